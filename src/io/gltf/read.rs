//! Reading: the scene's nodes, their meshes, and all of them as one.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use nalgebra::{Matrix4, Quaternion, UnitQuaternion};
use serde_json::{Map, Value};

use super::accessor::Accessors;
use super::budget::weight;
use super::document::{Document, Loaded, MaterialRuns, Mesh, Node, Primitive};
use super::paint::paint_of;
use super::topology::{Note, Restored, Triangles, restore, weld};
use super::{GltfMesh, MILLIMETRES_PER_METRE};
use crate::io::error::read_file;
use crate::io::{Paint, Place, ReadError};
use crate::mesh::srgb::from_light;
use crate::mesh::{ObjStatement, PolygonMesh, Vec3};

/// Reads a `.glb` or `.gltf` file, with its buffers inside or beside it. There is at least one vertex, numbers are finite,
/// and faces index vertices.
///
/// # Errors
/// When a file cannot be read, is no glTF 2.0 or needs an extension that changes what meshes are (compression, above all);
/// when an index, an accessor or a buffer view points outside of what it is of; or when there is no mesh. The message says
/// which.
pub fn read_gltf(path: &Path) -> Result<GltfMesh, ReadError> {
    parse_gltf(&read_file(path)?, path)
}

/// Parses the bytes of a `.glb` or `.gltf` file; `path` is named in errors, and buffers in files of their own are beside it.
///
/// # Errors
/// As [`read_gltf`].
pub fn parse_gltf(bytes: &[u8], path: &Path) -> Result<GltfMesh, ReadError> {
    Ok(parse_scene(&Loaded::new(bytes, path)?)?.0)
}

/// [`parse_gltf`] with the paint of its triangles.
///
/// # Errors
/// As there, and when an image cannot be read.
pub(in crate::io) fn parse_painted_gltf(bytes: &[u8], path: &Path) -> Result<(GltfMesh, Paint), ReadError> {
    let file = Loaded::new(bytes, path)?;
    let (all, materials) = parse_scene(&file)?;
    let paint = paint_of(&file, &all.mesh, &materials)?;
    Ok((all, paint))
}

fn parse_scene(file: &Loaded<'_>) -> Result<(GltfMesh, MaterialRuns), ReadError> {
    let accessors = Accessors::new(file);
    let mut parts = Vec::new();
    for (node, to_scene) in nodes_of_scene(file)? {
        if let Some(mesh) = node.mesh {
            let mesh = file.entry(&file.document.meshes, mesh, "meshes")?;
            // the joints of a skin have the last word about its mesh, whatever its node says
            let to_scene = if node.skin.is_some() { Matrix4::identity() } else { to_scene };
            let name = if node.name.is_empty() { &mesh.name } else { &node.name };
            parts.push(read_part(&accessors, file, mesh, name, &(to_scene * MILLIMETRES_PER_METRE))?);
        }
    }
    let count: usize = parts.iter().map(|p| p.mesh.positions.len()).sum();
    let corners: usize = parts.iter().map(|p| p.mesh.corners.len()).sum();
    if parts.len() > 1 {
        let names: HashSet<&String> = parts.iter().flat_map(|p| &p.targets).map(|(name, _)| name).collect();
        accessors.budget.spend(3 * count * names.len(), "the morph targets of all meshes")?;
    }
    if count == 0 {
        return file.malformed("a scene with a mesh that has vertices", "none");
    }
    if count.max(corners) >= u32::MAX as usize {
        return file.malformed("fewer than 2^32 vertices and corners", format!("{count} and {corners}"));
    }
    let mut first = 0;
    let mut runs = MaterialRuns::new();
    for part in &parts {
        runs.extend(part.materials.iter().map(|(polygon, material)| (first + polygon, *material)));
        first += part.mesh.polygon_count() as u32;
    }
    Ok((joined(parts), runs))
}

/// The colour of vertices without one, for it would multiply the material's.
const WHITE: [u8; 3] = [255; 3];

/// One mesh of the scene.
struct Part {
    name: String,
    mesh: PolygonMesh,
    /// One per vertex, or none.
    colors: Vec<[u8; 3]>,
    /// Name and displacements, vertex by vertex, x y z.
    targets: Vec<(String, Vec<f32>)>,
    extras: Map<String, Value>,
    materials: MaterialRuns,
}

/// The nodes of the scene, parents first, each with the matrix from its coordinates to the scene's.
fn nodes_of_scene<'l>(file: &'l Loaded<'_>) -> Result<Vec<(&'l Node, Matrix4<f64>)>, ReadError> {
    let Document { scene, scenes, nodes, .. } = &file.document;
    let roots: Vec<usize> = match (scene, scenes.is_empty()) {
        (None, true) => {
            let mut root = vec![true; nodes.len()];
            nodes.iter().flat_map(|n| &n.children).filter(|&&c| c < nodes.len()).for_each(|&c| root[c] = false);
            (0..nodes.len()).filter(|&i| root[i]).collect()
        }
        _ => file.entry(scenes, scene.unwrap_or(0), "scenes")?.nodes.clone(),
    };
    let mut seen = vec![false; nodes.len()];
    let mut waiting: Vec<(usize, Matrix4<f64>)> = roots.into_iter().rev().map(|i| (i, Matrix4::identity())).collect();
    let mut found = Vec::new();
    while let Some((i, to_scene)) = waiting.pop() {
        let node = file.entry(nodes, i, "nodes")?;
        if std::mem::replace(&mut seen[i], true) {
            return file.malformed("every node below one parent", format!("node {i} twice"));
        }
        let to_scene = to_scene * matrix_of(node);
        found.push((node, to_scene));
        waiting.extend(node.children.iter().rev().map(|&child| (child, to_scene)));
    }
    Ok(found)
}

fn matrix_of(node: &Node) -> Matrix4<f64> {
    if let Some(matrix) = &node.matrix {
        return Matrix4::from_column_slice(matrix);
    }
    let translation = Matrix4::new_translation(&Vec3::from(node.translation.unwrap_or_default()));
    let scale = Matrix4::new_nonuniform_scaling(&Vec3::from(node.scale.unwrap_or([1.0; 3])));
    match node.rotation {
        Some([x, y, z, w]) => {
            let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            translation * rotation.to_homogeneous() * scale
        }
        None => translation * scale,
    }
}

fn read_part(
    accessors: &Accessors<'_>,
    file: &Loaded<'_>,
    mesh: &Mesh,
    name: &str,
    to_millimetres: &Matrix4<f64>,
) -> Result<Part, ReadError> {
    accessors.budget.spend(weight(&mesh.extras) + name.len(), "names and notes of a mesh")?;
    let target_count = mesh.primitives.first().map_or(0, |p| p.targets.len());
    let names = target_names(file, mesh, target_count)?;
    let mut all = Triangles::default();
    let mut targets: Vec<Vec<f64>> = vec![Vec::new(); target_count];
    let mut materials: Vec<(u32, ObjStatement)> = Vec::new();
    let mut runs = MaterialRuns::new();
    for primitive in &mesh.primitives {
        if matches!(primitive.mode, Some(1..=3)) {
            continue;
        }
        if primitive.targets.len() != target_count {
            let expected = format!("{target_count} morph targets in every primitive of mesh {:?}", mesh.name);
            return file.malformed(expected, primitive.targets.len().to_string());
        }
        runs.push((all.triangles.len() as u32, primitive.material));
        if let Some(material) = primitive.material {
            let name = &file.entry(&file.document.materials, material, "materials")?.name;
            if !name.is_empty() {
                accessors.budget.spend(name.len(), "names of materials")?;
                materials.push((all.triangles.len() as u32, ObjStatement::Material(name.clone())));
            }
        }
        // what this project writes: other polygons of the same vertices
        let same =
            |first: &&Primitive| (&first.attributes, &first.targets) == (&primitive.attributes, &primitive.targets);
        let first =
            mesh.primitives.first().filter(|_| !all.positions.is_empty() && mesh.extras.get("nonrigid").is_some());
        match first.filter(same) {
            Some(_) => read_triangles(accessors, file, primitive, [0, all.positions.len()], &mut all)?,
            None => read_primitive(accessors, file, primitive, &mut all, &mut targets)?,
        }
    }
    let textured = all.uvs.iter().any(|uv| !uv[0].is_nan());
    if !textured {
        all.uvs.clear();
    }
    let note = mesh.extras.get("nonrigid");
    let (restored, extras) = match note {
        None => {
            let mut restored = weld(&all, &targets);
            restored.mesh.metadata.statements = materials;
            (restored, Map::new())
        }
        Some(note) => {
            let foreign = |found: String| {
                let expected = "extras.nonrigid of this mesh (without it, the file is read as it stands)";
                ReadError::malformed(file.path, Place::File, expected, found)
            };
            let mut note: Note =
                serde::Deserialize::deserialize(note).map_err(|e: serde_json::Error| foreign(e.to_string()))?;
            let extras = std::mem::take(&mut note.extras);
            let restored = restore(&all, note).map_err(foreign)?;
            // from triangles to the polygons that they are of
            let starts = &restored.mesh.starts;
            let firsts: Vec<u32> = (0..starts.len()).map(|f| starts[f] - 2 * f as u32).collect();
            runs.iter_mut().for_each(|run| run.0 = firsts.partition_point(|&first| first < run.0) as u32);
            (restored, extras)
        }
    };
    let Restored { mut mesh, sources } = restored;
    let linear = to_millimetres.fixed_view::<3, 3>(0, 0).into_owned();
    let origin: Vec3 = to_millimetres.fixed_view::<3, 1>(0, 3).into_owned();
    mesh.positions = sources.iter().map(|&i| linear * all.positions[i as usize] + origin).collect();
    if linear.determinant() < 0.0 {
        turn_over(&mut mesh);
    }
    let colored = all.light.iter().any(Option::is_some);
    let color = |i: &u32| all.light[*i as usize].map_or(WHITE, from_light);
    let colors = if colored { sources.iter().map(color).collect() } else { Vec::new() };
    let moved = |deltas: &Vec<f64>| -> Vec<f32> {
        let delta = |&i: &u32| linear * Vec3::from_column_slice(&deltas[3 * i as usize..3 * i as usize + 3]);
        sources.iter().map(delta).flat_map(|d| [d.x as f32, d.y as f32, d.z as f32]).collect()
    };
    let targets: Vec<(String, Vec<f32>)> = names.into_iter().zip(targets.iter().map(moved)).collect();
    let finite = mesh.positions.iter().flatten().all(|x| x.is_finite());
    if !finite || !targets.iter().flat_map(|t| &t.1).all(|x| x.is_finite()) {
        return file.malformed("finite positions in the scene", format!("others, of mesh {name:?}"));
    }
    Ok(Part { name: name.to_owned(), mesh, colors, targets, extras, materials: runs })
}

fn target_names(file: &Loaded<'_>, mesh: &Mesh, count: usize) -> Result<Vec<String>, ReadError> {
    let names = match mesh.extras.get("targetNames") {
        None => (0..count).map(|k| format!("target{k:03}")).collect(),
        Some(stated) => {
            let names: Option<Vec<String>> =
                stated.as_array().and_then(|a| a.iter().map(|n| n.as_str().map(str::to_owned)).collect());
            match names.filter(|names| names.len() == count) {
                Some(names) => names,
                None => {
                    let expected = format!("extras.targetNames with the names of {count} morph targets");
                    let found =
                        stated.as_array().map_or("something else".to_owned(), |a| format!("{} entries", a.len()));
                    return file.malformed(expected, found);
                }
            }
        }
    };
    let mut sorted: Vec<&String> = names.iter().collect();
    sorted.sort_unstable();
    match sorted.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => file.malformed("every morph target's name once", format!("{:?} twice", pair[0])),
        None => Ok(names),
    }
}

/// Appends a primitive's vertices and triangles.
fn read_primitive(
    accessors: &Accessors<'_>,
    file: &Loaded<'_>,
    primitive: &Primitive,
    all: &mut Triangles,
    targets: &mut [Vec<f64>],
) -> Result<(), ReadError> {
    let attribute = |of: &Map<String, Value>, name: &str| -> Result<Option<usize>, ReadError> {
        let Some(value) = of.get(name) else { return Ok(None) };
        match value.as_u64() {
            Some(index) => Ok(Some(index as usize)),
            None => file.malformed(format!("the number of an accessor for {name}"), value.to_string()),
        }
    };
    let Some(position) = attribute(&primitive.attributes, "POSITION")? else { return Ok(()) };
    let positions = accessors.read(position, "VEC3", 3, "POSITION")?;
    let (first, count) = (all.positions.len() as u32, positions.len() / 3);
    let check = |found: usize, what: &str| match found == count {
        true => Ok(()),
        false => file.malformed(format!("{what} for each of {count} vertices"), found.to_string()),
    };
    all.positions.extend(positions.chunks_exact(3).map(Vec3::from_column_slice));
    match attribute(&primitive.attributes, "TEXCOORD_0")? {
        None => all.uvs.extend(std::iter::repeat_n([f64::NAN; 2], count)),
        Some(index) => {
            let uvs = accessors.read(index, "VEC2", 2, "TEXCOORD_0")?;
            check(uvs.len() / 2, "texture coordinates")?;
            all.uvs.extend(uvs.chunks_exact(2).map(|uv| [uv[0], 1.0 - uv[1]]));
        }
    }
    match attribute(&primitive.attributes, "COLOR_0")? {
        None => all.light.extend(std::iter::repeat_n(None, count)),
        Some(index) => {
            let kind = &file.entry(&file.document.accessors, index, "accessors")?.kind;
            let (kind, width) = if kind == "VEC3" { ("VEC3", 3) } else { ("VEC4", 4) };
            let light = accessors.read(index, kind, width, "COLOR_0")?;
            check(light.len() / width, "colours")?;
            all.light.extend(light.chunks_exact(width).map(|c| Some(Vec3::new(c[0], c[1], c[2]))));
        }
    }
    for (target, deltas) in primitive.targets.iter().zip(targets) {
        match attribute(target, "POSITION")? {
            None => {
                accessors.budget.spend(3 * count, "a morph target without positions")?;
                deltas.extend(std::iter::repeat_n(0.0, 3 * count));
            }
            Some(index) => {
                let new = accessors.read(index, "VEC3", 3, "POSITION of a morph target")?;
                check(new.len() / 3, "displacements")?;
                deltas.extend(new);
            }
        }
    }
    read_triangles(accessors, file, primitive, [first as usize, count], all)
}

/// Appends a primitive's triangles, of `count` vertices from the `first`.
fn read_triangles(
    accessors: &Accessors<'_>,
    file: &Loaded<'_>,
    primitive: &Primitive,
    [first, count]: [usize; 2],
    all: &mut Triangles,
) -> Result<(), ReadError> {
    let mode = primitive.mode.unwrap_or(4);
    if mode == 0 {
        return Ok(());
    }
    let corners = match primitive.indices {
        Some(index) => accessors.read_indices(index, count)?,
        None => (0..count as u32).collect(),
    };
    let n = corners.len();
    let triangles: Vec<[u32; 3]> = match mode {
        4 if n.is_multiple_of(3) => corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
        4 => return file.malformed("triangles, three indices each", format!("{n} indices")),
        5 => (2..n).map(|i| [corners[i - 2], corners[i - 1 + i % 2], corners[i - i % 2]]).collect(),
        6 => (2..n).map(|i| [corners[i - 1], corners[i], corners[0]]).collect(),
        _ => return file.malformed("a primitive of mode 0 to 6", mode.to_string()),
    };
    all.triangles.extend(triangles.into_iter().map(|t| t.map(|c| first as u32 + c)));
    Ok(())
}

/// Reverses every polygon, for a mesh in a mirror.
fn turn_over(mesh: &mut PolygonMesh) {
    for f in 0..mesh.polygon_count() {
        let corners = mesh.starts[f] as usize..mesh.starts[f + 1] as usize;
        mesh.corners[corners.clone()].reverse();
        for of_corners in [&mut mesh.metadata.corner_uvs, &mut mesh.metadata.corner_normals] {
            if let Some(of_polygon) = of_corners.get_mut(corners.clone()) {
                of_polygon.reverse();
            }
        }
    }
}

/// All parts as one mesh, each an object of its own if there are several; targets of one name become one.
fn joined(mut parts: Vec<Part>) -> GltfMesh {
    if parts.len() == 1 {
        let Part { mesh, colors, targets, extras, .. } = parts.remove(0);
        let colors = (!colors.is_empty()).then_some(colors);
        let (target_names, deltas): (Vec<String>, Vec<Vec<f32>>) = targets.into_iter().unzip();
        return GltfMesh { mesh, colors, target_names, target_deltas: deltas.concat(), extras };
    }
    let count: usize = parts.iter().map(|p| p.mesh.positions.len()).sum();
    let textured = parts.iter().any(|p| !p.mesh.metadata.corner_uvs.is_empty());
    let mut all = GltfMesh { mesh: PolygonMesh { starts: vec![0], ..PolygonMesh::default() }, ..GltfMesh::default() };
    if parts.iter().any(|p| !p.colors.is_empty()) {
        let of = |p: &Part| if p.colors.is_empty() { vec![WHITE; p.mesh.positions.len()] } else { p.colors.clone() };
        all.colors = Some(parts.iter().flat_map(of).collect());
    }
    let mut index: HashMap<String, usize> = HashMap::new();
    for (name, _) in parts.iter().flat_map(|p| &p.targets) {
        if !index.contains_key(name) {
            index.insert(name.clone(), index.len());
            all.target_names.push(name.clone());
        }
    }
    all.target_deltas = vec![0.0; 3 * count * all.target_names.len()];
    for Part { name, mesh, targets, .. } in parts {
        let GltfMesh { mesh: whole, target_deltas, .. } = &mut all;
        let (vertices, corners) = (whole.positions.len() as u32, whole.corners.len() as u32);
        let (polygons, uvs) = (whole.polygon_count() as u32, whole.metadata.uvs.len() as u32);
        for (name, deltas) in targets {
            let start = 3 * (index[&name] * count + vertices as usize);
            target_deltas[start..start + deltas.len()].copy_from_slice(&deltas);
        }
        whole.positions.extend(&mesh.positions);
        whole.starts.extend(mesh.starts.iter().skip(1).map(|s| s + corners));
        whole.corners.extend(mesh.corners.iter().map(|c| c + vertices));
        let metadata = &mut whole.metadata;
        if textured {
            let shifted = mesh.metadata.corner_uvs.iter().map(|uv| if *uv == u32::MAX { *uv } else { uv + uvs });
            metadata.corner_uvs.extend(shifted);
            metadata.corner_uvs.resize(whole.corners.len(), u32::MAX);
        }
        if !mesh.metadata.corner_normals.is_empty() {
            metadata.corner_normals.resize(whole.corners.len() - mesh.corners.len(), u32::MAX);
            metadata.corner_normals.extend(mesh.metadata.corner_normals);
        }
        metadata.uvs.extend(mesh.metadata.uvs);
        metadata.material_libraries.extend(mesh.metadata.material_libraries);
        metadata.statements.push((polygons, ObjStatement::Object(name)));
        metadata.statements.extend(mesh.metadata.statements.into_iter().map(|(f, s)| (f + polygons, s)));
    }
    if !all.mesh.metadata.corner_normals.is_empty() {
        all.mesh.metadata.corner_normals.resize(all.mesh.corners.len(), u32::MAX);
    }
    all
}
