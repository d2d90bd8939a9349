//! Connections: accepted one by one, counted, given up when they are silent or come to nothing.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::Sleep;
use tokio_io_timeout::TimeoutStream;
use tokio_stream::Stream;
use tonic::Extensions;
use tonic::transport::server::{Connected, TlsConnectInfo};

use crate::metrics::Metrics;

/// Wait after an error of the system, such as no more file descriptors.
const BREATH: Duration = Duration::from_millis(100);

/// Who is at the other end.
#[derive(Clone, Debug)]
pub(crate) struct Peer {
    /// Number of the connection.
    pub(crate) connection: u64,
    /// Its address.
    pub(crate) address: SocketAddr,
    /// Whether a call came over it that was let in.
    pub(crate) accepted: Arc<AtomicBool>,
    /// Calls with a wrong token that came over it.
    pub(crate) wrong_tokens: Arc<AtomicU32>,
}

/// Calls with a wrong token after which a connection is closed: who guesses must connect anew.
const MOST_WRONG_TOKENS: u32 = 3;

/// Number of the last connection.
static LAST: AtomicU64 = AtomicU64::new(0);

/// Number of the next connection.
pub(crate) fn next_connection() -> u64 {
    LAST.load(Ordering::Acquire) + 1
}

/// Who has sent a request.
pub(crate) fn peer_of(extensions: &Extensions) -> Option<Peer> {
    let plain = extensions.get::<Peer>();
    plain.or_else(|| extensions.get::<TlsConnectInfo<Peer>>().map(TlsConnectInfo::get_ref)).cloned()
}

/// How many connections there may be, and for how long.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ConnectionLimits {
    /// Connections at a time; more wait.
    pub(crate) most: usize,
    /// Time in which something must be read, or could be written if there is something to write. A
    /// living peer is asked for signs of life more often than that.
    pub(crate) silence: Duration,
    /// Time until a call has been let in.
    pub(crate) probation: Duration,
}

/// An open connection of the gRPC port, as the metrics count it.
#[derive(Debug)]
struct Open {
    metrics: Arc<Metrics>,
    connection: u64,
}

impl Drop for Open {
    fn drop(&mut self) {
        self.metrics.connections.dec();
        tracing::debug!(connection = self.connection, "connection closed");
    }
}

/// A connection, or what came of it.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: Pin<Box<TimeoutStream<TcpStream>>>,
    peer: Peer,
    /// Ends connections over which no call was let in; none any more when one was.
    probation: Option<Pin<Box<Sleep>>>,
    open: Option<Open>,
    _permit: Option<OwnedSemaphorePermit>,
}

impl Connected for Connection {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer.clone()
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let over = |probation: &mut Pin<Box<Sleep>>| probation.as_mut().poll(context).is_ready();
        if self.probation.as_mut().is_some_and(over) {
            if !self.peer.accepted.load(Ordering::Acquire) {
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
            self.probation = None;
        }
        let read = self.stream.as_mut().poll_read(context, buffer);
        // The refusals go out; what comes after them is not looked at.
        let wrong = self.peer.wrong_tokens.load(Ordering::Acquire);
        if read.is_ready() && wrong >= MOST_WRONG_TOKENS {
            tracing::info!(address = %self.peer.address, wrong, "connection closed: wrong tokens");
            return Poll::Ready(Err(io::ErrorKind::PermissionDenied.into()));
        }
        read
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.stream.as_mut().poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stream.as_mut().poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stream.as_mut().poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.stream.as_mut().poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}

/// A listener whose connections are so many at most and time out. No error of a connection or of the
/// system ends it.
#[derive(Debug)]
pub(crate) struct Listener {
    listener: TcpListener,
    permits: Arc<Semaphore>,
    silence: Duration,
}

impl Listener {
    /// Gives at most `most` connections at a time, which must not be silent for longer.
    pub(crate) fn new(listener: TcpListener, most: usize, silence: Duration) -> Self {
        let permits = Arc::new(Semaphore::new(most.min(Semaphore::MAX_PERMITS)));
        Self { listener, permits, silence }
    }

    async fn next(&self) -> Connection {
        // The semaphore is never closed: there is always a permit.
        let permit = Arc::clone(&self.permits).acquire_owned().await.ok();
        let (stream, address) = loop {
            match self.listener.accept().await {
                Ok(accepted) => break accepted,
                Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => {}
                Err(error) => {
                    tracing::warn!(%error, "no connection accepted");
                    tokio::time::sleep(BREATH).await;
                }
            }
        };
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "no TCP_NODELAY");
        }
        let mut stream = TimeoutStream::new(stream);
        stream.set_read_timeout(Some(self.silence));
        stream.set_write_timeout(Some(self.silence));
        let connection = LAST.fetch_add(1, Ordering::AcqRel) + 1;
        Connection {
            stream: Box::pin(stream),
            peer: Peer {
                connection,
                address,
                accepted: Arc::default(),
                wrong_tokens: Arc::default(),
            },
            probation: None,
            open: None,
            _permit: permit,
        }
    }
}

impl axum::serve::Listener for Listener {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        let connection = self.next().await;
        let address = connection.peer.address;
        (connection, address)
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// The connections of the gRPC port.
pub(crate) fn connections(
    listener: TcpListener,
    limits: ConnectionLimits,
    metrics: Arc<Metrics>,
) -> impl Stream<Item = io::Result<Connection>> {
    let listener = Listener::new(listener, limits.most, limits.silence);
    async_stream::stream! {
        loop {
            let mut accepted = listener.next().await;
            let Peer { connection, address, .. } = accepted.peer;
            tracing::debug!(connection, %address, "connection opened");
            metrics.connections.inc();
            accepted.probation = Some(Box::pin(tokio::time::sleep(limits.probation)));
            accepted.open = Some(Open { metrics: Arc::clone(&metrics), connection });
            yield Ok(accepted);
        }
    }
}
