//! Seams: where two sheets of the template touch without being joined, as closed lips do.
//!
//! Closest points alone leave a gap between closed lips: their rims roll out of the scanner's sight, and each lip follows its
//! own visible side. But a scan of closed lips has surface *across* the gap, and a scan of open lips has none: at the middle
//! of a gap of width `g` the scan is nearer than `g / 2`, the distance of the lips themselves, only if the lips are closed.
//!
//! It is a guess all the same: a scanner that cannot look into a slit of 3 mm puts surface across it, too. Where landmarks stand on
//! both sides they say how far it is open, and nothing is guessed.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::PointToPoint;
use super::factory::{BuiltIn, Scheduled, Step, TermLandmark, TermLevel, TermWeight};
use super::sourced::{Source, Sourced};
use crate::correspondence::ScanSurface;
use crate::energy::{OptionTable, Options, OptionsError, Pointwise};
use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::closest_point::{ClosestVertex, ClosestVertices};
use crate::mesh::geodesic::{Reach, WeightedGraph, nearest_sources};
use crate::mesh::{MeshError, TriangleMesh, Vec3};
use crate::nlls::Kernel;

/// How much farther along the surface than a seam is wide its two sides lie.
const DETOUR: f64 = 8.0;

/// The scan spans a gap when it is nearer to the gap's middle than this share of its width.
const SPANNED: f64 = 0.3;

/// Nearest vertices among which the other side of a seam is looked for.
const NEIGHBOURS: usize = 16;

/// Pairs of vertices that touch across a seam of the rest shape.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Seams {
    pairs: Vec<Pair>,
}

/// A vertex, and the one that it touches.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pair {
    vertex: u32,
    other: u32,
    /// Their distance in the rest shape.
    rest_gap: f64,
    /// What a guess about them counts: less than 1 where landmarks tell.
    weight: f64,
}

impl Seams {
    /// For every vertex the nearest vertex within `width` that lies farther than eight times `width` along the surface, or
    /// on another part of it.
    ///
    /// # Errors
    /// When a position is not finite.
    pub fn find(rest: &TriangleMesh, width: f64) -> Result<Self, MeshError> {
        if width <= 0.0 {
            return Ok(Self::default());
        }
        let graph = WeightedGraph::euclidean(&EdgeGraph::of(rest), &rest.positions)?;
        let tree = ClosestVertices::new(&rest.positions)?;
        let scratch = || (Reach::new(&graph), Vec::new(), Vec::new());
        let across = |(reach, near, targets): &mut (Reach<'_>, Vec<ClosestVertex>, Vec<u32>),
                      (i, p): (usize, &Vec3)| {
            tree.k_nearest_within(p, NEIGHBOURS, width, near);
            targets.clear();
            targets.extend(near.iter().map(|c| c.vertex).filter(|v| *v as usize != i));
            let other = reach.first_beyond(i as u32, DETOUR * width, targets)?;
            let rest_gap = (rest.positions[other as usize] - p).norm();
            Some(Pair { vertex: i as u32, other, rest_gap, weight: 1.0 })
        };
        let found: Vec<_> = rest.positions.par_iter().enumerate().map_init(scratch, across).collect();
        Ok(Self { pairs: found.into_iter().flatten().collect() })
    }

    /// Lets pairs count less whose sides both have a landmark within `reach` along the surface: by its weight, not at all from 1 on.
    ///
    /// # Errors
    /// When a position is not finite.
    pub fn yield_to(&mut self, landmarks: &[TermLandmark], reach: f64, rest: &TriangleMesh) -> Result<(), MeshError> {
        if self.pairs.is_empty() || landmarks.is_empty() {
            return Ok(());
        }
        let tree = ClosestVertices::new(&rest.positions)?;
        let vertex = |l: &TermLandmark| match l.sample {
            vertex if vertex < rest.positions.len() => Some((vertex as u32, l.weight)),
            _ => Some((tree.query(&l.rest)?.vertex, l.weight)),
        };
        let (vertices, weights): (Vec<u32>, Vec<f64>) = landmarks.iter().filter_map(vertex).unzip();
        let graph = WeightedGraph::euclidean(&EdgeGraph::of(rest), &rest.positions)?;
        let nearest = nearest_sources(&graph, &vertices, 1);
        let told = |v: u32| {
            let near = nearest.of(v as usize).find(|(_, distance)| *distance <= reach);
            near.map_or(0.0, |(landmark, _)| weights[landmark as usize].min(1.0))
        };
        self.pairs.iter_mut().for_each(|pair| pair.weight = 1.0 - told(pair.vertex).min(told(pair.other)));
        Ok(())
    }

    /// Writes for every vertex the place that closes its seam to the width it has at rest, with the weight of its guess, where
    /// the scan spans it; weight zero elsewhere. Gaps wider than `widest` are left alone.
    pub fn targets(
        &self,
        scan: &ScanSurface,
        positions: &[Vec3],
        widest: f64,
        targets: &mut Vec<Vec3>,
        weights: &mut Vec<f64>,
    ) {
        targets.clear();
        targets.resize(positions.len(), Vec3::zeros());
        weights.clear();
        weights.resize(positions.len(), 0.0);
        for &Pair { vertex: i, other, rest_gap, weight } in &self.pairs {
            let (a, b) = (positions[i as usize], positions[other as usize]);
            let gap = (a - b).norm();
            let reach = SPANNED * gap;
            if gap <= rest_gap || gap > widest {
                continue;
            }
            if let Some(point) = scan.closest_within((a + b) / 2.0, reach) {
                targets[i as usize] = point + (a - b) * (rest_gap / 2.0 / gap);
                weights[i as usize] = weight;
            }
        }
    }
}

/// `[terms.seam]`: seams of the template, which close where the scan spans them. `[level.terms.seam]` has their weight per vertex.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SeamOptions {
    /// Vertices of the rest shape that lie nearer than this, but far apart along the surface, form a seam, millimetres; zero
    /// for no seams.
    pub width: f64,
    /// Gaps wider than this are open, millimetres.
    pub widest: f64,
    /// Where both sides of a seam have a landmark within this distance along the surface, millimetres, these say how far it is
    /// open: the guess counts less by their weight, and nothing beside one of weight 1.
    pub landmark_reach: f64,
}

impl Default for SeamOptions {
    fn default() -> Self {
        Self { width: 2.0, widest: 6.0, landmark_reach: 10.0 }
    }
}

impl OptionTable for SeamOptions {
    fn check(&self) -> Result<(), OptionsError> {
        OptionsError::not_negative("width", self.width)?;
        OptionsError::not_negative("widest", self.widest)?;
        OptionsError::not_negative("landmark_reach", self.landmark_reach)
    }
}

/// Pulls the vertices of a seam to the places that close it, without a kernel.
#[derive(Debug, Clone)]
struct Closing {
    seams: Seams,
    widest: f64,
}

impl Source for Closing {
    const MEASURES: bool = false;
}

impl Scheduled<3> for Sourced<PointToPoint, Closing> {
    fn set_level(&mut self, level: &TermLevel<'_>) -> Result<Kernel, OptionsError> {
        self.residuals.scale = level.options.read::<TermWeight>()?.weight * level.density;
        Ok(Kernel::None)
    }

    fn update(&mut self, step: &Step<'_>) -> Result<(), MeshError> {
        let PointToPoint { targets, weights, scale } = &mut self.residuals;
        if *scale > 0.0 {
            let Closing { seams, widest } = &self.source;
            seams.targets(step.scan, step.vertices, *widest, targets, weights);
            weights.iter_mut().zip(&step.masks.data).for_each(|(weight, data)| *weight *= data);
        }
        Ok(())
    }
}

pub(super) const TERM: BuiltIn = BuiltIn {
    options: Options::filled::<SeamOptions>,
    ..BuiltIn::new::<TermWeight>("seam", |input| {
        let options = input.options.read::<SeamOptions>()?;
        let mut seams = Seams::find(input.rest, options.width * input.unit)?;
        seams.yield_to(input.landmarks, options.landmark_reach * input.unit, input.rest)?;
        let source = Closing { seams, widest: options.widest * input.unit };
        Ok(Box::new(Pointwise::new("seams", Sourced { residuals: PointToPoint::default(), source }, Kernel::None)))
    })
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correspondence::ScanOptions;
    use crate::mesh::testing::{sheet, side_by_side};

    const LENGTH: f64 = 20.0;
    const ROWS: usize = 5;

    /// A strip folded over itself at x = 20: a lower sheet at z = 0, an upper one at z = `gap`, columns 21 and more.
    fn folded(gap: f64) -> TriangleMesh {
        sheet(42, ROWS, |c, r| if c <= LENGTH { Vec3::new(c, r, 0.0) } else { Vec3::new(41.0 - c, r, gap) })
    }

    /// Both vertices of every pair, and the distance that it keeps.
    fn pairs(mesh: &TriangleMesh, width: f64) -> Vec<(Vec3, Vec3, f64)> {
        let at = |v: u32| mesh.positions[v as usize];
        Seams::find(mesh, width).unwrap().pairs.iter().map(|p| (at(p.vertex), at(p.other), p.rest_gap)).collect()
    }

    /// The plane x = 0 for z from `low` to `high`.
    fn wall(low: f64, high: f64) -> TriangleMesh {
        sheet(17, 9, |c, r| Vec3::new(0.0, c - 6.0, low + (high - low) * r / 8.0))
    }

    /// Targets of the fold, opened from 1 mm to `gap`, on a scan.
    fn targets(scan: TriangleMesh, gap: f64, widest: f64) -> (Vec<Vec3>, Vec<Vec3>, Vec<f64>) {
        let seams = Seams::find(&folded(1.0), 2.0).unwrap();
        let scan = ScanSurface::new(scan, None, &ScanOptions::default()).unwrap();
        // What was there before must not survive.
        let (mut targets, mut weights) = (vec![Vec3::x()], vec![7.0]);
        let positions = folded(gap).positions;
        seams.targets(&scan, &positions, widest, &mut targets, &mut weights);
        assert_eq!((targets.len(), weights.len()), (positions.len(), positions.len()));
        (positions, targets, weights)
    }

    #[test]
    fn sheets_that_are_joined_far_away_form_pairs() {
        let found = pairs(&folded(1.0), 2.0);
        // Sixteen millimetres of detour: seven or eight to the fold, and back.
        assert!(found.iter().all(|(a, _, _)| a.x < 14.0));
        let opposite = found.iter().filter(|(a, _, _)| a.x <= 12.0);
        for (a, b, gap) in opposite.clone() {
            assert_eq!((a.xy(), (a.z - b.z).abs(), *gap), (b.xy(), 1.0, 1.0));
        }
        assert_eq!(opposite.count(), 2 * 13 * ROWS);
    }

    #[test]
    fn sheets_without_any_joint_form_pairs_everywhere() {
        let lower = sheet(6, 5, |c, r| Vec3::new(c, r, 0.0));
        let upper = sheet(6, 5, |c, r| Vec3::new(c, r, 1.5));
        let found = pairs(&side_by_side(&lower, &upper), 2.0);
        assert_eq!(found.len(), 60);
        assert!(found.iter().all(|(a, b, gap)| a.xy() == b.xy() && *gap == 1.5));
    }

    #[test]
    fn one_sheet_and_sheets_too_far_apart_form_none() {
        assert!(pairs(&sheet(20, 20, |c, r| Vec3::new(0.3 * c, 0.3 * r, 0.0)), 2.0).is_empty());
        assert!(pairs(&folded(2.1), 2.0).is_empty());
        assert_eq!(Seams::find(&folded(1.0), 0.0).unwrap(), Seams::default());
    }

    #[test]
    fn a_scan_across_the_gap_closes_it_to_its_width_at_rest() {
        let (positions, targets, weights) = targets(wall(-9.0, 11.0), 2.0, 6.0);
        for (r, row) in positions.chunks(42).enumerate() {
            let (low, high) = (r * 42, r * 42 + 41);
            assert_eq!((row[0].x, row[41].x), (0.0, 0.0));
            assert_eq!((weights[low], weights[high]), (1.0, 1.0));
            approx::assert_abs_diff_eq!(targets[low], Vec3::new(0.0, r as f64, 0.5), epsilon = 1e-12);
            approx::assert_abs_diff_eq!(targets[high], Vec3::new(0.0, r as f64, 1.5), epsilon = 1e-12);
        }
        // Farther in, the scan is nearer to neither the gap's middle nor its sides.
        assert_eq!(weights.iter().sum::<f64>(), 2.0 * ROWS as f64);
    }

    #[test]
    fn open_lips_are_left_open() {
        let lips = side_by_side(&wall(-9.0, 0.0), &wall(2.0, 11.0));
        let (_, _, weights) = targets(lips, 2.0, 6.0);
        assert!(weights.iter().all(|w| *w == 0.0));
    }

    #[test]
    fn the_rim_of_a_scan_closes_nothing() {
        // It ends at the gap's middle.
        let (_, _, weights) = targets(wall(-9.0, 1.0), 2.0, 6.0);
        assert!(weights.iter().all(|w| *w == 0.0));
    }

    #[test]
    fn where_landmarks_stand_on_both_sides_nothing_is_guessed() {
        // Column c of the lower sheet lies below column 41 - c.
        let rest = folded(1.0);
        let index = |column: usize| 2 * 42 + column;
        let at = |column, weight| {
            let rest = rest.positions[index(column)];
            TermLandmark { sample: index(column), rest, target: Vec3::zeros(), weight }
        };
        let guess = |landmarks: &[TermLandmark], column: usize| {
            let mut seams = Seams::find(&rest, 2.0).unwrap();
            seams.yield_to(landmarks, 3.0, &rest).unwrap();
            seams.pairs.iter().find(|pair| pair.vertex as usize == index(column)).unwrap().weight
        };
        let both = [at(4, 1.0), at(37, 1.0)];
        assert_eq!([4, 7, 8].map(|column| guess(&both, column)), [0.0, 0.0, 1.0]);
        assert_eq!([37, 34, 33].map(|column| guess(&both, column)), [0.0, 0.0, 1.0]);
        assert_eq!([&both[..1], &both[1..], &[]].map(|one| guess(one, 4)), [1.0; 3]);
        assert_eq!([0.0, 0.25, 4.0].map(|weight| guess(&[at(4, 1.0), at(37, weight)], 4)), [1.0, 0.75, 0.0]);
        // Inside a face it is nearest to one of its corners.
        let off = |landmark: TermLandmark| TermLandmark {
            sample: 42 * ROWS,
            rest: landmark.rest + Vec3::new(0.2, 0.2, 0.0),
            ..landmark
        };
        assert_eq!([4, 8].map(|column| guess(&both.map(off), column)), [0.0, 1.0]);
    }

    #[test]
    fn gaps_wider_than_the_widest_and_gaps_as_narrow_as_at_rest_are_left_alone() {
        for (gap, widest, closed) in [(2.0, 2.0, true), (2.0, 1.9, false), (1.0, 6.0, false), (0.5, 6.0, false)] {
            let (_, _, weights) = targets(wall(-9.0, 11.0), gap, widest);
            assert_eq!(weights.contains(&1.0), closed, "{gap} mm, widest {widest} mm");
        }
    }
}
