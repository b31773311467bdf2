//! What all plots share: SVG elements, colours, markers and legends. Lengths are pixels of a page 1100 wide.

use std::fmt::Write as _;

use nonrigid::text;

pub(super) const WIDTH: f64 = 1100.0;
/// Size of ordinary words.
pub(super) const WORDS: f64 = 13.0;
pub(super) const INK: &str = "#222222";
pub(super) const GREY: &str = "#6E6E6E";
pub(super) const GRID: &str = "#D8D8D8";

/// Distinguishable with all common kinds of colour blindness (M. Okabe, K. Ito, "Color Universal Design", 2008), without the yellow,
/// which white swallows.
const COLOURS: [&str; 7] = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"];

/// The colour of a look.
pub(super) fn colour(look: usize) -> &'static str {
    COLOURS[look % COLOURS.len()]
}

/// Width of a line of words, about.
pub(super) fn width(words: &str, size: f64) -> f64 {
    0.57 * size * words.chars().count() as f64
}

/// Where words stand at their point.
#[derive(Clone, Copy)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// A picture as it grows.
#[derive(Default)]
pub(super) struct Canvas(String);

impl Canvas {
    fn element(&mut self, text: std::fmt::Arguments<'_>) {
        let _ = writeln!(self.0, "{text}"); // a String takes everything
    }

    pub fn line(&mut self, [a, b]: [[f64; 2]; 2], stroke: &str, width: f64, dashed: bool) {
        let dashes = if dashed { " stroke-dasharray=\"6 4\"" } else { "" };
        self.element(format_args!(
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{stroke}\" stroke-width=\"{width}\"{dashes}/>",
            a[0], a[1], b[0], b[1]
        ));
    }

    pub fn polyline(&mut self, points: &[[f64; 2]], stroke: &str) {
        self.element(format_args!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{stroke}\" stroke-width=\"2\"/>",
            list(points)
        ));
    }

    pub fn polygon(&mut self, points: &[[f64; 2]], fill: &str) {
        self.element(format_args!("<polygon points=\"{}\" fill=\"{fill}\"/>", list(points)));
    }

    pub fn rectangle(&mut self, [left, top]: [f64; 2], [wide, high]: [f64; 2], fill: &str) {
        self.element(format_args!(
            "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{wide:.1}\" height=\"{high:.1}\" fill=\"{fill}\"/>"
        ));
    }

    /// Words whose middle line is at their point.
    pub fn words(&mut self, [x, y]: [f64; 2], words: &str, anchor: Anchor, style: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let words = text::html(words);
        self.element(format_args!(
            "<text x=\"{x:.1}\" y=\"{y:.1}\" dy=\"0.35em\" text-anchor=\"{anchor}\" {style}>{words}</text>"
        ));
    }

    pub fn title(&mut self, at: [f64; 2], words: &str) {
        self.words(at, words, Anchor::Middle, "font-size=\"16\" font-weight=\"bold\"");
    }

    /// Words that read upwards.
    pub fn upwards(&mut self, [x, y]: [f64; 2], words: &str, anchor: Anchor) {
        self.words([x, y], words, anchor, &format!("transform=\"rotate(-90 {x:.1} {y:.1})\""));
    }

    /// Draws what is cut at the edges of a rectangle; its upper left corner is the origin meanwhile.
    pub fn clipped(&mut self, [left, top]: [f64; 2], [wide, high]: [f64; 2], draw: impl FnOnce(&mut Self)) {
        self.element(format_args!("<svg x=\"{left:.1}\" y=\"{top:.1}\" width=\"{wide:.1}\" height=\"{high:.1}\">"));
        draw(self);
        self.element(format_args!("</svg>"));
    }

    /// The marker of a look: four shapes and seven colours.
    pub fn marker(&mut self, [x, y]: [f64; 2], look: usize) {
        let fill = colour(look);
        let at = |corners: &[[f64; 2]]| corners.iter().map(|c| [x + 4.5 * c[0], y + 4.5 * c[1]]).collect::<Vec<_>>();
        match look % 4 {
            0 => self.element(format_args!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.5\" fill=\"{fill}\"/>")),
            1 => self.polygon(&at(&[[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]]), fill),
            2 => self.polygon(&at(&[[0.0, -1.2], [1.2, 0.9], [-1.2, 0.9]]), fill),
            _ => self.polygon(&at(&[[0.0, -1.3], [1.3, 0.0], [0.0, 1.3], [-1.3, 0.0]]), fill),
        }
    }

    /// A small triangle that stands on its point: a value above the axis.
    pub fn above(&mut self, [x, y]: [f64; 2], fill: &str) {
        self.polygon(&[[x - 4.5, y], [x + 4.5, y], [x, y - 8.0]], fill);
    }

    /// Entries in as many columns as have room, from their upper left corner; where they end.
    pub fn legend(&mut self, [left, top]: [f64; 2], room: f64, entries: &[(Key, String)]) -> f64 {
        let widest = entries.iter().map(|e| 60.0 + width(&e.1, WORDS)).fold(1.0, f64::max);
        let columns = ((room / widest) as usize).clamp(1, entries.len().max(1));
        for (k, (key, words)) in entries.iter().enumerate() {
            let (x, y) = (left + widest * (k % columns) as f64, top + 20.0 * (k / columns) as f64 + 10.0);
            match *key {
                Key::Series(look) => {
                    self.line([[x, y], [x + 34.0, y]], colour(look), 2.0, false);
                    self.marker([x + 17.0, y], look);
                }
                Key::Dashed(stroke) => self.line([[x, y], [x + 34.0, y]], stroke, 1.5, true),
                Key::Above => self.above([x + 17.0, y + 4.0], GREY),
                Key::Swatch(look) => self.rectangle([x + 10.0, y - 7.0], [24.0, 14.0], colour(look)),
            }
            self.words([x + 42.0, y], words, Anchor::Start, "");
        }
        top + 20.0 * entries.len().div_ceil(columns) as f64
    }

    /// The picture so high, as wide as the page it stands in.
    pub fn page(self, high: f64) -> String {
        format!(
            "<svg viewBox=\"0 0 {WIDTH} {high:.0}\" xmlns=\"http://www.w3.org/2000/svg\" font-family=\"sans-serif\" \
             font-size=\"{WORDS}\" fill=\"{INK}\">\n<rect width=\"100%\" height=\"100%\" fill=\"#FFFFFF\"/>\n{}</svg>\n",
            self.0
        )
    }
}

fn list(points: &[[f64; 2]]) -> String {
    points.iter().map(|p| format!("{:.1},{:.1}", p[0], p[1])).collect::<Vec<_>>().join(" ")
}

/// What an entry of a legend shows before its words.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Key {
    Series(usize),
    Dashed(&'static str),
    Above,
    Swatch(usize),
}
