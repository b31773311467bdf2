//! The book's reference of schedules and recipes is what the code says: keys and defaults from the options themselves, sentences from
//! their documentation.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use nonrigid::correspondence::ScanOptions;
use nonrigid::energy::Options;
use nonrigid::measurement::{DEFINITIONS, Definition};
use nonrigid::model::{ModelFactory, ModelKind};
use nonrigid::morph::{DEFAULT_THRESHOLD, MAX_KERNEL, preset, preset_names};
use nonrigid::registration::{BoundsOptions, SigmaOptions, SolverOptions, StartOptions, StopOptions, WarmStartOptions};
use nonrigid::term::TERMS;

use crate::generated_page::check;

const NOTE: &str = "<!-- Generated from the code by a test; see tests/support/generated_page.rs. -->\n";

/// A field of a `struct` or a variant of an `enum`, with its documentation.
struct Entry {
    name: String,
    type_name: String,
    doc: String,
}

fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Documentation and entries of a public type in `src/FILE`.
fn entries(file: &str, name: &str) -> (String, Vec<Entry>) {
    let source = fs::read_to_string(repository().join("src").join(file)).unwrap();
    let lines: Vec<&str> = source.lines().collect();
    let opens = |l: &&str| ["struct", "enum"].iter().any(|k| **l == format!("pub {k} {name} {{"));
    let start = lines.iter().position(opens).unwrap_or_else(|| panic!("{file} has no {name}"));
    let above: Vec<&str> =
        lines[..start].iter().rev().copied().take_while(|l| l.starts_with("///") || l.starts_with('#')).collect();
    let about: Vec<&str> = above.into_iter().rev().filter_map(|l| l.strip_prefix("///")).collect();
    let (mut found, mut doc, mut skipped, mut renamed) = (Vec::<Entry>::new(), Vec::new(), false, None);
    let mut variant = String::new();
    for line in lines[start + 1..].iter().take_while(|l| **l != "}") {
        let text = line.trim_start();
        let depth = (line.len() - text.len()) / 4;
        if let Some(text) = text.strip_prefix("///") {
            doc.push(text);
        } else if text.starts_with('#') {
            skipped |= text.contains("serde(skip)") || text.contains("serde(untagged)");
            renamed = renamed.or_else(|| text.split("rename = \"").nth(1)?.split('"').next());
        } else if !text.starts_with('}') {
            let text = text.trim_start_matches("pub ").trim_end_matches([',', ' ', '{']);
            let (name, type_name) = text.split_once(": ").unwrap_or((text, ""));
            let name = name.split('(').next().unwrap();
            let name =
                renamed.map_or_else(|| if type_name.is_empty() { snake_case(name) } else { name.into() }, Into::into);
            let name = if depth > 1 { format!("{variant}.{name}") } else { name };
            if !skipped {
                found.push(Entry { name: name.clone(), type_name: type_name.into(), doc: sentence(&doc) });
            }
            if depth == 1 {
                variant = name;
            }
            (doc, skipped, renamed) = (Vec::new(), false, None);
        }
    }
    (sentence(&about), found)
}

fn snake_case(name: &str) -> String {
    let mut text = String::new();
    for c in name.chars() {
        if c.is_uppercase() && !text.is_empty() {
            text.push('_');
        }
        text.extend(c.to_lowercase());
    }
    text
}

/// Lines of documentation as one, without links.
fn sentence(lines: &[&str]) -> String {
    let lines = lines.iter().map(|l| l.trim()).filter(|l| !l.is_empty() && !l.contains("]: crate::"));
    let text = lines.take_while(|l| !l.starts_with("```")).collect::<Vec<_>>().join(" ");
    let (mut plain, mut rest) = (String::new(), text.trim());
    while let Some((before, after)) = rest.split_once('[') {
        plain += before;
        let code = before.matches('`').count() % 2 == 1;
        match after.split_once(']').filter(|(inner, _)| !code && (after.contains("](") || inner.starts_with('`'))) {
            Some((inner, tail)) => {
                plain += inner;
                rest = tail.strip_prefix('(').and_then(|t| t.split_once(')')).map_or(tail, |(_, tail)| tail);
            }
            None => {
                plain.push('[');
                rest = after;
            }
        }
    }
    plain + rest
}

/// Types of fields that are a choice between names, and where they are.
const CHOICES: [(&str, &str); 18] = [
    ("PoseKind", "mesh/pose.rs"),
    ("ScanFlip", "correspondence/mod.rs"),
    ("StepAlgorithm", "registration/schedule/options.rs"),
    ("LinearSolverKind", "nlls/linear/mod.rs"),
    ("KernelScale", "registration/schedule/level.rs"),
    ("GraphDistance", "model/node_options.rs"),
    ("NodeKind", "model/node_options.rs"),
    ("RotationKind", "model/node_options.rs"),
    ("Linearisation", "model/hybrid/mod.rs"),
    ("Smoothness", "model/free.rs"),
    ("EdgeWeights", "model/edge_weights.rs"),
    ("ArapSolver", "model/rigid_cells.rs"),
    ("Guidance", "model/poisson.rs"),
    ("Frames", "model/star_similarity.rs"),
    ("GreyWeights", "morph/texture.rs"),
    ("Sampling", "morph/texture.rs"),
    ("BlurKind", "morph/blur.rs"),
    ("Border", "morph/blur.rs"),
];

/// Text for a cell of a table. Names of Rust become what a file says.
fn cell(text: &str) -> String {
    let (threshold, side) = (format!("`{DEFAULT_THRESHOLD}`"), format!("`{MAX_KERNEL}`"));
    let words = [
        ("`DEFAULT_THRESHOLD`", threshold.as_str()),
        ("`MAX_KERNEL`", side.as_str()),
        ("`MorphModel::Direct`", "`\"direct\"`"),
        ("`Border::Replicate`", "`\"replicate\"`"),
        ("`StartSearch::rival`", "Likeness of the best pose elsewhere"),
    ];
    let text = words.iter().fold(text.to_owned(), |text, (name, word)| text.replace(name, word));
    let parts = text.split('`').enumerate();
    let escaped = parts.map(|(k, part)| if k % 2 == 1 { part.to_owned() } else { part.replace('<', "&lt;") });
    escaped.collect::<Vec<_>>().join("`").replace('|', "\\|")
}

/// What `As `T::field`.` stands for.
fn resolved(doc: &str) -> String {
    let named = doc.strip_prefix("As `").and_then(|d| d.strip_suffix("`.")).and_then(|d| d.split_once("::"));
    let Some((type_name, field)) = named else { return doc.to_owned() };
    let entry = entries("model/node_options.rs", type_name).1.into_iter().find(|e| e.name == field);
    entry.unwrap_or_else(|| panic!("{doc}")).doc
}

/// A table of keys: default, if `defaults` has them, and what they are.
fn table(entries: &[Entry], defaults: Option<&Options>) -> String {
    let head =
        if defaults.is_some() { "| key | default | what |\n|---|---|---|\n" } else { "| key | what |\n|---|---|\n" };
    let mut text = String::from(head);
    for Entry { name, type_name, doc } in entries {
        let mut what = cell(&resolved(doc));
        if let Some((choice, file)) = CHOICES.iter().find(|(choice, _)| type_name == choice) {
            for value in self::entries(file, choice).1.into_iter().filter(|value| !value.name.contains('.')) {
                write!(what, "<br>`\"{}\"`: {}", value.name, cell(&value.doc)).unwrap();
            }
        }
        write!(text, "| `{name}` | ").unwrap();
        if let Some(defaults) = defaults {
            let value = defaults.get(name).map_or("-".into(), |v| format!("`{v}`"));
            write!(text, "{value} | ").unwrap();
        }
        writeln!(text, "{what} |").unwrap();
    }
    text
}

/// The same for a type, of which `defaults` must be all that is not optional.
fn table_of(file: &str, name: &str, defaults: &Options) -> String {
    let (_, entries) = entries(file, name);
    let stated: BTreeSet<&str> = entries.iter().map(|e| e.name.as_str()).collect();
    for key in defaults.keys() {
        assert!(stated.contains(key), "{name} has no key {key}");
    }
    for entry in &entries {
        assert!(
            entry.type_name.starts_with("Option<") || defaults.get(&entry.name).is_some(),
            "{name}: {}",
            entry.name
        );
        assert!(!entry.doc.is_empty(), "{name}: {} says nothing", entry.name);
    }
    table(&entries, Some(defaults))
}

/// Which `struct` of which file a model reads from `[model]` and from a level's `model`.
fn tables_of(model: ModelKind) -> [Option<(&'static str, &'static str)>; 2] {
    let one_node = Some(("model/node_options.rs", "OneNodeOptions"));
    let blendshape = Some(("model/blendshape.rs", "BlendshapeLevel"));
    let graph = Some(("model/node_options.rs", "GraphOptions"));
    let smooth = Some(("model/factory.rs", "SmoothLevel"));
    match model.name() {
        "hybrid" | "klimov2020" => [graph, Some(("model/hybrid/mod.rs", "HybridLevel"))],
        "graph" => [graph, Some(("model/node_options.rs", "GraphLevel"))],
        "sumner" => [Some(("model/sumner.rs", "SumnerOptions")), Some(("model/node_options.rs", "GraphLevel"))],
        "blendshape" | "sequential" | "flame" => [one_node, blendshape],
        "rigid" | "similarity" => [one_node, None],
        "free" => [Some(("model/free.rs", "SmoothOptions")), smooth],
        "mass_spring" => [Some(("model/mass_spring.rs", "SpringOptions")), smooth],
        "fem" => [Some(("model/fem.rs", "TissueOptions")), smooth],
        "ffd" => [Some(("model/ffd.rs", "LatticeOptions")), smooth],
        "arap" => [Some(("model/arap.rs", "RigidityOptions")), smooth],
        "laplacian" => [Some(("model/laplacian.rs", "LaplacianOptions")), smooth],
        "gpmm" | "gpmm_rig" => [Some(("model/gpmm.rs", "GpmmOptions")), blendshape],
        "poisson" => [Some(("model/poisson.rs", "PoissonOptions")), smooth],
        "affine" => [Some(("model/affine.rs", "AffineOptions")), smooth],
        other => panic!("the reference does not know the model {other}"),
    }
}

#[test]
fn the_reference_of_schedules_is_that_of_the_code() {
    let schedule = "registration/schedule.rs";
    let [level_file, options] = ["registration/schedule/level.rs", "registration/schedule/options.rs"];
    let mut page = format!(
        "{NOTE}# Keys of a schedule\n\n\
         A schedule is a TOML file, given by `--config`. It replaces the [default schedule](default_schedules.md) of the model as a \
         whole, so start from that. Lengths are millimetres on a template of `reference_size`, and scale with yours.\n\n\
         ## Top level\n\n"
    );
    let tables = ["search", "scan", "solver", "stop", "warm_start", "sigma", "bounds"];
    let (_, mut fields) = entries(schedule, "Schedule");
    fields.iter_mut().for_each(|f| match f.name.as_str() {
        "start" => f.doc += " Default `\"rigid\"`.",
        "model" => f.doc = "What is true of the model at all levels. See [Models](#models).".into(),
        "terms" => f.doc = "What is true of a data term at all levels. See [Data terms](#data-terms).".into(),
        "bend" => f.doc += " See [below](#level).",
        "level" | "then" | "closed" => f.doc += &format!(" See [below](#{}).", f.name),
        name if tables.contains(&name) => f.doc += &format!(" See [below](#{name})."),
        _ => {}
    });
    page += &table(&fields, None);
    let of = |name: &str| match name {
        "search" => ("registration/start.rs", "StartOptions", Options::of(&StartOptions::default())),
        "scan" => ("correspondence/mod.rs", "ScanOptions", Options::of(&ScanOptions::default())),
        "solver" => (options, "SolverOptions", Options::of(&SolverOptions::default())),
        "stop" => (options, "StopOptions", Options::of(&StopOptions::default())),
        "warm_start" => (options, "WarmStartOptions", Options::of(&WarmStartOptions::default())),
        "sigma" => (options, "SigmaOptions", Options::of(&SigmaOptions::default())),
        "bounds" => (options, "BoundsOptions", Options::of(&BoundsOptions::default())),
        other => panic!("the reference does not know [{other}]"),
    };
    for name in tables {
        let (file, type_name, defaults) = of(name);
        let about = cell(&entries(file, type_name).0);
        write!(page, "\n## \\[{name}\\] {{#{name}}}\n\n{about}\n\n{}", table_of(file, type_name, &defaults)).unwrap();
    }
    let mut fields = entries(level_file, "Level").1;
    fields.iter_mut().for_each(|f| match f.name.as_str() {
        "model" => f.doc = "How stiff the model is. See [Models](#models).".into(),
        "kernel" => f.doc += " See [below](#kernels).",
        "terms" => f.doc += " See [Data terms](#data-terms).",
        _ => {}
    });
    let level = table(&fields, None);
    write!(page, "\n## \\[\\[level\\]\\] {{#level}}\n\n{}\n\n{level}", entries(level_file, "Level").0).unwrap();
    page += "\n### Robust kernels {#kernels}\n\n`kernel = \"none\"` or `kernel = { huber = { delta = 1.0 } }`. `delta`, or `eps`, is the \
             scale: beyond it a residual counts less.\n\n| kernel | keys | what |\n|---|---|---|\n";
    let kernels = entries("nlls/kernel.rs", "Kernel").1;
    for kernel in kernels.iter().filter(|k| !k.name.contains('.')) {
        let own = kernels.iter().filter_map(|k| k.name.strip_prefix(&kernel.name)?.strip_prefix('.'));
        let keys: Vec<String> = own.map(|key| format!("`{key}`")).collect();
        writeln!(page, "| `{}` | {} | {} |", kernel.name, keys.join(", "), kernel.doc).unwrap();
    }

    page += "\n## Data terms\n\nIn a level, `terms.NAME = { weight = 1.0 }`; a term that is not named has its default weight. \
             What is not said of single levels stands in `[terms.NAME]`.\n\n| term | in a level | in `[terms.NAME]` |\n|---|---|---|\n";
    for term in TERMS {
        let keys = |options: &Options| {
            let keys: Vec<_> = options.keys().map(|k| format!("`{k} = {}`", options.get(k).unwrap())).collect();
            if keys.is_empty() { "-".into() } else { keys.join(", ") }
        };
        let level = keys(&term.level_options(&Options::new()).unwrap());
        writeln!(page, "| `{}` | {level} | {} |", term.name(), keys(&term.options(&Options::new()).unwrap())).unwrap();
    }
    for (title, file, name) in [
        ("landmarks, in a level", "term/landmark.rs", "LandmarkLevel"),
        ("seam, in `[terms.seam]`", "term/seam.rs", "SeamOptions"),
    ] {
        write!(page, "\n**{title}**\n\n{}", table(&entries(file, name).1, None)).unwrap();
    }

    page += "\n## Models\n\n`[model]` holds what is true of all levels, `model = { ... }` in a level how stiff the model is there.\n";
    let mut told = BTreeSet::new();
    for model in ModelKind::ALL {
        let defaults = [model.options(&Options::new()).unwrap(), model.level_options(&Options::new()).unwrap()];
        write!(page, "\n### {}\n\n", model.name()).unwrap();
        for ((place, defaults), table) in ["[model]", "a level's `model`"].iter().zip(defaults).zip(tables_of(model)) {
            let Some((file, name)) = table else { continue };
            let text = table_of(file, name, &defaults);
            for field in entries(file, name).1 {
                let choice = CHOICES.iter().find(|(choice, _)| field.type_name == *choice);
                for value in choice.map(|(choice, file)| entries(file, choice).1).into_iter().flatten() {
                    let given = Options::new().with(&field.name, value.name.as_str());
                    model
                        .options(&given)
                        .unwrap_or_else(|e| panic!("{} {} = {}: {e}", model.name(), field.name, value.name));
                }
            }
            let place = if *place == "[model]" { "`[model]`" } else { place };
            if told.insert((name, text.clone())) {
                write!(page, "In {place}:\n\n{text}\n").unwrap();
            } else {
                let first = ModelKind::ALL.into_iter().find(|m| tables_of(*m).contains(&Some((file, name)))).unwrap();
                write!(page, "In {place}: as [{0}](#{0}).\n\n", first.name()).unwrap();
            }
        }
    }
    page.truncate(page.trim_end().len());
    page += "\n\n## \\[then\\] {#then}\n\n";
    write!(page, "{}\n\n{}", entries(schedule, "Stage").0, table(&entries(schedule, "Stage").1, None)).unwrap();
    let (doc, fields) = entries(schedule, "ClosedSubject");
    write!(page, "\n## \\[closed\\] {{#closed}}\n\n{doc}\n\n{}", table(&fields, None)).unwrap();
    check(repository(), "schedule.md", &page);
}

#[test]
fn the_reference_of_default_schedules_shows_every_model() {
    let mut page = format!(
        "{NOTE}# Default schedules\n\nWhat a model does without `--config`. Save one as a file, change what you must, and give it with \
         `--config`. [Keys of a schedule](schedule.md) says what each key is and what holds without it.\n"
    );
    for model in ModelKind::ALL {
        write!(page, "\n## {}\n\n```toml\n{}```\n", model.name(), model.default_schedule()).unwrap();
    }
    check(repository(), "default_schedules.md", &page);
}

#[test]
fn the_reference_of_recipes_is_that_of_the_code() {
    let mut page = format!(
        "{NOTE}# Recipes, presets, measurements\n\nA recipe is a TOML file that `nonrigid morph --recipe` replays on any mesh with the \
         same landmarks. `nonrigid morph --print nose-bridge` prints one to start from.\n"
    );
    for (title, file, name) in [
        ("Top level", "morph/recipe.rs", "Recipe"),
        ("\\[\\[step\\]\\]", "morph/recipe.rs", "RecipeStep"),
        ("\\[\\[step.mask\\]\\], \\[\\[step.protect\\]\\]", "morph/recipe.rs", "MaskSpec"),
        ("region", "morph/region.rs", "Region"),
        ("Shapes of a region", "morph/region.rs", "Shape"),
        ("blur", "morph/blur.rs", "Blur"),
        ("view", "morph/recipe.rs", "ViewSpec"),
        ("visibility", "morph/projection.rs", "Visibility"),
        ("frame", "morph/frame.rs", "FrameSpec"),
        ("frame.scale", "morph/frame.rs", "FrameScale"),
        ("\\[\\[step.pin\\]\\], \\[\\[step.goal\\]\\]", "morph/recipe.rs", "PointSpec"),
        ("\\[step.energy\\]", "morph/energy/mod.rs", "EnergyOptions"),
    ] {
        let (about, entries) = entries(file, name);
        let entries: Vec<Entry> = entries.into_iter().filter(|e| !e.doc.is_empty()).collect();
        assert!(!entries.is_empty(), "{name}");
        write!(page, "\n## {title}\n\n{}\n\n{}", cell(&about), table(&entries, None)).unwrap();
    }
    page += "\n## Presets\n\n`--preset NAME=MILLIMETRES`; without a number the usual amount.\n\n| preset | what | usual | range |\n|---|---|---|---|\n";
    for name in preset_names() {
        let recipe = preset(name).unwrap().unwrap();
        let range = recipe.range.map_or("-".into(), |[from, to]| format!("{from} to {to}"));
        writeln!(page, "| `{name}` | {} | {} | {range} |", cell(&recipe.about), recipe.amount).unwrap();
    }
    page += "\n## Measurements\n\n`nonrigid measure --list` prints them with their formulas and landmarks. A face after is measured along the axes of the \
             face before, carried along by the motion of the head: the rigid motion that leaves the least sum of displacements, each vertex by \
             its area.\n\n| measurement | unit | how |\n|---|---|---|\n";
    for definition in DEFINITIONS {
        let Definition { formula, .. } = definition;
        writeln!(page, "| {} | {} | {} |", definition.title(), formula.unit(), cell(&formula.to_string())).unwrap();
    }
    check(repository(), "recipes.md", &page);
}
