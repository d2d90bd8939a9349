//! The arm in the browser: the very physics of `octoarm-arm`, driven by a hand, a teacher, a linear
//! readout that is fitted here, or a trained network. `rust/web/page` is the page around it.
//!
//! ```
//! use octoarm_arm::ArmParameters;
//! use octoarm_env::TargetName;
//! use octoarm_web::Simulation;
//!
//! let mut simulation = Simulation::new(ArmParameters::default())?;
//! simulation.begin_lesson(TargetName::Quadratic, 90.0)?;
//! simulation.advance(8_000)?; // the teacher swings the arm
//! let error = simulation.fit(1e-6)?; // least squares
//! assert!(error < 0.1, "{error} degrees");
//! simulation.let_go()?; // the springs say where the base goes
//! simulation.advance(1_000)?;
//! assert!(simulation.distance() < 0.02, "of the amplitude");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bindings;
mod lesson;
mod network;
mod orbit_distance;
mod simulation;

pub use bindings::{Octoarm, preset, run};
pub use network::Network;
pub use simulation::{Driver, Simulation};
