//! `_core.ReachBatch`.

use numpy::{IntoPyArray, PyArray1};
use octoarm_arm::ParameterError;
use octoarm_env::{
    BatchStep, EpisodeBatch, Last, MUSCLES, Reach, ReachConfig, ReachOutcome, ReachReward,
    Words as _,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Joints, Table, Vector, joints_array, numbers, table};
use crate::episode_batch::{autoreset_mode, check_index};
use crate::errors::{interruptible, invalid};
use crate::infos::{Infos, Words, infos, step_infos};

/// What Gymnasium-Robotics calls the parts of an observation.
const PARTS: [&str; 3] = ["observation", "achieved_goal", "desired_goal"];

/// Observations, rewards, terminations, truncations, infos.
type Step<'py> =
    (Infos<'py>, Vector<'py>, Bound<'py, PyArray1<bool>>, Bound<'py, PyArray1<bool>>, Infos<'py>);

/// Many arms that reach; `octoarm_env.OctoArmReachVectorEnv` documents it.
#[pyclass(module = "octoarm_env._core")]
pub(crate) struct ReachBatch {
    inner: EpisodeBatch<Reach>,
}

fn words() -> Words<ReachOutcome> {
    ReachOutcome::info().iter().map(|word| (word.name, word.reading)).collect()
}

/// Triples of neighbouring numbers.
fn points_of(flat: &[f64]) -> Vec<[f64; 3]> {
    flat.as_chunks().0.to_vec()
}

/// Where the tip of the default body has been held by its muscles, (K, 3).
#[pyfunction]
pub(crate) fn reachable_goals(py: Python<'_>) -> PyResult<Table<'_>> {
    table(py, octoarm_env::reachable_goals().as_flattened().to_vec(), 3)
}

/// The actions of so many arms with so many muscles, (N, muscles), after the checks that the step of a
/// batch makes.
#[pyfunction]
pub(crate) fn check_reach_actions<'py>(
    py: Python<'py>,
    actions: &Bound<'py, PyAny>,
    num_envs: usize,
    muscles: usize,
) -> PyResult<Table<'py>> {
    let (actions, _) = numbers("actions", actions, &[Some(num_envs), Some(muscles)])?;
    let rows: Vec<Vec<f64>> = actions.chunks_exact(muscles).map(<[f64]>::to_vec).collect();
    let checked = octoarm_env::check_activations(&rows, muscles).map_err(invalid)?;
    table(py, checked.concat(), muscles)
}

/// The parameters of every body that these settings draw, as JSON text.
#[pyfunction]
pub(crate) fn drawn_reach_bodies(config: &str) -> PyResult<Vec<String>> {
    let bodies = ReachConfig::from_json(config).and_then(|config| config.drawn_bodies());
    bodies.map_err(invalid)?.iter().map(|body| body.to_json().map_err(invalid)).collect()
}

/// The rewards of tips at `achieved` (K, 3) for goals at `desired` (K, 3).
#[pyfunction]
pub(crate) fn reach_rewards<'py>(
    py: Python<'py>,
    achieved: &Bound<'py, PyAny>,
    desired: &Bound<'py, PyAny>,
    sparse: bool,
    distance_threshold: f64,
) -> PyResult<Vector<'py>> {
    let (tips, shape) = numbers("achieved_goal", achieved, &[None, Some(3)])?;
    let (goals, _) = numbers("desired_goal", desired, &[Some(shape[0]), Some(3)])?;
    let reward_type = if sparse { ReachReward::Sparse } else { ReachReward::Dense };
    let config = ReachConfig { reward_type, distance_threshold, ..ReachConfig::default() };
    let pairs = points_of(&tips).into_iter().zip(points_of(&goals));
    let rewards = pairs.map(|(tip, goal)| config.reward(octoarm_env::distance(tip, goal)));
    Ok(rewards.collect::<Vec<f64>>().into_pyarray(py))
}

impl ReachBatch {
    /// The observations of all: what is seen, and where the tips are and should be.
    fn observations<'py>(&self, py: Python<'py>, seen: Vec<f64>) -> PyResult<Infos<'py>> {
        let outcomes = self.inner.outcomes();
        let points = |of: fn(&ReachOutcome) -> [f64; 3]| {
            table(py, outcomes.iter().flat_map(of).collect(), 3)
        };
        let parts = PyDict::new(py);
        parts.set_item(PARTS[0], table(py, seen, self.inner.observation_len())?)?;
        parts.set_item(PARTS[1], points(|outcome| outcome.tip)?)?;
        parts.set_item(PARTS[2], points(|outcome| outcome.goal)?)?;
        Ok(parts)
    }
}

#[pymethods]
impl ReachBatch {
    #[new]
    fn new(
        py: Python<'_>,
        config: &str,
        goals: &Bound<'_, PyAny>,
        num_envs: usize,
        max_episode_steps: Option<u64>,
        autoreset: &str,
        threads: Option<usize>,
    ) -> PyResult<Self> {
        let autoreset = autoreset_mode(autoreset)?;
        let config = ReachConfig::from_json(config).map_err(invalid)?;
        let (goals, _) = numbers("goals", goals, &[None, Some(3)])?;
        let goals = points_of(&goals);
        let inner = interruptible(py, || {
            EpisodeBatch::reaching(config, goals, num_envs, max_episode_steps, autoreset, threads)
        })?;
        Ok(Self { inner })
    }

    #[pyo3(signature = (mask, seeds, goal))]
    fn reset<'py>(
        &mut self,
        py: Python<'py>,
        mask: Option<Vec<bool>>,
        seeds: Vec<Option<u64>>,
        goal: Option<[f64; 3]>,
    ) -> PyResult<(Infos<'py>, Infos<'py>)> {
        let reset =
            py.detach(|| self.inner.reset(mask.as_deref(), &seeds, goal)).map_err(invalid)?;
        let outcomes: Vec<Option<&ReachOutcome>> =
            reset.outcomes.iter().map(Option::as_ref).collect();
        Ok((self.observations(py, reset.observations)?, infos(py, words(), &outcomes)?))
    }

    fn step<'py>(&mut self, py: Python<'py>, actions: &Bound<'py, PyAny>) -> PyResult<Step<'py>> {
        let width = self.action_len();
        let (actions, _) = numbers("actions", actions, &[Some(self.inner.len()), Some(width)])?;
        let mut step: BatchStep<ReachOutcome> = py
            .detach(|| {
                let actions: Vec<Vec<f64>> =
                    actions.chunks_exact(width).map(<[f64]>::to_vec).collect();
                self.inner.step(&actions)
            })
            .map_err(invalid)?;
        let rewards: Vec<f64> = step.steps().map(|outcome| outcome.reward).collect();
        let terminated: Vec<bool> = step.steps().map(ReachOutcome::terminated).collect();
        let truncated: Vec<bool> = step.steps().map(|outcome| outcome.truncated).collect();
        let seen = |last: Last<ReachOutcome>| {
            let parts = PyDict::new(py);
            parts.set_item(PARTS[0], last.observation.into_pyarray(py))?;
            parts.set_item(PARTS[1], last.outcome.tip.to_vec().into_pyarray(py))?;
            parts.set_item(PARTS[2], last.outcome.goal.to_vec().into_pyarray(py))?;
            Ok(parts)
        };
        let infos = step_infos(py, words, &mut step, seen)?;
        Ok((
            self.observations(py, step.observations)?,
            rewards.into_pyarray(py),
            terminated.into_pyarray(py),
            truncated.into_pyarray(py),
            infos,
        ))
    }

    /// The infos of all episodes as they stand, as if they began there.
    fn infos<'py>(&self, py: Python<'py>) -> PyResult<Infos<'py>> {
        let outcomes = self.inner.outcomes();
        infos(py, words(), &outcomes.iter().map(Some).collect::<Vec<Option<&ReachOutcome>>>())
    }

    fn save(&self) -> PyResult<String> {
        serde_json::to_string(&self.inner.state())
            .map_err(|error| invalid(ParameterError::Format(error.to_string())))
    }

    fn load(&mut self, py: Python<'_>, state: &str) -> PyResult<()> {
        let state = octoarm_arm::read_json(state).map_err(invalid)?;
        py.detach(|| self.inner.set_state(&state)).map_err(invalid)
    }

    #[getter]
    fn ended(&self) -> Vec<bool> {
        self.inner.ended()
    }

    /// Steps since the resets.
    #[getter]
    fn elapsed(&self) -> Vec<u64> {
        self.inner.elapsed()
    }

    #[getter]
    fn threads(&self) -> usize {
        self.inner.arms().threads()
    }

    #[getter]
    fn observation_len(&self) -> usize {
        self.inner.observation_len()
    }

    #[getter]
    fn observation_bounds(&self) -> (f64, f64) {
        self.inner.settings().observation_bounds()
    }

    #[getter]
    fn action_len(&self) -> usize {
        self.inner.settings().muscles()
    }

    /// Where the tips should be, (N, 3).
    #[getter]
    fn goals<'py>(&self, py: Python<'py>) -> PyResult<Table<'py>> {
        table(py, self.inner.outcomes().iter().flat_map(|outcome| outcome.goal).collect(), 3)
    }

    /// The activations of an arm's muscles, (segments, 5).
    fn activations<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Table<'py>> {
        check_index(index, self.inner.len())?;
        table(py, self.inner.activations(index).to_vec(), MUSCLES)
    }

    /// Centres of an arm's planes.
    fn positions<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Table<'py>> {
        check_index(index, self.inner.len())?;
        table(py, self.inner.arms().state(index).positions().into_flattened(), 3)
    }

    /// Ends of an arm's longitudinal springs.
    fn joints<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Joints<'py>> {
        check_index(index, self.inner.len())?;
        let arms = self.inner.arms();
        joints_array(py, arms.state(index).joints(arms.parameters(index)))
    }
}
