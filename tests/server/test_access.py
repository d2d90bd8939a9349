"""Who may use a server, how much, and what its operator sees of it."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import grpc
import pytest
from clients import (
    PATIENCE,
    Client,
    RawPeer,
    RefusedError,
    fetch,
    metrics,
    nothing_left,
    open_channel,
    property_request,
    status_of,
    tensor,
    wait_for_levels,
    wait_until,
)
from dm_env_rpc.v1 import dm_env_rpc_pb2 as pb
from dm_env_rpc.v1.extensions import properties_pb2
from octoarm_agents.common.serving import ServerProcess, find_program

Code = grpc.StatusCode
INVALID_ARGUMENT, RESOURCE_EXHAUSTED = 3, 8
TOKEN = "a-token.of_the/tests+0123456789="
SERVICE = "dm_env_rpc.v1.Environment"
REFLECTION = "/grpc.reflection.{}.ServerReflection/ServerReflectionInfo"
OPTIONS = {
    "host": "127.0.0.1",
    "port": 0,
    "tls-certificate": "certificate.pem",
    "tls-key": "key.pem",
    "token-file": "token",
    "max-worlds": 2,
    "max-worlds-per-connection": 2,
    "max-num-envs": 4,
    "max-arms": 100,
    "max-compartments": 20,
    "max-physics-steps": 15_600,
    "max-threads": 1,
    "max-message-size": 100_000,
    "max-world-bytes": 100_000_000,
    "max-bytes-in-flight": 1_000_000,
    "max-connections": 100,
    "max-connections-per-address": 50,
    "max-streams-per-connection": 10,
    "probation-timeout": 10.0,
    "message-timeout": 10.0,
    "max-connection-age": 1000.0,
    "idle-timeout": 100.0,
    "keepalive-interval": 10.0,
    "keepalive-timeout": 10.0,
    "busy-poll": 0.0,
    "shutdown-timeout": 5.0,
    "drain-timeout": 0.0,
    "server-threads": 1,
    "metrics-port": 0,
    "metrics-host": "127.0.0.1",
    "log-format": "json",
    "log-level": "debug",
    "log-rate": 5000,
}
"""Every option but --config, with a value that a server can start with."""


@dataclass
class Certificate:
    """A certificate for this machine, signed by itself."""

    file: Path
    key: Path

    @property
    def options(self) -> tuple[str, ...]:
        return ("--tls-certificate", str(self.file), "--tls-key", str(self.key))

    @property
    def credentials(self) -> grpc.ChannelCredentials:
        """Those of a client that trusts it."""
        return grpc.ssl_channel_credentials(self.file.read_bytes())


def make_certificate(folder: Path) -> Certificate:
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("needs the openssl command")
    certificate = Certificate(folder / "certificate.pem", folder / "key.pem")
    arguments = (
        "req -x509 -nodes -days 2 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 "
        "-subj /CN=localhost -addext subjectAltName=DNS:localhost,IP:127.0.0.1"
    )
    files = ["-keyout", str(certificate.key), "-out", str(certificate.file)]
    subprocess.run([program, *arguments.split(), *files], check=True, capture_output=True)
    return certificate


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Certificate:
    return make_certificate(tmp_path_factory.mktemp("tls"))


@pytest.fixture
def token_file(tmp_path: Path) -> Path:
    path = tmp_path / "token"
    path.write_text(f"{TOKEN}\n")
    return path


@pytest.fixture(params=["file", "environment"])
def locked(request: pytest.FixtureRequest, token_file: Path) -> Iterator[ServerProcess]:
    """A server with a token, that logs all it can."""
    options = ["--metrics-port", "0", "--log-level", "trace,octoarm_server=trace"]
    environment = {}
    if request.param == "file":
        options += ["--token-file", str(token_file)]
    else:
        environment["OCTOARM_TOKEN"] = TOKEN
    with ServerProcess(*options, environment=environment) as server:
        yield server


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A server that is expected to end by itself."""
    program = str(find_program())
    return subprocess.run(
        [program, "--port", "0", *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        env=environment,
        check=False,
    )


def assert_refused(result: subprocess.CompletedProcess[str], code: int, *words: str) -> None:
    """It has said why it does not serve, and nothing else."""
    assert result.returncode == code, result.stderr
    for word in words:
        assert word in result.stderr
    assert "panic" not in result.stderr
    assert "RUST_BACKTRACE" not in result.stderr
    # Who starts a server waits for this line.
    assert "listening on" not in result.stdout


def call(
    channel: grpc.Channel, method: str, request: bytes, token: str | None = None
) -> list[bytes]:
    """Answers to a request that is sent alone, all of it as bytes."""
    metadata = None if token is None else [("authorization", f"Bearer {token}")]
    stream = channel.stream_stream(method)(iter([request]), metadata=metadata, timeout=PATIENCE)
    return list(stream)


def test_only_the_token_opens_the_environment(locked: ServerProcess) -> None:
    with nothing_left(locked), open_channel(locked.address) as channel:
        with Client(channel=channel, token=TOKEN) as client:
            assert client.enter().step().state == pb.EnvironmentStateType.RUNNING
        wrong = ["", "x", TOKEN[:-1], TOKEN + "0", TOKEN.upper(), TOKEN[::-1], f"Bearer {TOKEN}"]
        for token in wrong:
            # A few of them close a connection.
            with Client(locked.address, token=token) as client:
                assert status_of(client) is Code.UNAUTHENTICATED
                assert client.stream.details() == "the token is wrong"
        with Client(channel=channel) as client:
            assert status_of(client) is Code.UNAUTHENTICATED
            assert "authorization: Bearer <token>" in client.stream.details()
        for value in (TOKEN, f"Basic {TOKEN}"):
            stream = channel.stream_stream(f"/{SERVICE}/Process")
            with pytest.raises(grpc.RpcError) as error:
                next(stream(iter([]), metadata=[("authorization", value)], timeout=PATIENCE))
            assert error.value.code() is Code.UNAUTHENTICATED
        assert metrics(locked)["octoarm_unauthenticated_total"] == len(wrong) + 3
        assert metrics(locked)['octoarm_requests_total{request="step",result="answered"}'] == 1


def test_a_token_is_not_to_be_seen(locked: ServerProcess) -> None:
    wrong = "wrong-token-0123456789"
    for token in (TOKEN, wrong):
        with Client(locked.address, token=token) as client:
            if token == TOKEN:
                client.create()
            else:
                assert status_of(client) is Code.UNAUTHENTICATED
    assert locked.metrics_url is not None
    places = [locked.log, fetch(locked.metrics_url)[1]]
    command_line = Path(f"/proc/{locked.process.pid}/cmdline")
    if command_line.exists():
        places.append(command_line.read_text(encoding="utf-8"))
    if shutil.which("ps"):
        ps = ["ps", "-o", "args=", "-p", str(locked.process.pid)]
        places.append(subprocess.run(ps, check=True, capture_output=True, text=True).stdout)
    assert locked.stop() == 0
    places.append(locked.log)
    # It has logged a lot, so there was an occasion.
    assert "TRACE" in locked.log
    for text in places:
        assert TOKEN not in text
        assert wrong not in text


@pytest.mark.parametrize(
    "token", ["", "short", "0123456789abcde", "with spaces 0123456789", "ü" * 20]
)
def test_a_token_that_is_none(token: str, tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text(token)
    for result, source in (
        (run("--token-file", str(file)), "token_file"),
        (run(OCTOARM_TOKEN=token), "OCTOARM_TOKEN"),
    ):
        assert_refused(result, 2, source, "at least 16 printable ASCII characters")
        assert not token or token not in result.stderr
    missing = str(tmp_path / "nowhere")
    assert_refused(run("--token-file", missing), 2, "token_file", missing, "No such file")


def test_health_needs_no_token(locked: ServerProcess) -> None:
    method = "/grpc.health.v1.Health/Check"
    # A HealthCheckRequest holds nothing but the service's name; SERVING is 1.
    named = bytes([0x0A, len(SERVICE)]) + SERVICE.encode()
    with open_channel(locked.address) as channel:
        check = channel.unary_unary(method)
        for request in (b"", named):
            assert check(request, timeout=PATIENCE) == b"\x08\x01"
        with pytest.raises(grpc.RpcError) as error:
            check(b"\x0a\x05other", timeout=PATIENCE)
        assert error.value.code() is Code.NOT_FOUND


@pytest.mark.parametrize("kind", ["health", "reflection"])
def test_who_only_looks_on_does_not_delay_the_end(kind: str) -> None:
    method, request = {
        "health": ("/grpc.health.v1.Health/Watch", bytes([0x0A, len(SERVICE)]) + SERVICE.encode()),
        "reflection": (REFLECTION.format("v1"), b"\x3a\x00"),
    }[kind]
    with (
        ServerProcess("--shutdown-timeout", "5") as server,
        open_channel(server.address) as channel,
    ):
        done = Event()

        def requests() -> Iterator[bytes]:
            yield request
            done.wait(PATIENCE)

        if kind == "health":
            stream = channel.unary_stream(method)(request, timeout=PATIENCE)
        else:
            stream = channel.stream_stream(method)(requests(), timeout=PATIENCE)
        assert next(stream)
        server.process.send_signal(signal.SIGTERM)
        code = server.process.wait(PATIENCE)
        done.set()
        assert code == 0
        assert "broken off" not in server.log


def test_a_connection_without_the_token_is_given_up(token_file: Path) -> None:
    options = ("--probation-timeout", "0.7", "--metrics-port", "0")
    with (
        ServerProcess("--token-file", str(token_file), *options) as server,
        open_channel(server.address) as stranger,
        open_channel(server.address) as prober,
        Client(server.address, token=TOKEN) as client,
    ):
        client.enter()
        with Client(channel=stranger) as refused:
            assert status_of(refused) is Code.UNAUTHENTICATED
        prober.unary_unary("/grpc.health.v1.Health/Check")(b"", timeout=PATIENCE)
        # Both channels are open still.
        wait_for_levels(server, connections=1, streams=1, worlds=1)
        time.sleep(1.0)
        assert client.step().state == pb.EnvironmentStateType.RUNNING


@pytest.mark.parametrize("version", ["v1", "v1alpha"])
def test_reflection_needs_the_token(locked: ServerProcess, version: str) -> None:
    method = REFLECTION.format(version)
    list_services = b"\x3a\x00"
    file_of_symbol = bytes([0x22, len(SERVICE)]) + SERVICE.encode()
    with open_channel(locked.address) as channel:
        (services,) = call(channel, method, list_services, TOKEN)
        assert SERVICE.encode() in services
        (file,) = call(channel, method, file_of_symbol, TOKEN)
        for name in (b"dm_env_rpc/v1/dm_env_rpc.proto", b"EnvironmentRequest", b"Process"):
            assert name in file
        for token in (None, "wrong-token-0123456789"):
            with pytest.raises(grpc.RpcError) as error:
                call(channel, method, list_services, token)
            assert error.value.code() is Code.UNAUTHENTICATED


def test_without_a_token_reflection_is_open(server: ServerProcess) -> None:
    method = REFLECTION.format("v1")
    with open_channel(server.address) as channel:
        assert SERVICE.encode() in call(channel, method, b"\x3a\x00")[0]


def test_tls(certificate: Certificate) -> None:
    with ServerProcess("--metrics-port", "0", *certificate.options) as server:
        port = server.address.rpartition(":")[2]
        for host in ("localhost", "127.0.0.1"):
            with (
                open_channel(f"{host}:{port}", certificate.credentials) as channel,
                Client(channel=channel) as client,
            ):
                assert client.enter().step().state == pb.EnvironmentStateType.RUNNING
        with Client(server.address) as plain:
            assert status_of(plain) is Code.UNAVAILABLE
        with (
            open_channel(server.address, grpc.ssl_channel_credentials()) as channel,
            Client(channel=channel) as distrustful,
        ):
            assert status_of(distrustful) is Code.UNAVAILABLE
        wait_for_levels(server, connections=0, streams=0, worlds=0)


def test_a_peer_that_begins_no_tls_is_given_up(certificate: Certificate) -> None:
    options = ("--keepalive-interval", "0.2", "--keepalive-timeout", "0.5", "--metrics-port", "0")
    with (
        ServerProcess(*options, *certificate.options) as server,
        nothing_left(server),
        RawPeer(server) as mute,
        RawPeer(server) as half,
        RawPeer(server) as nonsense,
    ):
        half.send(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03")
        nonsense.send(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n")
        for peer in (mute, half, nonsense):
            peer.wait_for_end()
        with (
            open_channel(server.address, certificate.credentials) as channel,
            Client(channel=channel) as client,
        ):
            assert client.create()


@pytest.mark.parametrize("wrong", ["no files", "key of another", "rubbish", "no key", "swapped"])
def test_certificates_that_do_not_work(
    certificate: Certificate, tmp_path: Path, wrong: str
) -> None:
    rubbish = tmp_path / "rubbish.pem"
    rubbish.write_text("-----BEGIN CERTIFICATE-----\nrubbish\n-----END CERTIFICATE-----\n")
    if wrong == "no files":
        nowhere = Certificate(tmp_path / "nowhere.pem", certificate.key)
        assert_refused(run(*nowhere.options), 2, "tls_certificate", "nowhere.pem", "No such file")
        nowhere = Certificate(certificate.file, tmp_path / "nowhere.pem")
        assert_refused(run(*nowhere.options), 2, "tls_key", "nowhere.pem", "No such file")
        for half in (certificate.options[:2], certificate.options[2:]):
            assert_refused(run(*half), 2, "tls_certificate and tls_key go together")
        return
    bad = {
        "key of another": lambda: Certificate(certificate.file, make_certificate(tmp_path).key),
        "rubbish": lambda: Certificate(rubbish, certificate.key),
        "no key": lambda: Certificate(certificate.file, rubbish),
        "swapped": lambda: Certificate(certificate.key, certificate.file),
    }[wrong]()
    result = run(*bad.options)
    assert result.returncode in {1, 2}
    # The operator must learn which of the settings it is about.
    assert_refused(result, result.returncode, "tls_")


def test_beyond_this_machine_it_needs_tls_and_a_token(
    certificate: Certificate, token_file: Path
) -> None:
    token = ("--token-file", str(token_file))
    for host in ("0.0.0.0", "::"):
        for missing in ((), token, certificate.options):
            result = run("--host", host, *missing)
            assert_refused(result, 2, f"host = {host}", "tls_certificate", "tls_key", "token_file")
            assert "OCTOARM_TOKEN" in result.stderr
    with ServerProcess("--host", "0.0.0.0", *token, *certificate.options) as server:
        address = server.address.replace("0.0.0.0", "127.0.0.1")
        with open_channel(address, certificate.credentials) as channel:
            with Client(channel=channel, token=TOKEN) as client:
                assert client.enter().step().state == pb.EnvironmentStateType.RUNNING
            with Client(channel=channel) as client:
                assert status_of(client) is Code.UNAUTHENTICATED
        with Client(address, token=TOKEN) as plain:
            assert status_of(plain) is Code.UNAVAILABLE


def refusal(client: Client, **given: Any) -> RefusedError:
    """Why a world is not made."""
    with pytest.raises(RefusedError) as error:
        client.create(**given)
    return error.value


def test_worlds_of_the_server_are_limited() -> None:
    with (
        ServerProcess("--max-worlds", "3", "--metrics-port", "0") as server,
        nothing_left(server),
        Client(server.address) as first,
        Client(server.address) as second,
    ):
        names = [first.create(), first.create(), second.create()]
        for client in (first, second):
            error = refusal(client)
            assert error.code == RESOURCE_EXHAUSTED
            assert "3 worlds are taken of the 3 that this server may have" in error.message
        first.destroy(names[0])
        second.create()
        assert refusal(first).code == RESOURCE_EXHAUSTED
        second.close()
        wait_for_levels(server, worlds=1)
        first.create()
        first.create()
        assert refusal(first).code == RESOURCE_EXHAUSTED
        # What is refused for another reason takes no place.
        first.destroy(names[1])
        for _ in range(5):
            assert refusal(first, amplitude=-1.0).code == INVALID_ARGUMENT
            assert refusal(first, arm="inertial", amplitude=359.0).code == INVALID_ARGUMENT
        first.create()


def test_worlds_of_a_connection_are_limited() -> None:
    with (
        ServerProcess("--max-worlds-per-connection", "2", "--metrics-port", "0") as server,
        nothing_left(server),
        open_channel(server.address) as channel,
        Client(channel=channel) as first,
        Client(channel=channel) as second,
        Client(server.address) as other,
    ):
        name = first.create()
        second.create()
        for client in (first, second):
            error = refusal(client)
            assert error.code == RESOURCE_EXHAUSTED
            assert "2 worlds are taken of the 2 that one connection may have" in error.message
        other.create()
        other.create()
        # It counts who made a world, not who frees it.
        other.destroy(name)
        assert refusal(other).code == RESOURCE_EXHAUSTED
        second.create()
        first.close()
        second.close()
        wait_for_levels(server, worlds=2)
        with Client(channel=channel) as third:
            third.create()
            third.create()


def test_arms_of_the_server_are_limited() -> None:
    with (
        ServerProcess("--max-arms", "10", "--metrics-port", "0") as server,
        nothing_left(server),
        Client(server.address) as first,
        Client(server.address) as second,
    ):
        large = first.create(num_envs=8)
        error = refusal(second, num_envs=3)
        assert error.code == RESOURCE_EXHAUSTED
        assert "8 arms are taken of the 10" in error.message
        second.create()
        # One of twice the usual compartments counts as two.
        assert refusal(second, arm__compartments=40).code == RESOURCE_EXHAUSTED
        second.create()
        assert refusal(second).code == RESOURCE_EXHAUSTED
        first.destroy(large)
        second.create(num_envs=8)


@pytest.mark.parametrize(
    ("option", "most", "fits", "beyond", "code", "words"),
    [
        ("--max-num-envs", "4", {"num_envs": 4}, {"num_envs": 5}, 3, r"num_envs = 5 .*\[1, 4\]"),
        ("--max-threads", "2", {"threads": 2}, {"threads": 3}, 3, r"threads = 3 .*\[1, 2\]"),
        (
            "--max-compartments",
            "5",
            {"arm__compartments": 5},
            {"arm__compartments": 6},
            3,
            r"arm.compartments = 6 .*\[1, 5\]",
        ),
        # 100 steps an arm, and 385 times as many for the swing that episodes begin from.
        (
            "--max-physics-steps",
            "40000",
            {"num_envs": 400, "control_period": 0.1},
            {"num_envs": 401, "control_period": 0.1},
            8,
            "40100 physics",
        ),
        # 10 steps, and 1555 times as many.
        (
            "--max-physics-steps",
            "15550",
            {},
            {"control_period": 0.011},
            8,
            "swings .* allows 15550",
        ),
        ("--max-physics-steps", "15550", {}, {"arm__compartments": 21}, 8, "16328 physics"),
    ],
)
def test_worlds_are_limited_in_size(
    option: str, most: str, fits: dict[str, Any], beyond: dict[str, Any], code: int, words: str
) -> None:
    with ServerProcess(option, most) as server, Client(server.address) as client:
        error = refusal(client, **beyond)
        assert error.code == code
        assert re.search(words, error.message)
        client.enter(**fits).step()


def test_streams_of_a_connection_are_limited() -> None:
    with (
        ServerProcess("--max-streams-per-connection", "2", "--metrics-port", "0") as server,
        nothing_left(server),
        open_channel(server.address) as channel,
        Client(channel=channel) as first,
        Client(channel=channel) as second,
        ThreadPoolExecutor(1) as pool,
    ):
        first.create()
        second.create()
        with Client(channel=channel) as third:
            created = pool.submit(third.create)
            time.sleep(0.3)
            assert not created.done()
            # Another connection has streams of its own.
            with Client(server.address) as other:
                other.create()
            assert second.create()
            first.close()
            assert created.result(PATIENCE)


def test_connections_are_limited() -> None:
    with (
        ServerProcess("--max-connections", "2", "--metrics-port", "0") as server,
        nothing_left(server),
        Client(server.address) as first,
        Client(server.address) as second,
        ThreadPoolExecutor(1) as pool,
    ):
        first.create()
        second.create()
        with Client(server.address) as third:
            created = pool.submit(third.create)
            time.sleep(0.3)
            assert not created.done()
            wait_for_levels(server, connections=2)
            assert second.create()
            first.close()
            assert created.result(PATIENCE)
            wait_for_levels(server, connections=2)


def toml(values: dict[str, Any]) -> str:
    return "".join(f"{name.replace('-', '_')} = {json.dumps(values[name])}\n" for name in values)


def test_every_option_may_stand_in_a_file(
    certificate: Certificate, token_file: Path, tmp_path: Path
) -> None:
    files = {
        "tls-certificate": str(certificate.file),
        "tls-key": str(certificate.key),
        "token-file": str(token_file),
    }
    file = tmp_path / "settings.toml"
    file.write_text(toml(OPTIONS | files))
    # `ServerProcess` looks for the metrics' address only if it is asked for.
    with (
        ServerProcess("--config", str(file), "--metrics-port", "0", "--max-worlds", "1") as server,
        open_channel(server.address, certificate.credentials) as channel,
        Client(channel=channel, token=TOKEN) as client,
    ):
        log = wait_until(lambda: "listening" in server.log and server.log, "a line of the log")
        messages = [json.loads(line)["message"] for line in log.splitlines()]
        # That of certificate and token, which are soon over and open to all.
        assert [message == "listening" for message in messages[:3]] == [False, False, True]
        assert refusal(client, num_envs=5).code == INVALID_ARGUMENT
        assert "allows 15600" in refusal(client, control_period=0.02).message
        client.create()
        # The command line goes before the file.
        assert "of the 1 that this server may have" in refusal(client).message
        assert metrics(server)["octoarm_worlds"] == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("max_wolrds = 3\n", ["max_wolrds", "max_worlds"]),
        ("max-worlds = 3\n", ["max-worlds"]),
        ("port = 0\nconfig = 'other.toml'\n", ["config"]),
        ("max_worlds = 'many'\n", ["max_worlds", "line 1"]),
        ("port = 70000\n", ["port", "70000"]),
        ("host = 'elsewhere'\n", ["host"]),
        ("log_format = 'xml'\n", ["xml", "json"]),
        ("max_worlds = 0\n", ["max_worlds = 0", "positive"]),
        ("idle_timeout = -1.0\n", ["idle_timeout = -1"]),
        ("this is no TOML\n", ["line 1"]),
        ("[server]\nmax_worlds = 3\n", ["server"]),
    ],
)
def test_what_a_file_may_not_say(text: str, words: list[str], tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text(text)
    assert_refused(run("--config", str(file)), 2, *words)


def test_a_file_that_there_is_not() -> None:
    result = run("--config", "/nowhere/settings.toml")
    assert_refused(result, 2, "/nowhere/settings.toml", "No such file")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--max-worlds", "0"], "max_worlds = 0"),
        (["--max-worlds=-1"], "--max-worlds"),
        (["--max-worlds", "many"], "--max-worlds"),
        (["--idle-timeout", "nan"], "idle_timeout = NaN"),
        (["--keepalive-interval", "0"], "keepalive_interval = 0"),
        (["--keepalive-timeout", "inf"], "keepalive_timeout = inf"),
        (["--shutdown-timeout", "1e300"], "shutdown_timeout = 1"),
        (["--busy-poll=-1"], "busy_poll = -1"),
        (["--max-message-size", "0"], "max_message_size = 0"),
        (["--server-threads", "0"], "server_threads = 0"),
        (["--log-level", "x=y=z"], "log_level"),
        (["--log-format", "xml"], "--log-format"),
        (["--colour", "red"], "--colour"),
    ],
)
def test_what_the_command_line_may_not_say(arguments: list[str], words: str) -> None:
    assert_refused(run(*arguments), 2, words)


def test_a_port_that_is_taken(server: ServerProcess) -> None:
    host, _, port = server.address.rpartition(":")
    program = [str(find_program())]
    for options in (["--port", port], ["--port", "0", "--metrics-port", port]):
        result = subprocess.run(
            program + options, capture_output=True, text=True, timeout=PATIENCE, check=False
        )
        assert_refused(result, 1, f"cannot listen on {host}:{port}", "in use")


def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names = [name for name, _ in pairs]
    assert len(set(names)) == len(names), f"a name stands twice: {names}"
    return dict(pairs)


def make_noise(server: ServerProcess) -> None:
    """Give a server something to log, of names too that would like to be lines of it."""
    with Client(server.address) as client:
        client.enter().step()
        refusal(client, **{"colour\n2026-01-01T00:00:00Z ERROR fake": 1})
        refusal(client, **{"amplitude": float("nan"), "x\r\n\x1b[31m": float("nan")})
        list_none = properties_pb2.ListPropertyRequest(key="a\nb")
        request = properties_pb2.PropertyRequest(list_property=list_none)
        assert client.ask(property_request(request)).error.code
        assert client.ask(pb.EnvironmentRequest()).error.code
        for name in ("nowhere\n", "\x07"):
            with pytest.raises(RefusedError):
                client.join(name)
    with RawPeer(server) as peer:
        peer.send(b"\n{}\n")
    wait_for_levels(server, connections=0)


@pytest.mark.parametrize("level", ["info", "debug"])
def test_a_json_log_is_an_object_a_line(level: str) -> None:
    options = ("--log-format", "json", "--log-level", level, "--metrics-port", "0")
    with ServerProcess(*options) as server:
        make_noise(server)
        assert server.stop() == 0
        lines = server.log.splitlines()
    entries = [json.loads(line, object_pairs_hook=unique) for line in lines]
    for entry in entries:
        assert {"timestamp", "level", "message"} <= set(entry)
    said = [entry["message"] for entry in entries]
    assert said[0] == "listening"
    assert said[-1] == "stopped"
    assert "world created" in said
    assert ("request refused" in said) == (level == "debug")
    assert {"INFO", "DEBUG"} >= {entry["level"] for entry in entries}


@pytest.mark.parametrize("level", ["info", "debug"])
def test_clients_cannot_write_lines_of_the_log(level: str) -> None:
    with ServerProcess("--log-level", level, "--metrics-port", "0") as server:
        make_noise(server)
        assert server.stop() == 0
        log = server.log
    assert "listening" in log
    assert "\x1b" not in log
    assert "\x07" not in log
    for line in log.splitlines():
        assert re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d+Z +(INFO|DEBUG|WARN) ", line), line
        assert "ERROR fake" not in line.partition("request refused")[0]


def test_help_names_every_option() -> None:
    text = run("--help").stdout
    named = set(re.findall(r"^\s+(?:-\w, )?--([a-z-]+)", text, flags=re.MULTILINE))
    assert named == {*OPTIONS, "otlp-endpoint", "config", "help", "version"}
    assert "OCTOARM_TOKEN" in text
    assert re.fullmatch(r"octoarm-server \d+\.\d+\.\d+\n", run("--version").stdout)


def test_metrics_count() -> None:
    with (
        ServerProcess("--metrics-port", "0") as server,
        Client(server.address) as client,
    ):
        assert metrics(server)["octoarm_environment_steps_total"] == 0
        client.enter(num_envs=3)
        # The first begins the episodes.
        for _ in range(5):
            client.step()
        refusal(client, colour="red")
        client.reset()
        client.reset_world(client.world)
        client.property("version")
        client.leave()
        client.destroy(client.world)
        assert client.ask(pb.EnvironmentRequest()).error.code
        text = metrics(server)
        counts = {
            ("create_world", "answered"): 1,
            ("create_world", "refused"): 1,
            ("join_world", "answered"): 1,
            ("step", "answered"): 5,
            ("step", "refused"): 0,
            ("reset", "answered"): 1,
            ("reset_world", "answered"): 1,
            ("leave_world", "answered"): 1,
            ("destroy_world", "answered"): 1,
            ("extension", "answered"): 1,
            ("unknown", "refused"): 1,
        }
        for (kind, result), count in counts.items():
            name = f'octoarm_requests_total{{request="{kind}",result="{result}"}}'
            assert text.get(name, 0) == count, name
        assert text["octoarm_environment_steps_total"] == 12
        duration = "octoarm_request_duration_seconds"
        assert text[f'{duration}_count{{request="step"}}'] == 5
        assert text[f'{duration}_bucket{{le="+Inf",request="step"}}'] == 5
        assert 0 < text[f'{duration}_sum{{request="step"}}'] < PATIENCE
        assert text["octoarm_connections"] == text["octoarm_streams"] == 1
        assert text["octoarm_worlds"] == 0
        assert text["octoarm_unauthenticated_total"] == text["octoarm_idle_streams_total"] == 0
        if Path("/proc/self/status").exists():
            assert 1e6 < text["process_resident_memory_bytes"] < 1e9


def test_metrics_have_one_page() -> None:
    with ServerProcess("--metrics-port", "0") as server:
        assert server.metrics_url is not None
        assert server.metrics_url.endswith("/metrics")
        status, text = fetch(server.metrics_url)
        assert status == 200
        assert "# HELP octoarm_worlds " in text
        assert "# TYPE octoarm_requests counter" in text
        for path in ("/", "/metrics/", "/metrics/more", "/metric", "//metrics", "/etc/passwd"):
            assert fetch(server.metrics_url, path)[0] == 404, path
        # Where clients connect there are no metrics.
        with RawPeer(server) as peer:
            peer.send(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert b"octoarm" not in peer.wait_for_end()
    with ServerProcess() as server:
        assert server.metrics_url is None


def test_large_answers_are_no_requests() -> None:
    # The limit is on what clients send: a batch's observations are longer.
    with (
        ServerProcess("--max-message-size", "200") as server,
        Client(server.address) as client,
    ):
        client.enter(num_envs=100)
        step = client.step()
        assert step.ByteSize() > 50_000
        many = {f"name{index}": tensor(index) for index in range(20)}
        client.send(pb.EnvironmentRequest(create_world=pb.CreateWorldRequest(settings=many)))
        assert status_of(client) in {Code.RESOURCE_EXHAUSTED, Code.OUT_OF_RANGE}
