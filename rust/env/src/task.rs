//! What an episode is, apart from the arm that it moves: the rules that a batch of episodes follows.

use std::fmt::Debug;

use octoarm_arm::{Arm, ArmLanes, ArmState, DomainError, Interval, ParameterError};

/// How far an episode is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// It waits for its first reset.
    Waiting,
    /// It can be stepped.
    Running,
    /// The arm left its domain, or the time is over: only a reset goes on.
    Over,
}

impl Stage {
    /// The stage of a saved episode that runs, or is over, or neither.
    pub(crate) fn saved(running: bool, over: bool) -> Self {
        match (running, over) {
            (true, _) => Self::Running,
            (false, true) => Self::Over,
            (false, false) => Self::Waiting,
        }
    }
}

/// The rules of an episode: what is commanded, earned and drawn. [`crate::EpisodeBatch`] plays many.
pub trait Task: Clone + Debug + Send + Sync {
    /// What an agent does.
    type Action: Clone + Debug + Send + Sync;
    /// What a reset may be asked to begin with.
    type Ask: Copy + Sync;
    /// Where an episode begins.
    type Start: Copy;
    /// What a step or a reset brings beside what the agent sees of the springs.
    type Outcome: Clone + Debug + Send;
    /// Everything an episode needs to go on.
    type State;

    /// How far the episode is.
    fn stage(&self) -> Stage;

    /// Steps since the reset.
    fn elapsed(&self) -> u64;

    /// The last action; after a reset, the one that the arm was under before it.
    fn action(&self) -> Self::Action;

    /// Starts the generator of resets anew.
    fn seed(&mut self, seed: u64);

    /// Checks what a reset is asked for.
    ///
    /// # Errors
    /// [`ParameterError`] that names it, its value and its range.
    fn check_ask(ask: Self::Ask) -> Result<(), ParameterError>;

    /// Draws where the next episode begins, but for what is asked.
    fn draw(&mut self, ask: Option<Self::Ask>) -> Self::Start;

    /// The body that an episode begins with, at rest.
    fn body(&self, start: Self::Start) -> &Arm;

    /// The state that its arm begins in.
    fn first_state(&self, start: Self::Start) -> &ArmState;

    /// Begins an episode there.
    fn begin(&mut self, start: Self::Start);

    /// Checks the actions of a batch, and gives them as [`Task::advance`] takes them.
    ///
    /// # Errors
    /// [`ParameterError`] that names the entry.
    fn check_actions(&self, actions: &[Self::Action]) -> Result<Vec<Self::Action>, ParameterError>;

    /// Physics steps from one action to the next.
    fn physics_steps(&self) -> u32;

    /// Moves the arms in the lanes through a control period under their actions, each by its number of
    /// physics steps, 0 for one that stands still. Says which did not come to the end, and why.
    fn advance(
        lanes: &mut ArmLanes,
        tasks: &mut [Self],
        actions: &[Self::Action],
        steps: &[u32; ArmLanes::WIDTH],
    ) -> [Option<DomainError>; ArmLanes::WIDTH];

    /// The control period under an action is over: what it brought.
    fn finish(
        &mut self,
        action: &Self::Action,
        lanes: &ArmLanes,
        lane: usize,
        failure: Option<DomainError>,
    ) -> Self::Outcome;

    /// Where the episode stands, as if it began there.
    fn standing(&self, lanes: &ArmLanes, lane: usize) -> Self::Outcome;

    /// How many numbers the agent sees of so many springs: their lengths and what follows from them.
    fn observation_len(&self, springs: usize) -> usize {
        springs
    }

    /// Turns the lengths of the springs, after a reset or a step, into what the agent sees; the row is
    /// of [`Task::observation_len`], and begins with the lengths.
    fn see(&mut self, row: &mut [f64]);

    /// Adds to an outcome what lies between the agent and the body, after [`Task::see`]; the lengths \[m\]
    /// are those of the springs themselves.
    fn tell(&self, lengths: &dyn Fn() -> Vec<f64>, outcome: &mut Self::Outcome);

    /// Turns the lengths of the springs into what the agent has seen of them.
    fn show(&self, row: &mut [f64]);

    /// Saves the episode of an arm in this state.
    fn state(&self, arm: ArmState) -> Self::State;

    /// Checks a saved episode, but for the arm's own state, and gives that and its body.
    ///
    /// # Errors
    /// [`ParameterError`] for a state that does not fit.
    fn saved<'a>(
        &'a self,
        state: &'a Self::State,
    ) -> Result<(&'a Arm, &'a ArmState), ParameterError>;

    /// Goes on where a checked episode was saved, in whose state the arm is put.
    fn set_state(&mut self, state: &Self::State);
}

/// Checks the length of an episode.
pub(crate) fn check_limit(max_episode_steps: Option<u64>) -> Result<(), ParameterError> {
    if max_episode_steps == Some(0) {
        let range = "of positive numbers";
        return Err(ParameterError::out_of_range("max_episode_steps", 0, range));
    }
    Ok(())
}

/// How far an action may pass its bounds, and is then taken for the bound: what rounding in single
/// precision makes of ±1 when wrappers scale actions.
const ROUNDING: f64 = 8.0 * f32::EPSILON as f64;

/// Checks an entry of an action, in [`low`, 1], and gives it without the rounding past its bounds.
pub(crate) fn check_entry(
    low: f64,
    value: f64,
    name: impl FnOnce() -> String,
) -> Result<f64, ParameterError> {
    // What rounding adds is let in, but not told as allowed.
    if !Interval::closed(low - ROUNDING, 1.0 + ROUNDING).contains(value) {
        Interval::closed(low, 1.0).check(value, name)?;
    }
    Ok(value.clamp(low, 1.0))
}
