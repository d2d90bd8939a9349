//! Connections: accepted one by one, counted, given up when they are silent.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep};
use tokio_stream::Stream;
use tonic::transport::server::Connected;

use crate::metrics::Metrics;

/// Wait after an error of the system, such as no more file descriptors.
const BREATH: Duration = Duration::from_millis(100);

/// Who is at the other end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Peer {
    /// Number of the connection.
    pub(crate) connection: u64,
    /// Its address.
    pub(crate) address: SocketAddr,
}

/// A connection. A living one is asked for signs of life, so that a silent one is dead, or was never
/// meant to speak: reading from it fails after the time given.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: TcpStream,
    peer: Peer,
    silence: Duration,
    deadline: Pin<Box<Sleep>>,
    metrics: Arc<Metrics>,
    _permit: OwnedSemaphorePermit,
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.metrics.connections.dec();
        tracing::debug!(connection = self.peer.connection, "connection closed");
    }
}

impl Connected for Connection {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        match Pin::new(&mut self.stream).poll_read(context, buffer) {
            Poll::Ready(result) => {
                let deadline = Instant::now() + self.silence;
                self.deadline.as_mut().reset(deadline);
                Poll::Ready(result)
            }
            Poll::Pending if self.deadline.as_mut().poll(context).is_ready() => {
                Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
            }
            Poll::Pending => Poll::Pending,
        }
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}

/// The connections of a listener, at most so many at a time; more wait until one is closed. No error of
/// a connection or of the system ends it.
pub(crate) fn connections(
    listener: TcpListener,
    most: usize,
    silence: Duration,
    metrics: Arc<Metrics>,
) -> impl Stream<Item = io::Result<Connection>> {
    static NUMBER: AtomicU64 = AtomicU64::new(1);
    async_stream::stream! {
        let permits = Arc::new(Semaphore::new(most.min(Semaphore::MAX_PERMITS)));
        loop {
            let Ok(permit) = Arc::clone(&permits).acquire_owned().await else { break };
            let (stream, address) = loop {
                match listener.accept().await {
                    Ok(accepted) => break accepted,
                    Err(error) => {
                        tracing::warn!(%error, "no connection accepted");
                        tokio::time::sleep(BREATH).await;
                    }
                }
            };
            if let Err(error) = stream.set_nodelay(true) {
                tracing::debug!(%error, "no TCP_NODELAY");
            }
            let connection = NUMBER.fetch_add(1, Ordering::Relaxed);
            tracing::debug!(connection, %address, "connection opened");
            metrics.connections.inc();
            yield Ok(Connection {
                stream,
                peer: Peer { connection, address },
                silence,
                deadline: Box::pin(tokio::time::sleep(silence)),
                metrics: Arc::clone(&metrics),
                _permit: permit,
            });
        }
    }
}
