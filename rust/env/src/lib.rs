//! What an episode of the octopus arm is: the limit cycle to follow, the base actuator's schedule, the
//! reward, the seeded reset onto the orbit, and the end; and many of them at once, in lanes and
//! threads. No Python, no sockets.
//!
//! ```
//! use octoarm_env::{Autoreset, Episode, EpisodeBatch, EpisodeConfig, Target, TargetName};
//!
//! // One arm that follows the Lissajous figure of the paper, as its teacher commands.
//! let target = Target::Named(TargetName::Lissajous);
//! let config = EpisodeConfig { target, ..EpisodeConfig::default() }.checked()?;
//! let mut episode = Episode::with_limit(config.clone(), Some(500))?;
//! episode.seed(0);
//! episode.reset();
//! let outcome = episode.step(episode.teacher_action())?;
//! assert!(outcome.reward > 0.9 && !outcome.terminated());
//! assert_eq!(episode.observation().len(), 80);
//!
//! // Twelve of them in lanes, on two threads.
//! let mut batch = EpisodeBatch::new(&vec![config; 12], Some(500), Autoreset::NextStep, Some(2))?;
//! let seeds: Vec<Option<u64>> = (0..12).map(Some).collect();
//! batch.reset(None, &seeds, None)?;
//! let step = batch.step(&batch.teacher_actions())?;
//! assert_eq!(step.observations[..80], episode.observation());
//! assert_eq!(step.outcomes[0], outcome);
//! # Ok::<(), octoarm_arm::ParameterError>(())
//! ```
//!
//! [`ArmBatch`] is many arms without episodes.

mod arm_batch;
mod config;
mod control;
mod draw;
mod episode;
mod episode_batch;
mod goals;
mod limit_cycle;
mod number_files;
mod orbit;
mod outcome;
mod reach;
mod reach_bodies;
mod reach_config;
mod reward;
mod senses;
mod swing;
mod task;
mod teacher;
mod workers;

pub use arm_batch::{ArmBatch, Stop};
pub use config::{CheckedConfig, EpisodeConfig};
pub use control::command_at;
pub use draw::share;
pub use episode::Episode;
pub use episode_batch::{
    Autoreset, BatchReset, BatchState, BatchStep, EpisodeBatch, Last, PartialStep,
};
pub use goals::reachable_goals;
pub use limit_cycle::{EpisodeState, LimitCycle, check_actions, check_step};
pub use orbit::{Orbit, Target, TargetName};
pub use outcome::{Outcome, Reading, Word, Words};
pub use reach::{Reach, ReachOutcome, ReachState, check_activations};
pub use reach_bodies::ReachBodies;
pub use reach_config::{MUSCLES, ReachConfig, ReachReward, distance};
pub use reward::{Reward, RewardTerms};
pub use senses::{DisturbanceInfo, Disturbances, Part, Senses, Told};
pub use swing::{Snapshot, Swing, SwingRun, Swings};
pub use task::{Stage, Task};
pub use teacher::TeacherClock;
