//! Identity modes: smooth ways in which faces differ, orthogonal to each other, each scaled by its standard deviation.

use nonrigid::mesh::Vec3;

use crate::face::bell;

/// Root mean square displacement of the first mode, millimetres, and the ratio from one mode to the next.
const FIRST_RMS: f64 = 3.0;
const DECAY: f64 = 0.78;

/// `count` modes (8 at most) of falling variance, orthogonalised in this order, so that they are the principal components
/// of the faces they make.
pub(crate) fn modes(neutral: &[Vec3], count: usize) -> Vec<Vec<Vec3>> {
    let fields: [fn(&Vec3) -> Vec3; 8] = [
        // wide or narrow
        |p| Vec3::new(p.x, 0.0, 0.0),
        // long or short
        |p| Vec3::new(0.0, p.y, 0.0),
        // deep or flat
        |p| Vec3::new(0.0, 0.0, p.x.abs() - 30.0 + 8.0 * (p.y / 60.0)),
        // jaw broad or pointed
        |p| Vec3::new(p.x * bell(p.y + 65.0, 28.0), 0.0, 0.0),
        // nose large or small
        |p| {
            let near = bell(p.x, 13.0) * bell(p.y - 2.0, 17.0);
            Vec3::new(0.5 * p.x, -2.0, 9.0) * near
        },
        // chin forward or receding
        |p| Vec3::new(0.0, -2.0, 6.0) * bell(p.x, 26.0) * bell(p.y + 72.0, 20.0),
        // cheeks full or hollow
        |p| {
            let near = bell(p.x.abs() - 42.0, 15.0) * bell(p.y + 12.0, 18.0);
            Vec3::new(3.0 * (p.x / 15.0).tanh(), 0.0, 5.0) * near
        },
        // brow heavy or light
        |p| Vec3::new(0.0, -1.5, 5.0) * bell(p.x.abs() - 22.0, 18.0) * bell(p.y - 50.0, 11.0),
    ];
    let dot = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
    let mut modes: Vec<Vec<Vec3>> = Vec::new();
    for (k, field) in fields.iter().take(count).enumerate() {
        let mut mode: Vec<Vec3> = neutral.iter().map(field).collect();
        let mean = mode.iter().sum::<Vec3>() / mode.len() as f64;
        mode.iter_mut().for_each(|d| *d -= mean);
        for earlier in &modes {
            let share = dot(&mode, earlier) / dot(earlier, earlier);
            mode.iter_mut().zip(earlier).for_each(|(d, e)| *d -= e * share);
        }
        let rms = (dot(&mode, &mode) / mode.len() as f64).sqrt();
        let scale = FIRST_RMS * DECAY.powi(k as i32) / rms;
        mode.iter_mut().for_each(|d| *d *= scale);
        modes.push(mode);
    }
    modes
}

#[cfg(test)]
mod tests {
    use crate::{FaceOptions, FaceRig};
    use nonrigid::evaluation::flipped_triangles;

    #[test]
    fn variances_fall_and_no_mode_folds_the_face() {
        let rig = FaceRig::generate(&FaceOptions::default());
        assert_eq!(rig.identities.len(), 8);
        let variance: Vec<f64> = rig.identities.iter().map(|m| m.iter().map(|d| d.norm_squared()).sum()).collect();
        assert!(variance.windows(2).all(|v| v[1] < 0.9 * v[0]), "{variance:?}");
        let triangles = rig.mesh.triangulate().triangles;
        for k in 0..8 {
            for weight in [-2.0, 2.0] {
                let mut weights = [0.0; 8];
                weights[k] = weight;
                let moved = rig.pose(&[], &weights);
                assert_eq!(flipped_triangles(&rig.neutral, &moved, &triangles), Ok(0), "mode {k} at {weight}");
            }
        }
    }
}
