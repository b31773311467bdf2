//! stub
use num_dual::DualNum;
/// stub
pub fn exp_times<D: DualNum<Primitive = f64> + Copy>(w: [D; 3], r: &[f64; 9]) -> [[D; 3]; 3] {
    let t2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
    let (a, b) = if t2.re() < 1e-8 {
        (D::from(1.0) - t2 / 6.0, D::from(0.5) - t2 / 24.0)
    } else {
        let t = t2.sqrt();
        (t.sin() / t, (D::from(1.0) - t.cos()) / t2)
    };
    let e: [[D; 3]; 3] = std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let skew = match (i, j) {
                (0, 1) => -w[2],
                (0, 2) => w[1],
                (1, 0) => w[2],
                (1, 2) => -w[0],
                (2, 0) => -w[1],
                (2, 1) => w[0],
                _ => D::from(0.0),
            };
            let d = if i == j { D::from(1.0) - b * t2 } else { D::from(0.0) };
            d + a * skew + b * w[i] * w[j]
        })
    });
    std::array::from_fn(|i| std::array::from_fn(|j| e[i][0] * r[j] + e[i][1] * r[3 + j] + e[i][2] * r[6 + j]))
}
/// stub
pub fn retract(r: &[f64; 9], w: [f64; 3]) -> [f64; 9] {
    let m = exp_times(w, r);
    std::array::from_fn(|k| m[k / 3][k % 3])
}
