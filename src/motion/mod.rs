//! The registered frames of a sequence as one motion: [lost frames](lost) are found, and what flickers between the others is
//! [smoothed](smooth).
//!
//! Each frame's scan has noise of its own, and so has each result: played, it shimmers. What tells noise from motion is time: a frame
//! is expected to continue the motion of those before and after it.

pub mod lost;
pub mod smooth;

use crate::mesh::Vec3;

/// What a sequence's frames became.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// Positions of every frame.
    pub frames: Vec<Vec<Vec3>>,
    /// Of every frame, why it is lost, if it is.
    pub lost: Vec<Option<Lost>>,
    /// Frames at which the motion begins anew.
    pub cuts: Vec<usize>,
}

/// Why a frame is lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lost {
    /// There is none.
    Missing,
    /// It lies so many millimetres (root mean square) from where the frames round it lead.
    Jump(f64),
}

/// Why frames are no sequence.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MotionError {
    /// All are missing.
    #[error("every frame of the sequence is missing")]
    Nothing,
    /// Vertices are not one for one.
    #[error("frame {frame} has {found} vertices, the first one {expected}")]
    VertexCount {
        /// Which one, from 0.
        frame: usize,
        /// As the first has.
        expected: usize,
        /// As it has.
        found: usize,
    },
}

impl Track {
    /// Follows frames, `None` where one is missing. Missing frames, and with a cutoff (in frames^-1, see [`smooth::strength`]) those that
    /// jump, are bridged by the motion of those round them, before the first and after the last by it standing still; with a cutoff
    /// all are smoothed. Without one the others stay, bit for bit, those that jump as well. What lies on both sides of a cut is
    /// followed by itself.
    ///
    /// # Errors
    /// When there is no frame, or they have different numbers of vertices.
    pub fn follow(frames: Vec<Option<Vec<Vec3>>>, cutoff: Option<f64>) -> Result<Self, MotionError> {
        let first = frames.iter().flatten().next().ok_or(MotionError::Nothing)?.len();
        let other = frames.iter().enumerate().find_map(|(k, f)| Some((k, f.as_ref()?.len())).filter(|f| f.1 != first));
        if let Some((frame, found)) = other {
            return Err(MotionError::VertexCount { frame, expected: first, found });
        }
        let lost::Jumps { off: jumps, cuts } = lost::jumps(&frames);
        let lost: Vec<Option<Lost>> = (0..frames.len())
            .map(|k| if frames[k].is_none() { Some(Lost::Missing) } else { jumps[k].map(Lost::Jump) })
            .collect();
        let trusted: Vec<bool> = lost
            .iter()
            .map(|lost| match lost {
                None => true,
                Some(Lost::Missing) => false,
                Some(Lost::Jump(_)) => cutoff.is_none(),
            })
            .collect();
        let mut left: Vec<Vec<Vec3>> =
            frames.into_iter().map(|f| f.unwrap_or_else(|| vec![Vec3::zeros(); first])).collect();
        let mut parts: Vec<Vec<Vec<Vec3>>> = cuts.iter().rev().map(|&cut| left.split_off(cut)).collect();
        parts.push(left);
        let mut frames = Vec::with_capacity(lost.len());
        for part in parts.into_iter().rev() {
            let trusted = &trusted[frames.len()..][..part.len()];
            frames.extend(followed(part, trusted, cutoff));
        }
        Ok(Self { frames, lost, cuts })
    }

    /// Numbers of the lost frames, from 0.
    #[must_use]
    pub fn lost_frames(&self) -> Vec<usize> {
        (0..self.lost.len()).filter(|&k| self.lost[k].is_some()).collect()
    }
}

/// Frames without a cut, smoothed with a cutoff, or else bridged where they are not trusted.
fn followed(frames: Vec<Vec<Vec3>>, trusted: &[bool], cutoff: Option<f64>) -> Vec<Vec<Vec3>> {
    match cutoff {
        Some(cutoff) => smooth::smoothed(frames, trusted, smooth::strength(cutoff)),
        None if trusted.contains(&false) => {
            let bridged = smooth::smoothed(frames.clone(), trusted, BRIDGE);
            frames.into_iter().zip(bridged).zip(trusted).map(|((g, b), keep)| if *keep { g } else { b }).collect()
        }
        None => frames,
    }
}

/// Strength that all but interpolates the frames that are there.
const BRIDGE: f64 = 1e-6;

/// How much frames flicker: root mean square of the vertices' second differences in time, millimetres; of errors against truth, what
/// is not in the true motion. 0 for fewer than three frames.
#[must_use]
pub fn flicker(frames: &[impl AsRef<[Vec3]>]) -> f64 {
    let squares = |k: usize| -> f64 {
        let [before, at, after]: [&[Vec3]; 3] = [k - 2, k - 1, k].map(|k| frames[k].as_ref());
        let second = |v: usize| before[v] - at[v] * 2.0 + after[v];
        (0..at.len()).map(|v| second(v).norm_squared()).sum::<f64>() / at.len() as f64
    };
    let all: Vec<f64> = (2..frames.len()).map(squares).collect();
    if all.is_empty() { 0.0 } else { (all.iter().sum::<f64>() / all.len() as f64).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::noise;

    /// Twenty points that sway and turn, and noise.
    fn frames(count: usize, sigma: f64) -> Vec<Vec<Vec3>> {
        let point = |k: usize, v: usize| {
            let (t, v) = (k as f64 * 0.1, v as f64);
            let at = |a: f64| sigma * 3f64.sqrt() * noise(1 + (10_000.0 * a + 300.0 * v) as usize + 7919 * k);
            Vec3::new(30.0 * (t + 0.1 * v).sin() + at(1.0), 5.0 * v + at(2.0), 20.0 * (0.7 * t).cos() + at(3.0))
        };
        (0..count).map(|k| (0..20).map(|v| point(k, v)).collect()).collect()
    }

    fn rms(a: &[Vec<Vec3>], b: &[Vec<Vec3>]) -> f64 {
        let squares = a.iter().zip(b).flat_map(|(a, b)| a.iter().zip(b)).map(|(p, q)| (p - q).norm_squared());
        (squares.sum::<f64>() / (a.len() * a[0].len()) as f64).sqrt()
    }

    fn errors(a: &[Vec<Vec3>], b: &[Vec<Vec3>]) -> Vec<Vec<Vec3>> {
        a.iter().zip(b).map(|(a, b)| a.iter().zip(b).map(|(p, q)| p - q).collect()).collect()
    }

    fn given(frames: &[Vec<Vec3>]) -> Vec<Option<Vec<Vec3>>> {
        frames.iter().cloned().map(Some).collect()
    }

    #[test]
    fn noise_goes_and_motion_stays() {
        let (truth, noisy) = (frames(60, 0.0), frames(60, 0.5));
        let before = (rms(&noisy, &truth), flicker(&errors(&noisy, &truth)));
        let track = Track::follow(given(&noisy), Some(4.0 / 60.0)).unwrap();
        let after = (rms(&track.frames, &truth), flicker(&errors(&track.frames, &truth)));
        assert!(after.0 < 0.6 * before.0 && after.1 < 0.05 * before.1, "{before:?} {after:?}");
        assert!(track.lost_frames().is_empty());
        let still = Track::follow(given(&truth), Some(4.0 / 60.0)).unwrap();
        assert!(rms(&still.frames, &truth) < 0.1, "{}", rms(&still.frames, &truth));
        assert_eq!(Track::follow(given(&noisy), None).unwrap().frames, noisy);
    }

    #[test]
    fn lost_frames_are_found_and_bridged_and_the_others_are_not_lost() {
        let truth = frames(60, 0.0);
        let mut given = given(&frames(60, 0.3));
        for (k, by) in [(0, 9.0), (20, 8.0), (30, 25.0), (31, 25.0), (32, 24.0), (59, 12.0)] {
            given[k].as_mut().unwrap().iter_mut().for_each(|p| p.y += by);
        }
        given[10] = None;
        given[45] = None;
        given[46] = None;
        for cutoff in [Some(4.0 / 60.0), None] {
            let track = Track::follow(given.clone(), cutoff).unwrap();
            assert_eq!(track.lost_frames(), [0, 10, 20, 30, 31, 32, 45, 46, 59]);
            assert!(
                matches!((track.lost[10], track.lost[20]), (Some(Lost::Missing), Some(Lost::Jump(by))) if (by - 8.0).abs() < 1.0)
            );
            let off: Vec<f64> = (0..60).map(|k| rms(&track.frames[k..=k], &truth[k..=k])).collect();
            let bridged = |k: usize| off[k] < 1.0;
            assert!([10, 45, 46].into_iter().all(bridged), "{off:?}");
            assert_eq!([20, 30, 31, 32].into_iter().all(bridged), cutoff.is_some(), "{off:?}");
            // at the ends it stands still: one frame's motion away
            assert_eq!(off[0] < 4.0 && off[59] < 4.0, cutoff.is_some(), "{off:?}");
        }
    }

    #[test]
    fn a_cut_loses_no_frame_and_is_not_smoothed_over() {
        let truth: Vec<Vec<Vec3>> = frames(60, 0.0);
        let moved = |frames: Vec<Vec<Vec3>>, by: f64| -> Vec<Vec<Vec3>> {
            let aside = |(k, f): (usize, Vec<Vec3>)| {
                f.into_iter().map(|p| p + Vec3::y() * if k < 25 { 0.0 } else { by }).collect()
            };
            frames.into_iter().enumerate().map(aside).collect()
        };
        for by in [8.0, 15.0, 60.0] {
            let truth = moved(truth.clone(), by);
            let mut noisy = given(&moved(frames(60, 0.3), by));
            let track = Track::follow(noisy.clone(), Some(4.0 / 60.0)).unwrap();
            assert_eq!((track.lost_frames(), &track.cuts[..]), (vec![], &[25][..]), "{by}");
            let off: Vec<f64> = (0..60).map(|k| rms(&track.frames[k..=k], &truth[k..=k])).collect();
            assert!(off.iter().all(|off| *off < 0.8), "{by}: {off:?}");
            // a frame that is off near it is lost, and one that is missing stays on its side
            let missing = if by > 20.0 { 24 } else { 22 }; // less across a missing frame is a fast motion
            noisy[missing] = None;
            noisy[30].as_mut().unwrap().iter_mut().for_each(|p| p.x += 20.0);
            let track = Track::follow(noisy, Some(4.0 / 60.0)).unwrap();
            assert_eq!((track.lost_frames(), &track.cuts[..]), (vec![missing, 30], &[25][..]), "{by}");
            let off: Vec<f64> = (0..60).map(|k| rms(&track.frames[k..=k], &truth[k..=k])).collect();
            // the missing one stands still: one frame's motion away
            assert!(off.iter().all(|off| *off < 4.0), "{by}: {off:?}");
        }
    }

    #[test]
    fn few_frames_are_a_sequence_too_and_none_are_not() {
        let some = given(&frames(3, 0.3));
        for count in 1..=3 {
            let track = Track::follow(some[..count].to_vec(), Some(0.1)).unwrap();
            assert!(track.frames.len() == count && track.frames.iter().flatten().flatten().all(|x| x.is_finite()));
        }
        let gap = Track::follow(vec![some[0].clone(), None, None], Some(0.1)).unwrap();
        assert_eq!(gap.frames[2], gap.frames[0]);
        assert_eq!(Track::follow(vec![None, None], None), Err(MotionError::Nothing));
        let error = Track::follow(vec![some[0].clone(), Some(vec![Vec3::zeros()])], None).unwrap_err();
        assert_eq!(error.to_string(), "frame 1 has 1 vertices, the first one 20");
    }
}
