//! Threads that share a list of independent pieces of work with the thread that asks.

use std::sync::{Arc, Mutex, PoisonError};

use octoarm_arm::ParameterError;

/// Most threads that a batch may ask for.
const MOST_THREADS: usize = 1024;

/// The helpers of this process, and the process they belong to: after a fork there are none.
static HELPERS: Mutex<Option<(u32, Arc<rayon::ThreadPool>)>> = Mutex::new(None);

fn processors() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

/// The helpers, which all batches of the process share, however many there are: one fewer than the
/// processor runs threads at once, for whoever asks works too, and a helper that finds nothing to do looks for
/// work for a while, in the others' way. They are started when they are first needed; none if the system gives
/// no threads.
fn helpers() -> Option<Arc<rayon::ThreadPool>> {
    let process = std::process::id();
    let mut shared = HELPERS.lock().unwrap_or_else(PoisonError::into_inner);
    if shared.as_ref().is_some_and(|(owner, _)| *owner != process) {
        // The threads stayed with the parent; there is nobody to be told to stop.
        std::mem::forget(shared.take());
    }
    let count = processors() - 1;
    if shared.is_none() && count > 0 {
        let builder = rayon::ThreadPoolBuilder::new()
            .num_threads(count)
            .thread_name(|index| format!("octoarm-{index}"));
        *shared = builder.build().ok().map(|pool| (process, Arc::new(pool)));
    }
    shared.as_ref().map(|(_, pool)| Arc::clone(pool))
}

/// The largest number of threads that share a batch's work, the calling one included.
#[derive(Debug)]
pub(crate) struct Workers {
    threads: usize,
}

impl Workers {
    /// At most `threads` of them; without a number, as many as the processor runs at once.
    pub(crate) fn new(threads: Option<usize>) -> Result<Self, ParameterError> {
        let threads = threads.unwrap_or_else(processors);
        if !(1..=MOST_THREADS).contains(&threads) {
            let range = format!("[1, {MOST_THREADS}]");
            return Err(ParameterError::out_of_range("threads", threads, range));
        }
        Ok(Self { threads })
    }

    pub(crate) fn threads(&self) -> usize {
        self.threads
    }

    /// Does every piece of work once, in any order. The calling thread works too, and begins at once.
    /// One of a rayon pool is helped by the others of its own pool.
    pub(crate) fn for_each<T: Send>(&self, pieces: Vec<T>, work: impl Fn(T) + Sync) {
        let count = (self.threads - 1).min(pieces.len().saturating_sub(1));
        let queue = Mutex::new(pieces.into_iter());
        let drain = || {
            loop {
                let piece = queue.lock().unwrap_or_else(PoisonError::into_inner).next();
                let Some(piece) = piece else { break };
                work(piece);
            }
        };
        if count > 0 && rayon::current_thread_index().is_some() {
            rayon::scope(|scope| {
                (0..count).for_each(|_| scope.spawn(|_| drain()));
                drain();
            });
        } else if let Some(pool) = (count > 0).then(helpers).flatten() {
            pool.in_place_scope(|scope| {
                (0..count).for_each(|_| scope.spawn(|_| drain()));
                drain();
            });
        } else {
            drain();
        }
    }
}
