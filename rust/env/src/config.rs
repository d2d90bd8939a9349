//! The settings of an episode, under the names that Python and files use.

use std::collections::BTreeMap;
use std::sync::Arc;

use octoarm_arm::{
    Actuator, ArmParameters, Interval, ParameterError, domain, read_fields, read_json,
};
use rand_core::SeedableRng;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::draw::share;
use crate::orbit::{Orbit, Target, TargetName};
use crate::reward::Reward;
use crate::senses::Disturbances;

/// Everything that `gym.make("OctoArm-v0", …)` takes, beside rendering and length.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EpisodeConfig {
    /// Limit cycle to follow; by default the quadratic one of the paper.
    pub target: Target,
    /// Largest |angle| of the target \[degrees\], in (0, 360\]. By default the paper's for a named
    /// target (its R: 90, 130 and 10 for the quadratic, Van der Pol and Lissajous cycles, Figures 6
    /// to 8) and the samples' own for samples; with a number, samples are scaled to it.
    pub amplitude: Option<f64>,
    /// Time from one action to the next \[s\], a multiple of the arm's `timestep`, at most 10 and
    /// at most 10,000 of these; by default 0.01.
    pub control_period: f64,
    /// Drive of the base; by default [`Actuator::Direct`].
    pub actuator: Actuator,
    /// Body; by default [`ArmParameters::nakajima2013`].
    pub arm: ArmParameters,
    /// Base angle of an action of 1 \[degrees\], in (0, 360\]; by default 1.3 times the amplitude.
    pub action_range: Option<f64>,
    /// Reward of an exactly tracked step, in (0, 1e6\]; by default 1.
    pub tracking_weight: f64,
    /// Tracking error at which the tracking reward has fallen to 1/e, as a fraction of the
    /// amplitude, in (0, 1e3\]; by default 0.3.
    pub reward_width: f64,
    /// Cost of a unit of squared action change, in \[0, 1e6\]; by default 0.01.
    pub action_change_weight: f64,
    /// Half width of white noise on every length that is seen \[m\], in \[0, 1\]; by default none. What
    /// is seen stays within the bounds of the observation.
    pub length_noise: f64,
    /// Half width of white noise on the commanded angles \[degrees\], drawn every control period, in
    /// \[0, 90\]; by default none.
    pub action_noise: f64,
    /// Control periods that a reading takes to the agent, at most 1000; by default none.
    pub delay: usize,
    /// Springs, drawn at every reset, whose rest length is seen in place of their length; by default
    /// none.
    pub dropout: usize,
    /// Factors on parameters of the arm, by their names: a body's own are drawn uniformly between these
    /// two, in (0, 10\]. By default none. `compartments`, `timestep`, `rest_length` and
    /// `servo_frequency` stay as they are.
    pub vary: BTreeMap<String, [f64; 2]>,
    /// Bodies that are drawn, one of which is at hand for each episode, in \[1, 256\]; by default 1,
    /// which it is without `vary`.
    pub bodies: usize,
    /// Seed of the factors: the same bodies whatever the seed of the episodes is; by default 0.
    pub body_seed: u64,
}

impl Default for EpisodeConfig {
    fn default() -> Self {
        Self {
            target: Target::Named(TargetName::Quadratic),
            amplitude: None,
            control_period: 0.01,
            actuator: Actuator::Direct,
            arm: ArmParameters::default(),
            action_range: None,
            tracking_weight: 1.0,
            reward_width: 0.3,
            action_change_weight: 0.01,
            length_noise: 0.0,
            action_noise: 0.0,
            delay: 0,
            dropout: 0,
            vary: BTreeMap::new(),
            bodies: 1,
            body_seed: 0,
        }
    }
}

/// The lead-compensated clock commands at most 1.08 times the amplitude of the three targets.
const ACTION_RANGE_PER_AMPLITUDE: f64 = 1.3;
/// Bounds of `amplitude` and `action_range` \[degrees\].
const ANGLE_LIMIT: f64 = 360.0;
const MAX_CONTROL_STEPS: f64 = 10_000.0;
const MAX_DELAY: usize = 1000;
const MAX_BODIES: usize = 256;
/// Sets the generator of bodies apart from those of episodes.
const BODIES_APART: u64 = 0x6a09_e667_f3bc_c908;
/// Parameters that are no body's own: shape and clock of what is seen and commanded.
const FIXED: [&str; 4] = ["compartments", "timestep", "rest_length", "servo_frequency"];

/// The factors that a body was drawn with, in the order of `vary`; shared with the infos of its episodes.
pub(crate) type Factors = Arc<[f64]>;

/// Settings that have been checked, with their bodies; shared, and never changed.
#[derive(Clone, Debug)]
pub struct CheckedConfig(Arc<(EpisodeConfig, Vec<ArmParameters>, Vec<Factors>)>);

impl std::ops::Deref for CheckedConfig {
    type Target = EpisodeConfig;

    fn deref(&self) -> &EpisodeConfig {
        &self.0.0
    }
}

impl CheckedConfig {
    /// The bodies that episodes are made with: that of the settings, or those drawn around it.
    #[must_use]
    pub fn drawn_bodies(&self) -> &[ArmParameters] {
        &self.0.1
    }

    /// The factors that a body was drawn with, in the order of `vary`.
    pub(crate) fn factors(&self, body: usize) -> &Factors {
        &self.0.2[body]
    }

    /// Whether both are the very same.
    pub(crate) fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl EpisodeConfig {
    /// Settings from JSON text; what is left out takes its default, and nothing is checked yet.
    ///
    /// # Errors
    /// [`ParameterError::Format`] that names the setting.
    pub fn from_json(text: &str) -> Result<Self, ParameterError> {
        read_json(text)
    }

    /// The settings as JSON text, exact to the bit.
    ///
    /// # Errors
    /// [`ParameterError::Format`] if a value has no JSON form (only possible before validation).
    pub fn to_json(&self) -> Result<String, ParameterError> {
        serde_json::to_string(self).map_err(|error| ParameterError::Format(error.to_string()))
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// [`ParameterError`] that names the setting, its value and its range.
    pub fn checked(self) -> Result<CheckedConfig, ParameterError> {
        let above = Interval::above;
        self.arm.validate()?;
        for (name, value, range) in [
            ("amplitude", self.amplitude, above(0.0, ANGLE_LIMIT)),
            ("action_range", self.action_range, above(0.0, ANGLE_LIMIT)),
            ("tracking_weight", Some(self.tracking_weight), above(0.0, 1e6)),
            ("reward_width", Some(self.reward_width), above(0.0, 1e3)),
            ("action_change_weight", Some(self.action_change_weight), Interval::closed(0.0, 1e6)),
            ("length_noise", Some(self.length_noise), Interval::closed(0.0, 1.0)),
            ("action_noise", Some(self.action_noise), Interval::closed(0.0, 90.0)),
        ] {
            value.map_or(Ok(()), |value| range.check(value, || name.to_owned()))?;
        }
        check_period(self.control_period, self.arm.timestep)?;
        check_counts(self.delay, self.dropout, &self.arm)?;
        if let Target::Samples(samples) = &self.target {
            Orbit::check_samples(samples, ANGLE_LIMIT)?;
        }
        let drawn = draw_bodies(&self.arm, &self.vary, self.bodies, self.body_seed)?;
        let factors = draw_factors(&self.vary, self.bodies, self.body_seed);
        Ok(CheckedConfig(Arc::new((self, drawn, factors))))
    }

    /// Physics steps from one action to the next.
    #[must_use]
    pub fn physics_steps(&self) -> u32 {
        whole_steps(self.control_period, self.arm.timestep)
    }

    /// Bounds of the observed spring lengths \[m\]: the domain's own.
    #[must_use]
    pub fn observation_bounds(&self) -> (f64, f64) {
        length_bounds(&self.arm)
    }

    /// What lies between the agent and the body.
    #[must_use]
    pub fn disturbances(&self) -> Disturbances {
        Disturbances {
            length_noise: self.length_noise,
            action_noise: self.action_noise,
            delay: self.delay,
            dropout: self.dropout,
            bounds: self.observation_bounds(),
            rest_length: self.arm.rest_length,
        }
    }

    /// The closed orbit to follow.
    ///
    /// # Errors
    /// [`ParameterError`] for samples that are no orbit.
    pub fn orbit(&self) -> Result<Orbit, ParameterError> {
        match &self.target {
            Target::Named(name) => {
                Ok(Orbit::named(*name, self.amplitude.unwrap_or(name.amplitude())))
            }
            Target::Samples(samples) => {
                Orbit::from_samples(samples, self.arm.timestep, self.amplitude)
            }
        }
    }

    /// Base angle of an action of 1 \[degrees\], for an orbit of the given amplitude.
    #[must_use]
    pub fn resolved_action_range(&self, amplitude: f64) -> f64 {
        self.action_range.unwrap_or(ACTION_RANGE_PER_AMPLITUDE * amplitude)
    }

    /// The reward for an orbit of the given amplitude.
    #[must_use]
    pub fn reward(&self, amplitude: f64) -> Reward {
        Reward {
            tracking_weight: self.tracking_weight,
            width: self.reward_width * amplitude,
            action_change_weight: self.action_change_weight,
        }
    }
}

/// Bounds of an arm's spring lengths \[m\]: the domain's own.
pub(crate) fn length_bounds(arm: &ArmParameters) -> (f64, f64) {
    let (low, high) = domain::SPRING_LENGTH;
    (low * arm.rest_length, high * arm.rest_length)
}

/// Physics steps in a control period.
pub(crate) fn whole_steps(control_period: f64, timestep: f64) -> u32 {
    (control_period / timestep).round() as u32
}

/// Checks a control period: a whole number of physics steps.
pub(crate) fn check_period(control_period: f64, timestep: f64) -> Result<(), ParameterError> {
    Interval::above(0.0, 10.0).check(control_period, || "control_period".to_owned())?;
    let steps = control_period / timestep;
    let whole = steps.round();
    if !(1.0..=MAX_CONTROL_STEPS).contains(&whole) || (steps - whole).abs() > 1e-6 * whole {
        let range = format!(
            "of whole multiples of arm.timestep ({timestep} s), 1 to {MAX_CONTROL_STEPS} of them"
        );
        return Err(ParameterError::out_of_range("control_period", control_period, range));
    }
    Ok(())
}

/// Checks what is counted of the disturbances.
pub(crate) fn check_counts(
    delay: usize,
    dropout: usize,
    arm: &ArmParameters,
) -> Result<(), ParameterError> {
    for (name, value, most) in
        [("delay", delay, MAX_DELAY), ("dropout", dropout, 4 * arm.compartments)]
    {
        if value > most {
            let range = format!("[0, {most}] of whole numbers");
            return Err(ParameterError::out_of_range(name, value, range));
        }
    }
    Ok(())
}

/// The parameters of every body: those of `arm`, each that varies with a factor of its own.
pub(crate) fn draw_bodies(
    arm: &ArmParameters,
    vary: &BTreeMap<String, [f64; 2]>,
    bodies: usize,
    seed: u64,
) -> Result<Vec<ArmParameters>, ParameterError> {
    let most = if vary.is_empty() { 1 } else { MAX_BODIES };
    if !(1..=most).contains(&bodies) {
        let without = if vary.is_empty() { " without vary" } else { "" };
        let range = format!("[1, {most}] of whole numbers{without}");
        return Err(ParameterError::out_of_range("bodies", bodies, range));
    }
    for (name, [low, high]) in vary {
        let entry = |index: usize| move || format!("vary.{name}[{index}]");
        Interval::above(0.0, 10.0).check(*low, entry(0))?;
        Interval::closed(*low, 10.0).check(*high, entry(1))?;
    }
    let Ok(Value::Object(nominal)) = serde_json::to_value(arm) else {
        return Err(ParameterError::Format("the body has no JSON form".to_owned()));
    };
    let lists = arm.per_compartment().map(|(name, ..)| name);
    // A number that has a point in JSON, counts have none; or one for each compartment.
    let varies = |name: &str| -> Option<&Value> {
        let value = nominal.get(name).filter(|_| !FIXED.contains(&name));
        value.filter(|value| value.is_f64() || lists.contains(&name))
    };
    let scaled = |value: &Value, factor: f64| match value {
        Value::Array(entries) => {
            entries.iter().filter_map(Value::as_f64).map(|entry| factor * entry).collect()
        }
        value => Value::from(factor * value.as_f64().unwrap_or_default()),
    };
    if let Some(name) = vary.keys().find(|name| varies(name).is_none()) {
        let known: Vec<&str> =
            nominal.keys().map(String::as_str).filter(|name| varies(name).is_some()).collect();
        let range = format!("of numbers of the body: {}", known.join(", "));
        return Err(ParameterError::out_of_range("vary", format!("{name:?}"), range));
    }
    let body = |factors: Factors| {
        let mut drawn = nominal.clone();
        for (name, factor) in vary.keys().zip(factors.iter()) {
            drawn.insert(name.clone(), scaled(&nominal[name], *factor));
        }
        let drawn: ArmParameters = read_fields(Value::Object(drawn))?;
        drawn.validate()?;
        Ok(drawn)
    };
    draw_factors(vary, bodies, seed).into_iter().map(body).collect()
}

/// The factors of every body, in the order of `vary`.
pub(crate) fn draw_factors(
    vary: &BTreeMap<String, [f64; 2]>,
    bodies: usize,
    seed: u64,
) -> Vec<Factors> {
    let mut generator = Pcg64::seed_from_u64(seed ^ BODIES_APART);
    let mut draw = |[low, high]: &[f64; 2]| low + (high - low) * share(&mut generator);
    (0..bodies).map(|_| vary.values().map(&mut draw).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_settings_are_named() {
        let bad = [
            (r#"{"amplitude": -3.0}"#, "amplitude = -3"),
            (r#"{"control_period": 0.0105}"#, "control_period = 0.0105"),
            (r#"{"control_period": 0.0}"#, "control_period = 0"),
            (r#"{"reward_width": 0.0}"#, "reward_width"),
            (r#"{"length_noise": -1e-5}"#, "length_noise = -0.00001"),
            (r#"{"action_noise": 91.0}"#, "action_noise = 91"),
            (r#"{"delay": 1001}"#, "delay = 1001"),
            (r#"{"delay": -1}"#, "delay"),
            (r#"{"dropout": 81}"#, "dropout = 81"),
            (r#"{"bodies": 2}"#, "bodies = 2"),
            (r#"{"bodies": 0, "vary": {"arm_density": [0.9, 1.1]}}"#, "bodies = 0"),
            (r#"{"bodies": 257, "vary": {"arm_density": [0.9, 1.1]}}"#, "bodies = 257"),
            (r#"{"vary": {"arm_density": [0.0, 1.1]}}"#, "vary.arm_density[0] = 0"),
            (r#"{"vary": {"arm_density": [1.1, 0.9]}}"#, "vary.arm_density[1] = 0.9"),
            (r#"{"vary": {"arm_density": [1.0]}}"#, "vary.arm_density"),
            (
                r#"{"vary": {"colour": [1.0, 1.1]}}"#,
                "vary = \"colour\" is outside the allowed range of numbers of the body: area_scale, ",
            ),
            (r#"{"vary": {"timestep": [1.0, 1.1]}}"#, "vary = \"timestep\""),
            (r#"{"vary": {"gravity": [1.0, 1.1]}}"#, "vary = \"gravity\""),
            (r#"{"vary": {"compartments": [1.0, 2.0]}}"#, "vary = \"compartments\""),
            (r#"{"vary": {"longitudinal_mass_share": [5.0, 6.0]}}"#, "longitudinal_mass_share = "),
            (r#"{"target": [[0.0, 1.0]]}"#, "target"),
            (r#"{"target": "square"}"#, "target: "),
            (r#"{"arm": {"area_scale": "big"}}"#, "arm.area_scale: invalid type"),
            (r#"{"arm": {"timestep": -1.0}}"#, "timestep = -1"),
            (r#"{"colour": 1}"#, "colour"),
        ];
        for (text, expected) in bad {
            let config = EpisodeConfig::from_json(text).and_then(EpisodeConfig::checked);
            let message = config.expect_err(text).to_string();
            assert!(message.contains(expected), "{text}: {message}");
        }
    }

    #[test]
    fn bodies_are_drawn_between_the_factors() {
        let text = |seed: u64| {
            format!(
                r#"{{"bodies": 50, "body_seed": {seed},
                    "vary": {{"longitudinal_stiffness": [0.5, 2.0], "arm_density": [0.9, 1.0]}}}}"#
            )
        };
        let bodies = |seed: u64| -> Vec<ArmParameters> {
            let config = EpisodeConfig::from_json(&text(seed)).expect("settings");
            let checked = config.checked().expect("valid");
            checked.drawn_bodies().to_vec()
        };
        let drawn = bodies(0);
        assert_eq!(drawn.len(), 50);
        let nominal = ArmParameters::default();
        let factors: Vec<f64> = drawn
            .iter()
            .map(|arm| arm.longitudinal_stiffness.at(0) / nominal.longitudinal_stiffness.at(0))
            .collect();
        assert!(factors.iter().all(|factor| (0.5..=2.0).contains(factor)), "{factors:?}");
        assert!(factors.iter().any(|factor| *factor < 0.7), "{factors:?}");
        assert!(factors.iter().any(|factor| *factor > 1.8), "{factors:?}");
        for arm in &drawn {
            assert!((0.9..=1.0).contains(&(arm.arm_density / nominal.arm_density)));
            let longitudinal_stiffness = nominal.longitudinal_stiffness.clone();
            let arm_density = nominal.arm_density;
            let same = ArmParameters { longitudinal_stiffness, arm_density, ..arm.clone() };
            assert_eq!(same, nominal);
        }
        assert_eq!(bodies(0), drawn);
        assert_ne!(bodies(1), drawn);
        let plain = EpisodeConfig::default().checked().expect("valid");
        assert_eq!(plain.drawn_bodies(), [nominal]);
    }

    #[test]
    fn a_factor_is_of_every_entry_of_a_list() {
        let text = r#"{"arm": {"compartments": 3, "transverse_damping": [0.5, 1.0, 2.0]},
            "bodies": 20, "vary": {"transverse_damping": [0.5, 2.0]}}"#;
        let config = EpisodeConfig::from_json(text).expect("settings").checked().expect("valid");
        let first = |arm: &ArmParameters| arm.transverse_damping.at(0);
        for arm in config.drawn_bodies() {
            let factor = first(arm) / 0.5;
            assert!((0.5..=2.0).contains(&factor), "{factor}");
            // 0.5, 1 and 2 are powers of 2: nothing is rounded.
            assert_eq!(arm.transverse_damping, vec![0.5 * factor, factor, 2.0 * factor].into());
        }
        let drawn = config.drawn_bodies();
        assert!(drawn.iter().any(|arm| first(arm) != first(&drawn[0])));
    }

    #[test]
    fn json_round_trip_is_exact() {
        let config = EpisodeConfig { amplitude: Some(1.0 / 3.0), ..EpisodeConfig::default() };
        let text = config.to_json().expect("json");
        assert_eq!(EpisodeConfig::from_json(&text).expect("parse"), config);
    }
}
