//! The stylised face: a grid of quads on a smooth height field, slit open at the mouth and the eyes.
//!
//! Rows run from chin to forehead, columns from the right ear (-X) to the left. The mouth and the eyes are slits of the
//! grid: along them every vertex exists twice, once above and once below. The mouth's copies lie 0.1 mm apart, the eyes'
//! are opened to almonds. There are no other holes.

use nonrigid::mesh::{ObjMetadata, ObjStatement, PolygonMesh, Vec3};

use crate::{expressions, identity};

/// How the face is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceOptions {
    /// Number of vertices aimed at, 500 to 100,000; default 1200. The grid comes as close as it can.
    pub vertices: usize,
}

impl Default for FaceOptions {
    fn default() -> Self {
        Self { vertices: 1200 }
    }
}

/// A named vertex of the template.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Landmark {
    /// What it marks, for instance `mouth_corner_L`.
    pub name: String,
    /// Vertex index.
    pub vertex: u32,
}

/// A template face with everything that a fit may use of it.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceRig {
    /// The template: quads, UVs with a seam along the symmetry plane, groups and materials, at the neutral positions.
    pub mesh: PolygonMesh,
    /// The neutral positions.
    pub neutral: Vec<Vec3>,
    /// Name and delta per vertex: position = neutral + weight x delta, weights 0 to 1.
    pub expressions: Vec<(String, Vec<Vec3>)>,
    /// Delta per vertex of each mode, scaled by its standard deviation: weights ~ N(0, 1). Falling variance.
    pub identities: Vec<Vec<Vec3>>,
    /// Marked vertices.
    pub landmarks: Vec<Landmark>,
}

/// Where the seam between the lips and the eyes lie.
pub(crate) const MOUTH: [f64; 2] = [0.0, -38.0];
pub(crate) const MOUTH_HALF_WIDTH: f64 = 25.0;
pub(crate) const EYE: [f64; 2] = [30.0, 30.0];
pub(crate) const EYE_HALF_WIDTH: f64 = 14.0;
/// How far the lids are open above and below the line between the corners.
pub(crate) const LID_OPENING: [f64; 2] = [5.0, 3.2];
const LIP_GAP: f64 = 0.1;
const IDENTITY_MODES: usize = 8;

/// A grid vertex before it is lifted: place in the plane and the side of the slit it belongs to.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Flat {
    pub x: f64,
    pub y: f64,
    /// Opening field of the mouth in half widths: 1 in the middle of the upper lip, -1 of the lower, 0 beside the corners.
    pub mouth: f64,
    /// The same of the eye on this side of the face.
    pub eye: f64,
}

impl FaceRig {
    /// Makes the rig. Deterministic: there is no randomness in it.
    #[must_use]
    pub fn generate(options: &FaceOptions) -> Self {
        let grid = Grid::new(options.vertices.clamp(500, 100_000));
        let flat = grid.flat_vertices();
        let neutral: Vec<Vec3> = flat.iter().map(lift).collect();
        let (starts, corners, metadata) = grid.polygons();
        let mesh = PolygonMesh { positions: neutral.clone(), starts, corners, metadata };
        let expressions = expressions::all(&flat, &neutral);
        let identities = identity::modes(&neutral, IDENTITY_MODES);
        let landmarks = landmarks(&flat, &neutral);
        Self { mesh, neutral, expressions, identities, landmarks }
    }

    /// The face at these weights; missing weights are 0 and superfluous ones are ignored.
    #[must_use]
    pub fn pose(&self, expression_weights: &[f64], identity_weights: &[f64]) -> Vec<Vec3> {
        let mut positions = self.neutral.clone();
        let shapes = self.expressions.iter().map(|e| &e.1).zip(expression_weights);
        for (delta, &weight) in shapes.chain(self.identities.iter().zip(identity_weights)) {
            for (p, d) in positions.iter_mut().zip(delta) {
                *p += d * weight;
            }
        }
        positions
    }
}

/// A slit: grid row, and first and last column, which are shared by both sides.
#[derive(Debug, Clone, Copy)]
struct Slit {
    row: usize,
    columns: [usize; 2],
    centre: f64,
    half_width: f64,
}

struct Grid {
    columns: usize,
    /// Height of each row on the symmetry plane.
    rows: Vec<f64>,
    /// Mouth, right eye, left eye.
    slits: [Slit; 3],
}

impl Grid {
    fn new(vertices: usize) -> Self {
        let half = ((vertices as f64 * 0.78).sqrt() / 2.0).round().max(8.0) as usize;
        let columns = 2 * half + 1;
        let row_count = vertices / columns;
        // Three bands of rows: chin to mouth, mouth to eyes, eyes to forehead; denser towards mouth and eyes.
        let lower = (row_count as f64 * 0.33).round() as usize;
        let middle = (row_count as f64 * 0.39).round() as usize;
        let upper = row_count.saturating_sub(lower + middle + 1).max(4);
        let mut rows = Vec::new();
        for i in 0..lower {
            let t = i as f64 / lower as f64;
            rows.push(BOTTOM + (MOUTH[1] - BOTTOM) * (t + 0.10 * (std::f64::consts::PI * t).sin()));
        }
        for i in 0..middle {
            let t = i as f64 / middle as f64;
            rows.push(MOUTH[1] + (EYE[1] - MOUTH[1]) * (t - 0.05 * (std::f64::consts::TAU * t).sin()));
        }
        for i in 0..=upper {
            let t = i as f64 / upper as f64;
            rows.push(EYE[1] + (TOP - EYE[1]) * (t - 0.08 * (std::f64::consts::PI * t).sin()));
        }
        let slit = |row: usize, y: f64, from: f64, to: f64| {
            let nearest = |x: f64| {
                let off = |c: &usize| (column_x(*c, columns, y) - x).abs();
                (0..columns).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
            };
            let ends = [nearest(from), nearest(to)];
            let x = ends.map(|c| column_x(c, columns, y));
            Slit { row, columns: ends, centre: 0.5 * (x[0] + x[1]), half_width: 0.5 * (x[1] - x[0]) }
        };
        let (mouth, eyes) = (lower, lower + middle);
        let (inner, outer) = (EYE[0] - EYE_HALF_WIDTH, EYE[0] + EYE_HALF_WIDTH);
        let slits = [
            slit(mouth, MOUTH[1], -MOUTH_HALF_WIDTH, MOUTH_HALF_WIDTH),
            slit(eyes, EYE[1], -outer, -inner),
            slit(eyes, EYE[1], inner, outer),
        ];
        Self { columns, rows, slits }
    }

    /// Lower copies along the slits, in the order in which they follow the grid's vertices.
    fn copies(&self) -> impl Iterator<Item = (usize, usize, usize)> {
        self.slits
            .iter()
            .enumerate()
            .flat_map(|(s, slit)| (slit.columns[0] + 1..slit.columns[1]).map(move |column| (s, slit.row, column)))
    }

    /// Vertex index at a grid point, seen from the row above or below it.
    fn index(&self, row: usize, column: usize, from_below: bool) -> u32 {
        let base = self.rows.len() * self.columns;
        let copy = self.copies().position(|(_, r, c)| from_below && r == row && c == column);
        copy.map_or(row * self.columns + column, |k| base + k) as u32
    }

    fn flat_vertices(&self) -> Vec<Flat> {
        let mut flat = Vec::new();
        for row in 0..self.rows.len() {
            for column in 0..self.columns {
                flat.push(self.flat(row, column, 1.0));
            }
        }
        flat.extend(self.copies().map(|(_, row, column)| self.flat(row, column, -1.0)));
        flat
    }

    /// Place of a grid point; `side` tells the copies of a slit apart.
    fn flat(&self, row: usize, column: usize, side: f64) -> Flat {
        let row_y = self.rows[row];
        let x = column_x(column, self.columns, row_y);
        let u = 2.0 * column as f64 / (self.columns - 1) as f64 - 1.0;
        // Round off the corners of the forehead and of the jaw.
        let mut y = row_y - 15.0 * u * u * (row_y / TOP).max(0.0).powi(2);
        y += 11.0 * u * u * ((row_y - MOUTH[1]) / (BOTTOM - MOUTH[1])).max(0.0).powi(2);
        let opening = |slit: &Slit, line: f64| {
            let on_line = row == slit.row;
            let height = if on_line { 0.0 } else { row_y - line };
            slit_field(x - slit.centre, height, slit.half_width, side)
        };
        let eye_slit = &self.slits[if x < 0.0 { 1 } else { 2 }];
        let mouth = opening(&self.slits[0], MOUTH[1]);
        let eye = opening(eye_slit, EYE[1]);
        // The lips' copies part by a fixed gap only where there are two of them.
        let slit = &self.slits[0];
        if row == slit.row && column > slit.columns[0] && column < slit.columns[1] {
            y += 0.5 * LIP_GAP * side;
        }
        let eye_near = bell(x - eye_slit.centre, 13.0) * bell(row_y - EYE[1], 8.0);
        y += eye * eye_near * if eye > 0.0 { LID_OPENING[0] } else { LID_OPENING[1] };
        Flat { x, y, mouth, eye }
    }

    fn polygons(&self) -> (Vec<u32>, Vec<u32>, ObjMetadata) {
        let middle = self.columns / 2;
        let mut quads: Vec<(Part, [u32; 4], bool)> = Vec::new();
        for row in 0..self.rows.len() - 1 {
            for column in 0..self.columns - 1 {
                // The lower edge of a cell sees the upper copies of its row, the upper edge the lower ones.
                let q = [
                    self.index(row, column, false),
                    self.index(row, column + 1, false),
                    self.index(row + 1, column + 1, true),
                    self.index(row + 1, column, true),
                ];
                let near = |s: &Slit, rows: usize| {
                    row + rows >= s.row && row < s.row + rows && column >= s.columns[0] && column < s.columns[1]
                };
                let part = if near(&self.slits[0], 2) {
                    Part::Lips
                } else if self.slits[1..].iter().any(|s| near(s, 1)) {
                    Part::Lids
                } else {
                    Part::Skin
                };
                quads.push((part, q, column >= middle));
            }
        }
        quads.sort_by_key(|q| q.0);

        // Two UV islands, left and right; the vertices on the symmetry plane have a texture coordinate in each.
        let flat = self.flat_vertices();
        let place = |v: usize, shift: f64| [(0.5 + flat[v].x / 160.0) * 0.94 + shift, 0.5 + flat[v].y / 200.0];
        let mut uvs: Vec<[f64; 2]> = (0..flat.len()).map(|v| place(v, 0.0)).collect();
        let mut second = vec![u32::MAX; flat.len()];
        let (mut starts, mut corners, mut corner_uvs) = (vec![0], Vec::new(), Vec::new());
        for (_, q, left) in &quads {
            for &v in q {
                let on_seam = flat[v as usize].x.abs() < 1e-9;
                let uv = if *left {
                    if second[v as usize] == u32::MAX {
                        second[v as usize] = if on_seam { uvs.len() as u32 } else { v };
                        if on_seam {
                            uvs.push(place(v as usize, 0.06));
                        } else {
                            uvs[v as usize] = place(v as usize, 0.06);
                        }
                    }
                    second[v as usize]
                } else {
                    v
                };
                corners.push(v);
                corner_uvs.push(uv);
            }
            starts.push(corners.len() as u32);
        }
        let mut statements = vec![(0, ObjStatement::Object("face".into()))];
        for (part, group, material) in
            [(Part::Skin, "skin", "skin"), (Part::Lids, "lids", "skin"), (Part::Lips, "lips", "lips")]
        {
            if let Some(first) = quads.iter().position(|q| q.0 == part) {
                statements.push((first as u32, ObjStatement::Group(group.into())));
                statements.push((first as u32, ObjStatement::Material(material.into())));
            }
        }
        statements.insert(1, (0, ObjStatement::Smoothing("1".into())));
        let material_libraries = vec!["face.mtl".into()];
        (starts, corners, ObjMetadata { uvs, corner_uvs, material_libraries, statements })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    Skin,
    Lids,
    Lips,
}

const BOTTOM: f64 = -90.0;
const TOP: f64 = 90.0;

/// Distance of a grid column from the symmetry plane at a row's height: the outline of the face, columns denser inside.
fn column_x(column: usize, columns: usize, y: f64) -> f64 {
    let u = 2.0 * column as f64 / (columns - 1) as f64 - 1.0;
    let t = y / TOP - 0.2;
    let half_width = if t > 0.0 { 70.0 - 20.0 * (t / 0.8).powi(2) } else { 70.0 - 31.0 * (t / 1.2).powi(2) };
    // Columns keep their place inside, so that slits are straight; the outline takes up the difference.
    let inner = 0.72 * u * 70.0 * (0.35 + 0.65 * half_width / 70.0);
    inner + (half_width.copysign(u) - inner / u.abs().max(1e-9)) * u.abs().powi(3)
}

/// The opening field of a slit from -a to a on the line y = 0, in half widths: Im sqrt((x + iy)^2 - a^2) / a, the plane
/// strain solution of a crack under tension. On the slit it is +-sqrt(1 - (x/a)^2) by `side`; smooth everywhere else and zero
/// on the line beyond the slit's ends.
pub(crate) fn slit_field(x: f64, y: f64, a: f64, side: f64) -> f64 {
    if y == 0.0 {
        // The general form loses half of its digits here.
        return (1.0 - (x / a).powi(2)).max(0.0).sqrt() * side;
    }
    let (re, im) = (x * x - y * y - a * a, 2.0 * x * y);
    let magnitude = (0.5 * (re.hypot(im) - re)).max(0.0).sqrt() / a;
    magnitude.copysign(y)
}

/// exp(-d^2 / 2 s^2).
pub(crate) fn bell(d: f64, s: f64) -> f64 {
    (-0.5 * (d / s).powi(2)).exp()
}

/// 0 below -1, 1 above 1, smooth between.
fn step(t: f64) -> f64 {
    0.5 + 0.5 * (1.5 * t).tanh()
}

/// Height of the face above the plane z = 0.
fn lift(flat: &Flat) -> Vec3 {
    let (x, y) = (flat.x, flat.y);
    let side = x.abs();
    let hump = |cx: f64, cy: f64, sx: f64, sy: f64| bell(side - cx, sx) * bell(y - cy, sy);
    let middle = |cy: f64, sx: f64, sy: f64| bell(x, sx) * bell(y - cy, sy);

    // Skull: an ellipsoid, flattened in front.
    let mut z = 78.0 * (1.0 - (x / 88.0).powi(2) - ((y - 6.0) / 128.0).powi(2)).max(0.02).sqrt();
    // Sockets with the eyeballs under the lids, brow ridge, cheek bones.
    z += -11.0 * hump(28.0, 27.0, 13.0, 10.0) + 6.0 * hump(30.0, 30.0, 9.0, 7.0);
    z += 5.0 * hump(26.0, 47.0, 17.0, 6.0) + 2.0 * middle(46.0, 14.0, 8.0);
    z += 4.5 * hump(46.0, 4.0, 14.0, 13.0) - 3.0 * hump(48.0, -30.0, 14.0, 16.0);
    // Nose: a ridge that rises from the root to the tip, and the wings.
    let along = ((40.0 - y) / 50.0).clamp(0.0, 1.2);
    let ridge = (3.0 + 17.0 * along) * step((y + 15.5) / 5.0) * step((46.0 - y) / 9.0);
    z += ridge * bell(x, 5.5 + 3.5 * along);
    z += 5.0 * middle(-9.0, 8.0, 6.0) + 7.0 * hump(12.0, -12.0, 4.5, 5.0);
    z -= 2.5 * hump(20.0, -14.0, 5.0, 8.0);
    // Mouth: the arch of the teeth, the lips, the seam between them, the philtrum.
    z += 7.0 * middle(-36.0, 24.0, 18.0);
    let lips = bell(x, 14.0);
    z += lips * (4.5 * bell(y + 33.0, 3.2) + 5.5 * bell(y + 43.5, 3.8));
    z -= 3.2 * bell(x, 14.0) * bell(y - MOUTH[1], 1.6) + 1.6 * middle(-24.5, 3.0, 4.0);
    z -= 1.2 * hump(28.0, -38.0, 6.0, 6.0);
    // Chin with the fold above it.
    z += -4.0 * middle(-54.0, 17.0, 5.0) + 9.0 * middle(-72.0, 17.0, 12.0);
    Vec3::new(x, y, z)
}

fn landmarks(flat: &[Flat], neutral: &[Vec3]) -> Vec<Landmark> {
    let (mouth, eye) = (MOUTH_HALF_WIDTH, EYE_HALF_WIDTH);
    let mut wanted: Vec<(String, f64, f64)> = vec![
        ("nose_root".into(), 0.0, 36.0),
        ("nose_tip".into(), 0.0, -9.0),
        ("nose_base".into(), 0.0, -21.0),
        ("lip_upper".into(), 0.0, MOUTH[1] + 0.05),
        ("lip_lower".into(), 0.0, MOUTH[1] - 0.05),
        ("chin".into(), 0.0, -72.0),
    ];
    for (suffix, sign) in [("R", -1.0), ("L", 1.0)] {
        for (name, x, y) in [
            ("brow_inner", 12.0, 47.0),
            ("brow_outer", 44.0, 46.0),
            ("eye_inner", EYE[0] - eye, EYE[1]),
            ("eye_outer", EYE[0] + eye, EYE[1]),
            ("lid_upper", EYE[0], EYE[1] + LID_OPENING[0]),
            ("lid_lower", EYE[0], EYE[1] - LID_OPENING[1]),
            ("nose_wing", 13.0, -13.0),
            ("mouth_corner", mouth, MOUTH[1]),
            ("jaw", 52.0, -45.0),
        ] {
            wanted.push((format!("{name}_{suffix}"), sign * x, y));
        }
    }
    wanted
        .into_iter()
        .map(|(name, x, y)| {
            let off = |v: &usize| (neutral[*v].x - x).powi(2) + (neutral[*v].y - y).powi(2);
            let vertex = (0..flat.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0) as u32;
            Landmark { name, vertex }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn vertex(rig: &FaceRig, name: &str) -> usize {
        rig.landmarks.iter().find(|l| l.name == name).unwrap().vertex as usize
    }

    #[test]
    fn the_template_has_the_promised_size_and_parts() {
        let rig = FaceRig::generate(&FaceOptions::default());
        assert!((1100..1300).contains(&rig.neutral.len()), "{}", rig.neutral.len());
        let extent = |axis: usize| {
            let c = || rig.neutral.iter().map(|p| p[axis]);
            c().fold(f64::MIN, f64::max) - c().fold(f64::MAX, f64::min)
        };
        assert!((130.0..150.0).contains(&extent(0)) && (170.0..190.0).contains(&extent(1)));
        let m = &rig.mesh.metadata;
        assert_eq!(m.corner_uvs.len(), rig.mesh.corners.len());
        assert!(m.uvs.len() > rig.neutral.len(), "the seam doubles texture coordinates");
        assert!(m.corner_uvs.iter().all(|u| (*u as usize) < m.uvs.len()));
        assert!(m.uvs.iter().flatten().all(|c| (0.0..=1.0).contains(c)));
        let count = |f: fn(&ObjStatement) -> bool| m.statements.iter().filter(|s| f(&s.1)).count();
        assert!(count(|s| matches!(s, ObjStatement::Group(_))) >= 2);
        assert!(count(|s| matches!(s, ObjStatement::Material(_))) >= 2);
        let distinct: BTreeSet<u32> = rig.landmarks.iter().map(|l| l.vertex).collect();
        assert_eq!(distinct.len(), rig.landmarks.len());
        let used: BTreeSet<u32> = rig.mesh.corners.iter().copied().collect();
        assert_eq!(used.len(), rig.neutral.len());
    }

    #[test]
    fn all_quads_face_forward_at_several_resolutions() {
        for vertices in [500, 1200, 5000] {
            let rig = FaceRig::generate(&FaceOptions { vertices });
            let surface = rig.mesh.triangulate();
            for t in &surface.triangles {
                let [a, b, c] = t.map(|v| surface.positions[v as usize]);
                assert!((b - a).cross(&(c - a)).z > 1e-3, "{vertices}: {a:?}");
            }
        }
    }

    #[test]
    fn lips_meet_in_the_neutral_and_part_when_the_jaw_opens() {
        let rig = FaceRig::generate(&FaceOptions::default());
        let grid = Grid::new(1200);
        let slit = grid.slits[0];
        let open = rig.pose(&[1.0], &[]);
        assert_eq!(rig.expressions[0].0, "jawOpen");
        let mut widest: f64 = 0.0;
        for column in slit.columns[0] + 1..slit.columns[1] {
            let [a, b] = [false, true].map(|below| grid.index(slit.row, column, below) as usize);
            assert_ne!(a, b);
            assert!((rig.neutral[a] - rig.neutral[b]).norm() < 0.2);
            widest = widest.max((open[a] - open[b]).norm());
        }
        assert!(widest >= 25.0, "{widest}");
        let eye = (rig.neutral[vertex(&rig, "lid_upper_L")] - rig.neutral[vertex(&rig, "lid_lower_L")]).norm();
        assert!(eye > 5.0, "{eye}");
    }
}
