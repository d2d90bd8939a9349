"""The experiment runner: trials are kept, taken up again, and do not depend on how they are run."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from octoarm_agents.common.provenance import code_digest
from octoarm_agents.common.trials import run_trials, share_out
from octoarm_agents.experiments import EXPERIMENTS
from octoarm_agents.experiments.runner import (
    Experiment,
    RunSettings,
    load_experiment,
    reproduce,
)
from octoarm_agents.experiments.tables import ResultTable

from octoarm_env import ArmParameters


def draw_number(parameters, *, seed, trial, log):
    """A trial that leaves a line in a file whenever it is really computed."""
    with Path(log).open("a", encoding="utf-8") as file:
        file.write(f"{trial}\n")
    matrix = np.random.default_rng([seed, trial]).normal(size=(200, 200))
    return {"trial": trial, "sum": float((matrix @ matrix).sum() * parameters.rest_length)}


def stop_at_three(parameters, *, trial, how):
    """A trial that ends the whole process the first time that number three is tried."""
    if trial == 3 and Path(how).exists():
        Path(how).unlink()
        if how.endswith("killed"):
            os.kill(os.getpid(), signal.SIGKILL)
        raise KeyboardInterrupt
    return {"trial": trial}


def record_numbers(parameters, settings):
    """What trials can do together; leaves a line with their numbers in a file."""
    with Path(settings[0]["log"]).with_suffix(".shares").open("a", encoding="utf-8") as file:
        file.write(f"{[each['trial'] for each in settings]}\n")
    return [parameters.rest_length * each["trial"] for each in settings]


def use_recording(parameters, *, trial, log, stop=None, recording=None):
    """A trial that can be recorded with others; one of them may end the process once."""
    if stop is not None and trial == stop and Path(log).with_suffix(".stop").exists():
        Path(log).with_suffix(".stop").unlink()
        raise KeyboardInterrupt
    with Path(log).open("a", encoding="utf-8") as file:
        file.write(f"{trial}\n")
    together = recording is not None
    return {"trial": trial, "value": recording if together else parameters.rest_length * trial}


def shares_of(log):
    """Numbers of the trials of each share, in order of the shares' first."""
    lines = log.with_suffix(".shares").read_text(encoding="utf-8").splitlines()
    return sorted(json.loads(line) for line in lines)


def not_a_number(parameters, *, trial):
    return {"error": float("nan")}


def settings(log, trials=4, seed=0):
    return [{"seed": seed, "trial": trial, "log": str(log)} for trial in range(trials)]


def computed(log):
    """Numbers of the trials that were computed, in the order of their numbers."""
    return sorted(int(line) for line in log.read_text(encoding="utf-8").split())


@pytest.fixture
def log(tmp_path):
    return tmp_path / "log"


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "trials"


def test_trials_are_computed_once(log, folder):
    first = run_trials(draw_number, ArmParameters(), settings(log), folder=folder)
    assert [result["trial"] for result in first] == [0, 1, 2, 3]
    again = run_trials(draw_number, ArmParameters(), settings(log, 6), folder=folder)
    assert again[:4] == first
    assert computed(log) == [0, 1, 2, 3, 4, 5]
    assert len(list(folder.iterdir())) == 6


@pytest.mark.parametrize(
    "change",
    [
        {"parameters": ArmParameters().replace(rest_length=0.021)},
        {"seed": 1},
        {"fresh": True},
    ],
    ids=str,
)
def test_trials_of_another_kind_are_computed_anew(log, folder, change):
    run_trials(draw_number, ArmParameters(), settings(log), folder=folder)
    run_trials(
        draw_number,
        change.get("parameters", ArmParameters()),
        settings(log, seed=change.get("seed", 0)),
        folder=folder,
        fresh=change.get("fresh", False),
    )
    assert computed(log) == [0, 0, 1, 1, 2, 2, 3, 3]


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[: len(text) // 2],
        lambda text: "[]",
        lambda text: text.replace('"seed": 0', '"seed": 5'),
        lambda text: text.replace('"code": "', '"code": "0'),
        lambda text: text.replace('"numpy": "', '"numpy": "0'),
    ],
    ids=["truncated", "not an object", "other settings", "other code", "other version"],
)
def test_damaged_and_stale_files_are_computed_anew(log, folder, damage):
    first = run_trials(draw_number, ArmParameters(), settings(log), folder=folder)
    victim = sorted(folder.iterdir())[0]
    text = victim.read_text(encoding="utf-8")
    assert damage(text) != text
    victim.write_text(damage(text), encoding="utf-8")
    assert run_trials(draw_number, ArmParameters(), settings(log), folder=folder) == first
    assert len(computed(log)) == 5
    assert victim.read_text(encoding="utf-8") == text


def test_results_do_not_depend_on_the_number_of_processes(log, tmp_path):
    alone, together = (
        run_trials(
            draw_number, ArmParameters(), settings(log), folder=tmp_path / str(jobs), jobs=jobs
        )
        for jobs in (1, 2)
    )
    assert alone == together
    assert computed(log) == [0, 0, 1, 1, 2, 2, 3, 3]


def test_an_interrupted_run_goes_on_where_it_ended(tmp_path, folder):
    how = tmp_path / "interrupted"
    how.touch()
    trials = [{"trial": trial, "how": str(how)} for trial in range(6)]
    with pytest.raises(KeyboardInterrupt):
        run_trials(stop_at_three, ArmParameters(), trials, folder=folder)
    assert len(list(folder.iterdir())) == 3
    results = run_trials(stop_at_three, ArmParameters(), trials, folder=folder)
    assert [result["trial"] for result in results] == list(range(6))


def test_a_killed_run_goes_on_where_it_ended(tmp_path, folder):
    how = tmp_path / "killed"
    how.touch()
    trials = [{"trial": trial, "how": str(how)} for trial in range(5)]
    script = (
        "import sys, json, pathlib; sys.path.insert(0, sys.argv[1]); import test_runner as t\n"
        "t.run_trials(t.stop_at_three, t.ArmParameters(), json.loads(sys.argv[2]),"
        " folder=pathlib.Path(sys.argv[3]))"
    )
    command = [sys.executable, "-c", script, str(Path(__file__).parent)]
    run = subprocess.run([*command, json.dumps(trials), str(folder)], check=False)
    assert run.returncode == -signal.SIGKILL
    stored = sorted(folder.iterdir())
    assert len(stored) == 3
    before = [file.stat().st_mtime_ns for file in stored]
    results = run_trials(stop_at_three, ArmParameters(), trials, folder=folder)
    assert [result["trial"] for result in results] == list(range(5))
    assert [file.stat().st_mtime_ns for file in stored] == before


def test_trials_are_recorded_together(log, tmp_path):
    trials = [{"trial": trial, "log": str(log)} for trial in range(11)]
    alone = run_trials(use_recording, ArmParameters(), trials, folder=tmp_path / "alone")
    names = {file.name: file.read_bytes() for file in (tmp_path / "alone").iterdir()}
    for jobs, shares in (
        (1, [[0, 1, 2, 3, 4, 5], [6, 7, 8, 9, 10]]),
        (2, [[0, 1, 2, 3, 4, 5], [6, 7, 8, 9, 10]]),
        (3, [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10]]),
    ):
        folder = tmp_path / f"{jobs}"
        together = run_trials(
            use_recording, ArmParameters(), trials, folder=folder, record=record_numbers, jobs=jobs
        )
        assert together == alone
        assert {file.name: file.read_bytes() for file in folder.iterdir()} == names
        assert shares_of(log) == shares
        log.with_suffix(".shares").unlink()


def test_only_what_is_missing_of_a_share_is_recorded(log, folder):
    trials = [{"trial": trial, "log": str(log)} for trial in range(7)]
    run_trials(use_recording, ArmParameters(), [trials[1], trials[4]], folder=folder)
    results = run_trials(
        use_recording, ArmParameters(), trials, folder=folder, record=record_numbers
    )
    assert [result["trial"] for result in results] == list(range(7))
    assert shares_of(log) == [[0, 2, 3, 5, 6]]
    assert computed(log) == list(range(7))
    run_trials(use_recording, ArmParameters(), trials, folder=folder, record=record_numbers)
    assert shares_of(log) == [[0, 2, 3, 5, 6]]


def test_an_interrupted_share_keeps_its_finished_trials(log, folder):
    log.with_suffix(".stop").touch()
    trials = [{"trial": trial, "log": str(log), "stop": 3} for trial in range(6)]
    arguments = (use_recording, ArmParameters(), trials)
    with pytest.raises(KeyboardInterrupt):
        run_trials(*arguments, folder=folder, record=record_numbers)
    assert len(list(folder.iterdir())) == 3
    results = run_trials(*arguments, folder=folder, record=record_numbers)
    assert [result["trial"] for result in results] == list(range(6))
    assert shares_of(log) == [[0, 1, 2, 3, 4, 5], [3, 4, 5]]
    assert computed(log) == list(range(6))


def test_shares_are_even():
    for count in range(60):
        for jobs in range(1, 12):
            shares = [list(range(count)[share]) for share in share_out(count, jobs)]
            assert [index for share in shares for index in share] == list(range(count))
            sizes = [len(share) for share in shares]
            assert all(0 < size <= min(8, -(-count // jobs)) for size in sizes)
            assert len(set(sizes[:-1])) <= 1


def test_results_must_be_finite(folder):
    with pytest.raises(ValueError, match="not JSON compliant"):
        run_trials(not_a_number, ArmParameters(), [{"trial": 0}], folder=folder)
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(("progress", "shown"), [(True, True), (False, False), (None, False)])
def test_the_bar_is_shown_on_a_terminal_or_when_asked_for(log, folder, capfd, progress, shown):
    run_trials(
        draw_number,
        ArmParameters(),
        settings(log),
        folder=folder,
        progress=progress,
        description="counting",
    )
    captured = capfd.readouterr()
    assert captured.out == ""
    assert ("counting" in captured.err) is shown


def test_the_digest_is_of_the_package_and_of_the_trials_own_module(tmp_path, monkeypatch):
    inside = {code_digest(f"octoarm_agents.{name}") for name in ("reservoir.inputs", "demo")}
    assert len(inside) == 1
    monkeypatch.syspath_prepend(str(tmp_path))
    module = tmp_path / "some_trials.py"
    module.write_text("first = 1\n", encoding="utf-8")
    first = code_digest("some_trials")
    assert first not in inside
    code_digest.cache_clear()
    module.write_text("second = 2\n", encoding="utf-8")
    assert code_digest("some_trials") != first


def square(run):
    log = run.out.parent / "log"
    (results,) = run.repeat("square", draw_number, [[{"log": str(log)}]])
    return {"trials": run.trials, "sums": [result["sum"] for result in results]}


class Picture:
    """What stands for a figure."""

    def __init__(self, result):
        self.trials = result["trials"]

    def savefig(self, path):
        path.write_bytes(b"picture of %d" % self.trials)


def tabulate(result):
    return [ResultTable("Square", ("sum",), [[str(s)] for s in result["sums"]])]


SQUARE = Experiment("square", 3, square, tabulate, Picture)


def test_an_experiment_writes_both_files_and_says_what_it_was_run_with(tmp_path):
    out = tmp_path / "out"
    result = reproduce(SQUARE, RunSettings(out, seed=4))
    assert sorted(path.name for path in out.iterdir()) == [
        ".square-trials",
        "square.json",
        "square.png",
    ]
    assert (out / "square.png").read_bytes() == b"picture of 3"
    content = json.loads((out / "square.json").read_text(encoding="utf-8"))
    assert content == json.loads(json.dumps(result))
    assert len(content["sums"]) == content["trials"] == 3
    assert content["command"] == "octoarm reproduce square --trials 3 --seed 4"
    assert content["seed"] == 4
    assert content["body"] == json.loads(ArmParameters().to_json())
    assert content["versions"]["numpy"] == np.__version__
    assert content["machine"]["cpu_count"] == os.cpu_count()


def test_a_failure_leaves_no_new_file(tmp_path):
    class Broken(Picture):
        def savefig(self, path):
            super().savefig(path)
            raise RuntimeError("no ink")

    broken = Experiment("square", 1, square, tabulate, Broken)
    with pytest.raises(RuntimeError, match="no ink"):
        reproduce(broken, RunSettings(tmp_path / "out"))
    assert [path.name for path in (tmp_path / "out").iterdir()] == [".square-trials"]


def test_settings_take_turns_over_the_trials(tmp_path):
    run = RunSettings(tmp_path, trials=3, seed=5)
    logs = [str(tmp_path / name) for name in "abc"]
    points = [[{"log": logs[0]}, {"log": logs[1]}], [{"log": logs[2]}]]
    first, second = run.repeat("square", draw_number, points)
    assert [each["trial"] for each in first] == [0, 1, 2]
    assert first == second
    assert [computed(Path(log)) for log in logs] == [[0, 2], [1], [0, 1, 2]]


@pytest.mark.parametrize("setting", [{"trials": 0}, {"seed": -1}, {"jobs": 0}], ids=str)
def test_bad_settings_are_named(tmp_path, setting):
    ((name, value),) = setting.items()
    with pytest.raises(ValueError, match=f"{name} = {value}: expected a whole number, at least"):
        RunSettings(tmp_path, **setting)


def test_every_experiment_is_what_the_registry_calls_it():
    for name in EXPERIMENTS:
        experiment = load_experiment(name)
        assert experiment.name == name
        assert experiment.trials >= 1


def test_a_cluster_needs_an_extra(octoarm, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    result = octoarm("reproduce", "table2", "--cluster", "auto", "--out", tmp_path)
    assert result.exit_code == 1
    assert 'pip install "octoarm-agents[ray]"' in result.output
    assert list(tmp_path.iterdir()) == []
