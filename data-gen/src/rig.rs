//! The rig at one resolution: template, shapes, landmarks and regions per vertex.

use nonrigid::mesh::{ObjMetadata, ObjStatement, PolygonMesh, Vec3};
use rayon::prelude::*;

use crate::face::{Eyeball, FaceModel, FaceWeights, Flat, LANDMARKS, Layout, REGIONS, Site, region, site};

/// How the face is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceOptions {
    /// Number of vertices aimed at, 1,000 to 500,000; default 5,000. The layout comes as close as it can.
    pub vertices: usize,
    /// Number of identity modes; default 60.
    pub identity_modes: usize,
}

impl Default for FaceOptions {
    fn default() -> Self {
        Self { vertices: 5000, identity_modes: 60 }
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
    /// Name and vertices of each region; every vertex belongs to one.
    pub regions: Vec<(String, Vec<u32>)>,
    /// Place of each vertex on the flat face.
    pub places: Vec<Flat>,
    /// The same face at any resolution.
    pub model: FaceModel,
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
        let landmarks = landmarks(&places);
        Self { mesh, neutral, expressions, identities, landmarks, regions, places, model }
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

    /// The eyeballs of a person, left and right.
    #[must_use]
    pub fn eyeballs(&self, identity_weights: &[f64]) -> [Eyeball; 2] {
        self.model.eyeballs(&FaceWeights { expressions: Vec::new(), identity: identity_weights.to_vec() })
    }
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
