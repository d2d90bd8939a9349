//! What comes in before anything is done with it: how many bytes the server holds of requests, how long a
//! request may take to arrive, and how many calls there may be on a connection that nobody knows yet.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use bytes::Bytes;
use http::{Request, Response};
use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::Sleep;
use tonic::Status;
use tonic::body::Body;
use tower::{Layer, Service};

use crate::listener::{Peer, peer_of};
use crate::metrics::Level;

/// Most calls at a time for the health over a connection over which none was let in. Any other is let in
/// or refused at once.
const FEW_CALLS: usize = 8;
/// The service that needs no token.
const HEALTH: &str = "/grpc.health.v1.Health/";
/// Bytes of a request or answer for which the last quarter of the room is kept.
pub(crate) const SMALL: usize = 1 << 16;
/// Bytes before a message: whether it is compressed, and its length.
const HEADER: usize = 5;
/// Its call that lives on: so may the connection.
const WATCH: &str = "/grpc.health.v1.Health/Watch";

/// How much the server holds of requests that are not answered, and of large answers that are not sent.
#[derive(Debug)]
pub(crate) struct Room {
    taken: AtomicUsize,
    most: usize,
    level: Level,
}

/// A share of the room.
#[derive(Debug)]
pub(crate) struct Share {
    room: Arc<Room>,
    bytes: usize,
}

impl Drop for Share {
    fn drop(&mut self) {
        self.shrink(0);
    }
}

impl Room {
    /// Room for so many bytes; `level` tells how many are taken.
    pub(crate) fn new(most: usize, level: Level) -> Arc<Self> {
        Arc::new(Self { taken: AtomicUsize::new(0), most, level })
    }

    /// A share that holds nothing yet.
    pub(crate) fn share(self: &Arc<Self>) -> Share {
        Share { room: Arc::clone(self), bytes: 0 }
    }
}

impl Share {
    /// Takes more bytes, of a message that is `small` or not.
    pub(crate) fn grow(&mut self, bytes: usize, small: bool) -> Result<(), Status> {
        let Room { taken, most, level } = &*self.room;
        let limit = if small { *most } else { most - most / 4 };
        let fits = |taken: usize| taken.checked_add(bytes).filter(|sum| *sum <= limit);
        if taken.fetch_update(Ordering::AcqRel, Ordering::Acquire, fits).is_err() {
            return Err(Status::resource_exhausted(format!(
                "requests and answers on their way have taken the {limit} bytes that there are for \
                 them (max_bytes_in_flight): try again later"
            )));
        }
        self.bytes += bytes;
        level.set(taken.load(Ordering::Relaxed) as i64);
        Ok(())
    }

    /// Gives all back but so many bytes.
    fn shrink(&mut self, bytes: usize) {
        let back = self.bytes.saturating_sub(bytes);
        if back > 0 {
            self.bytes -= back;
            let before = self.room.taken.fetch_sub(back, Ordering::AcqRel);
            self.room.level.set(before.saturating_sub(back) as i64);
        }
    }
}

/// Where a sequence of gRPC messages stands.
#[derive(Debug, Default)]
struct Framing {
    header: [u8; HEADER],
    /// Bytes of the header that have come.
    known: usize,
    /// Bytes of the message that have not.
    missing: usize,
    /// Bytes that have come of the message that has not come to its end.
    begun: usize,
}

impl Framing {
    /// More has come.
    fn advance(&mut self, mut data: &[u8]) {
        while !data.is_empty() {
            if self.known < HEADER {
                let count = data.len().min(HEADER - self.known);
                self.header[self.known..self.known + count].copy_from_slice(&data[..count]);
                self.known += count;
                self.begun += count;
                data = &data[count..];
                if self.known < HEADER {
                    break;
                }
                let [_, length @ ..] = self.header;
                self.missing = u32::from_be_bytes(length) as usize;
            }
            let count = data.len().min(self.missing);
            self.missing -= count;
            self.begun += count;
            data = &data[count..];
            if self.missing == 0 {
                (self.known, self.begun) = (0, 0);
            }
        }
    }
}

/// What a client sends over a stream.
struct Incoming {
    body: Body,
    framing: Framing,
    /// Of what has been handed on: the messages that are being answered, and what has come of the next.
    share: Share,
    timeout: Duration,
    /// Until when a message that has begun must have come to its end.
    deadline: Option<Pin<Box<Sleep>>>,
}

impl HttpBody for Incoming {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let this = &mut *self;
        // More is wanted: what came before is done with, but for the message that is not complete.
        this.share.shrink(this.framing.begun);
        match Pin::new(&mut this.body).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) => {
                if let Some(data) = frame.data_ref() {
                    let before = this.framing.begun;
                    this.framing.advance(data);
                    if this.framing.begun <= before {
                        // Another message: it has its own time.
                        this.deadline = None;
                    }
                    let small = this.framing.begun.max(data.len()) <= SMALL;
                    this.share.grow(data.len(), small)?;
                }
                Poll::Ready(Some(Ok(frame)))
            }
            Poll::Pending if this.framing.begun > 0 => {
                let timeout = this.timeout;
                let deadline =
                    this.deadline.get_or_insert_with(|| Box::pin(tokio::time::sleep(timeout)));
                if deadline.as_mut().poll(context).is_pending() {
                    return Poll::Pending;
                }
                Poll::Ready(Some(Err(Status::deadline_exceeded(format!(
                    "a request was not sent to its end within {} s (message_timeout)",
                    timeout.as_secs_f64()
                )))))
            }
            other => other,
        }
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// A call for the health over a connection, until its answer has gone out.
struct Call(Arc<AtomicUsize>);

impl Drop for Call {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// What the server sends over a stream, and the call that it belongs to if that is for the health.
struct Outgoing {
    body: Body,
    _call: Option<Call>,
}

impl HttpBody for Outgoing {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// Stands before all services.
#[derive(Clone, Debug)]
pub(crate) struct Intake {
    pub(crate) room: Arc<Room>,
    /// Time that a request may take from its first byte to its last.
    pub(crate) message_timeout: Duration,
}

impl<S> Layer<S> for Intake {
    type Service = Guarded<S>;

    fn layer(&self, inner: S) -> Guarded<S> {
        Guarded { intake: self.clone(), inner }
    }
}

/// All services, behind the intake.
#[derive(Clone, Debug)]
pub(crate) struct Guarded<S> {
    intake: Intake,
    inner: S,
}

/// Counts a call; none if there are too many of them on a connection that nobody knows.
fn enter(peer: &Peer) -> Option<Call> {
    let before = peer.calls.fetch_add(1, Ordering::AcqRel);
    let call = Call(Arc::clone(&peer.calls));
    (before < FEW_CALLS || peer.accepted.load(Ordering::Acquire)).then_some(call)
}

type Answered<E> = Pin<Box<dyn Future<Output = Result<Response<Body>, E>> + Send>>;

impl<S> Service<Request<Body>> for Guarded<S>
where
    S: Service<Request<Body>, Response = Response<Body>>,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = Answered<S::Error>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        let mut call = None;
        let path = request.uri().path();
        let peer = path.starts_with(HEALTH).then(|| peer_of(request.extensions())).flatten();
        if let Some(peer) = peer {
            if path == WATCH {
                peer.watches.store(true, Ordering::Release);
            }
            call = enter(&peer);
            if call.is_none() {
                let status = Status::resource_exhausted(format!(
                    "at most {FEW_CALLS} calls for the health at a time before another one is let in"
                ));
                return Box::pin(std::future::ready(Ok(status.into_http())));
            }
        }
        let Intake { room, message_timeout } = &self.intake;
        let (share, timeout) = (room.share(), *message_timeout);
        let request = request.map(|body| {
            let framing = Framing::default();
            Body::new(Incoming { body, framing, share, timeout, deadline: None })
        });
        let answered = self.inner.call(request);
        Box::pin(async move {
            let response = answered.await?;
            Ok(response.map(|body| Body::new(Outgoing { body, _call: call })))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_told_apart_wherever_they_are_cut() {
        let mut bytes = Vec::new();
        for length in [0_usize, 1, 300, 70_000, 5] {
            bytes.push(0);
            bytes.extend((length as u32).to_be_bytes());
            bytes.extend(vec![7; length]);
        }
        for cut in [1, 2, 3, 4, 5, 6, 7, 299, 305, 65_536, bytes.len()] {
            let mut framing = Framing::default();
            let ends: Vec<usize> = bytes
                .chunks(cut)
                .scan(0, |come, piece| {
                    framing.advance(piece);
                    *come += piece.len();
                    Some(*come - framing.begun)
                })
                .collect();
            // Where the messages that have come to their end do end.
            assert!(ends.iter().all(|end| [0, 5, 11, 316, 70_321, 70_331].contains(end)), "{cut}");
            assert_eq!((framing.known, framing.begun, framing.missing), (0, 0, 0));
        }
    }

    #[test]
    fn the_room_is_shared_and_comes_back() {
        let room = Room::new(1000, Level::default());
        let (mut one, mut other) = (room.share(), room.share());
        assert!(one.grow(700, false).is_ok());
        assert_eq!(
            other.grow(100, false).expect_err("full").code(),
            tonic::Code::ResourceExhausted
        );
        assert!(other.grow(300, true).is_ok());
        assert!(other.grow(1, true).is_err());
        one.shrink(200);
        assert!(other.grow(500, true).is_ok());
        drop((one, other));
        assert_eq!(room.taken.load(Ordering::Relaxed), 0);
        assert_eq!(room.level.get(), 0);
    }
}
