//! Plans: recipes (TOML) that the page changes step by step and `nonrigid morph` replays to the same bytes.
//!
//! The text is all there is: every change reads it, changes its tables and writes it. What the page does not know (a recipe written by
//! hand may hold more) stays as it is.

mod drawn;

use std::collections::HashSet;
use std::path::Path;

use nonrigid::morph::{FrameSpec, MorphModel, Recipe, preset_names, preset_text};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};
use ts_rs::TS;

use self::drawn::{MOST_BLURS, blur_of, known_model, mask_table, pixels_per_mm, protect_tables, soft, table, times};
use crate::case::Side;
use crate::error::{Problem, problem};

pub use self::drawn::{Drawing, DrawnFrom, DrawnStep, Mask};

/// Largest recipe or schedule, bytes.
const LARGEST: usize = 4 << 20;
/// Most steps: beyond, nobody waits for it.
const MOST_STEPS: usize = 500;

/// What becomes of a step; what is not given stays.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, TS)]
#[serde(default)]
pub struct StepChange {
    /// Its name.
    pub name: Option<String>,
    /// What its displacements are multiplied by.
    pub amount: Option<f64>,
    /// Deformation model.
    pub model: Option<String>,
    /// Displacement of its first mask.
    pub displacement: Option<[f64; 3]>,
    /// Soft rim of its masks, mm.
    pub soft: Option<f64>,
    /// Mirror image of its masks.
    pub mirror: Option<bool>,
    /// Which side of the face.
    pub side: Option<Side>,
    /// What is protected, in place of what was.
    pub protect: Option<Vec<Mask>>,
}

impl StepChange {
    /// Whether it takes knowing the face's left from its right.
    #[must_use]
    pub fn needs_sides(&self) -> bool {
        self.mirror == Some(true) || self.side.is_some_and(|side| side != Side::Both)
    }
}

/// A step as the page lists it.
#[derive(Debug, Clone, PartialEq, Serialize, TS)]
pub struct StepView {
    /// Its name.
    pub name: String,
    /// The ready operation that it is, whose slider moves it; of a second one like it, none.
    pub preset: Option<String>,
    /// What its displacements are multiplied by; of a ready operation, millimetres.
    pub amount: f64,
    /// Which side of the face.
    pub side: Side,
    /// Deformation model.
    pub model: String,
    /// Displacement of its first mask.
    pub displacement: Option<[f64; 3]>,
    /// Soft rim of its first mask, mm.
    pub soft: f64,
    /// Mirror image of its first mask.
    pub mirror: bool,
    /// How many masks protect.
    pub protects: u32,
    /// How many points are pinned.
    pub pins: u32,
}

/// A ready operation.
#[derive(Debug, Clone, PartialEq, Serialize, TS)]
pub struct Preset {
    /// Its name.
    pub name: String,
    /// What it does.
    pub about: String,
    /// Usual millimetres.
    pub amount: f64,
    /// From where to where it is made for.
    pub range: [f64; 2],
}

/// The twenty ready operations.
#[must_use]
pub fn presets() -> Vec<Preset> {
    let known = |name: &str| {
        let table: Table = toml::from_str(&preset_text(name)?).ok()?;
        let text = |key: &str| table.get(key).and_then(Value::as_str).unwrap_or_default().to_owned();
        let range = table.get("range").and_then(Value::as_array).map(|r| [number(&r[0]), number(&r[1])]);
        Some(Preset {
            name: name.to_owned(),
            about: text("about"),
            amount: table.get("amount").map_or(1.0, number),
            range: range.unwrap_or([-5.0, 5.0]),
        })
    };
    preset_names().into_iter().filter_map(known).collect()
}

/// A plan without steps.
#[must_use]
pub fn empty(name: &str) -> String {
    let table = Table::from_iter([("name".to_owned(), Value::from(name))]);
    toml::to_string(&table).unwrap_or_default()
}

/// Whether a plan has no steps: it leaves the face as it is.
#[must_use]
pub fn is_empty(text: &str) -> bool {
    parse(text).is_ok_and(|table| table.keys().all(|key| ["name", "about"].contains(&key.as_str())))
}

/// Reads a plan that has steps.
///
/// # Errors
/// When it is no recipe, is too large, or names files: the page knows none but the vault's.
pub fn read(text: &str) -> Result<Recipe, Problem> {
    if text.len() > LARGEST {
        return Err(problem(format!("the recipe has {} bytes, at most {LARGEST} are read; split it", text.len())));
    }
    let recipe = Recipe::from_text(text, "the plan").map_err(problem)?;
    if let Some(file) = recipe.files().first() {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        return Err(problem(format!(
            "the recipe takes a mask from the file {name:?}, which is not in the vault; draw the mask or name regions (parts)"
        )));
    }
    let masks = recipe.step.iter().flat_map(|s| s.get_ref().mask.iter().chain(&s.get_ref().protect));
    if recipe.step.len() > MOST_STEPS
        || masks.into_iter().any(|m| m.get_ref().blur.is_some_and(|b| b.iterations > MOST_BLURS))
    {
        return Err(problem(format!("a plan has at most {MOST_STEPS} steps, a mask at most {MOST_BLURS} blurs")));
    }
    Ok(recipe)
}

/// Whether a text is a plan.
///
/// # Errors
/// As [`read`].
pub fn check(text: &str) -> Result<(), Problem> {
    if text.len() <= LARGEST && is_empty(text) { Ok(()) } else { read(text).map(drop) }
}

/// The text of a file that was added.
///
/// # Errors
/// When it is too long for a recipe or schedule, or cannot be read.
pub fn text_of(path: &Path) -> Result<String, Problem> {
    if std::fs::metadata(path)?.len() > LARGEST as u64 {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        return Err(problem(format!("{name}: larger than {LARGEST} bytes; is it another file?")));
    }
    Ok(nonrigid::io::read_text(path)?)
}

fn parse(text: &str) -> Result<Table, Problem> {
    toml::from_str(text).map_err(|e| problem(format!("the recipe: {}", e.message())))
}

fn steps(table: &Table) -> &[Value] {
    table.get("step").and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

fn number(value: &Value) -> f64 {
    value.as_float().or_else(|| value.as_integer().map(|i| i as f64)).unwrap_or_default()
}

/// Changes the tables of a plan and writes them; the recipe's amount goes into its steps.
fn edited(
    text: &str,
    change: impl FnOnce(&mut Table, &mut Vec<Value>) -> Result<(), Problem>,
) -> Result<String, Problem> {
    let mut table = parse(text)?;
    let mut steps = match table.remove("step") {
        Some(Value::Array(steps)) => steps,
        _ => Vec::new(),
    };
    let amount = table.remove("amount").map_or(1.0, |a| number(&a));
    table.remove("range");
    for step in steps.iter_mut().filter_map(Value::as_table_mut).filter(|_| amount != 1.0) {
        let own = step.get("amount").map_or(1.0, number);
        step.insert("amount".to_owned(), (own * amount).into());
    }
    change(&mut table, &mut steps)?;
    if steps.is_empty() {
        table.remove("frame");
    } else {
        table.insert("step".to_owned(), Value::Array(steps));
    }
    let text = toml::to_string(&table).map_err(problem)?;
    check(&text)?;
    Ok(text)
}

/// The frame of the ready operations, in which the page draws too.
fn preset_frame() -> Value {
    let text = preset_text(preset_names()[0]).unwrap_or_default();
    parse(&text).ok().and_then(|mut t| t.remove("frame")).unwrap_or(Value::Table(Table::new()))
}

/// Puts a step into the frame of the ready operations, whatever the recipe's own is.
fn into_frame(table: &mut Table, first: bool, step: &mut Table) {
    let frame = preset_frame();
    if first {
        table.insert("frame".to_owned(), frame);
    } else if table.get("frame") != Some(&frame) {
        step.insert("frame".to_owned(), frame);
    }
}

const LEFT: &str = "left side";
const RIGHT: &str = "right side";

fn side_of(step: &Table) -> Side {
    let protected = |name: &str| {
        let masks = step.get("protect").and_then(Value::as_array);
        masks.is_some_and(|m| m.iter().any(|m| m.get("name").and_then(Value::as_str) == Some(name)))
    };
    match (protected(LEFT), protected(RIGHT)) {
        (true, false) => Side::Right,
        (false, true) => Side::Left,
        _ => Side::Both,
    }
}

/// Protects the other side: a half of the face, drawn in its frame.
fn set_side(step: &mut Table, side: Side) {
    let mut protect = match step.remove("protect") {
        Some(Value::Array(masks)) => masks,
        _ => Vec::new(),
    };
    protect.retain(|m| ![Some(LEFT), Some(RIGHT)].contains(&m.get("name").and_then(Value::as_str)));
    let other = match side {
        Side::Both => None,
        Side::Left => Some((RIGHT, -1.0)),
        Side::Right => Some((LEFT, 1.0)),
    };
    if let Some((name, sign)) = other {
        let far = 160.0 * sign;
        let half = format!(
            "name = '{name}'\nvisibility = 'through'\nblur = {{ iterations = 0 }}\nview = {{ frame = {{ pixels_per_mm = 0.5 }} }}\n\
             region = {{ polygon = {{ rings = [[[0.0, -220.0], [{far:.1}, -220.0], [{far:.1}, 180.0], [0.0, 180.0]]] }} }}"
        );
        protect.extend(parse(&half).map(Value::Table));
    }
    if !protect.is_empty() {
        step.insert("protect".to_owned(), Value::Array(protect));
    }
}

/// The step of a ready operation, with its name.
fn preset_step(name: &str) -> Option<Table> {
    let preset = parse(&preset_text(name)?).ok()?;
    steps(&preset).first()?.as_table().cloned()
}

/// The ready operation that a step is: its masks tell it, the name may be anyone's.
fn preset_of(step: &Value) -> Option<String> {
    let name = step.get("name").and_then(Value::as_str)?;
    (step.get("mask")? == preset_step(name)?.get("mask")?).then(|| name.to_owned())
}

/// A plan with a ready operation: added, changed, or with 0 mm taken away. Of steps that are this operation, the first is meant.
///
/// # Errors
/// When there is none of this name.
pub fn with_preset(text: &str, preset: &str, amount: f64, side: Side) -> Result<String, Problem> {
    if !amount.is_finite() {
        return Err(problem(format!("{preset}: give millimetres")));
    }
    let known = preset_step(preset).ok_or_else(|| {
        problem(format!("there is no ready operation {preset:?}; there are {}", preset_names().join(", ")))
    })?;
    edited(text, |table, steps| {
        let at = steps.iter().position(|step| preset_of(step).as_deref() == Some(preset));
        if amount == 0.0 {
            at.map(|at| steps.remove(at));
            return Ok(());
        }
        let at = at.unwrap_or_else(|| {
            let mut step = known;
            into_frame(table, steps.is_empty(), &mut step);
            steps.push(Value::Table(step));
            steps.len() - 1
        });
        let step = step_at(steps, at)?;
        step.insert("amount".to_owned(), amount.into());
        set_side(step, side);
        Ok(())
    })
}

/// A plan with a drawn step at its end.
///
/// # Errors
/// When the step is no step of a recipe.
pub fn with_step(text: &str, drawn: &DrawnStep) -> Result<String, Problem> {
    edited(text, |recipe, steps| {
        let mut mask = mask_table(&drawn.mask, drawn.soft, drawn.through)?;
        mask.insert("displacement".to_owned(), Value::try_from(drawn.displacement).map_err(problem)?);
        if drawn.mirror {
            mask.insert("mirror".to_owned(), true.into());
        }
        let mut step = Table::new();
        step.insert("name".to_owned(), drawn.name.as_str().into());
        check_pins(&drawn.model, !drawn.pins.is_empty())?;
        step.insert("model".to_owned(), known_model(&drawn.model)?);
        step.insert("mask".to_owned(), Value::Array(vec![Value::Table(mask)]));
        let protect = protect_tables(&drawn.protect)?;
        if !protect.is_empty() {
            step.insert("protect".to_owned(), Value::Array(protect));
        }
        let pin = |v: &u32| table([("vertex", i64::from(*v).into()), ("by", Value::Array(vec![0.0.into(); 3]))]);
        if !drawn.pins.is_empty() {
            step.insert("pin".to_owned(), Value::Array(drawn.pins.iter().map(pin).collect()));
        }
        let framed = |mask: &Mask| matches!(mask, Mask::Drawn { from: DrawnFrom::Frame { .. }, .. });
        if drawn.mirror || framed(&drawn.mask) || drawn.protect.iter().any(framed) {
            into_frame(recipe, steps.is_empty(), &mut step);
        }
        steps.push(Value::Table(step));
        Ok(())
    })
}

/// Refuses pins of a model that cannot hold them.
fn check_pins(model: &str, pins: bool) -> Result<(), Problem> {
    if pins && model == MorphModel::Direct.name() {
        return Err(problem("the direct model holds no pins: choose another model, such as arap, or no pins"));
    }
    Ok(())
}

fn step_at(steps: &mut [Value], index: usize) -> Result<&mut Table, Problem> {
    let step = steps.get_mut(index).and_then(Value::as_table_mut);
    step.ok_or_else(|| problem("this step is not there any more; another window has changed the plan"))
}

/// A plan with a step changed.
///
/// # Errors
/// When there is no such step, it would be none of a recipe, or has no frame in which left and right are told.
pub fn with_change(text: &str, index: usize, change: &StepChange) -> Result<String, Problem> {
    edited(text, |recipe, steps| {
        let step = step_at(steps, index)?;
        if change.needs_sides() && !step.contains_key("frame") && !recipe.contains_key("frame") {
            return Err(problem(
                "this step was drawn where nothing told the face's left from its right, so it has no side and no mirror \
                 image: give the face its landmarks and draw the step again",
            ));
        }
        if let Some(name) = &change.name {
            step.insert("name".to_owned(), name.as_str().into());
        }
        if let Some(amount) = change.amount {
            step.insert("amount".to_owned(), amount.into());
        }
        if let Some(model) = &change.model {
            check_pins(model, step.contains_key("pin"))?;
            step.insert("model".to_owned(), known_model(model)?);
        }
        if let Some(side) = change.side {
            set_side(step, side);
        }
        if let Some(masks) = &change.protect {
            let side = side_of(step);
            step.insert("protect".to_owned(), Value::Array(protect_tables(masks)?));
            set_side(step, side);
        }
        let masks = step.get_mut("mask").and_then(Value::as_array_mut);
        for (k, mask) in masks.into_iter().flatten().filter_map(Value::as_table_mut).enumerate() {
            if let Some(displacement) = change.displacement.filter(|_| k == 0) {
                mask.insert("displacement".to_owned(), Value::try_from(displacement).map_err(problem)?);
            }
            if let Some(soft) = change.soft.filter(|_| !mask.contains_key("parts")) {
                let iterations = times(blur_of(mask), soft * pixels_per_mm(mask)).into();
                match mask.get_mut("blur").and_then(Value::as_table_mut) {
                    Some(blur) => drop(blur.insert("iterations".to_owned(), iterations)),
                    None => drop(mask.insert("blur".to_owned(), table([("iterations", iterations)]))),
                }
            }
            if let Some(mirror) = change.mirror {
                mask.insert("mirror".to_owned(), mirror.into());
            }
        }
        Ok(())
    })
}

/// A plan with a step at another place.
///
/// # Errors
/// When there is no such step.
pub fn moved(text: &str, from: usize, to: usize) -> Result<String, Problem> {
    edited(text, |_, steps| {
        step_at(steps, from)?;
        step_at(steps, to)?;
        let step = steps.remove(from);
        steps.insert(to, step);
        Ok(())
    })
}

/// A plan without a step.
///
/// # Errors
/// When there is no such step.
pub fn without(text: &str, index: usize) -> Result<String, Problem> {
    edited(text, |_, steps| {
        step_at(steps, index)?;
        steps.remove(index);
        Ok(())
    })
}

/// A plan without the steps whose pins or goals are vertices by number, and the names of those.
///
/// # Errors
/// When it is no recipe.
pub fn without_vertices(text: &str) -> Result<(String, Vec<String>), Problem> {
    let numbered = |step: &Value| {
        let points = ["pin", "goal"].into_iter().filter_map(|key| step.get(key)?.as_array()).flatten();
        points.into_iter().any(|point| point.get("vertex").is_some())
    };
    let mut names = Vec::new();
    if !steps(&parse(text)?).iter().any(numbered) {
        return Ok((text.to_owned(), names));
    }
    let text = edited(text, |_, steps| {
        names.extend(steps.extract_if(.., |step| numbered(step)).map(|step| name_of(&step)));
        Ok(())
    })?;
    Ok((text, names))
}

fn name_of(step: &Value) -> String {
    step.get("name").and_then(Value::as_str).unwrap_or("a step without a name").to_owned()
}

/// The steps as the page lists them.
#[must_use]
pub fn view(text: &str) -> Vec<StepView> {
    let Ok(table) = parse(text) else { return Vec::new() };
    let amount = table.get("amount").map_or(1.0, number);
    let mut presets = HashSet::new();
    let of = |step: &Value| {
        let preset = preset_of(step).filter(|name| presets.insert(name.clone()));
        let step = step.as_table()?;
        let masks = step.get("mask").and_then(Value::as_array);
        let mask = masks.and_then(|m| m.first()).and_then(Value::as_table).cloned().unwrap_or_default();
        let text = |key: &str| step.get(key).and_then(Value::as_str).unwrap_or_default().to_owned();
        let count = |key: &str| step.get(key).and_then(Value::as_array).map_or(0, |a| a.len() as u32);
        let displacement = mask.get("displacement").and_then(Value::as_array).filter(|d| d.len() == 3);
        let side = side_of(step);
        Some(StepView {
            preset,
            name: text("name"),
            amount: amount * step.get("amount").map_or(1.0, number),
            side,
            model: Some(text("model")).filter(|m| !m.is_empty()).unwrap_or_else(|| "direct".to_owned()),
            displacement: displacement.map(|d| std::array::from_fn(|k| number(&d[k]))),
            soft: soft(&mask),
            mirror: mask.get("mirror").and_then(Value::as_bool).unwrap_or_default(),
            protects: count("protect") - u32::from(side != Side::Both),
            pins: count("pin"),
        })
    };
    steps(&table).iter().filter_map(of).collect()
}

/// What each step depends on besides the face it finds: equal texts do the same.
#[must_use]
pub fn step_keys(text: &str) -> Vec<String> {
    let Ok(table) = parse(text) else { return Vec::new() };
    let shared = ["amount", "frame"].map(|key| table.get(key).map(ToString::to_string).unwrap_or_default()).join("\n");
    steps(&table).iter().map(|step| format!("{shared}\n{step}")).collect()
}

/// What a step depends on besides the face it finds, its amount and the displacements of its masks: what a drag leaves as it is.
/// Where pins or goals are moved too, the amount stays in it.
#[must_use]
pub fn drag_key(text: &str, index: usize) -> String {
    let Ok(mut table) = parse(text) else { return String::new() };
    let moved =
        |point: &Value| point.get("by").and_then(Value::as_array).is_some_and(|by| by.iter().any(|x| number(x) != 0.0));
    let points = |step: &Table, key: &str| step.get(key).and_then(Value::as_array).cloned().unwrap_or_default();
    let Some(mut step) = steps(&table).get(index).and_then(Value::as_table).cloned() else { return String::new() };
    if !["pin", "goal"].iter().any(|key| points(&step, key).iter().any(moved)) {
        step.remove("amount");
        table.remove("amount");
    }
    for mask in step.get_mut("mask").and_then(Value::as_array_mut).into_iter().flatten().filter_map(Value::as_table_mut)
    {
        if let Some(displacement) = mask.get_mut("displacement") {
            *displacement = true.into();
        }
    }
    let shared = ["amount", "frame"].map(|key| table.get(key).map(ToString::to_string).unwrap_or_default()).join("\n");
    format!("{shared}\n{step}")
}

/// A recipe of one step of another one.
#[must_use]
pub fn only_step(recipe: &Recipe, step: usize) -> Recipe {
    let mut single = recipe.clone();
    single.step = vec![recipe.step[step].clone()];
    single
}

/// The frame of the ready operations, and of what is drawn.
#[must_use]
pub fn frame_spec() -> Option<FrameSpec> {
    preset_frame().try_into().ok()
}

/// The frame of a step: its own, or else the recipe's.
#[must_use]
pub fn frame_of(text: &str, index: usize) -> Option<FrameSpec> {
    let table = parse(text).ok()?;
    let frame = steps(&table).get(index)?.get("frame").or_else(|| table.get("frame"))?;
    frame.clone().try_into().ok()
}

#[cfg(test)]
mod tests {
    use nonrigid::morph::Blur;

    use super::*;

    #[test]
    fn presets_come_change_and_go() {
        let plan = with_preset(&empty("A"), "nose-bridge", 2.5, Side::Both).unwrap();
        let plan = with_preset(&plan, "thin-face", 3.0, Side::Left).unwrap();
        let plan = with_preset(&plan, "nose-bridge", 1.5, Side::Both).unwrap();
        let steps = view(&plan);
        assert_eq!(
            steps.iter().map(|s| (&*s.name, s.amount, s.side)).collect::<Vec<_>>(),
            [("nose-bridge", 1.5, Side::Both), ("thin-face", 3.0, Side::Left)]
        );
        assert_eq!(view(&moved(&plan, 0, 1).unwrap())[0].name, "thin-face");
        let plan = with_preset(&plan, "nose-bridge", 0.0, Side::Both).unwrap();
        let plan = with_preset(&plan, "thin-face", 0.0, Side::Both).unwrap();
        assert_eq!(plan, empty("A"));
        assert!(with_preset(&plan, "nose", 1.0, Side::Both).is_err());
    }

    #[test]
    fn a_slider_moves_the_step_that_it_made_and_no_namesake() {
        let own =
            "[[step]]\nname = 'nose-bridge'\namount = 0.5\n[[step.mask]]\nparts = ['lips']\ndisplacement = [0, 0, 1]\n";
        let slid = |text: &str, amount: f64| with_preset(text, "nose-bridge", amount, Side::Both).unwrap();
        let seen = |text: &str| view(text).into_iter().map(|s| (s.preset.is_some(), s.amount)).collect::<Vec<_>>();
        let plan = slid(own, 2.0);
        assert_eq!(seen(&plan), [(false, 0.5), (true, 2.0)]);
        let one_side = with_preset(&plan, "nose-bridge", 3.0, Side::Left).unwrap();
        assert_eq!(seen(&one_side), [(false, 0.5), (true, 3.0)]);
        assert_eq!(seen(&slid(&one_side, 0.0)), [(false, 0.5)]);
        // the same operation twice, as in a recipe that was loaded: the second is none of the slider's
        let single = slid(&empty("A"), 1.0);
        let twice = edited(&single, |_, steps| {
            steps.push(steps[0].clone());
            Ok(())
        });
        let twice = twice.unwrap();
        assert_eq!(seen(&slid(&twice, 2.0)), [(true, 2.0), (false, 1.0)]);
        assert_eq!(seen(&slid(&twice, 0.0)), [(true, 1.0)]);
    }

    #[test]
    fn drawn_steps_are_recipes() {
        let drawing = Drawing::Union(vec![
            Drawing::Circle { centre: [0.0, 5.0], radius: 9.0 },
            Drawing::Polygon { rings: vec![vec![[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]]] },
        ]);
        let step = DrawnStep {
            name: "cheek".to_owned(),
            model: "arap".to_owned(),
            mask: Mask::Drawn { from: DrawnFrom::Frame { yaw: 30.0, pitch: -4.0 }, drawing },
            soft: 5.0,
            displacement: [0.0, 0.0, 3.0],
            mirror: true,
            through: false,
            protect: vec![Mask::Parts { names: vec!["lips".to_owned()] }],
            pins: vec![7],
        };
        let plan = with_step(&empty("A"), &step).unwrap();
        let recipe = read(&plan).unwrap();
        let first = recipe.step[0].get_ref();
        assert_eq!((first.mask.len(), first.protect.len(), first.pin.len()), (1, 1, 1));
        assert_eq!((&*view(&plan)[0].model, view(&plan)[0].mirror), ("arap", true));
        assert!((view(&plan)[0].soft - 5.0).abs() < 0.3);
        let change = StepChange { soft: Some(0.0), side: Some(Side::Right), ..StepChange::default() };
        let steps = view(&with_change(&plan, 0, &change).unwrap());
        assert_eq!((steps[0].soft, steps[0].side, steps[0].protects), (0.0, Side::Right, 1));
        assert!(with_change(&plan, 1, &change).is_err());
        // what has no energy holds no pins
        let direct = StepChange { model: Some("direct".to_owned()), ..StepChange::default() };
        assert!(with_change(&plan, 0, &direct).unwrap_err().0.contains("pins"));
        let pinned = DrawnStep { model: "direct".to_owned(), ..step.clone() };
        assert!(with_step(&plan, &pinned).unwrap_err().0.contains("pins"));
        assert!(with_step(&plan, &DrawnStep { model: "magic".to_owned(), ..step }).is_err());
    }

    #[test]
    fn a_soft_rim_is_as_wide_whatever_the_kernel() {
        let mask = "[[step]]\n[[step.mask]]\nregion = { circle = { centre = [0, 0], radius = 9 } }\ndisplacement = [0, 0, 1]\n";
        for (blur, iterations) in [
            ("{ kernel = 5, iterations = 3 }", 128),
            ("{ kernel = 31, iterations = 3 }", 3),
            ("{ kind = { gaussian = { sigma = 4.0 } }, border = 'zero' }", 16),
        ] {
            let plan = format!("{mask}blur = {blur}\n");
            let change = StepChange { soft: Some(4.0), ..StepChange::default() };
            let changed = with_change(&plan, 0, &change).unwrap();
            let [before, after] =
                [&plan, &changed].map(|text| read(text).unwrap().step[0].get_ref().mask[0].get_ref().blur);
            let (before, after) = (before.unwrap(), after.unwrap());
            assert_eq!(after, Blur { iterations, ..before }, "{blur}");
            assert!((view(&changed)[0].soft - 4.0).abs() < 0.3, "{blur}: {}", view(&changed)[0].soft);
            assert!((view(&plan)[0].soft - before.deviation() / 4.0).abs() < 1e-12, "{blur}");
        }
    }

    #[test]
    fn a_drag_changes_displacements_and_amounts_alone() {
        let plan = |amount: f64, up: f64, radius: f64, pin: f64| {
            format!(
                "amount = {amount:?}\n[[step]]\namount = {amount:?}\n[[step.mask]]\nregion = {{ circle = {{ centre = [0, 0], radius = {radius:?} }} }}\n\
                 displacement = [0, 0, {up:?}]\n[[step.pin]]\nvertex = 7\nby = [0, 0, {pin:?}]\n"
            )
        };
        let key = |text: &str| drag_key(text, 0);
        let first = key(&plan(1.0, 2.0, 9.0, 0.0));
        assert_eq!(key(&plan(2.0, -3.0, 9.0, 0.0)), first);
        assert_ne!(key(&plan(1.0, 2.0, 9.5, 0.0)), first);
        assert_ne!(key(&plan(1.0, 2.0, 9.0, 1.0)), first);
        assert_ne!(key(&plan(1.0, 2.0, 9.0, 1.0)), key(&plan(2.0, 2.0, 9.0, 1.0)), "the pin moves with the amount");
        assert_ne!(
            key(&plan(1.0, 2.0, 9.0, 0.0).replace("displacement = [0, 0, 2.0]", "")),
            first,
            "a free mask is another"
        );
    }

    #[test]
    fn plans_name_no_files() {
        for file in ["png = '/etc/passwd'", "weights = '../../x.npy'"] {
            let text = format!("[[step]]\n[[step.mask]]\n{file}\ndisplacement = [0, 0, 1]");
            assert!(check(&text).unwrap_err().0.contains("not in the vault"), "{file}");
        }
        assert!(check("[[step]]\n[[step.mask]]\nparts = ['lips']\nblur = { iterations = 100000000 }").is_err());
    }
}
