//! A view of meshes that one can turn, inside the page: WebGL of our own, positions in 16 bits, values in 8, all as base64.

use anyhow::{Result, bail};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use nonrigid::mesh::{PolygonMesh, TriangleMesh, Vec3};
use nonrigid::render::{ColourMap, ColourScale};
use nonrigid::text::html;
use serde_json::{Value, json};

/// A mesh among those of a [`View3d`].
#[derive(Debug)]
pub struct ViewMesh {
    name: String,
    said: String,
    surface: TriangleMesh,
    values: Vec<Vec<f64>>,
}

/// Meshes in one frame, one of them shown at a time, the first at first.
#[derive(Debug)]
pub struct View3d {
    /// What can be chosen.
    pub meshes: Vec<ViewMesh>,
    /// Names of the values that meshes have; meshes without any are shown as clay.
    pub quantities: Vec<&'static str>,
    /// Their common scale, from zero.
    pub scale: ColourScale,
    /// What it shows.
    pub caption: String,
}

impl ViewMesh {
    /// A surface under its name in the list, and what is said while it is shown.
    #[must_use]
    pub fn new(name: &str, said: String, surface: TriangleMesh) -> Self {
        Self { name: name.to_owned(), said, surface, values: Vec::new() }
    }

    /// Of polygons.
    #[must_use]
    pub fn of_polygons(name: &str, said: String, mesh: &PolygonMesh) -> Self {
        Self::new(name, said, mesh.triangulate())
    }

    /// With the values of every vertex, by quantity; not a number where there is none.
    #[must_use]
    pub fn with_values(mut self, values: Vec<Vec<f64>>) -> Self {
        self.values = values;
        self
    }
}

impl View3d {
    /// Meshes alone.
    #[must_use]
    pub fn of_shapes(meshes: Vec<ViewMesh>, caption: String) -> Self {
        let scale = ColourScale::new(ColourMap::Viridis, 0.0, 1.0, "", "");
        Self { meshes, quantities: Vec::new(), scale, caption }
    }

    /// The figure, to stand in a page with [`SCRIPT`].
    ///
    /// # Errors
    /// When a mesh has no vertex, one that is not finite, or values for other than every vertex.
    pub fn html(&self) -> Result<String> {
        let mut topologies: Vec<&[[u32; 3]]> = Vec::new();
        let mut meshes = Vec::new();
        for mesh in &self.meshes {
            let triangles = &mesh.surface.triangles[..];
            let topology = topologies.iter().position(|t| *t == triangles).unwrap_or_else(|| {
                topologies.push(triangles);
                topologies.len() - 1
            });
            meshes.push(self.mesh(mesh, topology).map_err(|e| e.context(format!("3D view of {:?}", mesh.name)))?);
        }
        let colours: Vec<u8> = (0..256).flat_map(|k| self.scale.map.at(f64::from(k) / 255.0)).collect();
        let data = json!({
            "meshes": meshes,
            "topologies": topologies.iter().map(|t| encoded_triangles(t)).collect::<Vec<_>>(),
            "quantities": self.quantities,
            "colours": STANDARD.encode(colours),
            "high": self.scale.high,
            "unit": self.scale.unit,
        });
        // Within a script, only "</" could end it.
        let data = data.to_string().replace("</", "<\\/");
        let stops = (0..=8).map(|k| self.scale.map.at(f64::from(k) / 8.0));
        let gradient = stops.map(|[r, g, b]| format!("rgb({r},{g},{b})")).collect::<Vec<_>>().join(",");
        let label = html(&self.scale.label);
        Ok(format!(
            "<figure class=\"view3d\"><canvas tabindex=\"0\" aria-label=\"3D view: drag or arrow keys turn, + and - zoom\"></canvas>\
             <div class=\"controls\"><label>mesh <input type=\"range\" name=\"mesh\" min=\"0\" value=\"0\"></label>\
             <select name=\"choice\" aria-label=\"mesh\"></select><output></output>\
             <label data-values>colour <select name=\"values\"></select></label>\
             <span data-values class=\"bar\">{label}: 0 <i style=\"background:linear-gradient(90deg,{gradient})\"></i>\
             <span class=\"bar-high\"></span></span>\
             <label data-values>range <input type=\"range\" name=\"top\" min=\"5\" max=\"100\" value=\"100\"></label></div>\
             <figcaption>{} Drag or arrow keys turn; + and −, or the wheel after a click, zoom.</figcaption>\
             <script type=\"application/json\">{data}</script></figure>\n",
            html(&self.caption)
        ))
    }

    fn mesh(&self, mesh: &ViewMesh, topology: usize) -> Result<Value> {
        let points = &mesh.surface.positions;
        if points.is_empty() || points.iter().any(|p| p.iter().any(|v| !v.is_finite())) {
            bail!("a vertex is not finite, or there is none");
        }
        if let Some(values) = mesh.values.iter().find(|values| values.len() != points.len()) {
            bail!("{} values for {} vertices", values.len(), points.len());
        }
        let (low, high) = points.iter().fold((points[0], points[0]), |(low, high), p| (low.inf(p), high.sup(p)));
        let size = high - low;
        let values = mesh.values.iter().map(|of| {
            let byte = |v: &f64| {
                if v.is_nan() { 255 } else { (254.0 * self.scale.position(*v).clamp(0.0, 1.0)).round() as u8 }
            };
            STANDARD.encode(of.iter().map(byte).collect::<Vec<u8>>())
        });
        Ok(json!({
            "name": mesh.name,
            "said": mesh.said,
            "topology": topology,
            "low": low.as_slice(),
            "size": size.as_slice(),
            "positions": STANDARD.encode(quantised(points, low, size)),
            "values": values.collect::<Vec<_>>(),
        }))
    }
}

/// Each coordinate in 16 bits, little endian: 0 at the box's lower side, 65535 at its upper.
fn quantised(points: &[Vec3], low: Vec3, size: Vec3) -> Vec<u8> {
    let one = |p: &Vec3| -> [u16; 3] {
        std::array::from_fn(|k| if size[k] > 0.0 { (65535.0 * (p[k] - low[k]) / size[k]).round() as u16 } else { 0 })
    };
    points.iter().flat_map(one).flat_map(u16::to_le_bytes).collect()
}

/// In 16 bits where these do, else in 32.
fn encoded_triangles(triangles: &[[u32; 3]]) -> Value {
    let corners = || triangles.iter().flatten().copied();
    let (bits, bytes): (u32, Vec<u8>) = if corners().all(|v| v <= u32::from(u16::MAX)) {
        (16, corners().flat_map(|v| (v as u16).to_le_bytes()).collect())
    } else {
        (32, corners().flat_map(u32::to_le_bytes).collect())
    };
    json!({ "bits": bits, "triangles": STANDARD.encode(bytes) })
}

/// What draws every view of a page.
pub const SCRIPT: &str = include_str!("viewer.js");

#[cfg(test)]
mod tests {
    use super::*;

    fn quad(far: f64) -> TriangleMesh {
        let corner = |x, y| Vec3::new(x, y, far);
        TriangleMesh {
            positions: vec![corner(0.0, 0.0), corner(10.0, 0.0), corner(10.0, 4.0), corner(0.0, 1.0)],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    fn data(view: &View3d) -> Value {
        let html = view.html().unwrap();
        let json = html.split_once("application/json\">").unwrap().1.split_once("</script>").unwrap().0;
        serde_json::from_str(json).unwrap()
    }

    fn numbers(text: &Value) -> Vec<u16> {
        let bytes = STANDARD.decode(text.as_str().unwrap()).unwrap();
        bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect()
    }

    #[test]
    fn positions_come_back_to_half_a_step_and_topologies_are_shared() {
        let scale = ColourScale::new(ColourMap::Viridis, 0.0, 2.0, "error", "mm");
        let valued =
            ViewMesh::new("b </script>", "b".into(), quad(5.0)).with_values(vec![vec![0.0, 1.0, 9.0, f64::NAN]]);
        let meshes = vec![ViewMesh::new("a", "a".into(), quad(0.0)), valued];
        let view = View3d { meshes, quantities: vec!["off"], scale, caption: "A < B.".into() };
        let data = data(&view);
        assert_eq!(data["topologies"].as_array().unwrap().len(), 1);
        assert_eq!(numbers(&data["topologies"][0]["triangles"]), [0, 1, 2, 0, 2, 3]);
        let mesh = &data["meshes"][1];
        assert_eq!(mesh["name"], "b </script>");
        for (stored, point) in numbers(&mesh["positions"]).chunks_exact(3).zip(quad(5.0).positions) {
            for axis in 0..3 {
                let (low, size) = (mesh["low"][axis].as_f64().unwrap(), mesh["size"][axis].as_f64().unwrap());
                let back = low + f64::from(stored[axis]) / 65535.0 * size;
                assert!((back - point[axis]).abs() <= size / 131_070.0 * 1.001, "{back}, {point}");
            }
        }
        assert_eq!(STANDARD.decode(mesh["values"][0].as_str().unwrap()).unwrap(), [0, 127, 254, 255]);
    }

    #[test]
    fn what_cannot_be_drawn_is_an_error() {
        let view = |mesh: ViewMesh| View3d::of_shapes(vec![mesh], String::new()).html();
        let mut lost = quad(0.0);
        lost.positions[2].x = f64::NAN;
        assert!(view(ViewMesh::new("a", String::new(), lost)).is_err());
        let error = view(ViewMesh::new("a", String::new(), quad(0.0)).with_values(vec![vec![1.0]])).unwrap_err();
        assert_eq!(format!("{error:#}"), "3D view of \"a\": 1 values for 4 vertices");
    }
}
