//! What an episode of the octopus arm is: the limit cycle to follow, the base actuator's schedule, the
//! reward, the seeded reset onto the orbit, and the end. No Python, no sockets, no threads.
//!
//! [`Episode`] is the way in.

mod config;
mod episode;
mod orbit;
mod reward;
mod swing;

pub use config::{EpisodeConfig, Target, TargetName};
pub use episode::{Episode, EpisodeState, Outcome};
pub use orbit::Orbit;
pub use reward::{Reward, RewardTerms};
pub use swing::{Swing, TeacherClock};
