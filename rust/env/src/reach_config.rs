//! The settings of reaching, under the names that Python and files use.

use std::collections::BTreeMap;

use octoarm_arm::{ArmParameters, Interval, ParameterError, read_json};
use serde::{Deserialize, Serialize};

use crate::config::{check_counts, check_period, draw_bodies, length_bounds, whole_steps};
use crate::senses::Disturbances;

/// Groups of muscles in a segment: the longitudinal ones of the four sides, and the transverse ones.
pub const MUSCLES: usize = 5;

/// Reward of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReachReward {
    /// 0 within the threshold, else −1.
    Sparse,
    /// Minus the distance \[m\].
    Dense,
}

/// Everything that `gym.make("OctoArmReach-v0", …)` takes, beside goals, rendering and length.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReachConfig {
    /// Body; by default [`ArmParameters::nakajima2013`].
    pub arm: ArmParameters,
    /// Time from one action to the next \[s\], as in [`crate::EpisodeConfig`]; by default 0.05.
    pub control_period: f64,
    /// Parts along the arm whose muscles act as one, from 1 to the number of compartments; by default 5.
    pub segments: usize,
    /// Force of a fully active muscle at the arm's base \[N\], in (0, 100\]; by default 1. Along the arm
    /// it falls as the cross-section does: the stress is the same.
    pub max_force: f64,
    /// Time constant with which the activation follows the action \[s\], in (0, 10\]; by default 0.1.
    pub activation_time: f64,
    /// Distance from the goal at which it counts as reached \[m\], in (0, 1\]; by default 0.02.
    pub distance_threshold: f64,
    /// Reward of a step; by default [`ReachReward::Sparse`].
    pub reward_type: ReachReward,
    /// Whether the agent sees, after the lengths, how fast they have changed in the last control period
    /// on average \[m/s\]; by default not.
    pub observe_rates: bool,
    /// As in [`crate::EpisodeConfig`].
    pub length_noise: f64,
    /// As in [`crate::EpisodeConfig`].
    pub delay: usize,
    /// As in [`crate::EpisodeConfig`].
    pub dropout: usize,
    /// As in [`crate::EpisodeConfig`].
    pub vary: BTreeMap<String, [f64; 2]>,
    /// As in [`crate::EpisodeConfig`].
    pub bodies: usize,
    /// As in [`crate::EpisodeConfig`].
    pub body_seed: u64,
}

impl Default for ReachConfig {
    fn default() -> Self {
        Self {
            arm: ArmParameters::default(),
            control_period: 0.05,
            segments: 5,
            max_force: 1.0,
            activation_time: 0.1,
            distance_threshold: 0.02,
            reward_type: ReachReward::Sparse,
            observe_rates: false,
            length_noise: 0.0,
            delay: 0,
            dropout: 0,
            vary: BTreeMap::new(),
            bodies: 1,
            body_seed: 0,
        }
    }
}

impl ReachConfig {
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

    /// Checks every setting, and gives the parameters of the bodies that are drawn.
    ///
    /// # Errors
    /// [`ParameterError`] that names the setting, its value and its range.
    pub fn drawn_bodies(&self) -> Result<Vec<ArmParameters>, ParameterError> {
        let above = Interval::above;
        self.arm.validate()?;
        for (name, value, range) in [
            ("max_force", self.max_force, above(0.0, 100.0)),
            ("activation_time", self.activation_time, above(0.0, 10.0)),
            ("distance_threshold", self.distance_threshold, above(0.0, 1.0)),
            ("length_noise", self.length_noise, Interval::closed(0.0, 1.0)),
        ] {
            range.check(value, || name.to_owned())?;
        }
        let most = self.arm.compartments;
        if !(1..=most).contains(&self.segments) {
            let range = format!("[1, {most}] of whole numbers");
            return Err(ParameterError::out_of_range("segments", self.segments, range));
        }
        check_period(self.control_period, self.arm.timestep)?;
        check_counts(self.delay, self.dropout, &self.arm)?;
        draw_bodies(&self.arm, &self.vary, self.bodies, self.body_seed)
    }

    /// Muscles that an action commands: [`MUSCLES`] of every segment.
    #[must_use]
    pub fn muscles(&self) -> usize {
        MUSCLES * self.segments
    }

    /// Physics steps from one action to the next.
    #[must_use]
    pub fn physics_steps(&self) -> u32 {
        whole_steps(self.control_period, self.arm.timestep)
    }

    /// What lies between the agent and the body; the muscles are commanded without noise.
    #[must_use]
    pub fn disturbances(&self) -> Disturbances {
        Disturbances {
            length_noise: self.length_noise,
            action_noise: 0.0,
            delay: self.delay,
            dropout: self.dropout,
            bounds: self.observation_bounds(),
            rest_length: self.arm.rest_length,
        }
    }

    /// Bounds of the observed spring lengths \[m\]: the domain's own.
    #[must_use]
    pub fn observation_bounds(&self) -> (f64, f64) {
        length_bounds(&self.arm)
    }

    /// How fast a length that is seen can change within a control period at most \[m/s\].
    #[must_use]
    pub fn fastest(&self) -> f64 {
        let (low, high) = self.observation_bounds();
        (high - low) / self.control_period
    }

    /// The reward of a tip so far from the goal \[m\].
    #[must_use]
    pub fn reward(&self, distance: f64) -> f64 {
        match self.reward_type {
            ReachReward::Dense => -distance,
            ReachReward::Sparse if distance <= self.distance_threshold => 0.0,
            ReachReward::Sparse => -1.0,
        }
    }
}

/// The distance between two points \[m\].
#[must_use]
pub fn distance(tip: [f64; 3], goal: [f64; 3]) -> f64 {
    let [x, y, z] = [0, 1, 2].map(|axis| tip[axis] - goal[axis]);
    (x * x + y * y + z * z).sqrt()
}
