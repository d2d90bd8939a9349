//! The way to a server: straight or through a proxy, in the clear or with TLS.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use http::Uri;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::client::legacy::connect::proxy::Tunnel;
use hyper_util::client::proxy::matcher::{Intercept, Matcher};
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::ClientConfig;
use tokio_rustls::rustls::pki_types::ServerName;
use tonic::transport::{Channel, Endpoint};
use tower::{Service as _, service_fn};

use crate::access::Access;
use crate::ending::Ending;
use crate::tls;

/// Time of silence after which a server is asked whether it is there, and that it has to answer.
const KEEPALIVE: Duration = Duration::from_secs(30);
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(20);

/// What a server may send before it must wait \[bytes\]: the answer to a step of a thousand arms.
const WINDOW: u32 = 1 << 24;
/// Largest part \[bytes\] in which a message is sent: every one costs a call to the system or two.
const FRAME: u32 = 1 << 20;

trait Io: AsyncRead + AsyncWrite + Send {}
impl<T: AsyncRead + AsyncWrite + Send> Io for T {}

type Failure = Box<dyn std::error::Error + Send + Sync>;

#[derive(Clone)]
pub(crate) struct Connector {
    endpoint: Endpoint,
    proxy: Option<Intercept>,
    tls: Option<(Arc<ClientConfig>, ServerName<'static>)>,
}

impl Connector {
    /// The way to a server.
    ///
    /// # Errors
    /// An address that is none; nobody is trusted.
    pub(crate) fn new(access: &Access) -> Result<Self, Ending> {
        let host = if access.host.contains(':') {
            format!("[{}]", access.host)
        } else {
            access.host.clone()
        };
        let place = |scheme| -> Result<Uri, Ending> {
            format!("{scheme}://{host}:{}", access.port).parse().map_err(Ending::of_transport)
        };
        let (origin, place) = (place("https")?, place("http")?);
        let mut endpoint = Endpoint::from(place.clone())
            .http2_keep_alive_interval(KEEPALIVE)
            .keep_alive_timeout(KEEPALIVE_TIMEOUT)
            .keep_alive_while_idle(true)
            .initial_stream_window_size(WINDOW)
            .initial_connection_window_size(WINDOW)
            .max_frame_size(FRAME);
        let mut tls = None;
        if access.encrypted {
            // What the requests say of themselves.
            endpoint = endpoint.origin(origin);
            let name = ServerName::try_from(access.host.clone()).map_err(Ending::of_transport)?;
            let settings = tls::settings(access.roots.as_deref()).map_err(Ending::of_transport)?;
            tls = Some((settings, name));
        }
        let proxy = access.proxy.as_ref().and_then(|(proxy, direct)| {
            Matcher::builder().all(proxy.as_str()).no(direct.as_str()).build().intercept(&place)
        });
        Ok(Self { endpoint, proxy, tls })
    }

    /// A connection; the first request shows whether anybody speaks there.
    pub(crate) async fn connect(&self) -> Result<Channel, Ending> {
        let connector = self.clone();
        let connect = service_fn(move |place| connector.clone().open(place));
        self.endpoint.connect_with_connector(connect).await.map_err(Ending::of_transport)
    }

    async fn open(self, place: Uri) -> Result<TokioIo<Pin<Box<dyn Io>>>, Failure> {
        let mut straight = HttpConnector::new();
        straight.set_nodelay(true);
        let stream: TcpStream = match &self.proxy {
            None => straight.call(place).await?.into_inner(),
            Some(proxy) => {
                let mut tunnel = Tunnel::new(proxy.uri().clone(), straight);
                if let Some(value) = proxy.basic_auth() {
                    tunnel = tunnel.with_auth(value.clone());
                }
                tunnel.call(place).await?.into_inner()
            }
        };
        let stream: Pin<Box<dyn Io>> = match self.tls {
            None => Box::pin(stream),
            Some((settings, name)) => {
                let stream = TlsConnector::from(settings).connect(name, stream).await?;
                if stream.get_ref().1.alpn_protocol() != Some(b"h2".as_slice()) {
                    return Err(io::Error::other("no HTTP/2 is spoken there").into());
                }
                Box::pin(stream)
            }
        };
        Ok(TokioIo::new(stream))
    }
}
