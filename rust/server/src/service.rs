//! The environment service: streams of requests and their answers.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use octoarm_protocol::EnvironmentResponse;
use octoarm_protocol::environment_response::Payload;
use prost::Message as _;
use tokio_stream::Stream;
use tonic::{Request, Response, Status, Streaming};

use crate::auth::Owner;
use crate::codec::Environment;
use crate::intake::{Room, SMALL, Share};
use crate::listener::peer_of;
use crate::reply::Refusal;
use crate::session::Session;
use crate::sessions::Sessions;

/// The service.
#[derive(Clone, Debug)]
pub(crate) struct Service {
    pub(crate) sessions: Arc<Sessions>,
    /// For large answers on their way.
    pub(crate) room: Arc<Room>,
}

/// Takes room for a large answer until it has gone out; where there is none, the answer is that.
fn held(room: &Arc<Room>, answer: EnvironmentResponse) -> (EnvironmentResponse, Option<Share>) {
    let bytes = answer.encoded_len();
    if bytes <= SMALL {
        return (answer, None);
    }
    let mut share = room.share();
    match share.grow(bytes, false) {
        Ok(()) => (answer, Some(share)),
        Err(status) => {
            let refusal = Refusal::new(status.code(), status.message());
            (EnvironmentResponse { payload: Some(Payload::Error(refusal.into())) }, None)
        }
    }
}

type Answers = Pin<Box<dyn Stream<Item = Result<EnvironmentResponse, Status>> + Send>>;

/// Looks for the next request for a while without sleeping; none, if it takes longer. To wake a
/// sleeping processor costs more than most requests.
async fn busy_poll(
    requests: &mut Streaming<Bytes>,
    sessions: &Sessions,
) -> Option<Result<Option<Bytes>, Status>> {
    let end = Instant::now() + sessions.limits.busy_poll;
    while Instant::now() < end && !sessions.stop.is_cancelled() {
        let found = tokio::select! {
            biased;
            request = requests.message() => Some(request),
            () = std::future::ready(()) => None,
        };
        if found.is_some() {
            return found;
        }
        tokio::task::yield_now().await;
    }
    None
}

#[tonic::async_trait]
impl Environment for Service {
    type ProcessStream = Answers;

    async fn process(
        &self,
        request: Request<Streaming<Bytes>>,
    ) -> Result<Response<Answers>, Status> {
        let peer = peer_of(request.extensions())
            .ok_or_else(|| Status::internal("the connection is unknown"))?;
        if self.sessions.draining.is_cancelled() {
            return Err(Status::unavailable("the server is about to stop"));
        }
        let (sessions, room) = (Arc::clone(&self.sessions), Arc::clone(&self.room));
        let owner = request.extensions().get::<Owner>();
        let present = owner.map(|owner| sessions.metrics.present(&owner.0));
        let token = owner.map(|owner| Arc::clone(&owner.0));
        let mut requests = request.into_inner();
        let mut session = Session::new(Arc::clone(&sessions), peer, token);
        // One task does everything for a stream: it reads, computes and answers, and the next request
        // is read when the answer has been taken.
        let answers = async_stream::stream! {
            let _present = present;
            let idle = session.idle();
            let mut idle = std::pin::pin!(idle.cancelled());
            let mut stop = std::pin::pin!(sessions.stop.cancelled());
            let mut early = None;
            loop {
                let request = if let Some(request) = early.take() { request } else { tokio::select! {
                    biased;
                    () = &mut stop => Err(Status::unavailable("the server is shutting down")),
                    () = &mut idle => Err(Status::deadline_exceeded(format!(
                        "no request for {} s (idle_timeout)",
                        sessions.limits.idle_timeout.as_secs_f64()
                    ))),
                    request = requests.message() => request,
                } };
                let answer = match request {
                    Ok(Some(request)) => session.serve(request).await,
                    Ok(None) => break,
                    Err(status) => Err(status),
                };
                match answer {
                    Ok(answer) => {
                        let (answer, share) = held(&room, answer);
                        yield Ok(answer);
                        // The next one is asked for: this one is on its way.
                        drop(share);
                    }
                    Err(status) => {
                        tracing::debug!(%status, "stream broken off");
                        yield Err(status);
                        break;
                    }
                }
                // A client that sends ahead lets the others have their turn, and its answers go out.
                tokio::task::yield_now().await;
                if sessions.can_busy_poll() && session.is_quick() {
                    early = busy_poll(&mut requests, &sessions).await;
                }
            }
        };
        Ok(Response::new(Box::pin(answers)))
    }
}
