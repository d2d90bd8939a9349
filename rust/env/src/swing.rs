//! The teacher's clock, and the swing it keeps the arm in: where episodes begin.
//!
//! A readout has no clock of its own: it keeps whatever phase its body starts with. So an episode must
//! begin with the body already swinging in phase with the target. A swing is a run of the arm forced
//! by the lead-compensated clock, with a snapshot of the whole state at every control instant.

use std::sync::{Arc, Mutex, PoisonError};

use octoarm_arm::{Actuator, Arm, ArmState, DomainError, ParameterError, Servo, poll};

use crate::config::{EpisodeConfig, Target};
use crate::course::command_at;
use crate::orbit::Orbit;

/// Time in which the command grows from rest to the full orbit \[s\].
const RAMP: f64 = 1.0;
/// Time after the ramp in which the body forgets how it got there \[s\].
const SETTLE: f64 = 12.0;
/// Snapshots of a swing, one a control period.
const SNAPSHOTS: usize = 256;
/// Swings kept for environments that will be made later.
const KEPT: usize = 8;

/// The command that puts the base exactly on the target at every control instant, as a function of
/// time alone.
///
/// A servo lags its command. The clock therefore follows a servo of its own, undisturbed, and commands
/// what brings that one onto the target at the end of the control period. A base driven `direct` needs
/// no lead: the command is the target itself.
#[derive(Clone, Debug)]
pub struct TeacherClock {
    orbit: Arc<Orbit>,
    period: f64,
    servo: Option<Servo>,
}

impl TeacherClock {
    /// The clock of an episode that follows `orbit`.
    #[must_use]
    pub fn new(config: &EpisodeConfig, orbit: Arc<Orbit>) -> Self {
        let servo = match config.actuator {
            Actuator::Direct => None,
            Actuator::Servo => Some(Servo::new(config.arm.servo_frequency, config.control_period)),
        };
        Self { orbit, period: config.control_period, servo }
    }

    /// The target at control instant `tick` \[degrees\].
    #[must_use]
    pub fn target(&self, tick: i64) -> [f64; 2] {
        self.orbit.at(tick as f64 * self.period)
    }

    /// The command \[degrees\] from instant `tick` to the next for an undisturbed base
    /// `[θ, φ, θ̇, φ̇]` \[degrees, degrees/s\], and that base at the end.
    #[must_use]
    pub fn command(&self, tick: i64, base: [f64; 4]) -> ([f64; 2], [f64; 4]) {
        self.command_towards(self.target(tick + 1), base)
    }

    fn command_towards(&self, goal: [f64; 2], base: [f64; 4]) -> ([f64; 2], [f64; 4]) {
        let mut command = goal;
        let mut end = [goal[0], goal[1], 0.0, 0.0];
        for axis in 0..2 {
            let (angle, rate) = (base[axis], base[axis + 2]);
            if let Some(servo) = &self.servo {
                command[axis] = servo.command_for(angle, rate, goal[axis]);
                (end[axis], end[axis + 2]) = servo.advance(angle, rate, command[axis]);
            } else {
                end[axis + 2] = (goal[axis] - angle) / self.period;
            }
        }
        (command, end)
    }
}

/// Where an episode may begin.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// The arm, on the orbit and in phase.
    pub arm: ArmState,
    /// The clock's undisturbed base `[θ, φ, θ̇, φ̇]` \[degrees, degrees/s\].
    pub clock: [f64; 4],
    /// The command that led here \[degrees\].
    pub command: [f64; 2],
}

/// An arm kept on its orbit by the teacher, with a snapshot at every control instant.
#[derive(Clone, Debug)]
pub struct Swing {
    /// The orbit.
    pub orbit: Arc<Orbit>,
    /// The teacher.
    pub clock: TeacherClock,
    /// State at instants 0, 1, 2, … of the clock.
    pub snapshots: Vec<Snapshot>,
    /// An arm of this body at rest, to be cloned.
    pub arm: Arm,
}

/// Smooth growth from 0 to 1 with two continuous derivatives.
fn ramp(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (x * (6.0 * x - 15.0) + 10.0)
}

/// Moves the arm through one control period under a command in degrees ([`command_at`]).
///
/// Gives the reason if the arm would leave its domain; it then is in its last valid state.
///
/// # Errors
/// Those of `before_each` physics step, with the arm on its way.
pub(crate) fn control_step(
    arm: &mut Arm,
    command: [f64; 2],
    physics_steps: u32,
    before_each: impl Fn() -> Result<(), ParameterError>,
) -> Result<Option<DomainError>, ParameterError> {
    let (actuator, start) = (arm.actuator(), arm.base_degrees());
    for step in 1..=physics_steps {
        before_each()?;
        if let Err(failure) = arm.step(command_at(actuator, start, command, step, physics_steps)) {
            return Ok(Some(failure));
        }
    }
    Ok(None)
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
    ParameterError::OutOfRange {
        name: name.to_owned(),
        value,
        range: format!("of targets that this body can be swung along: {failure}"),
    }
}

impl Swing {
    /// The swing of a configuration; computed once, then shared by every environment that asks for it.
    ///
    /// # Errors
    /// [`ParameterError`] for settings out of range, a body without a rest state, or a target that
    /// takes the arm out of its domain.
    pub fn shared(config: &EpisodeConfig) -> Result<Arc<Self>, ParameterError> {
        static SHARED: Mutex<Vec<(String, Arc<Swing>)>> = Mutex::new(Vec::new());
        // Only what the swing depends on: rewards and action range do not matter.
        let standard = EpisodeConfig::default();
        let key = EpisodeConfig {
            action_range: None,
            tracking_weight: standard.tracking_weight,
            reward_width: standard.reward_width,
            action_change_weight: standard.action_change_weight,
            ..config.clone()
        }
        .to_json()?;
        {
            let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(at) = shared.iter().position(|(known, _)| *known == key) {
                let entry = shared.remove(at);
                let swing = Arc::clone(&entry.1);
                shared.push(entry);
                return Ok(swing);
            }
        }
        let swing = Arc::new(Self::new(config)?);
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        if shared.len() >= KEPT {
            shared.remove(0);
        }
        shared.push((key, Arc::clone(&swing)));
        Ok(swing)
    }

    /// Forces the arm onto the orbit and records it.
    ///
    /// # Errors
    /// As [`Swing::shared`].
    pub fn new(config: &EpisodeConfig) -> Result<Self, ParameterError> {
        config.validate()?;
        let orbit = Arc::new(config.orbit()?);
        let clock = TeacherClock::new(config, Arc::clone(&orbit));
        let resting = Arm::new(config.arm.clone(), config.actuator)?;
        let mut arm = resting.clone();
        let physics_steps = config.physics_steps();
        let lead_in = ((RAMP + SETTLE) / config.control_period).ceil() as i64;
        let mut base = [0.0; 4];
        let mut snapshots = Vec::with_capacity(SNAPSHOTS);
        for tick in -lead_in..SNAPSHOTS as i64 - 1 {
            let elapsed = (tick + 1 + lead_in) as f64 * config.control_period;
            let goal = clock.target(tick + 1).map(|angle| angle * ramp(elapsed / RAMP));
            let (command, end) = clock.command_towards(goal, base);
            if let Some(failure) = control_step(&mut arm, command, physics_steps, poll)? {
                return Err(unable(config, &orbit, &failure));
            }
            base = end;
            if tick + 1 >= 0 {
                snapshots.push(Snapshot {
                    arm: ArmState { steps: 0, ..arm.state() },
                    clock: base,
                    command,
                });
            }
        }
        Ok(Self { orbit, clock, snapshots, arm: resting })
    }
}
