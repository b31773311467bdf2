//! The pose by landmarks: closed form, without the landmarks that stray, and of another size only where no expression explains it and,
//! if shapes may make the subject of another size, it is far from the template's.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix};

use super::{OTHER_SIZE, StartInput, StartOptions};
use crate::landmark::Landmark;
use crate::mesh::adjacency::EdgeGraph;
use crate::mesh::closest_point::ClosestVertices;
use crate::mesh::{Pose, PoseKind, Vec3, rms_size, weighted_closest_pose};
use crate::registration::RegistrationError;
use crate::rig::Family;

/// By how much a template differs from another person at a landmark, millimetres.
const MISMATCH: f64 = 4.0;
/// By how much the size of some landmarks differs from that of the whole face, in its logarithm: people's proportions differ, however
/// many landmarks there are.
const UNLIKE_SIZE: f64 = 0.03;
/// Landmarks that a similarity leaves off by more than this share of their spread say nothing of a size.
const NO_FACE: f64 = 0.2;
/// A landmark is suspect if its way differs from that of each of its nearest ones by so many millimetres and so much of their distance.
/// What is closed, such as a body, may bend at joints: there the lengths between landmarks are compared, and not their ways.
const STRAY: f64 = 25.0;
const STRAY_SLOPE: f64 = 0.25;
const NEAREST: usize = 3;
/// Nearest ones of which one must have gone the same way: of an open mouth's lip the other lip has the three nearest.
const AROUND: usize = 6;
/// Such a subject is bent if a similarity leaves the landmarks off by more than this share of their spread.
const BENT: f64 = 0.1;
/// More than this share of the landmarks cannot be suspect: then nothing says which are right.
const MOST_SUSPECTS: f64 = 0.25;
/// Landmarks are mirrored if their mirror image fits so many times better, and they are off by so many millimetres.
const MIRRORED: f64 = 2.0;
const MIRRORED_RMS: f64 = 6.0;

/// What landmarks say of the start.
pub(super) struct LandmarkPose {
    pub pose: Pose,
    /// Which of them took no part: their numbers and distances, the farthest first.
    pub suspects: Vec<(usize, f64)>,
    /// How much the others [scatter](super::LandmarkStart::scatter); of what bends, nothing says that.
    pub scatter: f64,
}

/// The pose by landmarks.
pub(super) fn landmark_pose(
    input: &StartInput<'_>,
    kind: PoseKind,
    options: &StartOptions,
) -> Result<LandmarkPose, RegistrationError> {
    let all = input.landmarks;
    let fit = |kept: &[usize], kind: PoseKind, sigma: f64| {
        weighted_closest_pose(kept.iter().map(|&i| (all[i].0, all[i].1.target, all[i].1.weight(sigma))), kind)
    };
    let of_scale = |scale: f64, kept: &[usize]| -> Result<Pose, RegistrationError> {
        let pairs = kept.iter().map(|&i| (all[i].0 * scale, all[i].1.target, all[i].1.weight(scale * input.sigma)));
        Ok(Pose { scale, ..weighted_closest_pose(pairs, PoseKind::Rigid)? })
    };
    // What is closed, such as a body, may bend at joints.
    let bends = EdgeGraph::of(input.template).is_closed();
    let by_kind = |kept: &[usize]| -> Result<Pose, RegistrationError> {
        let similar = fit(kept, PoseKind::Similarity, input.sigma)?;
        let spread = rms_size(&kept.iter().map(|&i| all[i].0).collect::<Vec<_>>());
        let square = |&i: &usize| (similar.apply(all[i].0) - all[i].1.target).norm_squared();
        let rms = (kept.iter().map(square).sum::<f64>() / kept.len() as f64).sqrt();
        let bent = (bends && rms > BENT * spread * similar.scale).then(|| size_by_lengths(input, kept)).flatten();
        let (mut free, spread) = match bent {
            None => (similar, spread),
            Some((scale, length)) => (of_scale(scale, kept)?, length / std::f64::consts::SQRT_2),
        };
        let doubt = MISMATCH * input.unit / (spread.max(f64::MIN_POSITIVE) * (kept.len() as f64).sqrt());
        // Without shapes of identity nothing else makes a template larger or smaller: its vertices slide over the scan instead.
        let is_open = input.size_is_open && !bends && {
            let weight = |&i: &usize| all[i].1.weight(input.sigma);
            let total: f64 = kept.iter().map(weight).sum();
            let mean = |of: &dyn Fn(&usize) -> f64| kept.iter().map(|i| weight(i) * of(i)).sum::<f64>() / total;
            let centre = kept.iter().map(|i| all[*i].0 * weight(i)).sum::<Vec3>() / total;
            mean(&square).sqrt() <= NO_FACE * similar.scale * mean(&|&i| (all[i].0 - centre).norm_squared()).sqrt()
        };
        let least = if is_open { 2.0 * doubt.max(UNLIKE_SIZE) } else { OTHER_SIZE.max(3.0 * doubt) };
        let other_size = |pose: &Pose| options.scale_sigma > 0.0 && pose.scale.ln().abs() > least;
        if kind == PoseKind::Similarity && bent.is_none() {
            return Ok(fit(kept, kind, free.scale * input.sigma)?);
        }
        if !(0.5..=2.0).contains(&free.scale) {
            return Err(RegistrationError::Scale { scale: free.scale });
        }
        if kind == PoseKind::Similarity {
            return Ok(free);
        }
        if other_size(&free) && bent.is_none() {
            let expressive = expressive_similarity(input, kept)?;
            if expressive.scale.ln().abs() < free.scale.ln().abs() {
                free = expressive;
            }
        }
        if !other_size(&free) {
            return Ok(fit(kept, kind, input.sigma)?);
        }
        if !is_open {
            return Ok(free);
        }
        // the mean of the prior times what the landmarks say
        let [prior, found] = [options.scale_sigma, UNLIKE_SIZE].map(|sigma| sigma * sigma);
        of_scale(free.scale.powf(prior / (prior + found)), kept)
    };
    // Of the mirrored template, turned about: whatever the plane.
    let check_mirrored = |kept: &[usize], pose: &Pose| -> Result<(), RegistrationError> {
        let rms = |pose: &Pose, sign: f64| {
            let away = |&i: &usize| {
                let p = Vec3::new(sign * all[i].0.x, all[i].0.y, all[i].0.z);
                (pose.apply(p) - all[i].1.target).norm_squared()
            };
            (kept.iter().map(away).sum::<f64>() / kept.len() as f64).sqrt()
        };
        let mirrored = kept.iter().map(|&i| {
            let p = all[i].0;
            (Vec3::new(-p.x, p.y, p.z), all[i].1.target, all[i].1.weight(input.sigma))
        });
        if let (true, Ok(mirrored)) = (kept.len() > 3, weighted_closest_pose(mirrored, PoseKind::Similarity)) {
            let (rms, reflected) = (rms(pose, 1.0), rms(&mirrored, -1.0));
            if rms > MIRRORED * reflected && rms > MIRRORED_RMS * input.unit * pose.scale {
                return Err(RegistrationError::Mirrored { rms, reflected });
            }
        }
        Ok(())
    };
    let mut kept: Vec<usize> = (0..all.len()).collect();
    let mut pose = by_kind(&kept)?;
    // Of few landmarks with the other side's names, those of the midline seem to stray.
    check_mirrored(&kept, &pose)?;
    let mut suspects = Vec::new();
    while let Some((i, _)) = stray(input, &kept, &pose, bends) {
        kept.retain(|k| *k != i);
        suspects.push(i);
        if suspects.len() as f64 > MOST_SUSPECTS * all.len() as f64 || kept.len() < 3 {
            (kept, suspects) = ((0..all.len()).collect(), Vec::new());
            pose = by_kind(&kept)?;
            break;
        }
        pose = by_kind(&kept)?;
    }
    check_mirrored(&kept, &pose)?;
    let mut suspects: Vec<(usize, f64)> =
        suspects.into_iter().map(|i| (i, (pose.apply(all[i].0) - all[i].1.target).norm())).collect();
    suspects.sort_by(|a, b| b.1.total_cmp(&a.1));
    let scatter = if bends { 1.0 } else { scatter(input, &kept, &pose) };
    Ok(LandmarkPose { pose, suspects, scatter })
}

/// How many times as long the ways from landmarks to their nearest ones are on the scan as on the template, and how long they are there,
/// both in the median: where joints bend they stay. `None` where landmarks coincide.
fn size_by_lengths(input: &StartInput<'_>, kept: &[usize]) -> Option<(f64, f64)> {
    let ways = kept.iter().zip(nearest(input, kept, NEAREST)).flat_map(|(&a, near)| {
        let (p, l) = input.landmarks[a];
        near.into_iter().map(move |b| {
            let (q, m) = input.landmarks[b];
            ((l.target - m.target).norm(), (p - q).norm())
        })
    });
    let apart = ways.filter(|(on_scan, on_template)| *on_scan > 0.0 && *on_template > 0.0);
    let (mut ratios, mut lengths): (Vec<f64>, Vec<f64>) =
        apart.map(|(scan, template)| (scan / template, template)).unzip();
    let middle = ratios.len() / 2;
    let median = |of: &mut [f64]| *of.select_nth_unstable_by(middle, f64::total_cmp).1;
    (!ratios.is_empty()).then(|| (median(&mut ratios), median(&mut lengths)))
}

/// For each of `kept` so many of them that are nearest to it on the template.
fn nearest(input: &StartInput<'_>, kept: &[usize], count: usize) -> Vec<Vec<usize>> {
    let at: Vec<Vec3> = kept.iter().map(|&i| input.landmarks[i].0).collect();
    let Ok(tree) = ClosestVertices::new(&at) else { return vec![Vec::new(); kept.len()] };
    let mut found = Vec::new();
    let of = |(a, p): (usize, &Vec3)| {
        tree.k_nearest(p, count + 1, &mut found);
        let others = found.iter().map(|f| f.vertex as usize).filter(|&b| b != a);
        others.take(count).map(|b| kept[b]).collect()
    };
    at.iter().enumerate().map(of).collect()
}

/// As many landmarks say how much they scatter.
const MANY: usize = 8;
/// Over so much of the distance between two landmarks people differ from the template.
const UNLIKE_SLOPE: f64 = 0.1;
/// Median of how far a normal deviate of three dimensions lies from the nearest of [`NEAREST`] others, in standard deviations.
const LIKEST: f64 = 1.488;

/// How many times as much as they say, in the median, `kept` landmarks are off, each otherwise than those next to it by more than
/// people differ over the way between them: a shape that lacks something is off alike there. 1 where they are few.
fn scatter(input: &StartInput<'_>, kept: &[usize], pose: &Pose) -> f64 {
    if kept.len() < MANY {
        return 1.0;
    }
    let way = |i: usize| input.landmarks[i].1.target - pose.apply(input.landmarks[i].0);
    let unlike = |(&a, near): (&usize, Vec<usize>)| {
        let (p, l) = input.landmarks[a];
        let over = |b: usize| {
            let by_shape = UNLIKE_SLOPE * (p - input.landmarks[b].0).norm() * pose.scale;
            (way(a) - way(b)).norm_squared() - by_shape.powi(2)
        };
        let least = near.into_iter().map(over).fold(f64::INFINITY, f64::min);
        least.max(0.0).sqrt() / l.sigma.unwrap_or(input.sigma * pose.scale)
    };
    let mut unlike: Vec<f64> = kept.iter().zip(nearest(input, kept, NEAREST)).map(unlike).collect();
    let middle = unlike.len() / 2;
    *unlike.select_nth_unstable_by(middle, f64::total_cmp).1 / LIKEST
}

/// Rounds in which pose and expression follow each other, at most, and the change of the scale that ends them.
const ROUNDS: usize = 50;
const SAME_SCALE: f64 = 1e-4;

/// The similarity that landmarks ask for where expressions may move the template's: an open mouth is no larger face. Minimises, over
/// pose and weights `w`, the sum of `|T^-1(t_i) - p_i - D_i w|^2 / MISMATCH^2` and of `(w_k / sigma_k)^2`, by turns.
fn expressive_similarity(input: &StartInput<'_>, kept: &[usize]) -> Result<Pose, RegistrationError> {
    let (all, shapes) = (input.landmarks, input.shapes);
    let expressions: Vec<usize> =
        (0..shapes.len()).filter(|&k| shapes.shapes()[k].family != Family::Identity).collect();
    let sigma = MISMATCH * input.unit;
    let mut motion = DMatrix::<f64>::zeros(3 * kept.len(), expressions.len());
    for (row, &i) in kept.iter().enumerate() {
        for (v, share) in all[i].1.template.corners() {
            for (column, &k) in expressions.iter().enumerate() {
                let displacement = shapes.displacement(v as usize, k);
                (0..3).for_each(|axis| motion[(3 * row + axis, column)] += share * displacement[axis] / sigma);
            }
        }
    }
    let prior = DVector::from_iterator(expressions.len(), expressions.iter().map(|&k| shapes.sigmas()[k].powi(-2)));
    let solver = (motion.tr_mul(&motion) + DMatrix::from_diagonal(&prior)).cholesky();
    let mut moved = DVector::<f64>::zeros(3 * kept.len());
    let fit = |moved: &DVector<f64>| {
        let pair = |(row, &i): (usize, &usize)| {
            let (p, l) = all[i];
            (p + moved.fixed_rows::<3>(3 * row), l.target, l.weight(input.sigma))
        };
        weighted_closest_pose(kept.iter().enumerate().map(pair), PoseKind::Similarity)
    };
    let mut pose = fit(&moved)?;
    let Some(solver) = solver.filter(|_| !expressions.is_empty()) else { return Ok(pose) };
    for _ in 0..ROUNDS {
        let mut left = DVector::<f64>::zeros(3 * kept.len());
        for (row, &i) in kept.iter().enumerate() {
            let (p, l) = all[i];
            let back = pose.rotation.transpose() * (l.target - pose.translation) / pose.scale;
            left.fixed_rows_mut::<3>(3 * row).copy_from(&((back - p) / sigma));
        }
        moved = &motion * solver.solve(&motion.tr_mul(&left)) * sigma;
        let before = std::mem::replace(&mut pose, fit(&moved)?);
        if (pose.scale / before.scale).ln().abs() < SAME_SCALE {
            break;
        }
    }
    Ok(pose)
}

/// The landmark that differs most from its nearest ones, of those that differ too much. A jaw that opens moves all that is near.
fn stray(input: &StartInput<'_>, kept: &[usize], pose: &Pose, bends: bool) -> Option<(usize, f64)> {
    if kept.len() < 5 {
        return None;
    }
    let way = |i: usize| input.landmarks[i].1.target - pose.apply(input.landmarks[i].0);
    let excess = |(&a, near): (&usize, Vec<usize>)| {
        let (p, l) = input.landmarks[a];
        let over = |b: usize| {
            let (q, m) = input.landmarks[b];
            let apart = (p - q).norm() * pose.scale;
            let differs = if bends { ((l.target - m.target).norm() - apart).abs() } else { (way(a) - way(b)).norm() };
            differs - STRAY_SLOPE * apart
        };
        let least = (STRAY * input.unit * pose.scale).max(4.0 * l.sigma.unwrap_or(0.0));
        (a, near.into_iter().map(over).fold(f64::INFINITY, f64::min) - least)
    };
    let around = nearest(input, kept, if bends { NEAREST } else { AROUND });
    let worst = kept.iter().zip(around).map(excess).filter(|w| w.1 > 0.0);
    worst.max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))
}

/// Predicted root mean square error of a pose by landmarks at the template's vertices.
pub(super) fn deviation(input: &StartInput<'_>, landmarks: &[(Vec3, &Landmark)], pose: &Pose) -> f64 {
    let jacobian = |p: Vec3| {
        let arm = pose.rotation * (p - input.centre) * pose.scale;
        let turn = -arm.cross_matrix();
        let mut j = SMatrix::<f64, 3, 6>::zeros();
        j.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        j.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
        j
    };
    let scale = input.unit * pose.scale;
    let mut information = SMatrix::<f64, 6, 6>::zeros();
    for (p, l) in landmarks {
        let j = jacobian(*p);
        let own = l.sigma.unwrap_or(input.sigma * pose.scale);
        information += j.tr_mul(&j) / (own * own + (MISMATCH * scale).powi(2));
    }
    let Some(covariance) = information.try_inverse() else { return f64::INFINITY };
    let vertices = input.template.surface_points();
    let variance = |p: &Vec3| {
        let j = jacobian(p + input.centre);
        (j * covariance * j.transpose()).trace()
    };
    (vertices.iter().map(variance).sum::<f64>() / vertices.len().max(1) as f64).max(0.0).sqrt()
}
