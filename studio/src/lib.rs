//! The studio: wrap, compare and plan an operation by mouse, in a browser. Start reading at [`server`]; `README.md` has the map.

pub mod analysis;
pub mod archive;
pub mod case;
pub mod demo;
pub mod error;
pub mod knowledge;
pub mod plan;
pub mod protocol;
pub mod server;
pub mod session;
pub mod store;
pub mod vault;
pub mod wrap;
