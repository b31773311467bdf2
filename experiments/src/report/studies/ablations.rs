//! Ablations: what each part of the hybrid is worth, one changed at a time.

use anyhow::Result;
use nonrigid::registration::{ModelKind, Schedule, StepAlgorithm};

use crate::plots::{Bar, GroupedBars};
use crate::report::effort::Effort;
use crate::report::study::{
    Block, ERROR_COLUMNS, Section, Setting, Study, error_cells, error_text, least_and_most, ranked, register_variant,
    spread,
};
use crate::report::table::{Table, counted, number, shown};
use crate::scan_bench::{LandmarkUse, Variant};

pub const STUDY: Study = Study {
    name: "ablations",
    title: "The hybrid, one part changed at a time",
    about: "Varied, each alone: number of nodes, nodes that move a vertex (K), distance between nodes, parametrisation of rotations, \
            rigid or affine nodes, minimiser, weight of the prior on blendshapes, landmarks; robust kernels and data terms here only \
            where the comparison does not have them. Held: everything else, as in the default schedule. Measured: errors, steps, the \
            largest blendshape weight.",
    tables: &["ablations"],
    seconds: |effort| {
        effort.ablation_cases as f64 * if effort.kernels_and_terms { 15.0 } else { 22.0 } * effort.vertices as f64
            / 5000.0
    },
    run,
};

/// The plot ends here, millimetres.
const TOP: f64 = 2.0;

fn run(setting: &Setting<'_>) -> Result<Section> {
    let variants = variants(setting.effort)?;
    let cases = &setting.data.cases[..setting.effort.ablation_cases.min(setting.data.cases.len())];
    let jobs: Vec<_> = variants.iter().flat_map(|v| cases.iter().map(move |c| (v, c))).collect();
    let outcomes = setting.run_all(&jobs, |(variant, case)| {
        let (row, result, _) = register_variant(variant, case)?;
        let largest = result.weights.iter().map(|w| w.value.abs()).fold(0.0, f64::max);
        Ok((row, largest))
    });

    let columns = [&["group", "name", "case"][..], &ERROR_COLUMNS, &["largest_weight", "error"]].concat();
    let mut table = Table::new(&columns);
    for ((variant, case), outcome) in jobs.iter().zip(outcomes) {
        let (row, largest) = match outcome {
            Ok((row, largest)) => (Ok(row), largest),
            Err(e) => (Err(e), f64::NAN),
        };
        let mut cells = vec![variant.group.clone(), variant.name.clone(), case.name.clone()];
        cells.extend(error_cells(row.as_ref().ok()));
        cells.extend([number(largest), error_text(&row)]);
        table.push(cells);
    }
    table.write(setting.out, "ablations")?;

    let columns =
        ["normal", "tangential", "rmse", "p95", "flips", "self_intersections", "iterations", "largest_weight"];
    let mut means = Table::new(&[&["group", "variant"][..], &columns].concat());
    let mut bars: Vec<(String, Bar)> = Vec::new();
    for variant in &variants {
        let rows = [("group", &*variant.group), ("name", &*variant.name)];
        let mean = |column: &str| table.numbers(&rows, column).map(|values| spread(&values));
        let mut cells = vec![variant.group.clone(), variant.name.clone()];
        for column in columns {
            let (mean, _) = mean(column)?;
            cells.push(if mean.is_finite() { number(mean) } else { "failed".to_owned() });
        }
        means.push(cells);
        let (mean, range) = mean("rmse")?;
        bars.push((variant.group.clone(), Bar { name: variant.name.clone(), value: mean, spread: Some(range) }));
    }
    let count = counted(cases.len(), "case");
    let caption = format!("Error of the hybrid with one part changed; mean and range over {count}.");
    let figure = setting.plot("ablations", &GroupedBars::new("", "rmse / mm", bars).top(TOP).svg()?, caption)?;
    let caption = format!("Means over {count}, millimetres.");
    let by_name = ranked(&table, &[], "name", "rmse")?;
    let default = by_name.iter().find(|(name, _)| *name == variants[0].name).map_or(f64::NAN, |d| d.1);
    let finding = format!("The default: {} mm. {}", shown(default), least_and_most("rmse", &by_name, " mm"));
    Ok(Section { finding, blocks: vec![figure, Block::Table { table: means, caption, file: "ablations.csv".into() }] })
}

/// Every variant, by group; the default is the first of all. Kernels and terms only where the comparison has them not.
fn variants(effort: &Effort) -> Result<Vec<Variant>> {
    let mut all = vec![Variant { group: "default".into(), ..Variant::of_model(ModelKind::Hybrid)? }];
    let mut add = |group: &str, name: &str, change: &dyn Fn(&mut Schedule)| -> Result<()> {
        all.push(Variant::hybrid(group, name, change)?);
        Ok(())
    };
    for nodes in [50, 100, 200, 400, 800, 1600] {
        add("nodes", &nodes.to_string(), &|s| s.model.set("nodes", nodes as i64))?;
    }
    for influences in [1, 2, 4, 6, 8] {
        add("influences", &format!("K = {influences}"), &|s| s.model.set("influences", influences as i64))?;
    }
    for (name, distance) in [("along the surface", "surface"), ("through space", "euclidean")] {
        add("distance", name, &|s| s.model.set("distance", distance))?;
    }
    for (name, rotation) in [("matrix", "matrix"), ("quaternion", "quaternion"), ("angle-axis", "angle_axis")] {
        add("rotation", name, &|s| s.model.set("rotation", rotation))?;
    }
    add("nodes' motion", "affine", &|s| {
        s.model.set("node", "affine");
        s.levels.iter_mut().for_each(|level| level.model.set("lambda_rotation", 1.0));
    })?;
    for (name, algorithm) in [
        ("Gauss-Newton", StepAlgorithm::GaussNewton),
        ("Levenberg-Marquardt", StepAlgorithm::LevenbergMarquardt),
        ("dogleg", StepAlgorithm::Dogleg),
    ] {
        add("minimiser", name, &|s| s.solver.algorithm = algorithm)?;
    }
    for factor in [0.0, 0.1, 1.0, 10.0] {
        add("prior", &format!("lambda_blend x {factor}"), &|s| {
            for level in &mut s.levels {
                let lambda = level.model.number("lambda_blend").unwrap_or(0.0);
                level.model.set("lambda_blend", factor * lambda);
            }
        })?;
    }
    if !effort.kernels_and_terms {
        all.extend(Variant::kernels()?);
        all.extend(Variant::terms()?);
    }
    for (name, landmarks) in [
        ("all", LandmarkUse::All),
        ("9", LandmarkUse::Some(9)),
        ("for the start", LandmarkUse::Align),
        ("none", LandmarkUse::None),
    ] {
        let of = Variant::of_model(ModelKind::Hybrid)?;
        all.push(Variant { group: "landmarks".into(), name: name.into(), landmarks, ..of });
    }
    Ok(all)
}
