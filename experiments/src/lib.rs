//! Studies on top of `nonrigid`.
