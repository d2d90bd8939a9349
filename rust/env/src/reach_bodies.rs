//! The bodies of episodes of reaching, which are made before the first one begins.

use octoarm_arm::{Actuator, Arm, ArmLanes, ArmParameters, ArmState, ParameterError, poll};

use crate::goals::check_goal;
use crate::reach_config::ReachConfig;

/// Checked settings and goals of reaching, and their bodies, which come to rest one at a time, so that
/// others can have their turn in between.
#[derive(Clone, Debug)]
pub struct ReachBodies {
    pub(crate) config: ReachConfig,
    pub(crate) goals: Vec<[f64; 3]>,
    /// Those that are made, at rest.
    pub(crate) arms: Vec<(Arm, ArmState)>,
    drawn: Vec<ArmParameters>,
}

impl ReachBodies {
    /// Checks settings and goals; no body is made yet.
    ///
    /// # Errors
    /// [`ParameterError`] that names the setting, its value and its range.
    pub fn new(config: ReachConfig, goals: Vec<[f64; 3]>) -> Result<Self, ParameterError> {
        let drawn = config.drawn_bodies()?;
        if goals.is_empty() {
            return Err(ParameterError::shape("goals", "(0, 3)", "(G, 3) with at least one"));
        }
        for (index, goal) in goals.iter().enumerate() {
            check_goal(*goal, |axis| format!("goals[{index}, {axis}]"))?;
        }
        Ok(Self { config, goals, arms: Vec::with_capacity(drawn.len()), drawn })
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &ReachConfig {
        &self.config
    }

    /// What goals are drawn from \[m\].
    #[must_use]
    pub fn goals(&self) -> &[[f64; 3]] {
        &self.goals
    }

    /// Brings another body to rest; false when there is none left.
    ///
    /// # Errors
    /// [`ParameterError`] for a body without a rest state.
    pub fn advance(&mut self) -> Result<bool, ParameterError> {
        poll()?;
        let Some(parameters) = self.drawn.get(self.arms.len()) else { return Ok(false) };
        let arm = Arm::new(parameters.clone(), Actuator::Direct)?;
        let state = arm.state();
        self.arms.push((arm, state));
        Ok(true)
    }

    /// All bodies at rest.
    ///
    /// # Errors
    /// As [`ReachBodies::advance`].
    pub(crate) fn finish(mut self) -> Result<Self, ParameterError> {
        while self.advance()? {}
        Ok(self)
    }

    /// Memory that bodies and goals take, made or not, rounded up \[bytes\].
    #[must_use]
    pub fn bytes(&self) -> usize {
        let arm = ArmLanes::bytes(self.config.arm.compartments)
            .saturating_add(size_of::<ArmParameters>());
        arm.saturating_mul(self.drawn.len())
            .saturating_add(self.goals.len().saturating_mul(size_of::<[f64; 3]>()))
    }
}
