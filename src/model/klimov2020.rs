//! The hybrid with the energy of Klimov 2020 and nothing else: point-to-plane (3) of every vertex and landmarks, under (5), (7) and
//! (9). No model of its own but a schedule, so that tables show what the default schedule of [`hybrid`] adds.

use super::factory::BuiltIn;
use super::hybrid;

pub(super) const MODEL: BuiltIn = hybrid::MODEL.scheduled("klimov2020", include_str!("schedules/klimov2020.toml"));
