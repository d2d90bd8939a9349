"""Proxies: none on the way to this machine, no token in the clear, and messages that name them."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
from certificates import make_certificate, tls
from clients import Proxy
from octoarm_agents.benchmark.server import _deepmind
from octoarm_agents.common.serving import ServerProcess, find_program

from octoarm_env import OctoArmEnv
from octoarm_env.remote import RemoteOctoArm

TOKEN = "0123456789abcdef"


@pytest.mark.parametrize(
    ("host", "name"),
    [("127.0.0.1", "127.0.0.1"), ("127.0.0.1", "http://localhost"), ("::1", "[::1]")],
)
def test_no_proxy_to_this_machine(
    proxy: Proxy, monkeypatch: pytest.MonkeyPatch, host: str, name: str
) -> None:
    # gRPC's own, which asks proxies for other proxies too.
    monkeypatch.setenv("GRPC_ADDRESS_HTTP_PROXY", proxy.address)
    monkeypatch.setenv("GRPC_ADDRESS_HTTP_PROXY_ENABLED_ADDRESSES", "0.0.0.0/0,::/0")
    options = {"OCTOARM_TOKEN": TOKEN}
    with ServerProcess("--host", host, environment=options) as server:
        port = server.address.rpartition(":")[2]
        env = RemoteOctoArm(f"{name}:{port}", token=TOKEN)
        assert env.reset(seed=1)[0].tobytes() == OctoArmEnv().reset(seed=1)[0].tobytes()
        env.close()
    assert proxy.received == []


def test_no_proxy_for_the_load_and_the_benchmark(proxy: Proxy, server: ServerProcess) -> None:
    load = find_program("octoarm-load")
    command = [str(load), f"http://{server.address}", "--seconds", "0.05"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=120)
    with _deepmind(server.address):
        pass
    assert proxy.received == []


def test_a_proxy_that_refuses_is_named(proxy: Proxy, monkeypatch: pytest.MonkeyPatch) -> None:
    for first in ("grpc_proxy", "https_proxy", "http_proxy"):
        with pytest.raises(ConnectionError) as caught:
            RemoteOctoArm("192.0.2.1:50051", timeout=0.5)
        message = str(caught.value)
        assert "no server answers at 192.0.2.1:50051" in message
        assert f"{first} = http://{proxy.address} leads there through a proxy" in message
        assert "sesame" not in message
        assert "somebody" not in message
        # The last attempt may have been given up before it said anything.
        asked = [data for data in proxy.received if data]
        assert asked
        assert all(data.startswith(b"CONNECT 192.0.2.1:50051") for data in asked)
        proxy.received.clear()
        monkeypatch.delenv(first)


def test_without_a_proxy_none_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in os.environ.keys() & {"grpc_proxy", "https_proxy", "http_proxy"}:
        monkeypatch.delenv(name)
    for value in ({}, {"https_proxy": ""}):
        for name, text in value.items():
            monkeypatch.setenv(name, text)
        with pytest.raises(ConnectionError) as caught:
            RemoteOctoArm("192.0.2.1:50051", timeout=0.05)
        assert "proxy" not in str(caught.value)


def test_no_token_in_the_clear_beyond_this_machine(proxy: Proxy) -> None:
    with pytest.raises(ValueError, match="a token is not sent to another machine without TLS"):
        RemoteOctoArm("192.0.2.1:50051", token=TOKEN)
    assert proxy.received == []


def test_with_tls_the_proxy_sees_no_token(proxy: Proxy) -> None:
    with pytest.raises(ConnectionError, match="leads there through a proxy"):
        RemoteOctoArm("https://192.0.2.1:50051", token=TOKEN, timeout=0.5)
    assert proxy.received
    assert not any(TOKEN.encode() in data for data in proxy.received)


def test_through_a_proxy(proxy: Proxy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = make_certificate(tmp_path, names="DNS:arm.example")
    with ServerProcess(*tls(files), environment={"OCTOARM_TOKEN": TOKEN}) as server:
        proxy.place = server.address
        env = RemoteOctoArm("https://arm.example:50051", token=TOKEN, certificate=files[0])
        assert env.reset(seed=1)[0].tobytes() == OctoArmEnv().reset(seed=1)[0].tobytes()
        env.close()
        asked = proxy.received[0]
        assert asked.startswith(b"CONNECT arm.example:50051 HTTP/1.1\r\n")
        # Base64 of its user and password.
        assert b"c29tZWJvZHk6c2VzYW1l" in asked
        assert not any(TOKEN.encode() in data for data in proxy.received)
        # Nobody knows that name.
        monkeypatch.setenv("no_proxy", "arm.example")
        with pytest.raises(ConnectionError, match=r"no server answers at arm\.example:50051"):
            RemoteOctoArm("https://arm.example:50051", certificate=files[0], timeout=0.2)


def test_every_channel_of_the_documents_is_direct() -> None:
    root = Path(__file__).parents[2]
    page = (root / "docs" / "server.md").read_text(encoding="utf-8")
    channels = page.count("grpc.insecure_channel(")
    assert channels > 0
    assert page.count('grpc.insecure_channel("127.0.0.1:50051", DIRECT)') == channels
