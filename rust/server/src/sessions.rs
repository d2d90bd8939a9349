//! All streams of a server, and what they share.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use crate::metrics::Metrics;
use crate::reply::Answer;
use crate::settings::{Limits, cores};
use crate::world::failed;
use crate::worlds::{Agent, Worlds};

/// What is known of a stream, whether or not anybody reads its answers.
#[derive(Debug)]
pub(crate) struct Activity {
    /// When the last request was answered \[ms since the server's start\].
    last: AtomicU64,
    /// Whether a request is being answered.
    busy: AtomicBool,
    /// Told when the stream has been idle for too long.
    pub(crate) idle: CancellationToken,
    agent: Mutex<Option<Arc<Agent>>>,
}

impl Activity {
    /// What the stream has joined.
    pub(crate) fn agent(&self) -> MutexGuard<'_, Option<Arc<Agent>>> {
        self.agent.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The stream's client leaves what it has joined.
    pub(crate) fn leave(&self) {
        let agent = self.agent().take();
        drop(agent);
    }
}

/// The streams.
#[derive(Debug)]
pub(crate) struct Sessions {
    pub(crate) worlds: Arc<Worlds>,
    pub(crate) limits: Limits,
    pub(crate) metrics: Arc<Metrics>,
    /// Long computations at a time.
    long: Arc<Semaphore>,
    /// Told when the server stops.
    pub(crate) stop: CancellationToken,
    open: Mutex<BTreeMap<u64, Arc<Activity>>>,
    started: Instant,
    numbers: AtomicU64,
    cores: i64,
}

impl Sessions {
    /// A list without streams.
    pub(crate) fn new(
        limits: Limits,
        metrics: Arc<Metrics>,
        stop: CancellationToken,
        server_threads: usize,
    ) -> Arc<Self> {
        Arc::new(Self {
            worlds: Worlds::new(limits.clone(), Arc::clone(&metrics)),
            long: Arc::new(Semaphore::new(limits.max_threads)),
            limits,
            metrics,
            stop,
            open: Mutex::default(),
            started: Instant::now(),
            numbers: AtomicU64::new(1),
            cores: cores().min(server_threads) as i64,
        })
    }

    fn now(&self) -> u64 {
        self.started.elapsed().as_millis() as u64
    }

    fn open(&self) -> MutexGuard<'_, BTreeMap<u64, Arc<Activity>>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of streams.
    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.open().len()
    }

    /// A stream has begun; gives its number.
    pub(crate) fn add(&self) -> (u64, Arc<Activity>) {
        let id = self.numbers.fetch_add(1, Ordering::Relaxed);
        let activity = Arc::new(Activity {
            last: AtomicU64::new(self.now()),
            busy: AtomicBool::new(false),
            idle: CancellationToken::new(),
            agent: Mutex::new(None),
        });
        self.open().insert(id, Arc::clone(&activity));
        self.metrics.streams.inc();
        (id, activity)
    }

    /// A stream has ended: what its client made is freed.
    pub(crate) fn remove(&self, id: u64) {
        if let Some(activity) = self.open().remove(&id) {
            activity.leave();
        }
        self.worlds.release(id);
        self.metrics.streams.dec();
    }

    /// A stream's request begins to be answered.
    pub(crate) fn begin(&self, activity: &Activity) {
        activity.busy.store(true, Ordering::Release);
    }

    /// A stream's request is answered.
    pub(crate) fn end(&self, activity: &Activity) {
        activity.last.store(self.now(), Ordering::Release);
        activity.busy.store(false, Ordering::Release);
    }

    /// Whether the streams are so few that half of the serving threads can wait for them.
    pub(crate) fn can_busy_poll(&self) -> bool {
        !self.limits.busy_poll.is_zero() && 2 * self.metrics.streams.get() <= self.cores
    }

    /// Ends the streams that have been idle for too long, and frees what they hold: also of those whose
    /// client reads no answers, so that they are not served.
    pub(crate) fn end_idle(&self) {
        let limit = self.limits.idle_timeout.as_millis() as u64;
        let now = self.now();
        let is_idle = |activity: &Activity| {
            !activity.busy.load(Ordering::Acquire)
                && !activity.idle.is_cancelled()
                && now.saturating_sub(activity.last.load(Ordering::Acquire)) > limit
        };
        let idle: Vec<(u64, Arc<Activity>)> = self
            .open()
            .iter()
            .filter(|(_, activity)| is_idle(activity))
            .map(|(id, activity)| (*id, Arc::clone(activity)))
            .collect();
        for (id, activity) in idle {
            let mut agent = activity.agent();
            // It may have come to life meanwhile.
            if !is_idle(&activity) {
                continue;
            }
            activity.idle.cancel();
            let agent = agent.take();
            self.metrics.idle.inc();
            tracing::info!(stream = id, "idle stream ended");
            drop(agent);
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
    pub(crate) async fn run_long<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Answer<T> {
        let permit = Arc::clone(&self.long).acquire_owned().await;
        let done = tokio::task::spawn_blocking(move || {
            let _permit = permit;
            work()
        });
        done.await.map_err(|_| failed())
    }
}
