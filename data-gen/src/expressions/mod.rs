//! Expression blendshapes: smooth displacement fields on the skin.
//!
//! Names are ARKit's as ICT-FaceKit writes them, `_L` the subject's left; right shapes are the left ones' mirror images.

mod fields;
mod shapes;
#[cfg(test)]
mod tests;

use nonrigid::mesh::Vec3;

use crate::face::Site;
use fields::{keep_off_eyeballs, lids};
use shapes::{SHAPES, Shape, Sides};

/// A named displacement field on the skin, at weight 1.
pub(crate) struct Expression {
    pub name: String,
    shape: &'static Shape,
    mirrored: bool,
}

impl Expression {
    /// Millimetres.
    pub fn displacement(&self, site: &Site) -> Vec3 {
        if self.mirrored {
            let d = self.shape.displacement(&site.mirrored());
            Vec3::new(-d.x, d.y, d.z)
        } else {
            self.shape.displacement(site)
        }
    }
}

impl Shape {
    /// Of the left or only one of the shape's twins.
    fn displacement(&self, site: &Site) -> Vec3 {
        keep_off_eyeballs(site, (self.pull)(site)) + lids(site, self.close)
    }
}

/// All expressions, in this order always.
pub(crate) fn expressions() -> Vec<Expression> {
    let mut all = Vec::new();
    for shape in &SHAPES {
        let twins: &[(String, bool)] = &match shape.sides {
            Sides::One => vec![(shape.name.to_owned(), false)],
            Sides::Suffixed => vec![(format!("{}_L", shape.name), false), (format!("{}_R", shape.name), true)],
            Sides::Named => vec![(format!("{}Left", shape.name), false), (format!("{}Right", shape.name), true)],
        };
        all.extend(twins.iter().map(|(name, mirrored)| Expression { name: name.clone(), shape, mirrored: *mirrored }));
    }
    all
}
