//! The rig at one resolution: template, shapes, landmarks and regions per vertex.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use anyhow::Context as _;
use nonrigid::mesh::{ObjMetadata, ObjStatement, PolygonMesh, Vec3};
use nonrigid::rig::{Family, Rig, RigError, RigReadOptions, Shape};
use rayon::prelude::*;

use crate::face::{
    ANTHROPOMETRIC, Eyeball, FaceModel, FaceWeights, Flat, LANDMARKS, Layout, REGIONS, Site, region, site,
};

/// How the face is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceOptions {
    /// Number of vertices aimed at, 1,000 to 500,000 (others count as the nearest of these); default 5,000. The layout comes
    /// as close as it can, within a few per cent.
    pub vertices: usize,
    /// Number of identity modes; default 100. There are 268: more than that count as all of them.
    pub identity_modes: usize,
}

impl Default for FaceOptions {
    fn default() -> Self {
        Self { vertices: 5000, identity_modes: 100 }
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

/// A template face with everything that a fit may use of it, and the continuous face behind it.
#[derive(Clone)]
pub struct FaceRig {
    /// The template: quads, UVs, groups and materials, at the neutral positions.
    pub mesh: PolygonMesh,
    /// The neutral positions.
    pub neutral: Vec<Vec3>,
    /// Name and delta per vertex: position = neutral + weight x delta, weights 0 to 1.
    pub expressions: Vec<(String, Vec<Vec3>)>,
    /// Delta per vertex of each mode, scaled by its standard deviation: weights ~ N(0, 1). Falling variance.
    pub identities: Vec<Vec<Vec3>>,
    /// The 68 Multi-PIE/iBUG landmarks in their order.
    pub landmarks: Vec<Landmark>,
    /// The landmarks that `nonrigid measure` knows: midline, left ones, right ones. Vertices on the two sides mirror each other.
    pub anthropometric: Vec<Landmark>,
    /// Name and vertices of each region; every vertex belongs to one.
    pub regions: Vec<(String, Vec<u32>)>,
    /// Place of each vertex on the generated face's plane; of a rig that was read none.
    pub places: Vec<Flat>,
    /// The same face at any resolution; `None`: the rig was read.
    pub model: Option<Arc<FaceModel>>,
}

impl FaceRig {
    /// Makes the rig. Deterministic: there is no randomness in it.
    #[must_use]
    pub fn generate(options: &FaceOptions) -> Self {
        let Layout { flat: places, quads } = Layout::new(options.vertices.clamp(1000, 500_000));
        let sites: Vec<Site> = places.par_iter().map(|p| site(*p)).collect();
        let neutral: Vec<Vec3> = sites.iter().map(|s| s.neutral).collect();
        let model = FaceModel::new(options.identity_modes);
        let names: Vec<String> = model.expression_names().map(str::to_owned).collect();
        let expressions =
            names.into_iter().enumerate().map(|(k, name)| (name, model.expression_deltas(k, &sites))).collect();
        let identities = model.identity_deltas(&sites);
        let region_of: Vec<usize> = sites.iter().map(region).collect();
        let mut regions: Vec<(String, Vec<u32>)> = REGIONS.iter().map(|r| (r.to_string(), Vec::new())).collect();
        for (v, r) in region_of.iter().enumerate() {
            regions[*r].1.push(v as u32);
        }
        let mesh = template(&places, &neutral, quads, &model);
        let (landmarks, anthropometric) = (landmarks(&places), anthropometric(&places));
        Self {
            mesh,
            neutral,
            expressions,
            identities,
            landmarks,
            anthropometric,
            regions,
            places,
            model: Some(Arc::new(model)),
        }
    }

    /// The template's vertices at these weights; missing weights are 0 and superfluous ones are ignored.
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

    /// A rig of any kind that `nonrigid` reads, to be scanned. `mouthClose` is left out: it only goes with an open jaw.
    ///
    /// # Errors
    /// When it cannot be read, or has no triangles.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let (rig, _) = Rig::read(path, &RigReadOptions::default())?;
        let mesh = rig.mesh().with_context(|| format!("{}: the rig has no triangles to scan", path.display()))?;
        let (mut expressions, mut identities) = (Vec::new(), Vec::new());
        for (k, shape) in rig.shapes().iter().enumerate().filter(|(_, s)| s.name != "mouthClose") {
            let deltas =
                rig.deltas(k).chunks_exact(3).map(|d| Vec3::new(d[0].into(), d[1].into(), d[2].into())).collect();
            match shape.family {
                Family::Identity => identities.push(deltas),
                _ => expressions.push((shape.name.clone(), deltas)),
            }
        }
        let numbered = |(k, vertex): (usize, &u32)| Landmark { name: k.to_string(), vertex: *vertex };
        let landmarks = match rig.landmarks() {
            Some(all) => all.iter().enumerate().map(numbered).collect(),
            None => named_landmarks(&path.join("landmarks.json"), rig.neutral().len())?,
        };
        Ok(Self {
            mesh: mesh.clone(),
            neutral: rig.neutral().to_vec(),
            expressions,
            identities,
            landmarks,
            anthropometric: Vec::new(),
            regions: Vec::new(),
            places: Vec::new(),
            model: None,
        })
    }

    /// The rig as a fit reads it from files, in 32 bits: the expressions, then the identity modes `identity000` and so on.
    ///
    /// # Errors
    /// When two expressions have one name.
    pub fn to_rig(&self) -> Result<Rig, RigError> {
        let expressions = self.expressions.iter().map(|(name, d)| (name.clone(), Family::Expression, d));
        let modes = self.identities.iter().enumerate().map(|(k, d)| (format!("identity{k:03}"), Family::Identity, d));
        let (mut shapes, mut deltas) = (Vec::new(), Vec::new());
        for (name, family, delta) in expressions.chain(modes) {
            shapes.push(Shape { name, family });
            deltas.extend(delta.iter().flat_map(|d| [d.x as f32, d.y as f32, d.z as f32]));
        }
        Ok(Rig::new(self.neutral.clone(), Some(self.mesh.clone()), shapes, deltas)?.0)
    }

    /// The eyeballs of a person, left and right; of a rig that was read none are known.
    #[must_use]
    pub fn eyeballs(&self, identity_weights: &[f64]) -> Option<[Eyeball; 2]> {
        let weights = FaceWeights { expressions: Vec::new(), identity: identity_weights.to_vec() };
        self.model.as_ref().map(|model| model.eyeballs(&weights))
    }
}

/// The landmarks of a rig that is no face, `{"name": vertex, ...}`, in the order of their names; none where there is no such file.
fn named_landmarks(path: &Path, vertices: usize) -> anyhow::Result<Vec<Landmark>> {
    if !path.is_file() {
        return Ok(Vec::new());
    }
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let named: BTreeMap<String, u32> = serde_json::from_str(&text)
        .with_context(|| format!("{}: expected {{\"name\": vertex, ...}}", path.display()))?;
    if let Some((name, vertex)) = named.iter().find(|(_, v)| **v as usize >= vertices) {
        anyhow::bail!("{}: {name:?} is vertex {vertex}, but there are {vertices}", path.display());
    }
    Ok(named.into_iter().map(|(name, vertex)| Landmark { name, vertex }).collect())
}

/// Quads sorted by region, with a texture coordinate per vertex: its place on the flat face.
fn template(places: &[Flat], neutral: &[Vec3], quads: Vec<[u32; 4]>, model: &FaceModel) -> PolygonMesh {
    let mut quads: Vec<(usize, [u32; 4])> = quads
        .into_iter()
        .map(|q| {
            let middle = [0, 1].map(|k| q.iter().map(|v| places[*v as usize][k]).sum::<f64>() / 4.0);
            (region(&site(middle)), q)
        })
        .collect();
    quads.sort_by_key(|q| q.0);

    let axis = |k: usize, pick: fn(f64, f64) -> f64| model.outline().iter().map(|p| p[k]).reduce(pick).unwrap_or(0.0);
    let (low, high) = ([axis(0, f64::min), axis(1, f64::min)], [axis(0, f64::max), axis(1, f64::max)]);
    let size = 1.02 * (high[0] - low[0]).max(high[1] - low[1]);
    let uv = |p: &Flat| [0, 1].map(|k| 0.5 + (p[k] - 0.5 * (low[k] + high[k])) / size);

    let mut statements = vec![(0, ObjStatement::Object("face".into())), (0, ObjStatement::Smoothing("1".into()))];
    let mut before = None;
    for (k, (region, _)) in quads.iter().enumerate() {
        if before != Some(*region) {
            before = Some(*region);
            let name = REGIONS[*region];
            statements.push((k as u32, ObjStatement::Group(name.into())));
            let material = if name == "lips" { "lips" } else { "skin" };
            statements.push((k as u32, ObjStatement::Material(material.into())));
        }
    }
    let corners: Vec<u32> = quads.iter().flat_map(|q| q.1).collect();
    let metadata = ObjMetadata {
        uvs: places.iter().map(uv).collect(),
        corner_uvs: corners.clone(),
        corner_normals: Vec::new(),
        material_libraries: vec!["face.mtl".into()],
        statements,
    };
    let starts = (0..=quads.len() as u32).map(|k| 4 * k).collect();
    PolygonMesh { positions: neutral.to_vec(), starts, corners, metadata }
}

/// The vertex nearest to each landmark that is not another one's already.
fn landmarks(places: &[Flat]) -> Vec<Landmark> {
    let mut taken = vec![false; places.len()];
    LANDMARKS
        .iter()
        .map(|(name, side, mark)| {
            let [x, y] = mark.flat();
            let off = |v: &usize| (places[*v][0] - side * x).powi(2) + (places[*v][1] - y).powi(2);
            let free = (0..places.len()).filter(|v| !taken[*v]);
            let vertex = free.min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0);
            taken[vertex] = true;
            Landmark { name: (*name).to_owned(), vertex: vertex as u32 }
        })
        .collect()
}

/// The vertex nearest to each landmark of anthropometry, and the one on the right to each on the left.
fn anthropometric(places: &[Flat]) -> Vec<Landmark> {
    let nearest = |[x, y]: Flat, midline: bool| {
        let off = |v: &usize| (places[*v][0] - x).powi(2) + (places[*v][1] - y).powi(2);
        let possible = (0..places.len()).filter(|v| !midline || places[*v][0] == 0.0);
        possible.min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
    };
    let landmark = |name: String, vertex: usize| Landmark { name, vertex: vertex as u32 };
    let named =
        ANTHROPOMETRIC.map(|(name, mark)| landmark(name.to_owned(), nearest(mark.flat(), !name.ends_with("_left"))));
    let right: Vec<Landmark> = named
        .iter()
        .filter_map(|left| {
            let [x, y] = places[left.vertex as usize];
            Some(landmark(format!("{}_right", left.name.strip_suffix("_left")?), nearest([-x, y], false)))
        })
        .collect();
    named.into_iter().chain(right).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn rig(vertices: usize) -> FaceRig {
        FaceRig::generate(&FaceOptions { vertices, ..FaceOptions::default() })
    }

    #[test]
    fn landmarks_by_name_are_vertices_that_exist() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("landmarks.json");
        assert_eq!(named_landmarks(&path, 9).unwrap(), []);
        std::fs::write(&path, r#"{"toe": 8, "hip": 2}"#).unwrap();
        let of = |name: &str, vertex| Landmark { name: name.to_owned(), vertex };
        assert_eq!(named_landmarks(&path, 9).unwrap(), [of("hip", 2), of("toe", 8)]);
        let message = |vertices| named_landmarks(&path, vertices).unwrap_err().to_string();
        assert!(message(8).ends_with("\"toe\" is vertex 8, but there are 8"), "{}", message(8));
        std::fs::write(&path, "[1, 2]").unwrap();
        assert!(message(9).contains("expected {\"name\": vertex, ...}"), "{}", message(9));
    }

    #[test]
    fn the_template_has_the_size_of_a_face_with_texture_groups_and_materials() {
        let rig = rig(5000);
        let extent = |axis: usize| {
            let c = || rig.neutral.iter().map(|p| p[axis]);
            c().fold(f64::MIN, f64::max) - c().fold(f64::MAX, f64::min)
        };
        assert!(
            (125.0..150.0).contains(&extent(0)) && (180.0..210.0).contains(&extent(1)),
            "{} {}",
            extent(0),
            extent(1)
        );
        let front = rig.neutral.iter().max_by(|a, b| a.z.total_cmp(&b.z)).unwrap();
        assert!(front.x == 0.0 && (-41.0..-35.0).contains(&front.y), "the nose's tip is in front: {front}");
        let m = &rig.mesh.metadata;
        assert!(m.uvs.len() == rig.neutral.len() && m.corner_uvs == rig.mesh.corners);
        assert!(m.uvs.iter().flatten().all(|c| (0.0..=1.0).contains(c)));
        let group = |s: &&(u32, ObjStatement)| matches!(&s.1, ObjStatement::Group(_));
        assert_eq!(m.statements.iter().filter(group).count(), REGIONS.len());
        let all: BTreeSet<u32> = rig.regions.iter().flat_map(|r| r.1.iter().copied()).collect();
        assert!(all.len() == rig.neutral.len() && rig.regions.iter().all(|r| r.1.len() > 30));
        let landmarks: BTreeSet<u32> = rig.landmarks.iter().map(|l| l.vertex).collect();
        assert_eq!(landmarks.len(), 68);
    }

    #[test]
    fn it_is_its_own_mirror_image() {
        let rig = rig(1000);
        let twin = |p: &Vec3| Vec3::new(-p.x, p.y, p.z);
        let nearest = |p: Vec3| rig.neutral.iter().map(|q| (p - q).norm()).fold(f64::INFINITY, f64::min);
        assert!(rig.neutral.iter().all(|p| nearest(twin(p)) < 1e-9));
        let at =
            |name: &str| rig.anthropometric.iter().find(|l| l.name == name).map(|l| rig.neutral[l.vertex as usize]);
        assert_eq!(rig.anthropometric.len(), 25);
        for landmark in &rig.anthropometric {
            let place = at(&landmark.name).unwrap();
            match landmark.name.strip_suffix("_left") {
                Some(stem) => assert!((at(&format!("{stem}_right")).unwrap() - twin(&place)).norm() < 1e-9, "{stem}"),
                None => assert!(landmark.name.ends_with("_right") || place.x == 0.0, "{}", landmark.name),
            }
        }
    }

    #[test]
    fn lips_meet_with_vertices_of_their_own_and_the_eyes_are_open() {
        for vertices in [1000, 5000, 20_000] {
            let rig = rig(vertices);
            let sites: Vec<Site> = rig.places.iter().map(|p| site(*p)).collect();
            let line = |upper: bool| -> Vec<Vec3> {
                let on_line = sites.iter().filter(|s| s.mouth.r.abs() < 1e-6 && s.mouth.eta.sin().abs() > 1e-6);
                on_line.filter(|s| (s.mouth.eta > 0.0) == upper).map(|s| s.neutral).collect()
            };
            let (upper, lower) = (line(true), line(false));
            assert!(upper.len() > 10 && lower.len() > 10);
            // Distance to the other lip's line of vertices.
            let to_line = |p: &Vec3, line: &[Vec3]| {
                let to_segment = |a: &Vec3, b: &Vec3| {
                    let t = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
                    (a + (b - a) * t - p).norm()
                };
                line.windows(2).map(|w| to_segment(&w[0], &w[1])).fold(f64::INFINITY, f64::min)
            };
            let by_x = |mut line: Vec<Vec3>| {
                line.sort_by(|a, b| a.x.total_cmp(&b.x));
                line
            };
            let lower = by_x(lower);
            let inner = upper.iter().filter(|p| p.x.abs() < 24.0);
            let widest = inner.map(|p| to_line(p, &lower)).fold(0.0, f64::max);
            assert!(widest < 0.2, "{vertices}: lips are {widest} mm apart");
            let lid = |name: &str| rig.neutral[rig.landmarks.iter().find(|l| l.name == name).unwrap().vertex as usize];
            let open = (lid("eye_L_upper_inner") - lid("eye_L_lower_inner")).norm();
            assert!((6.0..12.0).contains(&open), "{open}");
        }
    }

    #[test]
    fn quads_are_small_at_lips_and_eyelids_and_large_at_forehead_and_cheeks() {
        let rig = rig(5000);
        let mean_edge = |name: &str| {
            let region: BTreeSet<u32> = rig.regions.iter().find(|r| r.0 == name).unwrap().1.iter().copied().collect();
            let quads = rig.mesh.corners.chunks_exact(4).filter(|q| q.iter().all(|v| region.contains(v)));
            let edges = quads.flat_map(|q| (0..4).map(|k| [q[k], q[(k + 1) % 4]]));
            let lengths: Vec<f64> =
                edges.map(|[a, b]| (rig.neutral[a as usize] - rig.neutral[b as usize]).norm()).collect();
            lengths.iter().sum::<f64>() / lengths.len() as f64
        };
        for (fine, coarse) in [("lips", "cheeks"), ("eyelids", "cheeks"), ("lips", "forehead"), ("eyelids", "forehead")]
        {
            assert!(
                1.5 * mean_edge(fine) < mean_edge(coarse),
                "{fine} {coarse}: {} {}",
                mean_edge(fine),
                mean_edge(coarse)
            );
        }
    }

    #[test]
    fn the_neutral_is_smooth_and_no_triangle_is_degenerate_or_folded() {
        for vertices in [1000, 5000, 50_000] {
            let rig = rig(vertices);
            let surface = rig.mesh.triangulate();
            // At the corners of mouth and eyes the two sides of the opening meet like the pages of a book.
            let corner = |v: u32| {
                let site = site(rig.places[v as usize]);
                [site.mouth, site.left_eye, site.right_eye].iter().any(|a| a.r < 1.5 && a.eta.sin().abs() < 0.35)
            };
            let normal = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|v| surface.positions[v as usize]);
                (b - a).cross(&(c - a))
            };
            let normals: Vec<Vec3> = surface.triangles.iter().map(normal).collect();
            assert!(normals.iter().all(|n| n.norm() > 1e-5), "{vertices}: a triangle without area");
            let mut sides = std::collections::BTreeMap::new();
            let mut steep = 0;
            for (t, n) in surface.triangles.iter().zip(&normals) {
                for k in 0..3 {
                    let edge = (t[k].min(t[(k + 1) % 3]), t[k].max(t[(k + 1) % 3]));
                    if let Some(other) = sides.insert(edge, n.normalize()) {
                        let cosine: f64 = n.normalize().dot(&other);
                        let bends = cosine.acos().to_degrees();
                        let at = surface.positions[edge.0 as usize];
                        let inner = corner(edge.0) || corner(edge.1);
                        assert!(inner || bends < 110.0, "{vertices}: a fold of {bends:.0} degrees at {at}");
                        steep += usize::from(cosine < 0.5);
                    }
                }
            }
            assert!(steep * 25 < normals.len(), "{vertices}: {steep} edges bend by more than 60 degrees");
        }
    }
}
