//! The token that clients must present.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use tonic::service::Interceptor;
use tonic::{Request, Status};

use crate::listener::peer_of;
use crate::metrics::Metrics;
use crate::tokens::Tokens;

/// The name of the token that a call was let in with, among its extensions.
#[derive(Clone, Debug)]
pub(crate) struct Owner(pub(crate) Arc<str>);

/// Refuses calls without one of the tokens.
#[derive(Clone, Debug)]
pub(crate) struct Guard {
    /// Without any every call passes.
    pub(crate) tokens: Arc<Tokens>,
    /// Where the refused are counted.
    pub(crate) metrics: Arc<Metrics>,
}

impl Interceptor for Guard {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        let peer = peer_of(request.extensions());
        let welcome = |request| {
            if let Some(peer) = &peer {
                peer.accepted.store(true, Ordering::Release);
            }
            Ok(request)
        };
        if self.tokens.is_empty() {
            return welcome(request);
        }
        let given = request.metadata().get("authorization").map(|value| value.as_bytes());
        let given = given.and_then(|value| value.split_at_checked(7)).filter(|(scheme, _)| {
            // RFC 7235: the scheme's case does not matter.
            scheme.eq_ignore_ascii_case(b"bearer ")
        });
        let address = peer.as_ref().map(|peer| peer.address);
        let refusal = match given {
            Some((_, given)) => {
                // Without a connection it is none of those that there were.
                let connection = peer.as_ref().map_or(u64::MAX, |peer| peer.connection);
                if let Some(token) = self.tokens.owner(given, connection) {
                    tracing::debug!(?address, %token, "call let in");
                    request.extensions_mut().insert(Owner(token));
                    return welcome(request);
                }
                if let Some(peer) = &peer {
                    peer.wrong_tokens.fetch_add(1, Ordering::AcqRel);
                }
                "the token is wrong"
            }
            None => {
                "this server needs a token: send the metadata \"authorization: Bearer <token>\""
            }
        };
        self.metrics.unauthenticated.inc();
        tracing::debug!(?address, refusal, "call refused");
        Err(Status::unauthenticated(refusal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tokens::Token;

    #[test]
    fn only_the_token_passes() {
        let tokens = Token::read("it", "0123456789abcdef\n").expect("token");
        let tokens = Arc::new(Tokens::new(tokens, None));
        let mut guard = Guard { tokens, metrics: Metrics::new() };
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
        assert!(
            Guard { tokens: Arc::new(Tokens::new(Vec::new(), None)), metrics: Metrics::new() }
                .call(Request::new(()))
                .is_ok()
        );
    }
}
