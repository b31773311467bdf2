//! Expressions on a start.
//!
//! A mouth wide open holds the template's upper half and leaves the jaw where no correspondence finds it. So expressions are
//! tried on the pose that the search found, the best first, as long as they help; the start is then the pose of the template nearest to what they
//! make of it, as landmarks would give it.

use rayon::prelude::*;

use super::StartInput;
use super::icp::{LOOK_REACH, Matching, Problem};
use crate::mesh::adjacency::vertex_triangles;
use crate::mesh::closest_point::ClosestVertices;
use crate::mesh::{MeshError, Pose, Vec3, closest_pose};
use crate::registration::RegistrationError;
use crate::registration::surfels::Surfel;
use crate::rig::Family;

/// Vertices of the template near its surfels, and the triangles round them: what shapes deform.
pub(super) struct Expressions {
    vertices: Vec<usize>,
    triangles: Vec<Vec<[u32; 3]>>,
}

/// Vertices on which expressions are tried.
const EXPRESSION: usize = 300;
/// Weights at which they are.
const EXPRESSION_WEIGHTS: [f64; 2] = [0.5, 1.0];
/// Expressions at most, and the share of the loss that each has to take away.
const MOST_EXPRESSIONS: usize = 3;
const EXPRESSION_GAIN: f64 = 0.1;

impl Expressions {
    pub fn new(problem: &Problem<'_>, input: &StartInput<'_>) -> Result<Self, RegistrationError> {
        let unusable = |e: MeshError| RegistrationError::Template(e.to_string());
        let tree = ClosestVertices::new(&input.template.positions).map_err(unusable)?;
        let spread = problem.template.iter().take(EXPRESSION);
        let nearest = spread.filter_map(|s| tree.query(&(s.point * input.unit))).map(|c| c.vertex as usize);
        let round = vertex_triangles(input.template.positions.len(), &input.template.triangles);
        let vertices: Vec<usize> = nearest.filter(|&v| !round.row(v).is_empty()).collect();
        let triangles = vertices.iter().map(|&v| {
            let all = round.row(v).iter().map(|&t| input.template.triangles[t as usize]);
            all.collect()
        });
        Ok(Self { triangles: triangles.collect(), vertices })
    }

    /// The surfels of the template with shapes of the given weights.
    fn surfels(&self, input: &StartInput<'_>, weights: &[f64]) -> Vec<Surfel> {
        let at = |v: usize| input.shapes.blend(v, input.template.positions[v], weights) / input.unit;
        let surfel = |(&v, round): (&usize, &Vec<[u32; 3]>)| {
            let cross = |t: &[u32; 3]| {
                let [a, b, c] = t.map(|v| at(v as usize));
                (b - a).cross(&(c - a))
            };
            let normal = round.iter().map(cross).sum::<Vec3>().try_normalize(0.0).unwrap_or_default();
            Surfel { point: at(v), normal, area: 1.0 }
        };
        self.vertices.iter().zip(&self.triangles).map(surfel).collect()
    }

    /// Tries expressions one after another, each with the pose that suits it. Where any helps, `pose` becomes that of the
    /// template nearest to what they make of it.
    pub fn find(
        &self,
        problem: &Problem<'_>,
        pose: &mut Pose,
        reach: f64,
        input: &StartInput<'_>,
    ) -> Result<Vec<(String, f64)>, RegistrationError> {
        let shapes = input.shapes.shapes();
        let fitted = |weights: &[f64], mut pose: Pose| {
            if problem.cancel.is_set() {
                return (f64::INFINITY, pose);
            }
            let deformed = Problem { template: self.surfels(input, weights), ..*problem };
            let exact = |reach: f64| Matching { count: EXPRESSION, reach, exact: true };
            deformed.descend(&mut pose, Matching { count: EXPRESSION, reach: LOOK_REACH, exact: false }, 4, 0.05);
            deformed.descend(&mut pose, exact(1.5 * reach), 4, 0.05);
            (deformed.fit(&pose, exact(reach)).loss, pose)
        };
        let mut weights = vec![0.0; shapes.len()];
        let mut best = fitted(&weights, *pose);
        for _ in 0..MOST_EXPRESSIONS {
            let trials = (0..shapes.len()).filter(|&k| shapes[k].family != Family::Identity && weights[k] == 0.0);
            let trials: Vec<(usize, f64)> = trials.flat_map(|k| EXPRESSION_WEIGHTS.map(|w| (k, w))).collect();
            let ends: Vec<(f64, Pose)> = trials
                .par_iter()
                .map(|&(k, w)| {
                    let mut tried = weights.clone();
                    tried[k] = w;
                    fitted(&tried, best.1)
                })
                .collect();
            problem.cancel.check()?;
            let better = (0..ends.len()).min_by(|&a, &b| ends[a].0.total_cmp(&ends[b].0));
            let Some(i) = better.filter(|&i| ends[i].0 < (1.0 - EXPRESSION_GAIN) * best.0) else { break };
            weights[trials[i].0] = trials[i].1;
            best = ends[i];
        }
        let used: Vec<usize> = (0..shapes.len()).filter(|&k| weights[k] != 0.0).collect();
        if !used.is_empty() {
            let seen = (0..input.template.positions.len()).filter(|&v| !input.ignored[v]);
            let pair = |v: usize| {
                let rest = input.template.positions[v];
                (rest / input.unit, best.1.apply(input.shapes.blend(v, rest, &weights) / input.unit))
            };
            *pose = closest_pose(&seen.map(pair).collect::<Vec<_>>(), problem.kind)?;
        }
        Ok(used.into_iter().map(|k| (shapes[k].name.clone(), weights[k])).collect())
    }
}
