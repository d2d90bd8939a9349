//! All streams of a server, and what they share.

use std::collections::BTreeMap;
use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;
use tonic::Code;

use crate::metrics::Metrics;
use crate::pool::Pool;
use crate::reply::{Answer, Refusal};
use crate::settings::{Limits, cores};
use crate::worlds::{Agent, Worlds};

/// Longest work that counts as short \[µs\], and the most threads for it.
const SHORT: f64 = 5000.0;
const MOST_SHORT: usize = 8;
/// Time from one look at the running episodes to the next.
const GLANCE: Duration = Duration::from_millis(20);
/// By how much the threads of long work let the others go first.
const NICENESS: i32 = 5;

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
    /// For what takes milliseconds: a share of the processor that long work does not get.
    short: Arc<Pool>,
    /// For what takes longer.
    long: Arc<Pool>,
    /// Told when nothing new may begin.
    pub(crate) draining: CancellationToken,
    /// Told when the server stops.
    pub(crate) stop: CancellationToken,
    open: Mutex<BTreeMap<u64, Arc<Activity>>>,
    started: Instant,
    numbers: AtomicU64,
    cores: i64,
}

impl Sessions {
    /// A list without streams.
    ///
    /// # Errors
    /// What the system says if it gives no threads.
    pub(crate) fn new(
        limits: Limits,
        metrics: Arc<Metrics>,
        stop: CancellationToken,
        server_threads: usize,
    ) -> io::Result<Arc<Self>> {
        // A world may be allowed more: they would not make it faster.
        let threads = limits.max_threads.min(cores());
        let pool =
            |name, threads, niceness| Pool::new(name, threads, niceness, metrics.waiting(name));
        Ok(Arc::new(Self {
            worlds: Worlds::new(limits.clone(), Arc::clone(&metrics)),
            short: pool("short", threads.min(MOST_SHORT), 0)?,
            long: pool("long", threads, NICENESS)?,
            draining: CancellationToken::new(),
            limits,
            metrics,
            stop,
            open: Mutex::default(),
            started: Instant::now(),
            numbers: AtomicU64::new(1),
            cores: cores().min(server_threads) as i64,
        }))
    }

    /// Where work is done that takes about so long \[µs\].
    pub(crate) fn pool(&self, microseconds: f64) -> &Arc<Pool> {
        if microseconds <= SHORT { &self.short } else { &self.long }
    }

    /// Completes when no stream is in an episode.
    pub(crate) async fn episodes_over(&self) {
        let running = || {
            let open: Vec<Arc<Activity>> = self.open().values().cloned().collect();
            let agents = open.iter().filter_map(|activity| activity.agent().clone());
            // Without the list, which those who leave need too.
            let agents: Vec<Arc<Agent>> = agents.collect();
            agents.iter().any(|agent| agent.world.running())
        };
        while running() {
            tokio::time::sleep(GLANCE).await;
        }
    }

    /// Nothing new begins on a server that is about to stop.
    pub(crate) fn refuse_while_draining(&self) -> Answer<()> {
        if self.draining.is_cancelled() {
            return Err(Refusal::new(Code::Unavailable, "the server is about to stop"));
        }
        Ok(())
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
}
