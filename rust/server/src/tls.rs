//! TLS: the certificate that is shown, which can be exchanged, and why no connection came of it.

use std::io;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use tokio::task::JoinSet;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{AlertDescription, Error, ServerConfig};
use tokio_rustls::server::TlsStream;
use tokio_stream::{Stream, StreamExt as _};
use tonic::transport::server::Connected as _;

use crate::listener::Connection;

/// Time before its end from which a certificate is warned of.
const SOON: Duration = Duration::from_secs(30 * 24 * 3600);

/// The files of a certificate and its key, PEM.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct CertificateFiles {
    pub(crate) certificate: PathBuf,
    pub(crate) key: PathBuf,
}

impl std::fmt::Display for CertificateFiles {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { certificate, key } = self;
        write!(formatter, "tls_certificate {}, tls_key {}", certificate.display(), key.display())
    }
}

/// From when to when a certificate holds \[s since 1970\].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Validity {
    begin: i64,
    end: i64,
}

fn now() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_secs().cast_signed())
}

/// A moment as RFC 2822 has it.
fn date(seconds: i64) -> String {
    let time = x509_parser::time::ASN1Time::from_timestamp(seconds);
    time.map_or_else(|_| format!("{seconds} s after 1970"), |time| time.to_string())
}

impl Validity {
    fn of(certificate: &CertificateDer<'_>) -> Result<Self, String> {
        let (_, certificate) = x509_parser::parse_x509_certificate(certificate)
            .map_err(|error| format!("the certificate cannot be read: {error}"))?;
        let validity = certificate.validity();
        Ok(Self { begin: validity.not_before.timestamp(), end: validity.not_after.timestamp() })
    }

    /// Why nobody can trust it at this moment, if nobody can.
    fn fault(self, now: i64) -> Option<String> {
        if now < self.begin {
            Some(format!("the certificate is not valid before {}", date(self.begin)))
        } else if now > self.end {
            Some(format!("the certificate expired on {}", date(self.end)))
        } else {
            None
        }
    }

    /// What its operator should know of it.
    fn warning(self, now: i64) -> Option<String> {
        self.fault(now).or_else(|| {
            (self.end - now < SOON.as_secs().cast_signed())
                .then(|| format!("the certificate expires on {}", date(self.end)))
        })
    }
}

/// A certificate that is in use.
#[derive(Clone)]
struct Shown {
    config: Arc<ServerConfig>,
    validity: Validity,
}

fn read(files: &CertificateFiles) -> Result<Shown, String> {
    let fail = |what: &str, error: String| format!("{files}: {what}{error}");
    let chain = CertificateDer::pem_file_iter(&files.certificate)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|error| fail("certificate: ", error.to_string()))?;
    let first =
        chain.first().ok_or_else(|| fail("", "there is no certificate in the file".to_owned()))?;
    let validity = Validity::of(first).map_err(|error| fail("", error))?;
    let key = PrivateKeyDer::from_pem_file(&files.key)
        .map_err(|error| fail("key: ", error.to_string()))?;
    let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, key))
        .map_err(|error| fail("", error.to_string()))?;
    config.alpn_protocols = vec![b"h2".to_vec()];
    Ok(Shown { config: Arc::new(config), validity })
}

/// What a handshake that failed says of the client.
fn reason(error: &io::Error, validity: Validity) -> String {
    let inner = error.get_ref().and_then(|inner| inner.downcast_ref::<Error>());
    let distrust = |what: &str| match validity.fault(now()) {
        Some(fault) => format!("the client refuses the certificate ({what}): {fault}"),
        None => format!("the client refuses the certificate ({what})"),
    };
    match inner {
        Some(Error::InvalidMessage(_)) => {
            "what came is no TLS: this port speaks TLS alone, https://".to_owned()
        }
        Some(Error::AlertReceived(alert)) => match alert {
            AlertDescription::CertificateExpired => distrust("expired"),
            AlertDescription::UnknownCA => distrust("it knows nobody who signed it"),
            AlertDescription::BadCertificate
            | AlertDescription::UnsupportedCertificate
            | AlertDescription::CertificateRevoked
            | AlertDescription::CertificateUnknown => distrust(&format!("{alert:?}")),
            other => format!("the client gave up: {other:?}"),
        },
        _ if error.kind() == io::ErrorKind::UnexpectedEof => {
            let gone = "the client went in the middle of the handshake";
            validity
                .fault(now())
                .map_or_else(|| gone.to_owned(), |fault| format!("{gone}; {fault}"))
        }
        _ => error.to_string(),
    }
}

/// The certificate that new connections are shown.
pub(crate) struct Tls {
    files: CertificateFiles,
    shown: RwLock<Shown>,
    /// Time in which a handshake must be done.
    patience: Duration,
    /// Second in which a failure was last told.
    told: AtomicU64,
}

impl std::fmt::Debug for Tls {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Tls").field("files", &self.files).finish_non_exhaustive()
    }
}

impl Tls {
    /// Reads certificate and key, and warns of what is soon over.
    pub(crate) fn new(files: CertificateFiles, patience: Duration) -> Result<Self, String> {
        let shown = read(&files)?;
        let tls = Self { files, shown: RwLock::new(shown), patience, told: AtomicU64::new(0) };
        tls.warn();
        Ok(tls)
    }

    fn shown(&self) -> Shown {
        self.shown.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn warn(&self) {
        if let Some(warning) = self.shown().validity.warning(now()) {
            tracing::warn!(files = %self.files, "{warning}");
        }
    }

    /// Shows new connections what the files hold now; where they cannot be used, what they were shown
    /// before.
    pub(crate) fn reload(&self) -> Result<(), String> {
        let shown = read(&self.files)?;
        *self.shown.write().unwrap_or_else(PoisonError::into_inner) = shown;
        self.warn();
        Ok(())
    }

    /// Whether a failure is told: one a second, whoever knocks how often.
    fn first_in_this_second(&self) -> bool {
        let second = now().cast_unsigned();
        self.told.swap(second, Ordering::Relaxed) != second
    }

    async fn accept(self: Arc<Self>, connection: Connection) -> Option<TlsStream<Connection>> {
        let peer = connection.connect_info();
        let Shown { config, validity } = self.shown();
        let handshake = TlsAcceptor::from(config).accept(connection);
        let reason = match tokio::time::timeout(self.patience, handshake).await {
            Ok(Ok(stream)) => return Some(stream),
            Ok(Err(error)) => reason(&error, validity),
            Err(_) => format!("no handshake within {} s", self.patience.as_secs_f64()),
        };
        let (connection, address) = (peer.connection, peer.address);
        if self.first_in_this_second() {
            tracing::warn!(connection, %address, "no TLS: {reason}");
        } else {
            tracing::debug!(connection, %address, "no TLS: {reason}");
        }
        None
    }

    /// The connections that come to speak TLS; none waits for another's handshake.
    pub(crate) fn secured(
        self: Arc<Self>,
        incoming: impl Stream<Item = io::Result<Connection>> + Send + 'static,
    ) -> impl Stream<Item = io::Result<TlsStream<Connection>>> {
        async_stream::stream! {
            let mut incoming = std::pin::pin!(incoming);
            let mut handshakes = JoinSet::new();
            loop {
                let done = tokio::select! {
                    connection = incoming.next() => match connection {
                        Some(Ok(connection)) => {
                            handshakes.spawn(Arc::clone(&self).accept(connection));
                            None
                        }
                        Some(Err(error)) => Some(Err(error)),
                        None => break,
                    },
                    Some(done) = handshakes.join_next() => done.ok().flatten().map(Ok),
                };
                if let Some(done) = done {
                    yield done;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_certificate_has_its_time() {
        let day = 24 * 3600;
        let validity = Validity { begin: 100 * day, end: 200 * day };
        assert!(validity.fault(99 * day).is_some_and(|fault| fault.contains("not valid before")));
        assert!(validity.fault(201 * day).is_some_and(|fault| fault.contains("expired on")));
        assert_eq!(validity.fault(199 * day), None);
        assert_eq!(validity.warning(150 * day), None);
        assert!(validity.warning(180 * day).is_some_and(|text| text.contains("expires on")));
        assert!(validity.warning(201 * day).is_some_and(|text| text.contains("expired on")));
    }

    #[test]
    fn what_a_handshake_fails_of_is_told() {
        let over = Validity { begin: 0, end: 1 };
        let good = Validity { begin: 0, end: i64::MAX };
        let of = |error: Error, validity| {
            reason(&io::Error::new(io::ErrorKind::InvalidData, error), validity)
        };
        let alert = |alert| Error::AlertReceived(alert);
        let expired = of(alert(AlertDescription::CertificateExpired), over);
        assert!(expired.contains("refuses the certificate (expired): the certificate expired on"));
        let unknown = of(alert(AlertDescription::UnknownCA), good);
        assert_eq!(unknown, "the client refuses the certificate (it knows nobody who signed it)");
        let plain = tokio_rustls::rustls::InvalidMessage::InvalidContentType;
        assert!(of(Error::InvalidMessage(plain), good).contains("speaks TLS alone"));
    }
}
