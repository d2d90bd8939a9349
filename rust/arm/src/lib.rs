//! The soft robotic arm of Nakajima et al. (2013), "A soft body as a reservoir": twenty
//! mass–spring–damper compartments with the octopus's muscular arrangement, in water, driven by the
//! rotation of their base. Equation numbers are the paper's.
//!
//! ```
//! use octoarm_arm::{Actuator, Arm, ArmLanes, ArmParameters};
//!
//! // The paper's body with stiffer longitudinal springs, at rest.
//! let parameters = ArmParameters { longitudinal_stiffness: 220.0.into(), ..ArmParameters::nakajima2013() };
//! let mut arm = Arm::new(parameters, Actuator::Direct)?;
//!
//! // A tenth of a second in which the base turns to θ = 5°, and the 80 spring lengths on the way.
//! let commands: Vec<[f64; 2]> = (1..=100).map(|step| [0.05 * f64::from(step), 0.0]).collect();
//! let mut lengths = vec![0.0; 100 * arm.observation_len()];
//! arm.run(&commands, &mut lengths).map_err(|(_, failure)| failure)?;
//! assert!(lengths.iter().all(|length| (0.015..0.025).contains(length)));
//!
//! // Eight arms in the lanes of the vector registers have the very same bits.
//! let mut lanes = ArmLanes::new(&[&arm; ArmLanes::WIDTH])?;
//! assert!(lanes.step(&[[5.0, 0.0]; ArmLanes::WIDTH], &[true; ArmLanes::WIDTH]));
//! arm.step([5.0, 0.0])?;
//! assert_eq!(lanes.state(7), arm.state());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The physics is deterministic to the bit: no platform mathematics, no data-dependent order of
//! summation, the same result on every instruction set. What cannot be is a [`ParameterError`] before
//! anything is changed; a step that would leave the model's domain is a [`DomainError`], and the arm
//! keeps its last valid state.

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
mod multiply_add;
mod parameters;
mod per_compartment;
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
pub use per_compartment::PerCompartment;
pub use posture::Energy;
pub use readout::LinearReadout;
pub use state::{ArmState, COORDINATES, MuscleRow};
