//! Expression blendshapes: smooth local displacement fields.

use nonrigid::mesh::Vec3;

use crate::face::Site;

type Field = Box<dyn Fn(&Site) -> Vec3 + Send + Sync>;

/// A named displacement field on the skin, at weight 1.
pub(crate) struct Expression {
    pub name: String,
    field: Field,
}

impl Expression {
    fn new(name: impl Into<String>, field: impl Fn(&Site) -> Vec3 + Send + Sync + 'static) -> Self {
        Self { name: name.into(), field: Box::new(field) }
    }

    /// Millimetres.
    pub fn displacement(&self, site: &Site) -> Vec3 {
        (self.field)(site)
    }
}

/// All expressions, in this order always.
pub(crate) fn expressions() -> Vec<Expression> {
    vec![Expression::new("jawOpen", |s| {
        let below = 0.5 - 0.5 * s.mouth.eta.sin();
        let (y, z) = (s.neutral.y + 8.0, s.neutral.z + 75.0);
        let (sin, cos) = 26f64.to_radians().sin_cos();
        Vec3::new(0.0, cos * y - sin * z - y, sin * y + cos * z - z) * below
    })]
}
