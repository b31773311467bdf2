//! The server without a browser: who gets in, what hostile messages and files come to, what the vault keeps, and the command line.

#![allow(missing_docs)]

mod archive;
mod big;
mod client;
mod jobs;
mod program;
mod protocol;
mod rewrap;
mod sculpting;
mod security;
mod vault;
