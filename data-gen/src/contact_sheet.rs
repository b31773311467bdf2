//! One picture of everything: the template, expressions, people, scans.

use nonrigid::mesh::{PolygonMesh, Vec3};
use nonrigid::render::{Camera, Frame, Panel, Scene, Sheet, Style, View, render};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::{FaceRig, ScanCase};

/// Pixels of a panel.
const SIZE: [u32; 2] = [400, 460];
const ACROSS: usize = 6;
const EYE_WHITE: [u8; 3] = [236, 236, 240];

/// What is shown of the expressions; those with `_L` and `_R` on both sides.
const EXPRESSIONS: [&str; 12] = [
    "jawOpen",
    "eyeBlink",
    "mouthSmile",
    "mouthFrown",
    "mouthPucker",
    "mouthFunnel",
    "cheekPuff",
    "browInnerUp",
    "browDown",
    "noseSneer",
    "jawLeft",
    "mouthUpperUp",
];

/// A sheet of the rig and of up to three scans: template and wireframe, 12 expressions at weight 1, 6 random people drawn
/// from `seed`, the scans and their triangles.
#[must_use]
pub fn contact_sheet(rig: &FaceRig, scans: &[(String, ScanCase)], seed: u64) -> Sheet {
    let frame = Frame::of(&rig.neutral);
    let mut sheet = Sheet::new(&format!("template: {} vertices; seed {seed}", rig.neutral.len()));

    let close = |x: f64, y: f64, half: f64| Frame { centre: Vec3::new(x, y, -5.0), half: Vec3::new(half, half, 10.0) };
    let template = [
        ("template", &frame, View::Front, false),
        ("", &frame, View::ThreeQuarter, false),
        ("", &frame, View::Front, true),
        ("", &frame, View::Side, true),
        ("lips", &close(8.0, -66.0, 30.0), View::Angles { yaw: 15.0, pitch: 0.0 }, true),
        ("eyelids", &close(30.0, 2.0, 24.0), View::Angles { yaw: 10.0, pitch: 0.0 }, true),
    ];
    let panels = template.map(|(name, frame, view, wires)| {
        let scene = face(rig, &rig.neutral, &[]);
        Shot { scene: if wires { scene.wireframe(&rig.mesh) } else { scene }, frame: *frame, view }.draw(name)
    });
    sheet = sheet.row("", panels);

    let shown = EXPRESSIONS.map(|name| {
        let is_it = |n: &str| n == name || n.strip_prefix(name).is_some_and(|rest| rest == "_L" || rest == "_R");
        let weights: Vec<f64> = rig.expressions.iter().map(|e| f64::from(u8::from(is_it(&e.0)))).collect();
        let scene = face(rig, &rig.pose(&weights, &[]), &[]);
        Shot { scene, frame, view: View::Angles { yaw: 12.0, pitch: 0.0 } }.draw(name)
    });
    for row in shown.chunks(ACROSS) {
        sheet = sheet.row("", row.to_vec());
    }

    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let people = (0..ACROSS).map(|k| {
        let identity: Vec<f64> = rig.identities.iter().map(|_| StandardNormal.sample(&mut rng)).collect();
        let scene = face(rig, &rig.pose(&[], &identity), &identity);
        Shot { scene, frame, view: View::ThreeQuarter }.draw(&format!("person {}", k + 1))
    });
    sheet = sheet.row("", people);

    let scans = scans.iter().take(ACROSS / 2).flat_map(|(name, case)| {
        let frame = Frame::of(&case.truth);
        let scene = || Scene::new().mesh(&case.scan, Style::Clay);
        let wires = scene().wireframe(&PolygonMesh::from(case.scan.clone()));
        let count = format!("{} triangles", case.scan.triangles.len());
        let near = Frame { centre: frame.centre - Vec3::new(0.0, 0.2 * frame.half.y, 0.0), half: frame.half * 0.4 };
        [
            Shot { scene: scene(), frame, view: View::ThreeQuarter }.draw(name),
            Shot { scene: wires, frame: near, view: View::Front }.draw(&count),
        ]
    });
    sheet.row("", scans)
}

/// The face with its eyeballs.
fn face(rig: &FaceRig, positions: &[Vec3], identity: &[f64]) -> Scene {
    let mesh = PolygonMesh { positions: positions.to_vec(), ..rig.mesh.clone() };
    rig.eyeballs(identity).iter().flatten().fold(Scene::new().mesh(&mesh.triangulate(), Style::Clay), |scene, eye| {
        scene.mesh(&eye.surface(), Style::Solid(EYE_WHITE))
    })
}

struct Shot {
    scene: Scene,
    frame: Frame,
    view: View,
}

impl Shot {
    fn draw(&self, caption: &str) -> Panel {
        Panel::new(render(&self.scene, &Camera::framing(&self.frame, self.view, SIZE), SIZE), caption)
    }
}
