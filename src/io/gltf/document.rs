//! The part of a glTF file's JSON that meshes need, and the binary container round it.

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::Read;
use std::path::{Component, Path, PathBuf};
use std::rc::Rc;

use base64::Engine as _;
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::io::error::{excerpt, without_mark};
use crate::io::{Place, ReadError, inputs};

/// Extensions that do not change what a mesh is, or that only allow further types of numbers.
const EXTENSIONS: [&str; 4] =
    ["KHR_mesh_quantization", "KHR_materials_unlit", "KHR_texture_transform", "KHR_materials_pbrSpecularGlossiness"];

macro_rules! objects {
    ($($(#[$attribute:meta])* $name:ident { $($(#[$of_field:meta])* $field:ident: $kind:ty,)* })*) => {$(
        $(#[$attribute])*
        #[derive(Debug, Clone, Default, Deserialize)]
        #[serde(default, rename_all = "camelCase")]
        pub(super) struct $name { $($(#[$of_field])* pub $field: $kind,)* }
    )*};
}

objects! {
    Document {
        asset: Asset,
        extensions_required: Vec<String>,
        scene: Option<usize>,
        scenes: Vec<Scene>,
        nodes: Vec<Node>,
        meshes: Vec<Mesh>,
        materials: Vec<Material>,
        textures: Vec<Texture>,
        images: Vec<Image>,
        samplers: Vec<Sampler>,
        accessors: Vec<Accessor>,
        buffer_views: Vec<BufferView>,
        buffers: Vec<Buffer>,
    }
    Asset { version: String, }
    Scene { nodes: Vec<usize>, }
    Node {
        name: String,
        children: Vec<usize>,
        mesh: Option<usize>,
        skin: Option<usize>,
        matrix: Option<[f64; 16]>,
        translation: Option<[f64; 3]>,
        rotation: Option<[f64; 4]>,
        scale: Option<[f64; 3]>,
    }
    Mesh { name: String, primitives: Vec<Primitive>, extras: Value, }
    Material { name: String, pbr_metallic_roughness: Value, extensions: Value, }
    Texture { source: Option<usize>, sampler: Option<usize>, }
    Image { uri: Option<String>, buffer_view: Option<usize>, }
    Sampler { wrap_s: Option<u32>, wrap_t: Option<u32>, }
    Primitive {
        attributes: Map<String, Value>,
        indices: Option<usize>,
        material: Option<usize>,
        mode: Option<u32>,
        targets: Vec<Map<String, Value>>,
    }
    Accessor {
        buffer_view: Option<usize>,
        byte_offset: usize,
        component_type: u32,
        normalized: bool,
        count: usize,
        #[serde(rename = "type")]
        kind: String,
        sparse: Option<Sparse>,
    }
    Sparse { count: usize, indices: SparsePart, values: SparsePart, }
    SparsePart { buffer_view: usize, byte_offset: usize, component_type: u32, }
    BufferView { buffer: usize, byte_offset: usize, byte_length: usize, byte_stride: Option<usize>, }
    Buffer { uri: Option<String>, byte_length: usize, }
}

/// Polygon from which on a material, by its number, counts, or none does.
pub(super) type MaterialRuns = Vec<(u32, Option<usize>)>;

/// A document with the bytes of its buffers.
pub(super) struct Loaded<'a> {
    pub path: &'a Path,
    pub document: Document,
    /// Buffers in one file are loaded once.
    pub buffers: Vec<Rc<Cow<'a, [u8]>>>,
    json_length: usize,
}

impl<'a> Loaded<'a> {
    /// Opens a container or bare JSON and loads the buffers.
    pub fn new(bytes: &'a [u8], path: &'a Path) -> Result<Self, ReadError> {
        let (json, binary) = if bytes.starts_with(b"glTF") { chunks(bytes, path)? } else { (bytes, None) };
        let expected = "a glTF 2.0 file: glTF and version 2, or JSON";
        let document: Document = serde_json::from_slice(without_mark(json)).map_err(|e| {
            let place = if binary.is_some() { Place::File } else { Place::Line(e.line().max(1)) };
            ReadError::json(path, place, expected, &e)
        })?;
        let malformed = |expected: &str, found: String| Err(ReadError::malformed(path, Place::File, expected, found));
        if !document.asset.version.starts_with("2.") {
            return malformed("asset.version 2", format!("{:?}", document.asset.version));
        }
        if let Some(needed) = document.extensions_required.iter().find(|e| !EXTENSIONS.contains(&e.as_str())) {
            return malformed(
                "no extension that changes what meshes are: export again without it and without compression",
                format!("extensionsRequired {needed:?}"),
            );
        }
        let mut buffers = Vec::with_capacity(document.buffers.len());
        let mut beside = Buffers::new();
        for (i, buffer) in document.buffers.iter().enumerate() {
            let data = match &buffer.uri {
                None => match binary.filter(|_| i == 0) {
                    Some(binary) => Rc::new(Cow::Borrowed(binary)),
                    None => return malformed("a uri or the container's binary chunk", format!("none in buffer {i}")),
                },
                Some(uri) => load(path, i, uri, buffer.byte_length, &mut beside)?,
            };
            if data.len() < buffer.byte_length {
                let expected = format!("{} bytes in buffer {i}", buffer.byte_length);
                return malformed(&expected, data.len().to_string());
            }
            buffers.push(data);
        }
        Ok(Self { path, document, buffers, json_length: json.len() })
    }

    /// Bytes of the document and its buffers.
    pub fn length(&self) -> usize {
        self.json_length + self.buffers.iter().map(|b| b.len()).sum::<usize>()
    }

    pub fn malformed<T>(&self, expected: impl Into<String>, found: impl Into<String>) -> Result<T, ReadError> {
        Err(ReadError::malformed(self.path, Place::File, expected, found))
    }

    /// Entry `index` of a list of the document.
    pub fn entry<'l, T>(&self, list: &'l [T], index: usize, what: &str) -> Result<&'l T, ReadError> {
        match list.get(index) {
            Some(entry) => Ok(entry),
            None => self.malformed(format!("one of {} {what}", list.len()), format!("number {index}")),
        }
    }
}

/// The JSON and the binary chunk of a container.
fn chunks<'a>(bytes: &'a [u8], path: &Path) -> Result<(&'a [u8], Option<&'a [u8]>), ReadError> {
    let fail = |at, expected: &str, found: String| Err(ReadError::malformed(path, Place::Byte(at), expected, found));
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    match word(4) {
        Some(2) => {}
        found => {
            return fail(
                4,
                "version 2 of the container",
                found.map_or("the end of the file".into(), |v| v.to_string()),
            );
        }
    }
    let length = word(8).unwrap_or(0) as usize;
    if length < 12 || length > bytes.len() {
        return fail(8, &format!("a length of at most {} bytes, the file's", bytes.len()), length.to_string());
    }
    let (mut json, mut binary, mut at) = (None, None, 12);
    while at + 8 <= length {
        let size = word(at).unwrap_or(0) as usize;
        let Some(chunk) = bytes[..length].get(at + 8..).and_then(|rest| rest.get(..size)) else {
            return fail(at, &format!("a chunk of at most {} bytes", length - at - 8), size.to_string());
        };
        match &bytes[at + 4..at + 8] {
            b"JSON" if json.is_none() => json = Some(chunk),
            b"BIN\0" if binary.is_none() => binary = Some(chunk),
            _ => {}
        }
        at += 8 + size.next_multiple_of(4);
    }
    match json {
        Some(json) => Ok((json, binary)),
        None => fail(12, "a JSON chunk", "none".into()),
    }
}

type Buffers = HashMap<PathBuf, Rc<Cow<'static, [u8]>>>;

/// A buffer from a data URI or a file beside the document, where `beside` are those which are known.
fn load(
    path: &Path,
    index: usize,
    uri: &str,
    length: usize,
    beside: &mut Buffers,
) -> Result<Rc<Cow<'static, [u8]>>, ReadError> {
    let malformed = |expected: &str| {
        let found = format!("buffer {index} with uri {}", excerpt(uri.as_bytes()));
        ReadError::malformed(path, Place::File, expected, found)
    };
    if let Some(data) = uri.strip_prefix("data:") {
        return Ok(Rc::new(Cow::Owned(from_base64(data).map_err(|expected| malformed(&expected))?)));
    }
    let file_path = beside_file(path, uri).ok_or_else(|| malformed("a data uri or the relative path of a file"))?;
    let fail = |source| ReadError::io(&file_path, source);
    let one_file = file_path.canonicalize().map_err(fail)?;
    if let Some(known) = beside.get(&one_file) {
        return match known.len() == length {
            true => Ok(known.clone()),
            false => Err(malformed(&format!("{} bytes in every buffer of one file", known.len()))),
        };
    }
    // before it is opened: that of a pipe waits for a writer
    let metadata = std::fs::metadata(&file_path).map_err(fail)?;
    if !metadata.is_file() || metadata.len() < length as u64 {
        let expected = format!("{length} bytes, buffer {index} of {}", path.display());
        return Err(ReadError::malformed(&file_path, Place::File, expected, metadata.len().to_string()));
    }
    let file = inputs::open(&file_path).map_err(fail)?;
    let mut bytes = Vec::with_capacity(length);
    file.take(length as u64).read_to_end(&mut bytes).map_err(fail)?;
    let buffer: Rc<Cow<[u8]>> = Rc::new(Cow::Owned(bytes));
    beside.insert(one_file, buffer.clone());
    Ok(buffer)
}

/// What a data URI holds, or what was expected of it.
pub(super) fn from_base64(data: &str) -> Result<Vec<u8>, String> {
    let text = data.split_once(";base64,").ok_or("a data uri in base64")?.1;
    let engine = base64::engine::general_purpose::STANDARD;
    engine.decode(text).map_err(|e| format!("a data uri in base64 ({e})"))
}

/// The file beside `path` that a relative path names.
pub(super) fn beside_file(path: &Path, uri: &str) -> Option<PathBuf> {
    let name = PathBuf::from(percent_decoded(uri)?);
    let relative =
        name.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir | Component::ParentDir));
    let is_file = relative && !uri.contains("://") && !name.as_os_str().is_empty();
    is_file.then(|| path.parent().unwrap_or(Path::new("")).join(name))
}

/// Files beside `path` that hold buffers, and images if asked for, each once; none of a document that cannot be read.
pub(in crate::io) fn files_beside(bytes: &[u8], path: &Path, images: bool) -> Vec<PathBuf> {
    let json = if bytes.starts_with(b"glTF") { chunks(bytes, path).map(|c| c.0) } else { Ok(bytes) };
    let document: Document = json.ok().and_then(|json| serde_json::from_slice(json).ok()).unwrap_or_default();
    let images = document.images.into_iter().filter(|_| images).filter_map(|image| image.uri);
    let uris = document.buffers.into_iter().filter_map(|buffer| buffer.uri).chain(images);
    let mut files: Vec<PathBuf> =
        uris.filter(|uri| !uri.starts_with("data:")).filter_map(|uri| beside_file(path, &uri)).collect();
    files.sort();
    files.dedup();
    files
}

/// `%20` and the like as the bytes they stand for.
fn percent_decoded(uri: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let [first, others @ ..] = rest {
        rest = others;
        if *first == b'%' {
            let digits = rest.get(..2).filter(|d| d.iter().all(u8::is_ascii_hexdigit))?;
            bytes.push(u8::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok()?);
            rest = &rest[2..];
        } else {
            bytes.push(*first);
        }
    }
    String::from_utf8(bytes).ok()
}
