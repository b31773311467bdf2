//! The table of the shapes.

use nonrigid::mesh::Vec3;

use super::fields::{
    along, crease, lower_lip, open_jaw, part_lips, pull, pull_both, purse, roll, slides_with_jaw, upper_lip, wrinkles,
};
use crate::face::{Site, bell, fade};

/// Whether a shape has a mirror image, and how the two are called.
#[derive(Clone, Copy)]
pub(super) enum Sides {
    /// Symmetric, or anyway only one.
    One,
    /// `_L` and `_R`.
    Suffixed,
    /// `Left` and `Right`.
    Named,
}

/// A shape; of two twins the left one.
pub(super) struct Shape {
    pub name: &'static str,
    pub sides: Sides,
    /// By which shares of the eye's opening upper and lower lid close.
    pub close: [f64; 2],
    /// All else, millimetres.
    pub pull: fn(&Site) -> Vec3,
}

const fn one(name: &'static str, pull: fn(&Site) -> Vec3) -> Shape {
    Shape { name, sides: Sides::One, close: [0.0; 2], pull }
}

const fn pair(name: &'static str, pull: fn(&Site) -> Vec3) -> Shape {
    Shape { name, sides: Sides::Suffixed, close: [0.0; 2], pull }
}

const fn left_right(name: &'static str, pull: fn(&Site) -> Vec3) -> Shape {
    Shape { name, sides: Sides::Named, close: [0.0; 2], pull }
}

const fn eye(name: &'static str, close: [f64; 2], pull: fn(&Site) -> Vec3) -> Shape {
    Shape { name, sides: Sides::Suffixed, close, pull }
}

/// The left corner of the mouth, in the chart.
const CORNER: [f64; 2] = [25.5, -68.0];

pub(super) const SHAPES: [Shape; 31] = [
    // Corrugator and procerus.
    pair("browDown", |s| {
        pull(s, [22.0, 19.0], [15.0, 8.5], [-2.5, -6.5, 0.8])
            + pull(s, [8.0, 16.0], [6.0, 8.0], [-1.0, -2.5, 0.8])
            + crease(s, [6.0, 12.0], [8.0, 26.0], 2.5, 1.2)
    }),
    // Frontalis, its inner part.
    pair("browInnerUp", |s| {
        pull(s, [13.0, 23.0], [11.5, 15.0], [1.0, 7.5, 0.6]) + wrinkles(s, [11.0, 42.0], [12.0, 9.0], [0.0, 10.0], 0.6)
    }),
    // Frontalis, its outer part.
    pair("browOuterUp", |s| {
        pull(s, [42.0, 21.0], [14.0, 14.0], [0.5, 8.0, 0.5]) + wrinkles(s, [38.0, 42.0], [13.0, 9.0], [0.0, 10.0], 0.5)
    }),
    // Air blows up the cheek; buccinator gives way.
    pair("cheekPuff", |s| {
        pull(s, [47.0, -66.0], [16.0, 17.0], [0.0, 0.0, 11.5])
            + pull(s, [20.0, -56.0], [9.0, 7.0], [0.0, 0.0, 3.0])
            + pull(s, [20.0, -82.0], [9.0, 7.0], [0.0, 0.0, 3.0])
    }),
    // Orbicularis oculi, its outer ring, lifts the whole cheek.
    eye("cheekRaiser", [0.04, 0.14], |s| {
        pull(s, [36.0, -30.0], [15.0, 12.0], [0.5, 5.5, 3.0])
            + wrinkles(s, [57.0, -3.0], [7.0, 9.0], [2.0, 9.0], 0.5)
            + crease(s, [24.0, -52.0], [31.0, -64.0], 4.0, 0.8)
    }),
    // Its upper part, under the eye.
    eye("cheekSquint", [0.02, 0.22], |s| {
        pull(s, [35.0, -19.0], [13.0, 7.5], [0.0, 3.6, 2.2]) + wrinkles(s, [54.0, -5.0], [6.0, 7.0], [2.0, 8.0], 0.35)
    }),
    eye("eyeBlink", [0.79, 0.2], |s| pull(s, [32.0, 14.0], [14.0, 6.0], [0.0, -0.8, 0.0])),
    // The lids follow the eyeball; the cornea lifts them a little.
    eye("eyeLookDown", [0.42, -0.12], |_| Vec3::zeros()),
    eye("eyeLookIn", [0.0, 0.0], |s| look_aside(s, -3.5)),
    eye("eyeLookOut", [0.0, 0.0], |s| look_aside(s, 3.5)),
    eye("eyeLookUp", [-0.16, 0.12], |s| pull(s, [32.0, 20.0], [15.0, 7.0], [0.0, 0.8, 0.0])),
    eye("eyeSquint", [0.12, 0.32], |s| {
        pull(s, [34.0, -15.0], [13.0, 6.0], [0.0, 1.6, 1.0])
            + pull(s, [32.0, 17.0], [14.0, 6.0], [0.0, -1.5, 0.2])
            + wrinkles(s, [54.0, -2.0], [5.5, 7.0], [2.0, 8.0], 0.35)
    }),
    // Levator palpebrae.
    eye("eyeWide", [-0.26, -0.1], |s| pull(s, [32.0, 19.0], [15.0, 7.0], [0.0, 1.2, 0.0])),
    one("jawForward", |s| Vec3::new(0.0, -3.0, 8.5) * slides_with_jaw(s)),
    left_right("jaw", |s| Vec3::new(8.0, -2.5, 0.0) * slides_with_jaw(s)),
    // Depressors of the jaw; the corners of the mouth come nearer to each other.
    one("jawOpen", |s| {
        open_jaw(s, 27.5, Vec3::new(0.0, -3.0, 10.0)) + pull_both(s, CORNER, [9.0, 12.0], [-3.5, 0.0, 0.0])
    }),
    // Buccinator draws the corner back.
    pair("mouthDimple", |s| {
        pull(s, CORNER, [9.0, 8.0], [5.0, 1.0, -2.5])
            + pull(s, [34.0, -67.0], [3.5, 5.0], [0.0, 0.0, -2.0])
            + pull(s, [41.0, -66.0], [5.0, 8.0], [0.0, 0.0, 1.5])
    }),
    // Depressor anguli oris.
    pair("mouthFrown", |s| {
        pull(s, CORNER, [10.5, 11.0], [1.0, -9.0, -0.5])
            + crease(s, [29.0, -72.0], [31.0, -90.0], 3.0, 1.5)
            + pull(s, [0.0, -84.0], [12.0, 7.0], [0.0, 1.0, 0.8])
    }),
    // Orbicularis oris, lips apart and turned out.
    one("mouthFunnel", |s| {
        purse(s, 0.42, 7.5, 19.0)
            + part_lips(s, 7.5, 11.0)
            + roll(s, [-14.0, -16.0])
            + pull(s, [0.0, -68.0], [4.0, 7.0], [0.0, 0.9, 0.0])
    }),
    left_right("mouth", |s| {
        pull(s, [2.0, -68.0], [27.0, 16.0], [9.0, 0.0, 0.0]) + pull(s, [36.0, -62.0], [10.0, 13.0], [0.0, 1.0, 2.0])
    }),
    // Depressor labii inferioris.
    pair("mouthLowerDown", |s| {
        let lip = lower_lip(s, 12.0) * bell(s.x - 12.0, 10.0);
        along(s, [2.0, -8.5, 0.8]) * lip + roll(s, [0.0, -8.0]) * fade(s.x / 10.0)
    }),
    // Both lips against each other.
    pair("mouthPress", |s| {
        let side = fade(s.x / 8.0);
        roll(s, [38.0, 38.0]) * side
            + pull(s, CORNER, [7.0, 7.0], [1.5, 0.5, -1.5])
            + pull(s, [12.0, -83.0], [9.0, 6.0], [0.0, 1.0, 1.2])
    }),
    // Orbicularis oris, lips together.
    one("mouthPucker", |s| purse(s, 0.52, 11.0, 18.0) + roll(s, [-20.0, -20.0])),
    one("mouthRollLower", |s| roll(s, [0.0, 52.0]) + pull(s, [0.0, -86.0], [17.0, 6.0], [0.0, 1.5, 1.2])),
    one("mouthRollUpper", |s| roll(s, [70.0, 0.0])),
    // Mentalis.
    one("mouthShrugLower", |s| {
        pull(s, [0.0, -92.0], [17.0, 13.0], [0.0, 5.5, 1.0])
            + pull(s, [0.0, -72.0], [19.0, 8.0], [0.0, 3.0, 2.5])
            + roll(s, [0.0, -10.0])
            + wrinkles(s, [0.0, -100.0], [10.0, 7.0], [0.0, 7.0], 0.35)
    }),
    one("mouthShrugUpper", |s| pull(s, [0.0, -64.0], [18.0, 8.5], [0.0, 4.5, 2.5]) + roll(s, [-10.0, 0.0])),
    // Zygomaticus major pulls the corner up and back; the cheek bunches above the fold.
    pair("mouthSmile", |s| {
        pull(s, CORNER, [15.0, 12.5], [9.0, 8.5, -2.5])
            + pull(s, [13.0, -68.0], [9.0, 10.0], [0.0, -0.5, -2.5])
            + pull(s, [40.0, -46.0], [13.0, 12.0], [1.0, 3.0, 4.0])
            + crease(s, [26.0, -51.0], [38.0, -73.0], 4.5, 0.9)
            + roll(s, [14.0, 14.0]) * fade(s.x / 8.0)
            + pull(s, [34.0, -21.0], [13.0, 7.0], [0.0, 1.2, 0.6])
    }),
    // Risorius and platysma.
    pair("mouthStretch", |s| {
        pull(s, CORNER, [14.0, 12.0], [9.5, -3.0, -0.5])
            + pull(s, [28.0, -92.0], [13.0, 11.0], [2.0, -2.5, 0.0])
            + crease(s, [36.0, -58.0], [38.0, -84.0], 3.5, 1.0)
    }),
    // Levator labii superioris.
    pair("mouthUpperUp", |s| {
        let lip = upper_lip(s, 9.5) * bell(s.x - 12.0, 10.0);
        along(s, [1.0, 7.0, 0.8]) * lip
            + pull(s, [17.0, -46.0], [8.0, 7.0], [0.5, 1.8, 1.0])
            + pull(s, [28.0, -46.0], [8.0, 9.0], [0.0, 1.5, 1.5])
    }),
    // Levator labii superioris alaeque nasi: the nose's wing, the lip under it, the skin beside the nose.
    pair("noseSneer", |s| {
        pull(s, [14.0, -42.0], [6.5, 9.0], [1.0, 4.5, 0.8])
            + along(s, [0.5, 4.0, 0.6]) * (upper_lip(s, 11.0) * bell(s.x - 13.0, 8.0))
            + pull(s, [13.0, -18.0], [7.0, 9.0], [-0.5, 2.5, 1.5])
            + wrinkles(s, [8.0, -13.0], [6.0, 8.0], [3.0, 6.0], 0.5)
            + crease(s, [19.0, -38.0], [26.0, -54.0], 3.0, 1.2)
            + pull(s, [13.0, 16.0], [9.0, 6.0], [-0.5, -2.0, 0.3])
    }),
];

/// The bulge of the cornea draws the lids with it.
fn look_aside(s: &Site, by: f64) -> Vec3 {
    pull(s, [31.5, 0.0], [9.0, 7.0], [by, 0.0, 0.0])
}
