"""`octoarm benchmark --server`: one run, plausible figures."""

import json
import os
import sys
from pathlib import Path

import pytest

pytest.importorskip("grpc")
pytest.importorskip("dm_env_rpc")

from octoarm_agents.benchmark import server
from octoarm_agents.benchmark.server import Sample, ServerResult, load_name
from octoarm_agents.benchmark.speed import Spread

FOLDER = "OCTOARM_SERVER_FOLDER"
PROGRAMS = ("octoarm-server", "octoarm-load")
TINY = ("benchmark", "--server", "--seconds", 0.1, "--rounds", 1)


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
def result():
    """One run with all that there is."""
    told = []
    measured = server.measure_server(0.1, 1, lambda *words: told.append(words))
    assert told == [(name, len(told)) for name in measured.loads]
    return measured


class TestMeasuring:
    def test_one_run_is_complete(self, result):
        names = {load_name(server.RUST, connections, 0.01) for connections in server.CONNECTIONS}
        names |= {load_name(each, 1, 0.001) for each in (server.RUST, server.RUST_SLEEPING)}
        names |= {load_name(server.RUST_SLEEPING, 1, 0.01), server.LOCAL, server.DEEPMIND}
        names |= {server.REMOTE} - set(result.left_out)
        assert set(result.samples) == set(result.loads) == names
        for name, samples in result.samples.items():
            load = result.loads[name]
            alone = load.connections == 1 and load.contender in (server.RUST, server.RUST_SLEEPING)
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
        assert content["ratios"]["deepmind_minus_local"]["median"] > 0
        assert {"grpcio", "protobuf", "dm-env-rpc", "octoarm-env"} <= set(content["versions"])
        assert all(content["versions"].values())
        assert content["machine"]["cpu_count"] >= 1

    def test_ratios_are_formed_within_a_round(self):
        def sample(rate, median, over=None):
            return Sample(25, rate, dict.fromkeys(server.PERCENTILES, median), over)

        rust, sleeping = (load_name(each, 1, 0.01) for each in (server.RUST, server.RUST_SLEEPING))
        loads = {
            name: server.Load(contender, 1, 0.01, print)
            for name, contender in ((rust, server.RUST), (server.LOCAL, server.LOCAL))
        }
        samples = {
            rust: [sample(10.0, 100.0, 60.0), sample(30.0, 50.0, 40.0)],
            sleeping: [sample(5.0, 120.0), sample(5.0, 80.0)],
            server.LOCAL: [sample(1.0, 10.0), sample(1.0, 20.0)],
            server.DEEPMIND: [sample(1.0, 50.0), sample(1.0, 40.0)],
        }
        found = {ratio.key: ratio.spread for ratio in ServerResult(2, 1.0, loads, samples).ratios()}
        assert found == {
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
        for words in (
            "connections",
            "p99.9",
            server.RUST,
            server.DEEPMIND,
            "Target, at most 150 µs",
        ):
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
        monkeypatch.delitem(sys.modules, "octoarm_agents.benchmark.server")
        monkeypatch.setitem(sys.modules, "grpc", None)
        run = octoarm(*TINY)
        assert run.exit_code == 1
        assert 'pip install "octoarm-agents[benchmark]"' in run.stderr
        assert run.stdout == ""
