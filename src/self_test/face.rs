//! A face in millimetres, by formula: template, shapes, and a scan of another expression with other vertices, so that the truth is
//! known exactly. Nothing in it is symmetric or regular: no two distances are equal, and no choice hangs on the last digit.

use crate::landmark::{Landmark, TemplatePoint};
use crate::mesh::{PolygonMesh, Pose, TriangleMesh, Vec3};
use crate::rig::{Family, Shape, ShapeBasis};

/// A template, its shapes and a scan.
#[derive(Debug, Clone)]
pub struct Face {
    /// The neutral face: 66 x 76 vertices, quads.
    pub template: PolygonMesh,
    /// Its shapes.
    pub shapes: ShapeBasis,
    /// The deformed face, seen from somewhere else, with vertices of its own.
    pub scan: TriangleMesh,
    /// A few template vertices and where they are on the scan.
    pub landmarks: Vec<Landmark>,
    /// Where every template vertex is on the scan.
    pub truth: Vec<Vec3>,
}

/// Columns and rows of the template's vertices.
const TEMPLATE: [usize; 2] = [66, 76];
/// Columns and rows of the scan's.
const SCAN: [usize; 2] = [127, 149];
const SHAPES: usize = 40;
/// Landmarks, in columns and rows of the template.
const LANDMARKS: [[usize; 2]; 7] = [[14, 52], [26, 51], [41, 52], [53, 50], [33, 33], [22, 19], [45, 20]];

impl Default for Face {
    fn default() -> Self {
        Self::new()
    }
}

impl Face {
    /// The face.
    #[must_use]
    pub fn new() -> Self {
        let domain = grid(TEMPLATE, 0.3);
        let positions: Vec<Vec3> = domain.iter().map(|&at| rest(at)).collect();
        let bumps = bumps(SHAPES);
        let mut slab = Vec::with_capacity(3 * positions.len() * SHAPES);
        for &p in &positions {
            let deltas: Vec<Vec3> = bumps.iter().map(|bump| bump.displacement(p)).collect();
            slab.extend((0..3).flat_map(|axis| deltas.iter().map(move |d| d[axis] as f32)));
        }
        let named = |k| Shape { name: format!("shape {k}"), family: Family::Expression };
        let shapes = ShapeBasis::new((0..SHAPES).map(named).collect(), slab);
        let pose = Pose::rigid(Vec3::new(0.08, -0.21, 0.05), Vec3::new(12.0, -7.0, 30.0));
        let on_scan = |p: Vec3| deformed(p, &bumps, &pose);
        let truth: Vec<Vec3> = positions.iter().map(|&p| on_scan(p)).collect();
        let quads = quads(TEMPLATE);
        let template = PolygonMesh {
            starts: (0..=quads.len() as u32).map(|f| 4 * f).collect(),
            corners: quads.into_iter().flatten().collect(),
            positions,
            ..PolygonMesh::default()
        };
        let scan = TriangleMesh {
            positions: grid(SCAN, 1.1).into_iter().map(|at| on_scan(rest(at))).collect(),
            triangles: self::quads(SCAN).into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
        };
        let landmark = |[column, row]: [usize; 2]| {
            let vertex = row * TEMPLATE[0] + column;
            Landmark {
                name: vertex.to_string(),
                template: TemplatePoint::Vertex(vertex as u32),
                target: truth[vertex],
                sigma: None,
            }
        };
        let landmarks = LANDMARKS.map(landmark).into();
        Self { template, shapes, scan, landmarks, truth }
    }
}

/// Points of the domain, row by row, bent so that no two cells are equal.
fn grid([columns, rows]: [usize; 2], phase: f64) -> Vec<[f64; 2]> {
    let at = |i: usize, count: usize| 2.0 * i as f64 / (count - 1) as f64 - 1.0;
    let point = |row: usize, column: usize| {
        let (s, t) = (at(column, columns), at(row, rows));
        let bend = |along: f64, across: f64| along + 0.02 * (1.0 - along * along) * (7.0 * across + phase).sin();
        [bend(s, t), bend(t, s)]
    };
    (0..rows).flat_map(|row| (0..columns).map(move |column| point(row, column))).collect()
}

fn quads([columns, rows]: [usize; 2]) -> Vec<[u32; 4]> {
    let quad = |row: usize, column: usize| {
        let first = row * columns + column;
        [first, first + 1, first + columns + 1, first + columns].map(|v| v as u32)
    };
    (0..rows - 1).flat_map(|row| (0..columns - 1).map(move |column| quad(row, column))).collect()
}

/// The neutral face over the square from -1 to 1: x to the right, y up, z towards the viewer.
pub fn rest([u, v]: [f64; 2]) -> Vec3 {
    let turn = 1.2 * u;
    let (x, y) = (74.0 * turn.sin() * (1.0 - 0.15 * v * v), 98.0 * v);
    let bump = |cx: f64, cy: f64, rx: f64, ry: f64| (-((x - cx) / rx).powi(2) - ((y - cy) / ry).powi(2)).exp();
    let features = 21.0 * bump(0.7, -4.0, 10.0, 19.0) // nose
        + 5.0 * bump(-0.4, 44.0, 45.0, 9.0) // brow
        - 8.0 * (bump(-32.0, 28.0, 13.0, 9.0) + bump(32.6, 27.4, 13.0, 9.0)) // eyes
        + 4.5 * (bump(0.3, -39.0, 22.0, 4.5) + bump(-0.3, -49.0, 20.0, 5.0)) // lips
        + 9.0 * bump(0.2, -74.0, 20.0, 12.0); // chin
    Vec3::new(x, y, 70.0 * turn.cos() * (1.0 - 0.25 * v * v) + features + 0.8 * (0.06 * y + 0.04 * x).sin())
}

/// A shape: the skin round `centre` goes in a direction, the less the farther away.
pub struct Bump {
    centre: Vec3,
    radius: f64,
    height: Vec3,
}

/// The first shapes of a sequence that covers the face.
pub fn bumps(count: usize) -> Vec<Bump> {
    let bump =
        |k| Bump { centre: rest(scattered(k)), radius: 16.0 + 1.5 * (k % 11) as f64, height: 6.0 * direction(k) };
    (0..count).map(bump).collect()
}

impl Bump {
    /// How the point `p` of the neutral face moves at weight 1.
    pub fn displacement(&self, p: Vec3) -> Vec3 {
        (-(p - self.centre).norm_squared() / self.radius.powi(2)).exp() * self.height
    }
}

/// The point `p` of the neutral face on the scan: moved by the shapes, by waves that no shape expresses, and by the head's pose.
fn deformed(p: Vec3, bumps: &[Bump], pose: &Pose) -> Vec3 {
    let weighted = |(k, bump): (usize, &Bump)| (0.2 + 0.3 * (1.7 * k as f64).sin()) * bump.displacement(p);
    let shapes: Vec3 = bumps.iter().enumerate().map(weighted).sum();
    let waves = Vec3::new(
        0.2 * (p.y / 31.0).sin(),
        0.2 * (p.x / 27.0 + 1.0).sin(),
        0.5 * ((p.x + 0.8 * p.y) / 29.0 + 0.5).cos(),
    );
    pose.apply(p + shapes + waves)
}

/// Point `i` of a sequence that fills the domain evenly (Roberts' generalised golden ratio).
pub fn scattered(i: usize) -> [f64; 2] {
    [0.754_877_666_246_693, 0.569_840_290_998_053].map(|step| 1.8 * ((i + 1) as f64 * step).fract() - 0.9)
}

/// Direction `i` of a sequence that fills the sphere evenly.
pub fn direction(i: usize) -> Vec3 {
    let [u, v] = scattered(i).map(|x| x / 0.9);
    let (angle, radius) = (std::f64::consts::PI * u, (1.0 - v * v).sqrt());
    Vec3::new(radius * angle.cos(), radius * angle.sin(), v)
}
