//! How the base moves: position control, either direct or through a servo (physics: Eq. 16, 24).

use serde::{Deserialize, Serialize};

use crate::parameters::ArmParameters;
use crate::transcendental::exp_negative;

/// What stands between the commanded and the actual base angle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Actuator {
    /// The paper's: the base moves linearly to the commanded angle within the physics step.
    Direct,
    /// A critically damped second-order follower of natural frequency `servo_frequency`.
    Servo,
}

/// Motion of the base at one instant; index 0 is θ, index 1 is φ.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BaseMotion {
    /// Angles θ, φ \[rad\].
    pub angle: [f64; 2],
    /// Angular rates θ̇, φ̇ \[rad/s\].
    pub rate: [f64; 2],
    /// Angular accelerations θ̈, φ̈ \[rad/s²\].
    pub acceleration: [f64; 2],
}

/// A critically damped follower, `ẍ = ω² (u − x) − 2 ω ẋ`, solved exactly over a time in which the
/// command `u` is constant: with `y = x − u` and `b = ẏ + ω y`, `y(t) = (y + b t) e^{−ω t}`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Servo {
    omega: f64,
    duration: f64,
    decay: f64,
}

impl Servo {
    /// The follower of natural frequency `frequency` \[Hz\] over `duration` \[s\].
    #[must_use]
    pub fn new(frequency: f64, duration: f64) -> Self {
        let omega = std::f64::consts::TAU * frequency;
        Self { omega, duration, decay: exp_negative(omega * duration) }
    }

    /// Angle \[rad\] and rate \[rad/s\] at the end of the duration under a command \[rad\]; any
    /// unit of angle does, if it is the same for all.
    #[must_use]
    pub fn advance(&self, angle: f64, rate: f64, command: f64) -> (f64, f64) {
        let offset = angle - command;
        let slope = rate + self.omega * offset;
        let end = offset + slope * self.duration;
        (command + end * self.decay, (slope - self.omega * end) * self.decay)
    }

    /// The constant command that brings the follower onto `goal` at the end of the duration.
    #[must_use]
    pub fn command_for(&self, angle: f64, rate: f64, goal: f64) -> f64 {
        let wt = self.omega * self.duration;
        let free = (angle * (1.0 + wt) + rate * self.duration) * self.decay;
        (goal - free) / (1.0 - (1.0 + wt) * self.decay)
    }

    fn acceleration(&self, angle: f64, rate: f64, command: f64) -> f64 {
        self.omega * (self.omega * (command - angle) - 2.0 * rate)
    }
}

/// The bases of `L` arms at one instant: [`BaseMotion`] by rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BaseRows<const L: usize> {
    pub(crate) angle: [[f64; L]; 2],
    pub(crate) rate: [[f64; L]; 2],
    pub(crate) acceleration: [[f64; L]; 2],
}

impl<const L: usize> BaseRows<L> {
    const STILL: Self =
        Self { angle: [[0.0; L]; 2], rate: [[0.0; L]; 2], acceleration: [[0.0; L]; 2] };

    /// The motion of one lane.
    pub(crate) fn lane(&self, lane: usize) -> BaseMotion {
        BaseMotion {
            angle: self.angle.map(|row| row[lane]),
            rate: self.rate.map(|row| row[lane]),
            acceleration: self.acceleration.map(|row| row[lane]),
        }
    }

    /// The base at this instant, `[θ, φ, θ̇, φ̇]`.
    pub(crate) fn state(&self) -> [[f64; L]; 4] {
        [self.angle[0], self.angle[1], self.rate[0], self.rate[1]]
    }
}

impl From<&BaseMotion> for BaseRows<1> {
    fn from(motion: &BaseMotion) -> Self {
        Self {
            angle: motion.angle.map(|value| [value]),
            rate: motion.rate.map(|value| [value]),
            acceleration: motion.acceleration.map(|value| [value]),
        }
    }
}

/// The motion of `L` bases over one physics step, each with an actuator of its own.
#[derive(Clone, Debug)]
pub(crate) struct BaseDrive<const L: usize> {
    actuator: [Actuator; L],
    timestep: [f64; L],
    half: [Servo; L],
    full: [Servo; L],
}

impl<const L: usize> BaseDrive<L> {
    pub(crate) fn new(arms: &[(&ArmParameters, Actuator); L]) -> Self {
        let servo =
            |share: f64| arms.map(|(arm, _)| Servo::new(arm.servo_frequency, share * arm.timestep));
        Self {
            actuator: arms.map(|(_, actuator)| actuator),
            timestep: arms.map(|(arm, _)| arm.timestep),
            half: servo(0.5),
            full: servo(1.0),
        }
    }

    /// Gives a lane the drive of an arm alone.
    pub(crate) fn set_lane(&mut self, lane: usize, alone: &BaseDrive<1>) {
        self.actuator[lane] = alone.actuator[0];
        self.timestep[lane] = alone.timestep[0];
        self.half[lane] = alone.half[0];
        self.full[lane] = alone.full[0];
    }

    pub(crate) fn actuator(&self, lane: usize) -> Actuator {
        self.actuator[lane]
    }

    /// Motion at the start, middle and end of a step that starts from `base`
    /// (`[θ, φ, θ̇, φ̇]`, rad) under commands in radians.
    pub(crate) fn motion(&self, base: &[[f64; L]; 4], command: &[[f64; L]; 2]) -> [BaseRows<L>; 3] {
        let mut motion = [BaseRows::STILL; 3];
        for axis in 0..2 {
            for lane in 0..L {
                let (angle, rate) = (base[axis][lane], base[axis + 2][lane]);
                let goal = command[axis][lane];
                match self.actuator[lane] {
                    Actuator::Direct => {
                        let travel = goal - angle;
                        let velocity = travel / self.timestep[lane];
                        let acceleration = (velocity - rate) / self.timestep[lane];
                        let angles = [angle, angle + 0.5 * travel, goal];
                        for (instant, angle) in motion.iter_mut().zip(angles) {
                            instant.angle[axis][lane] = angle;
                            instant.rate[axis][lane] = velocity;
                            instant.acceleration[axis][lane] = acceleration;
                        }
                    }
                    Actuator::Servo => {
                        let states = [
                            (angle, rate),
                            self.half[lane].advance(angle, rate, goal),
                            self.full[lane].advance(angle, rate, goal),
                        ];
                        for (instant, (angle, rate)) in motion.iter_mut().zip(states) {
                            instant.angle[axis][lane] = angle;
                            instant.rate[axis][lane] = rate;
                            instant.acceleration[axis][lane] =
                                self.full[lane].acceleration(angle, rate, goal);
                        }
                    }
                }
            }
        }
        motion
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_servo_is_the_exact_solution() {
        // One long step equals many short ones, and a fine Runge–Kutta solution.
        let (mut angle, mut rate) = (0.3, -2.0);
        let short = Servo::new(12.0, 1e-3);
        for _ in 0..10 {
            (angle, rate) = short.advance(angle, rate, 0.8);
        }
        let (long_angle, long_rate) = Servo::new(12.0, 1e-2).advance(0.3, -2.0, 0.8);
        assert!((angle - long_angle).abs() < 1e-14 && (rate - long_rate).abs() < 1e-12);

        let omega = std::f64::consts::TAU * 12.0;
        let slope = |x: f64, v: f64| (v, omega * omega * (0.8 - x) - 2.0 * omega * v);
        let (mut x, mut v, dt) = (0.3, -2.0, 1e-6);
        for _ in 0..10_000 {
            let k1 = slope(x, v);
            let k2 = slope(x + 0.5 * dt * k1.0, v + 0.5 * dt * k1.1);
            let k3 = slope(x + 0.5 * dt * k2.0, v + 0.5 * dt * k2.1);
            let k4 = slope(x + dt * k3.0, v + dt * k3.1);
            x += dt / 6.0 * (k1.0 + 2.0 * (k2.0 + k3.0) + k4.0);
            v += dt / 6.0 * (k1.1 + 2.0 * (k2.1 + k3.1) + k4.1);
        }
        assert!((x - long_angle).abs() < 1e-11 && (v - long_rate).abs() < 1e-9);
    }

    #[test]
    fn the_lead_command_lands_on_its_goal() {
        let servo = Servo::new(12.0, 0.01);
        let command = servo.command_for(0.1, 3.0, 0.14);
        assert!((servo.advance(0.1, 3.0, command).0 - 0.14).abs() < 1e-15);
    }
}
