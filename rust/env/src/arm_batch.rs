//! Many arms at once without episodes: runs in open and closed loop.

use octoarm_arm::{Arm, ArmLanes, ArmState, DomainError, LinearReadout, ParameterError};

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
struct Errand<'a> {
    lanes: &'a mut ArmLanes,
    first: usize,
    steps: std::ops::Range<usize>,
    stride: usize,
    stops: &'a mut [Option<Stop>],
    /// What the readouts say, an entry a step; empty in open loop.
    outputs: Vec<&'a mut [[f64; 2]]>,
    lengths: Vec<&'a mut [f64]>,
}

impl Errand<'_> {
    /// Runs the group: `command(arm, step, lengths)` gives the command and what to note as output; in
    /// open loop the lengths are those at the start.
    fn run(mut self, command: &(impl Fn(usize, usize, &[f64]) -> ([f64; 2], [f64; 2]) + Sync)) {
        let (count, width) = (self.lanes.len(), self.lanes.observation_len());
        let mut now = vec![0.0; count * width];
        for (lane, row) in now.chunks_exact_mut(width).enumerate() {
            self.lanes.lengths_into(lane, row);
        }
        let mut commands = [[0.0; 2]; WIDTH];
        let mut moves = [false; WIDTH];
        for step in self.steps.clone() {
            for (lane, row) in now.chunks_exact(width).enumerate() {
                moves[lane] = self.stops[lane].is_none();
                let (angles, output) = command(self.first + lane, step, row);
                commands[lane] = angles;
                if let Some(outputs) = self.outputs.get_mut(lane) {
                    outputs[step - self.steps.start] = output;
                }
            }
            if !self.lanes.step(&commands, &moves) {
                for lane in 0..count {
                    if moves[lane] {
                        self.stops[lane] = self.lanes.failure(lane).map(|failure| (step, failure));
                    }
                }
            }
            for (lane, _) in self.outputs.iter().enumerate() {
                self.lanes.lengths_into(lane, &mut now[lane * width..(lane + 1) * width]);
            }
            if (step + 1) % self.stride == 0 {
                let row = (step / self.stride - self.steps.start / self.stride) * width;
                for (lane, rows) in self.lengths.iter_mut().enumerate() {
                    self.lanes.lengths_into(lane, &mut rows[row..row + width]);
                }
            }
        }
    }
}

impl ArmBatch {
    /// Takes copies of the arms. `threads` share the work, the calling one included; without a
    /// number, as many as the processor runs at once.
    ///
    /// # Errors
    /// [`ParameterError`] for no arms, different numbers of compartments, or no threads.
    pub fn new(arms: &[&Arm], threads: Option<usize>) -> Result<Self, ParameterError> {
        let workers = Workers::new(threads)?;
        let Some(first) = arms.first() else {
            // The message of a group without arms.
            return ArmLanes::new(&[]).map(|_| Self { groups: Vec::new(), count: 0, workers });
        };
        let compartments = first.parameters().compartments;
        if let Some(other) = arms.iter().find(|arm| arm.parameters().compartments != compartments) {
            return Err(ParameterError::OutOfRange {
                name: "compartments".to_owned(),
                value: other.parameters().compartments.to_string(),
                range: format!("{compartments}, as the first arm's"),
            });
        }
        let groups = arms.chunks(WIDTH).map(ArmLanes::new).collect::<Result<_, _>>()?;
        Ok(Self { groups, count: arms.len(), workers })
    }

    /// Number of arms.
    #[must_use]
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.count
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

    /// Restores an arm's state exactly.
    ///
    /// # Errors
    /// As [`Arm::set_state`]; the arm is then unchanged.
    pub fn set_state(&mut self, arm: usize, state: &ArmState) -> Result<(), ParameterError> {
        self.groups[arm / WIDTH].set_state(arm % WIDTH, state)
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
        steps: std::ops::Range<usize>,
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
        steps: std::ops::Range<usize>,
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
        steps: std::ops::Range<usize>,
        stride: usize,
        outputs: Vec<&mut [[f64; 2]]>,
        lengths: Vec<&mut [f64]>,
        stops: &mut [Option<Stop>],
    ) {
        assert_eq!(lengths.len(), self.count, "lengths of every arm");
        assert_eq!(stops.len(), self.count, "a stop for every arm");
        let (mut outputs, mut lengths) = (outputs.into_iter(), lengths.into_iter());
        let errands: Vec<Errand<'_>> = self
            .groups
            .iter_mut()
            .zip(stops.chunks_mut(WIDTH))
            .enumerate()
            .map(|(index, (lanes, stops))| Errand {
                outputs: outputs.by_ref().take(lanes.len()).collect(),
                lengths: lengths.by_ref().take(lanes.len()).collect(),
                lanes,
                first: index * WIDTH,
                steps: steps.clone(),
                stride,
                stops,
            })
            .collect();
        self.workers.for_each(errands, |errand| errand.run(command));
    }
}
