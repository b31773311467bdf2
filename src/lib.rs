//! Deform meshes by nonlinear least squares: wrap a template onto a raw scan, compare deformation models, or put your own
//! model, data term or residual on the same solver.
//!
//! New here? Begin with the [`guide`].
//!
//! From the ground up; nothing imports from above itself:
//!
//! - [`nlls`]: generic least squares. Start here with a problem that has nothing to do with meshes.
//! - [`mesh`], [`io`], [`landmark`] and [`rig`]: polygon meshes, geodesics, closest points; files; landmarks; blendshape rigs.
//! - [`correspondence`]: which point of a scan belongs to which vertex of a template.
//! - [`energy`]: where deformation models and data terms meet, each ignorant of the other.
//! - [`model`] and [`term`]: the models and terms of Klimov 2020, equations (2) to (9), each with the options that it reads from a
//!   schedule; one file and one line for a new one.
//! - [`evaluation`] and [`render`]: errors and pictures; [`texture`]: a scan's texture in the template's texture coordinates.
//! - [`registration`]: non-rigid ICP on all of this. Start here with a template and a scan: [`registration::register`].
//! - [`morph`]: grey masks that are drawn, blurred, projected on a mesh and move its vertices (Li et al. 2018).
//! - [`measurement`]: distances, angles, symmetry, areas and volumes of a face, before and after; [`page`]: HTML for people.
//! - [`motion`]: the frames of a sequence: lost ones found, flicker smoothed.
//! - [`batch`]: many scans, each in a process of its own.
//! - [`self_test`]: does this build compute what it should on this machine?
//! - [`text`]: what came from a file, on its way into another one or onto a terminal.
//! - [`console`]: errors with exit codes, and what a program says; [`cli`]: the `nonrigid` command (feature `cli`).

#[cfg(feature = "cli")]
pub mod batch;
#[cfg(feature = "cli")]
pub mod cli;
pub mod console;
pub mod correspondence;
pub mod energy;
pub mod evaluation;
pub mod guide;
pub mod io;
pub mod landmark;
#[cfg(feature = "pictures")]
pub mod measurement;
pub mod mesh;
pub mod model;
#[cfg(feature = "pictures")]
pub mod morph;
pub mod motion;
pub mod nlls;
pub mod page;
pub mod registration;
#[cfg(feature = "pictures")]
pub mod render;
pub mod rig;
pub mod self_test;
pub mod term;
pub mod text;
#[cfg(feature = "pictures")]
pub mod texture;
