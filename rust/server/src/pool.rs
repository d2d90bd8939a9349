//! Threads for what takes long: few, whatever is asked of them, and shared fairly by the connections.
//!
//! A job does its work in parts. When its turn is over the others have theirs: the connections one after
//! the other, whatever number of jobs each has, and the jobs of a connection one after the other. A job
//! that nobody waits for any more ends with the part that it is in.

use std::collections::{HashMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use crate::metrics::Level;
use crate::reply::Answer;
use crate::world::failed;

/// Time after which a job that has parts left lets the others have their turn.
const TURN: Duration = Duration::from_millis(1);

/// A part of a job's work, which is told whether nobody waits for a turn; whether it was the last one.
type Job = Box<dyn FnMut(bool) -> bool + Send>;

/// Jobs that wait.
#[derive(Default)]
struct Turns {
    /// Those of every connection that has some.
    jobs: HashMap<u64, VecDeque<Job>>,
    /// The connections that have some, in the order of their turns.
    order: VecDeque<u64>,
    /// Jobs whose turn it is.
    running: usize,
}

impl Turns {
    fn push(&mut self, connection: u64, job: Job) {
        let jobs = self.jobs.entry(connection).or_default();
        if jobs.is_empty() {
            self.order.push_back(connection);
        }
        jobs.push_back(job);
    }

    fn pop(&mut self) -> Option<(u64, Job)> {
        let connection = self.order.pop_front()?;
        let jobs = self.jobs.get_mut(&connection)?;
        let job = jobs.pop_front()?;
        if jobs.is_empty() {
            self.jobs.remove(&connection);
        } else {
            self.order.push_back(connection);
        }
        Some((connection, job))
    }
}

/// A number of threads, and the jobs that share them.
pub(crate) struct Pool {
    threads: rayon::ThreadPool,
    turns: Mutex<Turns>,
    /// Jobs that wait, for the metrics.
    waiting: Level,
}

impl std::fmt::Debug for Pool {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Pool").finish_non_exhaustive()
    }
}

/// Lets other threads go first. It is no fault where that cannot be.
#[cfg(target_os = "linux")]
fn step_back(niceness: i32) {
    if niceness > 0 {
        // On Linux the priority of a process number is that of the one thread.
        let _ = rustix::process::setpriority_process(Some(rustix::thread::gettid()), niceness);
    }
}

#[cfg(not(target_os = "linux"))]
fn step_back(_: i32) {}

impl Pool {
    /// So many threads, which let others go first by so much (0 to 19). The jobs that wait are counted in
    /// `waiting`.
    ///
    /// # Errors
    /// What the system says if it gives no threads.
    pub(crate) fn new(
        name: &'static str,
        threads: usize,
        niceness: i32,
        waiting: Level,
    ) -> std::io::Result<Arc<Self>> {
        let threads = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(move |index| format!("{name}-{index}"))
            .start_handler(move |_| step_back(niceness))
            .build()
            .map_err(std::io::Error::other)?;
        Ok(Arc::new(Self { threads, turns: Mutex::default(), waiting }))
    }

    fn turns(&self) -> MutexGuard<'_, Turns> {
        self.turns.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Does a connection's job, part by part, until one gives the result. A part is told whether nobody else
    /// waits: it may be a larger one then. The job is dropped, with all that it holds, before the result is there; and soon, if nobody waits for the result any more.
    pub(crate) async fn run<T: Send + 'static>(
        self: &Arc<Self>,
        connection: u64,
        part: impl FnMut(bool) -> Option<T> + Send + 'static,
    ) -> Answer<T> {
        let (done, result) = oneshot::channel();
        let mut job = Some((part, done));
        self.submit(
            connection,
            Box::new(move |alone| {
                let Some((part, done)) = &mut job else { return true };
                let result = match done.is_closed() {
                    true => None,
                    false => match catch_unwind(AssertUnwindSafe(|| part(alone))) {
                        Ok(None) => return false,
                        Ok(Some(result)) => Some(Ok(result)),
                        Err(_) => Some(Err(failed())),
                    },
                };
                if let Some((part, done)) = job.take() {
                    drop(part);
                    result.map(|result| done.send(result));
                }
                true
            }),
        );
        result.await.unwrap_or_else(|_| Err(failed()))
    }

    /// [`Pool::run`] of work that has one part.
    pub(crate) async fn run_once<T: Send + 'static>(
        self: &Arc<Self>,
        connection: u64,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Answer<T> {
        let mut work = Some(work);
        self.run(connection, move |_| work.take().map(|work| work())).await
    }

    fn submit(self: &Arc<Self>, connection: u64, job: Job) {
        let mut turns = self.turns();
        turns.push(connection, job);
        self.waiting.inc();
        if turns.running < self.threads.current_num_threads() {
            turns.running += 1;
            self.next(turns);
        }
    }

    /// Whose turn it is has it on one of the threads.
    fn next(self: &Arc<Self>, mut turns: MutexGuard<'_, Turns>) {
        let Some((connection, job)) = turns.pop() else {
            turns.running -= 1;
            return;
        };
        drop(turns);
        self.waiting.dec();
        let pool = Arc::clone(self);
        self.threads.spawn(move || pool.turn(connection, job));
    }

    fn turn(self: Arc<Self>, connection: u64, mut job: Job) {
        let begin = Instant::now();
        let done = loop {
            let alone = self.turns().order.is_empty();
            if job(alone) {
                break true;
            }
            if begin.elapsed() >= TURN {
                break false;
            }
        };
        let mut turns = if done {
            drop(job);
            self.turns()
        } else {
            let mut turns = self.turns();
            turns.push(connection, job);
            self.waiting.inc();
            turns
        };
        if turns.order.is_empty() {
            turns.running -= 1;
        } else {
            self.next(turns);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// A part of a job that takes a turn.
    fn take_a_turn() {
        std::thread::sleep(TURN);
    }

    async fn settled(pool: &Arc<Pool>) {
        while pool.turns().running > 0 {
            tokio::time::sleep(TURN).await;
        }
    }

    #[tokio::test]
    async fn connections_take_turns_whatever_they_ask_for() {
        let pool = Pool::new("test", 1, 0, Level::default()).expect("pool");
        let greedy = Arc::new(AtomicUsize::new(0));
        let floods: Vec<_> = (0..20)
            .map(|_| {
                let (pool, greedy) = (Arc::clone(&pool), Arc::clone(&greedy));
                let part = move |_| {
                    take_a_turn();
                    greedy.fetch_add(1, Ordering::Relaxed);
                    None::<()>
                };
                tokio::spawn(async move { pool.run(1, part).await })
            })
            .collect();
        while greedy.load(Ordering::Relaxed) < 5 {
            tokio::time::sleep(TURN).await;
        }
        let before = greedy.load(Ordering::Relaxed);
        let seen = Arc::clone(&greedy);
        let mut left = 3;
        let part = move |_| {
            take_a_turn();
            left -= 1;
            (left == 0).then(|| seen.load(Ordering::Relaxed))
        };
        let after = pool.run(2, part).await.expect("result");
        // One turn of the other's for each of the three, and the one that ran.
        assert!(after - before <= 4, "{after} - {before}");
        floods.iter().for_each(tokio::task::JoinHandle::abort);
        settled(&pool).await;
    }

    #[tokio::test]
    async fn a_job_that_nobody_waits_for_ends() {
        let pool = Pool::new("test", 2, 0, Level::default()).expect("pool");
        let held = Arc::new(());
        let kept = Arc::clone(&held);
        let endless = move |_| {
            let _ = &kept;
            take_a_turn();
            None::<()>
        };
        let waiting = tokio::time::timeout(5 * TURN, pool.run(1, endless)).await;
        assert!(waiting.is_err());
        settled(&pool).await;
        assert_eq!(Arc::strong_count(&held), 1);
    }

    #[tokio::test]
    async fn a_panic_is_a_refusal_and_the_threads_go_on() {
        let pool = Pool::new("test", 1, 0, Level::default()).expect("pool");
        #[allow(clippy::panic)]
        let refused = pool.run_once(1, || panic!("on purpose")).await;
        let refused: Answer<()> = refused;
        assert_eq!(refused, Err(failed()));
        assert_eq!(pool.run_once(1, || 3).await, Ok(3));
    }
}
