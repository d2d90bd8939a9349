//! The soft robotic arm of Nakajima et al. (2013), "A soft body as a reservoir": twenty
//! mass–spring–damper compartments with the octopus's muscular arrangement, in water, driven by the
//! rotation of their base. Equation numbers are the paper's.
//!
//! [`Arm`] is the way in. The physics is deterministic to the bit: no platform mathematics, no
//! data-dependent order of summation, the same result on every instruction set.

mod arm;
mod arm_lanes;
mod base;
pub mod domain;
mod equilibrium;
mod error;
mod instruction_set;
mod interrupt;
mod interval;
mod json;
mod kernel;
mod lanes;
mod linearise;
pub mod memory;
mod parameters;
mod posture;
mod readout;
mod runge_kutta;
mod state;
pub mod transcendental;

pub use arm::{Arm, COMMAND_LIMIT, check_command};
pub use arm_lanes::ArmLanes;
pub use base::{Actuator, BaseMotion, Servo};
pub use domain::{DomainError, Limit};
pub use error::{ParameterError, check_finite};
pub use instruction_set::InstructionSet;
pub use interrupt::{interruptible, poll};
pub use interval::Interval;
pub use json::{read_fields, read_json};
pub use linearise::Linearisation;
pub use nalgebra::DMatrix as Matrix;
pub use parameters::{ArmParameters, BaseCoupling, ReferenceArea, VolumeForce};
pub use posture::Energy;
pub use readout::LinearReadout;
pub use state::{ArmState, COORDINATES, MuscleRow};
