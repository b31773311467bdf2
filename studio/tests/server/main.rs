//! The server without a browser: who gets in, what hostile messages and files come to, and what the vault keeps.

#![allow(missing_docs)]

mod archive;
mod big;
mod client;
mod protocol;
mod rewrap;
mod sculpting;
mod security;
mod vault;
