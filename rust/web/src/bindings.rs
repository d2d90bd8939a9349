//! What JavaScript calls. Arrays stay where they are: JavaScript looks at them through views of the
//! module's memory, for which a pointer and a length are given; a view holds until the next call.

use std::fmt::Display;

use octoarm_arm::{Actuator, Arm, ArmParameters, read_json};
use octoarm_env::TargetName;
use wasm_bindgen::prelude::{JsError, wasm_bindgen};

use crate::network::Network;
use crate::simulation::{Driver, Simulation};

type Result<T> = std::result::Result<T, JsError>;

/// An `Error` of JavaScript with the same words.
#[allow(clippy::needless_pass_by_value)] // as `map_err` calls it
fn error(error: impl Display) -> JsError {
    JsError::new(&error.to_string())
}

fn target(name: &str) -> Result<TargetName> {
    read_json(&format!("{name:?}")).map_err(|failure| JsError::new(&format!("target: {failure}")))
}

/// The body of one of the names in `ArmParameters::PRESETS`, as JSON.
#[wasm_bindgen]
pub fn preset(name: &str) -> Result<String> {
    ArmParameters::preset(name).and_then(|body| body.to_json()).map_err(error)
}

/// Spring lengths \[m\] after each step from rest, (T, springs), under base angles (T, 2) \[degrees\],
/// both row by row: what the module computes, for comparison with other machines.
#[wasm_bindgen]
pub fn run(body: &str, angles: &[f64]) -> Result<Vec<f64>> {
    let body = ArmParameters::from_json(body).map_err(error)?;
    let mut arm = Arm::new(body, Actuator::Direct).map_err(error)?;
    let (commands, _) = angles.as_chunks();
    let mut lengths = vec![0.0; commands.len() * arm.observation_len()];
    arm.run(commands, &mut lengths).map_err(|(_, failure)| error(failure))?;
    Ok(lengths)
}

/// The arm of the page.
#[wasm_bindgen]
#[derive(Debug)]
pub struct Octoarm {
    simulation: Simulation,
    joints: Vec<[[f64; 3]; 4]>,
    orbit: Vec<[f64; 2]>,
}

#[wasm_bindgen]
impl Octoarm {
    /// An arm at rest; the body is JSON, and what it leaves out is the paper's.
    #[wasm_bindgen(constructor)]
    pub fn new(body: &str) -> Result<Octoarm> {
        let body = ArmParameters::from_json(body).map_err(error)?;
        let simulation = Simulation::new(body).map_err(error)?;
        let orbit = simulation.orbit().table().to_vec();
        Ok(Self { joints: simulation.arm().joints(), orbit, simulation })
    }

    /// [`Simulation::set_body`] from JSON.
    pub fn set_body(&mut self, body: &str) -> Result<()> {
        let body = ArmParameters::from_json(body).map_err(error)?;
        self.simulation.set_body(body).map_err(error)
    }

    /// [`Simulation::reset`].
    pub fn reset(&mut self) -> Result<()> {
        self.simulation.reset().map_err(error)
    }

    /// [`Simulation::drag`].
    pub fn drag(&mut self, theta: f64, phi: f64) -> Result<()> {
        self.simulation.drag([theta, phi]).map_err(error)
    }

    /// [`Simulation::set_target`] by a target's name.
    pub fn set_target(&mut self, name: &str, amplitude: f64) -> Result<()> {
        self.simulation.set_target(target(name)?, amplitude).map_err(error)?;
        self.orbit.clear();
        self.orbit.extend_from_slice(self.simulation.orbit().table());
        Ok(())
    }

    /// [`Simulation::begin_lesson`] by a target's name.
    pub fn begin_lesson(&mut self, name: &str, amplitude: f64) -> Result<()> {
        self.set_target(name, amplitude)?;
        self.simulation.begin_lesson(target(name)?, amplitude).map_err(error)
    }

    /// [`Simulation::fit`].
    pub fn fit(&mut self, noise: f64) -> Result<f64> {
        self.simulation.fit(noise).map_err(error)
    }

    /// [`Simulation::let_go`].
    pub fn let_go(&mut self) -> Result<()> {
        self.simulation.let_go().map_err(error)
    }

    /// [`Simulation::let_network`] from a network's file.
    pub fn let_network(&mut self, file: &[u8]) -> Result<()> {
        let network = Network::from_bytes(file).map_err(error)?;
        self.simulation.let_network(network).map_err(error)
    }

    /// [`Simulation::set_noise`].
    pub fn set_noise(&mut self, command: f64, length: f64) -> Result<()> {
        self.simulation.set_noise(command, length).map_err(error)
    }

    /// [`Simulation::push`].
    pub fn push(&mut self, theta: f64, phi: f64) -> Result<()> {
        self.simulation.push([theta, phi]).map_err(error)
    }

    /// [`Simulation::advance`].
    pub fn advance(&mut self, steps: usize) -> Result<usize> {
        self.simulation.advance(steps).map_err(error)
    }

    /// Who commands the base: `hand`, `teacher`, `readout` or `network`.
    #[wasm_bindgen(getter)]
    pub fn driver(&self) -> String {
        match self.simulation.driver() {
            Driver::Hand => "hand",
            Driver::Teacher => "teacher",
            Driver::Readout => "readout",
            Driver::Network => "network",
        }
        .to_owned()
    }

    /// Time since the arm was at rest \[s\].
    #[wasm_bindgen(getter)]
    pub fn time(&self) -> f64 {
        self.simulation.arm().time()
    }

    /// Steps that the lesson holds.
    #[wasm_bindgen(getter)]
    pub fn lesson_steps(&self) -> usize {
        self.simulation.lesson_steps()
    }

    /// How far the base is from the orbit, in parts of the amplitude.
    #[wasm_bindgen(getter)]
    pub fn distance(&self) -> f64 {
        self.simulation.distance()
    }

    /// Time of one turn of the target \[s\].
    #[wasm_bindgen(getter)]
    pub fn turn(&self) -> f64 {
        self.simulation.orbit().period()
    }

    /// Whether a push is under way.
    #[wasm_bindgen(getter)]
    pub fn pushed(&self) -> bool {
        self.simulation.pushed()
    }

    /// Base angle θ \[degrees\].
    #[wasm_bindgen(getter)]
    pub fn theta(&self) -> f64 {
        self.simulation.arm().base_degrees()[0]
    }

    /// Base angle φ \[degrees\].
    #[wasm_bindgen(getter)]
    pub fn phi(&self) -> f64 {
        self.simulation.arm().base_degrees()[1]
    }

    /// Rest length of the springs \[m\].
    #[wasm_bindgen(getter)]
    pub fn rest_length(&self) -> f64 {
        self.simulation.arm().parameters().rest_length
    }

    /// Compartments of the arm.
    #[wasm_bindgen(getter)]
    pub fn compartments(&self) -> usize {
        self.simulation.arm().parameters().compartments
    }

    /// Ends of the springs in the world, (compartments + 1, 4, 3) \[m\], computed now.
    pub fn joints(&mut self) -> *const f64 {
        self.joints = self.simulation.arm().joints();
        self.joints.as_ptr().cast()
    }

    /// Lengths of the springs \[m\], (compartments, 4).
    #[must_use]
    pub fn lengths(&self) -> *const f64 {
        self.simulation.lengths().as_ptr()
    }

    /// Weights of the readout (springs, 2) \[degrees/m\]; 0 where there is none.
    #[must_use]
    pub fn weights(&self) -> *const f64 {
        self.simulation
            .readout()
            .map_or(std::ptr::null(), |readout| readout.weights.as_ptr().cast())
    }

    /// The target's orbit (`orbit_points`, 2) \[degrees\].
    #[must_use]
    pub fn orbit(&self) -> *const f64 {
        self.orbit.as_ptr().cast()
    }

    /// Points of the target's orbit.
    #[wasm_bindgen(getter)]
    pub fn orbit_points(&self) -> usize {
        self.orbit.len()
    }
}
