//! Long computations that can be told to stop.

use std::cell::RefCell;
use std::time::{Duration, Instant};

use crate::error::ParameterError;

/// Time between two questions; a user who presses Ctrl-C waits no longer than this.
const INTERVAL: Duration = Duration::from_millis(50);

struct Question {
    stop: Box<dyn FnMut() -> bool>,
    asked: Instant,
}

thread_local! {
    static QUESTION: RefCell<Option<Question>> = const { RefCell::new(None) };
}

/// Does `work`, which asks `stop` about every 50 ms whether to give up: whoever waits for the search of
/// an equilibrium, say, wants to be heard within it. Only work on the calling thread asks.
pub fn interruptible<R>(stop: impl FnMut() -> bool + 'static, work: impl FnOnce() -> R) -> R {
    struct Restore(Option<Question>);
    impl Drop for Restore {
        fn drop(&mut self) {
            QUESTION.set(self.0.take());
        }
    }
    let question = Question { stop: Box::new(stop), asked: Instant::now() };
    let _restore = Restore(QUESTION.replace(Some(question)));
    work()
}

/// Asks whether to go on; to be called at least every few milliseconds of a long computation.
///
/// # Errors
/// [`ParameterError::Interrupted`] within [`interruptible`] work that is to stop.
pub fn poll() -> Result<(), ParameterError> {
    QUESTION.with_borrow_mut(|question| match question {
        Some(question) if question.asked.elapsed() >= INTERVAL => {
            let stop = (question.stop)();
            question.asked = Instant::now();
            if stop { Err(ParameterError::Interrupted) } else { Ok(()) }
        }
        _ => Ok(()),
    })
}
