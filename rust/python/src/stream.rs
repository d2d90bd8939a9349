//! A stream to a server, for Python: waiting releases the GIL and ends with Ctrl-C.

use std::time::{Duration, Instant};

use octoarm_client::{Access, Ending, Event, Stream as Inner};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

use crate::messages::{Answer, Request, answer};

/// The one method of the protocol.
const METHOD: &str = "/dm_env_rpc.v1.Environment/Process";

/// Longest time after which Python's signals are looked for.
const SLICE: Duration = Duration::from_millis(20);

/// A stream to a server of dm_env_rpc. It ends with the object.
#[pyclass(frozen, module = "octoarm_env._core")]
pub(crate) struct Stream {
    inner: Inner,
}

/// A time from Python \[s\], which is no negative number; one too long to be reckoned with is without end.
fn seconds(value: f64) -> Duration {
    Duration::try_from_secs_f64(value).unwrap_or(Duration::MAX)
}

impl Stream {
    /// What comes next, within a time.
    fn next(&self, py: Python<'_>, patience: Duration) -> PyResult<Option<Event>> {
        let end = Instant::now().checked_add(patience);
        loop {
            let left = end.map_or(SLICE, |end| end.saturating_duration_since(Instant::now()));
            let event = py.detach(|| self.inner.next(left.min(SLICE)));
            if event.is_some() || left.is_zero() {
                return Ok(event);
            }
            py.check_signals()?;
        }
    }
}

#[pymethods]
impl Stream {
    #[new]
    #[pyo3(signature = (host, port, encrypted, roots, token, proxy, patience))]
    fn new(
        host: String,
        port: u16,
        encrypted: bool,
        roots: Option<Vec<u8>>,
        token: Option<String>,
        proxy: Option<(String, String)>,
        patience: f64,
    ) -> PyResult<Self> {
        let access = Access { host, port, encrypted, roots, token, proxy };
        let inner = Inner::open(access, METHOD, seconds(patience));
        Ok(Self { inner: inner.map_err(PyOSError::new_err)? })
    }

    /// Waits until a server is there, at most so long [s]; whether it is.
    fn ready(&self, py: Python<'_>, timeout: f64) -> PyResult<bool> {
        Ok(self.next(py, seconds(timeout))? == Some(Event::Ready))
    }

    /// Sends a request.
    fn send(&self, request: &Request) {
        self.inner.send(request.to_bytes().into());
    }

    /// Waits for the next answer, at most so long [s]; None if there was none. "ended" is how the stream
    /// did: the name of gRPC's code, and what is told.
    fn receive<'py>(&self, py: Python<'py>, timeout: f64) -> PyResult<Option<Answer<'py>>> {
        Ok(match self.next(py, seconds(timeout))? {
            None | Some(Event::Ready) => None,
            Some(Event::Message(message)) => Some(answer(py, &message)?),
            Some(Event::Ended(Ending { code, details, .. })) => {
                Some(("ended", (code, details).into_pyobject(py)?.into_any()))
            }
        })
    }

    /// Ends the stream.
    fn close(&self) {
        self.inner.close();
    }
}
