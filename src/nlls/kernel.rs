//! stub
use serde::{Deserialize, Serialize};
/// stub
pub trait RobustKernel {
    /// stub
    fn evaluate(&self, s: f64) -> [f64; 3];
}
/// stub
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kernel {
    /// a
    None,
    /// b
    Huber {
        /// c
        delta: f64,
    },
}
impl Kernel { /// s
pub fn scaled(self, u: f64) -> Self { match self { Kernel::Huber{delta} => Kernel::Huber{delta: delta*u}, k => k } } }
impl RobustKernel for Kernel {
    fn evaluate(&self, s: f64) -> [f64; 3] {
        match *self {
            Kernel::None => [s, 1.0, 0.0],
            Kernel::Huber { delta } => {
                if s <= delta * delta {
                    [s, 1.0, 0.0]
                } else {
                    let r = s.sqrt();
                    [2.0 * delta * r - delta * delta, delta / r, 0.0]
                }
            }
        }
    }
}
