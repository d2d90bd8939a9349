//! One stream: its requests, answered one by one.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use octoarm_arm::ParameterError;
use octoarm_env::{Autoreset, Swing, SwingRun};
use octoarm_protocol::environment_request::Payload as Request;
use octoarm_protocol::environment_response::Payload as Response;
use octoarm_protocol::{
    CreateWorldResponse, DestroyWorldRequest, DestroyWorldResponse, EnvironmentRequest,
    EnvironmentResponse, JoinWorldRequest, JoinWorldResponse, LeaveWorldResponse, ResetRequest,
    ResetResponse, ResetWorldRequest, ResetWorldResponse, StepRequest, StepResponse,
};
use prost_types::Any;
use tokio_util::sync::CancellationToken;
use tonic::{Code, Status};
use tracing::Span;

use crate::codec::decode;
use crate::environment::Environment;
use crate::listener::Peer;
use crate::next_reset::NextReset;
use crate::properties;
use crate::reply::{Answer, Refusal, quoted};
use crate::sessions::{Activity, Sessions};
use crate::settings::Limits;
use crate::task_settings::TaskSettings;
use crate::traces;
use crate::world::{World, failed};
use crate::world_settings::{WorldSettings, memory, weight};
use crate::worlds::Agent;

/// Longest work \[µs\] that is done where the stream is served; what takes longer must not keep the
/// others waiting.
const INLINE: f64 = 1000.0;

/// Roughly the time that an arm takes to be made, or its state to be read or written \[µs\].
const MICROSECONDS_AN_ARM: f64 = 50.0;

/// Largest request \[bytes\] that is decoded where the stream is served, and roughly the time that more
/// of them take \[µs/byte\].
const SMALL_REQUEST: usize = 1 << 14;
const MICROSECONDS_A_BYTE: f64 = 0.02;

/// Longest search for the rest state of a body, which cannot be done in parts.
const LONGEST_SEARCH: Duration = Duration::from_secs(2);

/// A request as it was read.
#[derive(Debug)]
pub(crate) enum Asked {
    /// The settings of a world that is to be made, checked.
    Create(Answer<WorldSettings>),
    /// Any other.
    Other(EnvironmentRequest),
}

impl Asked {
    /// Checks the settings of a world: they may be many.
    fn of(request: EnvironmentRequest, limits: &Limits) -> Self {
        match request.payload {
            Some(Request::CreateWorld(request)) => {
                Self::Create(WorldSettings::from_tensors(&request.settings, limits))
            }
            _ => Self::Other(request),
        }
    }
}

/// What the episodes of a world begin from, made part by part; false when there is nothing left to make.
fn prepare(task: &mut TaskSettings, run: &mut Option<SwingRun>) -> Result<bool, ParameterError> {
    match task {
        TaskSettings::LimitCycle(config) => match run {
            Some(run) => run.advance(),
            None if Swing::kept(config).is_some() => Ok(false),
            None => SwingRun::new(config).map(|begun| run.insert(begun)).map(|_| true),
        },
        TaskSettings::Reach(bodies) => bodies.advance(),
    }
}

/// An environment in the making: its swing, control period by control period, or its bodies, one by one,
/// and then the rest.
fn made(
    settings: &mut Option<WorldSettings>,
    run: &mut Option<SwingRun>,
) -> Answer<Option<Environment>> {
    let Some(wanted) = settings else { return Err(failed()) };
    let begin = Instant::now();
    let late = move || begin.elapsed() > LONGEST_SEARCH;
    let goes_on = octoarm_arm::interruptible(late, || prepare(&mut wanted.task, run));
    let goes_on = goes_on.map_err(|error| match error {
        ParameterError::Interrupted => Refusal::exhausted(format!(
            "the rest state of this body was not found within {} s",
            LONGEST_SEARCH.as_secs()
        )),
        error => error.into(),
    })?;
    if goes_on {
        return Ok(None);
    }
    let swings = run.take().map(SwingRun::keep);
    let environment = settings.take().map(Environment::new).transpose()?;
    drop(swings);
    Ok(environment)
}

/// A stream. When it is dropped, what its client made is freed.
#[derive(Debug)]
pub(crate) struct Session {
    sessions: Arc<Sessions>,
    id: u64,
    peer: Peer,
    /// Name of the token that it was let in with.
    token: Option<Arc<str>>,
    activity: Arc<Activity>,
}

impl Drop for Session {
    fn drop(&mut self) {
        self.sessions.remove(self.id);
        tracing::debug!(stream = self.id, connection = self.peer.connection, "stream ended");
    }
}

/// A name that cannot be guessed.
fn name() -> Answer<String> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes)
        .map_err(|error| Refusal::new(Code::Internal, format!("no random name: {error}")))?;
    Ok(format!("{:032x}", u128::from_be_bytes(bytes)))
}

/// A computation that a panic cannot leave.
fn guarded<T>(work: impl FnOnce() -> Answer<T>) -> Answer<T> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|_| failed())?
}

impl Session {
    /// A new stream.
    pub(crate) fn new(sessions: Arc<Sessions>, peer: Peer, token: Option<Arc<str>>) -> Self {
        let (id, activity) = sessions.add();
        tracing::debug!(stream = id, connection = peer.connection, address = %peer.address, "stream opened");
        Self { sessions, id, peer, token, activity }
    }

    /// Told when the stream has been idle for too long.
    pub(crate) fn idle(&self) -> CancellationToken {
        self.activity.idle.clone()
    }

    /// Whether a step is done where the stream is served. After a longer one the next request does not come
    /// at once: a thread that looks for it is in the way of those that the client needs.
    pub(crate) fn is_quick(&self) -> bool {
        self.agent().map_or(true, |agent| agent.world.microseconds <= INLINE)
    }

    /// What the stream has joined.
    fn agent(&self) -> Answer<Arc<Agent>> {
        let agent = self.activity.agent().clone();
        agent.ok_or_else(|| Refusal::precondition("no world is joined: send JoinWorld first"))
    }

    /// Reads a request, and answers it.
    ///
    /// # Errors
    /// The status that the stream ends with, if what came is no request.
    pub(crate) async fn serve(&mut self, bytes: Bytes) -> Result<EnvironmentResponse, Status> {
        let begin = Instant::now();
        let span = self.span();
        self.sessions.begin(&self.activity);
        let length = bytes.len();
        let asked = if length <= SMALL_REQUEST {
            Asked::of(decode(bytes)?, &self.sessions.limits)
        } else {
            let sessions = Arc::clone(&self.sessions);
            let work = move || decode(bytes).map(|request| Asked::of(request, &sessions.limits));
            let pool = self.sessions.pool(length as f64 * MICROSECONDS_A_BYTE);
            let asked = pool.run_once(self.peer.connection, work).await;
            asked.map_err(|refusal| Status::new(refusal.code, refusal.message))??
        };
        Ok(self.answer_since(begin, span, asked).await)
    }

    /// Answers a request.
    #[cfg(test)]
    pub(crate) async fn answer(&mut self, request: EnvironmentRequest) -> EnvironmentResponse {
        self.sessions.begin(&self.activity);
        let asked = Asked::of(request, &self.sessions.limits);
        self.answer_since(Instant::now(), self.span(), asked).await
    }

    /// The span of a request that begins now.
    fn span(&self) -> Span {
        traces::request(self.peer.connection, self.id, self.token.as_deref())
    }

    /// Tells a request's span which world it is about.
    fn tell_world(&self, span: &Span) {
        if !span.is_disabled()
            && let Some(agent) = &*self.activity.agent()
        {
            span.record("world", traces::shown(&agent.world.name));
        }
    }

    async fn answer_since(
        &mut self,
        begin: Instant,
        span: Span,
        asked: Asked,
    ) -> EnvironmentResponse {
        let metrics = Arc::clone(&self.sessions.metrics);
        let requests = match &asked {
            Asked::Create(_) => metrics.of_creation(),
            Asked::Other(request) => metrics.of(request.payload.as_ref()),
        };
        span.record("otel.name", requests.kind);
        // It may be left in between.
        self.tell_world(&span);
        let answer = match asked {
            Asked::Create(Err(refusal)) => Err(refusal),
            Asked::Create(Ok(settings)) => self.create(settings).await.map(Response::CreateWorld),
            Asked::Other(request) => self.other(request).await,
        };
        let payload = answer.unwrap_or_else(|refusal| {
            tracing::debug!(stream = self.id, code = ?refusal.code, reason = ?refusal.message, "request refused");
            let code = metrics.refused(refusal.code);
            span.record("otel.status_code", "ERROR").record("error.type", code);
            if self.agent().is_ok_and(|agent| agent.world.broken()) {
                tracing::error!(stream = self.id, "a computation failed: its world is given up");
                self.activity.leave();
            }
            Response::Error(refusal.into())
        });
        match &payload {
            Response::CreateWorld(made) => {
                span.record("world", traces::shown(&made.world_name));
            }
            Response::JoinWorld(_) => self.tell_world(&span),
            _ => (),
        }
        requests.count(matches!(payload, Response::Error(_)), begin.elapsed().as_secs_f64());
        self.sessions.end(&self.activity);
        EnvironmentResponse { payload: Some(payload) }
    }

    async fn other(&mut self, request: EnvironmentRequest) -> Answer<Response> {
        match request.payload {
            Some(Request::Step(request)) => self.step(request).await.map(Response::Step),
            // Its settings are read before.
            Some(Request::CreateWorld(_)) => Err(failed()),
            Some(Request::JoinWorld(request)) => self.join(&request).map(Response::JoinWorld),
            Some(Request::Reset(request)) => self.reset(&request).map(Response::Reset),
            Some(Request::ResetWorld(request)) => {
                self.reset_world(&request).await.map(Response::ResetWorld)
            }
            Some(Request::LeaveWorld(_)) => {
                self.activity.leave();
                Ok(Response::LeaveWorld(LeaveWorldResponse {}))
            }
            Some(Request::DestroyWorld(request)) => {
                self.destroy(&request).map(Response::DestroyWorld)
            }
            Some(Request::Extension(request)) => {
                self.extension(request).await.map(Response::Extension)
            }
            None => Err(Refusal::invalid("the request holds nothing that this server knows")),
        }
    }

    async fn create(&self, settings: WorldSettings) -> Answer<CreateWorldResponse> {
        self.sessions.refuse_while_draining()?;
        let (num_envs, count) = (settings.num_envs, settings.num_envs.unwrap_or(1));
        let finals = settings.autoreset == Autoreset::SameStep;
        let arms = (count as f64 * weight(settings.task.arm())).ceil() as usize;
        let worlds = &self.sessions.worlds;
        let reservation = worlds.reserve(self.peer.connection, arms, memory(&settings))?;
        let microseconds = match &settings.task {
            TaskSettings::LimitCycle(config) if Swing::kept(config).is_some() => {
                count as f64 * MICROSECONDS_AN_ARM
            }
            _ => f64::INFINITY,
        };
        let (mut settings, mut run) = (Some(settings), None);
        let mut reservation = Some(reservation);
        // Room is taken from now on, until the world is gone, or its making is given up.
        let mut part = move |_| {
            let made = made(&mut settings, &mut run).transpose()?;
            Some(made.map(|environment| (environment, reservation.take())))
        };
        let mut made = None;
        if microseconds <= INLINE {
            made = guarded(|| part(true).transpose())?;
        }
        let (environment, reservation) = match made {
            Some(made) => made,
            None => self.sessions.pool(microseconds).run(self.peer.connection, part).await??,
        };
        let reservation = reservation.ok_or_else(failed)?;
        let world = World::new(name()?, environment, num_envs, finals);
        let world_name = world.name.clone();
        tracing::info!(stream = self.id, arms = world.arms, "world created");
        worlds.insert(world, reservation, self.id);
        Ok(CreateWorldResponse { world_name })
    }

    fn join(&self, request: &JoinWorldRequest) -> Answer<JoinWorldResponse> {
        let mut joined = self.activity.agent();
        if joined.is_some() {
            return Err(Refusal::precondition("this stream has joined a world: leave it first"));
        }
        if let Some(name) = request.settings.keys().next() {
            return Err(Refusal::invalid(format!(
                "unknown setting {}; JoinWorld takes none, CreateWorld does",
                quoted(name)
            )));
        }
        let agent = self.sessions.worlds.join(&request.world_name)?;
        let specs = Some(agent.world.specs.message.clone());
        *joined = Some(Arc::new(agent));
        Ok(JoinWorldResponse { specs })
    }

    async fn step(&self, request: StepRequest) -> Answer<StepResponse> {
        let agent = self.agent()?;
        if self.sessions.draining.is_cancelled() && !agent.world.running() {
            self.sessions.refuse_while_draining()?;
        }
        let microseconds = agent.world.microseconds;
        let mut step = agent.world.begin_step(&request)?;
        drop(request);
        let mut part = move |alone| agent.world.advance(&mut step, alone).transpose();
        let done = if microseconds <= INLINE {
            guarded(|| {
                loop {
                    if let Some(done) = part(true) {
                        break done;
                    }
                }
            })
        } else {
            // The agent stays with the world until the part is done, even if the stream ends.
            self.sessions.pool(microseconds).run(self.peer.connection, part).await?
        };
        let (response, steps) = done?;
        self.sessions.metrics.steps.inc_by(steps as u64);
        Ok(response)
    }

    fn reset(&self, request: &ResetRequest) -> Answer<ResetResponse> {
        let world = &self.agent()?.world;
        let next = NextReset::from_tensors(&request.settings, world.task, world.specs.num_envs())?;
        world.environment()?.reset(next);
        Ok(ResetResponse { specs: Some(world.specs.message.clone()) })
    }

    async fn reset_world(&self, request: &ResetWorldRequest) -> Answer<ResetWorldResponse> {
        // One that there is not is refused below.
        let task = self.sessions.worlds.task(&request.world_name).unwrap_or_default();
        let next = NextReset::from_tensors(&request.settings, task, None)?;
        let own = self.agent().ok().map(|agent| Arc::clone(&agent.world));
        if let Some(world) = own.as_ref().filter(|world| world.name == request.world_name) {
            let mut environment = world.environment()?;
            world.reset_now(&mut environment);
            environment.reset(next);
            return Ok(ResetWorldResponse {});
        }
        let own = own.as_ref().map(|world| world.name.as_str());
        let Some(done) = self.sessions.worlds.reset(&request.world_name, own, next)? else {
            return Ok(ResetWorldResponse {});
        };
        let result = tokio::select! {
            // An error: the world was freed before its agent came to the end.
            done = done => done.map_err(|_| Refusal::new(Code::Aborted, "the world is gone")),
            () = self.sessions.stop.cancelled() => {
                Err(Refusal::new(Code::Unavailable, "the server is shutting down"))
            }
            () = tokio::time::sleep(self.sessions.limits.idle_timeout) => Err(Refusal::new(
                Code::DeadlineExceeded,
                "the world's client has made no step for so long (idle_timeout)",
            )),
        };
        if let Some(own) = own {
            self.sessions.worlds.waited(own);
        }
        result.map(|()| ResetWorldResponse {})
    }

    async fn extension(&self, request: Any) -> Answer<Any> {
        let agent = self.agent().ok();
        let worlds = self.sessions.worlds.len();
        // What takes its time is the state of many arms.
        let arms = agent.as_ref().map_or(0, |agent| agent.world.arms);
        let microseconds =
            MICROSECONDS_AN_ARM * arms as f64 + MICROSECONDS_A_BYTE * request.value.len() as f64;
        let work = move || {
            let environment = agent.as_ref().map(|agent| agent.world.environment());
            properties::answer(&request, worlds, environment.transpose()?.as_deref_mut())
        };
        if microseconds <= INLINE {
            guarded(work)
        } else {
            self.sessions.pool(microseconds).run_once(self.peer.connection, work).await?
        }
    }

    fn destroy(&self, request: &DestroyWorldRequest) -> Answer<DestroyWorldResponse> {
        self.sessions.worlds.destroy(&request.world_name)?;
        tracing::info!(stream = self.id, "world destroyed");
        Ok(DestroyWorldResponse {})
    }
}

#[cfg(test)]
mod tests;
