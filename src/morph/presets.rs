//! The twenty modules of the paper's system (Li et al. 2018, section 3) as recipes in landmark coordinates.
//!
//! They are made for the 68 Multi-PIE/iBUG landmarks by number, which both the generated face and ICT-FaceKit have, and so has any
//! scan that was registered to either. Regions grow with the face: lengths are such that the outer corners of the eyes are 88 mm apart.
//! Amounts are millimetres of the mesh.

use super::{Recipe, RecipeError};

/// What all presets share: x from the subject's right to the left, y up from the chin to the nasion, z out of the face.
const FRAME: &str = "\
# lengths of regions are those of a face whose outer eye corners (36, 45) are 88 mm apart
[frame]
origin = [\"36\", \"39\", \"42\", \"45\"]
right = [\"36\", \"45\"]
up = [\"8\", \"27\"]
scale = { between = [\"36\", \"45\"], millimetres = 88.0 }

";

/// Name and steps of each preset.
const PRESETS: [(&str, &str); 20] = [
    ("thin-face", include_str!("presets/thin-face.toml")),
    ("chin-forward", include_str!("presets/chin-forward.toml")),
    ("chin-length", include_str!("presets/chin-length.toml")),
    ("jaw-angle", include_str!("presets/jaw-angle.toml")),
    ("nose-bridge", include_str!("presets/nose-bridge.toml")),
    ("nose-tip", include_str!("presets/nose-tip.toml")),
    ("hump", include_str!("presets/hump.toml")),
    ("alar-width", include_str!("presets/alar-width.toml")),
    ("forehead", include_str!("presets/forehead.toml")),
    ("temples", include_str!("presets/temples.toml")),
    ("brow-lift", include_str!("presets/brow-lift.toml")),
    ("brow-tail", include_str!("presets/brow-tail.toml")),
    ("inner-eye-corner", include_str!("presets/inner-eye-corner.toml")),
    ("outer-eye-corner", include_str!("presets/outer-eye-corner.toml")),
    ("eyelid", include_str!("presets/eyelid.toml")),
    ("cheekbone", include_str!("presets/cheekbone.toml")),
    ("cheek-volume", include_str!("presets/cheek-volume.toml")),
    ("upper-lip", include_str!("presets/upper-lip.toml")),
    ("lower-lip", include_str!("presets/lower-lip.toml")),
    ("lip-corner", include_str!("presets/lip-corner.toml")),
];

/// The presets' names.
#[must_use]
pub fn preset_names() -> [&'static str; 20] {
    PRESETS.map(|p| p.0)
}

/// The recipe of a preset as a file would have it; `None` if there is no preset of this name.
#[must_use]
pub fn preset_text(name: &str) -> Option<String> {
    let (_, text) = PRESETS.iter().find(|p| p.0 == name)?;
    // Tables end what stands at the top of a file.
    let (head, steps) = text.split_once("\n[[").expect("proven: every preset has a step, see the tests");
    Some(format!("{head}\n{FRAME}[[{steps}"))
}

/// A preset; `None` if there is none of this name.
///
/// # Errors
/// Never for the presets that come with the crate: a test reads them all.
pub fn preset(name: &str) -> Option<Result<Recipe, RecipeError>> {
    Some(Recipe::from_text(&preset_text(name)?, &format!("preset {name}")))
}
