"""`octoarm benchmark --server`: one run, plausible figures."""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("grpc")
pytest.importorskip("dm_env_rpc")

from octoarm_agents.benchmark import server
from octoarm_agents.benchmark.server import batch_name, load_name
from octoarm_agents.benchmark.turns import Spread

FOLDER = "OCTOARM_SERVER_FOLDER"
PROGRAMS = ("octoarm-server", "octoarm-load")
BATCHES = ((2, 0.01), (9, 0.02))
SERVERS = (server.SERVER, server.SLEEPING)
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
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(server, "CONNECTIONS", (1, 4))
        patch.setattr(server, "BATCHES", BATCHES)
        return server.measure_server(0.1, 1)


class TestMeasuring:
    def test_one_run_is_complete(self, result):
        names = {load_name(each, 1, period) for each in SERVERS for period in server.PERIODS}
        names |= {load_name(server.SERVER, 4, 0.01), server.LOCAL, server.DEEPMIND}
        if server.REMOTE not in result.left_out:
            batches = [(*batch, remote) for batch in BATCHES for remote in (True, False)]
            names |= {batch_name(*batch, remote=remote) for *batch, remote in batches}
            names.add(server.REMOTE)
        assert set(result.figures) == names
        for name, figures in result.figures.items():
            trips = [figures[f"{percentile}_us"][0] for percentile in server.PERCENTILES]
            assert 0 < trips[0] <= trips[1] <= trips[2] <= trips[3]
            assert 0 < figures["steps_per_second"][0] <= 1e6
            alone = name.startswith(server.SERVER) and ", 1 connection," in name
            assert (server.OVER_PHYSICS in figures) == alone
            assert not alone or 0 < figures[server.OVER_PHYSICS][0] < trips[3]

    def test_its_file(self, result):
        content = json.loads(json.dumps(result.to_dict(), allow_nan=False))
        assert content["rounds"] == 1
        row = content["contenders"][load_name(server.SERVER, 4, 0.01)]
        assert row["p99.9_us"]["max"] >= row["p50_us"]["median"] > 0
        assert content["ratios"]["deepmind_over_local"]["median"] > 0
        assert {"grpcio", "protobuf", "dm-env-rpc", "octoarm-env"} <= set(content["versions"])
        assert all(content["versions"].values())
        assert content["machine"]["cpu_count"] >= 1

    def test_ratios_are_formed_within_a_round(self):
        rust, sleeping = (load_name(each, 1, 0.01) for each in SERVERS)
        medians = {
            rust: [100.0, 50.0],
            sleeping: [120.0, 80.0],
            server.LOCAL: [10.0, 20.0],
            server.DEEPMIND: [50.0, 40.0],
        }
        figures = {
            name: {"steps_per_second": [1.0, 1.0], server.MEDIAN: values}
            for name, values in medians.items()
        }
        spreads = {each.key: each.spread(figures) for each in server.comparisons()}
        assert {key: spread for key, spread in spreads.items() if spread is not None} == {
            "busy_poll_saves_10_ms": Spread(20.0, 25.0, 30.0),
            "deepmind_minus_local": Spread(20.0, 30.0, 40.0),
            "deepmind_over_local": Spread(2.0, 3.5, 5.0),
        }


class TestCommand:
    def test_table_and_file(self, octoarm, monkeypatch, result, tmp_path):
        less = replace(result, left_out={server.REMOTE: "it is not there"})
        monkeypatch.setattr(server, "measure_server", lambda *_: less)
        out = tmp_path / "new" / "server.json"
        run = octoarm(*TINY, "--out", out)
        assert run.exit_code == 0, run.output
        for words in ("connection", "p99.9", server.SERVER, server.DEEPMIND, "over physics"):
            assert words in run.stdout
        assert f"{server.REMOTE} left out: it is not there" in run.stdout
        assert json.loads(octoarm(*TINY, "--json").stdout) == json.loads(
            out.read_text(encoding="utf-8")
        )

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
