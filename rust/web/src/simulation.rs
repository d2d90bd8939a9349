//! One arm, and who commands its base.

use std::fmt::Display;

use octoarm_arm::{
    Actuator, Arm, ArmParameters, DomainError, Interval, LinearReadout, ParameterError,
};
use octoarm_env::{Orbit, TargetName, command_at, share};
use rand_core::SeedableRng;
use rand_pcg::Pcg64;

use crate::lesson::Lesson;
use crate::network::Network;
use crate::orbit_distance::distance;

/// Step of the teacher's signal, and so of every arm here \[s\].
const TIMESTEP: f64 = 1e-3;
/// First steps of a lesson that are not used: the arm comes from rest, and its cycle settles.
const WASHOUT: usize = 4_000;
/// Steps of the teacher's signal that are computed first, and most that there are.
const SIGNAL: usize = 1 << 15;
const LONGEST_SIGNAL: usize = 1 << 20;
/// Fastest that a hand turns the base \[degrees a second\].
const HAND_SPEED: f64 = 720.0;
/// Steps that a push lasts.
const PUSH: u32 = 200;
const AMPLITUDE: Interval = Interval::above(0.0, 180.0).of("degrees");

/// Who commands the base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Driver {
    /// A hand, through a servo.
    Hand,
    /// A clock that follows the target.
    Teacher,
    /// The linear readout of the springs.
    Readout,
    /// A trained network, every control period.
    Network,
}

/// A push of the base, a half wave that is added to what it is commanded.
#[derive(Clone, Copy, Debug)]
struct Push {
    peak: [f64; 2],
    step: u32,
}

/// An arm, its target, and who commands its base; with noise and pushes.
#[derive(Clone, Debug)]
pub struct Simulation {
    arm: Arm,
    driver: Driver,
    target: TargetName,
    orbit: Orbit,
    signal: Vec<[f64; 2]>,
    lesson: Lesson,
    readout: Option<LinearReadout>,
    network: Option<Network>,
    /// Where a hand wants the base, and where it has been led.
    goal: [f64; 2],
    led: [f64; 2],
    /// Of the network's control period: begin and end \[degrees\], and steps made.
    period: ([f64; 2], [f64; 2], u32),
    push: Option<Push>,
    command_noise: f64,
    length_noise: f64,
    generator: Pcg64,
    lengths: Vec<f64>,
    seen: Vec<f64>,
}

impl Simulation {
    /// An arm at rest in a hand.
    ///
    /// # Errors
    /// [`ParameterError`] for a body that cannot be, has no rest, or another timestep than 1 ms.
    pub fn new(parameters: ArmParameters) -> Result<Self, ParameterError> {
        let arm = arm(parameters, Actuator::Servo)?;
        let target = TargetName::Quadratic;
        let lengths = arm.lengths();
        Ok(Self {
            driver: Driver::Hand,
            target,
            orbit: Orbit::named(target, target.amplitude()),
            signal: Vec::new(),
            lesson: Lesson::new(lengths.len()),
            readout: None,
            network: None,
            goal: [0.0; 2],
            led: [0.0; 2],
            period: ([0.0; 2], [0.0; 2], 0),
            push: None,
            command_noise: 0.0,
            length_noise: 0.0,
            generator: Pcg64::seed_from_u64(0),
            seen: lengths.clone(),
            lengths,
            arm,
        })
    }

    /// The arm.
    #[must_use]
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// Who commands the base.
    #[must_use]
    pub fn driver(&self) -> Driver {
        self.driver
    }

    /// The cycle to follow.
    #[must_use]
    pub fn orbit(&self) -> &Orbit {
        &self.orbit
    }

    /// Lengths of the springs \[m\], as [`Arm::lengths`].
    #[must_use]
    pub fn lengths(&self) -> &[f64] {
        &self.lengths
    }

    /// The readout that was fitted last.
    #[must_use]
    pub fn readout(&self) -> Option<&LinearReadout> {
        self.readout.as_ref()
    }

    /// Steps that the lesson holds, those of its begin left out.
    #[must_use]
    pub fn lesson_steps(&self) -> usize {
        self.lesson.rows()
    }

    /// How far the base is from the orbit, in parts of the amplitude.
    #[must_use]
    pub fn distance(&self) -> f64 {
        distance(self.orbit.table(), self.arm.base_degrees()) / self.orbit.amplitude()
    }

    /// Whether a push is under way.
    #[must_use]
    pub fn pushed(&self) -> bool {
        self.push.is_some()
    }

    /// Another body. It goes on where the one before was, if it can, and at rest otherwise. A readout
    /// is kept, a lesson is not: it was another body's.
    ///
    /// # Errors
    /// As [`Simulation::new`]; nothing is changed then.
    pub fn set_body(&mut self, parameters: ArmParameters) -> Result<(), ParameterError> {
        let mut body = arm(parameters, self.arm.actuator())?;
        let springs = body.observation_len();
        if springs != self.arm.observation_len() {
            (self.readout, self.network) = (None, None);
            self.take(Driver::Hand)?;
        } else if body.set_state(&self.arm.state()).is_err() {
            self.take(Driver::Hand)?;
        }
        self.arm = body;
        self.lesson = Lesson::new(springs);
        if self.driver == Driver::Teacher {
            self.take(Driver::Hand)?;
        }
        self.look();
        Ok(())
    }

    /// Back to rest, in a hand. Lesson and readout are kept.
    ///
    /// # Errors
    /// [`ParameterError::NoEquilibrium`], never after it was found once.
    pub fn reset(&mut self) -> Result<(), ParameterError> {
        self.arm.reset()?;
        self.take(Driver::Hand)?;
        (self.push, self.goal, self.led) = (None, [0.0; 2], [0.0; 2]);
        self.look();
        Ok(())
    }

    /// A hand wants the base there \[degrees\], and takes it.
    ///
    /// # Errors
    /// [`ParameterError`] for angles that are not finite or beyond 180 degrees.
    pub fn drag(&mut self, goal: [f64; 2]) -> Result<(), ParameterError> {
        for (value, name) in goal.iter().zip(["theta", "phi"]) {
            Interval::within(180.0).of("degrees").check(*value, || name.to_owned())?;
        }
        self.take(Driver::Hand)?;
        self.goal = goal;
        Ok(())
    }

    /// A new lesson: from rest the teacher swings the arm along a cycle of this amplitude \[degrees\].
    ///
    /// # Errors
    /// [`ParameterError`] for an amplitude out of range; nothing is changed then.
    pub fn begin_lesson(
        &mut self,
        target: TargetName,
        amplitude: f64,
    ) -> Result<(), ParameterError> {
        self.set_target(target, amplitude)?;
        self.reset()?;
        self.signal = Orbit::teacher_signal(target, amplitude, SIGNAL)?;
        self.lesson = Lesson::new(self.arm.observation_len());
        self.take(Driver::Teacher)
    }

    /// The cycle that distances are taken from.
    ///
    /// # Errors
    /// [`ParameterError`] for an amplitude out of range.
    pub fn set_target(&mut self, target: TargetName, amplitude: f64) -> Result<(), ParameterError> {
        AMPLITUDE.check(amplitude, || "amplitude".to_owned())?;
        (self.target, self.orbit) = (target, Orbit::named(target, amplitude));
        Ok(())
    }

    /// Fits the readout to the lesson by least squares; white noise of this half width \[m\] on the
    /// lengths is allowed for. Gives the root mean square of its error \[degrees\].
    ///
    /// # Errors
    /// [`ParameterError`] for a lesson that is too short, or noise out of range.
    pub fn fit(&mut self, noise: f64) -> Result<f64, ParameterError> {
        let (readout, error) = self.lesson.fit(noise)?;
        self.readout = Some(readout);
        Ok(error)
    }

    /// The readout takes the base: the loop is closed.
    ///
    /// # Errors
    /// [`ParameterError`] where none was fitted.
    pub fn let_go(&mut self) -> Result<(), ParameterError> {
        if self.readout.is_none() {
            return Err(missing("readout", "of arms that were taught: fit one first"));
        }
        self.take(Driver::Readout)
    }

    /// The network takes the base. It is trained for an arm on its cycle, as the teacher leaves it.
    ///
    /// # Errors
    /// [`ParameterError`] for a network of another number of springs.
    pub fn let_network(&mut self, network: Network) -> Result<(), ParameterError> {
        let (found, expected) = (network.springs(), self.arm.observation_len());
        if found != expected {
            let shape = |springs| format!("({springs},)");
            return Err(ParameterError::shape("agent", shape(found), shape(expected)));
        }
        self.network = Some(network);
        self.period.2 = 0;
        self.take(Driver::Network)
    }

    /// Half width of the white noise on the commands \[degrees\] and on the lengths that readout and
    /// network see \[m\].
    ///
    /// # Errors
    /// [`ParameterError`] for noise out of range.
    pub fn set_noise(&mut self, command: f64, length: f64) -> Result<(), ParameterError> {
        Interval::closed(0.0, 90.0).of("degrees").check(command, || "command_noise".to_owned())?;
        Interval::closed(0.0, 1e-2).of("metres").check(length, || "length_noise".to_owned())?;
        (self.command_noise, self.length_noise) = (command, length);
        Ok(())
    }

    /// Pushes the base: for 0.2 s a half wave of this height θ, φ \[degrees\] is added to what it is
    /// commanded.
    ///
    /// # Errors
    /// [`ParameterError`] for a height out of range.
    pub fn push(&mut self, peak: [f64; 2]) -> Result<(), ParameterError> {
        for (value, name) in peak.iter().zip(["push[0]", "push[1]"]) {
            Interval::within(180.0).of("degrees").check(*value, || name.to_owned())?;
        }
        self.push = Some(Push { peak, step: 0 });
        Ok(())
    }

    /// So many physics steps. Gives the number that was made: fewer where the teacher has nothing more
    /// to show, and gives the base back to the hand.
    ///
    /// # Errors
    /// [`DomainError`] for a step that would leave the model's domain: the arm keeps the state before
    /// it, and waits in a hand.
    pub fn advance(&mut self, steps: usize) -> Result<usize, DomainError> {
        for made in 0..steps {
            let Some(command) = self.command() else {
                self.hold();
                return Ok(made);
            };
            let taught = (self.driver == Driver::Teacher).then(|| self.steps());
            let pushed = self.pushed_by();
            if let Err(failure) = self.arm.step([command[0] + pushed[0], command[1] + pushed[1]]) {
                self.hold();
                return Err(failure);
            }
            self.look();
            if let Some(step) = taught
                && step >= WASHOUT
            {
                // Lengths after step t, and the command that follows them.
                self.lesson.record(&self.lengths, self.signal[step + 1]);
            }
        }
        Ok(steps)
    }

    /// What the base is commanded in the next step \[degrees\]; none where the lesson is over.
    fn command(&mut self) -> Option<[f64; 2]> {
        let ideal = match self.driver {
            Driver::Hand => {
                let most = HAND_SPEED * TIMESTEP;
                for (led, goal) in self.led.iter_mut().zip(self.goal) {
                    *led += (goal - *led).clamp(-most, most);
                }
                return Some(self.led);
            }
            Driver::Teacher => return self.taught(),
            Driver::Readout => {
                self.sense();
                self.readout.as_ref()?.output(&self.seen)
            }
            Driver::Network => {
                let steps = self.network.as_ref()?.steps();
                if self.period.2 == 0 {
                    self.sense();
                    let goal = self.network.as_ref()?.command(&self.seen);
                    self.period = (self.arm.base_degrees(), self.with_noise(goal), 0);
                }
                let (start, goal, step) = self.period;
                self.period.2 = (step + 1) % steps;
                return Some(command_at(Actuator::Direct, start, goal, step + 1, steps));
            }
        };
        Some(self.with_noise(ideal))
    }

    /// The teacher's command; its signal is continued as it is needed.
    fn taught(&mut self) -> Option<[f64; 2]> {
        let step = self.steps();
        if step + 1 >= self.signal.len() {
            let longer = 2 * self.signal.len();
            if longer > LONGEST_SIGNAL {
                return None;
            }
            self.signal =
                Orbit::teacher_signal(self.target, self.orbit.amplitude(), longer).ok()?;
        }
        Some(self.signal[step])
    }

    fn with_noise(&mut self, command: [f64; 2]) -> [f64; 2] {
        if self.command_noise == 0.0 {
            return command;
        }
        command.map(|angle| angle + self.command_noise * self.draw())
    }

    /// A number in \[−1, 1).
    fn draw(&mut self) -> f64 {
        2.0 * share(&mut self.generator) - 1.0
    }

    /// What readout and network see.
    fn sense(&mut self) {
        self.seen.copy_from_slice(&self.lengths);
        if self.length_noise > 0.0 {
            for index in 0..self.seen.len() {
                self.seen[index] += self.length_noise * self.draw();
            }
        }
    }

    /// What a push adds in the next step.
    fn pushed_by(&mut self) -> [f64; 2] {
        let Some(push) = &mut self.push else { return [0.0; 2] };
        push.step += 1;
        let share = f64::from(push.step) / f64::from(PUSH);
        let height = 4.0 * share * (1.0 - share);
        let added = push.peak.map(|peak| peak * height);
        if push.step == PUSH {
            self.push = None;
        }
        added
    }

    /// Steps since the arm was at rest.
    fn steps(&self) -> usize {
        (self.arm.time() / TIMESTEP).round() as usize
    }

    fn look(&mut self) {
        let springs = self.arm.observation_len();
        self.lengths.resize(springs, 0.0);
        self.seen.resize(springs, 0.0);
        self.arm.lengths_into(&mut self.lengths);
    }

    /// The base stays where it is, in a hand.
    fn hold(&mut self) {
        self.push = None;
        self.goal = self.arm.base_degrees().map(|angle| angle.clamp(-180.0, 180.0));
        // A state that was valid under one actuator is so under the other.
        let _ = self.take(Driver::Hand);
    }

    /// Gives the base to somebody; a hand has a servo, all others move the base themselves.
    fn take(&mut self, driver: Driver) -> Result<(), ParameterError> {
        let actuator = if driver == Driver::Hand { Actuator::Servo } else { Actuator::Direct };
        if actuator != self.arm.actuator() {
            let mut other = Arm::undeformed(self.arm.parameters().clone(), actuator)?;
            other.set_state(&self.arm.state())?;
            self.arm = other;
        }
        if self.driver != driver {
            self.led = self.arm.base_degrees();
            if driver == Driver::Hand {
                self.goal = self.led.map(|angle| angle.clamp(-180.0, 180.0));
            }
        }
        self.driver = driver;
        Ok(())
    }
}

fn arm(parameters: ArmParameters, actuator: Actuator) -> Result<Arm, ParameterError> {
    if parameters.timestep != TIMESTEP {
        let range = "of 0.001 s, the step of the teacher's signal";
        return Err(ParameterError::out_of_range("timestep", parameters.timestep, range));
    }
    Arm::new(parameters, actuator)
}

fn missing(name: &str, range: impl Display) -> ParameterError {
    ParameterError::out_of_range(name, "none", range)
}
