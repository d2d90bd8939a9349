//! How many lines the log takes: nobody can fill a disk by doing something often.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tracing::{Event, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;

/// Lets so many events pass in a second.
#[derive(Clone, Debug)]
pub struct LogRate {
    most: u64,
    /// Events of this second.
    seen: Arc<AtomicU64>,
}

impl LogRate {
    /// At most so many lines a second, as long as [`LogRate::keep_watch`] runs.
    #[must_use]
    pub fn new(most: u64) -> Self {
        Self { most, seen: Arc::default() }
    }

    /// Counts the seconds; says of each how many lines were left out. It never completes.
    pub async fn keep_watch(self) {
        let mut second = tokio::time::interval(Duration::from_secs(1));
        loop {
            second.tick().await;
            let left_out = self.seen.swap(0, Ordering::Relaxed).saturating_sub(self.most);
            if left_out > 0 {
                tracing::warn!(lines = left_out, "lines of the log were left out (log_rate)");
            }
        }
    }
}

impl<S: Subscriber> Layer<S> for LogRate {
    fn event_enabled(&self, _: &Event<'_>, _: Context<'_, S>) -> bool {
        self.seen.fetch_add(1, Ordering::Relaxed) < self.most
    }
}

#[cfg(test)]
mod tests {
    use tracing_subscriber::layer::SubscriberExt as _;

    use super::*;

    /// Counts what reaches it.
    #[derive(Clone, Debug, Default)]
    struct Counter(Arc<AtomicU64>);

    impl<S: Subscriber> Layer<S> for Counter {
        fn on_event(&self, _: &Event<'_>, _: Context<'_, S>) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    #[test]
    fn a_second_has_so_many_lines() {
        let counter = Counter::default();
        let rate = LogRate::new(3);
        let subscriber = tracing_subscriber::registry().with(counter.clone()).with(rate.clone());
        tracing::subscriber::with_default(subscriber, || {
            for line in 0..10 {
                tracing::info!(line, "again");
            }
            assert_eq!(counter.0.load(Ordering::Relaxed), 3);
            let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build();
            let runtime = runtime.expect("runtime");
            // Its first second begins at once.
            runtime.block_on(async {
                let watch = rate.keep_watch();
                let _ = tokio::time::timeout(Duration::from_millis(1), watch).await;
            });
            // The line that says so, and the next.
            tracing::info!("again");
            assert_eq!(counter.0.load(Ordering::Relaxed), 5);
        });
    }
}
