//! The environment service: streams of requests and their answers.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Instant;

use tokio_stream::Stream;
use tonic::{Request, Response, Status, Streaming};

use crate::listener::peer_of;
use crate::protocol::environment_server::Environment;
use crate::protocol::{EnvironmentRequest, EnvironmentResponse};
use crate::session::Session;
use crate::sessions::Sessions;

/// The service.
#[derive(Clone, Debug)]
pub(crate) struct Service {
    pub(crate) sessions: Arc<Sessions>,
}

type Answers = Pin<Box<dyn Stream<Item = Result<EnvironmentResponse, Status>> + Send>>;

/// Looks for the next request for a while without sleeping; none, if it takes longer. To wake a
/// sleeping processor costs more than most requests.
async fn busy_poll(
    requests: &mut Streaming<EnvironmentRequest>,
    sessions: &Sessions,
) -> Option<Result<Option<EnvironmentRequest>, Status>> {
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
        request: Request<Streaming<EnvironmentRequest>>,
    ) -> Result<Response<Answers>, Status> {
        let peer = peer_of(request.extensions())
            .ok_or_else(|| Status::internal("the connection is unknown"))?;
        let sessions = Arc::clone(&self.sessions);
        let mut requests = request.into_inner();
        let mut session = Session::new(Arc::clone(&sessions), peer);
        // One task does everything for a stream: it reads, computes and answers, and the next request
        // is read when the answer has been taken.
        let answers = async_stream::stream! {
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
                match request {
                    Ok(Some(request)) => yield Ok(session.answer(request).await),
                    Ok(None) => break,
                    Err(status) => {
                        tracing::debug!(%status, "stream broken off");
                        yield Err(status);
                        break;
                    }
                }
                // A client that sends ahead lets the others have their turn, and its answers go out.
                tokio::task::yield_now().await;
                if sessions.can_busy_poll() {
                    early = busy_poll(&mut requests, &sessions).await;
                }
            }
        };
        Ok(Response::new(Box::pin(answers)))
    }
}
