//! The swing that the teacher keeps an arm in: where episodes begin.
//!
//! A readout has no clock of its own: it keeps whatever phase its body starts with. So an episode must
//! begin with the body already swinging in phase with the target. A swing is a run of the arm forced
//! by the lead-compensated clock, with a snapshot of the whole state at every control instant.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use octoarm_arm::{
    Actuator, Arm, ArmLanes, ArmParameters, ArmState, COORDINATES, DomainError, MuscleRow,
    ParameterError, poll,
};
use serde_json::json;

use crate::config::{CheckedConfig, EpisodeConfig};
use crate::control::control_step_of_lanes;
use crate::number_files::NumberFiles;
use crate::orbit::{Orbit, Target};
use crate::teacher::TeacherClock;
use crate::workers::Workers;

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

impl Snapshot {
    /// How many numbers a snapshot of so many compartments is in a file.
    const fn len(compartments: usize) -> usize {
        4 + 2 + 4 + 2 * COORDINATES * compartments
    }

    /// What is kept in a file: everything, for a swing's muscles are at rest.
    fn numbers(&self) -> impl Iterator<Item = f64> {
        let Self { arm: ArmState { coordinates, rates, base, .. }, undisturbed, command } = self;
        let rows = coordinates.iter().chain(rates).flatten();
        undisturbed.iter().chain(command).chain(base).chain(rows).copied()
    }

    /// From [`Snapshot::len`] numbers.
    fn of_numbers(numbers: &[f64]) -> Option<Self> {
        let (undisturbed, numbers) = numbers.split_first_chunk()?;
        let (command, numbers) = numbers.split_first_chunk()?;
        let (base, numbers) = numbers.split_first_chunk()?;
        let rows = numbers.as_chunks::<COORDINATES>().0;
        let (coordinates, rates) = rows.split_at(rows.len() / 2);
        let (coordinates, rates) = (coordinates.to_vec(), rates.to_vec());
        let arm = ArmState { coordinates, rates, base: *base, steps: 0, muscles: Vec::new() };
        Some(Self { arm, undisturbed: *undisturbed, command: *command })
    }
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
    /// Whether all snapshots are there.
    fn is_complete(&self) -> bool {
        self.snapshots.len() == SNAPSHOTS
    }

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

    /// [`Swing::shared`] of several configurations: their bodies swing side by side, shared by threads.
    ///
    /// # Errors
    /// Those of [`Swing::shared`], of the first body that has one.
    pub(crate) fn shared_by(
        configs: &[CheckedConfig],
        workers: &Workers,
    ) -> Result<Vec<Swings>, ParameterError> {
        // Those that are known, or where among the missing ones they are.
        let mut missing: Vec<(Key, &CheckedConfig)> = Vec::new();
        let mut places = Vec::with_capacity(configs.len());
        for config in configs {
            places.push(match Self::kept(config) {
                Some(swings) => Ok(swings),
                None => {
                    let key = Key::of(config);
                    let place = missing.iter().position(|(known, _)| *known == key);
                    let place = place.unwrap_or(missing.len());
                    if place == missing.len() {
                        missing.push((key, config));
                    }
                    Err(place)
                }
            });
        }
        let mut bodies = Vec::new();
        for (_, config) in &missing {
            let course = Course::new(config)?;
            bodies.extend((0..config.bodies).map(|body| Course { body, ..course.clone() }));
        }
        let alike = |a: &Course, b: &Course| a.config.arm.compartments == b.config.arm.compartments;
        let groups = bodies.chunk_by(alike).flat_map(|alike| alike.chunks(WIDTH));
        let mut runs: Vec<_> = groups.map(|group| (group, Ok(Vec::new()))).collect();
        let stop = AtomicBool::new(false);
        workers.for_each(runs.iter_mut().collect(), |(group, result)| {
            *result = SwingRun::of(group).and_then(|mut run| {
                // Whoever is asked to stop is the calling thread.
                while run.advance()? {
                    if stop.load(Ordering::Relaxed) {
                        return Err(ParameterError::Interrupted);
                    }
                }
                Ok(run.swings)
            });
            if matches!(result, Err(ParameterError::Interrupted)) {
                stop.store(true, Ordering::Relaxed);
            }
        });
        if stop.into_inner() {
            return Err(ParameterError::Interrupted);
        }
        let mut swings = Vec::with_capacity(bodies.len());
        for (_, result) in runs {
            swings.extend(result?);
        }
        let mut swings = swings.into_iter();
        let made = missing
            .into_iter()
            .map(|(_, config)| keep(config, swings.by_ref().take(config.bodies).collect()));
        let made: Vec<Swings> = made.collect();
        let of =
            |place: Result<Swings, usize>| place.unwrap_or_else(|place| Arc::clone(&made[place]));
        Ok(places.into_iter().map(of).collect())
    }
}

/// Keeps swings for whoever asks for them with [`Swing::shared`].
fn keep(config: &CheckedConfig, swings: Swings) -> Swings {
    let mut shared = shared();
    if shared.len() >= KEPT {
        shared.remove(0);
    }
    shared.push((Key::of(config), Arc::clone(&swings)));
    swings
}

/// A body that is to be swung, and how.
#[derive(Clone, Debug)]
struct Course {
    config: CheckedConfig,
    body: usize,
    orbit: Arc<Orbit>,
    clock: TeacherClock,
}

impl Course {
    /// That of a configuration's first body.
    fn new(config: &CheckedConfig) -> Result<Self, ParameterError> {
        let orbit = Arc::new(config.orbit()?);
        let clock = TeacherClock::new(config, Arc::clone(&orbit));
        Ok(Self { config: config.clone(), body: 0, orbit, clock })
    }

    /// The body comes to rest; with its snapshots, if a file has them.
    fn begin(&self) -> Result<Swing, ParameterError> {
        let body = self.config.drawn_bodies()[self.body].clone();
        let mut arm = Arm::undeformed(body, self.config.actuator)?;
        arm.reset()?;
        let files = NumberFiles::of_user();
        let known = files.and_then(|files| self.read(&files, &arm));
        Ok(Swing {
            orbit: Arc::clone(&self.orbit),
            clock: self.clock.clone(),
            snapshots: known.unwrap_or_else(|| Vec::with_capacity(SNAPSHOTS)),
            arm,
        })
    }

    /// What the snapshots depend on, as the key of their file.
    fn file_key(&self) -> String {
        json!({
            "version": env!("CARGO_PKG_VERSION"),
            "swing": [RAMP, SETTLE, SNAPSHOTS as f64],
            "target": self.config.target,
            "amplitude": self.config.amplitude,
            "control_period": self.config.control_period,
            "actuator": self.config.actuator,
            "body": self.config.drawn_bodies()[self.body],
        })
        .to_string()
    }

    /// The snapshots of a file, unless it is damaged or of another physics.
    fn read(&self, files: &NumberFiles, arm: &Arm) -> Option<Vec<Snapshot>> {
        let numbers = files.read(&self.file_key())?;
        let rows = numbers.chunks_exact(Snapshot::len(self.config.arm.compartments));
        let snapshots: Vec<Snapshot> = rows.map(Snapshot::of_numbers).collect::<Option<_>>()?;
        (snapshots.len() == SNAPSHOTS && self.follow(&snapshots, arm)?).then_some(snapshots)
    }

    /// Whether eight of the snapshots follow from those before them, bit for bit.
    fn follow(&self, snapshots: &[Snapshot], arm: &Arm) -> Option<bool> {
        let pairs: [&[Snapshot]; WIDTH] = std::array::from_fn(|lane| {
            let after = (lane + 1) * (SNAPSHOTS - 1) / WIDTH;
            &snapshots[after - 1..=after]
        });
        let mut lanes = ArmLanes::new(&[arm; WIDTH]).ok()?;
        for (lane, pair) in pairs.iter().enumerate() {
            lanes.set_state(lane, &pair[0].arm).ok()?;
        }
        let commands = pairs.map(|pair| pair[1].command);
        let steps = [self.config.physics_steps(); WIDTH];
        control_step_of_lanes(&mut lanes, &commands, &steps, |_, _| ());
        let same = pairs.iter().enumerate().all(|(lane, pair)| {
            let tick = (lane + 1) * (SNAPSHOTS - 1) / WIDTH;
            let (command, undisturbed) = self.clock.command(tick as i64 - 1, pair[0].undisturbed);
            let arm = ArmState { steps: 0, ..lanes.state(lane) };
            let found = Snapshot { arm, undisturbed, command };
            found.numbers().map(f64::to_bits).eq(pair[1].numbers().map(f64::to_bits))
        });
        Some(same)
    }

    /// Keeps the snapshots of a swing for processes to come.
    fn write(&self, swing: &Swing, files: &NumberFiles) -> Result<(), ParameterError> {
        let numbers = swing.snapshots.iter().flat_map(Snapshot::numbers);
        files.write(&self.file_key(), numbers)
    }
}

/// Bodies that swing side by side.
#[derive(Debug)]
struct Group {
    lanes: ArmLanes,
    /// Control periods that are made, and where the undisturbed base is.
    ticks: [i64; WIDTH],
    bases: [[f64; 4]; WIDTH],
}

impl Group {
    /// Goes on by a control period; false when all snapshots are taken.
    fn advance(
        &mut self,
        courses: &[Course],
        swings: &mut [Swing],
    ) -> Result<bool, ParameterError> {
        poll()?;
        let (mut commands, mut ends) = ([[0.0; 2]; WIDTH], self.bases);
        let mut steps = [0; WIDTH];
        for (lane, (Course { config, clock, .. }, swing)) in
            courses.iter().zip(&*swings).enumerate()
        {
            if !swing.is_complete() {
                let tick = self.ticks[lane] + 1;
                let elapsed = tick as f64 * config.control_period;
                let goal = clock.target(tick - lead_in(config) as i64);
                let goal = goal.map(|angle| angle * ramp(elapsed / RAMP));
                (commands[lane], ends[lane]) = clock.command_towards(goal, self.bases[lane]);
                steps[lane] = config.physics_steps();
            }
        }
        let failures = control_step_of_lanes(&mut self.lanes, &commands, &steps, |_, _| ());
        for (lane, (course, swing)) in courses.iter().zip(&mut *swings).enumerate() {
            if let Some(failure) = &failures[lane] {
                return Err(unable(&course.config, &course.orbit, course.body, failure));
            }
            if steps[lane] == 0 {
                continue;
            }
            self.ticks[lane] += 1;
            if self.ticks[lane] >= lead_in(&course.config) as i64 {
                swing.snapshots.push(Snapshot {
                    arm: ArmState { steps: 0, ..self.lanes.state(lane) },
                    undisturbed: ends[lane],
                    command: commands[lane],
                });
            }
        }
        self.bases = ends;
        Ok(!swings.iter().all(Swing::is_complete))
    }

    /// Keeps the swings that were made here in files, if the user wants them.
    fn keep(&self, courses: &[Course], swings: &[Swing]) -> Result<(), ParameterError> {
        let Some(files) = NumberFiles::of_user() else { return Ok(()) };
        for (lane, (course, swing)) in courses.iter().zip(swings).enumerate() {
            if self.ticks[lane] > 0 {
                course.write(swing, &files)?;
            }
        }
        Ok(())
    }
}

/// Swings in the making, a control period of eight bodies at a time, so that others can have their turn
/// in between.
#[derive(Debug)]
pub struct SwingRun {
    courses: Vec<Course>,
    /// Those that are done, and those under way, whose snapshots are fewer.
    swings: Vec<Swing>,
    /// The bodies under way, the last ones of the swings.
    group: Option<Group>,
}

impl SwingRun {
    /// The first arm at rest.
    ///
    /// # Errors
    /// [`ParameterError`] for a body without a rest state.
    pub fn new(config: &CheckedConfig) -> Result<Self, ParameterError> {
        let course = Course::new(config)?;
        let bodies = (0..config.bodies).map(|body| Course { body, ..course.clone() });
        Self::of(&bodies.collect::<Vec<_>>())
    }

    /// Some bodies, of one number of compartments.
    fn of(courses: &[Course]) -> Result<Self, ParameterError> {
        let swings = vec![courses[0].begin()?];
        Ok(Self { courses: courses.to_vec(), swings, group: None })
    }

    /// Goes on by a control period, or brings another body to rest; false when there is nothing left.
    ///
    /// # Errors
    /// [`ParameterError`] for a body without a rest state, or a target that takes an arm out of its
    /// domain.
    pub fn advance(&mut self) -> Result<bool, ParameterError> {
        let (known, bodies) = (self.swings.len(), self.courses.len());
        let first = (known - 1) / WIDTH * WIDTH;
        let (courses, swings) = (&self.courses[first..known], &mut self.swings[first..]);
        if let Some(group) = &mut self.group {
            if group.advance(courses, swings)? {
                return Ok(true);
            }
            group.keep(courses, swings)?;
            self.group = None;
            return Ok(known < bodies);
        }
        let swung = swings.iter().all(Swing::is_complete);
        if swung && known == bodies {
            return Ok(false);
        }
        if known < bodies && (swung || known < first + WIDTH) {
            self.swings.push(self.courses[known].begin()?);
            return Ok(true);
        }
        let arms: Vec<&Arm> = swings.iter().map(|swing| &swing.arm).collect();
        let lanes = ArmLanes::new(&arms)?;
        self.group = Some(Group { lanes, ticks: [0; WIDTH], bases: [[0.0; 4]; WIDTH] });
        Ok(true)
    }

    /// The swings, when [`SwingRun::advance`] has come to its end, kept for whoever asks for them with
    /// [`Swing::shared`].
    #[must_use]
    pub fn keep(self) -> Swings {
        keep(&self.courses[0].config, self.swings.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with a swing of the wrong physics, whole by itself, is not believed.
    #[test]
    fn snapshots_that_do_not_follow_are_refused() -> Result<(), ParameterError> {
        let course = |density| {
            let arm = ArmParameters { arm_density: density, ..ArmParameters::default() };
            Course::new(&EpisodeConfig { arm, ..EpisodeConfig::default() }.checked()?)
        };
        let (course, heavier) = (course(1042.0)?, course(1043.0)?);
        let swing = |course: &Course| {
            let mut run = SwingRun::of(std::slice::from_ref(course))?;
            while run.advance()? {}
            Ok::<_, ParameterError>(run.swings.remove(0))
        };
        let (own, foreign) = (swing(&course)?, swing(&heavier)?);
        let folder = std::env::temp_dir().join(format!("octoarm-swing-{}", std::process::id()));
        let files = NumberFiles::in_folder(folder.clone());
        assert!(course.read(&files, &own.arm).is_none());
        course.write(&own, &files)?;
        assert_eq!(course.read(&files, &own.arm).as_ref(), Some(&own.snapshots));
        assert!(heavier.read(&files, &foreign.arm).is_none());
        course.write(&foreign, &files)?;
        assert!(files.read(&course.file_key()).is_some());
        assert!(course.read(&files, &own.arm).is_none());
        assert!(std::fs::remove_dir_all(folder).is_ok());
        Ok(())
    }
}
