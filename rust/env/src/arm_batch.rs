//! Many arms at once: eight in the lanes of a group, the groups shared by threads; and their runs in
//! open and closed loop.

use std::ops::Range;

use octoarm_arm::{
    Arm, ArmLanes, ArmParameters, ArmState, DomainError, LinearReadout, ParameterError,
    check_finite, memory, poll,
};

use crate::workers::Workers;

const WIDTH: usize = ArmLanes::WIDTH;

/// Where and why an arm's run ended early: the index of the step that was not made, and the reason.
pub type Stop = (usize, DomainError);

/// Arms of any parameters and actuators, all with the same number of compartments, each with the
/// bits that it has alone.
#[derive(Debug)]
pub struct ArmBatch {
    groups: Vec<ArmLanes>,
    count: usize,
    workers: Workers,
}

/// One group's share of a run.
struct GroupRun<'a> {
    first: usize,
    stops: &'a mut [Option<Stop>],
    /// What the readouts say, an entry a step; empty in open loop.
    outputs: Vec<&'a mut [[f64; 2]]>,
    lengths: Vec<&'a mut [f64]>,
}

impl GroupRun<'_> {
    /// Runs the group: `command(arm, step, lengths)` gives the command and what to note as output; in
    /// open loop the lengths are those at the start.
    fn run(
        mut self,
        lanes: &mut ArmLanes,
        steps: Range<usize>,
        stride: usize,
        command: &(impl Fn(usize, usize, &[f64]) -> ([f64; 2], [f64; 2]) + Sync),
    ) {
        let (count, width) = (lanes.len(), lanes.observation_len());
        let mut now = vec![0.0; count * width];
        for (lane, row) in now.chunks_exact_mut(width).enumerate() {
            lanes.lengths_into(lane, row);
        }
        let mut commands = [[0.0; 2]; WIDTH];
        let mut moves = [false; WIDTH];
        for step in steps.clone() {
            for (lane, row) in now.chunks_exact(width).enumerate() {
                moves[lane] = self.stops[lane].is_none();
                let (angles, output) = command(self.first + lane, step, row);
                commands[lane] = angles;
                if let Some(outputs) = self.outputs.get_mut(lane) {
                    outputs[step - steps.start] = output;
                }
            }
            if !lanes.step(&commands, &moves) {
                for lane in 0..count {
                    if moves[lane] {
                        self.stops[lane] = lanes.failure(lane).map(|failure| (step, failure));
                    }
                }
            }
            for (lane, _) in self.outputs.iter().enumerate() {
                lanes.lengths_into(lane, &mut now[lane * width..(lane + 1) * width]);
            }
            if (step + 1) % stride == 0 {
                let row = (step / stride - steps.start / stride) * width;
                for (lane, rows) in self.lengths.iter_mut().enumerate() {
                    lanes.lengths_into(lane, &mut rows[row..row + width]);
                }
            }
        }
    }
}

impl ArmBatch {
    /// Takes copies of the arms. At most `threads` share the work, the calling one included; without a
    /// number, as many as the processor runs at once. The others are the process's, one fewer than threads
    /// that the processor runs at once, shared by all batches; or, if the calling thread is one of a rayon
    /// pool, the others of that pool.
    ///
    /// # Errors
    /// [`ParameterError`] for no arms, different numbers of compartments, no threads, or more arms
    /// than fit into memory; [`ParameterError::Interrupted`].
    pub fn new(arms: &[&Arm], threads: Option<usize>) -> Result<Self, ParameterError> {
        let workers = Workers::new(threads)?;
        let compartments = arms.first().map_or(0, |arm| arm.parameters().compartments);
        // A group checks its own arms; here the message of one with no arms, or different ones.
        match arms.iter().find(|arm| arm.parameters().compartments != compartments) {
            Some(other) => ArmLanes::new(&[arms[0], other]).map(|_| ())?,
            None if arms.is_empty() => ArmLanes::new(arms).map(|_| ())?,
            None => {}
        }
        let count = arms.len().div_ceil(WIDTH);
        let bytes = count.checked_mul(ArmLanes::bytes(compartments));
        memory::check_room::<u8>(&format!("{} arms", arms.len()), bytes)?;
        let mut groups = Vec::with_capacity(count);
        for group in arms.chunks(WIDTH) {
            poll()?;
            groups.push(ArmLanes::new(group)?);
        }
        Ok(Self { groups, count: arms.len(), workers })
    }

    /// Number of arms.
    #[must_use]
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.count
    }

    /// An arm's parameters.
    #[must_use]
    pub fn parameters(&self, arm: usize) -> &ArmParameters {
        self.groups[arm / WIDTH].parameters(arm % WIDTH)
    }

    /// The group of an arm, and its lane there.
    pub(crate) fn place_of(&self, arm: usize) -> (&ArmLanes, usize) {
        (&self.groups[arm / WIDTH], arm % WIDTH)
    }

    /// Number of threads that share the work.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.workers.threads()
    }

    /// Number of spring lengths of an arm.
    #[must_use]
    pub fn observation_len(&self) -> usize {
        self.groups[0].observation_len()
    }

    /// An arm's complete state.
    #[must_use]
    pub fn state(&self, arm: usize) -> ArmState {
        self.groups[arm / WIDTH].state(arm % WIDTH)
    }

    /// All arms' complete states.
    #[must_use]
    pub fn states(&self) -> Vec<ArmState> {
        (0..self.count).map(|arm| self.state(arm)).collect()
    }

    /// Restores the states of all arms exactly.
    ///
    /// # Errors
    /// [`ParameterError`] for another number of states, or as [`Arm::set_state`]; no arm is changed
    /// then.
    pub fn set_states<'a>(
        &mut self,
        states: impl ExactSizeIterator<Item = &'a ArmState>,
    ) -> Result<(), ParameterError> {
        check_len("states", states.len(), self.count)?;
        let before = self.states();
        for (arm, state) in states.enumerate() {
            if let Err(error) = self.groups[arm / WIDTH].set_state(arm % WIDTH, state) {
                for (arm, state) in before[..arm].iter().enumerate() {
                    self.groups[arm / WIDTH].restore(&[(arm % WIDTH, state)]);
                }
                return Err(error);
            }
        }
        Ok(())
    }

    /// [`ArmBatch::set_states`] with the bodies of other arms, with as many compartments as these.
    ///
    /// # Errors
    /// As [`ArmBatch::set_states`]; no arm is changed then.
    pub(crate) fn set_arms<'a>(
        &mut self,
        bodies: &[&Arm],
        states: impl ExactSizeIterator<Item = &'a ArmState>,
    ) -> Result<(), ParameterError> {
        let before = self.groups.clone();
        for (arm, body) in bodies.iter().enumerate() {
            self.groups[arm / WIDTH].place(&[(arm % WIDTH, body, &body.state())]);
        }
        self.set_states(states).inspect_err(|_| self.groups = before)
    }

    /// The muscle inputs ξ_c and δ_c \[N\] of all arms, each in observation order.
    #[must_use]
    pub fn muscles(&self) -> (Vec<f64>, Vec<f64>) {
        let all = (0..self.count).map(|arm| self.groups[arm / WIDTH].muscles(arm % WIDTH));
        let (longitudinal, transverse): (Vec<_>, Vec<_>) = all.unzip();
        (longitudinal.concat(), transverse.concat())
    }

    /// Sets the muscle inputs ξ_c and δ_c \[N\] of all arms, as [`Arm::set_muscles`] does of one; they act
    /// until changed.
    ///
    /// # Errors
    /// [`ParameterError`] for slices of another length or numbers that are not finite; no arm is changed
    /// then.
    pub fn set_muscles(
        &mut self,
        longitudinal: &[f64],
        transverse: &[f64],
    ) -> Result<(), ParameterError> {
        let width = self.observation_len();
        for (name, values) in [("longitudinal", longitudinal), ("transverse", transverse)] {
            check_len(name, values.len(), self.count * width)?;
            for (index, value) in values.iter().enumerate() {
                check_finite(*value, || {
                    let (arm, spring) = (index / width, index % width);
                    format!("{name}[{arm}, {}, {}]", spring / 4, spring % 4)
                })?;
            }
        }
        let rows = longitudinal.chunks_exact(width).zip(transverse.chunks_exact(width));
        for (arm, (longitudinal, transverse)) in rows.enumerate() {
            self.groups[arm / WIDTH].set_muscles(arm % WIDTH, longitudinal, transverse)?;
        }
        Ok(())
    }

    /// The base angles θ, φ of an arm \[degrees\].
    #[must_use]
    pub fn base_degrees(&self, arm: usize) -> [f64; 2] {
        self.groups[arm / WIDTH].base_degrees(arm % WIDTH)
    }

    /// Spring lengths \[m\] of all arms.
    #[must_use]
    pub fn lengths(&self) -> Vec<f64> {
        let width = self.observation_len();
        let mut lengths = vec![0.0; self.count * width];
        for (arm, row) in lengths.chunks_exact_mut(width).enumerate() {
            self.groups[arm / WIDTH].lengths_into(arm % WIDTH, row);
        }
        lengths
    }

    /// Does `work` with every group of eight arms from the `first` on and its piece, for as many as there
    /// are pieces; threads share the groups.
    pub(crate) fn for_each_group<T: Send>(
        &mut self,
        first: usize,
        pieces: impl Iterator<Item = T>,
        work: impl Fn(&mut ArmLanes, T) + Sync,
    ) {
        let groups = self.groups.iter_mut().skip(first).zip(pieces).collect();
        self.workers.for_each(groups, |(lanes, piece)| work(lanes, piece));
    }

    /// Every arm follows its commands \[degrees\] in these steps of the run that the commands are for;
    /// the lengths after every `stride`-th step of that run go to that arm's entry of `lengths`, those
    /// of the first such step to its begin. An arm with a stop in `stops` stands still; one whose step
    /// would leave the domain gets one, and stands still from there, its lengths repeated.
    ///
    /// # Panics
    /// If the numbers of entries do not fit, or `stride` is 0.
    pub fn run(
        &mut self,
        commands: &[&[[f64; 2]]],
        steps: Range<usize>,
        stride: usize,
        lengths: Vec<&mut [f64]>,
        stops: &mut [Option<Stop>],
    ) {
        assert_eq!(commands.len(), self.count, "commands of every arm");
        let command = |arm: usize, step: usize, _: &[f64]| (commands[arm][step], [0.0; 2]);
        self.run_with(&command, steps, stride, Vec::new(), lengths, stops);
    }

    /// Closes every arm's loop through its readout (Eqs. 24–26), as [`Arm::run_closed_loop`] does, in
    /// these steps of the run that the perturbations are for; what the readouts say in them goes to
    /// `outputs`. Lengths and stops are as in [`ArmBatch::run`].
    ///
    /// # Panics
    /// If the numbers of entries do not fit, or `stride` is 0.
    #[allow(clippy::too_many_arguments)] // A block of a run needs all that the run has.
    pub fn run_closed_loop(
        &mut self,
        readouts: &[&LinearReadout],
        perturbations: Option<&[&[[f64; 2]]]>,
        steps: Range<usize>,
        stride: usize,
        outputs: Vec<&mut [[f64; 2]]>,
        lengths: Vec<&mut [f64]>,
        stops: &mut [Option<Stop>],
    ) {
        assert_eq!(readouts.len(), self.count, "a readout for every arm");
        assert_eq!(outputs.len(), self.count, "outputs of every arm");
        let command = |arm: usize, step: usize, lengths: &[f64]| {
            let said = readouts[arm].output(lengths);
            let push = perturbations.map_or([0.0; 2], |rows| rows[arm][step]);
            ([said[0] + push[0], said[1] + push[1]], said)
        };
        self.run_with(&command, steps, stride, outputs, lengths, stops);
    }

    fn run_with(
        &mut self,
        command: &(impl Fn(usize, usize, &[f64]) -> ([f64; 2], [f64; 2]) + Sync),
        steps: Range<usize>,
        stride: usize,
        outputs: Vec<&mut [[f64; 2]]>,
        lengths: Vec<&mut [f64]>,
        stops: &mut [Option<Stop>],
    ) {
        assert_eq!(lengths.len(), self.count, "lengths of every arm");
        assert_eq!(stops.len(), self.count, "a stop for every arm");
        let (mut outputs, mut lengths) = (outputs.into_iter(), lengths.into_iter());
        let runs = stops.chunks_mut(WIDTH).enumerate().map(|(index, stops)| GroupRun {
            first: index * WIDTH,
            outputs: outputs.by_ref().take(stops.len()).collect(),
            lengths: lengths.by_ref().take(stops.len()).collect(),
            stops,
        });
        self.for_each_group(0, runs, |lanes, run| run.run(lanes, steps.clone(), stride, command));
    }
}

/// Refuses another number of entries than there are arms.
pub(crate) fn check_len(name: &str, found: usize, count: usize) -> Result<(), ParameterError> {
    if found == count {
        return Ok(());
    }
    Err(ParameterError::shape(name, format!("({found},)"), format!("({count},)")))
}
