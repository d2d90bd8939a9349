//! Connections: accepted one by one, counted, given up when they are silent or come to nothing.

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio::time::{Instant, Sleep};
use tokio_io_timeout::TimeoutStream;
use tokio_stream::Stream;
use tokio_util::sync::{CancellationToken, WaitForCancellationFutureOwned};
use tonic::Extensions;
use tonic::transport::server::{Connected, TlsConnectInfo};

use crate::metrics::Metrics;

/// Wait after an error of the system, such as no more file descriptors.
const BREATH: Duration = Duration::from_millis(100);
/// Times in a row that a connection must be found silent. After a pause of the whole process, which looks
/// like silence, a peer is asked for a sign of life before the second.
const STRIKES: u32 = 2;

/// Bytes that are taken at a time of a connection over which no call was let in, and the pause after them:
/// what came is dealt with meanwhile, and dropped for the most part.
const PORTION: usize = 1 << 15;
const PAUSE: Duration = Duration::from_millis(10);

/// Who is at the other end.
#[derive(Clone, Debug)]
pub(crate) struct Peer {
    /// Number of the connection.
    pub(crate) connection: u64,
    /// Its address.
    pub(crate) address: SocketAddr,
    /// Whether a call came over it that was let in.
    pub(crate) accepted: Arc<AtomicBool>,
    /// Whether a call came over it that watches the server's health.
    pub(crate) watches: Arc<AtomicBool>,
    /// Calls for the health that are not answered to their end.
    pub(crate) calls: Arc<AtomicUsize>,
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

impl Peer {
    /// Who has said nothing yet.
    pub(crate) fn new(connection: u64, address: SocketAddr) -> Self {
        Self {
            connection,
            address,
            accepted: Arc::default(),
            watches: Arc::default(),
            calls: Arc::default(),
            wrong_tokens: Arc::default(),
        }
    }
}

/// Who has sent a request.
pub(crate) fn peer_of(extensions: &Extensions) -> Option<Peer> {
    let plain = extensions.get::<Peer>();
    plain.or_else(|| extensions.get::<TlsConnectInfo<Peer>>().map(TlsConnectInfo::get_ref)).cloned()
}

/// How many connections there may be, and for how long.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ConnectionLimits {
    /// Connections at a time; one more takes the place of the oldest over which no call was let in, or
    /// waits if there is none.
    pub(crate) most: usize,
    /// Connections at a time from one address; what is more is closed.
    pub(crate) most_of_address: usize,
    /// Time in which something must be read, or could be written if there is something to write. A
    /// living peer is asked for signs of life more often than that.
    pub(crate) silence: Duration,
    /// Time until a call has been let in, or one watches the health.
    pub(crate) probation: Duration,
}

/// What is known of an open connection.
#[derive(Debug)]
struct Slot {
    address: IpAddr,
    accepted: Arc<AtomicBool>,
    /// Told when another takes its place.
    evicted: CancellationToken,
}

impl Slot {
    /// Whether no call was let in.
    fn unknown(&self) -> bool {
        !self.accepted.load(Ordering::Acquire)
    }

    /// Whether it was not told to go.
    fn stays(&self) -> bool {
        !self.evicted.is_cancelled()
    }
}

/// The open connections; those with the smallest numbers are the oldest.
#[derive(Debug, Default)]
struct Slots {
    open: Mutex<BTreeMap<u64, Slot>>,
    freed: Notify,
}

impl Slots {
    fn open(&self) -> MutexGuard<'_, BTreeMap<u64, Slot>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A place among the open connections, until the connection is closed.
#[derive(Debug)]
struct Place {
    slots: Arc<Slots>,
    connection: u64,
    evicted: CancellationToken,
    /// Of the gRPC port, whose connections are counted.
    metrics: Option<Arc<Metrics>>,
}

impl Drop for Place {
    fn drop(&mut self) {
        self.slots.open().remove(&self.connection);
        self.slots.freed.notify_one();
        if let Some(metrics) = &self.metrics {
            metrics.connections.dec();
            tracing::debug!(connection = self.connection, "connection closed");
        }
    }
}

/// What counts as one address: of IPv6 the network, since a machine has as many addresses of it as it
/// likes.
fn place_of(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() >> 64 << 64)),
        address => address,
    }
}

/// A connection, or what came of it.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: Pin<Box<TimeoutStream<TcpStream>>>,
    peer: Peer,
    /// Ends connections over which no call was let in; none any more when one was.
    probation: Option<Pin<Box<Sleep>>>,
    evicted: Option<Pin<Box<WaitForCancellationFutureOwned>>>,
    /// Bytes that were read since the last pause, before a call was let in.
    portion: usize,
    pause: Option<Pin<Box<Sleep>>>,
    /// When something was read.
    heard: Instant,
    silence: Pin<Box<Sleep>>,
    /// Time from one look for silence to the next.
    patience: Duration,
    strikes: u32,
    _place: Place,
}

impl Connected for Connection {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer.clone()
    }
}

impl Connection {
    /// Why the connection is to be closed, if it is.
    fn poll_end(&mut self, context: &mut Context<'_>) -> Poll<&'static str> {
        if self.evicted.as_mut().is_some_and(|told| told.as_mut().poll(context).is_ready()) {
            self.evicted = None;
            return Poll::Ready("another takes its place");
        }
        let over = |probation: &mut Pin<Box<Sleep>>| probation.as_mut().poll(context).is_ready();
        if self.probation.as_mut().is_some_and(over) {
            let known = |flag: &AtomicBool| flag.load(Ordering::Acquire);
            if !known(&self.peer.accepted) && !known(&self.peer.watches) {
                return Poll::Ready("no call was let in");
            }
            self.probation = None;
        }
        while self.silence.as_mut().poll(context).is_ready() {
            let (now, next) = (Instant::now(), self.heard + self.patience);
            if next > now {
                self.strikes = 0;
                self.silence.as_mut().reset(next);
            } else {
                self.strikes += 1;
                if self.strikes >= STRIKES {
                    return Poll::Ready("nothing was heard");
                }
                self.silence.as_mut().reset(now + self.patience);
            }
        }
        Poll::Pending
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let known = self.peer.accepted.load(Ordering::Acquire);
        if known || self.pause.as_mut().is_some_and(|pause| pause.as_mut().poll(context).is_ready())
        {
            self.pause = None;
        }
        let before = buffer.filled().len();
        let read = match self.pause {
            Some(_) => Poll::Pending,
            None => self.stream.as_mut().poll_read(context, buffer),
        };
        let count = buffer.filled().len() - before;
        if count > 0 {
            self.heard = Instant::now();
            self.strikes = 0;
            self.portion += count;
            if !known && self.portion >= PORTION {
                self.portion = 0;
                self.pause = Some(Box::pin(tokio::time::sleep(PAUSE)));
            }
        }
        match self.poll_end(context) {
            Poll::Ready(reason) => {
                let Peer { connection, address, .. } = self.peer;
                tracing::debug!(connection, %address, reason, "connection given up");
                Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
            }
            Poll::Pending => {
                // The refusals go out; what comes after them is not looked at.
                let wrong = self.peer.wrong_tokens.load(Ordering::Acquire);
                if read.is_ready() && wrong >= MOST_WRONG_TOKENS {
                    tracing::info!(address = %self.peer.address, wrong, "connection closed: wrong tokens");
                    return Poll::Ready(Err(io::ErrorKind::PermissionDenied.into()));
                }
                read
            }
        }
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
    slots: Arc<Slots>,
    limits: ConnectionLimits,
    /// Where the connections are counted, if they are.
    metrics: Option<Arc<Metrics>>,
}

impl Listener {
    /// Gives connections within these limits.
    pub(crate) fn new(
        listener: TcpListener,
        limits: ConnectionLimits,
        metrics: Option<Arc<Metrics>>,
    ) -> Self {
        Self { listener, slots: Arc::default(), limits, metrics }
    }

    /// The next one that the system has.
    async fn accept(&self) -> (TcpStream, SocketAddr) {
        loop {
            match self.listener.accept().await {
                Ok(accepted) => return accepted,
                Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => {}
                Err(error) => {
                    tracing::warn!(%error, "no connection accepted");
                    tokio::time::sleep(BREATH).await;
                }
            }
        }
    }

    fn count(&self, reason: &'static str) {
        if let Some(metrics) = &self.metrics {
            metrics.turned_away(reason);
        }
    }

    /// A place for a connection, if there is one now. If all are taken, the oldest that nobody knows is
    /// told to go.
    fn place(&self, peer: &Peer) -> Option<Place> {
        let mut open = self.slots.open();
        if open.len() >= self.limits.most {
            // Those that were told to go may make room enough.
            if open.values().filter(|slot| slot.stays()).count() >= self.limits.most
                && let Some(slot) = open.values().find(|slot| slot.stays() && slot.unknown())
            {
                slot.evicted.cancel();
                self.count("evicted");
            }
            return None;
        }
        let evicted = CancellationToken::new();
        let slot = Slot {
            address: place_of(peer.address.ip()),
            accepted: Arc::clone(&peer.accepted),
            evicted: evicted.clone(),
        };
        open.insert(peer.connection, slot);
        if let Some(metrics) = &self.metrics {
            metrics.connections.inc();
        }
        let (slots, metrics) = (Arc::clone(&self.slots), self.metrics.clone());
        Some(Place { slots, connection: peer.connection, evicted, metrics })
    }

    /// Whether an address has as many connections as it may, and all of them are known. If one is not,
    /// it is told to go.
    fn crowded(&self, address: SocketAddr) -> bool {
        let place = place_of(address.ip());
        let open = self.slots.open();
        let same = || open.values().filter(|slot| slot.address == place && slot.stays());
        if same().count() < self.limits.most_of_address {
            return false;
        }
        let Some(slot) = same().find(|slot| slot.unknown()) else { return true };
        slot.evicted.cancel();
        self.count("evicted");
        false
    }

    async fn next(&self) -> Connection {
        let (stream, address) = loop {
            let (stream, address) = self.accept().await;
            if !self.crowded(address) {
                break (stream, address);
            }
            self.count("address");
            tracing::debug!(%address, "connection closed: too many from its address");
        };
        let peer = Peer::new(LAST.fetch_add(1, Ordering::AcqRel) + 1, address);
        let place = loop {
            // Before the look, lest one is freed in between.
            let freed = self.slots.freed.notified();
            match self.place(&peer) {
                Some(place) => break place,
                // Also one that is unknown now may be the next to go.
                None => drop(tokio::time::timeout(BREATH, freed).await),
            }
        };
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "no TCP_NODELAY");
        }
        tracing::debug!(connection = peer.connection, %address, "connection opened");
        let ConnectionLimits { silence, probation, .. } = self.limits;
        let mut stream = TimeoutStream::new(stream);
        stream.set_write_timeout(Some(silence));
        let patience = silence / STRIKES;
        Connection {
            stream: Box::pin(stream),
            peer,
            probation: Some(Box::pin(tokio::time::sleep(probation))),
            evicted: Some(Box::pin(place.evicted.clone().cancelled_owned())),
            portion: 0,
            pause: None,
            heard: Instant::now(),
            silence: Box::pin(tokio::time::sleep(patience)),
            patience,
            strikes: 0,
            _place: place,
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
    let listener = Listener::new(listener, limits, Some(metrics));
    async_stream::stream! {
        loop {
            yield Ok(listener.next().await);
        }
    }
}
