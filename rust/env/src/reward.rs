//! The reward of a step.

use octoarm_arm::transcendental::exp_negative;
use serde::{Deserialize, Serialize};

/// Weights of the reward, in degrees where angles are meant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reward {
    /// Reward of an exactly tracked step, above 0.
    pub tracking_weight: f64,
    /// Tracking error at which it has fallen to 1/e \[degrees\], above 0.
    pub width: f64,
    /// Cost of a unit of squared action change, at least 0.
    pub action_change_weight: f64,
}

/// The terms that add up to the reward.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RewardTerms {
    /// `tracking_weight · exp(−(error / width)²)`, in (0, `tracking_weight`].
    pub tracking: f64,
    /// `−action_change_weight · |a − a_before|²`, in [−8 `action_change_weight`, 0].
    pub action_change: f64,
}

impl RewardTerms {
    /// The sum of the terms.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.tracking + self.action_change
    }
}

impl Reward {
    /// The terms for a tracking error in degrees and two successive actions.
    #[must_use]
    pub fn terms(&self, error: f64, action: [f64; 2], before: [f64; 2]) -> RewardTerms {
        let ratio = error / self.width;
        let change = [action[0] - before[0], action[1] - before[1]];
        RewardTerms {
            tracking: self.tracking_weight * exp_negative(ratio * ratio),
            action_change: -self.action_change_weight
                * (change[0] * change[0] + change[1] * change[1]),
        }
    }
}

/// Reward of a step of reaching.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReachReward {
    /// 0 within the threshold, else −1.
    Sparse,
    /// Minus the distance \[m\].
    Dense,
}
