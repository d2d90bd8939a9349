//! How a server is reached.

/// How a server is reached. It is not shown: it holds a token.
#[derive(Clone)]
#[expect(missing_debug_implementations)]
pub struct Access {
    /// Name or address of its machine, and the port.
    pub host: String,
    /// The port that it listens on.
    pub port: u16,
    /// Whether TLS is spoken.
    pub encrypted: bool,
    /// Certificates (PEM) of those who may have signed the server's, or its own; None: those that this
    /// machine trusts.
    pub roots: Option<Vec<u8>>,
    /// What opens the server.
    pub token: Option<String>,
    /// The proxy on the way, and the hosts that it is not asked for, as environment variables name them.
    pub proxy: Option<(String, String)>,
}
