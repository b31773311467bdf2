//! Blendshapes, then what the schedule's `[then]` names, from the shape that they have found (Bhat et al. 2013): no model of its
//! own but a schedule of two stages.

use super::blendshape;
use super::factory::BuiltIn;

pub(super) const MODEL: BuiltIn = BuiltIn {
    needs_second_stage: true,
    ..blendshape::MODEL.scheduled("sequential", include_str!("schedules/sequential.toml"))
};
