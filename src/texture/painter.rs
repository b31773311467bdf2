//! The light of a scan anywhere on its triangles.

use std::path::PathBuf;

use super::picture::{Decoding, Picture, PictureKind};
use crate::io::{Paint, Wrap};
use crate::mesh::srgb::to_light;
use crate::mesh::{TriangleMesh, Vec3};

/// Why a scan's colours cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PaintError {
    /// An image that is none.
    #[error("{}: expected an image in PNG or JPEG ({named_by}), found {found}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What names it.
        named_by: String,
        /// What was found instead.
        found: String,
    },
    /// There is not as much as there are triangles or vertices.
    #[error("found {found} {what}, expected {expected}")]
    Count {
        /// Of what.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
}

/// What a triangle is painted with.
#[derive(Debug, Clone, Copy)]
struct Coat {
    light: Vec3,
    image: Option<usize>,
    wrap: [Wrap; 2],
}

/// The light of a scan: of its images, or of its vertices, or of its materials.
pub struct Painter {
    uvs: Vec<[[f32; 2]; 3]>,
    coat_of: Vec<u32>,
    coats: Vec<Coat>,
    pictures: Vec<Picture>,
    decoding: Decoding,
    /// Pixels of the image for each square millimetre of each triangle.
    density: Vec<f32>,
    triangles: Vec<[u32; 3]>,
    vertices: Option<Vec<Vec3>>,
    kinds: Vec<(PathBuf, PictureKind)>,
}

impl std::fmt::Debug for Painter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Painter").field("images", &self.kinds).finish_non_exhaustive()
    }
}

impl Painter {
    /// The light of `scan`, its vertices in millimetres, by `paint` where that has an image, else by `colors` of its vertices, 0-255
    /// in sRGB, else by the colour of its material. `None` if no triangle has one: no image with coordinates in it, no colour but the
    /// white of materials that state none.
    ///
    /// # Errors
    /// When an image cannot be decoded, or there is not one colour for each vertex, or coordinates for each triangle.
    pub fn new(
        scan: &TriangleMesh,
        paint: Option<&Paint>,
        colors: Option<&[[u8; 3]]>,
    ) -> Result<Option<Self>, PaintError> {
        let count = |what, found, expected| match found == expected {
            true => Ok(()),
            false => Err(PaintError::Count { what, found, expected }),
        };
        if let Some(colors) = colors {
            count("colours of vertices", colors.len(), scan.positions.len())?;
        }
        let mut painter = Self {
            uvs: Vec::new(),
            coat_of: Vec::new(),
            coats: Vec::new(),
            pictures: Vec::new(),
            decoding: Decoding::new(false),
            density: Vec::new(),
            triangles: scan.triangles.clone(),
            vertices: colors.map(|colors| colors.iter().map(|c| to_light(*c)).collect()),
            kinds: Vec::new(),
        };
        if let Some(paint) = paint.filter(|paint| !paint.materials.is_empty()) {
            count("triangles' texture coordinates", paint.uvs.len(), scan.triangles.len())?;
            count("triangles' materials", paint.material_of.len(), scan.triangles.len())?;
            for file in &paint.images {
                let picture = Picture::decode(file)?;
                painter.kinds.push((file.path.clone(), picture.kind()));
                painter.pictures.push(picture);
            }
            painter.decoding = Decoding::new(painter.sixteen_bits());
            painter.pictures.iter_mut().for_each(|picture| picture.reduce(&painter.decoding));
            let coat = |m: &crate::io::Material| Coat { light: m.light, image: m.image, wrap: m.wrap };
            painter.coats = paint.materials.iter().map(coat).collect();
            painter.coat_of.clone_from(&paint.material_of);
            painter.uvs.clone_from(&paint.uvs);
            painter.density = (0..scan.triangles.len()).map(|t| painter.density(scan, t)).collect();
        }
        let any = painter.vertices.is_some() || (0..scan.triangles.len()).any(|t| painter.is_painted(t));
        Ok(any.then_some(painter))
    }

    /// Whether a material has something to say of a triangle.
    fn is_painted(&self, triangle: usize) -> bool {
        let coat = self.coat_of.get(triangle).and_then(|&coat| self.coats.get(coat as usize));
        coat.is_some_and(|coat| match coat.image {
            Some(_) => self.uvs[triangle].as_flattened().iter().all(|x| x.is_finite()),
            None => coat.light != Vec3::repeat(1.0),
        })
    }

    /// The images, by file, with what is worth a word about them.
    #[must_use]
    pub fn images(&self) -> &[(PathBuf, PictureKind)] {
        &self.kinds
    }

    /// Whether an image has numbers of 16 bits.
    #[must_use]
    pub fn sixteen_bits(&self) -> bool {
        self.kinds.iter().any(|(_, kind)| kind.sixteen_bits)
    }

    /// The same for a triangle that was turned, or has other vertices at the same places: other corners come first.
    pub(super) fn turned(
        &self,
        triangle: usize,
        scan: &TriangleMesh,
        corners: [u32; 3],
        barycentric: [f64; 3],
    ) -> [f64; 3] {
        let own = self.triangles[triangle];
        if own == corners {
            return barycentric;
        }
        let place = |v: u32| scan.positions[v as usize];
        own.map(|v| corners.iter().position(|&c| place(c) == place(v)).map_or(0.0, |k| barycentric[k]))
    }

    /// The light at a point of a triangle, for a sample that stands for so many square millimetres; `None` where nothing is painted.
    pub(super) fn light(&self, triangle: usize, barycentric: [f64; 3], area: f64) -> Option<Vec3> {
        let coat = self.coat_of.get(triangle).and_then(|&coat| self.coats.get(coat as usize));
        if let Some((coat, image)) = coat.and_then(|coat| Some((coat, coat.image?))) {
            let corners = self.uvs[triangle];
            let uv = [0, 1].map(|k| (0..3).map(|c| f64::from(corners[c][k]) * barycentric[c]).sum::<f64>());
            if uv.iter().all(|x| x.is_finite()) {
                let pixels = f64::from(self.density[triangle]) * area;
                // half a logarithm, for it is of an area
                let level = if pixels >= 4.0 { (0.5 * pixels.log2()) as usize } else { 0 };
                let light = self.pictures[image].light(uv, coat.wrap, level, &self.decoding)?;
                return Some(light.component_mul(&coat.light));
            }
        }
        if let Some(vertices) = &self.vertices {
            let corners = self.triangles[triangle];
            return Some(corners.iter().zip(barycentric).map(|(&v, b)| vertices[v as usize] * b).sum());
        }
        coat.filter(|coat| coat.image.is_none()).map(|coat| coat.light)
    }

    fn density(&self, scan: &TriangleMesh, triangle: usize) -> f32 {
        let coat = self.coats.get(self.coat_of[triangle] as usize);
        let Some(image) = coat.and_then(|coat| coat.image) else { return 0.0 };
        let [a, b, c] = self.uvs[triangle].map(|uv| uv.map(f64::from));
        let in_image = 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs();
        let [width, height] = self.pictures[image].size();
        let [p, q, r] = scan.triangles[triangle].map(|v| scan.positions[v as usize]);
        let area = 0.5 * (q - p).cross(&(r - p)).norm();
        let density = in_image * (width * height) as f64 / area;
        if density.is_finite() { density as f32 } else { 0.0 }
    }
}
