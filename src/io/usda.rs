//! Universal Scene Description as text (`.usda`): one mesh, at rest or with the points of every frame, its texture coordinates,
//! colours, and its materials and groups as subsets of faces. Lengths are millimetres, as the file says.

use std::collections::BTreeMap;
use std::io::{BufWriter, Write};
use std::path::Path;

use super::pc2::check_frames;
use super::{WriteError, write_atomically};
use crate::mesh::srgb::to_light;
use crate::mesh::{ObjStatement, PolygonMesh, Vec3};

/// Writes a mesh; `frames`, if there are several, are its vertices over time, `frames_per_second` of them.
///
/// # Errors
/// When the file cannot be written, there is no frame, one has not the mesh's number of vertices, colours are not one per vertex, or a
/// coordinate is not finite in 32 bits.
pub fn write_usda(
    path: &Path,
    mesh: &PolygonMesh,
    colors: Option<&[[u8; 3]]>,
    frames: &[Vec<Vec3>],
    frames_per_second: f64,
) -> Result<(), WriteError> {
    WriteError::check_count(path, "colours", colors.map(<[_]>::len), mesh.positions.len())?;
    check_frames(path, frames)?;
    WriteError::check_count(path, "positions in a frame", Some(frames[0].len()), mesh.positions.len())?;
    write_atomically(path, |w| write(w, mesh, colors, frames, frames_per_second))
}

fn write(
    w: &mut BufWriter<std::fs::File>,
    mesh: &PolygonMesh,
    colors: Option<&[[u8; 3]]>,
    frames: &[Vec<Vec3>],
    fps: f64,
) -> std::io::Result<()> {
    let moving = frames.len() > 1;
    writeln!(w, "#usda 1.0\n(\n    defaultPrim = \"Subject\"")?;
    if moving {
        let end = frames.len() - 1;
        writeln!(
            w,
            "    startTimeCode = 0\n    endTimeCode = {end}\n    framesPerSecond = {fps}\n    timeCodesPerSecond = {fps}"
        )?;
    }
    writeln!(
        w,
        "    metersPerUnit = 0.001\n    upAxis = \"Y\"\n    doc = \"nonrigid {}\"\n)\n",
        env!("CARGO_PKG_VERSION")
    )?;
    writeln!(w, "def Xform \"Subject\" (\n    kind = \"component\"\n)\n{{\n    def Mesh \"Surface\"\n    {{")?;
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
    if let Some(colors) = colors {
        write!(w, "        color3f[] primvars:displayColor = ")?;
        let light = colors.iter().map(|c| <[f64; 3]>::from(to_light(*c)).map(|x| x as f32));
        items(w, light, |w, c| write!(w, "({}, {}, {})", c[0], c[1], c[2]))?;
        writeln!(w, " (\n            interpolation = \"vertex\"\n        )")?;
    }
    subsets(w, mesh)?;
    writeln!(w, "    }}\n}}")
}

/// Faces by material and by group. A face may be in several groups, and in one material.
fn subsets(w: &mut impl Write, mesh: &PolygonMesh) -> std::io::Result<()> {
    let (mut materials, mut groups) = (BTreeMap::<&str, Vec<usize>>::new(), BTreeMap::<&str, Vec<usize>>::new());
    for (names, polygons) in mesh.groups() {
        for name in names.split_whitespace() {
            groups.entry(name).or_default().extend(polygons.clone());
        }
    }
    let uses = mesh.metadata.statements.iter().filter_map(|(first, statement)| match statement {
        ObjStatement::Material(name) => Some((name.as_str(), *first as usize)),
        _ => None,
    });
    let ends = uses.clone().skip(1).map(|u| u.1).chain([mesh.polygon_count()]);
    for ((name, first), end) in uses.zip(ends) {
        materials.entry(name).or_default().extend(first..end);
    }
    let mut taken = std::collections::BTreeSet::new();
    for (family, sets) in [("material", materials), ("group", groups)] {
        for (name, faces) in sets.into_iter().filter(|(_, faces)| !faces.is_empty()) {
            let prim = identifier(name, family, &mut taken);
            writeln!(
                w,
                "\n        def GeomSubset \"{prim}\" (\n            displayName = {}\n        )\n        {{",
                quoted(name)
            )?;
            writeln!(
                w,
                "            uniform token elementType = \"face\"\n            uniform token familyName = \"{family}\""
            )?;
            write!(w, "            int[] indices = ")?;
            items(w, faces.into_iter(), |w, f| write!(w, "{f}"))?;
            writeln!(w, "\n        }}")?;
        }
    }
    Ok(())
}

/// A name that the format allows, and that no other has.
fn identifier(name: &str, family: &str, taken: &mut std::collections::BTreeSet<String>) -> String {
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
