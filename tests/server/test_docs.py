"""docs/server.md: its examples run as printed, and it names all that there is."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import grpc
import pytest
from clients import fetch, open_channel
from dm_env_rpc.v1 import connection, dm_env_rpc_pb2, tensor_utils
from dm_env_rpc.v1.extensions import properties
from octoarm_agents.common.serving import ServerProcess, find_program

from octoarm_env.remote import RemoteOctoArm

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "server.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE, re.S)
COMMANDS = re.findall(r"```sh\n(.*?)```", PAGE, re.S)
ADDRESS = "127.0.0.1:50051"


def rows(title: str) -> dict[str, list[str]]:
    """The rows of a section's tables, by the names in code in their first code cells."""
    (section,) = re.findall(rf"^###? {title}\n(.*?)(?=^##|\Z)", PAGE, re.S | re.M)
    found = {}
    for line in re.findall(r"^\| (.*) \|$", section, re.M):
        cells = [cell.strip() for cell in line.split("|")]
        names = next((cell for cell in cells if cell.startswith("`")), "")
        found |= dict.fromkeys(re.findall(r"`([^`]+)`", names), cells)
    return found


class Joined:
    """A stream that has joined a world of its own."""

    def __init__(self, channel: grpc.Channel, **settings: int | str) -> None:
        stream = connection.Connection(channel)
        packed = {name: tensor_utils.pack_tensor(value) for name, value in settings.items()}
        name = stream.send(dm_env_rpc_pb2.CreateWorldRequest(settings=packed)).world_name
        self.specs = stream.send(dm_env_rpc_pb2.JoinWorldRequest(world_name=name)).specs
        self.properties = properties.PropertiesExtension(stream)


@pytest.fixture(scope="module")
def worlds(server: ServerProcess) -> Iterator[tuple[Joined, Joined]]:
    """A single arm, and a batch of three."""
    with open_channel(server.address) as channel:
        yield Joined(channel), Joined(channel, num_envs=3)


@pytest.fixture(scope="module")
def reaching(server: ServerProcess) -> Iterator[tuple[Joined, Joined]]:
    """The same with muscles."""
    task = {"task": "reach", "observe_rates": True}
    with open_channel(server.address) as channel:
        yield Joined(channel, **task), Joined(channel, num_envs=3, **task)


def shape_text(sizes: Iterable[int]) -> str:
    """A shape as the page's tables have it."""
    return f"({', '.join(str(size) for size in sizes)})"


@pytest.mark.parametrize("code", EXAMPLES, ids=range(len(EXAMPLES)))
def test_example_runs_as_printed(code: str, server: ServerProcess, tmp_path: Path) -> None:
    assert ADDRESS in code
    if "stable_baselines3" in code:
        # In this process, which may have imported PyTorch already.
        exec(code.replace(ADDRESS, server.address), {})
        return
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code.replace(ADDRESS, server.address)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    earned = re.search(r"return (\S+) of 500", done.stdout)
    assert earned is None or float(earned[1]) > 499


def test_tls_and_a_token_as_printed(tmp_path: Path) -> None:
    (block,) = (block for block in COMMANDS if "openssl" in block)
    *preparation, serve = block.replace("\\\n", "").strip().splitlines()
    subprocess.run(
        "\n".join(preparation), cwd=tmp_path, shell=True, check=True, capture_output=True
    )
    assert (tmp_path / "token").stat().st_mode & 0o077 == 0
    assert (tmp_path / "key.pem").stat().st_mode & 0o077 == 0
    program, command, *arguments = serve.split()
    assert (program, command) == ("octoarm", "serve")
    files = {name: str(tmp_path / name) for name in ("certificate.pem", "key.pem", "token")}
    with ServerProcess(*(files.get(argument, argument) for argument in arguments)) as server:
        port = server.address.rpartition(":")[2]
        for host in ("localhost", "127.0.0.1"):
            env = RemoteOctoArm(
                f"https://{host}:{port}",
                certificate=files["certificate.pem"],
                token=Path(files["token"]).read_text(encoding="utf-8").strip(),
            )
            env.reset()
            env.close()


def test_every_option_is_named() -> None:
    usage = subprocess.run(
        [str(find_program()), "--help"], capture_output=True, text=True, check=True
    ).stdout
    options = set(re.findall(r"^ +(?:-\w, )?(--[a-z-]+)", usage, re.M))
    assert len(options) > 20
    table = rows("Options")
    assert options == {name for name in table if name.startswith("--")}
    defaults = dict(re.findall(r"(--[a-z-]+) <\w+>\n +.*\[default: (.+)\]", usage))
    for option, default in defaults.items():
        shown = table[option][1].replace(",", "")
        assert shown in {default, "processor's"}, option


def frame() -> set[str]:
    """What is the world's beside the episode's own settings, as the server has it."""
    source = (ROOT / "rust/server/src/task_settings.rs").read_text(encoding="utf-8")
    found = re.search(r"const FRAME: .* = \[(.*)\];", source)
    assert found is not None
    return set(re.findall(r'"(\w+)"', found[1]))


def check_settings(settings: str, title: str, *more: str) -> None:
    """Find all settings of an episode, and those of a world, in a table, with their defaults."""
    episode = json.loads(settings)
    expected = set(episode) - {"vary"} | {"arm.<name>", "vary.<name>", *more} | frame()
    table = rows(title)
    assert expected == set(table)
    for name, value in episode.items():
        if isinstance(value, float):
            assert table[name][2] == f"{value:g}", name


def test_every_setting_of_a_world_is_named(worlds: tuple[Joined, Joined]) -> None:
    check_settings(worlds[0].properties["settings"], "Settings of a world")


def test_every_setting_of_reaching_is_named(reaching: tuple[Joined, Joined]) -> None:
    check_settings(reaching[0].properties["settings"], "Settings of reaching", "goals")


def check_observations(worlds: tuple[Joined, Joined], title: str) -> None:
    """Find all observations, as the specs have them, in a table."""
    table = rows(title)
    for world, column in zip(worlds, (3, 4), strict=True):
        specs = world.specs.observations
        assert {spec.name: str(uid) for uid, spec in specs.items()} == {
            name: cells[0] for name, cells in table.items()
        }
        for spec in specs.values():
            cells = table[spec.name]
            assert cells[2] == dm_env_rpc_pb2.DataType.Name(spec.dtype), spec.name
            assert cells[column].replace("N", "3") == shape_text(spec.shape), spec.name
            kind = "int64s" if cells[2] == "INT64" else "doubles"
            limits = [getattr(bound, kind).array for bound in (spec.min, spec.max)]
            texts = [f"{limit[0]:g}".replace("-", "−") if limit else "∞" for limit in limits]
            assert cells[5] == ("" if texts == ["∞", "∞"] else ", ".join(texts)), spec.name


def test_every_observation_is_as_its_row_says(worlds: tuple[Joined, Joined]) -> None:
    check_observations(worlds, "Actions and observations")


def test_every_observation_of_reaching_is_as_its_row_says(
    reaching: tuple[Joined, Joined],
) -> None:
    check_observations(reaching, "Observations of reaching")


def check_properties(worlds: tuple[Joined, Joined], table: dict[str, list[str]]) -> None:
    """Find all properties, as the extension lists them, in a table."""
    single, batch = (world.properties.specs() for world in worlds)
    assert set(batch) <= set(single)
    assert set(table) == set(single)
    kinds = {"float64": "DOUBLE", "int64": "INT64", "uint64": "UINT64", "object": "STRING"}
    kinds |= {"bool": "BOOL", "uint8": "UINT8"}
    for key, spec in single.items():
        kind, one, many, access, _ = table[key][1:]
        assert kind == kinds[spec.spec.dtype.name], key
        assert one == shape_text(spec.spec.shape), key
        shape = shape_text(batch[key].spec.shape) if key in batch else "–"
        assert many.replace("N", "3") == shape, key
        assert ("read" in access, "write" in access) == (spec.readable, spec.writable), key


def test_every_property_is_as_its_row_says(worlds: tuple[Joined, Joined]) -> None:
    check_properties(worlds, rows("Properties"))


def test_every_property_of_reaching_is_as_its_row_says(reaching: tuple[Joined, Joined]) -> None:
    (section,) = re.findall(r"^### Properties of reaching\n(.*?)^\|", PAGE, re.S | re.M)
    as_above = set(re.findall(r"`(\w+)`", section))
    shared = {name: cells for name, cells in rows("Properties").items() if name in as_above}
    assert set(shared) == as_above
    check_properties(reaching, shared | rows("Properties of reaching"))


def test_every_metric_is_named(server: ServerProcess) -> None:
    assert server.metrics_url is not None
    text = fetch(server.metrics_url)[1]
    kinds = dict(re.findall(r"^# TYPE (\w+) (\w+)$", text, re.M))
    suffix = {"counter": "_total", "info": "_info"}
    expected = {name + suffix.get(kind, ""): kind for name, kind in kinds.items()}
    found = {name: cells[1] for name, cells in rows("Metrics").items() if len(cells) == 3}
    assert {name: found[name] for name in expected} == expected


def test_links_lead_somewhere() -> None:
    headings = re.findall(r"^#+ (.+)$", PAGE, re.M)
    anchors = {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}
    for target in re.findall(r"\]\(([^)]+)\)", PAGE):
        if target.startswith("#"):
            assert target[1:] in anchors, target
        elif not target.startswith("https:"):
            assert (ROOT / "docs" / target).exists(), target
