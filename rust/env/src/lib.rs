//! What an episode of the octopus arm is: the limit cycle to follow, the base actuator's schedule, the
//! reward, the seeded reset onto the orbit, and the end; and many of them at once, in lanes and
//! threads. No Python, no sockets.
//!
//! [`Episode`] is the way in, [`EpisodeBatch`] that of many, [`ArmBatch`] many arms without episodes.

mod arm_batch;
mod batch;
mod config;
mod course;
mod episode;
mod orbit;
mod reward;
mod swing;
mod workers;

pub use arm_batch::{ArmBatch, Stop};
pub use batch::{Autoreset, BatchReset, BatchState, BatchStep, EpisodeBatch, Last};
pub use config::{EpisodeConfig, Target, TargetName};
pub use course::{EpisodeState, Outcome, check_step};
pub use episode::Episode;
pub use orbit::Orbit;
pub use reward::{Reward, RewardTerms};
pub use swing::{Swing, TeacherClock};
