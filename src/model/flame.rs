//! What users of a linear head model do, as FLAME's (Li et al. 2017): weights and pose by the landmarks, then also by robust closest
//! points, with Tikhonov priors and no motion but the shapes'. No model of its own but a schedule of [`blendshape`].

use super::blendshape;
use super::factory::BuiltIn;

pub(super) const MODEL: BuiltIn = blendshape::MODEL.scheduled("flame", include_str!("schedules/flame.toml"));
