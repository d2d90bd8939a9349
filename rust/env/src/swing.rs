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
use crate::control::control_step;
use crate::orbit::{Orbit, Target};
use crate::teacher::TeacherClock;

/// Time in which the command grows from rest to the full orbit \[s\].
const RAMP: f64 = 1.0;
/// Time after the ramp in which the body forgets how it got there \[s\].
const SETTLE: f64 = 12.0;
/// Snapshots of a swing, one a control period.
const SNAPSHOTS: usize = 256;
/// Swings kept for environments that will be made later.
const KEPT: usize = 8;

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
fn unable(config: &EpisodeConfig, orbit: &Orbit, failure: &DomainError) -> ParameterError {
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
    let range = format!("of targets that this body can be swung along: {failure}");
    ParameterError::out_of_range(name, value, range)
}

/// What a swing depends on.
#[derive(PartialEq)]
struct Key {
    target: Target,
    amplitude: Option<f64>,
    control_period: f64,
    actuator: Actuator,
    arm: ArmParameters,
}

impl Key {
    fn of(config: &EpisodeConfig) -> Self {
        Self {
            target: config.target.clone(),
            amplitude: config.amplitude,
            control_period: config.control_period,
            actuator: config.actuator,
            arm: config.arm.clone(),
        }
    }
}

/// The swings that are kept, the one that was asked for last at the end.
fn shared() -> MutexGuard<'static, Vec<(Key, Arc<Swing>)>> {
    static SHARED: Mutex<Vec<(Key, Arc<Swing>)>> = Mutex::new(Vec::new());
    SHARED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Control periods before the first snapshot.
fn lead_in(config: &EpisodeConfig) -> f64 {
    ((RAMP + SETTLE) / config.control_period).ceil()
}

impl Swing {
    /// Physics steps that [`Swing::new`] makes for valid settings.
    #[must_use]
    pub fn physics_steps(config: &EpisodeConfig) -> f64 {
        (lead_in(config) + SNAPSHOTS as f64 - 1.0) * f64::from(config.physics_steps())
    }

    /// Memory that a swing of valid settings takes, with the settings themselves, rounded up \[bytes\].
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
            .saturating_add(rows.saturating_mul(size_of::<[f64; 2]>()))
            .saturating_add(ArmLanes::bytes(compartments))
    }

    /// The swing of a configuration, if it is kept from before.
    #[must_use]
    pub fn kept(config: &CheckedConfig) -> Option<Arc<Self>> {
        let key = Key::of(config);
        let mut shared = shared();
        let at = shared.iter().position(|(known, _)| *known == key)?;
        let entry = shared.remove(at);
        let swing = Arc::clone(&entry.1);
        shared.push(entry);
        Some(swing)
    }

    /// The swing of a configuration; computed once, then shared by every environment that asks for it.
    ///
    /// # Errors
    /// [`ParameterError`] for a body without a rest state, or a target that takes the arm out of its
    /// domain.
    pub fn shared(config: &CheckedConfig) -> Result<Arc<Self>, ParameterError> {
        if let Some(swing) = Self::kept(config) {
            return Ok(swing);
        }
        let mut run = SwingRun::new(config)?;
        while run.advance()? {}
        Ok(run.keep())
    }

    /// Forces the arm onto the orbit and records it.
    ///
    /// # Errors
    /// As [`Swing::shared`].
    pub fn new(config: &CheckedConfig) -> Result<Self, ParameterError> {
        let mut run = SwingRun::new(config)?;
        while run.advance()? {}
        Ok(run.finish())
    }
}

/// A swing in the making, a control period at a time, so that others can have their turn in between.
#[derive(Debug)]
pub struct SwingRun {
    config: CheckedConfig,
    swing: Swing,
    arm: Arm,
    lead_in: i64,
    tick: i64,
    base: [f64; 4],
}

impl SwingRun {
    /// The arm at rest.
    ///
    /// # Errors
    /// [`ParameterError`] for a body without a rest state.
    pub fn new(config: &CheckedConfig) -> Result<Self, ParameterError> {
        let orbit = Arc::new(config.orbit()?);
        let clock = TeacherClock::new(config, Arc::clone(&orbit));
        let mut resting = config.undeformed_arm().clone();
        resting.reset()?;
        let lead_in = lead_in(config) as i64;
        Ok(Self {
            config: config.clone(),
            arm: resting.clone(),
            swing: Swing { orbit, clock, snapshots: Vec::with_capacity(SNAPSHOTS), arm: resting },
            lead_in,
            tick: -lead_in,
            base: [0.0; 4],
        })
    }

    /// Goes on by a control period; false when there is none left.
    ///
    /// # Errors
    /// [`ParameterError`] for a target that takes the arm out of its domain.
    pub fn advance(&mut self) -> Result<bool, ParameterError> {
        if self.tick >= SNAPSHOTS as i64 - 1 {
            return Ok(false);
        }
        let (config, tick) = (&self.config, self.tick);
        let elapsed = (tick + 1 + self.lead_in) as f64 * config.control_period;
        let goal = self.swing.clock.target(tick + 1).map(|angle| angle * ramp(elapsed / RAMP));
        let (command, end) = self.swing.clock.command_towards(goal, self.base);
        if let Some(failure) = control_step(&mut self.arm, command, config.physics_steps(), poll)? {
            return Err(unable(config, &self.swing.orbit, &failure));
        }
        self.base = end;
        if tick + 1 >= 0 {
            self.swing.snapshots.push(Snapshot {
                arm: ArmState { steps: 0, ..self.arm.state() },
                undisturbed: self.base,
                command,
            });
        }
        self.tick += 1;
        Ok(true)
    }

    /// The swing, when [`SwingRun::advance`] has come to its end.
    #[must_use]
    pub fn finish(self) -> Swing {
        self.swing
    }

    /// The same, kept for whoever asks for it with [`Swing::shared`].
    #[must_use]
    pub fn keep(self) -> Arc<Swing> {
        let key = Key::of(&self.config);
        let swing = Arc::new(self.finish());
        let mut shared = shared();
        if shared.len() >= KEPT {
            shared.remove(0);
        }
        shared.push((key, Arc::clone(&swing)));
        swing
    }
}
