//! A guide, from a first registration to models, terms and residuals of one's own. Its programs are run as tests.
//!
//! | chapter | for whom |
//! |---|---|
//! | [A first registration](first_registration) | who has a template and a scan |
//! | [A residual of one's own](own_residual) | who has an energy to minimise, with meshes or without |
//! | [A model of one's own](own_model) | who wants to deform in another way |
//! | [A term of one's own](own_term) | who knows more of the surface than a scan says |
//! | [Reading a report](reading_a_report) | who has a result, and doubts |
//!
//! The chapters go step by step; programs as a whole, on faces, are in the repository's folder `examples`. Where the energy and
//! its models come from is said at [`energy`](crate::energy), [`model`](crate::model) and [`term`](crate::term).

#[doc = include_str!("../docs/src/tutorials/developer.md")]
pub mod first_registration {}
#[doc = include_str!("../docs/src/howto/own_residual.md")]
pub mod own_residual {}
#[doc = include_str!("../docs/src/howto/own_model.md")]
pub mod own_model {}
#[doc = include_str!("../docs/src/howto/own_term.md")]
pub mod own_term {}
#[doc = include_str!("../docs/src/reference/report.md")]
pub mod reading_a_report {}
