//! What is drawn on a face, as tables of a recipe.

use nonrigid::morph::{Blur, MorphModel};
use serde::{Deserialize, Serialize};
use toml::{Table, Value};
use ts_rs::TS;

use super::number;
use crate::error::{Problem, problem};

/// Most blurs of a mask: beyond, nobody waits for it.
pub(super) const MOST_BLURS: usize = 2000;
/// Pixels of a drawing to a millimetre.
const PIXELS_PER_MM: f64 = 2.0;

/// A shape or a combination of shapes, as recipes write it. Lengths are millimetres of the face's frame, or pixels of a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
#[serde(rename_all = "snake_case")]
pub enum Drawing {
    /// A disc.
    Circle {
        /// Middle.
        centre: [f64; 2],
        /// Radius.
        radius: f64,
    },
    /// An ellipse.
    Ellipse {
        /// Middle.
        centre: [f64; 2],
        /// Half axes.
        radii: [f64; 2],
        /// Turn of the first, degrees.
        angle: f64,
    },
    /// Part of a disc or ring.
    Sector {
        /// Tip.
        centre: [f64; 2],
        /// Inner radius.
        inner: f64,
        /// Outer radius.
        outer: f64,
        /// First side, degrees.
        start: f64,
        /// Turn to the second, degrees.
        sweep: f64,
    },
    /// Rings, even-odd.
    Polygon {
        /// Points of each.
        rings: Vec<Vec<[f64; 2]>>,
    },
    /// In any.
    Union(Vec<Drawing>),
    /// In the first and in no other.
    Subtract(Vec<Drawing>),
    /// In all.
    Intersect(Vec<Drawing>),
}

/// From where a mask was drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
#[serde(rename_all = "snake_case")]
pub enum DrawnFrom {
    /// Along an axis of the face's frame.
    Frame {
        /// Turn about y, degrees.
        yaw: f64,
        /// Then about x, degrees.
        pitch: f64,
    },
    /// By a camera without perspective, for a face without landmarks.
    Camera {
        /// Where it is.
        eye: [f64; 3],
        /// What it looks at.
        target: [f64; 3],
        /// Upwards.
        up: [f64; 3],
        /// Height of the picture, mm.
        height: f64,
        /// Width and height of the drawing, pixels.
        size: [u32; 2],
    },
}

/// A mask: drawn, or whole regions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
#[serde(rename_all = "snake_case")]
pub enum Mask {
    /// Drawn.
    Drawn {
        /// From where.
        from: DrawnFrom,
        /// What.
        drawing: Drawing,
    },
    /// Regions of the rig.
    Parts {
        /// Their names.
        names: Vec<String>,
    },
}

/// A step that was drawn on the face.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, TS)]
pub struct DrawnStep {
    /// Its name.
    pub name: String,
    /// Deformation model.
    pub model: String,
    /// What moves.
    pub mask: Mask,
    /// Width of the soft rim: standard deviation of the blur, mm.
    pub soft: f64,
    /// Displacement along the frame's axes, mm.
    pub displacement: [f64; 3],
    /// Also the mirror image.
    pub mirror: bool,
    /// Also what the surface hides.
    pub through: bool,
    /// What is protected.
    pub protect: Vec<Mask>,
    /// Vertices that stay.
    pub pins: Vec<u32>,
}

/// How often this blur makes a rim of so many pixels' standard deviation.
pub(super) fn times(blur: Blur, pixels: f64) -> i64 {
    let once = Blur { iterations: 1, ..blur }.deviation();
    // a half is rounded up, also where the root of a variance has cost its last bit
    ((pixels / once).powi(2) + 1e-9).round().clamp(0.0, MOST_BLURS as f64) as i64
}

pub(super) fn table(entries: impl IntoIterator<Item = (&'static str, Value)>) -> Value {
    Value::Table(entries.into_iter().map(|(k, v)| (k.to_owned(), v)).collect())
}

pub(super) fn mask_table(mask: &Mask, soft: f64, through: bool) -> Result<Table, Problem> {
    let mut out = Table::new();
    match mask {
        Mask::Parts { names } => {
            out.insert("parts".to_owned(), Value::try_from(names).map_err(problem)?);
        }
        Mask::Drawn { from, drawing } => {
            let mut pixels_per_mm = PIXELS_PER_MM;
            let view = match from {
                DrawnFrom::Frame { yaw, pitch } => {
                    let ppm = Value::from(PIXELS_PER_MM);
                    table([(
                        "frame",
                        table([("yaw", (*yaw).into()), ("pitch", (*pitch).into()), ("pixels_per_mm", ppm)]),
                    )])
                }
                DrawnFrom::Camera { height, size, .. } => {
                    pixels_per_mm = f64::from(size[1]) / height.max(1e-9);
                    Value::try_from(from).map_err(problem)?
                }
            };
            out.insert("region".to_owned(), Value::try_from(drawing).map_err(problem)?);
            out.insert("view".to_owned(), view);
            out.insert("blur".to_owned(), table([("iterations", times(Blur::default(), soft * pixels_per_mm).into())]));
            if through {
                out.insert("visibility".to_owned(), "through".into());
            }
        }
    }
    Ok(out)
}

pub(super) fn known_model(model: &str) -> Result<Value, Problem> {
    model.parse::<MorphModel>().map(|m| m.name().into()).map_err(problem)
}

pub(super) fn protect_tables(masks: &[Mask]) -> Result<Vec<Value>, Problem> {
    // what is protected has a sharp rim: a soft one would let part of it move
    masks.iter().map(|mask| Ok(Value::Table(mask_table(mask, 0.0, true)?))).collect()
}

pub(super) fn pixels_per_mm(mask: &Table) -> f64 {
    let view = mask.get("view");
    let of_frame = view.and_then(|v| v.get("frame")?.get("pixels_per_mm")).map(number);
    let of_camera = view.and_then(|v| v.get("camera")).and_then(|c| {
        let height = number(c.get("height")?);
        Some(number(c.get("size")?.as_array()?.get(1)?) / height.max(1e-9))
    });
    of_frame.or(of_camera).unwrap_or(4.0)
}

/// How a mask is blurred.
pub(super) fn blur_of(mask: &Table) -> Blur {
    mask.get("blur").and_then(|blur| blur.clone().try_into().ok()).unwrap_or_default()
}

/// The standard deviation, mm, of the rim that a mask's blurs make.
pub(super) fn soft(mask: &Table) -> f64 {
    blur_of(mask).deviation() / pixels_per_mm(mask)
}
