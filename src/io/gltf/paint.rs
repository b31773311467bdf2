//! Base colours of materials: factors, images, and where on an image a triangle lies.

use std::path::Path;

use serde_json::Value;

use super::document::{Loaded, MaterialRuns, Sampler, beside_file, from_base64};
use crate::io::error::{excerpt, read_side_file};
use crate::io::{ImageFile, Material, Paint, ReadError, Wrap};
use crate::mesh::{PolygonMesh, Vec3};

/// `KHR_texture_transform`: offset, rotation, scale, of coordinates with v downwards.
struct Transform {
    offset: [f64; 2],
    rotation: f64,
    scale: [f64; 2],
}

impl Transform {
    fn of(info: &Value) -> Self {
        let stated = &info["extensions"]["KHR_texture_transform"];
        let pair = |name: &str, default: f64| {
            [0, 1].map(|k| stated[name][k].as_f64().filter(|x| x.is_finite()).unwrap_or(default))
        };
        let rotation = stated["rotation"].as_f64().unwrap_or(0.0);
        Self { offset: pair("offset", 0.0), rotation, scale: pair("scale", 1.0) }
    }

    /// Coordinates with v upwards, before and after.
    fn apply(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.rotation.sin_cos();
        let (u, v) = (u * self.scale[0], (1.0 - v) * self.scale[1]);
        [cos * u + sin * v + self.offset[0], 1.0 - (cos * v - sin * u + self.offset[1])]
    }
}

/// The paint of a scene's polygons.
pub(super) fn paint_of(file: &Loaded<'_>, mesh: &PolygonMesh, runs: &MaterialRuns) -> Result<Paint, ReadError> {
    let mut paint = Paint::default();
    let mut transforms: Vec<Transform> = Vec::new();
    let mut index = vec![u32::MAX; file.document.materials.len()];
    let mut images = vec![None; file.document.images.len()];
    for material in runs.iter().filter_map(|run| run.1) {
        if index[material] == u32::MAX {
            index[material] = paint.materials.len() as u32;
            let (material, transform) = read_material(file, material, &mut paint, &mut images)?;
            paint.materials.push(material);
            transforms.push(transform);
        }
    }
    let mut runs = runs.iter().peekable();
    let mut current = u32::MAX;
    let metadata = &mesh.metadata;
    for f in 0..mesh.polygon_count() {
        while let Some((_, material)) = runs.next_if(|(first, _)| *first as usize <= f) {
            current = material.map_or(u32::MAX, |m| index[m]);
        }
        let transform = transforms.get(current as usize);
        let uv = |c: u32| match metadata.corner_uvs.get(c as usize) {
            Some(&uv) if uv != u32::MAX => {
                let uv = metadata.uvs[uv as usize];
                transform.map_or(uv, |t| t.apply(uv)).map(|x| x as f32)
            }
            _ => [f32::NAN; 2],
        };
        let (first, end) = (mesh.starts[f], mesh.starts[f + 1]);
        for c in first + 1..end - 1 {
            paint.uvs.push([uv(first), uv(c), uv(c + 1)]);
            paint.material_of.push(current);
        }
    }
    Ok(paint)
}

fn read_material(
    file: &Loaded<'_>,
    number: usize,
    paint: &mut Paint,
    images: &mut [Option<usize>],
) -> Result<(Material, Transform), ReadError> {
    let stated = file.entry(&file.document.materials, number, "materials")?;
    // the older extension says the same in other words
    let old = &stated.extensions["KHR_materials_pbrSpecularGlossiness"];
    let pbr = &stated.pbr_metallic_roughness;
    let (info, factor) = match old["diffuseTexture"].is_object() && !pbr["baseColorTexture"].is_object() {
        true => (&old["diffuseTexture"], &old["diffuseFactor"]),
        false => (&pbr["baseColorTexture"], &pbr["baseColorFactor"]),
    };
    let light = Vec3::from([0, 1, 2].map(|k| factor[k].as_f64().filter(|c| c.is_finite()).unwrap_or(1.0)));
    let mut material = Material { name: stated.name.clone(), light, image: None, wrap: [Wrap::Repeat; 2] };
    let transform = Transform::of(info);
    if !info.is_object() {
        return Ok((material, transform));
    }
    let texture_set = info["extensions"]["KHR_texture_transform"]["texCoord"].as_u64().or(info["texCoord"].as_u64());
    if let Some(set) = texture_set.filter(|set| *set != 0) {
        return file.malformed(
            format!(
                "the colours of material {number} on TEXCOORD_0, the coordinates that are read: export again with these as the first set"
            ),
            format!("TEXCOORD_{set}"),
        );
    }
    let index = info["index"].as_u64().map_or(usize::MAX, |i| i as usize);
    let texture = file.entry(&file.document.textures, index, "textures")?;
    if let Some(sampler) = texture.sampler {
        let Sampler { wrap_s, wrap_t } = file.entry(&file.document.samplers, sampler, "samplers")?;
        material.wrap = [*wrap_s, *wrap_t].map(|wrap| match wrap {
            Some(33071) => Wrap::Clamp,
            Some(33648) => Wrap::Mirror,
            _ => Wrap::Repeat,
        });
    }
    let Some(image) = texture.source else {
        return file.malformed(format!("an image in PNG or JPEG of texture {index}"), "none");
    };
    file.entry(&file.document.images, image, "images")?;
    if images[image].is_none() {
        images[image] = Some(paint.images.len());
        paint.images.push(read_image(file, image)?);
    }
    material.image = images[image];
    Ok((material, transform))
}

fn read_image(file: &Loaded<'_>, number: usize) -> Result<ImageFile, ReadError> {
    let image = file.entry(&file.document.images, number, "images")?;
    let named_by = format!("image {number} of {}", file.path.display());
    let inside = |bytes: Vec<u8>| ImageFile { path: file.path.to_owned(), named_by: named_by.clone(), bytes };
    match (&image.uri, image.buffer_view) {
        (None, Some(view)) => {
            let view = file.entry(&file.document.buffer_views, view, "bufferViews")?;
            let buffer = file.entry(&file.buffers, view.buffer, "buffers")?;
            let end = view.byte_offset.checked_add(view.byte_length);
            match end.and_then(|end| buffer.get(view.byte_offset..end)) {
                Some(bytes) => Ok(inside(bytes.to_vec())),
                None => file.malformed(format!("{named_by} inside of its buffer"), format!("byte {end:?}")),
            }
        }
        (Some(uri), _) => match uri.strip_prefix("data:") {
            Some(data) => match from_base64(data) {
                Ok(bytes) => Ok(inside(bytes)),
                Err(expected) => file.malformed(expected, format!("{named_by}, {}", excerpt(uri.as_bytes()))),
            },
            None => match beside_file(file.path, uri) {
                Some(path) => read_beside(&path, named_by),
                None => file.malformed("a data uri or the relative path of a file", excerpt(uri.as_bytes())),
            },
        },
        (None, None) => file.malformed("a uri or a bufferView", format!("none in {named_by}")),
    }
}

fn read_beside(path: &Path, named_by: String) -> Result<ImageFile, ReadError> {
    let read = read_side_file(path);
    let bytes = read.map_err(|e| e.named_by(&named_by))?;
    Ok(ImageFile { path: path.to_owned(), named_by, bytes })
}
