//! A stream of messages to a gRPC server: what is sent, and what comes, as bytes.
//!
//! Whoever waits for an answer reads the connection, without a thread in between: a thread that wakes
//! another one costs as much as some steps of an arm. While nobody waits, a thread of the stream's own
//! answers now and then what keeps the connection alive.

mod access;
mod codec;
mod connector;
mod ending;
mod tls;

use std::io;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::time::Duration;

use bytes::Bytes;
use http::uri::PathAndQuery;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::yield_now;
use tokio::time::{sleep, timeout};
use tokio_stream::wrappers::UnboundedReceiverStream;
use tokio_util::sync::CancellationToken;
use tonic::Request;
use tonic::client::Grpc;
use tonic::metadata::AsciiMetadataValue;
use tonic::transport::Channel;

pub use crate::access::Access;
use crate::codec::BytesCodec;
use crate::connector::Connector;
pub use crate::ending::Ending;

/// Whatever a server says to this, and be it that it knows no such method, there is one.
const HEALTH: PathAndQuery = PathAndQuery::from_static("/grpc.health.v1.Health/Check");

/// Time after which a failed attempt to connect is followed by another one, at first and at most.
const FIRST_PAUSE: Duration = Duration::from_millis(50);
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// Time after which a connection that nobody waits for is looked at \[s\], and how often its tasks may then
/// go on one after the other.
const PAUSE: Duration = Duration::from_millis(250);
const GLANCE: usize = 16;

/// What comes of a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// A server is there.
    Ready,
    /// A message of the server's.
    Message(Bytes),
    /// The stream has ended. It is the last event.
    Ended(Ending),
}

/// What reads and writes the connection, and what has come. It moves only while somebody drives it.
#[derive(Debug)]
struct Driver {
    runtime: Runtime,
    events: UnboundedReceiver<Event>,
}

/// A driver that threads take in turn, until it is given up.
#[derive(Debug)]
struct Shared {
    driver: Mutex<Option<Driver>>,
    closed: CancellationToken,
    /// A process that was forked has its own end of nothing here.
    process: u32,
}

impl Shared {
    /// Waits for what comes next, but no longer than this.
    fn next(&self, patience: Duration) -> Option<Event> {
        if self.process != std::process::id() {
            return Some(Event::Ended(Ending::forked()));
        }
        let mut driver = self.driver.lock().unwrap_or_else(PoisonError::into_inner);
        let event = match &mut *driver {
            None => Some(None),
            Some(Driver { runtime, events }) => runtime.block_on(async {
                let come = timeout(patience, events.recv());
                self.closed.run_until_cancelled(come).await.map_or(Some(None), Result::ok)
            }),
        };
        drop(driver);
        self.tidy();
        event.map(|event| event.unwrap_or_else(|| Event::Ended(Ending::over())))
    }

    /// Does what there is to do without waiting, if nobody else drives the connection.
    fn glance(&self) {
        if let Ok(driver) = self.driver.try_lock()
            && let Some(Driver { runtime, .. }) = &*driver
        {
            runtime.block_on(async {
                for _ in 0..GLANCE {
                    yield_now().await;
                }
            });
        }
        self.tidy();
    }

    /// Gives up the connection if the stream is closed. Whoever drives it does so when he is done.
    fn tidy(&self) {
        if !self.closed.is_cancelled() {
            return;
        }
        let driver = match self.driver.try_lock() {
            Ok(mut driver) => driver.take(),
            Err(TryLockError::Poisoned(driver)) => driver.into_inner().take(),
            Err(TryLockError::WouldBlock) => None,
        };
        let Some(driver) = driver else { return };
        if self.process == std::process::id() {
            // A search for a name that goes on keeps nobody waiting.
            driver.runtime.shutdown_background();
        } else {
            // It shares with the parent what watches the connection.
            std::mem::forget(driver);
        }
    }
}

/// A stream. When it is dropped, it ends.
#[derive(Debug)]
pub struct Stream {
    requests: UnboundedSender<Bytes>,
    shared: Arc<Shared>,
    /// Its end is that of the thread which keeps the connection alive.
    _alive: mpsc::Sender<()>,
}

impl Drop for Stream {
    fn drop(&mut self) {
        self.close();
    }
}

impl Stream {
    /// Opens a stream of a method, such as `/package.Service/Method`, to a server that is waited for so
    /// long.
    ///
    /// # Errors
    /// What the system says if it gives no thread; a token that cannot be sent.
    pub fn open(access: Access, method: &'static str, patience: Duration) -> io::Result<Self> {
        let (requests, outgoing) = unbounded_channel();
        let (incoming, events) = unbounded_channel();
        let mut call = Request::new(UnboundedReceiverStream::new(outgoing));
        if let Some(token) = &access.token {
            call.metadata_mut().insert("authorization", authorization(token)?);
        }
        let runtime = Builder::new_current_thread().enable_all().build()?;
        runtime.spawn(converse(access, method, patience, call, incoming));
        let shared = Arc::new(Shared {
            driver: Mutex::new(Some(Driver { runtime, events })),
            closed: CancellationToken::new(),
            process: std::process::id(),
        });
        let (alive, ended) = mpsc::channel();
        let watched = Arc::clone(&shared);
        std::thread::Builder::new().name("octoarm-stream".to_owned()).spawn(move || {
            while ended.recv_timeout(PAUSE) == Err(RecvTimeoutError::Timeout) {
                watched.glance();
            }
        })?;
        Ok(Self { requests, shared, _alive: alive })
    }

    /// Sends a message, while [`Stream::next`] waits. After the end of the stream nobody gets it.
    pub fn send(&self, message: Bytes) {
        // The end is told by what comes.
        let _ = self.requests.send(message);
    }

    /// Waits for what comes next; None if nothing did within this time. After the end of the stream it ends
    /// again.
    pub fn next(&self, patience: Duration) -> Option<Event> {
        self.shared.next(patience)
    }

    /// Ends the stream; any thread may do it at any time.
    pub fn close(&self) {
        self.shared.closed.cancel();
        self.shared.tidy();
    }
}

/// Opens a connection. The first request over it shows whether a server of gRPC is there.
///
/// # Errors
/// Why there is no way.
pub async fn connect(access: &Access) -> Result<Channel, Ending> {
    Connector::new(access)?.connect().await
}

/// Connects, as often as it takes until somebody answers.
async fn wait_for_server(connector: Connector) -> Grpc<Channel> {
    let mut pause = FIRST_PAUSE;
    loop {
        let attempt = async {
            let mut client =
                Grpc::new(connector.connect().await?).max_decoding_message_size(usize::MAX);
            client.ready().await.map_err(Ending::of_transport)?;
            let asked = client.unary(Request::new(Bytes::new()), HEALTH, BytesCodec).await;
            match asked.map_err(Ending::from) {
                Err(ending) if ending.broken => Err(ending),
                _ => Ok(client),
            }
        };
        if let Ok(client) = attempt.await {
            return client;
        }
        sleep(pause).await;
        pause = (2 * pause).min(LONGEST_PAUSE);
    }
}

/// What is shown for a token.
fn authorization(token: &str) -> io::Result<AsciiMetadataValue> {
    let value = format!("Bearer {token}").parse();
    // The error would show it.
    let mut value: AsciiMetadataValue =
        value.map_err(|_| io::Error::new(io::ErrorKind::InvalidInput, "token"))?;
    value.set_sensitive(true);
    Ok(value)
}

/// Connects, sends the requests, and hands out what comes.
async fn converse(
    access: Access,
    method: &'static str,
    patience: Duration,
    call: Request<UnboundedReceiverStream<Bytes>>,
    events: UnboundedSender<Event>,
) {
    let Ok(connector) = Connector::new(&access) else { return };
    let Ok(client) = timeout(patience, wait_for_server(connector)).await else { return };
    // Whoever waited for it may be gone, then and later.
    if events.send(Event::Ready).is_ok() {
        let ending = talk(client, method, call, &events).await;
        let _ = events.send(Event::Ended(ending));
    }
}

async fn talk(
    mut client: Grpc<Channel>,
    method: &'static str,
    call: Request<UnboundedReceiverStream<Bytes>>,
    events: &UnboundedSender<Event>,
) -> Ending {
    if let Err(error) = client.ready().await {
        return Ending::of_transport(error);
    }
    let path = PathAndQuery::from_static(method);
    let mut answers = match client.streaming(call, path, BytesCodec).await {
        Ok(response) => response.into_inner(),
        Err(status) => return status.into(),
    };
    loop {
        match answers.message().await {
            Ok(Some(message)) => {
                if events.send(Event::Message(message)).is_err() {
                    return Ending::over();
                }
            }
            Ok(None) => return Ending::over(),
            Err(status) => return status.into(),
        }
    }
}
