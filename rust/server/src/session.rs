//! One stream: its requests, answered one by one.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use prost_types::Any;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tonic::Code;

use crate::arena::{Arena, Body, Order, Step};
use crate::listener::Peer;
use crate::metrics::Metrics;
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
use crate::settings::{Limits, cores};
use crate::specs::{ACTION, Observation, Specs};
use crate::tensor::doubles_of;
use crate::world::{Borrowed, World, Worlds};
use crate::world_settings::{NextReset, WorldSettings, weight};

/// Longest step \[µs\] that is computed where the stream is served; what takes longer must not keep
/// the others waiting.
const INLINE: f64 = 1000.0;

/// Arms whose state is read and written where the stream is served.
const FEW_ARMS: usize = 16;

/// What all streams share.
#[derive(Debug)]
pub(crate) struct Hub {
    pub(crate) worlds: Arc<Worlds>,
    pub(crate) limits: Limits,
    pub(crate) metrics: Arc<Metrics>,
    /// Long computations at a time.
    heavy: Arc<Semaphore>,
    /// Told when the server stops.
    pub(crate) stop: CancellationToken,
    streams: Mutex<BTreeMap<u64, Arc<Record>>>,
    started: Instant,
    numbers: AtomicU64,
    cores: i64,
}

/// What a stream has joined.
#[derive(Debug)]
struct Seat {
    world: Arc<World>,
    arena: Arena,
}

/// What is known of a stream, whether or not anybody reads its answers.
#[derive(Debug)]
struct Record {
    /// When the last request was answered \[ms since the server's start\].
    last: AtomicU64,
    /// Whether a request is being answered.
    busy: AtomicBool,
    /// Told when the stream has been idle for too long.
    idle: CancellationToken,
    seat: Mutex<Option<Seat>>,
}

/// A stream. When it is dropped, what its client made is freed.
#[derive(Debug)]
pub(crate) struct Session {
    hub: Arc<Hub>,
    id: u64,
    peer: Peer,
    record: Arc<Record>,
}

impl Hub {
    /// Without streams.
    pub(crate) fn new(
        limits: Limits,
        metrics: Arc<Metrics>,
        stop: CancellationToken,
        server_threads: usize,
    ) -> Arc<Self> {
        Arc::new(Self {
            worlds: Worlds::new(limits.clone(), Arc::clone(&metrics)),
            heavy: Arc::new(Semaphore::new(limits.max_threads)),
            limits,
            metrics,
            stop,
            streams: Mutex::default(),
            started: Instant::now(),
            numbers: AtomicU64::new(1),
            cores: cores().min(server_threads) as i64,
        })
    }

    /// Whether the streams are so few that half of the serving threads can wait for them.
    pub(crate) fn quiet(&self) -> bool {
        !self.limits.busy_poll.is_zero() && 2 * self.metrics.streams.get() <= self.cores
    }

    fn now(&self) -> u64 {
        self.started.elapsed().as_millis() as u64
    }

    fn streams(&self) -> MutexGuard<'_, BTreeMap<u64, Arc<Record>>> {
        self.streams.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the streams that have been idle for too long, and frees what they hold: also of those whose
    /// client reads no answers, so that they are not served.
    fn end_idle(&self) {
        let limit = self.limits.idle_timeout.as_millis() as u64;
        let now = self.now();
        let idle: Vec<(u64, Arc<Record>)> = self
            .streams()
            .iter()
            .filter(|(_, record)| {
                !record.busy.load(Ordering::Acquire)
                    && now.saturating_sub(record.last.load(Ordering::Acquire)) > limit
            })
            .map(|(id, record)| (*id, Arc::clone(record)))
            .collect();
        for (id, record) in idle {
            let mut seat = record.seat();
            // It may have come to life meanwhile.
            if record.idle.is_cancelled() || record.busy.load(Ordering::Acquire) {
                continue;
            }
            record.idle.cancel();
            let seat = seat.take();
            self.metrics.idle.inc();
            tracing::info!(stream = id, "idle stream ended");
            if let Some(Seat { world, arena }) = seat {
                self.worlds.leave(&world, arena);
            }
            self.worlds.release(id);
        }
    }

    /// Looks after idle streams until the server stops.
    pub(crate) async fn keep_watch(self: Arc<Self>) {
        let pause = (self.limits.idle_timeout / 4)
            .clamp(Duration::from_millis(10), Duration::from_secs(10));
        loop {
            tokio::select! {
                () = self.stop.cancelled() => break,
                () = tokio::time::sleep(pause) => self.end_idle(),
            }
        }
    }

    /// Runs a long computation on a thread of its own. What it is about, and its result, are dropped
    /// there or on the way, if the stream ends meanwhile.
    async fn run<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Answer<T> {
        let permit = Arc::clone(&self.heavy).acquire_owned().await;
        let done = tokio::task::spawn_blocking(move || {
            let _permit = permit;
            work()
        });
        done.await.map_err(|_| failed())
    }
}

impl Record {
    fn seat(&self) -> MutexGuard<'_, Option<Seat>> {
        self.seat.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        self.hub.streams().remove(&self.id);
        let seat = self.record.seat().take();
        if let Some(Seat { world, arena }) = seat {
            self.hub.worlds.leave(&world, arena);
        }
        self.hub.worlds.release(self.id);
        self.hub.metrics.streams.dec();
        tracing::debug!(stream = self.id, connection = self.peer.connection, "stream ended");
    }
}

fn failed() -> Refusal {
    Refusal::new(Code::Internal, "the computation failed; see the server's log")
}

fn not_joined() -> Refusal {
    Refusal::precondition("no world is joined: send JoinWorld first")
}

/// A name that cannot be guessed.
fn name() -> Answer<String> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes)
        .map_err(|error| Refusal::new(Code::Internal, format!("no random name: {error}")))?;
    Ok(format!("{:032x}", u128::from_be_bytes(bytes)))
}

/// What a step asks for; the actions count only where an episode runs.
fn order(request: &StepRequest, specs: &Specs, running: bool) -> Answer<Order> {
    let mut observations = Vec::with_capacity(request.requested_observations.len().min(16));
    for uid in &request.requested_observations {
        let observation = Observation::of(*uid)?;
        if observations.iter().all(|(known, _)| known != uid) {
            observations.push((*uid, observation));
        }
    }
    let mut actions = None;
    if running {
        for (uid, tensor) in &request.actions {
            if *uid != ACTION {
                let message = format!("action {uid} is unknown; known is {ACTION}");
                return Err(Refusal::invalid(message));
            }
            let flat = doubles_of("action", tensor, &specs.action_shape())?;
            actions = Some(flat.chunks_exact(2).map(|pair| [pair[0], pair[1]]).collect());
        }
    }
    Ok(Order { actions, observations })
}

fn step_response(step: Step) -> StepResponse {
    StepResponse { state: step.state as i32, observations: step.observations.into_iter().collect() }
}

impl Seat {
    /// The step of a request, if it is short; else what it asks for.
    fn prepare(&mut self, request: &StepRequest, worlds: &Worlds) -> Answer<Result<Step, Order>> {
        let specs = &self.world.specs;
        if self.world.attention() {
            // The request is checked before anything changes.
            let order = order(request, specs, false)?;
            let running = self.arena.running();
            if worlds.interrupt(&self.world, &mut self.arena) && running {
                return Ok(Ok(self.arena.interrupt(&order, specs)));
            }
        }
        let order = order(request, specs, self.arena.running())?;
        if self.arena.microseconds() > INLINE {
            return Ok(Err(order));
        }
        self.arena.step(&order, specs).map(Ok)
    }
}

/// A step that a panic cannot leave.
fn guarded<T>(work: impl FnOnce() -> T) -> Answer<T> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|_| failed())
}

impl Session {
    /// A new stream.
    pub(crate) fn new(hub: Arc<Hub>, peer: Peer) -> Self {
        let id = hub.numbers.fetch_add(1, Ordering::Relaxed);
        let record = Arc::new(Record {
            last: AtomicU64::new(hub.now()),
            busy: AtomicBool::new(false),
            idle: CancellationToken::new(),
            seat: Mutex::new(None),
        });
        hub.streams().insert(id, Arc::clone(&record));
        hub.metrics.streams.inc();
        tracing::debug!(stream = id, connection = peer.connection, address = %peer.address, "stream opened");
        Self { hub, id, peer, record }
    }

    /// Told when the stream has been idle for too long.
    pub(crate) fn idle(&self) -> CancellationToken {
        self.record.idle.clone()
    }

    /// Answers a request.
    pub(crate) async fn answer(&mut self, request: EnvironmentRequest) -> EnvironmentResponse {
        let begin = Instant::now();
        self.record.busy.store(true, Ordering::Release);
        let requests = self.hub.metrics.of(request.payload.as_ref()).clone();
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
                self.leave();
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
            Response::Error(refusal.into())
        });
        requests.count(matches!(payload, Response::Error(_)), begin.elapsed().as_secs_f64());
        self.record.last.store(self.hub.now(), Ordering::Release);
        self.record.busy.store(false, Ordering::Release);
        EnvironmentResponse { payload: Some(payload) }
    }

    async fn create(&self, request: CreateWorldRequest) -> Answer<CreateWorldResponse> {
        let settings = WorldSettings::from_tensors(&request.settings, &self.hub.limits)?;
        let num_envs = settings.num_envs;
        let arms = (num_envs.unwrap_or(1) as f64 * weight(&settings.config)).ceil() as usize;
        let place = self.hub.worlds.reserve(self.peer.connection, arms)?;
        // The first of a kind swings an arm onto the target, which takes a while; it has its place
        // until that is done, even if its stream has ended.
        let (arena, place) = self.hub.run(move || (Arena::new(&settings), place)).await?;
        let arena = arena?;
        let (config, amplitude) = match &arena.body {
            Body::Single(episode) => (episode.config(), episode.swing().orbit.amplitude()),
            Body::Batch(batch) => (batch.config(0), batch.swing(0).orbit.amplitude()),
        };
        let specs = Specs::new(config, amplitude, num_envs);
        let world = Arc::new(World::new(name()?, specs));
        let world_name = world.name.clone();
        tracing::info!(stream = self.id, arms = arena.len(), "world created");
        self.hub.worlds.insert(world, arena, place, self.id);
        Ok(CreateWorldResponse { world_name })
    }

    fn join(&self, request: &JoinWorldRequest) -> Answer<JoinWorldResponse> {
        let mut seat = self.record.seat();
        if seat.is_some() {
            return Err(Refusal::precondition("this stream has joined a world: leave it first"));
        }
        if let Some(name) = request.settings.keys().next() {
            return Err(Refusal::invalid(format!(
                "unknown setting {}; JoinWorld takes none, CreateWorld does",
                quoted(name)
            )));
        }
        let (world, arena) = self.hub.worlds.join(&request.world_name)?;
        let specs = Some(world.specs.message.clone());
        *seat = Some(Seat { world, arena });
        Ok(JoinWorldResponse { specs })
    }

    async fn step(&self, request: StepRequest) -> Answer<StepResponse> {
        let (arms, prepared) = {
            let mut guard = self.record.seat();
            let seat = guard.as_mut().ok_or_else(not_joined)?;
            let arms = if seat.arena.running() { seat.arena.len() as u64 } else { 0 };
            let prepared = guarded(|| seat.prepare(&request, &self.hub.worlds));
            (arms, prepared.inspect_err(|_| self.lose(guard.take()))??)
        };
        let step = match prepared {
            Ok(step) => step,
            Err(order) => self.step_elsewhere(order).await?,
        };
        self.hub.metrics.steps.inc_by(arms);
        Ok(step_response(step))
    }

    /// A step that takes long.
    async fn step_elsewhere(&self, order: Order) -> Answer<Step> {
        let Seat { world, arena } = self.record.seat().take().ok_or_else(not_joined)?;
        let mut arms = Borrowed::new(Arc::clone(&self.hub.worlds), Arc::clone(&world), arena);
        let work = move || {
            let step = arms.with(|arena, world| guarded(|| arena.step(&order, &world.specs)).ok());
            (step, arms)
        };
        let (step, arms) = self.hub.run(work).await?;
        match (step, arms.unwrap()) {
            (Some(step), Some((world, arena))) => {
                *self.record.seat() = Some(Seat { world, arena });
                step
            }
            _ => {
                tracing::error!(stream = self.id, "a step failed: its world is given up");
                self.hub.worlds.lose(&world);
                Err(failed())
            }
        }
    }

    /// The arms are in a state that nobody knows.
    fn lose(&self, seat: Option<Seat>) {
        if let Some(seat) = seat {
            tracing::error!(stream = self.id, "a step failed: its world is given up");
            self.hub.worlds.lose(&seat.world);
        }
    }

    fn reset(&self, request: &ResetRequest) -> Answer<ResetResponse> {
        let next = NextReset::from_tensors(&request.settings)?;
        let mut guard = self.record.seat();
        let seat = guard.as_mut().ok_or_else(not_joined)?;
        seat.arena.reset(next);
        Ok(ResetResponse { specs: Some(seat.world.specs.message.clone()) })
    }

    async fn reset_world(&self, request: &ResetWorldRequest) -> Answer<ResetWorldResponse> {
        let next = NextReset::from_tensors(&request.settings)?;
        {
            let mut guard = self.record.seat();
            if let Some(seat) = guard.as_mut()
                && seat.world.name == request.world_name
            {
                self.hub.worlds.interrupt(&seat.world, &mut seat.arena);
                seat.arena.reset(next);
                return Ok(ResetWorldResponse {});
            }
        }
        let own = self.record.seat().as_ref().map(|seat| seat.world.name.clone());
        let own = own.as_deref();
        let Some(done) = self.hub.worlds.reset(&request.world_name, own, next)? else {
            return Ok(ResetWorldResponse {});
        };
        let result = tokio::select! {
            // An error: the world was freed before its client came to the end.
            done = done => done.map_err(|_| Refusal::new(Code::Aborted, "the world is gone")),
            () = self.hub.stop.cancelled() => {
                Err(Refusal::new(Code::Unavailable, "the server is shutting down"))
            }
            () = tokio::time::sleep(self.hub.limits.idle_timeout) => Err(Refusal::new(
                Code::DeadlineExceeded,
                "the world's client has made no step for so long (idle_timeout)",
            )),
        };
        if let Some(own) = own {
            self.hub.worlds.waited(own);
        }
        result.map(|()| ResetWorldResponse {})
    }

    fn extension(&self, request: &Any) -> Answer<Any> {
        let mut guard = self.record.seat();
        let joined = guard.as_mut().map(|seat| &mut seat.arena);
        // The state of many arms takes its time.
        let large = joined.as_ref().is_some_and(|arena| arena.len() > FEW_ARMS);
        let work = || guarded(|| properties::answer(request, &self.hub.worlds, joined));
        let answer = if large { tokio::task::block_in_place(work) } else { work() };
        answer.inspect_err(|_| self.lose(guard.take()))?
    }

    fn leave(&self) {
        if let Some(Seat { world, arena }) = self.record.seat().take() {
            self.hub.worlds.leave(&world, arena);
        }
    }

    fn destroy(&self, request: &DestroyWorldRequest) -> Answer<DestroyWorldResponse> {
        self.hub.worlds.destroy(&request.world_name)?;
        tracing::info!(stream = self.id, "world destroyed");
        Ok(DestroyWorldResponse {})
    }
}

#[cfg(test)]
mod tests;
