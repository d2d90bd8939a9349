//! The soft robotic arm of Nakajima et al. (2013), "A soft body as a reservoir": twenty
//! mass–spring–damper compartments with the octopus's muscular arrangement, in water, driven by the
//! rotation of their base. Equation numbers are the paper's.
//!
//! [`Arm`] is the way in. The physics is deterministic to the bit: no platform mathematics, no
//! data-dependent order of summation, the same result on every instruction set.

mod arm;
mod base;
pub mod domain;
mod energy;
mod engine;
mod equilibrium;
mod error;
pub mod geometry;
mod interrupt;
mod kernel;
mod lanes;
pub mod memory;
mod parameters;
mod state;
pub mod transcendental;

pub use arm::{Arm, COMMAND_LIMIT, LinearReadout, check_command};
pub use base::{Actuator, BaseMotion, Servo};
pub use energy::Energy;
pub use engine::InstructionSet;
pub use error::{DomainError, Limit, ParameterError, read_json};
pub use interrupt::{interruptible, poll};
pub use lanes::ArmLanes;
pub use parameters::{ArmParameters, BaseCoupling, ReferenceArea, VolumeForce};
pub use state::{ArmState, COORDINATES, MuscleRow};
