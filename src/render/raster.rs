//! The rasteriser: a depth buffer, supersampled, shaded per sample.
//!
//! The image is cut into bands of rows. Each band draws its own primitives in scene order and owns its buffers, so the
//! result does not depend on how many threads share the bands. Depth is compared by a key that is linear on the screen
//! (1/depth, or -depth when orthographic); at equal depth the earlier primitive wins.

use image::RgbImage;
use rayon::prelude::*;

use super::camera::Camera;
use super::colour::NO_VALUE;
use super::scene::{Points, Scene, Style, Surface, Wires};
use super::{ColourScale, Rgb8};
use crate::mesh::Vec3;
use crate::mesh::normals::{NormalWeighting, vertex_normals};
use crate::mesh::srgb::{from_light, to_light};

/// Samples per pixel along each axis.
const SUPERSAMPLING: u32 = 2;
const BACKGROUND: Rgb8 = [255, 255, 255];
/// How far a line may lie behind a surface and still be drawn on it, as a share of its distance from the camera.
const LINE_BIAS: f64 = 0.0015;

/// Rows of output pixels in a band.
const BAND: u32 = 16;

/// Draws `scene` at `size` (width, height) pixels.
#[must_use]
pub fn render(scene: &Scene, camera: &Camera, size: [u32; 2]) -> RgbImage {
    let mut image = RgbImage::new(size[0], size[1]);
    let fine = size[0].checked_mul(SUPERSAMPLING).zip(size[1].checked_mul(SUPERSAMPLING));
    let Some(fine) = fine else { return image };
    let prepared = Prepared::new(scene, camera, [fine.0, fine.1]);
    let row_bytes = size[0] as usize * 3;
    if row_bytes == 0 {
        return image;
    }
    let samples: &mut [u8] = &mut image;
    samples.par_chunks_mut(row_bytes * BAND as usize).enumerate().for_each(|(band, pixels)| {
        Band::new(&prepared, band).draw(pixels);
    });
    image
}

type Linear = [f32; 3];

/// A scene projected to the fine grid, with its primitives sorted into bands.
struct Prepared<'a> {
    width: usize,
    factor: usize,
    background: Linear,
    perspective: bool,
    lights: Lights,
    surfaces: Vec<PreparedSurface<'a>>,
    wires: Vec<PreparedWires<'a>>,
    points: Vec<PreparedPoints<'a>>,
}

struct PreparedSurface<'a> {
    triangles: &'a [[u32; 3]],
    screen: Vec<[f64; 3]>,
    normals: Vec<Vec3>,
    look: Look<'a>,
    bands: Vec<Vec<u32>>,
}

enum Look<'a> {
    Plain { front: Linear, back: Linear },
    Overlay { weights: &'a [f64], colour: Linear },
    Values { values: &'a [f64], scale: &'a ColourScale, palette: Vec<Linear> },
}

/// Outside and inside of clay.
const CLAY: [Rgb8; 2] = [[226, 205, 188], [128, 138, 152]];

struct PreparedWires<'a> {
    layer: &'a Wires,
    screen: Vec<[f64; 3]>,
    colour: Linear,
    half_width: f64,
    occluder_bands: Vec<Vec<u32>>,
    edge_bands: Vec<Vec<u32>>,
}

struct PreparedPoints<'a> {
    layer: &'a Points,
    screen: Vec<[f64; 3]>,
    colour: Linear,
    radius: f64,
    bands: Vec<Vec<u32>>,
}

const NOWHERE: [f64; 3] = [f64::NAN; 3];

impl<'a> Prepared<'a> {
    fn new(scene: &'a Scene, camera: &Camera, fine: [u32; 2]) -> Self {
        let band_rows = f64::from(BAND * SUPERSAMPLING);
        let band_count = fine[1].div_ceil(BAND * SUPERSAMPLING) as usize;
        let project = |points: &[Vec3]| -> Vec<[f64; 3]> {
            points.par_iter().map(|p| camera.project(*p, fine).unwrap_or(NOWHERE)).collect()
        };
        let sort = |extents: &mut dyn Iterator<Item = [f64; 2]>| -> Vec<Vec<u32>> {
            let mut bands = vec![Vec::new(); band_count];
            for (primitive, [top, bottom]) in extents.enumerate() {
                if top.is_nan() || bottom.is_nan() || bottom < 0.0 || top >= f64::from(fine[1]) {
                    continue;
                }
                let first = (top.max(0.0) / band_rows) as usize;
                let last = ((bottom / band_rows) as usize).min(band_count.saturating_sub(1));
                for band in bands.iter_mut().take(last + 1).skip(first) {
                    band.push(primitive as u32);
                }
            }
            bands
        };
        let triangle_bands = |triangles: &[[u32; 3]], screen: &[[f64; 3]]| {
            sort(&mut triangles.iter().map(|t| {
                let y = t.map(|v| screen[v as usize][1]);
                if y.iter().any(|y| y.is_nan()) {
                    [f64::NAN; 2]
                } else {
                    [y[0].min(y[1]).min(y[2]), y[0].max(y[1]).max(y[2])]
                }
            }))
        };
        let surface = |layer: &'a Surface| {
            let screen = project(&layer.positions);
            let bands = triangle_bands(&layer.triangles, &screen);
            let normals = vertex_normals(&layer.positions, &layer.triangles, NormalWeighting::Area);
            PreparedSurface { triangles: &layer.triangles, screen, normals, look: Look::of(&layer.style), bands }
        };
        let wires = |layer: &'a Wires| {
            let screen = project(&layer.positions);
            let half_width = 0.5 * layer.width.max(0.0) * f64::from(SUPERSAMPLING);
            let margin = half_width + 1.0;
            let edge_bands = sort(&mut layer.edges.iter().map(|e| {
                let y = e.map(|v| screen[v as usize][1]);
                [y[0].min(y[1]) - margin, y[0].max(y[1]) + margin]
            }));
            let occluder_bands = triangle_bands(&layer.occluder, &screen);
            PreparedWires { layer, colour: to_linear(layer.colour), half_width, edge_bands, occluder_bands, screen }
        };
        let points = |layer: &'a Points| {
            let screen = project(&layer.positions);
            let radius = layer.radius.max(0.0) * f64::from(SUPERSAMPLING);
            let bands = sort(&mut screen.iter().map(|p| [p[1] - radius, p[1] + radius]));
            PreparedPoints { layer, colour: to_linear(layer.colour), radius, bands, screen }
        };
        Self {
            width: fine[0] as usize,
            factor: SUPERSAMPLING as usize,
            background: to_linear(BACKGROUND),
            perspective: camera.is_perspective(),
            lights: Lights::new(camera),
            surfaces: scene.surfaces.iter().map(surface).collect(),
            wires: scene.wires.iter().map(wires).collect(),
            points: scene.points.iter().map(points).collect(),
        }
    }
}

impl<'a> Look<'a> {
    fn of(style: &'a Style) -> Self {
        let plain = |front, back| Look::Plain { front: to_linear(front), back: to_linear(back) };
        match style {
            Style::Clay => plain(CLAY[0], CLAY[1]),
            Style::Solid(colour) => plain(*colour, *colour),
            Style::Overlay(weights, colour) => Look::Overlay { weights, colour: to_linear(*colour) },
            Style::Values(values, scale) => {
                let palette = (0..=PALETTE).map(|i| to_linear(scale.map.at(i as f64 / PALETTE as f64))).collect();
                Look::Values { values, scale, palette }
            }
        }
    }
}

/// Steps in the table of a colour map.
const PALETTE: usize = 1023;

/// What a sample sees: nothing when `layer` is `NOTHING`.
#[derive(Clone, Copy)]
struct Hit {
    key: f64,
    layer: u32,
    primitive: u32,
}

const NOTHING: Hit = Hit { key: f64::NEG_INFINITY, layer: u32::MAX, primitive: 0 };

struct Band<'p, 'a> {
    prepared: &'p Prepared<'a>,
    index: usize,
    /// First fine row.
    top: usize,
}

impl<'p, 'a> Band<'p, 'a> {
    fn new(prepared: &'p Prepared<'a>, index: usize) -> Self {
        Self { prepared, index, top: index * BAND as usize * prepared.factor }
    }

    fn draw(&self, pixels: &mut [u8]) {
        let p = self.prepared;
        let rows = pixels.len() / (3 * (p.width / p.factor)) * p.factor;
        let mut solid = vec![NOTHING; p.width * rows];
        for layer in 0..p.surfaces.len() {
            self.draw_surface(layer, &mut solid);
        }
        for layer in 0..p.points.len() {
            self.draw_points(layer, &mut solid);
        }
        let lines: Vec<Vec<f32>> = p.wires.iter().map(|wires| self.draw_wires(wires, &solid)).collect();

        let weight = 1.0 / (p.factor * p.factor) as f32;
        let columns = p.width / p.factor;
        for (i, pixel) in pixels.chunks_exact_mut(3).enumerate() {
            let (column, row) = (i % columns, i / columns);
            let mut sum = [0.0f32; 3];
            // Samples of one pixel on one triangle look alike: shade them once.
            let mut last = (NOTHING, p.background);
            for sub_row in 0..p.factor {
                for sub_column in 0..p.factor {
                    let (x, y) = (column * p.factor + sub_column, row * p.factor + sub_row);
                    let colour = self.sample(x, y, &solid, &lines, &mut last);
                    for c in 0..3 {
                        sum[c] += colour[c];
                    }
                }
            }
            pixel.copy_from_slice(&from_light(sum.map(|c| f64::from(c * weight)).into()));
        }
    }

    /// Colour of one sample; `y` counts from the top of the band.
    fn sample(&self, x: usize, y: usize, solid: &[Hit], lines: &[Vec<f32>], last: &mut (Hit, Linear)) -> Linear {
        let p = self.prepared;
        let at = y * p.width + x;
        let hit = solid[at];
        let mut colour = p.background;
        if let Some(points) = (hit.layer as usize).checked_sub(p.surfaces.len()) {
            if let Some(points) = p.points.get(points) {
                colour = points.colour;
            }
        } else {
            if (hit.layer, hit.primitive) != (last.0.layer, last.0.primitive) {
                *last = (hit, self.shade(hit, x, y));
            }
            colour = last.1;
        }
        for (wires, coverage) in p.wires.iter().zip(lines) {
            colour = mix(colour, wires.colour, coverage[at]);
        }
        colour
    }

    fn draw_surface(&self, layer: usize, hits: &mut [Hit]) {
        let surface = &self.prepared.surfaces[layer];
        for &t in &surface.bands[self.index] {
            let corners = surface.triangles[t as usize].map(|v| surface.screen[v as usize]);
            self.cover(corners, hits.len(), |at, key| {
                if key > hits[at].key {
                    hits[at] = Hit { key, layer: layer as u32, primitive: t };
                }
            });
        }
    }

    fn draw_points(&self, index: usize, hits: &mut [Hit]) {
        let p = self.prepared;
        let points = &p.points[index];
        let layer = (p.surfaces.len() + index) as u32;
        let rows = hits.len() / p.width;
        for &primitive in &points.bands[self.index] {
            let [cx, cy, key] = points.screen[primitive as usize];
            let cy = cy - self.top as f64;
            for y in range(cy - points.radius, cy + points.radius, rows) {
                for x in range(cx - points.radius, cx + points.radius, p.width) {
                    let (dx, dy) = (x as f64 + 0.5 - cx, y as f64 + 0.5 - cy);
                    let hit = &mut hits[y * p.width + x];
                    if dx * dx + dy * dy <= points.radius * points.radius && key > hit.key {
                        *hit = Hit { key, layer, primitive };
                    }
                }
            }
        }
        debug_assert_eq!(points.screen.len(), points.layer.positions.len());
    }

    /// Coverage 0 to 1 of each sample by the visible lines.
    fn draw_wires(&self, wires: &PreparedWires, solid: &[Hit]) -> Vec<f32> {
        let p = self.prepared;
        let rows = solid.len() / p.width;
        let mut nearest: Vec<f64> = solid.iter().map(|hit| hit.key).collect();
        for &t in &wires.occluder_bands[self.index] {
            let corners = wires.layer.occluder[t as usize].map(|v| wires.screen[v as usize]);
            self.cover(corners, solid.len(), |at, key| nearest[at] = nearest[at].max(key));
        }
        let mut coverage = vec![0.0f32; solid.len()];
        let reach = wires.half_width + 0.5;
        for &e in &wires.edge_bands[self.index] {
            let [a, b] = wires.layer.edges[e as usize].map(|v| wires.screen[v as usize]);
            let (ay, by) = (a[1] - self.top as f64, b[1] - self.top as f64);
            let (dx, dy) = (b[0] - a[0], by - ay);
            let length2 = dx * dx + dy * dy;
            for y in range(ay.min(by) - reach, ay.max(by) + reach, rows) {
                for x in range(a[0].min(b[0]) - reach, a[0].max(b[0]) + reach, p.width) {
                    let (px, py) = (x as f64 + 0.5 - a[0], y as f64 + 0.5 - ay);
                    let t = if length2 > 0.0 { ((px * dx + py * dy) / length2).clamp(0.0, 1.0) } else { 0.0 };
                    let distance = (px - t * dx).hypot(py - t * dy);
                    let cover = (reach - distance).clamp(0.0, 1.0).min(2.0 * wires.half_width) as f32;
                    let at = y * p.width + x;
                    if cover > coverage[at] {
                        let key = a[2] + t * (b[2] - a[2]);
                        // Bring the line nearer by a share of its depth (perspective) or of the depth key (orthographic).
                        let key = if p.perspective { key / (1.0 - LINE_BIAS) } else { key + LINE_BIAS * key.abs() };
                        if key >= nearest[at] {
                            coverage[at] = cover;
                        }
                    }
                }
            }
        }
        coverage
    }

    /// Calls `visit(index, key)` for every sample of this band inside the triangle.
    fn cover(&self, corners: [[f64; 3]; 3], samples: usize, mut visit: impl FnMut(usize, f64)) {
        let width = self.prepared.width;
        let rows = samples / width;
        let [a, b, c] = corners.map(|v| [v[0], v[1] - self.top as f64, v[2]]);
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let inverse = 1.0 / area;
        // Barycentric weights of b and c and their change from one sample to the next.
        let (ub, vb) = ((c[1] - a[1]) * inverse, -(c[0] - a[0]) * inverse);
        let (uc, vc) = (-(b[1] - a[1]) * inverse, (b[0] - a[0]) * inverse);
        for y in range(a[1].min(b[1]).min(c[1]) - 0.5, a[1].max(b[1]).max(c[1]) + 0.5, rows) {
            let py = y as f64 + 0.5 - a[1];
            for x in range(a[0].min(b[0]).min(c[0]) - 0.5, a[0].max(b[0]).max(c[0]) + 0.5, width) {
                let px = x as f64 + 0.5 - a[0];
                let (wb, wc) = (px * ub + py * vb, px * uc + py * vc);
                if wb >= -EDGE && wc >= -EDGE && wb + wc <= 1.0 + EDGE {
                    visit(y * width + x, a[2] + wb * (b[2] - a[2]) + wc * (c[2] - a[2]));
                }
            }
        }
    }

    /// Lit colour of a surface hit; `y` counts from the top of the band.
    fn shade(&self, hit: Hit, x: usize, y: usize) -> Linear {
        let p = self.prepared;
        let Some(surface) = p.surfaces.get(hit.layer as usize) else { return p.background };
        let triangle = surface.triangles[hit.primitive as usize].map(|v| v as usize);
        let [a, b, c] = triangle.map(|v| surface.screen[v]);
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        let (px, py) = (x as f64 + 0.5 - a[0], (y + self.top) as f64 + 0.5 - a[1]);
        let wb = ((px * (c[1] - a[1]) - py * (c[0] - a[0])) / area).clamp(0.0, 1.0);
        let wc = ((py * (b[0] - a[0]) - px * (b[1] - a[1])) / area).clamp(0.0, 1.0);
        let mut w = [(1.0 - wb - wc).max(0.0), wb, wc];
        if p.perspective {
            w = [w[0] * a[2], w[1] * b[2], w[2] * c[2]];
        }
        let sum = w[0] + w[1] + w[2];
        let w = w.map(|w| w / sum);
        let normal = surface.normals[triangle[0]] * w[0]
            + surface.normals[triangle[1]] * w[1]
            + surface.normals[triangle[2]] * w[2];
        // On the screen, y points down: a triangle that faces the viewer has negative area.
        let inside = area > 0.0;
        let light = p.lights.intensity(if inside { -normal } else { normal });
        let interpolated = |values: &[f64], missing: f64| -> f64 {
            triangle.iter().zip(w).map(|(v, w)| values.get(*v).copied().unwrap_or(missing) * w).sum()
        };
        match &surface.look {
            Look::Plain { front, back } => {
                let colour = if inside { back } else { front };
                colour.map(|c| c * light.0 + light.1)
            }
            Look::Overlay { weights, colour } => {
                let clay = to_linear(CLAY[usize::from(inside)]).map(|c| c * light.0 + light.1);
                let weight = interpolated(weights, 0.0);
                mix(clay, *colour, if weight.is_nan() { 0.0 } else { weight.clamp(0.0, 1.0) as f32 })
            }
            Look::Values { values, scale, palette } => {
                let value = interpolated(values, f64::NAN);
                let position = scale.position(value);
                let colour = if position.is_nan() {
                    to_linear(NO_VALUE)
                } else {
                    palette[(position.clamp(0.0, 1.0) * PALETTE as f64).round() as usize]
                };
                colour.map(|c| c * (0.35 + 0.65 * light.0))
            }
        }
    }
}

/// Slack on barycentric weights: neighbouring triangles overlap by this share rather than leave a crack.
const EDGE: f64 = 1e-9;

/// Samples whose centres lie between `low` and `high`, cut to `0..limit`.
fn range(low: f64, high: f64, limit: usize) -> std::ops::Range<usize> {
    let first = (low - 0.5).ceil().max(0.0);
    let end = ((high - 0.5).floor() + 1.0).min(limit as f64);
    if first < end { first as usize..end as usize } else { 0..0 }
}

/// A key light from the upper left, a fill light from the right, a sky above and a rim: all move with the camera.
struct Lights {
    key: Vec3,
    fill: Vec3,
    up: Vec3,
    viewer: Vec3,
    half: Vec3,
}

impl Lights {
    fn new(camera: &Camera) -> Self {
        let key = camera.to_world(Vec3::new(-0.55, 0.65, 0.62).normalize());
        let fill = camera.to_world(Vec3::new(0.80, 0.05, 0.55).normalize());
        let viewer = camera.towards_viewer();
        Self { key, fill, up: camera.to_world(Vec3::y()), viewer, half: (key + viewer).normalize() }
    }

    /// Diffuse factor and a faint, broad highlight for a normal of any length.
    fn intensity(&self, normal: Vec3) -> (f32, f32) {
        let Some(n) = normal.try_normalize(1e-30) else { return (0.5, 0.0) };
        let diffuse = 0.92 * n.dot(&self.key).max(0.0)
            + 0.22 * n.dot(&self.fill).max(0.0)
            + 0.05
            + 0.05 * (0.5 + 0.5 * n.dot(&self.up))
            + 0.06 * n.dot(&self.viewer).max(0.0);
        let gloss = n.dot(&self.half).max(0.0).powi(24);
        (diffuse as f32, 0.04 * gloss as f32)
    }
}

fn mix(under: Linear, over: Linear, opacity: f32) -> Linear {
    [0, 1, 2].map(|c| under[c] + (over[c] - under[c]) * opacity)
}

/// The light of a colour, in the 32 bits of the samples.
fn to_linear(colour: Rgb8) -> Linear {
    to_light(colour).map(|c| c as f32).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{PolygonMesh, TriangleMesh};
    use crate::render::{ColourMap, Frame, View};

    fn square(z: f64, half: f64) -> PolygonMesh {
        PolygonMesh {
            positions: [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
                .map(|[x, y]| Vec3::new(x * half, y * half, z))
                .to_vec(),
            starts: vec![0, 4],
            corners: vec![0, 1, 2, 3],
            ..PolygonMesh::default()
        }
    }

    fn camera() -> Camera {
        Camera::framing(&Frame { centre: Vec3::zeros(), half: Vec3::new(1.0, 1.0, 0.1) }, View::Front, SIZE)
    }

    const SIZE: [u32; 2] = [101, 101];

    #[test]
    fn the_nearer_surface_hides_the_farther_in_either_order() {
        let (near, far) = (square(0.1, 0.5).triangulate(), square(-0.1, 1.0).triangulate());
        let (red, blue) = (Style::Solid([255, 0, 0]), Style::Solid([0, 0, 255]));
        let a = render(&Scene::new().mesh(&near, red.clone()).mesh(&far, blue.clone()), &camera(), SIZE);
        let b = render(&Scene::new().mesh(&far, blue).mesh(&near, red), &camera(), SIZE);
        assert_eq!(a, b);
        assert!(a.get_pixel(50, 50).0[0] > 150 && a.get_pixel(50, 50).0[2] < 80);
        assert!(a.get_pixel(50, 12).0[2] > 150);
        assert_eq!(a.get_pixel(0, 0).0, [255, 255, 255]);
    }

    #[test]
    fn two_triangles_leave_no_crack() {
        let red = Scene::new().mesh(&square(0.0, 1.0).triangulate(), Style::Solid([255, 0, 0]));
        let picture = render(&red, &camera(), SIZE);
        for i in 8..92 {
            assert!(picture.get_pixel(i, 100 - i).0[1] < 100, "crack on the diagonal at {i}");
        }
    }

    #[test]
    fn wires_show_on_their_surface_and_not_behind_another() {
        let poly = square(0.0, 0.7);
        let base = Scene::new().mesh(&poly.triangulate(), Style::Clay);
        let plain = render(&base, &camera(), SIZE);
        let wired = render(&base.wireframe_with(&poly, [0, 0, 0], 2.0), &camera(), SIZE);
        let changed = plain.pixels().zip(wired.pixels()).filter(|(a, b)| a != b).count();
        assert!((300..1000).contains(&changed), "{changed}");
        assert_eq!(plain.get_pixel(50, 50), wired.get_pixel(50, 50), "the triangulation's diagonal is not drawn");
        let cover = Scene::new().mesh(&square(0.1, 0.95).triangulate(), Style::Clay);
        let alone = render(&cover, &camera(), SIZE);
        let cover = Scene::new().mesh(&square(0.1, 0.95).triangulate(), Style::Clay).wireframe(&poly);
        assert_eq!(render(&cover, &camera(), SIZE), alone);
    }

    #[test]
    fn values_colour_vertices_and_nan_is_grey() {
        let mesh = square(0.0, 1.0).triangulate();
        let scale = ColourScale::new(ColourMap::BlueRed, -1.0, 1.0, "", "");
        let draw =
            |values: Vec<f64>| render(&Scene::new().mesh(&mesh, Style::Values(values, scale.clone())), &camera(), SIZE);
        let [r, _, b] = draw(vec![1.0; 4]).get_pixel(50, 50).0;
        assert!(r > b + 40);
        let [r, g, b] = draw(vec![f64::NAN; 4]).get_pixel(50, 50).0;
        assert!(r == g && g == b);
        assert_eq!(draw(vec![]), draw(vec![f64::NAN; 4]));
    }

    #[test]
    fn an_overlay_is_clay_where_its_weight_is_0_and_its_colour_where_it_is_1() {
        let mesh = square(0.0, 1.0).triangulate();
        let draw = |style| render(&Scene::new().mesh(&mesh, style), &camera(), SIZE);
        let clay = draw(Style::Clay);
        assert_eq!(draw(Style::Overlay(vec![0.0; 4], [255, 0, 0])), clay);
        assert_eq!(draw(Style::Overlay(vec![f64::NAN; 3], [255, 0, 0])), clay);
        assert_eq!(draw(Style::Overlay(vec![1.0; 4], [255, 0, 0])).get_pixel(50, 50).0, [255, 0, 0]);
        // Equation (4) in light: the stored colour c is about c^2.2.
        let half = draw(Style::Overlay(vec![0.5; 4], [255, 0, 0])).get_pixel(50, 50).0;
        let light = |c: u8| f64::from(c).powf(2.2);
        let expected = [0, 1, 2].map(|k| 0.5 * (light(clay.get_pixel(50, 50).0[k]) + light([255, 0, 0][k])));
        assert!((0..3).all(|k| (light(half[k]) / expected[k] - 1.0).abs() < 0.03), "{half:?}");
    }

    #[test]
    fn bad_input_draws_nothing_and_does_not_panic() {
        let empty = render(&Scene::new(), &camera(), SIZE);
        let mut mesh = square(0.0, 1.0).triangulate();
        mesh.positions[0] = Vec3::repeat(f64::NAN);
        mesh.triangles.push([0, 1, 99]);
        mesh.triangles.push([1, 1, 1]);
        mesh.triangles.remove(1);
        let broken = PolygonMesh { starts: vec![0, 9, 3], corners: vec![7, 8, 9], ..PolygonMesh::default() };
        let scene = Scene::new()
            .mesh(&mesh, Style::Clay)
            .mesh(&TriangleMesh::default(), Style::Clay)
            .mesh_without(&square(0.0, 1.0).triangulate(), &[true; 4], Style::Clay)
            .wireframe(&broken)
            .points(&[Vec3::repeat(f64::INFINITY), Vec3::repeat(1e300)], [0; 3], 3.0);
        assert_eq!(render(&scene, &camera(), SIZE), empty);
        assert_eq!(render(&scene, &camera(), [0, 7]).dimensions(), (0, 7));
        let inside =
            Camera::look(Vec3::zeros(), -Vec3::z(), Vec3::y(), Projection::Perspective { vertical_fov: 60.0 }).unwrap();
        let _ = render(&scene.mesh(&square(0.0, 1e9).triangulate(), Style::Clay), &inside, SIZE);
    }

    use crate::render::Projection;

    #[test]
    fn the_same_bytes_at_any_thread_count() {
        let poly = square(0.0, 0.9);
        let points: Vec<Vec3> = (0..200).map(|i| Vec3::new((i as f64).sin(), (i as f64 * 1.7).cos(), 0.05)).collect();
        let scene = || {
            Scene::new()
                .mesh(&poly.triangulate(), Style::Clay)
                .mesh(&square(0.02, 0.5).triangulate(), Style::Solid([0, 120, 200]))
                .wireframe(&poly)
                .points(&points, [200, 60, 0], 2.0)
        };
        let draw = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| render(&scene(), &camera(), SIZE))
        };
        assert_eq!(draw(1), draw(4));
    }
}
