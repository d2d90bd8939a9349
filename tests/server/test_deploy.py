"""The files for running the server as a service fit the server of this checkout."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from octoarm_agents.common.serving import ServerProcess, find_program

from octoarm_env.remote import RemoteOctoArm

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "rust" / "server" / "deploy"
SETTINGS = DEPLOY / "octoarm-server.toml"
UNIT = (DEPLOY / "octoarm-server.service").read_text(encoding="utf-8")
DOCKERFILE = (DEPLOY / "Dockerfile").read_text(encoding="utf-8")
NOT_HERE = ("tls_certificate", "tls_key", "token_file", "otlp_endpoint")
"""Settings that name files, or need a server that was built otherwise."""


def options() -> dict[str, str | None]:
    """The server's options with their defaults, in the order of its help."""
    usage = subprocess.run(
        [str(find_program()), "--help"], capture_output=True, text=True, check=True
    ).stdout
    found = re.findall(r"^ +--([a-z-]+) <\w+>\n +(.*)$", usage, re.M)
    defaults = {name: re.search(r"\[default: (.+)\]", text) for name, text in found}
    return {
        name.replace("-", "_"): None if default is None else default[1]
        for name, default in defaults.items()
    }


def uncommented() -> str:
    """The settings file with every setting in force."""
    return re.sub(r"^#(\w+ = )", r"\1", SETTINGS.read_text(encoding="utf-8"), flags=re.M)


def unit(key: str) -> list[str]:
    return re.findall(rf"^{key}=(.*)$", UNIT, re.M)


def test_the_settings_file_has_every_option_and_its_default() -> None:
    expected = options()
    assert expected.pop("config") is None
    settings = tomllib.loads(uncommented())
    assert list(settings) == list(expected)
    for name, default in expected.items():
        if default is not None and not default.startswith("as many"):
            kind = type(settings[name])
            assert settings[name] == kind(default), name


def test_a_server_starts_with_the_settings_file() -> None:
    with ServerProcess("--config", str(SETTINGS), "--port", "0") as server:
        env = RemoteOctoArm(server.address)
        env.reset()
        env.close()


def test_a_server_starts_with_every_setting_in_force(tmp_path: Path) -> None:
    lines = uncommented().splitlines(keepends=True)
    file = tmp_path / "settings.toml"
    file.write_text("".join(line for line in lines if not line.startswith(NOT_HERE)), "utf-8")
    with ServerProcess("--config", str(file), "--port", "0", "--metrics-port", "0") as server:
        assert server.metrics_url is not None
        env = RemoteOctoArm(server.address)
        env.reset()
        env.close()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze")
def test_systemd_finds_no_fault(tmp_path: Path) -> None:
    file = tmp_path / "octoarm-server.service"
    file.write_text(UNIT.replace("/usr/local/bin/octoarm-server", str(find_program())), "utf-8")
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(file)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_the_service_gives_what_the_server_takes() -> None:
    known = options()
    (start,) = unit("ExecStart")
    given = re.findall(r"--([a-z-]+) (\S+)", start)
    assert {name.replace("-", "_") for name, _ in given} <= set(known)
    credentials = {credential.split(":")[0] for credential in unit("LoadCredential")}
    assert {path.removeprefix("%d/") for _, path in given if path.startswith("%d/")} == credentials
    # systemd waits longer than the server, and gives it a descriptor for every connection.
    defaults = {name: default for name, default in known.items() if default is not None}
    assert int(*unit("TimeoutStopSec")) > int(defaults["shutdown_timeout"])
    assert int(*unit("LimitNOFILE")) > int(defaults["max_connections"])


@pytest.mark.skipif(shutil.which("cargo") is None, reason="there is no cargo")
def test_the_image_has_what_it_is_built_from(tmp_path: Path) -> None:
    ignored = (DEPLOY / "Dockerfile.dockerignore").read_text(encoding="utf-8").splitlines()
    sources = re.findall(r"^COPY (?!--from)(.+) \S+$", DOCKERFILE, re.M)
    paths = [path for source in sources for path in source.split()]
    assert {line.removeprefix("!") for line in ignored if line.startswith("!")} == set(paths)
    for path in paths:
        (tmp_path / path).symlink_to(ROOT / path)
    # Cargo finds all that it must, and builds nothing.
    command = ["cargo", "metadata", "--offline", "--locked", "--no-deps", "--format-version", "1"]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    packages = {package["name"]: package for package in json.loads(done.stdout)["packages"]}
    build = re.search(r"cargo build --locked --release -p (\S+) --bin (\S+)", DOCKERFILE)
    assert build is not None
    programs = [t["name"] for t in packages[build[1]]["targets"] if t["kind"] == ["bin"]]
    assert build[2] in programs


def test_the_image_starts_the_server_with_options_that_it_has(tmp_path: Path) -> None:
    command = re.search(r"^CMD (\[.*?\])$", DOCKERFILE, re.S | re.M)
    assert command is not None
    arguments = json.loads(command[1].replace("\\\n", ""))
    names = {argument for argument in arguments if argument.startswith("--")}
    assert {name.removeprefix("--").replace("-", "_") for name in names} <= set(options())
    # The files that the page mounts are those that it opens.
    page = (ROOT / "docs" / "server.md").read_text(encoding="utf-8")
    for text in (page, DOCKERFILE):
        mounted = set(re.findall(r":(/run/secrets/[\w.]+):ro", text))
        assert mounted == {argument for argument in arguments if argument.startswith("/run/")}
    # Without them it says what is missing.
    with pytest.raises(RuntimeError, match=r"tls_certificate /run/secrets/certificate\.pem"):
        ServerProcess(*arguments)
    assert "EXPOSE 50051" in DOCKERFILE
    assert "STOPSIGNAL SIGTERM" in DOCKERFILE
