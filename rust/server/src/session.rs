//! One stream: its requests, answered one by one.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Instant;

use octoarm_env::Autoreset;
use prost_types::Any;
use tokio_util::sync::CancellationToken;
use tonic::Code;

use crate::environment::Environment;
use crate::listener::Peer;
use crate::properties;
use crate::protocol::environment_request::Payload as Request;
use crate::protocol::environment_response::Payload as Response;
use crate::protocol::{
    CreateWorldRequest, CreateWorldResponse, DestroyWorldRequest, DestroyWorldResponse,
    EnvironmentRequest, EnvironmentResponse, JoinWorldRequest, JoinWorldResponse,
    LeaveWorldResponse, ResetRequest, ResetResponse, ResetWorldRequest, ResetWorldResponse,
    StepRequest, StepResponse,
};
use crate::reply::{Answer, Refusal, quoted};
use crate::sessions::{Activity, Sessions};
use crate::world::{World, failed};
use crate::world_settings::{NextReset, WorldSettings, weight};
use crate::worlds::Agent;

/// Longest step \[µs\] that is computed where the stream is served; what takes longer must not keep
/// the others waiting.
const INLINE: f64 = 1000.0;

/// Arms whose state is read and written where the stream is served.
const FEW_ARMS: usize = 16;

/// A stream. When it is dropped, what its client made is freed.
#[derive(Debug)]
pub(crate) struct Session {
    sessions: Arc<Sessions>,
    id: u64,
    peer: Peer,
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
    pub(crate) fn new(sessions: Arc<Sessions>, peer: Peer) -> Self {
        let (id, activity) = sessions.add();
        tracing::debug!(stream = id, connection = peer.connection, address = %peer.address, "stream opened");
        Self { sessions, id, peer, activity }
    }

    /// Told when the stream has been idle for too long.
    pub(crate) fn idle(&self) -> CancellationToken {
        self.activity.idle.clone()
    }

    /// What the stream has joined.
    fn agent(&self) -> Answer<Arc<Agent>> {
        let agent = self.activity.agent().clone();
        agent.ok_or_else(|| Refusal::precondition("no world is joined: send JoinWorld first"))
    }

    /// Answers a request.
    pub(crate) async fn answer(&mut self, request: EnvironmentRequest) -> EnvironmentResponse {
        let begin = Instant::now();
        self.sessions.begin(&self.activity);
        let requests = self.sessions.metrics.of(request.payload.as_ref()).clone();
        let answer = match request.payload {
            Some(Request::Step(request)) => self.step(request).await.map(Response::Step),
            Some(Request::CreateWorld(request)) => {
                self.create(request).await.map(Response::CreateWorld)
            }
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
            Some(Request::Extension(request)) => self.extension(&request).map(Response::Extension),
            None => Err(Refusal::invalid("the request holds nothing that this server knows")),
        };
        let payload = answer.unwrap_or_else(|refusal| {
            tracing::debug!(stream = self.id, code = ?refusal.code, reason = ?refusal.message, "request refused");
            if self.agent().is_ok_and(|agent| agent.world.broken()) {
                tracing::error!(stream = self.id, "a computation failed: its world is given up");
                self.activity.leave();
            }
            Response::Error(refusal.into())
        });
        requests.count(matches!(payload, Response::Error(_)), begin.elapsed().as_secs_f64());
        self.sessions.end(&self.activity);
        EnvironmentResponse { payload: Some(payload) }
    }

    async fn create(&self, request: CreateWorldRequest) -> Answer<CreateWorldResponse> {
        let settings = WorldSettings::from_tensors(&request.settings, &self.sessions.limits)?;
        let (num_envs, finals) = (settings.num_envs, settings.autoreset == Autoreset::SameStep);
        let arms = (num_envs.unwrap_or(1) as f64 * weight(&settings.config)).ceil() as usize;
        let reservation = self.sessions.worlds.reserve(self.peer.connection, arms)?;
        // The first of a kind swings an arm onto the target, which takes a while; its room is taken
        // until that is done, even if its stream has ended.
        let work = move || (Environment::new(settings), reservation);
        let (environment, reservation) = self.sessions.run_long(work).await?;
        let world = World::new(name()?, environment?, num_envs, finals);
        let world_name = world.name.clone();
        tracing::info!(stream = self.id, arms = world.arms, "world created");
        self.sessions.worlds.insert(world, reservation, self.id);
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
        let (response, steps) = if agent.world.microseconds > INLINE {
            // The agent stays with the world until the step is done, even if the stream ends.
            self.sessions.run_long(move || agent.world.step(&request)).await??
        } else {
            guarded(|| agent.world.step(&request))?
        };
        self.sessions.metrics.steps.inc_by(steps as u64);
        Ok(response)
    }

    fn reset(&self, request: &ResetRequest) -> Answer<ResetResponse> {
        let world = &self.agent()?.world;
        let next = NextReset::from_tensors(&request.settings, world.specs.num_envs())?;
        world.environment()?.reset(next);
        Ok(ResetResponse { specs: Some(world.specs.message.clone()) })
    }

    async fn reset_world(&self, request: &ResetWorldRequest) -> Answer<ResetWorldResponse> {
        let next = NextReset::from_tensors(&request.settings, None)?;
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

    fn extension(&self, request: &Any) -> Answer<Any> {
        let agent = self.agent().ok();
        let worlds = self.sessions.worlds.len();
        let work = || {
            guarded(|| {
                let environment = agent.as_ref().map(|agent| agent.world.environment());
                properties::answer(request, worlds, environment.transpose()?.as_deref_mut())
            })
        };
        // The state of many arms takes its time.
        let large = agent.as_ref().is_some_and(|agent| agent.world.arms > FEW_ARMS);
        if large { tokio::task::block_in_place(work) } else { work() }
    }

    fn destroy(&self, request: &DestroyWorldRequest) -> Answer<DestroyWorldResponse> {
        self.sessions.worlds.destroy(&request.world_name)?;
        tracing::info!(stream = self.id, "world destroyed");
        Ok(DestroyWorldResponse {})
    }
}

#[cfg(test)]
mod tests;
