//! What lies between the agent and the body: noise, delay, springs that are not seen.

use std::collections::VecDeque;
use std::sync::Arc;

use octoarm_arm::{Interval, ParameterError};
use rand_core::SeedableRng;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::draw::{choose, share};

/// Sets the generator of disturbances apart from that of phases, which has the same seed.
const APART: u64 = 0x9e37_79b9_7f4a_7c15;

/// What lies between the agent and the body, as the settings have it.
#[derive(Clone, Copy, Debug)]
pub struct Disturbances {
    /// Half width of white noise on every length that is seen \[m\].
    pub length_noise: f64,
    /// Half width of white noise on the commanded angles \[degrees\].
    pub action_noise: f64,
    /// Control periods that a reading takes.
    pub delay: usize,
    /// Springs whose rest length is seen in place of their length.
    pub dropout: usize,
    /// Bounds of what is seen \[m\].
    pub bounds: (f64, f64),
    /// What is seen of a spring that is not \[m\].
    pub rest_length: f64,
}

impl Disturbances {
    /// Whether there are any.
    fn any(&self) -> bool {
        self.length_noise > 0.0 || self.action_noise > 0.0 || self.delay > 0 || self.dropout > 0
    }
}

/// What lies between the agent and the body after a reset or a step, for who looks from outside; only what
/// the settings ask for is there.
#[derive(Clone, Debug, PartialEq)]
pub struct DisturbanceInfo {
    /// Factors on the parameters of the arm that vary, in the alphabetical order of their names.
    body_factors: Option<Arc<[f64]>>,
    /// What was added to the angles that the action commands \[degrees\]; 0 after a reset.
    action_noise: Option<[f64; 2]>,
    /// Lengths of all springs as they are \[m\].
    true_lengths: Option<Vec<f64>>,
    /// Which springs are not seen in this episode.
    dropped: Option<Vec<bool>>,
    /// Control periods that a reading takes.
    delay: Option<usize>,
}

/// A part of a [`DisturbanceInfo`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Told<'a> {
    /// Numbers.
    Numbers(&'a [f64]),
    /// Flags.
    Flags(&'a [bool]),
    /// A count.
    Count(usize),
}

/// How a part is read; none where the settings do not ask for it.
pub type Part = fn(&DisturbanceInfo) -> Option<Told<'_>>;

impl DisturbanceInfo {
    /// Of an episode with such senses, whose body is the nominal one times `factors`; none of one that is
    /// not disturbed, and then nothing is asked for the lengths \[m\].
    pub(crate) fn of(
        senses: Option<&Senses>,
        disturbances: &Disturbances,
        factors: &Arc<[f64]>,
        lengths: &dyn Fn() -> Vec<f64>,
    ) -> Option<Box<Self>> {
        if senses.is_none() && factors.is_empty() {
            return None;
        }
        let Disturbances { length_noise, action_noise, delay, dropout, .. } = *disturbances;
        let unseen = |senses: &Senses| {
            (0..lengths().len()).map(|spring| senses.unseen.contains(&spring)).collect()
        };
        Some(Box::new(Self {
            body_factors: (!factors.is_empty()).then(|| Arc::clone(factors)),
            action_noise: senses.filter(|_| action_noise > 0.0).map(|senses| senses.noise),
            true_lengths: (length_noise > 0.0 || delay > 0 || dropout > 0).then(lengths),
            dropped: senses.filter(|_| dropout > 0).map(unseen),
            delay: (delay > 0).then_some(delay),
        }))
    }

    /// The parts, each under its key in Python's `info`; only what there is.
    pub const PARTS: [(&'static str, Part); 5] = [
        ("body_factors", |told| told.body_factors.as_deref().map(Told::Numbers)),
        ("action_noise", |told| told.action_noise.as_ref().map(|noise| Told::Numbers(noise))),
        ("true_lengths", |told| told.true_lengths.as_deref().map(Told::Numbers)),
        ("dropped", |told| told.dropped.as_deref().map(Told::Flags)),
        ("delay", |told| told.delay.map(Told::Count)),
    ];
}

/// The disturbances of an episode, and the readings that are on their way to the agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Senses {
    generator: Pcg64,
    /// Springs that are not seen in this episode.
    unseen: Vec<usize>,
    /// What was added to the last command \[degrees\].
    #[serde(default)]
    noise: [f64; 2],
    /// The last readings \[m\], the one that the agent has now first; none before the first.
    readings: VecDeque<Vec<f64>>,
}

/// A number in [−1, 1).
fn draw(generator: &mut Pcg64) -> f64 {
    2.0 * share(generator) - 1.0
}

impl Senses {
    /// Those that the settings ask for; most ask for none.
    pub(crate) fn of(disturbances: &Disturbances) -> Option<Self> {
        let generator = Pcg64::seed_from_u64(APART);
        disturbances.any().then(|| Self {
            generator,
            unseen: Vec::new(),
            noise: [0.0; 2],
            readings: VecDeque::new(),
        })
    }

    /// Memory of an episode's readings that are on their way, rounded up \[bytes\].
    #[must_use]
    pub fn bytes(disturbances: &Disturbances, springs: usize) -> usize {
        let reading = springs.saturating_mul(size_of::<f64>()).saturating_add(64);
        Self::of(disturbances)
            .map_or(0, |_| disturbances.delay.saturating_add(2).saturating_mul(reading))
    }

    pub(crate) fn seed(&mut self, seed: u64) {
        self.generator = Pcg64::seed_from_u64(seed ^ APART);
    }

    /// A new episode begins: what was read before is forgotten.
    pub(crate) fn begin(&mut self) {
        self.readings.clear();
        self.noise = [0.0; 2];
    }

    /// What the base is commanded \[degrees\] in place of what the agent wants.
    pub(crate) fn disturb(&mut self, disturbances: &Disturbances, command: [f64; 2]) -> [f64; 2] {
        if disturbances.action_noise == 0.0 {
            return command;
        }
        self.noise = [0; 2].map(|_| disturbances.action_noise * draw(&mut self.generator));
        [command[0] + self.noise[0], command[1] + self.noise[1]]
    }

    /// Takes the lengths \[m\] of all springs, and gives what the agent sees in their place. At the begin
    /// of an episode the arm has stood for as long as a reading takes.
    pub(crate) fn see(&mut self, disturbances: &Disturbances, lengths: &mut [f64]) {
        let count = if self.readings.is_empty() {
            let mut springs: Vec<usize> = (0..lengths.len()).collect();
            self.unseen.clear();
            for _ in 0..disturbances.dropout.min(lengths.len()) {
                let spring = choose(&mut self.generator, springs.len());
                self.unseen.push(springs.swap_remove(spring));
            }
            disturbances.delay + 1
        } else {
            self.readings.pop_front();
            1
        };
        for _ in 0..count {
            let reading = self.reading(disturbances, lengths);
            self.readings.push_back(reading);
        }
        self.show(lengths);
    }

    fn reading(&mut self, disturbances: &Disturbances, lengths: &[f64]) -> Vec<f64> {
        let mut reading = lengths.to_vec();
        if disturbances.length_noise > 0.0 {
            let (low, high) = disturbances.bounds;
            for length in &mut reading {
                let noisy = *length + disturbances.length_noise * draw(&mut self.generator);
                *length = noisy.clamp(low, high);
            }
        }
        for spring in &self.unseen {
            reading[*spring] = disturbances.rest_length;
        }
        reading
    }

    /// What the agent has seen last, if it has seen anything.
    pub(crate) fn show(&self, lengths: &mut [f64]) {
        if let Some(reading) = self.readings.front() {
            lengths.copy_from_slice(reading);
        }
    }

    /// Checks what was saved of an arm with so many springs.
    pub(crate) fn check(
        saved: Option<&Self>,
        disturbances: &Disturbances,
        springs: usize,
    ) -> Result<(), ParameterError> {
        let refuse = |value: &str, range: &str| {
            Err(ParameterError::out_of_range("senses", value.to_owned(), range))
        };
        let Some(saved) = saved else {
            return match Self::of(disturbances) {
                None => Ok(()),
                Some(_) => refuse("none", "of states with disturbances"),
            };
        };
        if Self::of(disturbances).is_none() {
            return refuse("some", "of states without disturbances");
        }
        if saved.unseen.len() > springs || saved.unseen.iter().any(|spring| *spring >= springs) {
            return refuse("springs that there are not", "of the arm's springs");
        }
        for (axis, noise) in saved.noise.into_iter().enumerate() {
            Interval::within(disturbances.action_noise)
                .of("degrees")
                .check(noise, || format!("senses.noise[{axis}]"))?;
        }
        let count = saved.readings.len();
        if count != 0 && count != disturbances.delay + 1 {
            return refuse(&format!("{count} readings"), "of one more than the delay");
        }
        let (low, high) = disturbances.bounds;
        for reading in &saved.readings {
            if reading.len() != springs {
                return refuse(
                    &format!("a reading of {} springs", reading.len()),
                    "of all springs",
                );
            }
            for length in reading {
                Interval::closed(low, high)
                    .of("m")
                    .check(*length, || "senses.readings".to_owned())?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: Disturbances = Disturbances {
        length_noise: 0.0,
        action_noise: 0.0,
        delay: 0,
        dropout: 0,
        bounds: (0.001, 0.06),
        rest_length: 0.02,
    };

    fn senses(disturbances: Disturbances) -> (Disturbances, Senses) {
        let mut senses = Senses::of(&disturbances).expect("some");
        senses.seed(1);
        (disturbances, senses)
    }

    #[test]
    fn most_have_none() {
        assert_eq!(Senses::of(&NONE), None);
    }

    #[test]
    fn draws_fill_their_interval() {
        let mut generator = Pcg64::seed_from_u64(0);
        let drawn: Vec<f64> = (0..20_000).map(|_| draw(&mut generator)).collect();
        assert!(drawn.iter().all(|value| (-1.0..1.0).contains(value)));
        let mean = drawn.iter().sum::<f64>() / 20_000.0;
        let square = drawn.iter().map(|value| value * value).sum::<f64>() / 20_000.0;
        // Their standard errors are 0.004 and 0.002.
        assert!(mean.abs() < 0.02 && (square - 1.0 / 3.0).abs() < 0.01, "{mean} {square}");
    }

    #[test]
    fn a_reading_takes_its_time() {
        let (config, mut senses) = senses(Disturbances { delay: 2, ..NONE });
        for (number, seen) in [(1.0, 1.0), (2.0, 1.0), (3.0, 1.0), (4.0, 2.0), (5.0, 3.0)] {
            let mut lengths = [number * 0.01; 80];
            senses.see(&config, &mut lengths);
            assert_eq!(lengths, [seen * 0.01; 80]);
            let mut again = [0.0; 80];
            senses.show(&mut again);
            assert_eq!(again, lengths);
        }
        senses.begin();
        let mut lengths = [0.09; 80];
        senses.see(&config, &mut lengths);
        assert_eq!(lengths, [0.09; 80]);
    }

    #[test]
    fn noise_and_springs_that_are_not_seen() {
        let (config, mut senses) = senses(Disturbances { length_noise: 1e-5, dropout: 7, ..NONE });
        let mut before = Vec::new();
        for _ in 0..2 {
            senses.begin();
            for _ in 0..3 {
                let mut lengths = [0.021; 80];
                senses.see(&config, &mut lengths);
                let unseen: Vec<usize> =
                    (0..80).filter(|spring| lengths[*spring] == config.rest_length).collect();
                assert_eq!(unseen.len(), 7);
                let mut named = senses.unseen.clone();
                named.sort_unstable();
                assert_eq!(unseen, named);
                let off = |length: &f64| (length - 0.021).abs();
                let noisy: Vec<f64> = lengths.iter().map(off).filter(|off| *off < 5e-4).collect();
                assert_eq!(noisy.len(), 73);
                assert!(
                    noisy.iter().all(|off| *off <= 1e-5) && noisy.iter().any(|off| *off > 8e-6)
                );
            }
            assert_ne!(senses.unseen, before);
            before.clone_from(&senses.unseen);
        }
    }

    #[test]
    fn commands_are_disturbed_by_so_much() {
        let (config, mut senses) = senses(Disturbances { action_noise: 5.0, ..NONE });
        let off: Vec<f64> =
            (0..1000).flat_map(|_| senses.disturb(&config, [30.0, -30.0])).collect();
        assert!(off.iter().all(|angle| (angle.abs() - 30.0).abs() <= 5.0));
        assert!(off.iter().any(|angle| angle.abs() > 34.9));
    }

    #[test]
    fn states_that_do_not_fit_are_refused() {
        let (config, mut senses) = senses(Disturbances { delay: 1, ..NONE });
        let plain = NONE;
        let check = |saved: Option<&Senses>, config: &Disturbances| {
            Senses::check(saved, config, 80).map_err(|error| error.to_string())
        };
        assert_eq!(check(Some(&senses), &config), Ok(()));
        senses.see(&config, &mut [0.02; 80]);
        assert_eq!(check(Some(&senses), &config), Ok(()));
        assert_eq!(check(None, &plain), Ok(()));
        assert!(check(None, &config).is_err());
        assert!(check(Some(&senses), &plain).is_err());
        for change in [
            (|senses| senses.unseen.push(80)) as fn(&mut Senses),
            |senses| senses.readings[0].push(0.02),
            |senses| senses.readings[0][3] = f64::NAN,
            |senses| senses.readings[1][3] = 7.0,
            |senses| drop(senses.readings.pop_front()),
            |senses| senses.noise[1] = 0.1,
        ] {
            let mut bad = senses.clone();
            change(&mut bad);
            assert!(check(Some(&bad), &config).expect_err("bad").contains("senses"));
        }
    }
}
