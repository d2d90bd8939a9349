//! The teacher: a clock that knows where the target is, and how to bring the base there.

use std::sync::Arc;

use octoarm_arm::{Actuator, Servo};

use crate::config::EpisodeConfig;
use crate::orbit::Orbit;

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

    pub(crate) fn command_towards(&self, goal: [f64; 2], base: [f64; 4]) -> ([f64; 2], [f64; 4]) {
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
