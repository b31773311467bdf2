//! `--bake-texture` of `nonrigid register`: the scan's texture in the template's texture coordinates, as files beside the result.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use rayon::prelude::*;

use super::{Failure, file_name, has_extension, say, warn};
use crate::io::{self, Paint, Scan, write_atomically};
use crate::mesh::{ObjStatement, PolygonMesh};
use crate::texture::{
    BakeInput, BakeOptions, Baked, Painter, SIDES, bake, check_bake, encode_color, encode_displacement, encode_normals,
    encode_seen,
};

/// What is baked.
#[derive(Debug, Args)]
pub struct BakeArguments {
    /// Bake the scan's texture (OBJ with materials and PNG or JPEG images, glTF), or its colours at vertices, into one of SIZE x SIZE
    /// texels (16 to 8192) in the template's UVs: beside the result, NAME_color.png, NAME_seen.png (white: seen on the scan; grey:
    /// filled from round it; black: off the template) and, of NAME.obj, NAME.mtl; in a .glb itself
    #[arg(long, value_name = "SIZE", value_parser = clap::value_parser!(u16).range(*SIDES.start() as i64..=*SIDES.end() as i64))]
    bake_texture: Option<u16>,
    /// Bake the scan's shape as well, of what the template's mesh is too coarse for: NAME_normal.png (tangent space, green upwards),
    /// NAME_displacement.png (16 bits: black 3 mm inwards, white 3 mm outwards)
    #[arg(long, value_enum, value_name = "MAPS", value_delimiter = ',', requires = "bake_texture")]
    bake: Vec<BakeMap>,
}

/// A map of the scan's shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum BakeMap {
    /// Normals in tangent space
    Normal,
    /// How far the scan is along the template's normal
    Displacement,
}

impl BakeArguments {
    /// Whether anything is baked.
    pub fn asked(&self) -> bool {
        self.bake_texture.is_some()
    }

    /// Every file that could be written beside the result.
    pub fn output_paths(&self, out: &Path) -> Vec<(&'static str, PathBuf)> {
        if !self.asked() {
            return Vec::new();
        }
        let mut files: Vec<_> =
            ["color.png", "seen.png"].iter().map(|end| ("--bake-texture", beside(out, end))).collect();
        let library = has_extension(out, "obj").then(|| ("--bake-texture", out.with_extension("mtl")));
        files.extend(library);
        files.extend(self.bake.iter().map(|map| ("--bake", beside(out, map.ending()))));
        files.dedup();
        files
    }

    /// What is baked from, once it is known that there will be something to bake onto.
    pub fn prepare(
        &self,
        template: (&Path, &PolygonMesh),
        scan: (&Path, &Scan),
        paint: Option<&Paint>,
    ) -> Result<Option<Painter>, Failure> {
        let (template_path, template) = template;
        let (scan_path, scan) = scan;
        if let Err(e) = check_bake(template, &scan.mesh, &BakeOptions::default()) {
            let path = if scan.mesh.triangles.is_empty() { scan_path } else { template_path };
            return Err(Failure::loading(format!("{}: {e} (--bake-texture)", path.display())));
        }
        let painter = Painter::new(&scan.mesh, paint, scan.colors.as_deref()).map_err(Failure::loading)?;
        if painter.is_none() && self.bake.is_empty() {
            let message = format!(
                "{}: it has neither a texture (mtllib, usemtl, map_Kd and vt in OBJ, materials in glTF, TextureFile in PLY) nor colours \
                 at its vertices, so there is nothing to bake; --bake normal,displacement bakes its shape",
                scan_path.display()
            );
            return Err(Failure::loading(message));
        }
        for (path, kind) in painter.iter().flat_map(Painter::images) {
            let name = path.display();
            if kind.cmyk {
                warn(format_args!("{name}: made for print (CMYK), its colours are converted without its profile"));
            }
            if kind.sixteen_bits {
                warn(format_args!("{name}: 16 bits a colour, and so has the texture"));
            }
            if kind.holes {
                warn(format_args!("{name}: what is transparent in it counts as not seen"));
            }
        }
        Ok(painter)
    }

    /// Bakes, onto the registered template.
    pub fn bake(&self, input: &BakeInput<'_>) -> Result<Option<Baked>, Failure> {
        let Some(side) = self.bake_texture else { return Ok(None) };
        let options = BakeOptions { side: usize::from(side), shape: !self.bake.is_empty(), ..BakeOptions::default() };
        bake(input, &options).map(Some).map_err(Failure::computation)
    }

    /// Writes everything but the mesh, which is made to show the texture; its colours as a PNG, if there are any.
    pub fn write(&self, baked: &Baked, out: &Path, mesh: &mut PolygonMesh) -> Result<Option<Vec<u8>>, Failure> {
        let of_map = |map: &BakeMap| match map {
            BakeMap::Normal => (map.ending(), encode_normals as Encode),
            BakeMap::Displacement => (map.ending(), encode_displacement as Encode),
        };
        let mut maps: Vec<(&str, Encode)> = vec![("color.png", encode_color), ("seen.png", encode_seen)];
        maps.extend(self.bake.iter().map(of_map));
        let encoded: Vec<Option<Vec<u8>>> = maps.par_iter().map(|(_, encode)| encode(baked)).collect();
        for ((ending, _), bytes) in maps.iter().zip(&encoded) {
            if let Some(bytes) = bytes {
                write_atomically(&beside(out, ending), |file| file.write_all(bytes)).map_err(Failure::writing)?;
            }
        }
        let color = encoded.into_iter().next().flatten();
        if color.is_some() && has_extension(out, "obj") {
            let library = out.with_extension("mtl");
            let materials = show_texture(mesh, &file_name(&library));
            let materials: Vec<&str> = materials.iter().map(String::as_str).collect();
            io::write_image_materials(&library, &materials, &file_name(&color_of(out))).map_err(Failure::writing)?;
        }
        Ok(color)
    }

    /// Says what was baked, and what is odd about it.
    pub fn report(&self, baked: &Baked, out: &Path) -> Result<(), Failure> {
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        let on = file_name(&beside(out, "seen.png"));
        say(format_args!(
            "texture: {side} x {side}, {} of it on the template; the scan shows {} of that, the rest is filled from round it ({on})",
            percent(baked.covered.iter().filter(|c| **c).count() as f64 / baked.covered.len() as f64),
            percent(baked.seen_share()),
            side = baked.side,
        ))?;
        if baked.is_of_one_colour() {
            warn(
                "the texture has one colour: is the scan's image in another map of its material, such as emissiveTexture? Only \
                 baseColorTexture (glTF) and map_Kd (OBJ) are read",
            );
        }
        if baked.tiles.len() > 1 {
            let tiles: Vec<String> = baked.tiles.iter().take(12).map(i64::to_string).collect();
            warn(format_args!(
                "the template's UVs lie on {} tiles (UDIM {}): they share the one texture that is baked, as it repeats",
                baked.tiles.len(),
                tiles.join(", ")
            ));
        }
        if baked.shared > 0.002 {
            warn(format_args!(
                "{} of the texture lies on several polygons of the template (mirrored or stacked UVs): the first of them has its \
                 colours there",
                percent(baked.shared)
            ));
        }
        if baked.unplaced > 0 {
            warn(format_args!(
                "{} polygons of the template have no UVs, or UVs over more than 64 tiles: they have no texture",
                baked.unplaced
            ));
        }
        if baked.flat > 0 {
            warn(format_args!(
                "{} triangles of the template have no area in its UVs: they show a line of the texture",
                baked.flat
            ));
        }
        if has_extension(out, "ply") {
            warn("a result in PLY does not name its texture; give --out as .obj, .glb or .usda for one that shows it");
        }
        Ok(())
    }
}

/// A map as a PNG file, if it was baked.
type Encode = fn(&Baked) -> Option<Vec<u8>>;

impl BakeMap {
    fn ending(self) -> &'static str {
        match self {
            Self::Normal => "normal.png",
            Self::Displacement => "displacement.png",
        }
    }
}

/// Where the colours of a result go.
pub fn color_of(out: &Path) -> PathBuf {
    beside(out, "color.png")
}

fn beside(out: &Path, ending: &str) -> PathBuf {
    let mut name = out.file_stem().unwrap_or_default().to_owned();
    name.push("_");
    name.push(ending);
    out.with_file_name(name)
}

/// Gives all materials of a mesh to one library, and its polygons before the first `usemtl` a material; the materials.
fn show_texture(mesh: &mut PolygonMesh, library: &str) -> Vec<String> {
    let metadata = &mut mesh.metadata;
    metadata.material_libraries = vec![library.to_owned()];
    let material = |s: &(u32, ObjStatement)| matches!(s.1, ObjStatement::Material(_));
    if !metadata.statements.iter().any(|s| s.0 == 0 && material(s)) {
        metadata.statements.insert(0, (0, ObjStatement::Material("texture".to_owned())));
    }
    let mut names: Vec<String> = Vec::new();
    for (_, statement) in &metadata.statements {
        match statement {
            ObjStatement::Material(name) if !names.contains(name) => names.push(name.clone()),
            _ => {}
        }
    }
    names
}
