//! From polygons with texture coordinates at their corners to triangles with one at each vertex, and back.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hasher};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::mesh::{ObjMetadata, ObjStatement, PolygonMesh, Vec3};

/// `extras.nonrigid` of a mesh: what the triangles do not say of the polygons that they were.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Note {
    /// Vertices of the mesh, the first of the file's.
    pub vertices: usize,
    /// Of which vertex each of the others is a copy.
    pub copies: Vec<u32>,
    /// Texture coordinate of each vertex of the file, -1 for none; empty if the mesh has none at all.
    pub uvs: Vec<i64>,
    /// Runs of polygons with the same number of corners: corners, polygons.
    pub polygons: Vec<(u32, u32)>,
    /// Polygon before which it stands, `o`, `g`, `usemtl` or `s`, and what follows.
    pub statements: Vec<(u32, String, String)>,
    pub material_libraries: Vec<String>,
    /// Which corners of a vertex share a normal, if the mesh says so.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub corner_normals: Vec<u32>,
    /// Of whoever called the writer.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub extras: Map<String, Value>,
}

/// Vertices and triangles as a file has them.
#[derive(Debug, Default)]
pub(super) struct Triangles {
    pub positions: Vec<Vec3>,
    /// One per vertex, v upwards; empty if there are none, NaN where a part has none.
    pub uvs: Vec<[f64; 2]>,
    /// Red, green and blue light of each vertex of a file, where it states any.
    pub light: Vec<Option<Vec3>>,
    pub triangles: Vec<[u32; 3]>,
}

/// Polygons of a file's vertices.
pub(super) struct Restored {
    /// Without positions.
    pub mesh: PolygonMesh,
    /// The file's vertex that each vertex is.
    pub sources: Vec<u32>,
}

/// Cuts a mesh into fans of triangles and its vertices along the texture's seams. Texture coordinates that no corner uses
/// are left out.
pub(super) fn split(mesh: &PolygonMesh) -> (Triangles, Note) {
    const UNSEEN: i64 = -2;
    let metadata = &mesh.metadata;
    let vertices = mesh.positions.len();
    let mut new_index = vec![-1; metadata.uvs.len()];
    metadata.corner_uvs.iter().filter(|&&uv| uv != u32::MAX).for_each(|&uv| new_index[uv as usize] = 0);
    let used = (0..).zip(new_index.iter_mut().filter(|uv| **uv == 0)).map(|(k, uv)| *uv = k).count();
    let textured = used > 0;

    let mut uv_of = vec![UNSEEN; vertices];
    let mut copies: Vec<u32> = Vec::new();
    let mut copy_of: HashMap<(u32, i64), u32> = HashMap::new();
    let mut corners = mesh.corners.clone();
    for (corner, uv) in corners.iter_mut().zip(&metadata.corner_uvs).filter(|_| textured) {
        let uv = if *uv == u32::MAX { -1 } else { new_index[*uv as usize] };
        let v = *corner as usize;
        if uv_of[v] == UNSEEN {
            uv_of[v] = uv;
        } else if uv_of[v] != uv {
            *corner = *copy_of.entry((*corner, uv)).or_insert_with(|| {
                copies.push(v as u32);
                uv_of.push(uv);
                uv_of.len() as u32 - 1
            });
        }
    }
    let uvs: Vec<i64> = uv_of.into_iter().filter(|_| textured).map(|uv| uv.max(-1)).collect();
    let mut values = vec![[0.0; 2]; used];
    new_index.iter().zip(&metadata.uvs).filter(|(k, _)| **k >= 0).for_each(|(k, uv)| values[*k as usize] = *uv);

    let mut polygons: Vec<(u32, u32)> = Vec::new();
    for f in 0..mesh.polygon_count() {
        let size = mesh.starts[f + 1] - mesh.starts[f];
        match polygons.last_mut().filter(|run| run.0 == size) {
            Some(run) => run.1 += 1,
            None => polygons.push((size, 1)),
        }
    }
    let statement = |(before, statement): &(u32, ObjStatement)| {
        let (keyword, rest) = statement.parts();
        (*before, keyword.to_owned(), rest.to_owned())
    };
    let note = Note {
        vertices,
        polygons,
        statements: metadata.statements.iter().map(statement).collect(),
        material_libraries: metadata.material_libraries.clone(),
        corner_normals: metadata.corner_normals.clone(),
        extras: Map::new(),
        copies,
        uvs,
    };
    let positions = mesh.positions.iter().copied();
    let positions = positions.chain(note.copies.iter().map(|&v| mesh.positions[v as usize])).collect();
    let uvs = note.uvs.iter().map(|&k| usize::try_from(k).map_or([0.0; 2], |k| values[k])).collect();
    let fans = PolygonMesh { starts: mesh.starts.clone(), corners, ..PolygonMesh::default() };
    (Triangles { positions, uvs, light: Vec::new(), triangles: fans.triangulate().triangles }, note)
}

/// The polygons that triangles were, as the note says.
///
/// # Errors
/// What does not fit the triangles, for a message.
pub(super) fn restore(file: &Triangles, note: Note) -> Result<Restored, String> {
    let (all, vertices) = (file.positions.len(), note.vertices);
    if vertices.checked_add(note.copies.len()) != Some(all) {
        return Err(format!("{vertices} vertices and {} copies instead of {all} together", note.copies.len()));
    }
    for (i, &v) in note.copies.iter().enumerate() {
        if v as usize >= vertices || file.positions[v as usize] != file.positions[vertices + i] {
            return Err(format!("vertex {} as a copy of {v}, which lies elsewhere", vertices + i));
        }
    }
    let count = |(corners, polygons): &(u32, u32)| u64::from(corners.checked_sub(2)?).checked_mul(u64::from(*polygons));
    let triangles = note.polygons.iter().try_fold(0u64, |sum, run| sum.checked_add(count(run)?));
    if note.polygons.iter().any(|run| run.0 < 3) || triangles != Some(file.triangles.len() as u64) {
        return Err(format!("polygons that are not {} triangles", file.triangles.len()));
    }
    let textured = !note.uvs.is_empty();
    if textured && (note.uvs.len() != all || file.uvs.len() != all) {
        return Err(format!("{} texture indices for {all} vertices", note.uvs.len()));
    }
    if let Some(uv) = note.uvs.iter().find(|&&uv| uv < -1 || uv >= all as i64) {
        return Err(format!("texture index {uv}"));
    }
    let used = note.uvs.iter().max().map_or(0, |&uv| (uv + 1) as usize);
    let mut uvs = vec![[0.0; 2]; used];
    for (&uv, value) in note.uvs.iter().zip(&file.uvs) {
        if let Ok(uv) = usize::try_from(uv) {
            uvs[uv] = *value;
        }
    }
    let mut mesh = PolygonMesh { starts: vec![0], ..PolygonMesh::default() };
    let mut fans = &file.triangles[..];
    let sizes = note.polygons.iter().flat_map(|&(corners, polygons)| (0..polygons).map(move |_| corners as usize));
    let mut corners = Vec::new();
    for size in sizes {
        let (fan, rest) = fans.split_at(size - 2);
        fans = rest;
        if fan.windows(2).any(|pair| pair[0][0] != pair[1][0] || pair[0][2] != pair[1][1]) {
            return Err(format!("polygon {}, whose triangles are no fan", mesh.polygon_count()));
        }
        corners.extend(fan[0]);
        corners.extend(fan[1..].iter().map(|t| t[2]));
        mesh.starts.push(corners.len() as u32);
    }
    let original = |c: &u32| if (*c as usize) < vertices { *c } else { note.copies[*c as usize - vertices] };
    mesh.corners = corners.iter().map(original).collect();
    if !(note.corner_normals.is_empty() || note.corner_normals.len() == mesh.corners.len()) {
        return Err(format!("{} of {} corner normals", note.corner_normals.len(), mesh.corners.len()));
    }
    let statement = |(before, keyword, rest): (u32, String, String)| {
        let statement = ObjStatement::from_parts(&keyword, rest);
        statement.map(|s| (before, s)).ok_or_else(|| format!("statement {keyword:?}"))
    };
    mesh.metadata = ObjMetadata {
        corner_uvs: corners
            .iter()
            .filter(|_| textured)
            .map(|&c| u32::try_from(note.uvs[c as usize]).unwrap_or(u32::MAX))
            .collect(),
        uvs,
        corner_normals: note.corner_normals,
        material_libraries: note.material_libraries,
        statements: note.statements.into_iter().map(statement).collect::<Result<_, _>>()?,
    };
    Ok(Restored { mesh, sources: (0..vertices as u32).collect() })
}

/// Triangles on vertices that are one where position and displacements in all targets are the same, bit for bit. Without
/// triangles, all vertices stay.
pub(super) fn weld(file: &Triangles, targets: &[Vec<f64>]) -> Restored {
    let count = file.positions.len();
    let mut sources: Vec<u32> = Vec::with_capacity(count);
    let mut vertex_of: Vec<u32> = Vec::with_capacity(count);
    // by position and a hash of the displacements: there may be any number at one place
    let mut at: HashMap<([u64; 3], u64), Vec<u32>> = HashMap::new();
    // `+ 0.0`: the two zeros are one place
    let bits = |x: f64| (x + 0.0).to_bits();
    for (i, p) in file.positions.iter().enumerate() {
        let moves = |i: usize| targets.iter().flat_map(move |t| &t[3 * i..3 * i + 3]);
        let mut hasher = DefaultHasher::new();
        moves(i).for_each(|d| hasher.write_u64(bits(*d)));
        let here = at.entry(([p.x, p.y, p.z].map(bits), hasher.finish())).or_default();
        let same = here.iter().find(|&&v| moves(sources[v as usize] as usize).eq(moves(i)));
        let vertex = match same.filter(|_| !file.triangles.is_empty()) {
            Some(&vertex) => vertex,
            None => {
                let new = sources.len() as u32;
                here.push(new);
                sources.push(i as u32);
                new
            }
        };
        vertex_of.push(vertex);
    }
    let mut metadata = ObjMetadata::default();
    if file.uvs.iter().any(|uv| !uv[0].is_nan()) && !file.triangles.is_empty() {
        let mut index = vec![u32::MAX; count];
        let mut known: HashMap<[u64; 2], u32> = HashMap::new();
        for (uv, index) in file.uvs.iter().zip(&mut index).filter(|(uv, _)| !uv[0].is_nan()) {
            *index = *known.entry(uv.map(f64::to_bits)).or_insert_with(|| {
                metadata.uvs.push(*uv);
                metadata.uvs.len() as u32 - 1
            });
        }
        metadata.corner_uvs = file.triangles.iter().flatten().map(|&c| index[c as usize]).collect();
    }
    let mesh = PolygonMesh {
        positions: Vec::new(),
        starts: (0..=file.triangles.len() as u32).map(|f| 3 * f).collect(),
        corners: file.triangles.iter().flatten().map(|&c| vertex_of[c as usize]).collect(),
        metadata,
    };
    Restored { mesh, sources }
}
