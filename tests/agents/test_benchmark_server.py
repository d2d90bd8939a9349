"""`octoarm benchmark --server`: servers that give the same bits, one run, plausible figures."""

import contextlib
import json
import math
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

grpc = pytest.importorskip("grpc")
pytest.importorskip("dm_env_rpc")

from dm_env_rpc.v1 import connection, tensor_utils  # noqa: E402
from dm_env_rpc.v1 import dm_env_rpc_pb2 as protocol  # noqa: E402
from dm_env_rpc.v1.error import DmEnvRpcError  # noqa: E402
from octoarm_agents.benchmark import server  # noqa: E402
from octoarm_agents.benchmark.server import Sample, ServerResult, load_name  # noqa: E402
from octoarm_agents.benchmark.speed import Spread  # noqa: E402
from octoarm_agents.serving import ServerProcess  # noqa: E402

FOLDER = "OCTOARM_SERVER_FOLDER"
PROGRAMS = ("octoarm-server", "octoarm-load")
TINY = ("benchmark", "--server", "--seconds", 0.1, "--rounds", 1)
OBSERVED = [1, 2, 9]
SERVERS = (server.RUST, server.THREADS, server.ASYNCIO)
PYTHON = ((), ("--asyncio",))


def has_programs(folder):
    return all((folder / name).is_file() for name in PROGRAMS)


@pytest.fixture(scope="module", autouse=True)
def _what_cargo_built():
    """Use the programs of this checkout: `cargo test` builds them before these tests run."""
    target = Path(__file__).parents[2] / "target"
    built = [path.parent for path in target.glob("*/octoarm-load") if has_programs(path.parent)]
    with pytest.MonkeyPatch.context() as patch:
        if built and not has_programs(Path(os.environ.get(FOLDER, "nowhere"))):
            newest = max(built, key=lambda path: (path / PROGRAMS[0]).stat().st_mtime)
            patch.setenv(FOLDER, str(newest))
        yield


@pytest.fixture(scope="module")
def addresses():
    with contextlib.ExitStack() as stack:
        yield {
            server.RUST: stack.enter_context(ServerProcess()).address,
            server.THREADS: stack.enter_context(server.python_server()),
            server.ASYNCIO: stack.enter_context(server.python_server("--asyncio")),
        }


@pytest.fixture(scope="module")
def result():
    """One run with all that there is."""
    told = []
    measured = server.measure_server(0.1, 1, lambda *words: told.append(words))
    assert told == [(name, len(told)) for name in measured.loads]
    return measured


@contextlib.contextmanager
def connect(address):
    with grpc.insecure_channel(address, [("grpc.enable_http_proxy", 0)]) as channel:
        client = connection.Connection(channel)
        try:
            yield client
        finally:
            client._stream.write(None)


def create(client, **settings):
    tensors = {name: tensor_utils.pack_tensor(*value) for name, value in settings.items()}
    return client.send(protocol.CreateWorldRequest(settings=tensors)).world_name


def join(client, **settings):
    world = create(client, **settings)
    return world, client.send(protocol.JoinWorldRequest(world_name=world)).specs


def step(client, number, wanted=OBSERVED):
    """The wave of octoarm-load: its bits, and the state."""
    action = [0.5 * math.sin(0.05 * number), 0.5 * math.cos(0.05 * number)]
    request = protocol.StepRequest(
        actions={1: tensor_utils.pack_tensor(action)}, requested_observations=wanted
    )
    answer = client.send(request)
    return answer.SerializeToString(deterministic=True), answer.state


class TestServersInPython:
    @pytest.mark.parametrize(
        "settings",
        [
            {"seed": (2**64 - 1, "uint64"), "max_episode_steps": (7,)},
            {"seed": (3,), "control_period": (0.001,), "max_episode_steps": (-1,)},
            {"seed": (3,), "control_period": (0.001,)},
        ],
    )
    def test_same_bits_as_the_server_in_rust(self, addresses, settings):
        # Beyond the 500 steps of an episode without a setting, and into several short ones.
        found = {}
        for name, address in addresses.items():
            with connect(address) as client:
                join(client, **settings)
                found[name] = [step(client, number) for number in range(510)]
        states = [state for _, state in found[server.RUST]]
        ends = states.count(protocol.INTERRUPTED)
        limit = settings.get("max_episode_steps", (500,))[0]
        assert ends == (0 if limit == -1 else 510 // (limit + 1))
        # An episode may begin as one before it did.
        assert len({bits for bits, _ in found[server.RUST]}) > 400
        for name in (server.THREADS, server.ASYNCIO):
            assert found[name] == found[server.RUST]

    @pytest.mark.parametrize("wanted", [[], [9], [2, 1], [1, 1]])
    def test_what_is_not_asked_for_is_not_sent(self, addresses, wanted):
        found = []
        for address in addresses.values():
            with connect(address) as client:
                join(client, seed=(0,))
                found.append([step(client, number, wanted) for number in range(2)])
        assert found[0] == found[1] == found[2]

    @pytest.mark.parametrize("name", SERVERS)
    def test_worlds_come_and_go(self, addresses, name):
        with connect(addresses[name]) as client:
            world, specs = join(client, seed=(1,))
            assert specs.actions[1].shape == [2]
            described = specs.observations[1]
            assert described.shape == [80]
            assert 0 < described.min.doubles.array[0] < described.max.doubles.array[0]
            first = step(client, 0)
            with pytest.raises(DmEnvRpcError, match="leave"):
                client.send(protocol.DestroyWorldRequest(world_name=world))
            client.send(protocol.LeaveWorldRequest())
            client.send(protocol.JoinWorldRequest(world_name=world))
            # Another episode, whose phase is the next that is drawn.
            assert step(client, 0) != first
            client.send(protocol.LeaveWorldRequest())
            client.send(protocol.DestroyWorldRequest(world_name=world))
            with pytest.raises(DmEnvRpcError, match=world):
                client.send(protocol.JoinWorldRequest(world_name=world))

    @pytest.mark.parametrize("name", SERVERS)
    def test_what_is_wrong_is_refused_by_the_same_code(self, addresses, name):
        def refused(code, call, *arguments, **settings):
            with pytest.raises(DmEnvRpcError) as error:
                call(client, *arguments, **settings)
            assert error.value.code == code.value[0]

        with connect(addresses[name]) as client:
            refused(grpc.StatusCode.FAILED_PRECONDITION, step, 0)
            for settings in ({"colour": (1,)}, {"max_episode_steps": (0,)}, {"seed": (-1,)}):
                refused(grpc.StatusCode.INVALID_ARGUMENT, create, **settings)
            refused(grpc.StatusCode.INVALID_ARGUMENT, create, control_period=(-1.0,))
            join(client, seed=(1,))
            refused(grpc.StatusCode.FAILED_PRECONDITION, join)
            step(client, 0)
            refused(grpc.StatusCode.INVALID_ARGUMENT, step, 1, [17])
            # The stream goes on.
            step(client, 1)

    @pytest.mark.parametrize("arguments", PYTHON)
    def test_it_ends_when_it_is_asked_to(self, arguments):
        command = [sys.executable, "-m", "octoarm_agents.benchmark.grpcio_server", "--port", "0"]
        with subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, text=True) as process:
            line = process.stdout.readline()
            assert re.fullmatch(r"listening on http://127\.0\.0\.1:\d+\n", line)
            with connect(line.strip().rpartition("/")[2]) as client:
                join(client)
                process.send_signal(signal.SIGTERM)
                assert process.wait(30) == 0

    def test_what_it_said_is_told_when_it_does_not_start(self):
        with (
            pytest.raises(RuntimeError, match=r"(?s)did not start.*--nonsense"),
            server.python_server("--nonsense"),
        ):
            pass


class TestMeasuring:
    def test_one_run_is_complete(self, result):
        names = {
            load_name(each, connections, 0.01)
            for each in SERVERS
            for connections in server.CONNECTIONS
        }
        names |= {load_name(each, 1, 0.001) for each in (*SERVERS, server.RUST_SLEEPING)}
        names |= {load_name(server.RUST_SLEEPING, 1, 0.01), server.LOCAL, server.DEEPMIND}
        names |= {server.REMOTE} - set(result.left_out)
        assert set(result.samples) == set(result.loads) == names
        for name, samples in result.samples.items():
            load = result.loads[name]
            alone = load.connections == 1 and load.contender in (*SERVERS, server.RUST_SLEEPING)
            for sample in samples:
                assert sample.steps >= 25 * load.connections
                trips = [sample.round_trip[percentile] for percentile in server.PERCENTILES]
                assert 0 < trips[0] <= trips[1] <= trips[2] <= trips[3]
                assert 0 < sample.steps_per_second <= 1e6 * max(load.connections, 1) / 5
                assert (sample.over_physics is not None) == alone
                assert not alone or 0 < sample.over_physics < trips[3]

    def test_its_file(self, result):
        content = json.loads(json.dumps(result.to_dict(), allow_nan=False))
        assert content["rounds"] == 1
        assert content["target"]["over_physics_us"] == 150
        medians = content["target"]["median_us"]
        assert set(medians) == {"10_ms", "1_ms"}
        assert content["target"]["reached"] == (max(medians.values()) <= 150)
        row = content["loads"][load_name(server.RUST, 16, 0.01)]
        assert (row["connections"], row["control_period_seconds"]) == (16, 0.01)
        assert row["round_trip_us"]["p99.9"]["max"] >= row["round_trip_us"]["p50"]["median"] > 0
        for connections in server.CONNECTIONS:
            for other in ("threads", "asyncio"):
                # A test shares its machine with others.
                assert content["ratios"][f"rust_over_{other}_{connections}_10_ms"]["median"] > 0.3
        assert content["ratios"]["deepmind_minus_local"]["median"] > 0
        assert {"grpcio", "protobuf", "dm-env-rpc", "octoarm-env"} <= set(content["versions"])
        assert all(content["versions"].values())
        assert content["machine"]["cpu_count"] >= 1

    def test_ratios_are_formed_within_a_round(self):
        def sample(rate, median, over=None):
            return Sample(25, rate, dict.fromkeys(server.PERCENTILES, median), over)

        rust, threads, sleeping = (
            load_name(each, 1, 0.01) for each in (server.RUST, server.THREADS, server.RUST_SLEEPING)
        )
        loads = {
            name: server.Load(contender, 1, 0.01, print)
            for name, contender in ((rust, server.RUST), (server.LOCAL, server.LOCAL))
        }
        samples = {
            rust: [sample(10.0, 100.0, 60.0), sample(30.0, 50.0, 40.0)],
            threads: [sample(5.0, 200.0), sample(5.0, 200.0)],
            sleeping: [sample(5.0, 120.0), sample(5.0, 80.0)],
            server.LOCAL: [sample(1.0, 10.0), sample(1.0, 20.0)],
            server.DEEPMIND: [sample(1.0, 50.0), sample(1.0, 40.0)],
        }
        found = {ratio.key: ratio.spread for ratio in ServerResult(2, 1.0, loads, samples).ratios()}
        assert found == {
            "rust_over_threads_1_10_ms": Spread(2.0, 4.0, 6.0),
            "busy_poll_saves_10_ms": Spread(20.0, 25.0, 30.0),
            "over_physics_rust_10_ms": Spread(40.0, 50.0, 60.0),
            "deepmind_minus_local": Spread(20.0, 30.0, 40.0),
            "deepmind_over_local": Spread(2.0, 3.5, 5.0),
        }

    @pytest.mark.parametrize(("slow", "reached"), [(150.0, True), (150.1, False)])
    def test_the_target_is_for_both_control_periods(self, slow, reached):
        trips = dict.fromkeys(server.PERCENTILES, 200.0)
        samples = {
            load_name(server.RUST, 1, period): [Sample(25, 5.0, trips, over)]
            for period, over in zip(server.PERIODS, (20.0, slow), strict=True)
        }
        target = ServerResult(1, 1.0, {}, samples).target()
        assert target["median_us"] == {"10_ms": 20.0, "1_ms": slow}
        assert target["reached"] is reached


class TestCommand:
    def test_json_alone_on_standard_output(self, octoarm, tmp_path, monkeypatch):
        monkeypatch.setattr(server, "CONNECTIONS", (1, 2))
        out = tmp_path / "new" / "server.json"
        run = octoarm(*TINY, "--json", "--out", out)
        assert run.exit_code == 0, run.output
        content = json.loads(run.stdout)
        assert content == json.loads(out.read_text(encoding="utf-8"))
        assert load_name(server.RUST, 2, 0.01) in content["loads"]

    def test_table(self, octoarm, monkeypatch, result):
        monkeypatch.setattr(server, "measure_server", lambda *_: result)
        run = octoarm(*TINY)
        assert run.exit_code == 0, run.output
        for words in ("connections", "p99.9", *SERVERS, server.DEEPMIND, "Target, at most 150 µs"):
            assert words in run.stdout
        assert ("reached, " in run.stdout) == result.target()["reached"]

    def test_what_is_left_out_is_named(self, octoarm, monkeypatch, result):
        less = ServerResult(
            1, 1.0, result.loads, result.samples, {server.REMOTE: "it is not there"}
        )
        monkeypatch.setattr(server, "measure_server", lambda *_: less)
        assert f"{server.REMOTE} left out: it is not there" in octoarm(*TINY).stdout

    def test_one_thing_at_a_time(self, octoarm):
        run = octoarm(*TINY, "--pictures")
        assert run.exit_code == 2
        assert "--server" in run.stderr
        assert "not together with --pictures" in run.stderr

    def test_without_the_program(self, octoarm, monkeypatch, tmp_path):
        monkeypatch.setenv(FOLDER, str(tmp_path))
        run = octoarm(*TINY)
        assert run.exit_code == 1
        assert "octoarm-load is not installed" in run.stderr
        assert run.stdout == ""

    def test_a_load_that_fails(self, octoarm, monkeypatch, tmp_path):
        (tmp_path / PROGRAMS[0]).symlink_to(Path(os.environ[FOLDER]) / PROGRAMS[0])
        program = tmp_path / PROGRAMS[1]
        program.write_text("#!/bin/sh\necho 'out of luck' >&2\nexit 3\n", encoding="utf-8")
        program.chmod(0o755)
        monkeypatch.setenv(FOLDER, str(tmp_path))
        run = octoarm(*TINY)
        assert run.exit_code == 1
        assert "octoarm-load failed (3): out of luck" in run.stderr
        assert run.stdout == ""

    def test_without_grpcio_the_extra_is_named(self, octoarm, monkeypatch):
        for name in ("server", "grpcio_server"):
            monkeypatch.delitem(sys.modules, f"octoarm_agents.benchmark.{name}")
        monkeypatch.setitem(sys.modules, "grpc", None)
        run = octoarm(*TINY)
        assert run.exit_code == 1
        assert 'pip install "octoarm-agents[benchmark]"' in run.stderr
        assert run.stdout == ""
