"""`octoarm benchmark`: one run, plausible figures."""

import json
import shutil

import pytest
from octoarm_agents.benchmark import contenders as names
from octoarm_agents.benchmark import speed
from octoarm_agents.benchmark.turns import Contender, Spread, fitted, take_turns

TINY = ("benchmark", "--seconds", 0.3, "--rounds", 2)


@pytest.fixture
def small(monkeypatch):
    """Fewer arms and environments: to make them takes its time."""
    monkeypatch.setattr(names, "BATCH_SIZES", (1, 16))
    monkeypatch.setattr(names, "SYNC_ENVS", 2)
    monkeypatch.setattr(names, "ASYNC_ENVS", 2)
    monkeypatch.setattr(speed, "MEMORY_ENVS", 512)


@pytest.fixture
def two_contenders(monkeypatch):
    """One arm and another alone, and no MuJoCo."""
    few = [Contender(name, fitted(names.FIGURE, 1e6, float, 10)) for name in (names.ARM, "other")]
    monkeypatch.setattr(speed, "make_contenders", lambda: few)
    monkeypatch.setattr(speed, "has_mujoco", lambda: False)
    monkeypatch.setattr(speed, "node", lambda: None)
    monkeypatch.setattr(speed, "_memory_per_environment", lambda: None)


@pytest.mark.usefixtures("small")
def test_figures_of_one_run(octoarm, tmp_path):
    pytest.importorskip("mujoco")
    out = tmp_path / "new" / "speed.json"
    run = octoarm(*TINY, "--out", out)
    assert run.exit_code == 0, run.output
    for words in ("Microseconds per arm", "MuJoCo twin / one arm", "CPUs", "numpy", "KiB"):
        assert words in run.stdout
    assert "not installed" not in run.stdout

    content = json.loads(out.read_text(encoding="utf-8"))
    assert list(out.parent.iterdir()) == [out]
    assert content["rounds"] == 2
    rows = content["contenders"]
    batches = {names.batch_name(arms, 1) for arms in names.BATCH_SIZES}
    vectors = {names.vector_name(envs, 1) for envs in names.BATCH_SIZES}
    peers = {names.TWIN, names.SYNC, names.ASYNC}
    elsewhere = {names.elsewhere_name(name) for name in names.other_instruction_sets()}
    assert {names.ARM, names.ARM_DRY, names.ARM_SERVO, names.ARM_STEP} <= set(rows)
    assert {names.ENV_BARE, names.ENV_MADE} | batches | vectors | peers | elsewhere <= set(rows)
    assert {names.RESETS, names.RESETS_OWN, names.RESETS_ANY, names.REACH} <= set(rows)
    assert names.LIMIT in rows
    assert (names.WEB in rows) == (shutil.which("node") is not None)
    for name, row in rows.items():
        figure = row["microseconds_per_arm_step"]
        assert len(figure["by_round"]) == 2
        assert 0 < figure["min"] <= figure["median"] <= figure["max"] == max(figure["by_round"])
        if not name.startswith("reset") and name != names.LIMIT:
            assert row["times_real_time"] == pytest.approx(1000 / figure["median"])
    steps = rows[names.vector_name(16, 1)]
    median = steps["microseconds_per_arm_step"]["median"]
    assert steps["environment_steps_per_second"] == pytest.approx(1e5 / median)

    # How large they are is for the command to say: a test shares its machine with others.
    best = "twin_over_batch_" + content["machine"]["instruction_set"]
    for name in ("twin_over_arm", best, "arm_over_batch"):
        assert content["ratios"][name]["median"] > 0
    # The arm's own state and scratch, no snapshots.
    assert 5_000 < content["bytes_per_vector_sub_environment"] < 60_000
    assert content["machine"]["cpu_count"] >= 1
    assert content["versions"]["mujoco"]


@pytest.mark.usefixtures("two_contenders")
def test_without_peers_the_rest_is_measured(octoarm):
    run = octoarm(*TINY)
    assert run.exit_code == 0, run.output
    missing = f'{names.TWIN} left out: not installed: pip install "octoarm-agents[benchmark]"'
    assert missing in run.stdout
    assert f"{names.WEB} left out: there is no node on the path" in run.stdout
    assert names.ARM in run.stdout
    assert "twin /" not in run.stdout


@pytest.mark.usefixtures("two_contenders")
def test_json_alone_on_standard_output(octoarm):
    content = json.loads(octoarm(*TINY, "--json").stdout)
    assert content["ratios"] == {}
    assert content["contenders"][names.ARM]["microseconds_per_arm_step"]["median"] == 1e6


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--seconds", "0"), "between 0.1 and 3,600 seconds"),
        (("--rounds", "0"), "between 1 and 1,001"),
        (("--out", "."), "folder"),
        (("--server", "--pictures"), "not together with --pictures"),
        (("--cluster", "auto", "--pictures"), "not together with --pictures"),
    ],
)
def test_a_bad_option_is_named(octoarm, options, message):
    run = octoarm("benchmark", *options)
    assert run.exit_code == 2
    assert options[0] in run.stderr
    assert message in run.stderr


def test_spread_of_rounds():
    assert Spread.of([3.0, 1.0, 2.0]) == Spread(1.0, 2.0, 3.0)


def test_contenders_take_turns_and_are_closed():
    told, closed = [], []

    def contender(name):
        return Contender(name, lambda _: {"µs": 1.0}, close=lambda: closed.append(name))

    result = take_turns(
        [contender(name) for name in "abc"], 0.0, 2, lambda *words: told.append(words)
    )
    assert [name for name, _ in told] == ["a", "b", "c", "b", "c", "a"]
    assert {slices for _, slices in told} == {6}
    assert closed == ["a", "b", "c"]
    assert result.figures["a"] == {"µs": [1.0, 1.0]}


def ratios(microseconds, threads=1):
    figures = {name: {names.FIGURE: values} for name, values in microseconds.items()}
    spreads = {each.key: each.spread(figures) for each in speed.comparisons(threads)}
    return {key: spread for key, spread in spreads.items() if spread is not None}


def test_ratios_are_formed_within_a_round():
    times = {names.TWIN: [100.0, 300.0], names.ARM_DRY: [10.0, 20.0], names.ARM: [20.0, 20.0]}
    assert ratios(times) == {
        "twin_over_arm": Spread(10.0, 12.5, 15.0),
        "twin_over_wet_arm": Spread(5.0, 10.0, 15.0),
    }


def test_overhead_is_the_time_beyond_ten_physics_steps():
    found = ratios({names.ENV_BARE: [10.7, 11.3], names.ARM_SERVO: [10.0, 11.0]})
    assert found["overhead_bare"].median == pytest.approx(5.0)


def test_the_vector_environment_is_compared_with_the_bare_batch_of_as_many_threads():
    microseconds = {}
    for threads in (1, 2):
        microseconds[names.batch_name(names.BATCH, threads)] = [1.0 / threads] * 2
        microseconds[names.vector_name(names.BATCH, threads)] = [1.25 / threads] * 2
    found = ratios(microseconds, 2)
    assert found["vector_share_1_threads"].median == found["vector_share_2_threads"].median == 80.0
    assert found["batch_threads"].median == found["vector_threads"].median == 2.0
