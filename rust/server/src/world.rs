//! A world: its environment, and the resets that wait for its agent.

use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};

use octoarm_protocol::{EnvironmentStateType, StepRequest, StepResponse};
use tokio::sync::oneshot;
use tonic::Code;

use crate::environment::{Advance, Environment};
use crate::next_reset::NextReset;
use crate::reply::{Answer, Refusal};
use crate::specs::Specs;
use crate::task_settings::TaskName;

/// A computation has failed.
pub(crate) fn failed() -> Refusal {
    Refusal::new(Code::Internal, "the computation failed; see the server's log")
}

/// A step of a world, which may be made in parts.
#[derive(Debug)]
pub(crate) struct Step {
    /// Observations that it is to bring, by their places.
    wanted: Vec<usize>,
    /// Where an episode begins they are ignored, and what is wrong with them too.
    actions: Option<Answer<Option<Vec<f64>>>>,
    /// The control period, when it has begun.
    advance: Option<Advance>,
}

/// A world, as its agent and others know it. A step that panics leaves the lock of its environment
/// poisoned: the world is then broken, and goes when its agent leaves.
#[derive(Debug)]
pub(crate) struct World {
    /// Not to be guessed.
    pub(crate) name: String,
    /// What its arms do.
    pub(crate) task: TaskName,
    /// What can be done and seen.
    pub(crate) specs: Specs,
    /// Number of arms.
    pub(crate) arms: usize,
    /// Roughly how long a step takes \[µs\].
    pub(crate) microseconds: f64,
    environment: Mutex<Environment>,
    /// Resets that others have asked for, and who is told that they are done.
    pending: Mutex<Vec<(NextReset, oneshot::Sender<()>)>>,
}

impl World {
    /// A world of this name and environment; `finals` are told where a step that ends an episode
    /// begins the next one.
    pub(crate) fn new(
        name: String,
        environment: Environment,
        num_envs: Option<usize>,
        finals: bool,
    ) -> Self {
        let episodes = &environment.episodes;
        Self {
            name,
            task: episodes.task(),
            specs: Specs::new(episodes.specs(), num_envs, finals),
            arms: episodes.len(),
            microseconds: episodes.microseconds(),
            environment: Mutex::new(environment),
            pending: Mutex::default(),
        }
    }

    /// The environment, for as long as a request needs it.
    pub(crate) fn environment(&self) -> Answer<MutexGuard<'_, Environment>> {
        self.environment.lock().map_err(|_| failed())
    }

    /// Whether an episode runs, or a step is being made.
    pub(crate) fn running(&self) -> bool {
        match self.environment.try_lock() {
            Ok(environment) => environment.running(),
            Err(TryLockError::WouldBlock) => true,
            Err(TryLockError::Poisoned(_)) => false,
        }
    }

    /// Whether nobody knows the environment's state any more.
    pub(crate) fn broken(&self) -> bool {
        self.environment.is_poisoned()
    }

    fn pending(&self) -> MutexGuard<'_, Vec<(NextReset, oneshot::Sender<()>)>> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a reset waits for the agent.
    #[cfg(test)]
    pub(crate) fn awaited(&self) -> bool {
        !self.pending().is_empty()
    }

    /// Resets the world at its agent's next step; the receiver tells when.
    pub(crate) fn reset_later(&self, next: NextReset) -> oneshot::Receiver<()> {
        let (done, receiver) = oneshot::channel();
        let mut pending = self.pending();
        pending.retain(|(_, waiting)| !waiting.is_closed());
        pending.push((next, done));
        receiver
    }

    /// Does the resets that have waited; whether there were any.
    pub(crate) fn reset_now(&self, environment: &mut Environment) -> bool {
        let mut any = false;
        for (next, done) in self.pending().drain(..) {
            // Who asked may be gone, and the wish with it.
            if !done.is_closed() {
                environment.reset(next);
                any = true;
                let _ = done.send(());
            }
        }
        any
    }

    /// The agent leaves.
    pub(crate) fn leave(&self) {
        if let Ok(mut environment) = self.environment.lock() {
            environment.leave();
            self.reset_now(&mut environment);
        }
    }

    /// What a request asks for, checked; nothing is changed yet.
    pub(crate) fn begin_step(&self, request: &StepRequest) -> Answer<Step> {
        let wanted = self.specs.wanted(request)?;
        Ok(Step { wanted, actions: Some(self.specs.actions(request)), advance: None })
    }

    /// Goes on by a part as a request asks: a control period, the begin of an episode, or word of a
    /// reset; by a larger part if nobody else waits. The last part gives the answer, and how many arms have
    /// made a step.
    pub(crate) fn advance(
        &self,
        step: &mut Step,
        alone: bool,
    ) -> Answer<Option<(StepResponse, usize)>> {
        let specs = &self.specs;
        let mut environment = self.environment()?;
        let Step { wanted, actions, advance } = step;
        let advance = match advance {
            Some(advance) => advance,
            None => {
                let running = environment.running();
                if self.reset_now(&mut environment) && running {
                    let interrupted = EnvironmentStateType::Interrupted;
                    return Ok(Some((environment.tell(interrupted, wanted, specs), 0)));
                }
                if !running {
                    return Ok(Some((environment.begin(wanted, specs)?, 0)));
                }
                advance.insert(Advance::new(actions.take().transpose()?.flatten()))
            }
        };
        let answer = environment.advance(advance, alone, wanted, specs)?;
        Ok(answer.map(|answer| (answer, self.arms)))
    }
}
