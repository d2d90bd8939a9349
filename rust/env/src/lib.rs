//! What an episode of the octopus arm is: the limit cycle to follow, the base actuator's schedule, the
//! reward, the seeded reset onto the orbit, and the end; and many of them at once, in lanes and
//! threads. No Python, no sockets.
//!
//! [`Episode`] is the way in, [`EpisodeBatch`] that of many, [`ArmBatch`] many arms without episodes.

mod arm_batch;
mod config;
mod control;
mod episode;
mod episode_batch;
mod orbit;
mod outcome;
mod reward;
mod swing;
mod task;
mod teacher;
mod workers;

pub use arm_batch::{ArmBatch, Stop};
pub use config::{CheckedConfig, EpisodeConfig};
pub use episode::Episode;
pub use episode_batch::{Autoreset, BatchReset, BatchState, BatchStep, EpisodeBatch, Last};
pub use orbit::{Orbit, Target, TargetName};
pub use outcome::{Outcome, Reading, Word};
pub use reward::{Reward, RewardTerms};
pub use swing::{Snapshot, Swing};
pub use task::{EpisodeState, check_step};
pub use teacher::TeacherClock;
