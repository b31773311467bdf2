//! Recipes at work: masks from what a recipe says, one step after the other.

use serde::Serialize;
use toml::Spanned;

use super::change::{TORN, Unmoved};
use super::{
    Blur, Constraints, Coordinates, EnergyOptions, EnergyReport, FrameSpec, LandmarkFrame, MaskSpec,
    MaskedDisplacement, MorphChange, MorphEnergy, MorphError, MorphModel, MorphStep, PlacedPoint, PointSpec, Projector,
    Recipe, RecipeError, RecipeStep, Texture, ViewSpec, Weights, uv_weights,
};
use crate::landmark::TemplatePoint;
use crate::mesh::adjacency::middle_of_parts;
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};
use crate::render::Projection;
use crate::rig::{Regions, ShapeBasis};

/// What a recipe is done to.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// The mesh, millimetres.
    pub mesh: &'a PolygonMesh,
    /// Names and places of landmarks; masks drawn in the frame of landmarks need those that the frame names.
    pub landmarks: &'a [(String, TemplatePoint)],
    /// Parts by name.
    pub regions: &'a Regions,
    /// For models that use them; bounds hold.
    pub shapes: &'a ShapeBasis,
}

/// How much of a recipe, and how strongly.
#[derive(Debug, Clone, Copy, Default)]
pub struct ReplayOptions {
    /// In place of the recipe's amount.
    pub amount: Option<f64>,
    /// Only so many of the steps.
    pub until: Option<usize>,
    /// In place of every step's model.
    pub model: Option<MorphModel>,
}

/// A mask as it met the mesh.
#[derive(Debug, Clone)]
pub struct DrawnMask {
    /// Its name in the recipe.
    pub name: String,
    /// Blurred; `None` if the recipe gives weights or parts.
    pub texture: Option<Texture>,
    /// Of every vertex, what is protected taken out; with its mirror image, the larger of the two.
    pub weights: Weights,
}

/// What a step did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepReport {
    /// Its name in the recipe.
    pub step: String,
    /// The model.
    pub model: MorphModel,
    /// Vertices that could move.
    pub moving: usize,
    /// Longest displacement that a mask, or masks together where they overlap, ask for, millimetres.
    pub asked: f64,
    /// What it did to the mesh.
    #[serde(flatten)]
    pub change: MorphChange,
    /// Of models with an energy.
    pub energy: Option<EnergyReport>,
}

impl StepReport {
    /// What is wrong with the step's surface or its energy, in words.
    #[must_use]
    pub fn doubts(&self) -> Vec<String> {
        let MorphChange { folded, stretch, .. } = &self.change;
        let triangles = if *folded == 1 { "triangle" } else { "triangles" };
        let torn = [
            (*folded > 0).then(|| format!("folds {folded} {triangles}")),
            (stretch.max > TORN).then(|| format!("draws edges to {:.1} times their length", stretch.max)),
        ];
        let torn: Vec<String> = torn.into_iter().flatten().collect();
        let torn = (!torn.is_empty()).then(|| format!("{}: move less, or blur the mask more", torn.join(" and ")));
        let unsettled = self.energy.as_ref().filter(|energy| !energy.settled).map(|energy| {
            let steps = energy.iterations;
            format!("ended after {steps} steps before its energy had settled: raise max_iterations of its energy")
        });
        torn.into_iter().chain(unsettled).collect()
    }
}

/// A step's outcome.
#[derive(Debug, Clone)]
pub struct StepOutcome {
    /// Its masks.
    pub masks: Vec<DrawnMask>,
    /// How much of each vertex is protected, 0 to 1.
    pub protected: Vec<f64>,
    /// All positions after the step.
    pub positions: Vec<Vec3>,
    /// What it did.
    pub report: StepReport,
}

impl StepOutcome {
    /// The largest weight of each vertex over all masks: `G` of an overlay.
    #[must_use]
    pub fn coverage(&self) -> Vec<f64> {
        let vertices = self.positions.len();
        let of = |v: usize| self.masks.iter().map(|mask| mask.weights.values()[v]).fold(0.0, f64::max);
        (0..vertices).map(of).collect()
    }
}

/// Follows a recipe.
///
/// # Errors
/// When something that it names is missing or malformed, or a step is impossible on this mesh; the message names the line.
pub fn replay(
    recipe: &Recipe,
    subject: &Subject<'_>,
    options: &ReplayOptions,
) -> Result<Vec<StepOutcome>, RecipeError> {
    let mut positions = subject.mesh.positions.clone();
    let amount = options.amount.unwrap_or(recipe.amount);
    let mut outcomes = Vec::new();
    let first = subject.shapes.seams(&subject.mesh.triangulate());
    for step in recipe.step.iter().take(options.until.unwrap_or(usize::MAX)) {
        let mesh = subject.mesh.with_positions(positions);
        let amount = amount * step.get_ref().amount;
        let stage = Stage { recipe, subject, first: &first, amount, triangles: mesh.triangulate(), mesh: &mesh, step };
        let outcome = stage.run(options.model.unwrap_or(step.get_ref().model))?;
        positions = outcome.positions.clone();
        outcomes.push(outcome);
    }
    Ok(outcomes)
}

/// A step that is done again and again with other displacements, as while a handle is dragged: masks are drawn, and the energy is
/// built, once. A solution starts from the one before, so that it is that of [`replay`] only as closely as the energy's tolerance says.
pub struct LiveStep {
    unmoved: Unmoved,
    model: MorphModel,
    drawn: Drawn,
    energy: Option<MorphEnergy>,
}

impl LiveStep {
    /// The first step of a recipe on a subject; none if it has no step. A solution takes at most `iterations` of the minimiser: a drag
    /// comes near its minimum over several.
    ///
    /// # Errors
    /// As [`replay`].
    pub fn new(recipe: &Recipe, subject: &Subject<'_>, iterations: usize) -> Result<Option<Self>, RecipeError> {
        let Some(step) = recipe.step.first() else { return Ok(None) };
        let amount = recipe.amount * step.get_ref().amount;
        let (mesh, model) = (subject.mesh, step.get_ref().model);
        let triangles = mesh.triangulate();
        let first = &subject.shapes.seams(&triangles);
        let stage = Stage { recipe, subject, first, amount, triangles, mesh, step };
        let drawn = stage.drawn()?;
        let options = step.get_ref().energy;
        let options = EnergyOptions { max_iterations: options.max_iterations.min(iterations), ..options };
        let energy = stage.energy(model, &drawn, &options)?;
        let unmoved = Unmoved::new(mesh).map_err(|error| recipe.impossible(stage.step, error))?;
        Ok(Some(Self { unmoved, model, drawn, energy }))
    }

    /// The step with the displacements of the masks and the amounts of a recipe that is otherwise the one it was made of; the amount
    /// of what pins and goals ask for stays what it was.
    ///
    /// # Errors
    /// When a displacement is not finite, the minimiser fails, or a pin is out of the model's reach.
    ///
    /// # Panics
    /// If the recipe has no step, or not the masks that it had.
    pub fn solve(&mut self, recipe: &Recipe) -> Result<StepOutcome, RecipeError> {
        let at_step = |error: MorphError| recipe.impossible(&recipe.step[0], error);
        let step = recipe.step[0].get_ref();
        let amount = recipe.amount * step.amount;
        let Self { unmoved, model, drawn, energy } = self;
        for (k, pair) in drawn.pair_of.iter().enumerate() {
            let asked = step.mask[pair.mask].get_ref().displacement.unwrap_or_default();
            let asked = vector(asked, drawn.frame.as_ref(), amount);
            let displacement = pair.displacement(asked, drawn.frame.as_ref());
            drawn.morph.pairs[k].displacement = displacement;
            if let Some(energy) = energy {
                energy.set_displacement(k, displacement).map_err(at_step)?;
            }
        }
        let (positions, energy) = match energy {
            None => (drawn.morph.apply(&unmoved.positions).map_err(at_step)?, None),
            Some(energy) => {
                let (positions, report) = energy.solve().map_err(at_step)?;
                (positions, Some(report))
            }
        };
        let change = unmoved.change(&positions).map_err(at_step)?;
        let report = drawn.report(step.name.clone(), *model, change, positions.len(), energy).map_err(at_step)?;
        Ok(StepOutcome { masks: drawn.masks.clone(), protected: drawn.protected.clone(), positions, report })
    }
}

/// A step's masks on a mesh.
struct Drawn {
    morph: MorphStep,
    constraints: Constraints,
    masks: Vec<DrawnMask>,
    protected: Vec<f64>,
    /// Where each pair of `morph` comes from.
    pair_of: Vec<PairOf>,
    frame: Option<LandmarkFrame>,
}

/// A mask of a step, or its mirror image.
struct PairOf {
    mask: usize,
    mirrored: bool,
}

impl PairOf {
    /// The displacement of a mask, reflected if this is its mirror image.
    fn displacement(&self, of_mask: Vec3, frame: Option<&LandmarkFrame>) -> Vec3 {
        let plane = frame.filter(|_| self.mirrored).map(LandmarkFrame::mirror_plane);
        plane.map_or(of_mask, |plane| plane.reflect_direction(of_mask))
    }
}

impl Drawn {
    fn report(
        &self,
        step: String,
        model: MorphModel,
        change: MorphChange,
        vertices: usize,
        energy: Option<EnergyReport>,
    ) -> Result<StepReport, MorphError> {
        let Self { morph, constraints, .. } = self;
        let free = |v: usize| constraints.free.iter().any(|w| w.values()[v] > morph.threshold);
        let moves = morph.moves(vertices)?;
        let together = |v: usize| -> f64 {
            let pulls = morph.pairs.iter().map(|pair| (pair.weights.values()[v], pair.displacement));
            pulls.filter(|(w, _)| *w > morph.threshold).map(|(w, d)| d * w).sum::<Vec3>().norm()
        };
        let alone = morph.pairs.iter().map(|pair| pair.displacement.norm());
        Ok(StepReport {
            step,
            model,
            moving: (0..vertices).filter(|v| moves[*v] || free(*v)).count(),
            asked: alone.chain((0..vertices).map(together)).fold(0.0, f64::max),
            change,
            energy,
        })
    }
}

/// A vector given in the frame, or in the mesh's axes where there is none, times an amount.
fn vector(d: [f64; 3], frame: Option<&LandmarkFrame>, amount: f64) -> Vec3 {
    frame.map_or_else(|| Vec3::from(d), |frame| frame.direction(d)) * amount
}

/// A step on the mesh as the one before has left it.
struct Stage<'a> {
    recipe: &'a Recipe,
    subject: &'a Subject<'a>,
    /// Of each vertex the first that is the same point, along [seams](ShapeBasis::seams). A mask takes all that it takes one of, so that
    /// the surface stays whole.
    first: &'a [u32],
    amount: f64,
    mesh: &'a PolygonMesh,
    triangles: TriangleMesh,
    step: &'a Spanned<RecipeStep>,
}

impl Stage<'_> {
    fn run(&self, model: MorphModel) -> Result<StepOutcome, RecipeError> {
        let drawn = self.drawn()?;
        let energy = self.energy(model, &drawn, &self.step.get_ref().energy)?;
        let at_step = |error: MorphError| self.recipe.impossible(self.step, error);
        let (positions, energy) = match energy {
            None => (drawn.morph.apply(&self.mesh.positions).map_err(at_step)?, None),
            Some(mut energy) => {
                let (positions, report) = energy.solve().map_err(at_step)?;
                (positions, Some(report))
            }
        };
        let name = self.step.get_ref().name.clone();
        let change = MorphChange::of(self.mesh, &positions).map_err(at_step)?;
        let report = drawn.report(name, model, change, positions.len(), energy).map_err(at_step)?;
        Ok(StepOutcome { masks: drawn.masks, protected: drawn.protected, positions, report })
    }

    /// The step's masks on the mesh.
    fn drawn(&self) -> Result<Drawn, RecipeError> {
        let step = self.step.get_ref();
        let at_step = |error: MorphError| self.recipe.impossible(self.step, error);
        let frame = step.frame.as_ref().or(self.recipe.frame.as_ref());
        let frame = frame.map(|spec| self.frame(spec)).transpose().map_err(at_step)?;
        let mut protected = vec![0.0; self.mesh.positions.len()];
        for spec in &step.protect {
            for weights in self.draw(spec, Blur { iterations: 0, ..Blur::default() }, frame.as_ref())?.1 {
                protected.iter_mut().zip(weights.values()).for_each(|(p, w): (&mut f64, _)| *p = p.max(*w));
            }
        }
        let mut morph = MorphStep { threshold: step.threshold, ..MorphStep::default() };
        let mut constraints = Constraints::default();
        let mut masks = Vec::new();
        let mut pair_of = Vec::new();
        for (place, spec) in step.mask.iter().enumerate() {
            let mask = spec.get_ref();
            let (texture, drawn) = self.draw(spec, Blur::default(), frame.as_ref())?;
            let drawn: Vec<Weights> = drawn.iter().map(|weights| weights.without(&protected)).collect();
            let displacement = mask.displacement.map(|d| self.vector(d, frame.as_ref()));
            let pulling = match &drawn[..] {
                [mask, mirrored] => Weights::shared([mask, mirrored]).to_vec(),
                _ => drawn.clone(),
            };
            for (k, weights) in pulling.into_iter().enumerate() {
                match displacement {
                    None => constraints.free.push(weights),
                    Some(displacement) => {
                        let pair = PairOf { mask: place, mirrored: k == 1 };
                        let displacement = pair.displacement(displacement, frame.as_ref());
                        morph.pairs.push(MaskedDisplacement { weights, displacement });
                        pair_of.push(pair);
                    }
                }
            }
            let weights = drawn.into_iter().reduce(|a, b| a.or(&b)).expect("proven: a mask is drawn at least once");
            masks.push(DrawnMask { name: mask.name.clone(), texture, weights });
        }
        constraints.pins = step.pin.iter().map(|pin| self.point(pin, frame.as_ref())).collect::<Result<_, _>>()?;
        let goal = |goal| Ok((self.point(goal, frame.as_ref())?, goal.get_ref().weight));
        constraints.goals = step.goal.iter().map(goal).collect::<Result<_, RecipeError>>()?;

        Ok(Drawn { morph, constraints, masks, protected, pair_of, frame })
    }

    /// The step's energy; none of the direct model.
    fn energy(
        &self,
        model: MorphModel,
        drawn: &Drawn,
        options: &EnergyOptions,
    ) -> Result<Option<MorphEnergy>, RecipeError> {
        let Drawn { morph, constraints, .. } = drawn;
        let at_step = |error: MorphError| self.recipe.impossible(self.step, error);
        if model == MorphModel::Direct {
            if *constraints != Constraints::default() {
                return Err(at_step(MorphError::NoEnergy));
            }
            if !morph.moves(self.mesh.positions.len()).map_err(at_step)?.contains(&true) {
                return Err(at_step(MorphError::NothingMoves));
            }
            return Ok(None);
        }
        let energy = MorphEnergy::new(&self.triangles, morph, constraints, model, self.subject.shapes, options);
        energy.map(Some).map_err(at_step)
    }

    fn frame(&self, spec: &FrameSpec) -> Result<LandmarkFrame, MorphError> {
        let places: Vec<(String, Vec3)> = self.places().collect();
        let frame = LandmarkFrame::new(spec, &places)?;
        // Landmarks lie on the front of a face, whose middle is behind them.
        let landmarks = places.iter().map(|p| p.1).sum::<Vec3>() / places.len() as f64;
        let corners = self.subject.landmarks.iter().flat_map(|(_, point)| point.corners());
        let front = landmarks - middle_of_parts(&self.triangles, corners.map(|c| c.0));
        if frame.axes()[2].dot(&front) < 0.0 { Err(MorphError::Mirrored) } else { Ok(frame) }
    }

    /// Every landmark where it is now.
    fn places(&self) -> impl Iterator<Item = (String, Vec3)> + '_ {
        let positions = &self.mesh.positions;
        self.subject.landmarks.iter().map(|(name, point)| (name.clone(), point.position(positions)))
    }

    fn landmark(&self, name: &str) -> Result<TemplatePoint, MorphError> {
        let found = self.subject.landmarks.iter().find(|(known, _)| known == name);
        let known = self.subject.landmarks.iter().map(|(name, _)| name.as_str());
        found.map(|(_, point)| *point).ok_or_else(|| MorphError::unknown_landmark(name, known))
    }

    fn vector(&self, d: [f64; 3], frame: Option<&LandmarkFrame>) -> Vec3 {
        vector(d, frame, self.amount)
    }

    fn point(&self, spec: &Spanned<PointSpec>, frame: Option<&LandmarkFrame>) -> Result<PlacedPoint, RecipeError> {
        let p = spec.get_ref();
        let vertices = self.mesh.positions.len();
        let (name, point) = match (&p.landmark, p.vertex) {
            (Some(name), _) => {
                (name.clone(), self.landmark(name).map_err(|error| self.recipe.impossible(spec, error))?)
            }
            (None, vertex) => {
                let vertex = vertex.unwrap_or(u32::MAX);
                if vertex as usize >= vertices {
                    let error = format!("there are {vertices} vertices");
                    let error = MorphError::Point { name: format!("vertex {vertex}"), error };
                    return Err(self.recipe.impossible(spec, error));
                }
                (format!("vertex {vertex}"), TemplatePoint::Vertex(vertex))
            }
        };
        let from = point.position(&self.mesh.positions);
        let by = || from + self.vector(p.by.unwrap_or_default(), frame);
        Ok(PlacedPoint { name, point, target: p.to.map_or_else(by, Vec3::from) })
    }

    /// The texture of a mask, blurred as usual unless it says how, if it has one, and its weights, then those of its mirror image, if it has one.
    fn draw(
        &self,
        spec: &Spanned<MaskSpec>,
        usual: Blur,
        frame: Option<&LandmarkFrame>,
    ) -> Result<(Option<Texture>, Vec<Weights>), RecipeError> {
        let mask = spec.get_ref();
        let blur = mask.blur.unwrap_or(usual);
        let fail = |error: MorphError| self.recipe.impossible(spec, error);
        let project = |projector: &Projector, texture: &Texture| {
            projector.weights(&self.triangles, texture, mask.sampling, mask.visibility)
        };
        let (texture, projector, weights) = if let Some(path) = &mask.weights {
            (None, None, Weights::read_npy(&self.recipe.file(path), self.mesh.positions.len())?)
        } else if !mask.parts.is_empty() {
            let weights = self.subject.regions.mask(&mask.parts).map_err(|e| fail(MorphError::Parts(e.to_string())))?;
            (None, None, Weights::new(weights).map_err(fail)?)
        } else {
            let picture = mask.png.as_ref().map(|path| Texture::read_png(&self.recipe.file(path), mask.grey));
            let Drawing { texture, projector } =
                self.drawing(mask, &blur, picture.transpose()?, frame).map_err(fail)?;
            let texture = blur.apply(&texture).map_err(fail)?;
            let weights = match &projector {
                Some(projector) => project(projector, &texture),
                None => uv_weights(self.mesh, &texture, mask.sampling),
            };
            (Some(texture), projector, weights.map_err(fail)?)
        };
        let mut all = vec![weights.together(self.first)];
        if mask.mirror {
            let plane = frame.ok_or_else(|| fail(MorphError::NoFrame))?.mirror_plane();
            let mirrored = match (&projector, &texture) {
                (Some(projector), Some(texture)) => project(&projector.mirrored(&plane), texture),
                _ => all[0].mirrored(&self.triangles, &plane),
            };
            all.push(mirrored.map_err(fail)?.together(self.first));
        }
        Ok((texture, all))
    }

    /// The texture before it is blurred, and how it meets the mesh.
    fn drawing(
        &self,
        mask: &MaskSpec,
        blur: &Blur,
        picture: Option<Texture>,
        frame: Option<&LandmarkFrame>,
    ) -> Result<Drawing, MorphError> {
        let drawn = |[width, height]: [usize; 2], coordinates| match (picture.clone(), &mask.region) {
            (Some(picture), _) => Ok(picture),
            (None, Some(region)) => region.rasterize(width, height, coordinates),
            (None, None) => Err(MorphError::NothingMoves),
        };
        match &mask.view {
            ViewSpec::Uv { size } => Ok(Drawing { texture: drawn(*size, Coordinates::Unit)?, projector: None }),
            ViewSpec::Camera { eye, target, up, vertical_fov, height, size } => {
                let texture = drawn(*size, Coordinates::Pixels)?;
                let projection = match height {
                    Some(height) => Projection::Orthographic { height: *height },
                    None => Projection::Perspective { vertical_fov: vertical_fov.unwrap_or(30.0) },
                };
                let aspect = texture.width() as f64 / texture.height() as f64;
                let [eye, target, up] = [eye, target, up].map(|p| Vec3::from(*p));
                Ok(Drawing { texture, projector: Some(Projector::look(eye, target, up, projection, aspect)?) })
            }
            ViewSpec::Frame { yaw, pitch, pixels_per_mm, covers } => {
                if !(*pixels_per_mm > 0.0 && pixels_per_mm.is_finite()) {
                    let what = "the number of pixels to a millimetre";
                    return Err(MorphError::Option { what, value: *pixels_per_mm, expected: "above 0" });
                }
                let frame = frame.ok_or(MorphError::NoFrame)?.turned(*yaw, *pitch);
                let frame = if mask.at.is_empty() { frame } else { frame.at(self.mean(&mask.at)?) };
                let [low, high] = match (covers, &mask.region) {
                    (Some(covers), _) => *covers,
                    (None, Some(region)) => {
                        let margin = MARGIN * blur.deviation() / pixels_per_mm + 2.0 / pixels_per_mm;
                        let [low, high] = region.bounds();
                        [low.map(|c| c - margin), high.map(|c| c + margin)]
                    }
                    (None, None) => return Err(MorphError::NoCover),
                };
                let side = |k: usize| ((high[k] - low[k]) * pixels_per_mm).ceil().max(1.0) as usize;
                let texture = drawn([side(0), side(1)], Coordinates::Box { low, high })?;
                Ok(Drawing { texture, projector: Some(frame.projector(low, high)?) })
            }
        }
    }

    fn mean(&self, names: &[String]) -> Result<Vec3, MorphError> {
        let place = |name: &String| Ok(self.landmark(name)?.position(&self.mesh.positions));
        let places = names.iter().map(place).collect::<Result<Vec<_>, MorphError>>()?;
        Ok(places.iter().sum::<Vec3>() / places.len() as f64)
    }
}

/// Standard deviations of a blur beyond which nothing of a region is left: exp(-8) is below any threshold of interest.
const MARGIN: f64 = 4.0;

/// A texture, and its projector unless it lies in texture coordinates.
struct Drawing {
    texture: Texture,
    projector: Option<Projector>,
}
