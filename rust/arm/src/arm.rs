//! One arm: parameters, state, and steps.

use std::sync::Arc;

use crate::base::{Actuator, BaseMotion};
use crate::domain::DomainError;
use crate::equilibrium::static_equilibrium;
use crate::error::ParameterError;
use crate::instruction_set::{InstructionSet, Supported};
use crate::interval::Interval;
use crate::lanes::Lanes;
use crate::parameters::ArmParameters;
use crate::posture::{Energy, energy};
use crate::readout::LinearReadout;
use crate::state::{ArmState, COORDINATES};

/// Largest commanded base angle \[degrees\].
pub const COMMAND_LIMIT: f64 = 3600.0;

/// A soft arm in water, driven by the rotation of its base.
///
/// ```
/// use octoarm_arm::{Actuator, Arm, ArmParameters};
/// let mut arm = Arm::new(ArmParameters::default(), Actuator::Servo)?;
/// for _ in 0..100 {
///     arm.step([10.0, 0.0])?;
/// }
/// assert_eq!(arm.lengths().len(), 80);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Arm {
    lane: Lanes<1>,
    equilibrium: Option<Arc<ArmState>>,
}

// Python's allocator, for one, aligns objects to 16 bytes.
const _: () = assert!(align_of::<Arm>() <= 16);

impl Arm {
    /// An arm hanging in static equilibrium.
    ///
    /// # Errors
    /// [`ParameterError`] for parameters out of range or without a static equilibrium.
    pub fn new(parameters: ArmParameters, actuator: Actuator) -> Result<Self, ParameterError> {
        let mut arm = Self::undeformed(parameters, actuator)?;
        arm.reset()?;
        Ok(arm)
    }

    /// An arm with every spring at its rest length.
    ///
    /// # Errors
    /// [`ParameterError`] for parameters out of range.
    pub fn undeformed(
        parameters: ArmParameters,
        actuator: Actuator,
    ) -> Result<Self, ParameterError> {
        parameters.validate()?;
        let lane = Lanes::new([Arc::new(parameters)], [actuator], Supported::detected());
        Ok(Self { lane, equilibrium: None })
    }

    pub(crate) fn lane(&self) -> &Lanes<1> {
        &self.lane
    }

    /// The same arm computing with other vector instructions, or with the best there are if the
    /// processor lacks them. The results are the same to the bit.
    #[must_use]
    pub fn with_instruction_set(mut self, instructions: InstructionSet) -> Self {
        self.lane.instructions = instructions.supported();
        self
    }

    /// The body's parameters.
    #[must_use]
    pub fn parameters(&self) -> &ArmParameters {
        self.lane.parameters(0)
    }

    /// How the base follows its command.
    #[must_use]
    pub fn actuator(&self) -> Actuator {
        self.lane.actuator(0)
    }

    /// Number of observed spring lengths, four a compartment.
    #[must_use]
    pub fn observation_len(&self) -> usize {
        self.lane.observation_len()
    }

    /// Back to static equilibrium at θ = φ = 0 without muscle inputs.
    ///
    /// # Errors
    /// [`ParameterError::NoEquilibrium`]; the arm is then unchanged.
    pub fn reset(&mut self) -> Result<(), ParameterError> {
        let state = match &self.equilibrium {
            Some(state) => Arc::clone(state),
            None => Arc::new(static_equilibrium(self.parameters(), self.lane.instructions)?),
        };
        let before = self.state();
        self.lane.restore(0, &state);
        if let Some(failure) = self.lane.present_failure(0) {
            self.lane.restore(0, &before);
            return Err(ParameterError::NoEquilibrium { reason: failure.to_string() });
        }
        self.equilibrium = Some(state);
        Ok(())
    }

    /// Back to rest with every spring at its rest length, θ = φ = 0, without muscle inputs.
    pub fn reset_undeformed(&mut self) {
        self.lane.restore(0, &ArmState::undeformed(self.lane.parameters(0)));
    }

    /// Takes another arm's body and actuator, and a state that this very body has been in, without checks.
    ///
    /// # Panics
    /// If it has another number of compartments.
    pub fn place(&mut self, other: &Self, state: &ArmState) {
        assert_eq!(self.observation_len(), other.observation_len(), "bodies of one shape");
        self.lane.set_body(0, &other.lane);
        self.lane.restore(0, state);
        self.equilibrium.clone_from(&other.equilibrium);
    }

    /// The complete state.
    #[must_use]
    pub fn state(&self) -> ArmState {
        self.lane.state(0)
    }

    /// Restores a state exactly: the steps that follow have the same bits.
    ///
    /// # Errors
    /// [`ParameterError`] for a state of another shape, with numbers that are not finite, or outside
    /// the domain; the arm is then unchanged.
    pub fn set_state(&mut self, state: &ArmState) -> Result<(), ParameterError> {
        self.lane.set_state(0, state)
    }

    /// Time since the last reset \[s\].
    #[must_use]
    pub fn time(&self) -> f64 {
        self.lane.steps(0) as f64 * self.parameters().timestep
    }

    /// The base, `[θ, φ, θ̇, φ̇]` \[rad, rad/s\].
    #[must_use]
    pub fn base(&self) -> [f64; 4] {
        self.lane.base(0)
    }

    /// The base angles θ, φ \[degrees\].
    #[must_use]
    pub fn base_degrees(&self) -> [f64; 2] {
        let [theta, phi, _, _] = self.base();
        [theta.to_degrees(), phi.to_degrees()]
    }

    /// Muscle inputs ξ_c and δ_c of every spring \[N\], in observation order; they act until changed.
    ///
    /// # Errors
    /// [`ParameterError`] for slices of another length or numbers that are not finite.
    pub fn set_muscles(
        &mut self,
        longitudinal: &[f64],
        transverse: &[f64],
    ) -> Result<(), ParameterError> {
        self.lane.set_muscles(0, longitudinal, transverse)
    }

    /// The muscle inputs ξ_c and δ_c \[N\], in observation order.
    #[must_use]
    pub fn muscles(&self) -> (Vec<f64>, Vec<f64>) {
        self.lane.muscles(0)
    }

    /// Writes the lengths of the longitudinal springs \[m\], index 4 (j − 1) + (i − 1).
    ///
    /// # Panics
    /// If `out` is shorter than [`Arm::observation_len`].
    pub fn lengths_into(&self, out: &mut [f64]) {
        self.lane.lengths_into(0, out);
    }

    /// Lengths of the longitudinal springs \[m\], index 4 (j − 1) + (i − 1).
    #[must_use]
    pub fn lengths(&self) -> Vec<f64> {
        let mut lengths = vec![0.0; self.observation_len()];
        self.lengths_into(&mut lengths);
        lengths
    }

    /// Kinetic and elastic energy.
    #[must_use]
    pub fn energy(&self) -> Energy {
        energy(self.parameters(), &self.state(), &self.lengths())
    }

    /// Centres of all planes, base first \[m\].
    #[must_use]
    pub fn positions(&self) -> Vec<[f64; 3]> {
        self.state().positions()
    }

    /// Ends of the longitudinal springs on all planes, as [`ArmState::joints`] \[m\].
    #[must_use]
    pub fn joints(&self) -> Vec<[[f64; 3]; 4]> {
        self.state().joints(self.parameters())
    }

    /// Accelerations of all coordinates in the present state under a given motion of the base.
    #[must_use]
    pub fn accelerations(&mut self, base: &BaseMotion) -> Vec<[f64; COORDINATES]> {
        self.lane.accelerations(base)
    }

    /// The base's motion over the next step under a command in degrees: start, middle and end.
    #[must_use]
    pub fn base_motion(&self, command: [f64; 2]) -> [BaseMotion; 3] {
        self.lane.motion(&[command]).map(|instant| instant.lane(0))
    }

    /// One physics step of `timestep` seconds under the commanded base angles θ, φ \[degrees\].
    ///
    /// # Errors
    /// [`DomainError`] if the step would leave the model's domain (a command that is not finite
    /// counts as that too); the arm keeps the state it had.
    pub fn step(&mut self, command: [f64; 2]) -> Result<(), DomainError> {
        if self.lane.step(&[command], &[true]) {
            return Ok(());
        }
        self.lane.failure(0).map_or(Ok(()), Err)
    }

    /// Follows a sequence of commands \[degrees\], writing the lengths after each step.
    ///
    /// # Errors
    /// The number of steps that were made, and the [`DomainError`] of the one that was not; `out`
    /// holds the lengths of those that were.
    ///
    /// # Panics
    /// If `out` does not hold [`Arm::observation_len`] numbers a command.
    pub fn run(
        &mut self,
        commands: &[[f64; 2]],
        out: &mut [f64],
    ) -> Result<(), (usize, DomainError)> {
        let width = self.observation_len();
        assert_eq!(out.len(), commands.len() * width, "room for the lengths of every step");
        for (step, (command, row)) in commands.iter().zip(out.chunks_exact_mut(width)).enumerate() {
            self.step(*command).map_err(|failure| (step, failure))?;
            self.lengths_into(row);
        }
        Ok(())
    }

    /// Closes the loop through a linear readout (Eqs. 24–26): every step commands
    /// `weights · lengths + bias + perturbation` \[degrees\].
    ///
    /// `outputs` receives the readout's outputs (without the perturbation), `lengths` the lengths
    /// after the step that followed. Their sizes set the number of steps.
    ///
    /// # Errors
    /// As [`Arm::run`].
    ///
    /// # Panics
    /// If `lengths`, `perturbation` or the readout's weights do not fit the number of outputs and of
    /// springs.
    pub fn run_closed_loop(
        &mut self,
        readout: &LinearReadout,
        perturbation: Option<&[[f64; 2]]>,
        outputs: &mut [[f64; 2]],
        lengths: &mut [f64],
    ) -> Result<(), (usize, DomainError)> {
        let width = self.observation_len();
        assert_eq!(lengths.len(), outputs.len() * width, "room for the lengths of every step");
        assert_eq!(readout.weights.len(), width, "a weight for every spring");
        assert!(perturbation.is_none_or(|rows| rows.len() == outputs.len()), "one row a step");
        let mut now = self.lengths();
        for (step, (output, row)) in
            outputs.iter_mut().zip(lengths.chunks_exact_mut(width)).enumerate()
        {
            let said = readout.output(&now);
            let push = perturbation.map_or([0.0; 2], |rows| rows[step]);
            self.step([said[0] + push[0], said[1] + push[1]]).map_err(|failure| (step, failure))?;
            *output = said;
            self.lengths_into(row);
            now.copy_from_slice(row);
        }
        Ok(())
    }

    /// [`Arm::run_closed_loop`] through muscles too: after the first readout, that of the base, follow
    /// those of muscle inputs \[N\], two outputs each, in observation order: the ξ_c of all springs, and
    /// after them, if there are so many, the δ_c. What has no readout stays as it is.
    ///
    /// `outputs` receives what all readouts say, two numbers each, a row a step.
    ///
    /// # Errors
    /// As [`Arm::run`]; the muscle inputs are then those of the last step that was made.
    ///
    /// # Panics
    /// If `outputs`, `lengths`, `perturbation` or the readouts do not fit each other and the springs.
    pub fn run_muscle_loop(
        &mut self,
        readouts: &[LinearReadout],
        perturbation: Option<&[[f64; 2]]>,
        outputs: &mut [f64],
        lengths: &mut [f64],
    ) -> Result<(), (usize, DomainError)> {
        let width = self.observation_len();
        let said = 2 * readouts.len();
        let steps = outputs.len() / said;
        assert!([width, 2 * width].contains(&(said - 2)), "a muscle for every spring, or two");
        assert_eq!(lengths.len(), steps * width, "room for the lengths of every step");
        assert!(readouts.iter().all(|readout| readout.weights.len() == width), "all springs");
        assert!(perturbation.is_none_or(|rows| rows.len() == steps), "one row a step");
        let mut now = self.lengths();
        let rows = outputs.chunks_exact_mut(said).zip(lengths.chunks_exact_mut(width));
        for (step, (output, row)) in rows.enumerate() {
            for (readout, pair) in readouts.iter().zip(output.chunks_exact_mut(2)) {
                pair.copy_from_slice(&readout.output(&now));
            }
            let push = perturbation.map_or([0.0; 2], |rows| rows[step]);
            let command = [output[0] + push[0], output[1] + push[1]];
            let before = self.muscles();
            let (along, across) = output[2..].split_at(width);
            let across = if across.is_empty() { &before.1 } else { across };
            // Inputs that are not finite end the run as a command does that is not.
            let pulled = self.set_muscles(along, across).is_ok();
            if let Err(failure) = self.step(if pulled { command } else { [f64::NAN; 2] }) {
                let restored = self.set_muscles(&before.0, &before.1);
                debug_assert!(restored.is_ok(), "inputs that were there");
                return Err((step, failure));
            }
            self.lengths_into(row);
            now.copy_from_slice(row);
        }
        Ok(())
    }
}

/// Whether a command in degrees can be followed at all.
///
/// # Errors
/// [`ParameterError::OutOfRange`] naming the angle.
pub fn check_command(command: [f64; 2]) -> Result<(), ParameterError> {
    const ANGLE: Interval = Interval::within(COMMAND_LIMIT).of("degrees");
    ANGLE.check(command[0], || "theta".to_owned())?;
    ANGLE.check(command[1], || "phi".to_owned())
}
