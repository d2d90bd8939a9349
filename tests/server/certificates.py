"""Certificates for the tests of the server."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

SECTION = """
[ca]
default_ca = here
[here]
dir = {folder}
new_certs_dir = {folder}
database = {folder}/index
rand_serial = yes
default_md = sha256
policy = any
x509_extensions = names
[any]
commonName = supplied
[names]
subjectAltName = {names}
{more}
[req]
distinguished_name = nobody
[nobody]
"""
ALWAYS = ("20200101000000Z", "21000101000000Z")


def make_certificate(
    folder: Path,
    times: tuple[str, str] = ALWAYS,
    names: str = "DNS:localhost,IP:127.0.0.1",
    signer: bool = False,
) -> tuple[Path, Path]:
    """A certificate that signs itself, with its key, for these times and names.

    A `signer` may sign others too, as what ``openssl req -x509`` makes.
    """
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("needs the openssl command")
    folder.mkdir(exist_ok=True)
    (folder / "index").write_text("")
    settings, request = folder / "openssl.cnf", folder / "request.pem"
    more = "basicConstraints = critical,CA:TRUE" if signer else ""
    settings.write_text(SECTION.format(folder=folder, names=names, more=more))
    certificate, key = folder / "certificate.pem", folder / "key.pem"

    def openssl(*arguments: Any) -> None:
        words = [program, *map(str, arguments)]
        subprocess.run(words, check=True, capture_output=True, timeout=60)

    curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
    begin, end = times
    openssl(
        *("req", "-new", *curve, "-config", settings, "-subj", "/CN=localhost"),
        *("-keyout", key, "-out", request),
    )
    openssl(
        *("ca", "-batch", "-selfsign", "-config", settings, "-keyfile", key, "-in", request),
        *("-startdate", begin, "-enddate", end, "-notext", "-out", certificate),
    )
    key.chmod(0o600)
    return certificate, key


def tls(files: tuple[Path, Path]) -> tuple[str, ...]:
    return ("--tls-certificate", str(files[0]), "--tls-key", str(files[1]))
