"""The client in rust/server/examples/node earns in Node.js what the environment gives here."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from clients import Proxy
from octoarm_agents.common.serving import ServerProcess

from octoarm_env import OctoArmEnv

SERVER = Path(__file__).parents[2] / "rust" / "server"
EXAMPLE = SERVER / "examples" / "node"
PACKAGES = ("@grpc/grpc-js", "@grpc/proto-loader")
TOKEN = "0123456789abcdef"
Start = Callable[..., subprocess.Popen[str]]
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Start:
    """Start a copy of the example, beside the packages that were installed for it."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("there is no node")
    modules = Path(os.environ.get("OCTOARM_NODE_MODULES", EXAMPLE / "node_modules"))
    missing = [package for package in PACKAGES if not (modules / package).is_dir()]
    if missing:
        pytest.skip(
            f"{', '.join(missing)} not installed: OCTOARM_NODE_MODULES names no folder with them, "
            "nor has `npm install` been run in rust/server/examples/node"
        )
    # A module looks for packages beside itself, and for the protocol beside the server's folder.
    root = tmp_path_factory.mktemp("node")
    folder = root / "server" / "examples" / "node"
    folder.mkdir(parents=True)
    for file in ("client.mjs", "package.json"):
        shutil.copy(EXAMPLE / file, folder)
    (folder / "node_modules").symlink_to(modules.resolve())
    (root / "protocol").symlink_to(SERVER.parent / "protocol")

    def start(*arguments: str, token: str | None = None) -> subprocess.Popen[str]:
        environment = {name: value for name, value in os.environ.items() if name != "OCTOARM_TOKEN"}
        if token is not None:
            environment["OCTOARM_TOKEN"] = token
        return subprocess.Popen(
            [node, "client.mjs", *arguments],
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    return start


@pytest.fixture(scope="module")
def run(start: Start) -> Run:
    """Run it to its end: exit code, standard output, standard error."""

    def run(*arguments: str, token: str | None = None) -> tuple[int, str, str]:
        with start(*arguments, token=token) as process:
            out, error = process.communicate(timeout=60)
            return process.returncode, out, error

    return run


def local_return(target: str, seed: int) -> float:
    env = OctoArmEnv(target=target)
    env.reset(seed=seed)
    total = 0.0
    for _ in range(500):
        # The teacher's policy would round its actions to float32; what goes over the wire is not.
        total += float(env.step(env.teacher_action())[1])
    return total


@pytest.mark.parametrize(("target", "seed"), [("lissajous", 0), ("quadratic", 2**53 + 1)])
def test_an_episode_is_the_local_one(
    run: Run, server: ServerProcess, target: str, seed: int
) -> None:
    code, out, error = run("--address", server.address, "--target", target, "--seed", str(seed))
    assert (code, error) == (0, "")
    found = re.search(r"^500 steps, INTERRUPTED, return (\S+)$", out, re.M)
    assert found is not None, out
    assert float(found[1]) == local_return(target, seed)


def test_its_pages_print_what_it_prints(run: Run, server: ServerProcess) -> None:
    _, out, _ = run("--address", server.address)
    assert f"```\n{out}```" in (EXAMPLE / "README.md").read_text(encoding="utf-8")
    last = out.splitlines()[-1]
    assert last in (SERVER.parents[1] / "docs" / "server.md").read_text(encoding="utf-8")


def test_what_goes_wrong_is_said_in_a_line(run: Run, server: ServerProcess) -> None:
    address = ("--address", server.address)
    for arguments, token, expected in (
        ((*address, "--target", "square"), None, "the server refused: target"),
        ((*address, "--seed", str(2**64)), None, f"--seed {2**64}: expected a whole number"),
        ((*address, "--colour"), None, "'--colour'"),
        ((*address, "--ca", "nowhere.pem"), None, "nowhere.pem"),
        (("--address", "127.0.0.1:1"), None, "14 UNAVAILABLE"),
        (("--address", "192.0.2.1:50051"), TOKEN, "a token is not sent to another machine"),
    ):
        code, out, error = run(*arguments, token=token)
        assert (code, out) == (1, ""), arguments
        assert re.fullmatch(r"client\.mjs: .*\n", error), error
        assert expected in error


def test_a_token(run: Run) -> None:
    with ServerProcess(environment={"OCTOARM_TOKEN": TOKEN}) as server:
        address = ("--address", server.address)
        assert run(*address, token=TOKEN)[0] == 0
        for token in (None, TOKEN + "x"):
            code, _, error = run(*address, token=token)
            assert code == 1
            assert "16 UNAUTHENTICATED" in error


def test_no_proxy_to_this_machine(run: Run, proxy: Proxy) -> None:
    with ServerProcess(environment={"OCTOARM_TOKEN": TOKEN}) as server:
        port = server.address.rpartition(":")[2]
        for host in ("127.0.0.1", "localhost"):
            assert run("--address", f"{host}:{port}", token=TOKEN)[0] == 0
    assert proxy.received == []


@pytest.mark.skipif(shutil.which("openssl") is None, reason="there is no openssl")
def test_tls(run: Run, tmp_path: Path) -> None:
    files = {name: str(tmp_path / f"{name}.pem") for name in ("certificate", "key")}
    command = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes"
    names = ("-subj", "/CN=octoarm", "-addext", "subjectAltName=DNS:localhost")
    out = ("-keyout", files["key"], "-out", files["certificate"])
    subprocess.run([*command.split(), *names, *out], check=True, capture_output=True)
    tls = ("--tls-certificate", files["certificate"], "--tls-key", files["key"])
    with ServerProcess(*tls, environment={"OCTOARM_TOKEN": TOKEN}) as server:
        address = ("--address", f"localhost:{server.address.rpartition(':')[2]}")
        code, _, error = run(*address, "--ca", files["certificate"], token=TOKEN)
        assert (code, error) == (0, "")
        assert run(*address, token=TOKEN)[0] == 1


@pytest.mark.parametrize("ending", ["kill", "terminate"])
def test_a_server_that_goes_is_noticed(start: Start, ending: str) -> None:
    with ServerProcess() as server, start("--address", server.address) as process:
        assert process.stdout is not None
        assert "springs" in process.stdout.readline()
        getattr(server.process, ending)()
        _, error = process.communicate(timeout=60)
        assert process.returncode == 1
        assert re.fullmatch(r"client\.mjs: 14 UNAVAILABLE: .*\n", error), error
