"""`octoarm benchmark`: one run, plausible figures."""

import json

import pytest
from octoarm_agents.benchmark import contenders as names
from octoarm_agents.benchmark import speed

TINY = ("benchmark", "--seconds", 3, "--rounds", 3)


@pytest.fixture
def two_contenders(monkeypatch):
    """One arm and a batch alone: what is made for every run takes its time."""
    make = names.make_contenders

    def few():
        made = make()
        for contender in made[2:]:
            contender.close()
        return made[:2]

    monkeypatch.setattr(speed, "make_contenders", few)


def test_figures_of_one_run(octoarm, tmp_path):
    pytest.importorskip("mujoco")
    out = tmp_path / "new" / "speed.json"
    run = octoarm(*TINY, "--out", out)
    assert run.exit_code == 0, run.output
    for words in ("Microseconds of an arm's", "MuJoCo twin / one arm", "CPUs", "numpy", "KiB"):
        assert words in run.stdout
    assert "not installed" not in run.stdout

    content = json.loads(out.read_text(encoding="utf-8"))
    assert content["rounds"] == 3
    times = content["microseconds_per_arm_step"]
    batches = {names.batch_name(arms, 1) for arms in names.BATCH_SIZES}
    vectors = {names.vector_name(envs, 1) for envs in names.BATCH_SIZES}
    peers = {names.TWIN, names.SYNC, names.ASYNC}
    elsewhere = {names.elsewhere_name(name) for name in names.other_instruction_sets()}
    assert {names.ARM, names.ARM_DRY, names.ARM_SERVO, names.ARM_STEP} <= set(times)
    assert {names.ENV_BARE, names.ENV_MADE} | batches | vectors | peers | elsewhere <= set(times)
    for row in times.values():
        assert 0 < row["min"] <= row["median"] <= row["max"]
        assert row["steps_per_round"] >= 1
        real_time = 1e6 * row["timestep_seconds"] / row["median"]
        assert row["simulated_seconds_per_second"] == pytest.approx(real_time)

    # How large they are is for the command to say: a test shares its machine with others.
    ratios = content["ratios"]
    best = "twin_over_batch_" + content["machine"]["instruction_set"]
    for name in ("twin_over_arm", best, "arm_over_batch", "sync_over_vector_1"):
        assert ratios[name]["median"] > 0
    assert ratios["vector_share_1_threads"]["median"] > 0
    rate = 1e5 / times[names.vector_name(names.BATCH, 1)]["median"]
    assert ratios["env_steps_1_threads"]["median"] == pytest.approx(rate)
    # The arm's own state and scratch, no snapshots.
    assert 5_000 < content["bytes_per_vector_sub_environment"] < 60_000
    assert content["machine"]["cpu_count"] >= 1
    assert content["versions"]["mujoco"]
    assert list(out.parent.iterdir()) == [out]


@pytest.mark.usefixtures("two_contenders")
def test_without_peers_the_rest_is_measured(octoarm):
    run = octoarm(*TINY)
    assert run.exit_code == 0, run.output
    assert (
        'MuJoCo not installed, so left out: pip install "octoarm-agents[benchmark]"' in run.stdout
    )
    assert names.ARM_SERVO in run.stdout
    assert "twin /" not in run.stdout


@pytest.mark.usefixtures("two_contenders")
def test_json_alone_on_standard_output(octoarm):
    run = octoarm("benchmark", "--seconds", 0.3, "--rounds", 1, "--json")
    content = json.loads(run.stdout)
    assert content["ratios"] == {}
    assert content["microseconds_per_arm_step"][names.ARM]["median"] > 0


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--seconds", "0", "between 0.1 and 3,600 seconds"),
        ("--rounds", "0", "between 1 and 1,001"),
        ("--out", ".", "folder"),
    ],
)
def test_a_bad_option_is_named(octoarm, option, value, message):
    run = octoarm("benchmark", option, value)
    assert run.exit_code == 2
    assert option in run.stderr
    assert message in run.stderr


def test_spread_of_rounds():
    assert speed.Spread.of([3.0, 1.0, 2.0]).to_dict() == {"min": 1.0, "median": 2.0, "max": 3.0}


def ratios(microseconds):
    result = speed.SpeedResult(2, {}, {}, microseconds)
    return {ratio.key: ratio.spread for ratio in result.ratios()}


def test_ratios_are_formed_within_a_round():
    found = ratios(
        {names.TWIN: [100.0, 300.0], names.ARM_DRY: [10.0, 20.0], names.ARM: [20.0, 20.0]}
    )
    assert found == {
        "twin_over_arm": speed.Spread(10.0, 12.5, 15.0),
        "twin_over_wet_arm": speed.Spread(5.0, 10.0, 15.0),
    }


def test_overhead_is_the_time_beyond_ten_physics_steps():
    found = ratios({names.ENV_BARE: [10.7, 11.3], names.ARM_SERVO: [10.0, 11.0]})
    assert found["overhead_bare"].median == pytest.approx(5.0)


def test_the_vector_environment_is_compared_with_the_bare_batch_of_as_many_threads():
    microseconds = {}
    for threads in (1, 2):
        microseconds[names.batch_name(names.BATCH, threads)] = [1.0 / threads] * 2
        microseconds[names.vector_name(names.BATCH, threads)] = [1.25 / threads] * 2
    found = ratios(microseconds)
    assert found["vector_share_1_threads"].median == found["vector_share_2_threads"].median == 80.0
    assert found["env_steps_2_threads"].median == 160_000.0
    assert found["batch_threads"].median == found["vector_threads"].median == 2.0
