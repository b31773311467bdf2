//! Recipes and presets: what they say, what they do, and how they say what is wrong.

use std::path::Path;
use std::sync::LazyLock;

use crate::threads::on_threads;
use data_gen::{FaceOptions, FaceRig};
use nonrigid::io::read_polygon_mesh;
use nonrigid::landmark::TemplatePoint;
use nonrigid::landmark::read_template_landmarks;
use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::morph::*;
use nonrigid::registration::ModelKind;
use nonrigid::rig::{Regions, ShapeBasis};

struct Face {
    mesh: PolygonMesh,
    landmarks: Vec<(String, TemplatePoint)>,
    regions: Regions,
    shapes: ShapeBasis,
}

impl Face {
    fn generated(vertices: usize, identity: &[f64]) -> Self {
        let rig = FaceRig::generate(&FaceOptions { vertices, identity_modes: 20 });
        let landmarks =
            rig.landmarks.iter().enumerate().map(|(k, l)| (k.to_string(), TemplatePoint::Vertex(l.vertex))).collect();
        Self::new(rig.mesh.with_positions(rig.pose(&[], identity)), landmarks)
    }

    fn new(mesh: PolygonMesh, landmarks: Vec<(String, TemplatePoint)>) -> Self {
        Self { regions: Regions::of_groups(&mesh), mesh, landmarks, shapes: ShapeBasis::none() }
    }

    fn subject(&self) -> Subject<'_> {
        Subject { mesh: &self.mesh, landmarks: &self.landmarks, regions: &self.regions, shapes: &self.shapes }
    }

    fn replay(&self, recipe: &Recipe, options: ReplayOptions) -> Result<Vec<StepOutcome>, RecipeError> {
        replay(recipe, &self.subject(), &options)
    }

    fn morph(&self, recipe: &str) -> Vec<StepOutcome> {
        let recipe = Recipe::from_text(&format!("{FRAME}{recipe}"), "test").unwrap();
        self.replay(&recipe, ReplayOptions::default()).unwrap()
    }

    /// That of [`FRAME`].
    fn frame(&self) -> LandmarkFrame {
        let names = |names: [&str; 2]| names.map(str::to_owned);
        let (right, up) = (names(["36", "45"]), names(["8", "27"]));
        let spec = FrameSpec { origin: vec!["30".to_owned()], right, up, scale: None };
        let places = self.landmarks.iter().map(|(name, point)| (name.clone(), point.position(&self.mesh.positions)));
        LandmarkFrame::new(&spec, &places.collect::<Vec<_>>()).unwrap()
    }

    fn place(&self, landmark: usize) -> Vec3 {
        self.landmarks[landmark].1.position(&self.mesh.positions)
    }

    fn vertex(&self, landmark: usize) -> usize {
        match self.landmarks[landmark].1 {
            TemplatePoint::Vertex(v) => v as usize,
            TemplatePoint::Face { .. } => unreachable!("landmarks of these faces are vertices"),
        }
    }
}

const FRAME: &str = "frame = { origin = [\"30\"], right = [\"36\", \"45\"], up = [\"8\", \"27\"] }\n";

static FACE: LazyLock<Face> = LazyLock::new(|| Face::generated(3000, &[]));

/// Every polygon with vertices of its own, and whose vertex each of them is.
fn cut(face: &Face) -> (Face, Vec<u32>) {
    let of = face.mesh.corners.clone();
    let positions = of.iter().map(|&v| face.mesh.positions[v as usize]).collect();
    let mesh = PolygonMesh { positions, corners: (0..of.len() as u32).collect(), ..face.mesh.clone() };
    let vertex = |point: &TemplatePoint| match point {
        TemplatePoint::Vertex(v) => TemplatePoint::Vertex(of.iter().position(|w| w == v).unwrap() as u32),
        other => *other,
    };
    let landmarks = face.landmarks.iter().map(|(name, point)| (name.clone(), vertex(point))).collect();
    (Face::new(mesh, landmarks), of)
}

#[test]
fn a_mesh_that_was_cut_moves_as_the_whole_one() {
    let (cut, of) = cut(&FACE);
    for model in ["direct", "arap"] {
        let recipe = format!(
            "[[step]]\nmodel = \"{model}\"\nmask = [{{ parts = [\"nose\", \"cheeks\"], displacement = [0, 0, 4] }}]\n\
             protect = [{{ parts = [\"cheeks\"] }}]\n"
        );
        let [one, other] = [&FACE, &cut].map(|face| face.morph(&recipe).pop().unwrap());
        let apart = (0..of.len()).map(|v| (other.positions[v] - one.positions[of[v] as usize]).norm());
        let apart = apart.fold(0.0, f64::max);
        assert!(apart < 1e-6, "{model}: {apart} mm");
        let moved = |v: usize| other.positions[v] != cut.mesh.positions[v];
        assert!(
            (0..of.len()).any(moved) && !cut.regions.vertices("cheeks").unwrap().iter().any(|&v| moved(v as usize))
        );
        assert!((one.report.change.largest_jump - other.report.change.largest_jump).abs() < 1e-6, "{model}");
    }
}

fn presets() -> impl Iterator<Item = (&'static str, Recipe)> {
    preset_names().into_iter().map(|name| (name, preset(name).unwrap().unwrap()))
}

#[test]
fn presets_fold_nothing_and_reach_what_they_are_asked_for() {
    let person: Vec<f64> = (0..20).map(|k| 1.5 * ((k * k) as f64).sin()).collect();
    for face in [Face::generated(2000, &[]), Face::generated(8000, &person)] {
        check_presets(&face);
    }
}

#[test]
fn presets_run_unchanged_on_a_real_rig() {
    let Some(folder) = crate::real_data::real_data("ict-facekit/narrow") else { return };
    let mesh = read_polygon_mesh(&folder.join("template.obj")).unwrap();
    let landmarks = read_template_landmarks(&folder.join("landmarks_multipie68.json"), &mesh).unwrap();
    check_presets(&Face::new(mesh, landmarks));
}

/// At the default amount and at the ends of each preset's range.
fn check_presets(face: &Face) {
    for (name, recipe) in presets() {
        let range = recipe.range.unwrap();
        assert!(range[0] <= recipe.amount && recipe.amount <= range[1] && !recipe.about.is_empty(), "{name}");
        for amount in [range[0], recipe.amount, range[1]] {
            let outcome = face.replay(&recipe, ReplayOptions { amount: Some(amount), ..ReplayOptions::default() });
            let report = &outcome.unwrap()[0].report;
            assert_eq!(report.change.folded, 0, "{name} {amount}");
            let asked = amount.abs();
            approx::assert_relative_eq!(report.asked, asked, max_relative = 0.01);
            assert!(
                report.change.reached > 0.9 * asked && report.change.reached < 1.01 * asked,
                "{name} {amount}: {report:?}"
            );
            assert!(report.change.stretch.min > 0.3 && report.change.stretch.max < 2.0, "{name} {amount}: {report:?}");
        }
    }
}

#[test]
fn presets_of_both_sides_keep_a_symmetric_face_symmetric() {
    let face = &*FACE;
    let key = |p: &Vec3| [(p.x.abs() * 1e4).round(), (p.y * 1e4).round(), (p.z * 1e4).round()].map(|c| c as i64);
    let twins = |positions: &[Vec3]| {
        let count = |sign: f64| {
            let mut keys: Vec<_> = positions.iter().filter(|p| p.x * sign > 1e-3).map(key).collect();
            keys.sort_unstable();
            keys
        };
        let (left, right) = (count(1.0), count(-1.0));
        left.iter().filter(|k| right.binary_search(k).is_err()).count() as f64 / left.len() as f64
    };
    assert!(twins(&face.mesh.positions) < 0.01, "the face is its own mirror image");
    for (name, recipe) in presets() {
        let after = face.replay(&recipe, ReplayOptions::default()).unwrap().remove(0).positions;
        assert!(twins(&after) < 0.02, "{name}: {}", twins(&after));
    }
}

#[test]
fn a_recipe_replayed_gives_the_same_bits_and_until_stops_early() {
    let face = &*FACE;
    let text = format!("{FRAME}{STEP}{STEP}model = \"arap\"\n").replace("model", "#");
    let recipe = Recipe::from_text(&text, "test").unwrap();
    let options = ReplayOptions { model: Some(MorphModel::Energy(ModelKind::Arap)), ..ReplayOptions::default() };
    let [a, b, c] = [1, 2, 2].map(|threads| on_threads(threads, || face.replay(&recipe, options).unwrap()));
    for k in 0..2 {
        assert_eq!((&a[k].positions, &a[k].report), (&b[k].positions, &b[k].report));
        assert_eq!(b[k].positions, c[k].positions);
    }
    assert_ne!(a[0].positions, a[1].positions);
    let first = face.replay(&recipe, ReplayOptions { until: Some(1), ..options }).unwrap();
    assert_eq!((first.len(), &first[0].positions), (1, &a[0].positions));
}

#[test]
fn a_dragged_step_ends_where_it_would_have_from_rest() {
    let face = &*FACE;
    let text = |model: &str, amount: f64, [x, z]: [f64; 2]| {
        format!(
            "{FRAME}amount = {amount:?}\n[[step]]\nmodel = \"{model}\"\n[[step.mask]]\nmirror = true\n\
             region = {{ circle = {{ centre = [20, 0], radius = 14 }} }}\nblur = {{ iterations = 4 }}\ndisplacement = [{x:?}, 0, {z:?}]\n"
        )
    };
    for model in ["direct", "free", "arap", "graph"] {
        let recipe = |amount, by| Recipe::from_text(&text(model, amount, by), "test").unwrap();
        let whole = |recipe: &Recipe| face.replay(recipe, ReplayOptions::default()).unwrap().remove(0);
        let first = recipe(1.0, [0.0, 2.0]);
        let mut live = LiveStep::new(&first, &face.subject(), usize::MAX).unwrap().unwrap();
        let (a, b) = (live.solve(&first).unwrap(), whole(&first));
        assert_eq!((&a.positions, &a.report), (&b.positions, &b.report), "{model}: from rest it is the same");
        for (amount, by) in [(1.0, [1.0, 2.5]), (2.0, [1.0, 2.5]), (1.0, [-1.0, 0.5])] {
            let recipe = recipe(amount, by);
            let (dragged, whole) = (live.solve(&recipe).unwrap(), whole(&recipe));
            let apart = dragged.positions.iter().zip(&whole.positions).map(|(p, q)| (p - q).norm()).fold(0.0, f64::max);
            assert!(apart < 0.02, "{model} {by:?}: {apart} mm");
            assert_eq!((dragged.report.moving, dragged.report.asked), (whole.report.moving, whole.report.asked));
            assert_eq!(dragged.coverage(), whole.coverage());
        }
        // a few iterations at a time come to the same
        let mut live = LiveStep::new(&first, &face.subject(), 2).unwrap().unwrap();
        let apart = |outcome: StepOutcome| {
            let apart = outcome.positions.iter().zip(&b.positions).map(|(p, q)| (p - q).norm());
            (apart.fold(0.0, f64::max), outcome.report.energy.map_or(0, |e| e.iterations))
        };
        let ends: Vec<(f64, usize)> = (0..12).map(|_| apart(live.solve(&first).unwrap())).collect();
        assert!(ends.iter().all(|e| e.1 <= 2) && ends[11].0 < 0.02, "{model}: {ends:?}");
    }
}

const STEP: &str = "[[step]]\n[[step.mask]]\nregion = { circle = { centre = [0, 0], radius = 12 } }\n\
                    blur = { iterations = 4 }\ndisplacement = [0, 0, 2]\n";

#[test]
fn regions_lie_where_they_are_drawn() {
    let face = &*FACE;
    // About the tip, 12 mm to the subject's left: there G is 1; elsewhere, beyond blur and rim, 0.
    let outcome = &face.morph(
        "[[step]]\n[[step.mask]]\nregion = { circle = { centre = [12, 0], radius = 6 } }\nblur = { iterations = 0 }\n\
         visibility = \"through\"\ndisplacement = [1, 2, 3]\n",
    )[0];
    let frame = face.frame();
    let centre = frame.point([12.0, 0.0, 0.0]);
    let [x, y, _] = frame.axes();
    let mut moved = 0;
    for ((p, q), w) in face.mesh.positions.iter().zip(&outcome.positions).zip(outcome.masks[0].weights.values()) {
        let off = x.dot(&(p - centre)).hypot(y.dot(&(p - centre)));
        assert!(off > 5.5 || *w == 1.0, "{off}: {w}");
        assert!(off < 6.5 || *w == 0.0, "{off}: {w}");
        approx::assert_abs_diff_eq!(q - p, frame.direction([1.0, 2.0, 3.0]) * *w, epsilon = 1e-9);
        moved += usize::from(*w > 0.0);
    }
    assert_eq!(moved, outcome.report.moving);
    assert!(moved > 8);
}

#[test]
fn a_turned_view_sees_the_side() {
    // A circle of 15 mm seen from the subject's left, about the jaw: it reaches far in depth, and only on that side.
    let face = &*FACE;
    let outcome = &face.morph(
        "[[step]]\n[[step.mask]]\nat = [\"13\"]\nview = { frame = { yaw = 90 } }\nblur = { iterations = 0 }\n\
         region = { circle = { centre = [0, 0], radius = 15 } }\ndisplacement = [1, 0, 0]\n",
    )[0];
    let jaw = face.place(13);
    let lifted = outcome.masks[0].weights.values().iter().zip(&face.mesh.positions).filter(|(w, _)| **w == 1.0);
    let (mut count, mut deepest) = (0, 0.0f64);
    for (_, p) in lifted {
        assert!((p.z - jaw.z).hypot(p.y - jaw.y) < 15.5 && p.x > 0.0);
        (count, deepest) = (count + 1, deepest.max((p.z - jaw.z).abs()));
    }
    assert!(count > 10 && deepest > 10.0, "{count}, {deepest}");
}

#[test]
fn protected_parts_keep_their_bits_and_points_go_where_they_are_put() {
    let face = &*FACE;
    let text = "[[step]]\nmodel = \"arap\"\n[[step.mask]]\nregion = { circle = { centre = [0, 0], radius = 45 } }\n\
                displacement = [0, 0, 3]\n[[step.protect]]\nat = [\"51\", \"57\"]\nblur = { iterations = 0 }\n\
                region = { circle = { centre = [0, 0], radius = 10 } }\nvisibility = \"through\"\n\
                [[step.pin]]\nlandmark = \"30\"\nby = [0, 0, 1]\n[[step.goal]]\nlandmark = \"28\"\nby = [0, 0, 4]\nweight = 1000\n";
    let outcome = &face.morph(text)[0];
    let mouth = (face.place(51) + face.place(57)) * 0.5;
    for (p, q) in face.mesh.positions.iter().zip(&outcome.positions) {
        if (p.x - mouth.x).hypot(p.y - mouth.y) < 9.5 {
            assert_eq!(p, q);
        }
    }
    let moved = |landmark: usize| outcome.positions[face.vertex(landmark)] - face.place(landmark);
    let out = face.frame().axes()[2];
    approx::assert_abs_diff_eq!(moved(30), out, epsilon = 1e-9);
    assert!((moved(28) - out * 4.0).norm() < 0.5, "{:?}", moved(28));
    let report = outcome.report.energy.as_ref().unwrap();
    assert_eq!((report.model, report.moving), (MorphModel::Energy(ModelKind::Arap), outcome.report.moving));
    // A region of its own, without handles.
    let text = "[[step]]\nmodel = \"graph\"\n[[step.mask]]\nregion = { circle = { centre = [0, 0], radius = 20 } }\n\
                [[step.pin]]\nlandmark = \"30\"\nby = [0, 0, 2]\n";
    let outcome = &face.morph(text)[0];
    approx::assert_abs_diff_eq!(outcome.positions[face.vertex(30)], face.place(30) + out * 2.0, epsilon = 1e-9);
    assert!(outcome.positions[face.vertex(29)].z > face.place(29).z + 0.3);
}

#[test]
fn masks_come_from_pictures_files_texture_coordinates_and_cameras() {
    let face = &*FACE;
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let run = |path: &Path| face.replay(&Recipe::read(path).unwrap(), ReplayOptions::default());
    let drawn = &face.morph(STEP)[0];
    drawn.masks[0].weights.write_npy(&folder.path().join("w.npy")).unwrap();
    let step = "[[step]]\n[[step.mask]]\nblur = { iterations = 0 }\ndisplacement = [0, 0, 2]\n";
    let by_file = write("file.toml", &format!("{FRAME}{step}weights = \"w.npy\"\n"));
    assert_eq!(run(&by_file).unwrap()[0].positions, drawn.positions);

    // The picture of the drawing covers what the drawing did: 8 bits of it.
    let texture = drawn.masks[0].texture.clone().unwrap();
    texture.write_png(&folder.path().join("t.png")).unwrap();
    let side = texture.width() as f64 / 8.0;
    let covers = format!("view = {{ frame = {{ covers = [[-{side}, -{side}], [{side}, {side}]] }} }}");
    let by_picture = write("picture.toml", &format!("{FRAME}{step}png = \"t.png\"\n{covers}\n"));
    for (a, b) in run(&by_picture).unwrap()[0].positions.iter().zip(&drawn.positions) {
        approx::assert_abs_diff_eq!(*a, *b, epsilon = 0.02);
    }

    let camera = "view = { camera = { eye = [0, 0, 900], target = [0, 0, 0], height = 240, size = [480, 480] } }\n\
                  region = { circle = { centre = [240, 240], radius = 40 } }\n";
    let by_camera = &run(&write("camera.toml", &format!("{step}{camera}"))).unwrap()[0];
    for (p, w) in face.mesh.positions.iter().zip(by_camera.masks[0].weights.values()) {
        assert!(p.x.hypot(p.y) < 20.8 || *w == 0.0);
    }
    assert!(by_camera.report.moving > 20);

    let uv = "view = { uv = {} }\nregion = { circle = { centre = [0.5, 0.5], radius = 0.1 } }\nmirror = true\n";
    let by_uv = &run(&write("uv.toml", &format!("{FRAME}{step}{uv}"))).unwrap()[0];
    assert!(by_uv.report.moving > 20);
    let parts: Vec<&str> = face.regions.names().collect();
    let by_part = write("part.toml", &format!("{FRAME}{step}parts = [\"{}\"]\n", parts[0]));
    assert_eq!(run(&by_part).unwrap()[0].report.moving, face.regions.vertices(parts[0]).unwrap().len());
    // All of these, and the weights of the file, are 1 or 0 in the frame of a mesh that moves along.
    let missing = write("missing.toml", &format!("{FRAME}{step}weights = \"none.npy\"\n"));
    let error = run(&missing).unwrap_err().to_string();
    assert!(error.contains("none.npy") && error.contains("cannot be read"), "{error}");
}

#[test]
fn malformed_recipes_name_the_line() {
    let mask = "region = { circle = { centre = [0, 0], radius = 3 } }\n";
    for (text, line, said) in [
        ("step = 3".to_owned(), 1, "sequence"),
        ("nmae = \"x\"\n".to_owned(), 1, "nmae"),
        ("[[step]]\nmodel = \"arab\"\n".to_owned(), 2, "arab"),
        (format!("\n\n[[step]]\n[[step.mask]]\n{mask}blurr = 3\n"), 6, "blurr"),
        ("[[step]]\n[[step.mask]]\nregion = { circle = { centre = [0, 0] } }\n".to_owned(), 3, "radius"),
        ("[[step]]\n[[step.mask]]\nregion = { circel = { centre = [0, 0], radius = 1 } }\n".to_owned(), 3, "circel"),
        (format!("{FRAME}[[step]]\nname = \"empty\"\n"), 2, "without masks"),
        (format!("[[step]]\n[[step.mask]]\n{mask}weights = \"a.npy\"\n"), 2, "one of region"),
        ("[[step]]\n[[step.mask]]\ndisplacement = [0, 0, 1]\n".to_owned(), 2, "one of region"),
        (
            format!("[[step]]\n[[step.mask]]\n{mask}displacement = [0, nan, 1]\n"),
            2,
            "[0.0, NaN, 1.0], expected finite numbers",
        ),
        (format!("[[step]]\n[[step.mask]]\n{mask}[[step.protect]]\n{mask}displacement = [0, 0, 1]\n"), 4, "protected"),
        (format!("[[step]]\n[[step.mask]]\n{mask}[[step.pin]]\nlandmark = \"3\"\n"), 4, "one of by and to"),
        (format!("[[step]]\n[[step.mask]]\n{mask}[[step.goal]]\nby = [0, 0, 1]\n"), 4, "landmark and vertex"),
        ("[[step]\n".to_owned(), 1, "]"),
    ] {
        let error = Recipe::from_text(&text, "r.toml").unwrap_err().to_string();
        assert!(error.starts_with(&format!("r.toml: line {line}: ")) && error.contains(said), "{text}: {error}");
        assert!(!error.contains('\n'), "{error}");
    }
    let error = Recipe::from_text("name = \"nothing\"\n", "r.toml").unwrap_err().to_string();
    assert_eq!(error, "r.toml: a recipe without steps: expected [[step]]");
    for head in ["amount = inf", "range = [2, 1]", "range = [nan, 1]"] {
        assert!(
            Recipe::from_text(&format!("{head}\n{FRAME}[[step]]\n[[step.mask]]\n{mask}"), "r.toml").is_err(),
            "{head}"
        );
    }
}

#[test]
fn what_a_mesh_cannot_do_names_the_line() {
    let face = &*FACE;
    let mask = "region = { circle = { centre = [0, 0], radius = 3 } }\n";
    let step = format!("[[step]]\n[[step.mask]]\n{mask}displacement = [0, 0, 1]\n");
    for (text, line, said) in [
        (step.clone(), 2, "give the recipe a frame"),
        (format!("frame = {{ origin = [\"99\"], right = [\"36\", \"45\"], up = [\"8\", \"27\"] }}\n{step}"), 2, "99"),
        (format!("{FRAME}{step}at = [\"nose\"]\n"), 3, "nose"),
        (format!("{FRAME}{}", step.replace("[0, 0], radius", "[900, 0], radius")), 2, "nothing is left to move"),
        (format!("{FRAME}{}", step.replace("radius = 3", "radius = -3")), 3, "radius"),
        (format!("{FRAME}{step}view = {{ frame = {{ pixels_per_mm = 0 }} }}\n"), 3, "pixels"),
        (format!("{FRAME}{step}view = {{ frame = {{ pixels_per_mm = 1e9 }} }}\n"), 3, "a texture of"),
        (format!("{FRAME}{step}blur = {{ kernel = 4 }}\n"), 3, "kernel"),
        (format!("{FRAME}{step}[[step.pin]]\nvertex = 9999999\nby = [0, 0, 0]\n"), 6, "vertex 9999999"),
        (format!("{FRAME}{step}[[step.pin]]\nlandmark = \"30\"\nby = [0, 0, 0]\n"), 2, "no energy"),
        (format!("{FRAME}{}", step.replace("[[step]]", "[[step]]\nthreshold = 2")), 2, "threshold"),
        (format!("{FRAME}{}", step.replace("[[step]]", "[[step]]\nmodel = \"hybrid\"")), 2, "needs blendshapes"),
        (format!("{FRAME}[[step]]\n[[step.mask]]\nparts = [\"elbow\"]\n"), 3, "elbow"),
    ] {
        let recipe = Recipe::from_text(&text, "r.toml").unwrap();
        let error = face.replay(&recipe, ReplayOptions::default()).unwrap_err();
        assert_eq!(error.is_input(), !said.contains("nothing is left"), "{error}");
        let error = error.to_string();
        assert!(error.starts_with(&format!("r.toml: line {line}: ")) && error.contains(said), "{text}: {error}");
    }
}

#[test]
fn a_mirrored_mesh_is_noticed() {
    let mirror = |face: &Face| {
        let flipped = face.mesh.positions.iter().map(|p| Vec3::new(-p.x, p.y, p.z)).collect();
        Face::new(face.mesh.with_positions(flipped), face.landmarks.clone())
    };
    let swap = |face: &Face| {
        let mut landmarks = face.landmarks.clone();
        let (right, left) = (landmarks[36].1, landmarks[45].1);
        (landmarks[36].1, landmarks[45].1) = (left, right);
        Face::new(face.mesh.clone(), landmarks)
    };
    let recipe = preset("nose-tip").unwrap().unwrap();
    for wrong in [mirror(&FACE), swap(&FACE)] {
        let error = wrong.replay(&recipe, ReplayOptions::default()).unwrap_err().to_string();
        assert!(error.contains("mirrored"), "{error}");
    }
    assert!(mirror(&mirror(&FACE)).replay(&recipe, ReplayOptions::default()).is_ok());
    // What else the mesh holds does not turn the face about.
    let table = (0..4).map(|i| Vec3::new(f64::from(i % 2) * 300.0, -400.0, 900.0 + f64::from(i / 2) * 300.0));
    let mut mesh = FACE.mesh.clone();
    let first = mesh.positions.len() as u32;
    mesh.positions.extend(table);
    mesh.corners.extend([first, first + 1, first + 3, first + 2]);
    mesh.starts.push(mesh.corners.len() as u32);
    mesh.positions.extend(std::iter::repeat_n(Vec3::new(0.0, -400.0, 1000.0), 3 * first as usize));
    let seated = Face::new(mesh, FACE.landmarks.clone());
    assert!(seated.replay(&recipe, ReplayOptions::default()).is_ok());
}

#[test]
fn presets_print_as_recipes_that_do_the_same() {
    for (name, recipe) in presets() {
        let text = preset_text(name).unwrap();
        let again = Recipe::from_text(&text, "printed").unwrap();
        let [a, b] = [recipe, again].map(|r| FACE.replay(&r, ReplayOptions::default()).unwrap().remove(0).positions);
        assert_eq!(a, b, "{name}");
    }
    assert!(preset("nose").is_none() && preset_text("nose").is_none());
}

#[test]
fn an_amount_of_a_step_multiplies_that_of_the_recipe() {
    let mask = "\n[[step.mask]]\nregion = { circle = { centre = [0, 0], radius = 9 } }\ndisplacement = [0, 0, 1.5]\n";
    let text = |amounts: [&str; 2]| format!("{}\n{FRAME}[[step]]\n{}{mask}", amounts[0], amounts[1]);
    let positions = |amounts| {
        let recipe = Recipe::from_text(&text(amounts), "test").unwrap();
        FACE.replay(&recipe, ReplayOptions::default()).unwrap().remove(0).positions
    };
    assert_eq!(positions(["amount = 2.0", "amount = 0.5"]), positions(["", ""]));
    assert_eq!(positions(["amount = 2.0", ""]), positions(["", "amount = 2.0"]));
    assert!(Recipe::from_text(&text(["", "amount = inf"]), "test").is_err());
}

#[test]
fn what_has_no_effect_and_what_a_recipe_is_not_made_for_are_said() {
    let circle = "region = { circle = { centre = [0, 0], radius = 3 } }";
    let step = |step: &str, mask: &str| format!("[[step]]\n{step}\n[[step.mask]]\n{mask}\n");
    let doubts = |text: &str, amount, model| Recipe::from_text(text, "r.toml").unwrap().doubts(amount, model);
    let arap = Some(MorphModel::Energy(ModelKind::Arap));
    let looking = "eye = [0, 0, 9], target = [0, 0, 0]";
    for (text, model, said) in [
        (step("", circle), None, &[][..]),
        (step("energy = { smoothing = 3 }", circle), None, &["line 1: smoothing has no effect: model direct"]),
        (step("energy = { smoothing = 3, tolerance = 1e-4 }", circle), arap, &[]),
        (step("energy = { smoothness = \"laplacian\", prior = 1 }", circle), arap, &["smoothness", "prior"]),
        (step("model = \"graph\"\nenergy = { nodes = 20 }", circle), None, &[]),
        (step("model = \"graph\"\nenergy = { nodes = 20 }", circle), arap, &["nodes has no effect: model arap"]),
        (
            step("", "parts = [\"nose\"]\nat = [\"3\"]\nview = { uv = {} }\nblur = {}\nsampling = \"nearest\""),
            None,
            &["line 3: view", "line 3: at", "line 3: blur", "line 3: sampling has no effect: parts"],
        ),
        (step("", "weights = \"w.npy\"\nvisibility = \"through\""), None, &["visibility has no effect: weights"]),
        (step("", &format!("{circle}\ngrey = \"as_printed\"")), None, &["grey has no effect"]),
        (step("", &format!("{circle}\nview = {{ uv = {{}} }}\nat = [\"3\"]")), None, &["at has no effect"]),
        (
            step("", "png = \"a.png\"\nview = { frame = { pixels_per_mm = 2, covers = [[0, 0], [1, 1]] } }"),
            None,
            &["pixels_per_mm has no effect: a picture"],
        ),
        (step("", "png = \"a.png\"\nview = { uv = { size = [9, 9] } }"), None, &["size has no effect: a picture"]),
        (step("", &format!("{circle}\nview = {{ uv = {{ size = [9, 9] }} }}")), None, &[]),
        (
            step("", &format!("{circle}\nview = {{ camera = {{ {looking}, height = 9, vertical_fov = 9 }} }}")),
            None,
            &["vertical_fov has no effect"],
        ),
        (
            step("", &format!("{circle}\n[[step.pin]]\nvertex = 3\nby = [0, 0, 1]\nweight = 3")),
            None,
            &["weight has no"],
        ),
    ] {
        let found = doubts(&text, None, model);
        assert_eq!(found.len(), said.len(), "{text}: {found:?}");
        assert!(found.iter().zip(said).all(|(found, said)| found.contains(said)), "{text}: {found:?}");
    }
    let ranged = format!("amount = 2\nrange = [-1, 3]\n{}", step("", circle));
    assert!(doubts(&ranged, None, None).is_empty() && doubts(&ranged, Some(-1.0), None).is_empty());
    assert_eq!(
        doubts(&ranged, Some(40.0), None),
        ["r.toml is made for amounts from -1 to 3, not 40: look at the folds"]
    );
    assert_eq!(doubts(&ranged.replace("amount = 2", "amount = 5"), None, None).len(), 1);
}

#[test]
fn masks_that_overlap_ask_for_their_sum() {
    let mask = "[[step.mask]]\nregion = { circle = { centre = [0, 0], radius = 9 } }\n";
    let step = format!("[[step]]\n{mask}displacement = [0, 0, 1]\n{mask}displacement = [0, 1, 1]\n");
    let report = FACE.morph(&step).remove(0).report;
    assert!(report.asked > 1.5 && report.change.reached <= report.asked + 1e-12, "{report:?}");
}

#[test]
fn a_gaussian_is_named_with_or_without_its_width() {
    let texture = Texture::new(9, 9, (0..81).map(|k| f64::from(u8::from(k == 40))).collect()).unwrap();
    let of = |kind: &str| -> Result<Texture, String> {
        let text = format!("[[step]]\n[[step.mask]]\npng = \"a.png\"\nblur = {{ kind = {kind}, kernel = 5 }}\n");
        let recipe = Recipe::from_text(&text, "r.toml").map_err(|e| e.to_string())?;
        Ok(recipe.step[0].get_ref().mask[0].get_ref().blur.unwrap().apply(&texture).unwrap())
    };
    assert_eq!(of("\"gaussian\""), of("{ gaussian = {} }"));
    assert_eq!(of("\"gaussian\""), of(&format!("{{ gaussian = {{ sigma = {} }} }}", Blur::sigma_of(5))));
    assert_ne!(of("\"mean\""), of("\"gaussian\""));
    for wrong in ["\"gauss\"", "3", "{ gaussian = { sigam = 2 } }"] {
        let error = of(wrong).unwrap_err();
        assert!(
            error.starts_with("r.toml: line 4: ") && error.contains("gaussian") || error.contains("sigam"),
            "{error}"
        );
    }
}
