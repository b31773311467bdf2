//! Recipes: what is done to a face, as a TOML file that replays on any mesh with the same landmarks.
//!
//! ```toml
//! name = "a higher bridge of the nose"
//! frame = { origin = ["27"], right = ["36", "45"], up = ["8", "27"] }
//!
//! [[step]]
//! model = "direct"                 # or free, arap, graph, blendshape, hybrid
//!
//! [[step.mask]]
//! at = ["28"]                      # drawn about this landmark, in millimetres, seen from the front
//! region = { ellipse = { centre = [0, 0], radii = [5, 14] } }
//! blur = { iterations = 10 }
//! displacement = [0, 0, 2.5]       # right, up, out of the face
//! ```
//!
//! Everything that a recipe can say is a field of [`Recipe`], [`RecipeStep`], [`MaskSpec`], [`ViewSpec`] and [`PointSpec`].

use std::path::{Path, PathBuf};

use serde::Deserialize;
use toml::Spanned;

use super::{
    Blur, DEFAULT_THRESHOLD, EnergyOptions, FrameSpec, GreyWeights, MorphError, MorphModel, Region, Sampling,
    Visibility,
};
use crate::io::{ReadError, read_text};

/// A recipe: steps, done in order, each on what the one before has left.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// What it is, in a few words.
    #[serde(default)]
    pub name: String,
    /// What it does, in a sentence.
    #[serde(default)]
    pub about: String,
    /// What all displacements are multiplied by, unless another amount is asked for; default 1. A preset states its displacements
    /// for one millimetre, and here how many are usual.
    #[serde(default = "one")]
    pub amount: f64,
    /// Amounts for which it is made, the least and the most; another is done with a warning.
    #[serde(default, deserialize_with = "crate::io::arrays::optional_array")]
    pub range: Option<[f64; 2]>,
    /// The frame in which masks are drawn and displacements given. Without it both are in the mesh's own axes, and masks need a camera,
    /// texture coordinates or a file.
    #[serde(default)]
    pub frame: Option<FrameSpec>,
    /// The steps.
    #[serde(default)]
    pub step: Vec<Spanned<RecipeStep>>,
    /// Where files that it names are, and what it is called in messages.
    #[serde(skip)]
    source: Source,
    /// Byte at which each line of the text ends.
    #[serde(skip)]
    line_ends: Vec<usize>,
}

#[derive(Debug, Clone, Default)]
struct Source {
    name: String,
    folder: PathBuf,
}

/// One step: all its masks move at once.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecipeStep {
    /// For reports.
    #[serde(default)]
    pub name: String,
    /// What its displacements are multiplied by, besides the recipe's amount; default 1. So steps of several presets, each stated for
    /// one millimetre, make one recipe.
    #[serde(default = "one")]
    pub amount: f64,
    /// Default `direct`. The others are deformation models that can be held at a rim; `nonrigid morph --help` names them.
    #[serde(default)]
    pub model: MorphModel,
    /// Of an energy; the direct model has none.
    #[serde(default)]
    pub energy: EnergyOptions,
    /// Weight of a mask, 0 to 1, up to which it leaves a vertex where it is; default [`DEFAULT_THRESHOLD`], one grey step of 8 bits.
    #[serde(default = "threshold")]
    pub threshold: f64,
    /// In place of the recipe's.
    #[serde(default)]
    pub frame: Option<FrameSpec>,
    /// What moves. A mask without displacement lets its vertices follow goals, pins and neighbours.
    #[serde(default)]
    pub mask: Vec<Spanned<MaskSpec>>,
    /// What is protected: the weights of all masks are multiplied by one less these.
    #[serde(default)]
    pub protect: Vec<Spanned<MaskSpec>>,
    /// Points that end exactly where they are put.
    #[serde(default)]
    pub pin: Vec<Spanned<PointSpec>>,
    /// Points that are drawn somewhere.
    #[serde(default)]
    pub goal: Vec<Spanned<PointSpec>>,
}

/// A mask: one of `region`, `png`, `weights` and `parts`.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MaskSpec {
    /// For reports.
    pub name: String,
    /// A drawing. Its coordinates are the frame's millimetres, a camera's pixels (from the top left, y down), or texture coordinates.
    pub region: Option<Region>,
    /// A picture.
    pub png: Option<PathBuf>,
    /// What red, green and blue of the picture count for.
    pub grey: GreyWeights,
    /// Weights of the vertices themselves, a `.npy` file.
    pub weights: Option<PathBuf>,
    /// Whole regions of the rig, or groups of the mesh, by name.
    pub parts: Vec<String>,
    /// How the drawing or picture meets the mesh.
    pub view: ViewSpec,
    /// Landmarks about whose mean the frame is put, in place of its origin.
    pub at: Vec<String>,
    /// Of the drawing or picture; default the paper's 13 x 13 mean, 20 times, and for what is protected none: a soft rim would let
    /// part of it move.
    pub blur: Option<Blur>,
    /// Default bilinear.
    pub sampling: Sampling,
    /// Default the visible surface.
    pub visibility: Visibility,
    /// How far a vertex of weight 1 moves, millimetres of the mesh along the frame's axes, times the amount.
    #[serde(deserialize_with = "crate::io::arrays::optional_array")]
    pub displacement: Option<[f64; 3]>,
    /// Also the mirror image, in the frame's plane x = 0, of mask and displacement.
    pub mirror: bool,
}

impl MaskSpec {
    /// Keys that say something else than the default and have no effect, and why.
    fn without_effect(&self) -> Vec<(&'static str, &'static str)> {
        let by_vertex = match (&self.weights, &self.parts[..]) {
            (Some(_), _) => Some("weights are of vertices already"),
            (None, [_, ..]) => Some("parts are whole vertices already"),
            (None, []) => None,
        };
        let drawn = by_vertex.or(self.region.as_ref().map(|_| "a drawing has no colours"));
        let (no_frame, all_seen) = match &self.view {
            ViewSpec::Frame { .. } => (None, None),
            ViewSpec::Camera { .. } => (Some("a camera has its own place"), None),
            ViewSpec::Uv { .. } => {
                (Some("texture coordinates have their own place"), Some("in texture coordinates nothing is hidden"))
            }
        };
        let of_picture = self.png.as_ref().map(|_| "a picture has its own pixels");
        let of_pixels = match &self.view {
            ViewSpec::Frame { pixels_per_mm: asked, .. } => ("pixels_per_mm", *asked != pixels_per_mm(), of_picture),
            ViewSpec::Camera { size: asked, .. } | ViewSpec::Uv { size: asked } => {
                ("size", *asked != size(), of_picture)
            }
        };
        let has_both = matches!(self.view, ViewSpec::Camera { vertical_fov: Some(_), height: Some(_), .. });
        let said = [
            ("view", self.view != ViewSpec::default(), by_vertex),
            ("at", !self.at.is_empty(), by_vertex.or(no_frame)),
            ("blur", self.blur.is_some(), by_vertex),
            ("sampling", self.sampling != Sampling::default(), by_vertex),
            ("visibility", self.visibility != Visibility::default(), by_vertex.or(all_seen)),
            ("grey", self.grey != GreyWeights::default(), drawn),
            of_pixels,
            ("vertical_fov", has_both, Some("a camera with a height has no angle")),
        ];
        said.into_iter().filter(|(_, other, _)| *other).filter_map(|(key, _, why)| Some((key, why?))).collect()
    }
}

/// How a texture meets the mesh.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum ViewSpec {
    /// Along the axis of the frame that points out of the face.
    Frame {
        /// The frame turned about its y axis, degrees; at 90 the face is seen from its left.
        #[serde(default)]
        yaw: f64,
        /// Then about its x axis, degrees; at 90 the face is seen from above.
        #[serde(default)]
        pitch: f64,
        /// Pixels to a millimetre of the frame; default 4.
        #[serde(default = "pixels_per_mm")]
        pixels_per_mm: f64,
        /// Corners of what a picture covers, millimetres of the frame; a drawing knows where it ends.
        #[serde(default, deserialize_with = "crate::io::arrays::optional_arrays")]
        covers: Option<[[f64; 2]; 2]>,
    },
    /// By a camera.
    Camera {
        /// Where it is, millimetres.
        #[serde(deserialize_with = "crate::io::arrays::array")]
        eye: [f64; 3],
        /// What it looks at.
        #[serde(deserialize_with = "crate::io::arrays::array")]
        target: [f64; 3],
        /// Which way is up; default y.
        #[serde(default = "up", deserialize_with = "crate::io::arrays::array")]
        up: [f64; 3],
        /// Full vertical angle, degrees, of a perspective picture; default 30.
        #[serde(default)]
        vertical_fov: Option<f64>,
        /// Height, millimetres, of an orthographic one.
        #[serde(default)]
        height: Option<f64>,
        /// Width and height of a drawing, pixels; default 1024 x 1024. A picture has its own.
        #[serde(default = "size", deserialize_with = "crate::io::arrays::array")]
        size: [usize; 2],
    },
    /// By the mesh's own texture coordinates; nothing lies under the mask whose coordinates are not from 0 to 1.
    Uv {
        /// Width and height of a drawing, pixels; default 1024 x 1024. A picture has its own.
        #[serde(default = "size", deserialize_with = "crate::io::arrays::array")]
        size: [usize; 2],
    },
}

impl Default for ViewSpec {
    fn default() -> Self {
        Self::Frame { yaw: 0.0, pitch: 0.0, pixels_per_mm: pixels_per_mm(), covers: None }
    }
}

/// A pin or a goal: one of `landmark` and `vertex`, one of `by` and `to`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointSpec {
    /// A landmark.
    #[serde(default)]
    pub landmark: Option<String>,
    /// A vertex.
    #[serde(default)]
    pub vertex: Option<u32>,
    /// How far from where it is, millimetres along the frame's axes, times the amount.
    #[serde(default, deserialize_with = "crate::io::arrays::optional_array")]
    pub by: Option<[f64; 3]>,
    /// Where to, in the mesh's coordinates.
    #[serde(default, deserialize_with = "crate::io::arrays::optional_array")]
    pub to: Option<[f64; 3]>,
    /// Of a goal: how many vertices' handles it counts as; default 100.
    #[serde(default = "hundred")]
    pub weight: f64,
}

fn one() -> f64 {
    1.0
}

fn hundred() -> f64 {
    100.0
}

fn threshold() -> f64 {
    DEFAULT_THRESHOLD
}

fn pixels_per_mm() -> f64 {
    4.0
}

fn up() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

fn size() -> [usize; 2] {
    [1024, 1024]
}

/// Why a recipe cannot be read, or not be followed.
#[derive(Debug, thiserror::Error)]
pub enum RecipeError {
    /// The file, or one that it names, cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// What is written is not a recipe.
    #[error("{recipe}{}: {message}", line.map_or_else(String::new, |line| format!(": line {line}")))]
    Format {
        /// File or preset.
        recipe: String,
        /// Line, from 1, if one is to blame.
        line: Option<usize>,
        /// What is wrong.
        message: String,
    },
    /// It asks for something impossible on this mesh.
    #[error("{recipe}: line {line}: {error}")]
    Impossible {
        /// File or preset.
        recipe: String,
        /// Line of the step, mask or point.
        line: usize,
        /// What is impossible.
        error: MorphError,
    },
}

impl RecipeError {
    /// Whether the recipe, or what it is done to, is at fault, not the computation.
    #[must_use]
    pub fn is_input(&self) -> bool {
        if let Self::Impossible { error, .. } = self { error.is_input() } else { true }
    }
}

impl Recipe {
    /// Reads a recipe; files that it names are relative to its folder.
    ///
    /// # Errors
    /// When the file cannot be read or is not a recipe; the message names the line.
    pub fn read(path: &Path) -> Result<Self, RecipeError> {
        let text = read_text(path)?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        Self::parse(&text, Source { name: path.display().to_string(), folder })
    }

    /// A recipe from its text; `name` stands for it in messages.
    ///
    /// # Errors
    /// When it is not a recipe.
    pub fn from_text(text: &str, name: &str) -> Result<Self, RecipeError> {
        Self::parse(text, Source { name: name.to_owned(), folder: PathBuf::new() })
    }

    fn parse(text: &str, source: Source) -> Result<Self, RecipeError> {
        let line_ends: Vec<usize> = text.bytes().enumerate().filter(|(_, b)| *b == b'\n').map(|(at, _)| at).collect();
        let mut recipe: Self = toml::from_str(text).map_err(|error| RecipeError::Format {
            recipe: source.name.clone(),
            line: error.span().map(|span| line_of(&line_ends, span.start)),
            message: error.message().trim().replace('\n', ", "),
        })?;
        (recipe.source, recipe.line_ends) = (source, line_ends);
        recipe.check()?;
        Ok(recipe)
    }

    /// The line, from 1, on which something of the recipe begins.
    pub(super) fn line<T>(&self, part: &Spanned<T>) -> usize {
        line_of(&self.line_ends, part.span().start)
    }

    /// Every file that the recipe names: pictures and weights of masks.
    #[must_use]
    pub fn files(&self) -> Vec<PathBuf> {
        let masks = self
            .step
            .iter()
            .map(Spanned::get_ref)
            .flat_map(|step| step.mask.iter().chain(&step.protect))
            .map(Spanned::get_ref);
        masks.flat_map(|mask| mask.png.iter().chain(&mask.weights)).map(|path| self.file(path)).collect()
    }

    /// A file that the recipe names.
    pub(super) fn file(&self, path: &Path) -> PathBuf {
        self.source.folder.join(path)
    }

    /// What to warn of before it is done with an amount (its own if none is given) and a model in place of every step's: an amount
    /// that it is not made for, and keys without effect.
    #[must_use]
    pub fn doubts(&self, amount: Option<f64>, model: Option<MorphModel>) -> Vec<String> {
        let name = &self.source.name;
        let amount = amount.unwrap_or(self.amount);
        let mut doubts = Vec::new();
        if let Some([low, high]) = self.range.filter(|[low, high]| !(*low..=*high).contains(&amount)) {
            doubts.push(format!("{name} is made for amounts from {low} to {high}, not {amount}: look at the folds"));
        }
        let mut no_effect = |line: usize, key: &str, why: String| {
            doubts.push(format!("{name}: line {line}: {key} has no effect: {why}"));
        };
        for step in &self.step {
            let s = step.get_ref();
            let model = model.unwrap_or(s.model);
            for key in s.energy.without_effect(model) {
                no_effect(self.line(step), key, format!("model {} does not use it", model.name()));
            }
            for mask in s.mask.iter().chain(&s.protect) {
                for (key, why) in mask.get_ref().without_effect() {
                    no_effect(self.line(mask), key, why.to_owned());
                }
            }
            for pin in s.pin.iter().filter(|pin| pin.get_ref().weight != hundred()) {
                no_effect(self.line(pin), "weight", "a pin holds exactly".to_owned());
            }
        }
        doubts
    }

    /// The error at a part of the recipe.
    pub(super) fn impossible<T>(&self, part: &Spanned<T>, error: impl Into<MorphError>) -> RecipeError {
        RecipeError::Impossible { recipe: self.source.name.clone(), line: self.line(part), error: error.into() }
    }

    /// What does not depend on a mesh.
    fn check(&self) -> Result<(), RecipeError> {
        let fail = |line: Option<usize>, message: String| {
            Err(RecipeError::Format { recipe: self.source.name.clone(), line, message })
        };
        if self.step.is_empty() {
            return fail(None, "a recipe without steps: expected [[step]]".to_owned());
        }
        if !self.amount.is_finite() {
            return fail(None, format!("the amount is {}, expected a number", self.amount));
        }
        if let Some([low, high]) = self.range.filter(|[low, high]| low.is_nan() || high.is_nan() || low > high) {
            return fail(None, format!("the range is {low} to {high}, expected the least amount and then the most"));
        }
        for step in &self.step {
            let line = Some(self.line(step));
            let s = step.get_ref();
            if !s.amount.is_finite() {
                return fail(line, format!("the step's amount is {}, expected a number", s.amount));
            }
            if s.mask.is_empty() {
                return fail(line, "a step without masks: nothing may move".to_owned());
            }
            let drawn = |mask: &MaskSpec| {
                [mask.region.is_some(), mask.png.is_some(), mask.weights.is_some(), !mask.parts.is_empty()]
                    .into_iter()
                    .filter(|given| *given)
                    .count()
            };
            for mask in s.mask.iter().chain(&s.protect) {
                if drawn(mask.get_ref()) != 1 {
                    let message = "a mask is one of region, png, weights and parts";
                    return fail(Some(self.line(mask)), message.to_owned());
                }
                if let Some(d) = mask.get_ref().displacement.filter(|d| !d.iter().all(|c| c.is_finite())) {
                    return fail(Some(self.line(mask)), format!("the displacement is {d:?}, expected finite numbers"));
                }
            }
            if let Some(protect) = s.protect.iter().find(|p| p.get_ref().displacement.is_some()) {
                return fail(Some(self.line(protect)), "what is protected has no displacement".to_owned());
            }
            for point in s.pin.iter().chain(&s.goal) {
                let p = point.get_ref();
                if p.landmark.is_some() == p.vertex.is_some() || p.by.is_some() == p.to.is_some() {
                    let message = "a point has one of landmark and vertex, and one of by and to";
                    return fail(Some(self.line(point)), message.to_owned());
                }
            }
        }
        Ok(())
    }
}

fn line_of(line_ends: &[usize], byte: usize) -> usize {
    line_ends.partition_point(|end| *end < byte) + 1
}
