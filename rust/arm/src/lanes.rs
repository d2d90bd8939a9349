//! Arms in the lanes of vector registers: everything that is done to an arm, for `L` of them at once.

use std::sync::Arc;

use crate::base::{Actuator, BaseDrive, BaseMotion, BaseRows};
use crate::domain::{DomainError, find_failure};
use crate::error::{ParameterError, check_finite};
use crate::instruction_set::Supported;
use crate::interval::Interval;
use crate::kernel::{Muscles, place};
use crate::parameters::ArmParameters;
use crate::runge_kutta::{Integrator, advance, refresh};
use crate::state::{ArmState, COORDINATES, MuscleRow};

/// `L` arms with the same number of compartments, each with its own parameters and actuator.
#[derive(Clone, Debug)]
pub(crate) struct Lanes<const L: usize> {
    parameters: [Arc<ArmParameters>; L],
    drive: BaseDrive<L>,
    integrator: Integrator<L>,
    pub(crate) instructions: Supported,
    base: [[f64; L]; 4],
    steps: [u64; L],
    failures: [Option<DomainError>; L],
}

impl<const L: usize> Lanes<L> {
    /// Arms at rest with every spring at its rest length. The parameters must be valid.
    pub(crate) fn new(
        parameters: [Arc<ArmParameters>; L],
        actuators: [Actuator; L],
        instructions: Supported,
    ) -> Self {
        let arms = std::array::from_fn(|lane| &*parameters[lane]);
        Self {
            drive: BaseDrive::new(&std::array::from_fn(|lane| (arms[lane], actuators[lane]))),
            integrator: Integrator::new(&arms),
            instructions,
            base: [[0.0; L]; 4],
            steps: [0; L],
            failures: [None; L],
            parameters,
        }
    }

    pub(crate) fn parameters(&self, lane: usize) -> &Arc<ArmParameters> {
        &self.parameters[lane]
    }

    pub(crate) fn actuator(&self, lane: usize) -> Actuator {
        self.drive.actuator(lane)
    }

    /// Takes the body and the actuator of another arm; the state of the lane must be restored next.
    pub(crate) fn set_body(&mut self, lane: usize, arm: &Lanes<1>) {
        let same = Arc::ptr_eq(arm.parameters(0), self.parameters(lane));
        if !same || arm.actuator(0) != self.actuator(lane) {
            self.parameters[lane] = Arc::clone(arm.parameters(0));
            self.drive.set_lane(lane, &arm.drive);
            self.integrator.set_body(lane, &arm.integrator);
        }
    }

    fn compartments(&self) -> usize {
        self.parameters[0].compartments
    }

    /// Number of spring lengths of an arm.
    pub(crate) fn observation_len(&self) -> usize {
        4 * self.compartments()
    }

    pub(crate) fn steps(&self, lane: usize) -> u64 {
        self.steps[lane]
    }

    /// `[θ, φ, θ̇, φ̇]` \[rad, rad/s\].
    pub(crate) fn base(&self, lane: usize) -> [f64; 4] {
        self.base.map(|row| row[lane])
    }

    pub(crate) fn state(&self, lane: usize) -> ArmState {
        let read = |entry: &dyn Fn(usize, usize) -> f64| {
            (0..self.compartments())
                .map(|j| std::array::from_fn(|index| entry(j, index)))
                .collect::<Vec<[f64; COORDINATES]>>()
        };
        ArmState {
            coordinates: read(&|j, index| self.integrator.coordinate(lane, j, index)),
            rates: read(&|j, index| self.integrator.rate(lane, j, index)),
            base: self.base(lane),
            steps: self.steps[lane],
            muscles: self.muscle_rows(lane),
        }
    }

    /// Puts a lane into a state that is known to be valid.
    pub(crate) fn restore(&mut self, lane: usize, state: &ArmState) {
        self.restore_many(&[(lane, state)]);
    }

    /// [`Lanes::restore`] of several lanes: the spring lengths of all are computed once.
    pub(crate) fn restore_many(&mut self, states: &[(usize, &ArmState)]) {
        // All of them are asked for before the first is needed: from far away they come side by side.
        let rows =
            states.iter().flat_map(|(_, state)| state.coordinates.iter().chain(&state.rates));
        std::hint::black_box(rows.map(|row| row[0]).sum::<f64>());
        for (lane, state) in states {
            self.integrator.set_state(*lane, &state.coordinates, &state.rates);
            for (row, value) in self.base.iter_mut().zip(state.base) {
                row[*lane] = value;
            }
            self.steps[*lane] = state.steps;
            for j in 0..self.compartments() {
                self.set_muscle_row(*lane, j, state.muscles.get(j).unwrap_or(&[0.0; 8]));
            }
        }
        refresh(self.instructions, &mut self.integrator, ());
    }

    /// Puts a lane into a state, which is checked.
    pub(crate) fn set_state(
        &mut self,
        lane: usize,
        state: &ArmState,
    ) -> Result<(), ParameterError> {
        state.validate(self.compartments())?;
        let before = self.state(lane);
        self.restore(lane, state);
        if let Some(failure) = self.present_failure(lane) {
            self.restore(lane, &before);
            let DomainError { limit, compartment, value, low, high, .. } = failure;
            let name = format!("state: {} of compartment {compartment}", limit.name());
            let range = Interval::closed(low, high);
            return Err(ParameterError::out_of_range(name, value, range));
        }
        Ok(())
    }

    fn set_muscle_row(&mut self, lane: usize, j: usize, row: &MuscleRow) {
        let (chunk, slot) = place::<L>(j);
        let Muscles { longitudinal: xi, transverse: delta } = &mut self.integrator.muscles[chunk];
        for i in 0..4 {
            xi[i][slot + lane] = row[i];
            delta[i][slot + lane] = row[4 + i];
        }
    }

    /// Muscle inputs of every compartment; none where all are zero.
    fn muscle_rows(&self, lane: usize) -> Vec<MuscleRow> {
        let row = |j| -> MuscleRow {
            let (chunk, slot) = place::<L>(j);
            let Muscles { longitudinal: xi, transverse: delta } = &self.integrator.muscles[chunk];
            std::array::from_fn(|i| if i < 4 { xi[i] } else { delta[i - 4] }[slot + lane])
        };
        let rows: Vec<MuscleRow> = (0..self.compartments()).map(row).collect();
        if rows.iter().flatten().all(|value| value.to_bits() == 0) { Vec::new() } else { rows }
    }

    /// Sets ξ_c and δ_c of an arm's springs \[N\], in observation order.
    pub(crate) fn set_muscles(
        &mut self,
        lane: usize,
        longitudinal: &[f64],
        transverse: &[f64],
    ) -> Result<(), ParameterError> {
        for (name, values) in [("longitudinal", longitudinal), ("transverse", transverse)] {
            if values.len() != self.observation_len() {
                let shape = |len| format!("({len},)");
                let (found, expected) = (shape(values.len()), shape(self.observation_len()));
                return Err(ParameterError::shape(name, found, expected));
            }
            for (index, value) in values.iter().enumerate() {
                check_finite(*value, || format!("{name}[{}, {}]", index / 4, index % 4))?;
            }
        }
        for j in 0..self.compartments() {
            let of =
                |i: usize| if i < 4 { longitudinal[4 * j + i] } else { transverse[4 * j + i - 4] };
            self.set_muscle_row(lane, j, &std::array::from_fn(of));
        }
        Ok(())
    }

    /// ξ_c and δ_c of an arm's springs \[N\], in observation order.
    pub(crate) fn muscles(&self, lane: usize) -> (Vec<f64>, Vec<f64>) {
        (0..self.compartments())
            .flat_map(|j| (0..4).map(move |i| (j, i)))
            .map(|(j, i)| {
                let (chunk, slot) = place::<L>(j);
                let muscles = &self.integrator.muscles[chunk];
                (muscles.longitudinal[i][slot + lane], muscles.transverse[i][slot + lane])
            })
            .unzip()
    }

    /// Writes an arm's spring lengths in observation order.
    pub(crate) fn lengths_into(&self, lane: usize, out: &mut [f64]) {
        self.integrator.lengths_into(lane, &mut out[..self.observation_len()]);
    }

    /// The bases' motion over the next step under commands in degrees: start, middle and end.
    pub(crate) fn motion(&self, commands: &[[f64; 2]; L]) -> [BaseRows<L>; 3] {
        let rows = [0, 1].map(|axis| std::array::from_fn(|lane| commands[lane][axis].to_radians()));
        self.drive.motion(&self.base, &rows)
    }

    /// One physics step of the active lanes. A lane whose step would leave the domain keeps its state;
    /// the others go on. Returns whether all active lanes made their step; if not,
    /// [`Lanes::failure`] says why.
    pub(crate) fn step(&mut self, commands: &[[f64; 2]; L], active: &[bool; L]) -> bool {
        let motion = self.motion(commands);
        let inside = advance(self.instructions, &mut self.integrator, &motion);
        let mut made = *active;
        let complete = (0..L).all(|lane| inside[lane] || !active[lane]) || {
            for lane in 0..L {
                // Within rounding of a limit the check in words finds nothing wrong.
                self.failures[lane] =
                    if active[lane] && !inside[lane] { self.refusal(lane) } else { None };
                made[lane] &= self.failures[lane].is_none();
            }
            made == *active
        };
        self.integrator.accept_lanes(&made);
        let end = motion[2].state();
        for lane in 0..L {
            if made[lane] {
                for (row, end) in self.base.iter_mut().zip(&end) {
                    row[lane] = end[lane];
                }
                self.steps[lane] = self.steps[lane].saturating_add(1);
            }
        }
        complete
    }

    /// Why the lane was refused in the last step that was not complete; none if it was not.
    pub(crate) fn failure(&self, lane: usize) -> Option<DomainError> {
        self.failures[lane]
    }

    /// The limit that the lane's present state passes.
    pub(crate) fn present_failure(&self, lane: usize) -> Option<DomainError> {
        self.find_failure(
            lane,
            |j, index| self.integrator.coordinate(lane, j, index),
            |j, index| self.integrator.rate(lane, j, index),
            |j, i| self.integrator.length(lane, j, i),
        )
    }

    fn refusal(&self, lane: usize) -> Option<DomainError> {
        self.find_failure(
            lane,
            |j, index| self.integrator.refused(lane, j).0[index],
            |j, index| self.integrator.refused(lane, j).1[index],
            |j, i| self.integrator.refused(lane, j).2[i],
        )
    }

    fn find_failure(
        &self,
        lane: usize,
        coordinate: impl Fn(usize, usize) -> f64,
        rate: impl Fn(usize, usize) -> f64,
        length: impl Fn(usize, usize) -> f64,
    ) -> Option<DomainError> {
        let parameters = &self.parameters[lane];
        let time = (self.steps[lane] as f64 + 1.0) * parameters.timestep;
        find_failure(parameters, coordinate, rate, length, time)
    }
}

impl Lanes<1> {
    pub(crate) fn accelerations(&mut self, base: &BaseMotion) -> Vec<[f64; COORDINATES]> {
        self.integrator.accelerations(self.instructions, base)
    }
}
