//! Closed orbits of the base angles: the paper's limit cycles and a user's own.

use octoarm_arm::transcendental::sin_cos;
use octoarm_arm::{Interval, ParameterError, memory, poll};
use serde::{Deserialize, Serialize};

/// Time of the oscillators per second of the arm: 0.01 a step of 1 ms (section 2.2.2).
const OSCILLATOR_RATE: f64 = 10.0;
/// Entries of the table of a named orbit.
const TABLE: usize = 2048;
/// Oscillator time of a physics step (section 2.2.2).
const TIME_PER_STEP: f64 = 0.01;
/// Where the oscillators start: on the cycle they would throw a resting base by the whole amplitude
/// within one physics step.
const START: [f64; 2] = [0.01, 0.01];
/// Step of the oscillators' integration, in their own time.
const FINE_STEP: f64 = 1e-3;
/// How long an oscillator runs before it counts as on its cycle; the slower of the two contracts by
/// e^{-5} or better each turn.
const TRANSIENT: f64 = 100.0;
/// Fewest samples of a user's orbit: cubic interpolation takes four.
const FEWEST_SAMPLES: usize = 4;
const MOST_SAMPLES: usize = 1_000_000;

/// The limit cycles of the paper, section 2.2.2.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TargetName {
    /// The quadratic limit cycle, Eq. 28.
    Quadratic,
    /// The Van der Pol oscillator, Eq. 27.
    VanDerPol,
    /// Eq. 29 with f1 = 2, f2 = 1.
    Lissajous,
}

impl TargetName {
    /// The paper's amplitude R \[degrees\], Figures 6 to 8.
    #[must_use]
    pub fn amplitude(self) -> f64 {
        match self {
            Self::Quadratic => 90.0,
            Self::VanDerPol => 130.0,
            Self::Lissajous => 10.0,
        }
    }
}

/// What the base shall follow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Target {
    /// One of the paper's limit cycles.
    Named(TargetName),
    /// One period of (θ, φ) in degrees, one row a physics step.
    Samples(Vec<[f64; 2]>),
}

/// A closed orbit as a function of phase, by cubic interpolation in a table over one period.
#[derive(Clone, Debug, PartialEq)]
pub struct Orbit {
    table: Vec<[f64; 2]>,
    period: f64,
    amplitude: f64,
}

fn van_der_pol(x: [f64; 2]) -> [f64; 2] {
    [x[1], (1.0 - x[0] * x[0]) * x[1] - x[0]]
}

fn quadratic(x: [f64; 2]) -> [f64; 2] {
    let square = x[0] * x[0] + x[1] * x[1];
    [x[0] + x[1] - 5.0 * x[0] * square, -2.0 * x[0] + x[1] - x[1] * square]
}

fn runge_kutta(slope: fn([f64; 2]) -> [f64; 2], x: [f64; 2], dt: f64) -> [f64; 2] {
    let along = |k: [f64; 2], h: f64| [x[0] + h * k[0], x[1] + h * k[1]];
    let k1 = slope(x);
    let k2 = slope(along(k1, 0.5 * dt));
    let k3 = slope(along(k2, 0.5 * dt));
    let k4 = slope(along(k3, dt));
    let sum = |i: usize| k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i];
    [x[0] + dt / 6.0 * sum(0), x[1] + dt / 6.0 * sum(1)]
}

/// One turn of an oscillator's limit cycle from its upward crossing of x1 = 0, and the turn's time.
fn cycle(slope: fn([f64; 2]) -> [f64; 2]) -> (Vec<[f64; 2]>, f64) {
    // Runs to the next upward crossing; the last step is shortened onto it by Newton's rule.
    let to_crossing = |mut x: [f64; 2]| {
        let mut time = 0.0;
        loop {
            let next = runge_kutta(slope, x, FINE_STEP);
            if x[0] < 0.0 && next[0] >= 0.0 {
                let mut dt = FINE_STEP * x[0] / (x[0] - next[0]);
                for _ in 0..8 {
                    let there = runge_kutta(slope, x, dt);
                    dt -= there[0] / slope(there)[0];
                }
                return (runge_kutta(slope, x, dt), time + dt);
            }
            x = next;
            time += FINE_STEP;
        }
    };
    let mut x = START;
    for _ in 0..(TRANSIENT / FINE_STEP) as usize {
        x = runge_kutta(slope, x, FINE_STEP);
    }
    let (start, _) = to_crossing(x);
    // A step away from the start, which rounding may have left on either side of x1 = 0.
    let (_, period) = to_crossing(runge_kutta(slope, start, FINE_STEP));
    let period = period + FINE_STEP;
    let substeps = 8;
    let dt = period / (TABLE * substeps) as f64;
    let mut x = start;
    let mut table = Vec::with_capacity(TABLE);
    for _ in 0..TABLE {
        table.push(x);
        for _ in 0..substeps {
            x = runge_kutta(slope, x, dt);
        }
    }
    (table, period)
}

fn slope_of(name: TargetName) -> Option<fn([f64; 2]) -> [f64; 2]> {
    match name {
        TargetName::Quadratic => Some(quadratic),
        TargetName::VanDerPol => Some(van_der_pol),
        TargetName::Lissajous => None,
    }
}

/// Eq. 29 with f1 = 2, f2 = 1.
fn lissajous(time: f64) -> [f64; 2] {
    [sin_cos(2.0 * time).0, sin_cos(time).0]
}

/// One turn of a cycle in its own units, and its time.
fn turn(name: TargetName) -> (Vec<[f64; 2]>, f64) {
    match slope_of(name) {
        Some(slope) => cycle(slope),
        None => {
            let turn = std::f64::consts::TAU;
            ((0..TABLE).map(|k| lissajous(turn * k as f64 / TABLE as f64)).collect(), turn)
        }
    }
}

fn largest(table: &[[f64; 2]]) -> f64 {
    table.iter().flatten().fold(0.0, |most: f64, value| most.max(value.abs()))
}

impl Orbit {
    /// One of the paper's limit cycles, scaled so that the variable with the larger range reaches
    /// `amplitude` degrees (section 2.2.2).
    #[must_use]
    pub fn named(name: TargetName, amplitude: f64) -> Self {
        let (table, period) = turn(name);
        Self::scaled(table, period / OSCILLATOR_RATE, amplitude)
    }

    /// One of the paper's limit cycles as the teacher gives it, one row a step of 1 ms: the
    /// oscillators integrated by the fourth-order Runge–Kutta method at 0.01 a step from near the
    /// origin, the Lissajous curve from its origin, scaled as [`Orbit::named`] \[degrees\].
    ///
    /// # Errors
    /// [`ParameterError::Memory`] and [`ParameterError::Interrupted`].
    pub fn teacher_signal(
        name: TargetName,
        amplitude: f64,
        steps: usize,
    ) -> Result<Vec<[f64; 2]>, ParameterError> {
        let scale = amplitude / largest(&turn(name).0);
        let mut signal = memory::reserved(&format!("a signal of {steps} steps"), Some(steps))?;
        let mut x = START;
        for step in 0..steps {
            if step % 1024 == 0 {
                poll()?;
            }
            let now = match slope_of(name) {
                Some(slope) => {
                    let now = x;
                    x = runge_kutta(slope, x, TIME_PER_STEP);
                    now
                }
                None => lissajous(TIME_PER_STEP * step as f64),
            };
            signal.push(now.map(|value| scale * value));
        }
        Ok(signal)
    }

    /// A user's orbit: one period, one row every `interval` seconds, degrees; scaled to `amplitude`
    /// if there is one.
    ///
    /// # Errors
    /// [`ParameterError`] as [`Orbit::check_samples`].
    pub fn from_samples(
        samples: &[[f64; 2]],
        interval: f64,
        amplitude: Option<f64>,
    ) -> Result<Self, ParameterError> {
        Self::check_samples(samples, f64::MAX)?;
        let own = largest(samples);
        let period = interval * samples.len() as f64;
        Ok(Self::scaled(samples.to_vec(), period, amplitude.unwrap_or(own)))
    }

    fn scaled(mut table: Vec<[f64; 2]>, period: f64, amplitude: f64) -> Self {
        let scale = amplitude / largest(&table);
        for value in table.iter_mut().flatten() {
            *value *= scale;
        }
        Self { table, period, amplitude }
    }

    /// Whether samples can be an orbit: enough of them, finite, within ±`limit` degrees, not all 0.
    ///
    /// # Errors
    /// [`ParameterError`] naming `target`.
    pub fn check_samples(samples: &[[f64; 2]], limit: f64) -> Result<(), ParameterError> {
        if !(FEWEST_SAMPLES..=MOST_SAMPLES).contains(&samples.len()) {
            let expected = format!("(T, 2) with T from {FEWEST_SAMPLES} to {MOST_SAMPLES}");
            let found = format!("({}, 2)", samples.len());
            return Err(ParameterError::shape("target", found, expected));
        }
        for (row, values) in samples.iter().enumerate() {
            for (column, value) in values.iter().enumerate() {
                let range = Interval::within(limit).of("degrees");
                range.check(*value, || format!("target[{row}, {column}]"))?;
            }
        }
        if largest(samples) == 0.0 {
            return Err(ParameterError::out_of_range("target", "all zeros", "of orbits that move"));
        }
        Ok(())
    }

    /// Time of one turn \[s\].
    #[must_use]
    pub fn period(&self) -> f64 {
        self.period
    }

    /// Largest |angle| \[degrees\].
    #[must_use]
    pub fn amplitude(&self) -> f64 {
        self.amplitude
    }

    /// One period at equal intervals \[degrees\].
    #[must_use]
    pub fn table(&self) -> &[[f64; 2]] {
        &self.table
    }

    /// θ, φ \[degrees\] at `time` seconds, by cubic interpolation through the four nearest samples.
    #[must_use]
    pub fn at(&self, time: f64) -> [f64; 2] {
        let n = self.table.len();
        let turns = time / self.period;
        let position = (turns - turns.floor()) * n as f64;
        // Rounding may carry the position to n itself.
        let index = (position as usize).min(n - 1);
        let x = position - index as f64;
        let row = |offset: usize| self.table[(index + n + offset - 1) % n];
        let weights = [
            -x * (x - 1.0) * (x - 2.0) / 6.0,
            (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
            -(x + 1.0) * x * (x - 2.0) / 2.0,
            (x + 1.0) * x * (x - 1.0) / 6.0,
        ];
        let mut sum = [0.0; 2];
        for (offset, weight) in weights.into_iter().enumerate() {
            let row = row(offset);
            sum[0] += weight * row[0];
            sum[1] += weight * row[1];
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lissajous_is_the_formula() {
        let orbit = Orbit::named(TargetName::Lissajous, 30.0);
        for k in 0..1000 {
            let time = f64::from(k) * 1.7e-3;
            let [theta, phi] = orbit.at(time);
            // Cubic interpolation: h⁴ 9/384 of the fourth derivative, 16 × 30 degrees.
            assert!((theta - 30.0 * (20.0 * time).sin()).abs() < 2e-8);
            assert!((phi - 30.0 * (10.0 * time).sin()).abs() < 2e-8);
        }
    }

    #[test]
    fn van_der_pol_has_its_known_period_and_amplitude() {
        // At μ = 1 the period is 6.663286859…, the largest x1 2.008619860….
        let orbit = Orbit::named(TargetName::VanDerPol, 1.0);
        assert!((orbit.period() * OSCILLATOR_RATE - 6.663_286_859_323).abs() < 1e-9);
        let (table, _) = cycle(van_der_pol);
        let reach = table.iter().fold(0.0_f64, |most, x| most.max(x[0]));
        // The table's nearest entry may miss the crest by the square of half its spacing.
        assert!((reach - 2.008_619_860).abs() < 1e-5, "{reach}");
    }

    #[test]
    fn orbits_close_and_solve_their_equation() {
        for (name, slope) in [
            (TargetName::VanDerPol, van_der_pol as fn([f64; 2]) -> [f64; 2]),
            (TargetName::Quadratic, quadratic),
        ] {
            let (table, period) = cycle(slope);
            let dt = period / TABLE as f64;
            let last = runge_kutta(slope, table[TABLE - 1], dt);
            assert!((last[0] - table[0][0]).abs() < 1e-8 && (last[1] - table[0][1]).abs() < 1e-8);
            let orbit = Orbit::named(name, 25.0);
            assert!((largest(orbit.table()) - 25.0).abs() < 1e-12);
            // The paper's own integration, 0.01 a millisecond, stays on the orbit for a turn.
            let scale = 25.0 / largest(&table);
            let mut x = table[0];
            for step in 0..600 {
                let [theta, phi] = orbit.at(f64::from(step) * 1e-3);
                assert!((theta - scale * x[0]).abs() < 1e-5 && (phi - scale * x[1]).abs() < 1e-5);
                x = runge_kutta(slope, x, 0.01);
            }
        }
    }

    #[test]
    fn samples_are_interpolated_through_their_points() {
        let samples: Vec<[f64; 2]> =
            (0..50).map(|k| [10.0 * (0.125 * f64::from(k)).sin(), f64::from(k % 7)]).collect();
        let orbit = Orbit::from_samples(&samples, 1e-3, None).expect("orbit");
        for (k, sample) in samples.iter().enumerate() {
            let value = orbit.at(k as f64 * 1e-3 + 0.05);
            assert!((value[0] - sample[0]).abs() < 1e-9 && (value[1] - sample[1]).abs() < 1e-9);
        }
    }
}
