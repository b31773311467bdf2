//! Universal Scene Description as text (`.usda`): one mesh, at rest or with the points of every frame, its texture coordinates,
//! colours, and its materials (bound, and showing a texture, if there is one), groups, objects and smoothing groups as subsets of
//! faces. Lengths are millimetres, as the file says.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufWriter, Write};
use std::path::Path;

use super::pc2::check_frames;
use super::{WriteError, write_atomically};
use crate::mesh::srgb::to_light;
use crate::mesh::{ObjStatement, PolygonMesh, Vec3};

/// A mesh's vertices over time.
#[derive(Debug, Clone, Copy)]
pub struct Clip<'a> {
    /// Positions of every frame.
    pub frames: &'a [Vec<Vec3>],
    /// How fast they follow each other.
    pub frames_per_second: f64,
    /// Numbers, from 0, of those that were lost.
    pub lost: &'a [usize],
}

/// Writes a mesh, which moves if there are several frames; which were lost stands in `customLayerData`. Its materials show `texture`, the
/// name of an image in the same folder.
///
/// # Errors
/// When the file cannot be written, there is no frame, one has not the mesh's number of vertices, colours are not one per vertex, or a
/// coordinate is not finite in 32 bits.
pub fn write_usda(
    path: &Path,
    mesh: &PolygonMesh,
    colors: Option<&[[u8; 3]]>,
    clip: &Clip<'_>,
    texture: Option<&str>,
) -> Result<(), WriteError> {
    WriteError::check_count(path, "colours", colors.map(<[_]>::len), mesh.positions.len())?;
    check_frames(path, clip.frames)?;
    WriteError::check_count(path, "positions in a frame", Some(clip.frames[0].len()), mesh.positions.len())?;
    write_atomically(path, |w| write(w, mesh, colors, clip, texture))
}

fn write(
    w: &mut BufWriter<std::fs::File>,
    mesh: &PolygonMesh,
    colors: Option<&[[u8; 3]]>,
    clip: &Clip<'_>,
    texture: Option<&str>,
) -> std::io::Result<()> {
    let (frames, fps) = (clip.frames, clip.frames_per_second);
    let moving = frames.len() > 1;
    writeln!(w, "#usda 1.0\n(\n    defaultPrim = \"Subject\"")?;
    if moving {
        let end = frames.len() - 1;
        writeln!(
            w,
            "    startTimeCode = 0\n    endTimeCode = {end}\n    framesPerSecond = {fps}\n    timeCodesPerSecond = {fps}"
        )?;
    }
    if !clip.lost.is_empty() {
        write!(w, "    customLayerData = {{\n        int[] lostFrames = ")?;
        items(w, clip.lost.iter(), |w, k| write!(w, "{k}"))?;
        writeln!(w, "\n    }}")?;
    }
    writeln!(
        w,
        "    metersPerUnit = 0.001\n    upAxis = \"Y\"\n    doc = \"nonrigid {}\"\n)\n",
        env!("CARGO_PKG_VERSION")
    )?;
    writeln!(w, "def Xform \"Subject\" (\n    kind = \"component\"\n)\n{{\n    def Mesh \"Surface\"")?;
    let subsets = subsets(mesh);
    let materials: Vec<&Subset<'_>> = subsets.iter().filter(|s| s.family == MATERIALS).collect();
    let whole = if materials.is_empty() { texture.map(|_| "texture") } else { None };
    if whole.is_some() {
        write!(w, " (\n        prepend apiSchemas = [\"MaterialBindingAPI\"]\n    )")?;
    }
    writeln!(w, "\n    {{")?;
    if let Some(name) = whole {
        writeln!(w, "        rel material:binding = </Subject/Materials/{name}>")?;
    }
    let counts = (0..mesh.polygon_count()).map(|f| mesh.polygon(f).len());
    list(w, "int[] faceVertexCounts", counts, |w, n| write!(w, "{n}"))?;
    list(w, "int[] faceVertexIndices", mesh.corners.iter(), |w, v| write!(w, "{v}"))?;
    writeln!(w, "        uniform token subdivisionScheme = \"none\"")?;
    if moving {
        writeln!(w, "        float3[] extent.timeSamples = {{")?;
        for (k, frame) in frames.iter().enumerate() {
            writeln!(w, "            {k}: {},", extent(frame))?;
        }
        writeln!(w, "        }}\n        point3f[] points.timeSamples = {{")?;
        for (k, frame) in frames.iter().enumerate() {
            write!(w, "            {k}: ")?;
            items(w, frame.iter(), point)?;
            writeln!(w, ",")?;
        }
        writeln!(w, "        }}")?;
    } else {
        writeln!(w, "        float3[] extent = {}", extent(&frames[0]))?;
        list(w, "point3f[] points", frames[0].iter(), point)?;
    }
    if !mesh.metadata.corner_uvs.is_empty() {
        // a corner without texture coordinates has those of the last place, which is nowhere else used
        let nowhere = mesh.metadata.uvs.len();
        let used = mesh.metadata.corner_uvs.iter().map(|&t| if t == u32::MAX { nowhere } else { t as usize });
        let missing = mesh.metadata.corner_uvs.contains(&u32::MAX);
        let uvs = mesh.metadata.uvs.iter().copied().chain(missing.then_some([0.0; 2]));
        write!(w, "        texCoord2f[] primvars:st = ")?;
        items(w, uvs, |w, uv| write!(w, "({}, {})", uv[0] as f32, uv[1] as f32))?;
        writeln!(w, " (\n            interpolation = \"faceVarying\"\n        )")?;
        list(w, "int[] primvars:st:indices", used, |w, t| write!(w, "{t}"))?;
    }
    let (normals, corner_normals) = mesh.corner_normals();
    if !moving && !normals.is_empty() {
        let of = corner_normals.iter().map(|&n| normals.get(n as usize).copied().unwrap_or_else(Vec3::z));
        write!(w, "        normal3f[] normals = ")?;
        items(w, of, |w, n| write!(w, "({:.6}, {:.6}, {:.6})", n.x, n.y, n.z))?;
        writeln!(w, " (\n            interpolation = \"faceVarying\"\n        )")?;
    }
    if let Some(colors) = colors {
        write!(w, "        color3f[] primvars:displayColor = ")?;
        let light = colors.iter().map(|c| <[f64; 3]>::from(to_light(*c)).map(|x| x as f32));
        items(w, light, |w, c| write!(w, "({}, {}, {})", c[0], c[1], c[2]))?;
        writeln!(w, " (\n            interpolation = \"vertex\"\n        )")?;
    }
    if !materials.is_empty() {
        writeln!(w, "        uniform token subsetFamily:{MATERIALS}:familyType = \"nonOverlapping\"")?;
    }
    for subset in &subsets {
        subset.write(w)?;
    }
    writeln!(w, "    }}")?;
    let names = materials.iter().map(|s| (s.prim.as_str(), s.name)).chain(whole.map(|name| (name, name)));
    let names: Vec<(&str, &str)> = names.collect();
    if !names.is_empty() {
        writeln!(w, "\n    def Scope \"Materials\"\n    {{")?;
        for (k, (prim, name)) in names.into_iter().enumerate() {
            material(w, prim, name, texture, k > 0)?;
        }
        writeln!(w, "    }}")?;
    }
    writeln!(w, "}}")
}

/// The family of the subsets that have a material.
const MATERIALS: &str = "materialBind";

/// A material, whose surface shows the texture.
fn material(w: &mut impl Write, prim: &str, name: &str, texture: Option<&str>, gap: bool) -> std::io::Result<()> {
    if gap {
        writeln!(w)?;
    }
    writeln!(
        w,
        "        def Material \"{prim}\" (\n            displayName = {}\n        )\n        {{",
        quoted(name)
    )?;
    if let Some(texture) = texture {
        let image = texture.replace("@@@", "\\@@@");
        let here = format!("/Subject/Materials/{prim}");
        write!(
            w,
            "            token outputs:surface.connect = <{here}/surface.outputs:surface>

            def Shader \"surface\"
            {{
                uniform token info:id = \"UsdPreviewSurface\"
                color3f inputs:diffuseColor.connect = <{here}/image.outputs:rgb>
                float inputs:roughness = 0.7
                token outputs:surface
            }}

            def Shader \"image\"
            {{
                uniform token info:id = \"UsdUVTexture\"
                asset inputs:file = @@@./{image}@@@
                token inputs:sourceColorSpace = \"sRGB\"
                float2 inputs:st.connect = <{here}/place.outputs:result>
                token inputs:wrapS = \"repeat\"
                token inputs:wrapT = \"repeat\"
                float3 outputs:rgb
            }}

            def Shader \"place\"
            {{
                uniform token info:id = \"UsdPrimvarReader_float2\"
                string inputs:varname = \"st\"
                float2 outputs:result
            }}
"
        )?;
    }
    writeln!(w, "        }}")
}

/// Some faces of a mesh.
struct Subset<'a> {
    family: &'static str,
    name: &'a str,
    prim: String,
    faces: Vec<usize>,
}

impl Subset<'_> {
    fn write(&self, w: &mut impl Write) -> std::io::Result<()> {
        let Self { family, name, prim, faces } = self;
        let bound =
            if *family == MATERIALS { "\n            prepend apiSchemas = [\"MaterialBindingAPI\"]" } else { "" };
        let name = quoted(name);
        writeln!(
            w,
            "\n        def GeomSubset \"{prim}\" (\n            displayName = {name}{bound}\n        )\n        {{"
        )?;
        writeln!(
            w,
            "            uniform token elementType = \"face\"\n            uniform token familyName = \"{family}\""
        )?;
        write!(w, "            int[] indices = ")?;
        items(w, faces.iter(), |w, f| write!(w, "{f}"))?;
        if *family == MATERIALS {
            write!(w, "\n            rel material:binding = </Subject/Materials/{prim}>")?;
        }
        writeln!(w, "\n        }}")
    }
}

/// Faces by material, group, object and smoothing group. A face may be in several groups, and in one of each of the others.
fn subsets(mesh: &PolygonMesh) -> Vec<Subset<'_>> {
    const FAMILIES: [&str; 4] = [MATERIALS, "group", "object", "smoothing"];
    let mut found: [BTreeMap<&str, Vec<usize>>; 4] = Default::default();
    let mut current: [Vec<&str>; 4] = Default::default();
    let mut statements = mesh.metadata.statements.iter().peekable();
    for f in 0..mesh.polygon_count() {
        while let Some((_, statement)) = statements.next_if(|(first, _)| *first as usize <= f) {
            match statement {
                ObjStatement::Material(name) => current[0] = vec![name],
                ObjStatement::Group(names) => current[1] = names.split_whitespace().collect(),
                ObjStatement::Object(name) => current[2] = vec![name],
                ObjStatement::Smoothing(value) => current[3] = vec![value],
            }
        }
        for (sets, names) in found.iter_mut().zip(&current) {
            names.iter().for_each(|name| sets.entry(name).or_default().push(f));
        }
    }
    let mut taken = BTreeSet::new();
    let named = FAMILIES.into_iter().zip(found);
    named
        .flat_map(|(family, sets)| sets.into_iter().map(move |(name, faces)| (family, name, faces)))
        .map(|(family, name, faces)| {
            let prefix = if family == MATERIALS { "material" } else { family };
            Subset { family, name, prim: identifier(name, prefix, &mut taken), faces }
        })
        .collect()
}

/// A name that the format allows, and that no other has.
fn identifier(name: &str, family: &str, taken: &mut BTreeSet<String>) -> String {
    let plain: String = name.chars().take(100).map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    let first = format!("{family}_{plain}");
    let numbered = (2..).map(|k| format!("{first}_{k}"));
    let free = std::iter::once(first.clone()).chain(numbered).find(|n| !taken.contains(n));
    let free = free.unwrap_or(first);
    taken.insert(free.clone());
    free
}

/// A string of the format.
fn quoted(text: &str) -> String {
    let escaped: String = text
        .chars()
        .filter(|c| !c.is_control())
        .flat_map(|c| if matches!(c, '"' | '\\') { vec!['\\', c] } else { vec![c] })
        .collect();
    format!("\"{escaped}\"")
}

fn extent(points: &[Vec3]) -> String {
    let bound = |pick: fn(f32, f32) -> f32| {
        let all = points.iter().map(|p| [p.x as f32, p.y as f32, p.z as f32]);
        let [x, y, z] = all.reduce(|a, b| [0, 1, 2].map(|k| pick(a[k], b[k]))).unwrap_or_default();
        format!("({x}, {y}, {z})")
    };
    format!("[{}, {}]", bound(f32::min), bound(f32::max))
}

fn point(w: &mut BufWriter<std::fs::File>, p: &Vec3) -> std::io::Result<()> {
    write!(w, "({}, {}, {})", p.x as f32, p.y as f32, p.z as f32)
}

fn list<W: Write, T>(
    w: &mut W,
    what: &str,
    values: impl Iterator<Item = T>,
    one: impl Fn(&mut W, T) -> std::io::Result<()>,
) -> std::io::Result<()> {
    write!(w, "        {what} = ")?;
    items(w, values, one)?;
    writeln!(w)
}

fn items<W: Write, T>(
    w: &mut W,
    values: impl Iterator<Item = T>,
    one: impl Fn(&mut W, T) -> std::io::Result<()>,
) -> std::io::Result<()> {
    write!(w, "[")?;
    for (k, value) in values.enumerate() {
        if k > 0 {
            write!(w, ", ")?;
        }
        one(w, value)?;
    }
    write!(w, "]")
}
