//! Writing: one node, one mesh, a primitive for each run of polygons of one material, on the same vertices; one container.

use std::io::Write;
use std::ops::Range;
use std::path::Path;

use nalgebra::{Rotation3, UnitQuaternion};
use serde_json::{Map, Value, json};

use super::MILLIMETRES_PER_METRE;
use super::topology::{Triangles, split};
use crate::io::{WriteError, write_atomically};
use crate::mesh::normals::{NormalWeighting, vertex_normals};
use crate::mesh::srgb::to_light;
use crate::mesh::{ObjStatement, PolygonMesh, Pose, Vec3};

const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Writes a mesh as `.glb`, with normals, and morph targets if there are any: `target_deltas` target by target, vertex by
/// vertex, x y z, in millimetres. Targets that move few vertices are stored sparsely. `extras` comes back from
/// [`read_gltf`](super::read_gltf) as it is. A mesh without polygons becomes points. Targets have no normals of their own, but where they
/// are [animated](write_animated_glb).
///
/// # Errors
/// When the file cannot be written, a coordinate is not finite in 32 bits, texture indices do not belong to the corners, a
/// polygon has fewer than three corners, or there are not as many displacements as names times vertices.
pub fn write_glb(
    path: &Path,
    mesh: &PolygonMesh,
    target_names: &[&str],
    target_deltas: &[f32],
    extras: &Map<String, Value>,
) -> Result<(), WriteError> {
    write_painted_glb(path, mesh, Look::default(), target_names, target_deltas, extras)
}

/// How a mesh moves: a pose and the weights of its morph targets for every frame.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    /// Frames a second.
    pub frames_per_second: f64,
    /// From the mesh's frame, millimetres, to that of the scene.
    pub poses: &'a [Pose],
    /// As many as targets, for every frame.
    pub weights: &'a [Vec<f64>],
    /// Numbers, from 0, of frames that were lost: `extras.lostFrames` of the animation.
    pub lost: &'a [usize],
}

/// [`write_glb`] with colours per vertex, if given, and an animation of node and morph targets, linear between frames.
///
/// # Errors
/// As [`write_glb`]; and when frames have not a weight for each target, or colours are not one per vertex.
pub fn write_animated_glb(
    path: &Path,
    mesh: &PolygonMesh,
    colors: Option<&[[u8; 3]]>,
    target_names: &[&str],
    target_deltas: &[f32],
    motion: &Motion<'_>,
) -> Result<(), WriteError> {
    let expected = || format!("{} frames, each with {} weights", motion.poses.len(), target_names.len());
    if motion.weights.len() != motion.poses.len() || motion.weights.iter().any(|w| w.len() != target_names.len()) {
        return Err(WriteError::data(path, expected(), format!("{} of others", motion.weights.len())));
    }
    let look = Look { colors, motion: Some(motion), ..Look::default() };
    write_painted_glb(path, mesh, look, target_names, target_deltas, &Map::new())
}

/// What a mesh looks like.
#[derive(Clone, Copy, Default)]
pub(in crate::io) struct Look<'a> {
    /// sRGB, one per vertex.
    pub colors: Option<&'a [[u8; 3]]>,
    /// A PNG file, which the texture coordinates are of.
    pub png: Option<&'a [u8]>,
    /// How it moves.
    pub motion: Option<&'a Motion<'a>>,
}

/// [`write_glb`] with colours.
pub(in crate::io) fn write_painted_glb(
    path: &Path,
    mesh: &PolygonMesh,
    Look { colors, png, motion }: Look<'_>,
    target_names: &[&str],
    target_deltas: &[f32],
    extras: &Map<String, Value>,
) -> Result<(), WriteError> {
    WriteError::check_count(path, "colours", colors.map(<[_]>::len), mesh.positions.len())?;
    check(path, mesh, target_names, target_deltas)?;
    let (Triangles { positions, uvs, triangles, .. }, mut note) = split(mesh);
    note.extras = extras.clone();
    let sources = || (0..mesh.positions.len()).chain(note.copies.iter().map(|&v| v as usize));

    let mut file = Contents::default();
    let metres = |mm: f64| (mm / MILLIMETRES_PER_METRE) as f32;
    let points: Vec<[f32; 3]> = positions.iter().map(|p| [metres(p.x), metres(p.y), metres(p.z)]).collect();
    let mut attributes = json!({ "POSITION": file.points(&points) });
    if let Some(colors) = colors {
        let light: Vec<f32> = sources().flat_map(|v| <[f64; 3]>::from(to_light(colors[v])).map(|c| c as f32)).collect();
        attributes["COLOR_0"] = json!(file.floats(&light, "VEC3"));
    }
    let mut primitive = Map::new();
    // of the mesh, not of the copies, so that no seam shows; and of what is written, so that it is written the same again
    let own = points[..mesh.positions.len()].iter();
    let written: Vec<Vec3> = own.map(|p| Vec3::from(p.map(f64::from)) * MILLIMETRES_PER_METRE).collect();
    let fans = mesh.triangulate().triangles;
    let normals_at = |points: &[Vec3]| -> Vec<Vec3> {
        let normals = vertex_normals(points, &fans, NormalWeighting::Area).into_iter();
        normals.map(|n| if n == Vec3::zeros() { Vec3::z() } else { n }).collect()
    };
    let normals = normals_at(&written);
    let short = |v: &Vec3| [v.x as f32, v.y as f32, v.z as f32];
    if triangles.is_empty() {
        primitive.insert("mode".into(), json!(0));
    } else {
        attributes["NORMAL"] =
            json!(file.floats(sources().map(|v| short(&normals[v])).collect::<Vec<_>>().as_flattened(), "VEC3"));
        if !uvs.is_empty() {
            let uvs: Vec<f32> = uvs.iter().flat_map(|uv| [uv[0] as f32, (1.0 - uv[1]) as f32]).collect();
            attributes["TEXCOORD_0"] = json!(file.floats(&uvs, "VEC2"));
        }
    }
    primitive.insert("attributes".into(), attributes);
    let mut of_mesh = Map::new();
    let mut mesh_extras = Map::new();
    if !target_names.is_empty() {
        let width = 3 * mesh.positions.len();
        let target = |k: usize| -> Value {
            let deltas = &target_deltas[k * width..(k + 1) * width];
            let deltas: Vec<[f32; 3]> =
                sources().map(|v| [0, 1, 2].map(|a| metres(f64::from(deltas[3 * v + a])))).collect();
            let mut target = json!({ "POSITION": file.displacements(&deltas) });
            if motion.is_some() && !triangles.is_empty() {
                let moved: Vec<Vec3> = written
                    .iter()
                    .zip(target_deltas[k * width..].chunks_exact(3))
                    .map(|(p, d)| p + Vec3::new(d[0].into(), d[1].into(), d[2].into()))
                    .collect();
                let turned = normals_at(&moved);
                let turns: Vec<[f32; 3]> = sources().map(|v| short(&(turned[v] - normals[v]))).collect();
                target["NORMAL"] = json!(file.displacements(&turns));
            }
            target
        };
        primitive.insert("targets".into(), (0..target_names.len()).map(target).collect());
        of_mesh.insert("weights".into(), json!(vec![0.0; target_names.len()]));
        mesh_extras.insert("targetNames".into(), json!(target_names));
    }
    let note = serde_json::to_value(&note).map_err(|e| WriteError::data(path, "notes as JSON", e.to_string()))?;
    mesh_extras.insert("nonrigid".into(), note);
    of_mesh.insert("extras".into(), mesh_extras.into());
    let runs = material_runs(mesh);
    let mut names: Vec<Option<&str>> = Vec::new();
    let mut primitives: Vec<Value> = Vec::new();
    for (material, range) in runs.iter().filter(|(_, range)| !range.is_empty()) {
        let known = names.iter().position(|name| name == material);
        let number = known.unwrap_or_else(|| {
            names.push(*material);
            names.len() - 1
        });
        primitive.insert("material".into(), json!(number));
        primitive.insert("indices".into(), json!(file.indices(triangles[range.clone()].as_flattened(), points.len())));
        primitives.push(primitive.clone().into());
    }
    if primitives.is_empty() {
        primitives.push(primitive.into());
    }
    of_mesh.insert("primitives".into(), primitives.into());
    let mut document = json!({
        "asset": { "version": "2.0", "generator": concat!("nonrigid ", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [of_mesh],
    });
    if let Some(motion) = motion {
        document["animations"] = json!([file.animation(motion, !target_names.is_empty())]);
    }
    document["accessors"] = json!(file.accessors);
    if !triangles.is_empty() {
        // the format's default is metal, which is black without surroundings
        let mut surface = json!({ "metallicFactor": 0.0, "roughnessFactor": 0.7 });
        if let Some(png) = png {
            let view = file.view(png.iter().map(|b| [*b]), None);
            document["images"] = json!([{ "bufferView": view, "mimeType": "image/png" }]);
            document["textures"] = json!([{ "source": 0 }]);
            surface["baseColorTexture"] = json!({ "index": 0 });
        }
        let material = |name: &Option<&str>| match name {
            Some(name) => json!({ "name": name, "pbrMetallicRoughness": surface }),
            None => json!({ "pbrMetallicRoughness": surface }),
        };
        document["materials"] = names.iter().map(material).collect();
    }
    document["bufferViews"] = json!(file.views);
    document["buffers"] = json!([{ "byteLength": file.bytes.len() }]);
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let length = 12 + 8 + json.len() + 8 + file.bytes.len();
    let Ok(length) = u32::try_from(length) else {
        return Err(WriteError::data(path, "less than 4 GiB, what a container can have", format!("{length} bytes")));
    };
    write_atomically(path, |w| {
        w.write_all(b"glTF")?;
        w.write_all(&2u32.to_le_bytes())?;
        w.write_all(&length.to_le_bytes())?;
        for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &file.bytes)] {
            w.write_all(&(chunk.len() as u32).to_le_bytes())?; // less than `length`
            w.write_all(kind)?;
            w.write_all(chunk)?;
        }
        Ok(())
    })
}

/// Materials in the order of the polygons, each with the triangles that it has next.
fn material_runs(mesh: &PolygonMesh) -> Vec<(Option<&str>, Range<usize>)> {
    let before = |f: usize| mesh.starts.get(f).map_or(0, |&corner| corner as usize - 2 * f);
    let count = mesh.polygon_count();
    let uses = mesh.metadata.statements.iter().filter_map(|(first, statement)| match statement {
        ObjStatement::Material(name) => Some((Some(name.as_str()), *first as usize)),
        _ => None,
    });
    let uses: Vec<(Option<&str>, usize)> = std::iter::once((None, 0)).chain(uses).collect();
    let ends = uses.iter().skip(1).map(|u| u.1).chain([count]);
    uses.iter()
        .zip(ends)
        .map(|(&(name, first), end)| (name, before(first.min(count))..before(end.min(count))))
        .collect()
}

fn check(path: &Path, mesh: &PolygonMesh, names: &[&str], deltas: &[f32]) -> Result<(), WriteError> {
    let fail = |expected: String, found: String| Err(WriteError::data(path, expected, found));
    let vertices = mesh.positions.len();
    if vertices == 0 {
        return fail("at least one vertex".into(), "none".into());
    }
    let finite = |x: &f64| (*x as f32).is_finite();
    if let Some(v) = mesh.positions.iter().position(|p| !p.iter().all(finite)) {
        return fail("coordinates within 32 bits".into(), format!("{:?} at vertex {v}", mesh.positions[v].as_slice()));
    }
    if let Some(uv) = mesh.metadata.uvs.iter().find(|uv| !uv.iter().all(finite)) {
        return fail("texture coordinates within 32 bits".into(), format!("{uv:?}"));
    }
    if let Some(f) = (0..mesh.polygon_count()).find(|&f| mesh.polygon(f).len() < 3) {
        return fail(format!("at least 3 corners in polygon {f}"), mesh.polygon(f).len().to_string());
    }
    let of_corners = mesh.metadata.corner_uvs.len();
    if of_corners != 0 && of_corners != mesh.corners.len() {
        return fail(format!("a texture index for each of {} corners", mesh.corners.len()), of_corners.to_string());
    }
    if deltas.len() != 3 * vertices * names.len() {
        return fail(
            format!("displacements of {vertices} vertices in {} targets", names.len()),
            deltas.len().to_string(),
        );
    }
    match deltas.iter().position(|d| !d.is_finite()) {
        Some(i) => {
            fail(format!("finite displacements in target {:?}", names[i / (3 * vertices)]), deltas[i].to_string())
        }
        None => Ok(()),
    }
}

/// The binary chunk and what lies where in it.
#[derive(Default)]
struct Contents {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Contents {
    /// A view of its own for some values of at most four bytes; its number.
    fn view<const N: usize>(&mut self, values: impl Iterator<Item = [u8; N]>, target: Option<u32>) -> usize {
        let start = self.bytes.len();
        values.for_each(|b| self.bytes.extend(b));
        let mut view = json!({ "buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(view);
        self.views.len() - 1
    }

    fn accessor(&mut self, accessor: Value) -> usize {
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Values over time, which no vertex has.
    fn track(&mut self, values: &[f32], kind: &str, width: usize) -> usize {
        let view = self.view(values.iter().map(|v| v.to_le_bytes()), None);
        let count = values.len() / width;
        self.accessor(json!({ "bufferView": view, "componentType": FLOAT, "type": kind, "count": count }))
    }

    fn animation(&mut self, motion: &Motion<'_>, has_targets: bool) -> Value {
        let times: Vec<f32> = (0..motion.poses.len()).map(|k| (k as f64 / motion.frames_per_second) as f32).collect();
        let input = self.track(&times, "SCALAR", 1);
        self.accessors[input]["min"] = json!([times.first()]);
        self.accessors[input]["max"] = json!([times.last()]);
        let translations: Vec<f32> = motion
            .poses
            .iter()
            .flat_map(|p| p.translation.iter().map(|x| (x / MILLIMETRES_PER_METRE) as f32).collect::<Vec<_>>())
            .collect();
        let mut last = UnitQuaternion::identity();
        let turn = |pose: &Pose| {
            let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(pose.rotation));
            // the nearer of the two that are the same rotation
            last = if turn.coords.dot(&last.coords) < 0.0 {
                UnitQuaternion::new_unchecked(-turn.into_inner())
            } else {
                turn
            };
            <[f64; 4]>::from(last.coords).map(|x| x as f32)
        };
        let turns: Vec<[f32; 4]> = motion.poses.iter().map(turn).collect();
        let scales: Vec<f32> = motion.poses.iter().flat_map(|p| [p.scale as f32; 3]).collect();
        let mut tracks = vec![
            ("translation", self.track(&translations, "VEC3", 3)),
            ("rotation", self.track(turns.as_flattened(), "VEC4", 4)),
            ("scale", self.track(&scales, "VEC3", 3)),
        ];
        if has_targets {
            let weights: Vec<f32> = motion.weights.iter().flatten().map(|w| *w as f32).collect();
            tracks.push(("weights", self.track(&weights, "SCALAR", 1)));
        }
        let samplers =
            tracks.iter().map(|(_, output)| json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
        let channel =
            |(k, (path, _)): (usize, &(&str, usize))| json!({ "sampler": k, "target": { "node": 0, "path": path } });
        let channels = tracks.iter().enumerate().map(channel);
        let mut animation = json!({ "name": "sequence" });
        animation["samplers"] = samplers.collect();
        animation["channels"] = channels.collect();
        if !motion.lost.is_empty() {
            animation["extras"] = json!({ "lostFrames": motion.lost });
        }
        animation
    }

    fn floats(&mut self, values: &[f32], kind: &str) -> usize {
        let view = self.view(values.iter().map(|v| v.to_le_bytes()), Some(ARRAY_BUFFER));
        let count = values.len() / if kind == "VEC2" { 2 } else { 3 };
        self.accessor(json!({ "bufferView": view, "componentType": FLOAT, "type": kind, "count": count }))
    }

    /// Indices of `vertices` vertices, in 16 bits where that is enough.
    fn indices(&mut self, values: &[u32], vertices: usize) -> usize {
        let (view, kind) = self.index_view(values, vertices, Some(ELEMENT_ARRAY_BUFFER));
        self.accessor(json!({ "bufferView": view, "componentType": kind, "type": "SCALAR", "count": values.len() }))
    }

    fn index_view(&mut self, values: &[u32], vertices: usize, target: Option<u32>) -> (usize, u32) {
        // the largest number of 16 bits is reserved
        if vertices < usize::from(u16::MAX) {
            (self.view(values.iter().map(|&v| (v as u16).to_le_bytes()), target), UNSIGNED_SHORT)
        } else {
            (self.view(values.iter().map(|v| v.to_le_bytes()), target), UNSIGNED_INT)
        }
    }

    fn points(&mut self, points: &[[f32; 3]]) -> usize {
        let index = self.floats(points.as_flattened(), "VEC3");
        self.bound(index, points)
    }

    /// Displacements, sparsely if that is shorter.
    fn displacements(&mut self, deltas: &[[f32; 3]]) -> usize {
        let moved: Vec<u32> = (0..).zip(deltas).filter(|(_, d)| **d != [0.0; 3]).map(|(i, _)| i).collect();
        if 16 * moved.len() >= 12 * deltas.len() {
            return self.points(deltas);
        }
        let mut accessor = json!({ "componentType": FLOAT, "type": "VEC3", "count": deltas.len() });
        if !moved.is_empty() {
            let (indices, kind) = self.index_view(&moved, deltas.len(), None);
            let values = moved.iter().flat_map(|&i| deltas[i as usize]).map(f32::to_le_bytes);
            let values = self.view(values, None);
            accessor["sparse"] = json!({
                "count": moved.len(),
                "indices": { "bufferView": indices, "componentType": kind },
                "values": { "bufferView": values },
            });
        }
        let index = self.accessor(accessor);
        self.bound(index, deltas)
    }

    /// States the smallest and the largest coordinates of an accessor, which the format asks for.
    fn bound(&mut self, accessor: usize, points: &[[f32; 3]]) -> usize {
        let bound = |pick: fn(f32, f32) -> f32| -> [f32; 3] {
            let folded = points.iter().copied().reduce(|a, b| [0, 1, 2].map(|k| pick(a[k], b[k])));
            folded.unwrap_or_default()
        };
        self.accessors[accessor]["min"] = json!(bound(f32::min).map(f64::from));
        self.accessors[accessor]["max"] = json!(bound(f32::max).map(f64::from));
        accessor
    }
}
