//! Files: round trips, formats, units, colour, and what is malformed.

#[path = "../support/mod.rs"]
mod support;

mod bad_input;
mod colour;
mod gltf;
mod mesh_formats;
mod round_trips;
mod texture;
mod units;
