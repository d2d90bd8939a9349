//! Threads that share a list of independent pieces of work with the thread that asks.

use std::sync::{Mutex, PoisonError};

use octoarm_arm::ParameterError;

/// Most threads of a batch.
const MOST_THREADS: usize = 1024;

/// A number of threads, the calling one included. The others are started when they are first needed.
#[derive(Debug)]
pub(crate) struct Workers {
    threads: usize,
    /// The helpers, and the process they belong to: after a fork there are none.
    helpers: Option<(u32, rayon::ThreadPool)>,
}

impl Workers {
    /// `threads` of them; without a number, as many as the processor runs at once.
    pub(crate) fn new(threads: Option<usize>) -> Result<Self, ParameterError> {
        let threads = threads.unwrap_or_else(|| {
            std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
        });
        if !(1..=MOST_THREADS).contains(&threads) {
            let range = format!("[1, {MOST_THREADS}]");
            return Err(ParameterError::out_of_range("threads", threads, range));
        }
        Ok(Self { threads, helpers: None })
    }

    pub(crate) fn threads(&self) -> usize {
        self.threads
    }

    /// Does every piece of work once, in any order. The calling thread works too, and begins at once.
    pub(crate) fn for_each<T: Send>(&mut self, pieces: Vec<T>, work: impl Fn(T) + Sync) {
        let helpers = (self.threads - 1).min(pieces.len().saturating_sub(1));
        let pool = if helpers > 0 { self.pool() } else { None };
        let Some(pool) = pool else {
            pieces.into_iter().for_each(work);
            return;
        };
        let queue = Mutex::new(pieces.into_iter());
        let drain = || {
            loop {
                let piece = queue.lock().unwrap_or_else(PoisonError::into_inner).next();
                let Some(piece) = piece else { break };
                work(piece);
            }
        };
        pool.in_place_scope(|scope| {
            for _ in 0..helpers {
                scope.spawn(|_| drain());
            }
            drain();
        });
    }

    /// The helpers; none if the system gives no threads, and the caller then works alone.
    fn pool(&mut self) -> Option<&rayon::ThreadPool> {
        let process = std::process::id();
        if self.helpers.as_ref().is_some_and(|(owner, _)| *owner != process) {
            // The threads stayed with the parent; there is nobody to be told to stop.
            std::mem::forget(self.helpers.take());
        }
        if self.helpers.is_none() {
            let builder = rayon::ThreadPoolBuilder::new()
                .num_threads(self.threads - 1)
                .thread_name(|index| format!("octoarm-{index}"));
            self.helpers = builder.build().ok().map(|pool| (process, pool));
        }
        self.helpers.as_ref().map(|(_, pool)| pool)
    }
}
