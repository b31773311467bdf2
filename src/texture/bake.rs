//! From the template along its normals to the scan, texel by texel.

use rayon::prelude::*;

use super::atlas::{Atlas, Patch};
use super::fill::fill;
use super::painter::Painter;
use super::tangents::tangents;
use super::{BakeError, SIDES};
use crate::mesh::adjacency::OpenBoundary;
use crate::mesh::closest_point::{Closest, ClosestPoint};
use crate::mesh::normals::{NormalWeighting, vertex_normals};
use crate::mesh::{PolygonMesh, TriangleMesh, Vec3};

/// Cosine of the widest angle between the normals of template and scan.
const FACING: f64 = 0.5;
/// Rows of texels that are baked together.
const BAND: usize = 8;

/// How a texture is baked.
#[derive(Debug, Clone, PartialEq)]
pub struct BakeOptions {
    /// Texels along a side of the texture, [`SIDES`]; default 2048.
    pub side: usize,
    /// Samples along a side of a texel, 1 to 8; default 2.
    pub supersampling: usize,
    /// How far from the template the scan may be, millimetres; default 3.
    pub reach: f64,
    /// Whether normals and displacement are baked too; default no.
    pub shape: bool,
}

impl Default for BakeOptions {
    fn default() -> Self {
        Self { side: 2048, supersampling: 2, reach: 3.0, shape: false }
    }
}

impl BakeOptions {
    fn fine(&self) -> usize {
        self.supersampling.clamp(1, 8)
    }
}

/// What is baked, and onto what; millimetres, in one frame.
#[derive(Debug, Clone, Copy)]
pub struct BakeInput<'a> {
    /// The template as registered, with its texture coordinates.
    pub template: &'a PolygonMesh,
    /// Where the scan has a say: from 0 to 1 at each vertex of the template; none: everywhere.
    pub mask: Option<&'a [f64]>,
    /// The scan, facing outwards.
    pub scan: &'a TriangleMesh,
    /// Its own normals, one a vertex; without them, those of the triangles.
    pub scan_normals: Option<&'a [Vec3]>,
    /// Its colours; none: only the shape can be baked.
    pub painter: Option<&'a Painter>,
    /// Which of the painter's triangles each one of the scan is; none: the same.
    pub sources: Option<&'a [u32]>,
}

impl<'a> BakeInput<'a> {
    /// The shape of a scan, everywhere.
    #[must_use]
    pub fn new(template: &'a PolygonMesh, scan: &'a TriangleMesh) -> Self {
        Self { template, mask: None, scan, scan_normals: None, painter: None, sources: None }
    }
}

/// A texture; rows from the top, texels from the left.
#[derive(Debug, Clone, PartialEq)]
pub struct Baked {
    /// Texels along a side.
    pub side: usize,
    /// Red, green and blue light, filled in where nothing is seen.
    pub light: Option<Vec<[f32; 3]>>,
    /// The scan's normal in the template's tangent space (along u, along v, outwards), and how far the scan is along the template's
    /// normal, millimetres.
    pub shape: Option<Vec<[f32; 4]>>,
    /// Which texels the scan shows.
    pub seen: Vec<bool>,
    /// Which texels lie on the template.
    pub covered: Vec<bool>,
    /// As in the options.
    pub reach: f64,
    /// Whether an image of the scan has 16 bits.
    pub sixteen_bits: bool,
    /// Share of the covered texels that more than one polygon covers: the first of them has its colours there.
    pub shared: f64,
    /// Samples whose colour is that of the closest point, as nothing lies along the normal; a share of those seen.
    pub by_closest: f64,
    /// Polygons with a corner that has no texture coordinates, or with any over more than 64 tiles: they have no texture.
    pub unplaced: usize,
    /// Triangles without area on the texture: they show one line of it.
    pub flat: usize,
    /// Tiles of the texture coordinates, by UDIM's numbers (1001 is the first): all share this texture.
    pub tiles: Vec<i64>,
}

impl Baked {
    /// Share of the texels on the template that the scan shows.
    #[must_use]
    pub fn seen_share(&self) -> f64 {
        let count = |of: &[bool]| of.iter().filter(|x| **x).count() as f64;
        count(&self.seen) / count(&self.covered).max(1.0)
    }

    /// Whether all that the scan shows has one colour.
    #[must_use]
    pub fn is_of_one_colour(&self) -> bool {
        let Some(light) = &self.light else { return false };
        let mut seen = light.iter().zip(&self.seen).filter(|(_, seen)| **seen).map(|(light, _)| light);
        let first = seen.next();
        let same =
            |light: &[f32; 3]| first.is_some_and(|first| first.iter().zip(light).all(|(a, b)| (a - b).abs() < 1e-4));
        first.is_some() && seen.all(same)
    }
}

/// What texels are made of.
struct Layers<'a> {
    light: &'a mut [[f32; 3]],
    shape: &'a mut [[f32; 4]],
    seen: &'a mut [bool],
    covered: &'a mut [bool],
}

/// Counts of samples, and of texels that are shared.
#[derive(Default, Clone, Copy)]
struct Counts {
    seen: u64,
    by_closest: u64,
    shared: u64,
}

/// Whether a scan can be baked onto a template, as far as that does not depend on where they lie.
///
/// # Errors
/// As [`bake`].
pub fn check_bake(template: &PolygonMesh, scan: &TriangleMesh, options: &BakeOptions) -> Result<(), BakeError> {
    atlas_of(&BakeInput::new(template, scan), options).map(drop)
}

fn atlas_of(input: &BakeInput<'_>, options: &BakeOptions) -> Result<Atlas, BakeError> {
    let BakeInput { template, scan, .. } = *input;
    if !SIDES.contains(&options.side) {
        return Err(BakeError::Size(options.side));
    }
    let count = |what, found: Option<usize>, expected| match found.filter(|f| *f != expected) {
        Some(found) => Err(BakeError::Count { what, found, expected }),
        None => Ok(()),
    };
    count("values of the mask", input.mask.map(<[_]>::len), template.positions.len())?;
    count("normals of the scan", input.scan_normals.map(<[_]>::len), scan.positions.len())?;
    if template.metadata.uvs.is_empty() || template.metadata.corner_uvs.is_empty() {
        return Err(BakeError::NoUvs);
    }
    count("texture indices of corners", Some(template.metadata.corner_uvs.len()), template.corners.len())?;
    if scan.triangles.is_empty() {
        return Err(BakeError::NoSurface);
    }
    let atlas = Atlas::new(template, options.side * options.fine());
    match (atlas.patches.is_empty(), atlas.flat > 0) {
        (true, true) => Err(BakeError::FlatUvs),
        (true, false) => Err(BakeError::NoUvs),
        _ => Ok(atlas),
    }
}

/// Bakes a texture: see the [module](super).
///
/// # Errors
/// When the size makes no sense, the template has no texture coordinates, the scan has no triangles, or counts or geometry do not fit.
pub fn bake(input: &BakeInput<'_>, options: &BakeOptions) -> Result<Baked, BakeError> {
    let BakeInput { template, scan, painter, .. } = *input;
    let atlas = atlas_of(input, options)?;
    let (side, fine) = (options.side, options.fine());
    let triangles = template.triangulate();
    triangles.check_indices()?;
    scan.check_indices()?;
    let projection = Projection::new(input, &atlas, triangles, options)?;

    let bands = side.div_ceil(BAND);
    let mut patches_of: Vec<Vec<u32>> = vec![Vec::new(); bands];
    for (index, patch) in atlas.patches.iter().enumerate() {
        let rows = patch.rows(0..side * fine);
        if !rows.is_empty() {
            let first = rows.start / (fine * BAND);
            patches_of[first..=(rows.end - 1) / (fine * BAND)].iter_mut().for_each(|band| band.push(index as u32));
        }
    }
    let texels = side * side;
    let mut light = vec![[0.0f32; 3]; if painter.is_some() { texels } else { 0 }];
    let mut shape = vec![[0.0f32; 4]; if options.shape { texels } else { 0 }];
    let (mut seen, mut covered) = (vec![false; texels], vec![false; texels]);
    let mut layers: Vec<Layers<'_>> = Vec::with_capacity(bands);
    {
        let mut shape = shape.chunks_mut(BAND * side);
        let mut light = light.chunks_mut(BAND * side);
        for (seen, covered) in seen.chunks_mut(BAND * side).zip(covered.chunks_mut(BAND * side)) {
            let (light, shape) = (light.next().unwrap_or_default(), shape.next().unwrap_or_default());
            layers.push(Layers { light, shape, seen, covered });
        }
    }
    let counts: Vec<Counts> = layers
        .into_par_iter()
        .zip(&patches_of)
        .enumerate()
        .map_init(Scratch::default, |scratch, (band, (layers, patches))| {
            let rows = band * BAND * fine..((band + 1) * BAND).min(side) * fine;
            let patches = patches.iter().map(|&p| &atlas.patches[p as usize]);
            projection.bake_band(layers, patches, rows, side, fine, scratch)
        })
        .collect();
    let total = counts.iter().fold(Counts::default(), |sum, c| Counts {
        seen: sum.seen + c.seen,
        by_closest: sum.by_closest + c.by_closest,
        shared: sum.shared + c.shared,
    });
    rayon::join(|| fill(side, &mut light, &seen, &covered), || fill(side, &mut shape, &seen, &covered));
    let on_template = covered.iter().filter(|c| **c).count().max(1) as f64;
    Ok(Baked {
        side,
        light: painter.map(|_| light),
        shape: options.shape.then_some(shape),
        reach: options.reach,
        sixteen_bits: painter.is_some_and(Painter::sixteen_bits),
        shared: total.shared as f64 / on_template,
        by_closest: total.by_closest as f64 / total.seen.max(1) as f64,
        unplaced: atlas.unplaced,
        flat: atlas.flat,
        tiles: atlas.tiles.iter().map(|[v, u]| 1001 + u + 10 * v).collect(),
        seen,
        covered,
    })
}

/// What a band of the texture is made with: allocated once a thread, since fresh memory costs a tenth of the baking.
#[derive(Default)]
struct Scratch {
    /// Polygon of each sample, counted from 1.
    owner: Vec<u32>,
    /// How many samples of each texel see the scan.
    samples: Vec<u8>,
    /// Texels on which several polygons lie.
    shared: Vec<bool>,
}

impl Scratch {
    fn cleared(&mut self, samples: usize, texels: usize) -> &mut Self {
        self.owner.clear();
        self.owner.resize(samples, 0);
        self.samples.clear();
        self.samples.resize(texels, 0);
        self.shared.clear();
        self.shared.resize(texels, false);
        self
    }
}

/// What projecting a sample needs.
struct Projection<'a> {
    input: &'a BakeInput<'a>,
    atlas: &'a Atlas,
    template: TriangleMesh,
    normals: Vec<Vec3>,
    tangents: Vec<[Vec3; 3]>,
    signs: Vec<f64>,
    tree: ClosestPoint,
    scan_normals: Vec<Vec3>,
    boundary: OpenBoundary,
    reach: f64,
}

/// What the scan shows.
struct Shown {
    at: Closest,
    normal: Vec3,
    by_closest: bool,
}

impl<'a> Projection<'a> {
    fn new(
        input: &'a BakeInput<'a>,
        atlas: &'a Atlas,
        template: TriangleMesh,
        options: &BakeOptions,
    ) -> Result<Self, BakeError> {
        let scan = input.scan;
        let rest = || {
            let scan_normals: Vec<Vec3> = match input.scan_normals {
                Some(normals) => normals.iter().map(|n| n.try_normalize(0.0).unwrap_or_default()).collect(),
                None => vertex_normals(&scan.positions, &scan.triangles, NormalWeighting::Area),
            };
            let normals = vertex_normals(&template.positions, &template.triangles, NormalWeighting::Area);
            let (tangents, signs) =
                if options.shape { tangents(input.template, atlas, &normals) } else { Default::default() };
            (scan_normals, normals, tangents, signs, OpenBoundary::of(scan))
        };
        let (tree, (scan_normals, normals, tangents, signs, boundary)) = rayon::join(|| ClosestPoint::new(scan), rest);
        let reach = options.reach;
        let tree = tree?;
        Ok(Self { input, atlas, template, normals, tangents, signs, tree, scan_normals, boundary, reach })
    }

    fn bake_band<'p>(
        &self,
        layers: Layers<'_>,
        patches: impl Iterator<Item = &'p Patch>,
        rows: std::ops::Range<usize>,
        side: usize,
        fine: usize,
        scratch: &mut Scratch,
    ) -> Counts {
        let columns = side * fine;
        let Layers { light, shape, seen, covered } = layers;
        let mut counts = Counts::default();
        let Scratch { owner, samples, shared } = scratch.cleared(rows.len() * columns, seen.len());
        for patch in patches {
            let triangle = patch.triangle as usize;
            let corners = self.template.triangles[triangle];
            let [points, normals] = [&self.template.positions, &self.normals].map(|of| corners.map(|v| of[v as usize]));
            let believed = corners.map(|v| self.input.mask.is_none_or(|mask| mask[v as usize] > 0.0));
            let polygon = self.atlas.polygon_of[triangle] + 1;
            let area = 0.5 * (points[1] - points[0]).cross(&(points[2] - points[0])).norm() / patch.area();
            let mut hint = Hint { triangle: u32::MAX, met: None };
            let mut last = usize::MAX;
            patch.samples(columns, rows.clone(), fine, |column, row, barycentric| {
                let sample = (row - rows.start) * columns + column;
                let texel = (row - rows.start) / fine * side + column / fine;
                if owner[sample] != 0 {
                    let inside = barycentric.iter().all(|b| *b > 1e-6);
                    shared[texel] |= inside && owner[sample] != polygon;
                    return;
                }
                owner[sample] = polygon;
                covered[texel] = true;
                let weight: f64 = (0..3).filter(|&k| believed[k]).map(|k| barycentric[k]).sum();
                if weight < 0.5 {
                    return;
                }
                let mix = |of: &[Vec3; 3]| of[0] * barycentric[0] + of[1] * barycentric[1] + of[2] * barycentric[2];
                let (p, n) = (mix(&points), mix(&normals));
                let Some(unit) = n.try_normalize(0.0) else { return };
                if last != texel {
                    (last, hint.met) = (texel, None);
                }
                let Some(shown) = self.shown(&p, &unit, &mut hint) else { return };
                let at = shown.at.triangle as usize;
                if let Some(painter) = self.input.painter {
                    let (scan, source) = (self.input.scan, self.input.sources.map_or(at, |of| of[at] as usize));
                    let own = painter.turned(source, scan, scan.triangles[at], shown.at.barycentric);
                    let Some(found) = painter.light(source, own, area) else { return };
                    (0..3).for_each(|k| light[texel][k] += found[k] as f32);
                }
                if let Some(texel) = shape.get_mut(texel) {
                    // as shaders do: neither tangent nor bitangent is made a unit vector after the interpolation
                    let tangent = mix(&self.tangents[triangle]);
                    let bitangent = n.cross(&tangent) * self.signs[triangle];
                    let frame = nalgebra::Matrix3::from_columns(&[tangent, bitangent, n]);
                    let inner = frame.try_inverse().map_or_else(Vec3::z, |inverse| inverse * shown.normal);
                    let inner = inner.try_normalize(0.0).unwrap_or_else(Vec3::z);
                    (0..3).for_each(|k| texel[k] += inner[k] as f32);
                    texel[3] += (shown.at.point - p).dot(&unit) as f32;
                }
                samples[texel] += 1;
                counts.seen += 1;
                counts.by_closest += u64::from(shown.by_closest);
            });
        }
        for (texel, samples) in samples.iter().enumerate().filter(|s| *s.1 > 0) {
            seen[texel] = true;
            let share = 1.0 / f32::from(*samples);
            light.get_mut(texel).into_iter().flatten().for_each(|x| *x *= share);
            shape.get_mut(texel).into_iter().flatten().for_each(|x| *x *= share);
        }
        counts.shared = shared.iter().filter(|s| **s).count() as u64;
        counts
    }

    /// What the scan shows at a point of the template with that unit normal.
    fn shown(&self, p: &Vec3, normal: &Vec3, hint: &mut Hint) -> Option<Shown> {
        let facing = |at: &Closest| {
            let corners = self.input.scan.triangles[at.triangle as usize];
            let sum: Vec3 = corners.iter().zip(at.barycentric).map(|(&v, b)| self.scan_normals[v as usize] * b).sum();
            sum.try_normalize(0.0).filter(|found| found.dot(normal) >= FACING)
        };
        if hint.met == Some(false) {
            return None;
        }
        let near = hint.met.and_then(|_| self.tree.along_to(p, normal, self.reach, hint.triangle));
        let met = near.or_else(|| self.tree.along(p, normal, self.reach, hint.triangle));
        if let Some((at, normal)) = met.and_then(|at| Some((at, facing(&at)?))) {
            *hint = Hint { triangle: at.triangle, met: Some(true) };
            return Some(Shown { at, normal, by_closest: false });
        }
        // the closest point is not one of a line: the next sample searches again
        let first = hint.met.is_none();
        hint.met = first.then_some(false);
        let at = self.tree.query_from_within(p, hint.triangle, self.reach * self.reach)?;
        let corners = self.input.scan.triangles[at.triangle as usize];
        if self.boundary.holds(at.triangle as usize, corners, at.barycentric) {
            return None;
        }
        let normal = facing(&at)?;
        *hint = Hint { triangle: at.triangle, met: None };
        Some(Shown { at, normal, by_closest: true })
    }
}

/// Where the scan was met last.
struct Hint {
    triangle: u32,
    /// What a line of the same texel has met: the scan (less than a texel away nothing else comes first), or nothing, and no closest
    /// point either, so that the rest of the texel is not looked for.
    met: Option<bool>,
}
