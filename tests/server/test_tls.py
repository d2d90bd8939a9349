"""Certificates and tokens: what is wrong with them is told on both sides; they are exchanged."""

from __future__ import annotations

import copy
import json
import os
import pickle
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from certificates import make_certificate, tls
from clients import metrics, wait_until
from octoarm_agents.common.serving import ServerProcess, find_program

from octoarm_env.remote import RemoteOctoArm, RemoteOctoArmVectorEnv
from octoarm_env.remote.tls import diagnose

ONE, TWO = "token-one-of-the-tests", "token-two-of-the-tests"
PAST, FUTURE = ("20200101000000Z", "20210101000000Z"), ("20900101000000Z", "21000101000000Z")


def said(server: ServerProcess, words: str) -> None:
    wait_until(lambda: words in server.log, f"the log says {words!r}: {server.log}", 30.0)


@pytest.fixture(autouse=True)
def _no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OCTOARM_TOKEN", raising=False)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return make_certificate(tmp_path_factory.mktemp("good"))


@pytest.fixture(scope="module")
def secure(good: tuple[Path, Path]) -> Iterator[ServerProcess]:
    with ServerProcess(*tls(good), "--log-level", "debug") as server:
        yield server


@pytest.mark.parametrize("signer", [False, True], ids=["", "signer"])
@pytest.mark.parametrize(
    ("times", "client", "log"),
    [
        (PAST, "certificate has expired", "the certificate expired on"),
        (FUTURE, "certificate is not yet valid", "the certificate is not valid before"),
    ],
    ids=["expired", "not yet valid"],
)
def test_a_certificate_out_of_its_time(
    tmp_path: Path, times: tuple[str, str], client: str, log: str, signer: bool
) -> None:
    files = make_certificate(tmp_path, times, signer=signer)
    with ServerProcess(*tls(files)) as server:
        # At the start, and again when somebody could not use it.
        said(server, log)
        with pytest.raises(ConnectionError, match=f"no way to the server at .*{client}"):
            RemoteOctoArm(f"https://{server.address}", certificate=files[0])
        said(server, "no TLS: ")
        assert log in server.log.split("no TLS: ", 1)[1]


def test_a_certificate_that_nobody_trusts(secure: ServerProcess, tmp_path: Path) -> None:
    other, _ = make_certificate(tmp_path / "other")
    for trusted in (other, None):
        with pytest.raises(ConnectionError, match="certificate is not signed by one that is trust"):
            RemoteOctoArm(f"https://{secure.address}", certificate=trusted)
    said(secure, "the client refuses the certificate (it knows nobody who signed it)")
    rubbish = tmp_path / "rubbish.pem"
    rubbish.write_text("rubbish")
    with pytest.raises(ConnectionError, match="holds no certificate"):
        RemoteOctoArm(f"https://{secure.address}", certificate=rubbish)


@pytest.mark.parametrize("signer", [False, True], ids=["", "signer"])
def test_a_certificate_for_other_names(tmp_path: Path, signer: bool) -> None:
    files = make_certificate(tmp_path, names="DNS:arm.example", signer=signer)
    with (
        ServerProcess(*tls(files)) as server,
        pytest.raises(ConnectionError, match="is for other names"),
    ):
        RemoteOctoArm(f"https://{server.address}", certificate=files[0])


def test_the_certificate_that_the_documents_make(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "server.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"^(openssl req -x509(?:.*\\\n)*.*)", page, re.MULTILINE)
    subprocess.run(command, shell=True, cwd=tmp_path, check=True, capture_output=True)
    files = (tmp_path / "certificate.pem", tmp_path / "key.pem")
    with ServerProcess(*tls(files)) as server:
        address = f"https://{server.address}"
        env = RemoteOctoArm(address, certificate=files[0])
        env.reset(seed=1)
        env.close()
        words = [address, "--certificate", str(files[0]), "--seconds", "0.05"]
        subprocess.run([find_program("octoarm-load"), *words], check=True, capture_output=True)
        other = make_certificate(tmp_path / "other", signer=True)[0]
        with pytest.raises(ConnectionError, match="certificate is not signed by one that is trust"):
            RemoteOctoArm(address, certificate=other)


def test_plaintext_to_tls_and_tls_to_plaintext(
    secure: ServerProcess, server: ServerProcess, good: tuple[Path, Path]
) -> None:
    with pytest.raises(ConnectionError, match="it speaks TLS: use https://"):
        RemoteOctoArm(secure.address)
    said(secure, "what came is no TLS: this port speaks TLS alone")
    with pytest.raises(ConnectionError, match="it speaks no TLS: use http://"):
        RemoteOctoArm(f"https://{server.address}", certificate=good[0])
    # Where nothing is wrong nothing is found.
    for place, encrypted in ((secure, True), (server, False)):
        host, _, port = place.address.rpartition(":")
        assert diagnose(host, int(port), encrypted, good[0].read_bytes()) is None
    assert diagnose("127.0.0.1", 1, True, None) is None


def test_soon_over_and_open_files_are_warned_of(tmp_path: Path) -> None:
    program = shutil.which("openssl")
    assert program is not None
    certificate, key, token = (tmp_path / name for name in ("c.pem", "key.pem", "token"))
    words = "req -x509 -nodes -days 20 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -subj /CN=x"
    files = ["-keyout", str(key), "-out", str(certificate)]
    subprocess.run([program, *words.split(), *files], check=True, capture_output=True)
    token.write_text(ONE)
    token.chmod(0o644)
    key.chmod(0o644)
    options = (*tls((certificate, key)), "--token-file", str(token))
    with ServerProcess(*options) as server:
        said(server, "the certificate expires on")
        for name in ("token_file", "tls_key"):
            said(server, f"{name} {token if name == 'token_file' else key}: every user")
    token.chmod(0o600)
    key.chmod(0o600)
    with ServerProcess(*options) as server:
        said(server, "listening")
        assert "every user" not in server.log


def test_sighup_exchanges_certificate_and_tokens(tmp_path: Path) -> None:
    old = make_certificate(tmp_path / "old")
    new = make_certificate(tmp_path / "new")
    files = (tmp_path / "certificate.pem", tmp_path / "key.pem")
    token = tmp_path / "token"

    def lay(source: tuple[Path, Path], tokens: str) -> None:
        for one, other in zip(source, files, strict=True):
            shutil.copy(one, other)
        token.write_text(tokens)
        token.chmod(0o600)

    lay(old, f"lab {ONE}\n")
    with ServerProcess(*tls(files), "--token-file", str(token)) as server:
        address = f"https://{server.address}"

        def tell(words: str) -> None:
            before = server.log.count(words)
            server.process.send_signal(signal.SIGHUP)
            wait_until(lambda: server.log.count(words) > before, f"{words}: {server.log}")

        first = RemoteOctoArm(address, certificate=old[0], token=ONE)
        first.reset(seed=1)
        lay(new, f"# after the exchange\nnotebook {TWO}\n")
        tell("certificate and tokens read again")
        second = RemoteOctoArm(address, certificate=new[0], token=TWO)
        second.reset(seed=1)
        with pytest.raises(ConnectionError, match="is not signed by one that is trusted"):
            RemoteOctoArm(address, certificate=old[0], token=TWO)
        with pytest.raises(PermissionError, match="the token is wrong"):
            RemoteOctoArm(address, certificate=new[0], token=ONE)
        # Who was there goes on.
        action = np.zeros(2)
        np.testing.assert_array_equal(first.step(action)[0], second.step(action)[0])
        # What cannot be used changes nothing, and ends nothing.
        files[0].write_text("rubbish")
        token.write_text("short")
        tell("not reloaded: token_file")
        assert "not reloaded: tls_certificate" in server.log
        third = RemoteOctoArm(address, certificate=new[0], token=TWO)
        for env in (first, second, third):
            env.close()
        assert server.stop() == 0
        assert ONE not in server.log
        assert TWO not in server.log


def streams(server: ServerProcess) -> dict[str, float]:
    """Open streams by the name of their token."""
    found = metrics(server).items()
    named = [(re.fullmatch(r'octoarm_client_streams\{token="(.*)"\}', key), n) for key, n in found]
    return {match[1]: number for match, number in named if match}


def test_several_tokens_and_wrong_ones(tmp_path: Path) -> None:
    token = tmp_path / "token"
    token.write_text(f"lab {ONE}\n# on the road\nnotebook\t{TWO}\n")
    token.chmod(0o600)
    options = ("--token-file", str(token), "--log-level", "debug", "--metrics-port", "0")
    with ServerProcess(*options) as server:
        for secret in (ONE, TWO):
            env = RemoteOctoArm(server.address, token=secret)
            if secret == ONE:
                # The other one has not been here yet.
                assert streams(server) == {"lab": 1}
            env.close()
        wait_until(lambda: streams(server) == {"lab": 0, "notebook": 0}, str(streams(server)))
        said(server, "token=lab")
        said(server, "token=notebook")
        with pytest.raises(PermissionError, match="the token is wrong"):
            RemoteOctoArm(server.address, token="another-token-of-nobody")
        with pytest.raises(PermissionError, match=r"needs a token.*set OCTOARM_TOKEN"):
            RemoteOctoArm(server.address)
        assert ONE not in server.log
        assert TWO not in server.log


def test_the_load_with_tls_and_a_token(good: tuple[Path, Path], tmp_path: Path) -> None:
    token = tmp_path / "token"
    token.write_text(f"{ONE}\n")
    token.chmod(0o600)
    with ServerProcess(*tls(good), "--token-file", str(token)) as server:
        address, trusted = f"https://{server.address}", ("--certificate", str(good[0]))

        def load(*options: str, **environment: str) -> tuple[int, str]:
            command = [str(find_program("octoarm-load")), address, "--seconds", "0.05", *options]
            where = os.environ | environment
            run = subprocess.run(
                command, check=False, env=where, capture_output=True, text=True, timeout=60
            )
            return run.returncode, run.stdout + run.stderr

        for options, environment in (
            ((*trusted, "--token-file", str(token)), {}),
            (trusted, {"OCTOARM_TOKEN": ONE}),
        ):
            code, output = load(*options, **environment)
            assert code == 0, output
            assert json.loads(output)["steps"] > 0
        for options, message in (
            (trusted, "this server needs a token"),
            ((*trusted, "--token-file", str(good[0])), "octoarm-load: "),
            (("--token-file", str(token)), "octoarm-load: "),
            ((*trusted, "--token-file", str(tmp_path / "none")), "--token-file"),
        ):
            code, output = load(*options)
            assert code == 1
            assert message in output
            assert ONE not in output


def test_a_few_wrong_tokens_close_the_connection(tmp_path: Path) -> None:
    import grpc
    from clients import Client, open_channel, status_of

    token = tmp_path / "token"
    token.write_text(ONE)
    with (
        ServerProcess("--token-file", str(token)) as server,
        open_channel(server.address) as channel,
    ):
        codes = []
        for index in range(12):
            with Client(channel=channel, token=f"wrong-{index}-0123456789") as client:
                codes.append(status_of(client))
        assert codes[:3] == [grpc.StatusCode.UNAUTHENTICATED] * 3
        said(server, "connection closed: wrong tokens")
        # Nobody else's connection is closed.
        with Client(server.address, token=ONE) as client:
            assert client.create()


@pytest.mark.parametrize("kind", ["single", "batch"])
def test_the_token_is_not_written_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    file = tmp_path / "token"
    file.write_text(f"lab {ONE}\n")

    def make(**arguments: Any) -> Any:
        if kind == "single":
            return gym.make("OctoArmRemote-v0", **arguments)
        return gym.make_vec("OctoArmRemote-v0", num_envs=2, **arguments)

    with ServerProcess("--token-file", str(file)) as server:
        address = {"address": server.address}
        given = make(**address, token=ONE)
        for text in (given.spec.to_json(), repr(given.spec), repr(given), str(given.unwrapped)):
            assert ONE not in text
        assert ONE not in repr(given.unwrapped._access)
        # A copy goes on all the same.
        for other in (copy.deepcopy(given.unwrapped), pickle.loads(pickle.dumps(given.unwrapped))):
            other.reset(seed=1)
            other.close()
        again = gym.make if kind == "single" else gym.make_vec
        with pytest.raises(PermissionError, match="give token or token_file, or set OCTOARM_TOKEN"):
            again(gym.envs.registration.EnvSpec.from_json(given.spec.to_json()))
        monkeypatch.setenv("OCTOARM_TOKEN", ONE)
        again(gym.envs.registration.EnvSpec.from_json(given.spec.to_json())).close()
        monkeypatch.setenv("OCTOARM_TOKEN", "wrong-0123456789-wrong")
        by_file = make(**address, token_file=file)
        by_file.reset(seed=1)
        assert str(file) in by_file.spec.to_json()
        with pytest.raises(ValueError, match="token and token_file: give one of them"):
            make(**address, token=ONE, token_file=file)
        with pytest.raises(PermissionError, match="wrong"):
            make(**address)
        file.write_text(f"lab {ONE}\nnotebook {TWO}\n")
        with pytest.raises(ValueError, match="token_file = .*: expected one token"):
            make(**address, token_file=file)
        for env in (given, by_file):
            env.close()


def test_a_reconnecting_client_takes_the_token_that_there_is_now(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text(ONE)
    with ServerProcess("--token-file", str(file)) as server:
        envs = RemoteOctoArmVectorEnv(2, server.address, token_file=file, reconnect=True)
        envs.reset(seed=1)
        file.write_text(TWO)
        server.process.send_signal(signal.SIGHUP)
        said(server, "read again")
        envs._core.connection._end("lost")
        envs.step(np.zeros((2, 2)))
        assert replace(envs._access).token is None
        envs.close()
