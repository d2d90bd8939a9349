//! The swing that the teacher keeps an arm in: where episodes begin.
//!
//! A readout has no clock of its own: it keeps whatever phase its body starts with. So an episode must
//! begin with the body already swinging in phase with the target. A swing is a run of the arm forced
//! by the lead-compensated clock, with a snapshot of the whole state at every control instant.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use octoarm_arm::{
    Actuator, Arm, ArmLanes, ArmParameters, ArmState, COORDINATES, DomainError, MuscleRow,
    ParameterError, poll,
};

use crate::config::{CheckedConfig, EpisodeConfig};
use crate::control::control_step_of_lanes;
use crate::orbit::{Orbit, Target};
use crate::teacher::TeacherClock;

/// Time in which the command grows from rest to the full orbit \[s\].
const RAMP: f64 = 1.0;
/// Time after the ramp in which the body forgets how it got there \[s\].
const SETTLE: f64 = 12.0;
/// Snapshots of a swing, one a control period.
const SNAPSHOTS: usize = 256;
/// Configurations whose swings are kept for environments that will be made later.
const KEPT: usize = 8;
/// Bodies that swing side by side.
const WIDTH: usize = ArmLanes::WIDTH;

/// Where an episode may begin.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// State of the arm, on the orbit and in phase.
    pub arm: ArmState,
    /// Base of the undisturbed clock, `[θ, φ, θ̇, φ̇]` \[degrees, degrees/s\].
    pub undisturbed: [f64; 4],
    /// Command that led here \[degrees\].
    pub command: [f64; 2],
}

/// An arm kept on its orbit by the teacher, with a snapshot at every control instant.
#[derive(Clone, Debug)]
pub struct Swing {
    /// Orbit that is followed.
    pub orbit: Arc<Orbit>,
    /// Clock that forces the arm along it.
    pub clock: TeacherClock,
    /// State at instants 0, 1, 2, … of the clock, a control period apart.
    pub snapshots: Vec<Snapshot>,
    /// An arm of this body at rest, to be cloned.
    pub arm: Arm,
}

/// Smooth growth from 0 to 1 with two continuous derivatives.
fn ramp(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (x * (6.0 * x - 15.0) + 10.0)
}

/// The refusal of a target that takes the arm out of its domain.
fn unable(
    config: &EpisodeConfig,
    orbit: &Orbit,
    body: usize,
    failure: &DomainError,
) -> ParameterError {
    let (name, value) = match &config.target {
        Target::Named(_) => ("amplitude", orbit.amplitude().to_string()),
        Target::Samples(rows) => (
            "target",
            format!(
                "{} rows of up to {} degrees, one a physics step of {} s, so a period of {} s",
                rows.len(),
                orbit.amplitude(),
                config.arm.timestep,
                orbit.period()
            ),
        ),
    };
    let which = if config.vary.is_empty() {
        "this body".to_owned()
    } else {
        format!("body {body} of those that are drawn (vary, body_seed)")
    };
    let range = format!("of targets that {which} can be swung along: {failure}");
    ParameterError::out_of_range(name, value, range)
}

/// What swings depend on.
#[derive(PartialEq)]
struct Key {
    target: Target,
    amplitude: Option<f64>,
    control_period: f64,
    actuator: Actuator,
    bodies: Vec<ArmParameters>,
}

impl Key {
    fn of(config: &CheckedConfig) -> Self {
        Self {
            target: config.target.clone(),
            amplitude: config.amplitude,
            control_period: config.control_period,
            actuator: config.actuator,
            bodies: config.drawn_bodies().to_vec(),
        }
    }
}

/// The swings of a configuration, one a body.
pub type Swings = Arc<[Swing]>;

/// The swings that are kept, those that were asked for last at the end.
fn shared() -> MutexGuard<'static, Vec<(Key, Swings)>> {
    static SHARED: Mutex<Vec<(Key, Swings)>> = Mutex::new(Vec::new());
    SHARED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Control periods before the first snapshot.
fn lead_in(config: &EpisodeConfig) -> f64 {
    ((RAMP + SETTLE) / config.control_period).ceil()
}

impl Swing {
    /// Physics steps that the swings of valid settings take: those of one body for each.
    #[must_use]
    pub fn physics_steps(config: &EpisodeConfig) -> f64 {
        let periods = lead_in(config) + SNAPSHOTS as f64 - 1.0;
        periods * f64::from(config.physics_steps()) * config.bodies as f64
    }

    /// Memory that the swings of valid settings take, with the settings themselves, rounded up \[bytes\].
    #[must_use]
    pub fn bytes(config: &EpisodeConfig) -> usize {
        let compartments = config.arm.compartments;
        // Coordinates, rates and muscle inputs of every compartment.
        let state = 2 * size_of::<[f64; COORDINATES]>() + size_of::<MuscleRow>();
        let snapshot = size_of::<Snapshot>() + 64 + compartments.saturating_mul(state);
        // The samples of the settings, those of the list of swings, and the orbit.
        let rows = match &config.target {
            Target::Named(_) => 2048,
            Target::Samples(rows) => 3 * rows.len(),
        };
        SNAPSHOTS
            .saturating_mul(snapshot)
            .saturating_add(ArmLanes::bytes(compartments))
            .saturating_mul(config.bodies)
            .saturating_add(rows.saturating_mul(size_of::<[f64; 2]>()))
    }

    /// The swings of a configuration, if they are kept from before.
    #[must_use]
    pub fn kept(config: &CheckedConfig) -> Option<Swings> {
        let key = Key::of(config);
        let mut shared = shared();
        let at = shared.iter().position(|(known, _)| *known == key)?;
        let entry = shared.remove(at);
        let swings = Arc::clone(&entry.1);
        shared.push(entry);
        Some(swings)
    }

    /// The swings of a configuration; computed once, then shared by every environment that asks.
    ///
    /// # Errors
    /// [`ParameterError`] for a body without a rest state, or a target that takes an arm out of its
    /// domain.
    pub fn shared(config: &CheckedConfig) -> Result<Swings, ParameterError> {
        if let Some(swings) = Self::kept(config) {
            return Ok(swings);
        }
        let mut run = SwingRun::new(config)?;
        while run.advance()? {}
        Ok(run.keep())
    }
}

/// Swings in the making, a control period of eight bodies at a time, so that others can have their turn
/// in between.
#[derive(Debug)]
pub struct SwingRun {
    config: CheckedConfig,
    /// Those that are done, and those under way, whose snapshots are fewer.
    swings: Vec<Swing>,
    /// The bodies under way, the last ones of the swings.
    lanes: Option<ArmLanes>,
    orbit: Arc<Orbit>,
    clock: TeacherClock,
    lead_in: i64,
    tick: i64,
    base: [f64; 4],
}

impl SwingRun {
    /// The first arm at rest.
    ///
    /// # Errors
    /// [`ParameterError`] for a body without a rest state.
    pub fn new(config: &CheckedConfig) -> Result<Self, ParameterError> {
        let orbit = Arc::new(config.orbit()?);
        let mut run = Self {
            config: config.clone(),
            swings: Vec::with_capacity(config.bodies),
            lanes: None,
            clock: TeacherClock::new(config, Arc::clone(&orbit)),
            orbit,
            lead_in: lead_in(config) as i64,
            tick: 0,
            base: [0.0; 4],
        };
        run.rest_next()?;
        Ok(run)
    }

    /// The next body comes to rest.
    fn rest_next(&mut self) -> Result<(), ParameterError> {
        let body = self.config.drawn_bodies()[self.swings.len()].clone();
        let mut arm = Arm::undeformed(body, self.config.actuator)?;
        arm.reset()?;
        self.swings.push(Swing {
            orbit: Arc::clone(&self.orbit),
            clock: self.clock.clone(),
            snapshots: Vec::with_capacity(SNAPSHOTS),
            arm,
        });
        Ok(())
    }

    /// Goes on by a control period, or brings another body to rest; false when there is nothing left.
    ///
    /// # Errors
    /// [`ParameterError`] for a body without a rest state, or a target that takes an arm out of its
    /// domain.
    pub fn advance(&mut self) -> Result<bool, ParameterError> {
        let (known, bodies) = (self.swings.len(), self.config.bodies);
        let first = (known - 1) / WIDTH * WIDTH;
        let Some(lanes) = &mut self.lanes else {
            let swung = self.swings[known - 1].snapshots.len() == SNAPSHOTS;
            if swung && known == bodies {
                return Ok(false);
            }
            if known < bodies && (swung || known < first + WIDTH) {
                self.rest_next()?;
                return Ok(true);
            }
            let arms: Vec<&Arm> = self.swings[first..].iter().map(|swing| &swing.arm).collect();
            self.lanes = Some(ArmLanes::new(&arms)?);
            (self.tick, self.base) = (-self.lead_in, [0.0; 4]);
            return Ok(true);
        };
        if self.tick < SNAPSHOTS as i64 - 1 {
            poll()?;
            let config = &self.config;
            let elapsed = (self.tick + 1 + self.lead_in) as f64 * config.control_period;
            let goal = self.clock.target(self.tick + 1).map(|angle| angle * ramp(elapsed / RAMP));
            let (command, end) = self.clock.command_towards(goal, self.base);
            let mut steps = [0; WIDTH];
            steps[..lanes.len()].fill(config.physics_steps());
            let failures = control_step_of_lanes(lanes, &[command; WIDTH], &steps, |_, _| ());
            if let Some((lane, failure)) = failures
                .iter()
                .enumerate()
                .find_map(|(lane, failure)| failure.as_ref().map(|failure| (lane, failure)))
            {
                return Err(unable(config, &self.orbit, first + lane, failure));
            }
            self.base = end;
            self.tick += 1;
            if self.tick >= 0 {
                for (lane, swing) in self.swings[first..].iter_mut().enumerate() {
                    swing.snapshots.push(Snapshot {
                        arm: ArmState { steps: 0, ..lanes.state(lane) },
                        undisturbed: end,
                        command,
                    });
                }
            }
            return Ok(true);
        }
        self.lanes = None;
        Ok(known < bodies)
    }

    /// The swings, when [`SwingRun::advance`] has come to its end, kept for whoever asks for them with
    /// [`Swing::shared`].
    #[must_use]
    pub fn keep(self) -> Swings {
        let swings: Swings = self.swings.into();
        let mut shared = shared();
        if shared.len() >= KEPT {
            shared.remove(0);
        }
        shared.push((Key::of(&self.config), Arc::clone(&swings)));
        swings
    }
}
