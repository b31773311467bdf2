//! Material libraries and images of a template on their way to another folder, beside what the template was made into.
//!
//! All libraries that the mesh names become one, `NAME.mtl` of `NAME.obj`, and their images `NAME_image.png`. Of a file's name what is
//! neither letter, digit, dot, dash nor underline becomes an underline; two that would be one get numbers. The images of the tiles of a
//! name with `<UDIM>` go along. Whatever else the libraries say stays.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

use super::error::{check_side_file, read_side_file};
use super::material::{libraries, named_beside, parse_map};
use super::{WriteError, gzip, is_made, read_file, write_atomically};
use crate::mesh::PolygonMesh;

/// What statements of a library name an image: these, and all that begin with `map_`.
const MAPS: [&str; 6] = ["bump", "disp", "decal", "refl", "norm", "displacement"];
/// A library's images and nothing else are copied.
const IMAGES: [&str; 14] =
    ["png", "jpg", "jpeg", "tif", "tiff", "exr", "hdr", "tga", "bmp", "webp", "gif", "psd", "ktx", "dds"];
const UDIM: &str = "<UDIM>";

/// The libraries that a mesh names, and their images.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MaterialFiles {
    /// Lines of the libraries, each with the map that it names.
    lines: Vec<(String, Option<Named>)>,
    /// Libraries that are there.
    libraries: Vec<PathBuf>,
    /// Names of those that are not.
    gone: Vec<String>,
    /// Images, and what they are to be called behind the name of the mesh.
    images: BTreeMap<PathBuf, String>,
    /// What is missing, as it is named (`<UDIM>` stands for tiles), and that in words.
    pub missing: Vec<(PathBuf, String)>,
}

/// A file as it was: path, time of its last change, length.
type AsItWas = (PathBuf, Option<SystemTime>, u64);

/// An image that a line ends with.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Named {
    /// As the library says.
    name: String,
    /// As the copy is called, behind the name of the mesh.
    copy: String,
}

impl MaterialFiles {
    /// What a mesh that was read from `path` names. What is not there, is no regular file, or has no name of an image, is
    /// [missing](Self::missing).
    #[must_use]
    pub fn of(path: &Path, mesh: &PolygonMesh) -> Self {
        Self::of_statements(path, &mesh.metadata.material_libraries)
    }

    fn of_statements(path: &Path, statements: &[String]) -> Self {
        let mut found = Self::default();
        let mut taken = BTreeSet::new();
        for library in libraries(path, statements) {
            match read_side_file(&library) {
                Ok(bytes) => found.add(&library, &String::from_utf8_lossy(&bytes), &mut taken),
                Err(error) => {
                    found.gone.push(file_name(&library));
                    found.missing.push((library, format!("{error} (mtllib of {})", path.display())));
                }
            }
        }
        found
    }

    /// [`of`](Self::of) the mesh in an OBJ file, of which only what it names is read; nothing of files of other formats.
    #[must_use]
    pub fn named_in(path: &Path) -> Self {
        let is_obj = path.is_file() && gzip::inner_extension(path) == "obj";
        if is_obj { Self::of_statements(path, &super::libraries_named_in(path)) } else { Self::default() }
    }

    /// [`named_in`](Self::named_in), kept for the last file while it stays as it is: a batch asks for every scan.
    #[must_use]
    pub fn kept_of(path: &Path) -> Self {
        static LAST: Mutex<Option<(AsItWas, MaterialFiles)>> = Mutex::new(None);
        let Ok(metadata) = std::fs::metadata(path) else { return Self::default() };
        let now = (path.to_owned(), metadata.modified().ok(), metadata.len());
        let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, files)) = last.as_ref().filter(|(known, _)| *known == now) {
            return files.clone();
        }
        let files = Self::named_in(path);
        *last = Some((now, files.clone()));
        files
    }

    fn add(&mut self, library: &Path, text: &str, taken: &mut BTreeSet<String>) {
        for (number, line) in (1..).zip(text.lines()) {
            let (keyword, rest) = line.trim().split_once([' ', '\t']).unwrap_or_default();
            let is_map = keyword.to_ascii_lowercase().starts_with("map_") || MAPS.contains(&keyword);
            let name = if is_map { parse_map(rest.trim(), number).map(|map| map.name) } else { None };
            let Some(name) = name.filter(|name| line.trim_end().trim_end_matches('"').ends_with(name.as_str())) else {
                self.lines.push((line.to_owned(), None));
                continue;
            };
            let copy = self.image(library, &name, taken);
            if copy.is_none() {
                let told = format!("{name}: no image that can be copied (line {number} of {})", library.display());
                self.missing.push((named_beside(library, &name), told));
            }
            self.lines.push((line.to_owned(), copy.map(|copy| Named { name, copy })));
        }
        self.libraries.push(library.to_owned());
    }

    /// What the copy of an image, or of the images of its tiles, is called; `None` if there is none.
    fn image(&mut self, library: &Path, name: &str, taken: &mut BTreeSet<String>) -> Option<String> {
        let path = named_beside(library, &name.replace(UDIM, "1001"));
        let Some((before, after)) = name.split_once(UDIM) else {
            return self.file(&path, &plain(&file_name(&path)), taken);
        };
        // whatever the folder that it was found in, the tiles are beside each other
        let [before, after] = [before, after].map(|part| file_name(Path::new(&part.replace('\\', "/"))));
        let entries = std::fs::read_dir(path.parent()?).ok()?.flatten();
        let tile = |name: String| -> Option<(String, String)> {
            let number = name.strip_prefix(before.as_str())?.strip_suffix(after.as_str())?.to_owned();
            (number.len() == 4 && number.bytes().all(|b| b.is_ascii_digit())).then_some((name, number))
        };
        let mut tiles: Vec<(String, String)> =
            entries.filter_map(|e| tile(e.file_name().to_string_lossy().into_owned())).collect();
        tiles.sort();
        let mut any = false;
        for (file, number) in tiles {
            let copy = format!("{}{number}{}", plain(&before), plain(&after));
            any |= self.file(&path.with_file_name(file), &copy, taken).is_some();
        }
        any.then(|| format!("{}{UDIM}{}", plain(&before), plain(&after)))
    }

    fn file(&mut self, path: &Path, wanted: &str, taken: &mut BTreeSet<String>) -> Option<String> {
        if let Some(known) = self.images.get(path) {
            return Some(known.clone());
        }
        let extension = path.extension()?.to_string_lossy().to_lowercase();
        if !IMAGES.contains(&extension.as_str()) || check_side_file(path).is_err() {
            return None;
        }
        let (stem, extension) = wanted.rsplit_once('.')?;
        let numbered = (2..).map(|k| format!("{stem}_{k}.{extension}"));
        let copy = std::iter::once(wanted.to_owned()).chain(numbered).find(|name| taken.insert(name.to_lowercase()))?;
        self.images.insert(path.to_owned(), copy.clone());
        Some(copy)
    }

    /// Whether there is anything to copy.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.libraries.is_empty()
    }

    /// Every file that is read.
    pub fn reads(&self) -> impl Iterator<Item = &PathBuf> {
        self.libraries.iter().chain(self.images.keys())
    }

    /// Every file that is written beside a mesh.
    #[must_use]
    pub fn writes(&self, mesh: &Path) -> Vec<PathBuf> {
        if self.is_empty() {
            return Vec::new();
        }
        let images = self.images.values().map(|name| mesh.with_file_name(beside(mesh, name)));
        std::iter::once(mesh.with_extension("mtl")).chain(images).collect()
    }

    /// All libraries as one, beside a mesh.
    fn library(&self, mesh: &Path) -> String {
        let line = |(line, named): &(String, Option<Named>)| match named {
            None => format!("{line}\n"),
            Some(Named { name, copy }) => {
                let start = line.trim_end().trim_end_matches('"').strip_suffix(name.as_str()).unwrap_or_default();
                format!("{}{}\n", start.trim_end_matches('"'), beside(mesh, copy))
            }
        };
        self.lines.iter().map(line).collect()
    }

    /// Whether a file that would be written beside a mesh is somebody else's. Those beside a mesh that is there are of the run that
    /// made it; without it, a copy of these materials and what is [as it was baked](is_made) are ours.
    #[must_use]
    pub fn is_foreign(&self, mesh: &Path, file: &Path) -> bool {
        if mesh.exists() || !file.exists() || is_made(mesh, file) {
            return false;
        }
        let is = |bytes: &[u8]| read_side_file(file).is_ok_and(|found| found == bytes);
        let is_copy = |(image, name): (&PathBuf, &String)| {
            file == mesh.with_file_name(beside(mesh, name)) && read_side_file(image).is_ok_and(|bytes| is(&bytes))
        };
        let is_library = file == mesh.with_extension("mtl") && !self.is_empty() && is(self.library(mesh).as_bytes());
        !is_library && !self.images.iter().any(is_copy)
    }

    /// Copies everything beside a mesh file, whose mesh is made to name it. New files go again unless they are [kept](Copied::keep): who
    /// cannot write the mesh leaves none.
    ///
    /// # Errors
    /// When a file cannot be read any more, or written.
    pub fn write(&self, path: &Path, mesh: &mut PolygonMesh) -> Result<Copied, WriteError> {
        let copied = Copied(self.writes(path).into_iter().filter(|file| !file.exists()).collect());
        if self.is_empty() {
            return Ok(copied);
        }
        for (image, name) in &self.images {
            let bytes = read_file(image).map_err(|e| WriteError::data(image, "an image to copy", e.to_string()))?;
            write_atomically(&path.with_file_name(beside(path, name)), |file| file.write_all(&bytes))?;
        }
        let library = path.with_extension("mtl");
        write_atomically(&library, |file| file.write_all(self.library(path).as_bytes()))?;
        let names = std::iter::once(file_name(&library)).chain(self.gone.iter().cloned());
        mesh.metadata.material_libraries = names.collect();
        Ok(copied)
    }
}

/// New files beside a mesh that is yet to be written.
#[derive(Debug)]
#[must_use = "the files go again when this is dropped"]
pub struct Copied(Vec<PathBuf>);

impl Copied {
    /// The mesh is written: the files stay.
    pub fn keep(mut self) {
        self.0.clear();
    }
}

impl Drop for Copied {
    fn drop(&mut self) {
        for file in &self.0 {
            let _ = std::fs::remove_file(file); // it may not have come to be
        }
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The name of an image beside a mesh.
fn beside(mesh: &Path, image: &str) -> String {
    format!("{}_{image}", plain(&mesh.file_stem().unwrap_or_default().to_string_lossy()))
}

/// A name that no program stumbles over.
fn plain(name: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || ".-_".contains(c) { c } else { '_' };
    name.chars().map(plain).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::parse_obj;

    #[test]
    fn libraries_and_images_go_along_with_names_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, bytes: &str| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        };
        put(
            "in/one.mtl",
            "# by hand\nnewmtl skin\nKd 1 0 0\nmap_Kd -s 2 2 a/my skin.png\nmap_Bump -bm 0.5 b/my_skin.png\n",
        );
        put("in/two.mtl", "newmtl eye\nmap_Kd eye.<UDIM>.jpg\nnorm gone.png\nmap_Ks ../secret\nmap_d a\\my skin.png");
        put("in/a/my skin.png", "A");
        put("in/b/my_skin.png", "B");
        put("in/eye.1001.jpg", "1");
        put("in/eye.1012.jpg", "12");
        put("in/eye.one.jpg", "no tile");
        put("secret", "s");
        let text = b"mtllib one.mtl\nmtllib two.mtl\nmtllib none.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl eye\nf 1 2 3\n";
        let path = folder.path().join("in/face.obj");
        let mut mesh = parse_obj(text, &path).unwrap();
        let files = MaterialFiles::of(&path, &mesh);
        let missing = files.missing.iter().map(|(_, told)| told.as_str()).collect::<Vec<_>>().join("\n");
        assert!(["gone.png", "../secret", "none.mtl"].iter().all(|name| missing.contains(name)), "{missing}");
        assert_eq!((files.missing.len(), files.reads().count()), (3, 2 + 4));

        let out = folder.path().join("out/the face.obj");
        put("out/x", "");
        files.write(&out, &mut mesh.clone()).map(drop).unwrap();
        assert_eq!(std::fs::read_dir(folder.path().join("out")).unwrap().count(), 1, "what is not kept goes");
        files.write(&out, &mut mesh).map(Copied::keep).unwrap();
        assert_eq!(mesh.metadata.material_libraries, ["the face.mtl", "none.mtl"]);
        let read = |name: &str| std::fs::read_to_string(folder.path().join("out").join(name)).unwrap();
        let library = read("the face.mtl");
        for line in [
            "# by hand",
            "map_Kd -s 2 2 the_face_my_skin.png",
            "map_Bump -bm 0.5 the_face_my_skin_2.png",
            "map_Kd the_face_eye.<UDIM>.jpg",
            "norm gone.png",
            "map_d the_face_my_skin.png",
        ] {
            assert!(library.lines().any(|l| l == line), "{line}\n{library}");
        }
        let images =
            ["the_face_my_skin.png", "the_face_my_skin_2.png", "the_face_eye.1001.jpg", "the_face_eye.1012.jpg"];
        assert_eq!(images.map(read), ["A", "B", "1", "12"]);
        let written: Vec<String> = files.writes(&out).iter().map(|p| file_name(p)).collect();
        assert_eq!(std::fs::read_dir(folder.path().join("out")).unwrap().count(), written.len() + 1, "{written:?}");
        // the copy is as good as the original
        let again = MaterialFiles::of(&out, &mesh);
        assert!(again.images.len() == 4 && again.missing.len() == 3);
    }
}
