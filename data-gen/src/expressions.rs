//! Expression blendshapes: smooth local displacement fields, discontinuous only across the slits of mouth and eyes.

use nonrigid::mesh::Vec3;

use crate::face::{EYE, Flat, LID_OPENING, MOUTH, MOUTH_HALF_WIDTH, bell};

/// Name and delta per vertex, in this order always.
pub(crate) fn all(flat: &[Flat], neutral: &[Vec3]) -> Vec<(String, Vec<Vec3>)> {
    type Field = Box<dyn Fn(&Flat, &Vec3) -> Vec3>;
    let mut fields: Vec<(String, Field)> = vec![("jawOpen".into(), Box::new(jaw_open))];
    for (suffix, sign) in [("L", 1.0), ("R", -1.0)] {
        fields.push((format!("mouthSmile_{suffix}"), Box::new(move |_, p| smile(p, sign))));
        fields.push((format!("browDown_{suffix}"), Box::new(move |_, p| brow_down(p, sign))));
        fields.push((format!("eyeBlink_{suffix}"), Box::new(move |f, p| blink(f, p, sign))));
    }
    fields.push(("mouthPucker".into(), Box::new(|_, p| pucker(p))));
    fields.push(("browInnerUp".into(), Box::new(|_, p| brow_inner_up(p))));
    fields.push(("cheekPuff".into(), Box::new(|_, p| cheek_puff(p))));
    fields.push(("jawLeft".into(), Box::new(|f, p| Vec3::new(8.0, 0.0, -0.02 * p.x) * jaw(f, p))));
    fields.push(("noseSneer".into(), Box::new(|_, p| nose_sneer(p))));
    fields
        .into_iter()
        .map(|(name, field)| (name, flat.iter().zip(neutral).map(|(f, p)| field(f, p)).collect()))
        .collect()
}

/// Share of a vertex in the jaw's motion: 0 above the mouth, 1 below, one half beside its corners.
fn jaw(flat: &Flat, p: &Vec3) -> f64 {
    let below = 0.5 - 0.5 * (1.7 * flat.mouth).tanh();
    // Skin far beside the mouth hangs on the skull.
    below * (0.35 + 0.65 * bell((p.x.abs() - 20.0).max(0.0), 28.0))
}

/// Rotation by 21 degrees about an axis through the ears.
fn jaw_open(flat: &Flat, p: &Vec3) -> Vec3 {
    let (y, z) = (p.y - 2.0, p.z + 12.0);
    let (sin, cos) = f64::to_radians(21.0).sin_cos();
    Vec3::new(0.0, cos * y - sin * z - y, sin * y + cos * z - z) * jaw(flat, p)
}

fn smile(p: &Vec3, side: f64) -> Vec3 {
    let near = bell(p.x - side * MOUTH_HALF_WIDTH, 15.0) * bell(p.y - MOUTH[1], 14.0);
    let cheek = bell(p.x - side * 44.0, 13.0) * bell(p.y + 12.0, 12.0);
    Vec3::new(7.0 * side, 6.5, -3.0) * near + Vec3::new(1.0 * side, 2.5, 3.0) * cheek
}

fn brow_down(p: &Vec3, side: f64) -> Vec3 {
    let near = bell(p.x - side * 25.0, 16.0) * bell(p.y - 48.0, 9.0);
    Vec3::new(-2.5 * side, -5.5, 1.0) * near
}

/// The upper lid comes down onto the lower one.
fn blink(flat: &Flat, p: &Vec3, side: f64) -> Vec3 {
    if p.x * side <= 0.0 || flat.eye <= 0.0 {
        return Vec3::zeros();
    }
    let height = (p.y - EYE[1] - LID_OPENING[0] * flat.eye.min(1.0)).max(0.0);
    let near = bell(p.x - side * EYE[0], 13.0) * bell(height, 7.5);
    let travel = 0.96 * (LID_OPENING[0] + LID_OPENING[1]) * flat.eye.min(1.0);
    Vec3::new(0.0, -travel, 0.16 * travel) * near
}

fn pucker(p: &Vec3) -> Vec3 {
    let near = bell(p.x, 24.0) * bell(p.y - MOUTH[1], 14.0);
    Vec3::new(-0.36 * p.x, -0.12 * (p.y - MOUTH[1]), 7.0) * near
}

fn brow_inner_up(p: &Vec3) -> Vec3 {
    Vec3::new(0.0, 7.0, 0.5) * bell((p.x.abs() - 8.0).max(0.0), 12.0) * bell(p.y - 52.0, 12.0)
}

fn cheek_puff(p: &Vec3) -> Vec3 {
    let near = bell(p.x.abs() - 42.0, 14.0) * bell(p.y + 26.0, 16.0);
    Vec3::new(6.0 * (p.x / 15.0).tanh(), 0.0, 8.0) * near
}

fn nose_sneer(p: &Vec3) -> Vec3 {
    let wing = bell(p.x.abs() - 13.0, 8.0) * bell(p.y + 10.0, 9.0);
    let lip = bell(p.x.abs() - 15.0, 9.0) * bell(p.y + 27.0, 6.0);
    Vec3::new(0.0, 4.5, 1.5) * wing + Vec3::new(0.0, 2.0, 1.0) * lip
}

#[cfg(test)]
mod tests {
    use crate::{FaceOptions, FaceRig};
    use nonrigid::evaluation::flipped_triangles;

    #[test]
    fn every_expression_moves_something_locally_and_folds_nothing() {
        for vertices in [700, 1200, 4000] {
            check(&FaceRig::generate(&FaceOptions { vertices }));
        }
    }

    fn check(rig: &FaceRig) {
        assert_eq!(rig.expressions.len(), 12);
        let triangles = rig.mesh.triangulate().triangles;
        for (k, (name, delta)) in rig.expressions.iter().enumerate() {
            let largest = delta.iter().map(|d| d.norm()).fold(0.0, f64::max);
            assert!(largest > 3.0 && largest < 45.0, "{name}: {largest}");
            let still = delta.iter().filter(|d| d.norm() < 0.05 * largest).count();
            assert!(still * 4 > delta.len(), "{name} moves everything");
            let mut weights = vec![0.0; 12];
            weights[k] = 1.0;
            let moved = rig.pose(&weights, &[]);
            assert_eq!(flipped_triangles(&rig.neutral, &moved, &triangles), Ok(0), "{name}");
        }
    }

    #[test]
    fn left_and_right_mirror_each_other() {
        let rig = FaceRig::generate(&FaceOptions::default());
        for name in ["mouthSmile", "browDown", "eyeBlink"] {
            let total = |suffix: &str| -> f64 {
                let shape = rig.expressions.iter().find(|e| e.0 == format!("{name}_{suffix}")).unwrap();
                shape.1.iter().map(|d| d.norm()).sum()
            };
            assert!((total("L") - total("R")).abs() < 1e-6 * total("L"), "{name}: {} {}", total("L"), total("R"));
        }
    }
}
