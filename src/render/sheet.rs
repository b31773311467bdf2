//! Several pictures on one: a grid of panels with titles and a colour bar.

use image::{Rgb, RgbImage, imageops};
use nalgebra::Matrix3;

use super::text::{draw_text, text_height, text_size};
use super::{Camera, ColourScale, Frame, Rgb8, Scene, Style, View, render};
use crate::mesh::{PolygonMesh, PoseKind, TriangleMesh, Vec3, closest_pose};

/// A picture of a [`Sheet`] with a caption above it, which may be empty. A picture alone is a panel too.
#[derive(Debug, Clone)]
pub struct Panel {
    picture: RgbImage,
    caption: String,
}

impl Panel {
    /// A picture and its caption, which shrinks to the picture's width.
    #[must_use]
    pub fn new(picture: RgbImage, caption: &str) -> Self {
        Self { picture, caption: caption.into() }
    }
}

impl From<RgbImage> for Panel {
    fn from(picture: RgbImage) -> Self {
        Self::new(picture, "")
    }
}

/// A grid of equally large panels with a title, column headings, captions above rows and panels and, on request, a colour bar. No word
/// stands on a picture.
#[derive(Debug, Clone, Default)]
pub struct Sheet {
    title: String,
    columns: Vec<String>,
    rows: Vec<(String, Vec<Panel>)>,
    scale: Option<ColourScale>,
}

const INK: Rgb8 = [32, 36, 44];
const FAINT: Rgb8 = [208, 211, 216];
/// Height of a line of text.
const LINE: u32 = 18;
/// The same of a caption.
const SMALL: u32 = 16;
const MARGIN: u32 = 14;
const GAP: u32 = 6;
const BAR: u32 = 22;

impl Sheet {
    /// An empty sheet with a title (which may be empty).
    #[must_use]
    pub fn new(title: &str) -> Self {
        Self { title: title.into(), ..Self::default() }
    }

    /// Sets the headings of the columns.
    #[must_use]
    pub fn columns(mut self, headings: &[&str]) -> Self {
        self.columns = headings.iter().map(ToString::to_string).collect();
        self
    }

    /// Adds a row of panels under a caption (which may be empty).
    #[must_use]
    pub fn row<P: Into<Panel>>(mut self, caption: &str, panels: impl IntoIterator<Item = P>) -> Self {
        self.rows.push((caption.into(), panels.into_iter().map(Into::into).collect()));
        self
    }

    /// Shows this scale as a bar on the right.
    #[must_use]
    pub fn colour_bar(mut self, scale: &ColourScale) -> Self {
        self.scale = Some(scale.clone());
        self
    }

    /// Draws the sheet.
    #[must_use]
    pub fn render(&self) -> RgbImage {
        let panels = || self.rows.iter().flat_map(|(_, panels)| panels);
        let width = panels().map(|p| p.picture.width()).max().unwrap_or(0);
        let height = panels().map(|p| p.picture.height()).max().unwrap_or(0);
        let across = self.rows.iter().map(|(_, p)| p.len()).max().unwrap_or(0).max(self.columns.len()) as u32;
        let header = |present: bool| if present { LINE + MARGIN } else { 0 };
        let title_height = header(!self.title.is_empty());
        let top = MARGIN + title_height + header(!self.columns.is_empty());
        let right = MARGIN + across * (width + GAP);
        let bar_width = self.scale.as_ref().map_or(0, |scale| MARGIN + bar_column_width(scale));
        let wide = |text: &String| text_size(text, LINE)[0] + 2 * MARGIN;
        let words = self.rows.iter().map(|r| &r.0).chain([&self.title]);
        let total_width = words.map(wide).fold(right + bar_width + MARGIN, u32::max);
        // Above the pictures of a row: its own caption, then theirs.
        let above = |(caption, panels): &(String, Vec<Panel>)| {
            let line = |present: bool, height: u32| if present { height + GAP } else { 0 };
            [line(!caption.is_empty(), LINE), line(panels.iter().any(|p| !p.caption.is_empty()), SMALL)]
        };
        let bottom = top + self.rows.iter().map(|row| above(row).iter().sum::<u32>() + height + GAP).sum::<u32>();
        let mut sheet = RgbImage::from_pixel(total_width, bottom + MARGIN - GAP.min(MARGIN), Rgb([255; 3]));

        draw_text(&mut sheet, i64::from(MARGIN), i64::from(MARGIN), &self.title, LINE, INK);
        for (i, heading) in self.columns.iter().enumerate() {
            let font = text_height(heading, LINE, width);
            let free = i64::from(width) - i64::from(text_size(heading, font)[0]);
            let x = i64::from(MARGIN) + i as i64 * i64::from(width + GAP) + free / 2;
            draw_text(&mut sheet, x, i64::from(MARGIN + title_height), heading, font, INK);
        }
        let mut y = top;
        for row in &self.rows {
            let [of_row, of_panels] = above(row);
            draw_text(&mut sheet, i64::from(MARGIN), i64::from(y), &row.0, LINE, INK);
            y += of_row + of_panels;
            for (c, panel) in row.1.iter().enumerate() {
                let x = i64::from(MARGIN) + c as i64 * i64::from(width + GAP);
                let font = text_height(&panel.caption, SMALL, width);
                draw_text(&mut sheet, x, i64::from(y - of_panels), &panel.caption, font, INK);
                let picture = &panel.picture;
                imageops::replace(&mut sheet, picture, x, i64::from(y));
                outline(&mut sheet, x, i64::from(y), picture.width(), picture.height(), FAINT);
            }
            y += height + GAP;
        }
        if let Some(scale) = &self.scale {
            draw_bar(&mut sheet, scale, right + MARGIN - GAP, top, bottom.saturating_sub(GAP));
        }
        sheet
    }
}

fn tick_texts(scale: &ColourScale) -> Vec<(f64, String)> {
    let mut ticks = scale.ticks();
    let end = |value: f64, limit: f64| (scale.position(value) - scale.position(limit)).abs() < 1e-6;
    for (value, text) in &mut ticks {
        if scale.clipped[0] && end(*value, scale.low) {
            text.insert_str(0, "≤ ");
        } else if scale.clipped[1] && end(*value, scale.high) {
            text.insert_str(0, "≥ ");
        }
    }
    ticks
}

/// Label and unit, broken into lines of at most 12 characters where the words allow it.
fn bar_label(scale: &ColourScale) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in scale.label.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= 12 => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.into()),
        }
    }
    if !scale.unit.is_empty() {
        lines.push(format!("[{}]", scale.unit));
    }
    lines
}

fn bar_column_width(scale: &ColourScale) -> u32 {
    let ticks = tick_texts(scale).iter().map(|t| text_size(&t.1, LINE)[0]).max().unwrap_or(0);
    let label = bar_label(scale).iter().map(|l| text_size(l, LINE)[0]).max().unwrap_or(0);
    (BAR + 12 + ticks).max(label)
}

fn draw_bar(sheet: &mut RgbImage, scale: &ColourScale, left: u32, top: u32, bottom: u32) {
    let lines = bar_label(scale);
    for (i, line) in lines.iter().enumerate() {
        draw_text(sheet, i64::from(left), i64::from(top + i as u32 * (LINE + 4)), line, LINE, INK);
    }
    let top = top + lines.len() as u32 * (LINE + 4) + LINE;
    let bottom = bottom.saturating_sub(LINE).min(top + 640);
    if bottom <= top + 1 {
        return;
    }
    let height = bottom - top;
    for y in 0..height {
        let colour = scale.map.at(1.0 - f64::from(y) / f64::from(height - 1));
        for x in left..left + BAR {
            if x < sheet.width() && top + y < sheet.height() {
                sheet.put_pixel(x, top + y, Rgb(colour));
            }
        }
    }
    outline(sheet, i64::from(left), i64::from(top), BAR, height, INK);
    for (value, text) in tick_texts(scale) {
        let y = i64::from(bottom) - 1 - (scale.position(value) * f64::from(height - 1)).round() as i64;
        for x in left + BAR..left + BAR + 6 {
            if x < sheet.width() && (0..i64::from(sheet.height())).contains(&y) {
                sheet.put_pixel(x, y as u32, Rgb(INK));
            }
        }
        draw_text(sheet, i64::from(left + BAR + 10), y - i64::from(LINE / 2), &text, LINE, INK);
    }
}

fn outline(image: &mut RgbImage, x: i64, y: i64, width: u32, height: u32, colour: Rgb8) {
    let (right, bottom) = (x + i64::from(width) - 1, y + i64::from(height) - 1);
    let mut put = |px: i64, py: i64| {
        if (0..i64::from(image.width())).contains(&px) && (0..i64::from(image.height())).contains(&py) {
            image.put_pixel(px as u32, py as u32, Rgb(colour));
        }
    };
    for px in x..=right {
        put(px, y);
        put(px, bottom);
    }
    for py in y..=bottom {
        put(x, py);
        put(right, py);
    }
}

/// Colours of "result over scan": where they alternate, the surfaces intersect.
const SCAN: Rgb8 = [86, 140, 196];
const RESULT: Rgb8 = [240, 160, 76];

/// The rotation that turns a result as its template is turned: back by the one of the rigid motion that maps the template best onto it. So
/// a face is seen from the front however its scan lies; none where the two do not correspond.
#[must_use]
pub fn turn_back(template: &[Vec3], result: &[Vec3]) -> Matrix3<f64> {
    let pairs: Vec<(Vec3, Vec3)> = result.iter().copied().zip(template.iter().copied()).collect();
    let pose = closest_pose(&pairs, PoseKind::Rigid).ok().filter(|_| template.len() == result.len());
    pose.map_or_else(Matrix3::identity, |pose| pose.rotation)
}

/// The sheet of a registration: template, scan, result with wireframe, and result (orange) over scan (blue), from the
/// front and in three-quarter view. Scan and result share one frame and are [turned](turn_back) as the template is, which is shown in its own
/// place at the same scale. `panel` is the side of a panel in pixels.
#[must_use]
pub fn registration_sheet(
    title: &str,
    template: &PolygonMesh,
    scan: &TriangleMesh,
    result: &PolygonMesh,
    panel: u32,
) -> RgbImage {
    let turn = turn_back(&template.positions, &result.positions);
    let turned = |positions: &[Vec3]| positions.iter().map(|p| turn * p).collect();
    let scan = &TriangleMesh { positions: turned(&scan.positions), triangles: scan.triangles.clone() };
    let result = &result.with_positions(turned(&result.positions));
    let frame = Frame::of(&result.positions).scaled(0.95);
    let template_frame = Frame::of(&template.positions).at_scale_of(frame);
    let (template_surface, result_surface) = (template.triangulate(), result.triangulate());
    let add_scan = |scene: Scene, style: Style| {
        if scan.triangles.is_empty() { scene.points(&scan.positions, SCAN, 1.3) } else { scene.mesh(scan, style) }
    };
    let scenes = [
        (template_frame, Scene::new().mesh(&template_surface, Style::Clay).wireframe(template)),
        (frame, add_scan(Scene::new(), Style::Clay)),
        (frame, Scene::new().mesh(&result_surface, Style::Clay).wireframe(result)),
        (frame, add_scan(Scene::new(), Style::Solid(SCAN)).mesh(&result_surface, Style::Solid(RESULT))),
    ];
    let mut sheet = Sheet::new(title).columns(&["template", "scan", "result", "result over scan"]);
    for view in [View::Front, View::ThreeQuarter] {
        let size = [panel, panel];
        let panels = scenes.iter().map(|(f, scene)| render(scene, &Camera::framing(f, view, size), size));
        sheet = sheet.row(&view.name(), panels);
    }
    sheet.render()
}

/// Heat maps of several results, one column each, on one scale: `results` holds heading, mesh and a value per vertex.
#[must_use]
pub fn error_sheet(
    title: &str,
    results: &[(&str, &PolygonMesh, &[f64])],
    scale: &ColourScale,
    views: &[View],
    panel: u32,
) -> RgbImage {
    let frame = results.iter().map(|r| Frame::of(&r.1.positions)).reduce(Frame::union);
    let frame = frame.unwrap_or_else(|| Frame::of(&[])).scaled(0.95);
    let headings: Vec<&str> = results.iter().map(|r| r.0).collect();
    let mut sheet = Sheet::new(title).columns(&headings).colour_bar(scale);
    let size = [panel, panel];
    for &view in views {
        let camera = Camera::framing(&frame, view, size);
        let draw = |(_, mesh, values): &(&str, &PolygonMesh, &[f64])| {
            let style = Style::Values(values.to_vec(), scale.clone());
            render(&Scene::new().mesh(&mesh.triangulate(), style), &camera, size)
        };
        sheet = sheet.row(&view.name(), results.iter().map(draw));
    }
    sheet.render()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Pose;
    use crate::render::ColourMap;

    #[test]
    fn a_sheet_holds_its_panels_and_survives_being_empty() {
        assert!(Sheet::new("").render().width() > 0);
        let panel = RgbImage::from_pixel(50, 40, Rgb([1, 2, 3]));
        let mut scale = ColourScale::new(ColourMap::Viridis, 0.0, 2.0, "error", "mm");
        scale.clipped[1] = true;
        let sheet = Sheet::new("a title wider than the panels").columns(&["one", "two"]).row("front", vec![panel; 2]);
        let sheet = sheet.colour_bar(&scale).render();
        assert_eq!(sheet.pixels().filter(|p| p.0 == [1, 2, 3]).count() / 1000, 2 * 48 * 38 / 1000);
        assert_eq!(tick_texts(&scale).last().unwrap().1, "≥ 2.0");
    }

    #[test]
    fn a_scan_that_lies_otherwise_gives_the_same_pictures() {
        let height = |x: f64, y: f64| 3.0 * (x * 0.7).sin() + 0.2 * x * y;
        let grid = (0..100).map(|k| (f64::from(k % 10), f64::from(k / 10)));
        let positions = grid.map(|(x, y)| Vec3::new(x, y, height(x, y))).collect();
        let quads = (0..90).filter(|k| k % 10 < 9).flat_map(|k| [[k, k + 1, k + 11], [k, k + 11, k + 10]]);
        let scan = TriangleMesh { positions, triangles: quads.collect() };
        let template = PolygonMesh::from(scan.clone());
        let sheet = |turn: Vec3| {
            let pose = Pose::rigid(turn, Vec3::new(5.0, 8.0, -3.0));
            let positions: Vec<Vec3> = scan.positions.iter().map(|p| pose.apply(*p)).collect();
            let result = template.with_positions(positions.clone());
            registration_sheet("", &template, &TriangleMesh { positions, ..scan.clone() }, &result, 60)
        };
        let (here, there) = (sheet(Vec3::zeros()), sheet(Vec3::new(1.5, 0.4, 0.0)));
        let same =
            here.pixels().zip(there.pixels()).filter(|(a, b)| a.0.iter().zip(b.0).all(|(a, b)| a.abs_diff(b) < 8));
        assert!(same.count() as f64 > 0.98 * here.pixels().len() as f64);
    }

    #[test]
    fn no_word_stands_on_a_picture() {
        let picture = RgbImage::from_pixel(50, 40, Rgb([1, 2, 3]));
        let whole = |sheet: Sheet| sheet.render().pixels().filter(|p| p.0 == [1, 2, 3]).count();
        let plain = Sheet::new("").row("", vec![picture.clone(); 2]);
        let named = [Panel::new(picture.clone(), "a caption wider than its picture"), picture.into()];
        assert_eq!(whole(Sheet::new("title").columns(&["one"]).row("a row", named)), whole(plain));
    }
}
