//! How far lids and lips are open, against the truth.

use serde::{Deserialize, Serialize};

use crate::mesh::Vec3;

/// Pairs of the 68 landmarks of Multi-PIE/iBUG, from 0, whose distance is how far an eye is open: upper lid, lower lid.
const LIDS: [[usize; 2]; 4] = [[37, 41], [38, 40], [43, 47], [44, 46]];
/// The same of the inner lips.
const LIPS: [[usize; 2]; 3] = [[61, 67], [62, 66], [63, 65]];

/// Mean of |aperture of the result - true aperture|, millimetres; an aperture is the distance of a landmark on the upper lid or lip
/// from the one below it. Whether the scan shows these vertices makes no difference: who looks at an eye sees how far it is open.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ApertureErrors {
    /// Over two pairs at each eye; `None` for a rig without the 68 landmarks.
    pub eye_aperture: Option<f64>,
    /// Over three pairs at the inner lips.
    pub lip_aperture: Option<f64>,
}

impl ApertureErrors {
    /// Compares `result` with `truth`, both in the template's vertex order; `landmarks` are the rig's
    /// ([`Rig::landmarks`](crate::rig::Rig::landmarks)).
    #[must_use]
    pub fn new(result: &[Vec3], truth: &[Vec3], landmarks: &[u32]) -> Self {
        let error = |pair: &[usize; 2]| {
            let [a, b] = [landmarks.get(pair[0])?, landmarks.get(pair[1])?].map(|v| *v as usize);
            let aperture = |points: &[Vec3]| Some((points.get(a)? - points.get(b)?).norm());
            Some((aperture(result)? - aperture(truth)?).abs())
        };
        let mean = |pairs: &[[usize; 2]]| {
            let errors: Option<Vec<f64>> = pairs.iter().map(error).collect();
            errors.map(|errors| errors.iter().sum::<f64>() / errors.len() as f64)
        };
        Self { eye_aperture: mean(&LIDS), lip_aperture: mean(&LIPS) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eyes_too_far_open_and_lips_apart_are_told_in_millimetres() {
        let truth: Vec<Vec3> = (0..68).map(|i| Vec3::new(f64::from(i), 0.0, 0.0)).collect();
        let landmarks: Vec<u32> = (0..68).collect();
        let mut result = truth.clone();
        [37, 38, 43, 44].into_iter().for_each(|v: usize| result[v].x -= 2.0);
        result[62].x += 3.0; // one of three pairs of lips, nearer to each other
        result.iter_mut().for_each(|p| p.y += 7.0); // where the face lies is another matter
        let errors = ApertureErrors::new(&result, &truth, &landmarks);
        assert_eq!((errors.eye_aperture, errors.lip_aperture), (Some(2.0), Some(1.0)));
        assert_eq!(ApertureErrors::new(&truth, &truth, &landmarks[..20]), ApertureErrors::default());
    }
}
