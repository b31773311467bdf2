//! The hybrid with the energy of Klimov 2020 and nothing else: point-to-plane (3) of every vertex and landmarks, under (5), (7) and
//! (9). No model of its own but a schedule, so that tables show what the default schedule of [`hybrid`] adds.

use super::factory::Scheduled;
use super::hybrid;

pub(super) const FACTORY: Scheduled = Scheduled {
    name: "klimov2020",
    schedule: include_str!("schedules/klimov2020.toml"),
    of: &hybrid::Factory,
    two_stages: false,
};
