//! Blendshapes, then what the schedule's `[then]` names, from the shape that they have found (Bhat et al. 2013): no model of its
//! own but a schedule of two stages.

use super::blendshape;
use super::factory::Scheduled;

pub(super) const FACTORY: Scheduled = Scheduled {
    name: "sequential",
    schedule: include_str!("schedules/sequential.toml"),
    of: &blendshape::Factory,
    two_stages: true,
};
