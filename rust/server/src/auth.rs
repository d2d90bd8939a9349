//! The token that clients must present.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use subtle::ConstantTimeEq;
use tonic::service::Interceptor;
use tonic::{Request, Status};

use crate::listener::peer_of;
use crate::metrics::Metrics;
use crate::settings::Token;

/// Refuses calls without the token.
#[derive(Clone, Debug)]
pub(crate) struct Guard {
    /// Without one every call passes.
    pub(crate) token: Option<Token>,
    /// Where the refused are counted.
    pub(crate) metrics: Arc<Metrics>,
}

impl Interceptor for Guard {
    fn call(&mut self, request: Request<()>) -> Result<Request<()>, Status> {
        let peer = peer_of(request.extensions());
        let welcome = |request| {
            if let Some(peer) = &peer {
                peer.accepted.store(true, Ordering::Release);
            }
            Ok(request)
        };
        let Some(Token(token)) = &self.token else { return welcome(request) };
        let given = request.metadata().get("authorization").map(|value| value.as_bytes());
        let given = given.and_then(|value| value.split_at_checked(7)).filter(|(scheme, _)| {
            // RFC 7235: the scheme's case does not matter.
            scheme.eq_ignore_ascii_case(b"bearer ")
        });
        let refusal = match given {
            // In a time that tells nothing of where they differ.
            Some((_, given)) if bool::from(given.ct_eq(token.as_bytes())) => {
                return welcome(request);
            }
            Some(_) => "the token is wrong",
            None => {
                "this server needs a token: send the metadata \"authorization: Bearer <token>\""
            }
        };
        self.metrics.unauthenticated.inc();
        tracing::debug!(address = ?peer.map(|peer| peer.address), refusal, "call refused");
        Err(Status::unauthenticated(refusal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_token_passes() {
        let token = Token::new("it", "0123456789abcdef\n").expect("token");
        let mut guard = Guard { token: Some(token), metrics: Metrics::new() };
        let mut call = |value: Option<&'static str>| {
            let mut request = Request::new(());
            if let Some(value) = value {
                let value = value.parse().expect("metadata");
                request.metadata_mut().insert("authorization", value);
            }
            guard.call(request).map(|_| ()).map_err(|status| status.code())
        };
        assert_eq!(call(Some("Bearer 0123456789abcdef")), Ok(()));
        assert_eq!(call(Some("bearer 0123456789abcdef")), Ok(()));
        for wrong in [
            None,
            Some(""),
            Some("Bearer "),
            Some("Bearer 0123456789abcdeg"),
            Some("Bearer 0123456789abcdef0"),
            Some("Basic 0123456789abcdef"),
            Some("0123456789abcdef"),
        ] {
            assert_eq!(call(wrong), Err(tonic::Code::Unauthenticated), "{wrong:?}");
        }
    }

    #[test]
    fn without_a_token_every_call_passes() {
        assert!(Guard { token: None, metrics: Metrics::new() }.call(Request::new(())).is_ok());
    }
}
