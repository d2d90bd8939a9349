"""Why a server cannot be spoken with, where it is TLS that stands between."""

from __future__ import annotations

import socket
import ssl

_PATIENCE = 5.0
"""Longest wait for a handshake [s]."""

_UNTRUSTED = (
    "its certificate is not signed by one that is trusted: give `certificate` the file that it is "
    "signed with, or its own"
)
_OTHER_NAMES = "its certificate is for other names (subjectAltName) than this address"
_REASONS = {
    9: "its certificate is not yet valid: its clock is wrong, or this machine's",
    10: "its certificate has expired: it needs a new one",
    18: _UNTRUSTED,
    19: _UNTRUSTED,
    20: _UNTRUSTED,
    62: _OTHER_NAMES,
    64: _OTHER_NAMES,
}
"""By the code of OpenSSL's verification."""


def diagnose(host: str, port: int, encrypted: bool, roots: bytes | None) -> str | None:
    """Tell why a client gets no answer, if TLS is the reason; None if it is not."""
    try:
        plain = socket.create_connection((host, port), _PATIENCE)
    except OSError:
        return None
    with plain:
        if encrypted:
            return _fault(plain, host, roots)
        return "it speaks TLS: use https://, or give `certificate`" if _greets(plain) else None


def _fault(plain: socket.socket, host: str, roots: bytes | None) -> str | None:
    """Why no TLS comes about."""
    try:
        context = ssl.create_default_context(cadata=None if roots is None else roots.decode())
    except (ssl.SSLError, ValueError):
        return "the file of `certificate` holds no certificate (PEM)"
    # gRPC is not as strict either.
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    context.set_alpn_protocols(["h2"])
    try:
        context.wrap_socket(plain, server_hostname=host).close()
    except ssl.SSLCertVerificationError as error:
        return _REASONS.get(error.verify_code, f"its certificate: {error.verify_message}")
    except ssl.SSLError as error:
        if error.reason in ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "HTTP_REQUEST"):
            return "it speaks no TLS: use http://, and no `certificate`"
        return f"no TLS comes about: {error.reason}"
    except OSError:
        pass
    return None


def _greets(plain: socket.socket) -> bool:
    """Whether the other end shows a certificate, whichever."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.set_alpn_protocols(["h2"])
    try:
        context.wrap_socket(plain).close()
    except OSError:
        return False
    return True
