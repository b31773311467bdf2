//! Pictures drawn on the CPU: shaded meshes, wireframes, points, colour maps with their bar, sheets of panels.
//!
//! A [`Scene`] holds layers, a [`Camera`] looks at them, [`render`] makes an image, a [`Sheet`] arranges several with
//! titles, and [`save_png`] writes the file. Axes: Y up, a face looks towards +Z. The same scene gives the same bytes at
//! any thread count. Nothing here panics: what cannot be drawn (NaN, indices out of range, points behind the camera) is
//! left out.
//!
//! ```
//! use nonrigid::mesh::{PolygonMesh, Vec3};
//! use nonrigid::render::{Camera, Frame, Scene, Style, View, render};
//!
//! let quad = PolygonMesh {
//!     positions: vec![Vec3::new(-1., -1., 0.), Vec3::new(1., -1., 0.), Vec3::new(1., 1., 0.), Vec3::new(-1., 1., 0.)],
//!     starts: vec![0, 4],
//!     corners: vec![0, 1, 2, 3],
//!     ..PolygonMesh::default()
//! };
//! let scene = Scene::new().mesh(&quad.triangulate(), Style::Clay).wireframe(&quad);
//! let camera = Camera::framing(&Frame::of(&quad.positions), View::Front, [64, 64]);
//! let picture = render(&scene, &camera, [64, 64]);
//! assert_ne!(picture.get_pixel(32, 20), picture.get_pixel(0, 0));
//! ```

mod camera;
mod colour;
mod png;
mod raster;
mod scene;
mod sheet;
mod text;

pub use image::RgbImage;

pub use camera::{Camera, CameraError, Frame, Projection, View};
pub use colour::{ColourMap, ColourScale, Rgb8};
pub use png::{PictureError, encode_png, save_png};
pub use raster::render;
pub use scene::{Scene, Style};
pub use sheet::{Panel, Sheet, error_sheet, registration_sheet, turn_back};
pub use text::{draw_text, text_height, text_size};
