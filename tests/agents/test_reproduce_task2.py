"""`octoarm reproduce`: the limit cycles, Figures 6 to 13 and the Floquet map, on slices of them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from octoarm_agents.experiments.cycles import (
    bursts,
    figure11,
    figure12,
    figure13,
    floquet,
    limit_cycles,
    taught,
    trials,
)
from octoarm_agents.experiments.cycles.floquet_trials import (
    is_stable,
    is_thrown_far,
    leading_exponent,
)
from octoarm_agents.experiments.cycles.limit_cycles import largest_recovered
from octoarm_agents.experiments.cycles.series import align_orbit, phase_shift
from octoarm_agents.experiments.cycles.taught import TaughtCycle
from octoarm_agents.experiments.cycles.trials import (
    BURST_BEGIN,
    BURST_END,
    disturb_cycle,
    hold_cycle,
    nudge_cycle,
    teach_cycle,
)
from octoarm_agents.reservoir.cycles import (
    CYCLES,
    PAPER_BURSTS,
    PAPER_FINDINGS,
    TRAININGS,
)
from octoarm_agents.reservoir.teaching import Teaching
from PIL import Image

from octoarm_env import LIMIT_CYCLES, ArmParameters

# Told in full where loops depend on it, whatever the default body is.
BODY = ArmParameters.preset("inertial").replace(area_scale=5.0)

# Trainings of a few steps, with which this body holds the Lissajous curve and not much else.
SHORT = {"steps": 20_000, "washout": 4_000}
QUADRATIC = {
    "plain": Teaching("quadratic", 10.0, 1e-4, sampled=True, **SHORT),
    "weighted": Teaching("quadratic", 10.0, 1e-4, **SHORT),
}
LISSAJOUS = {
    "plain": Teaching("lissajous", 20.0, 1e-4, sampled=True, **SHORT),
    "weighted": Teaching("lissajous", 20.0, 1e-4, **SHORT),
}
VAN_DER_POL = {
    "plain": Teaching("van_der_pol", 20.0, 1e-4, sampled=True, **SHORT),
    "weighted": Teaching("van_der_pol", 20.0, 1e-4, **SHORT),
}
# More than the arm can follow.
BEYOND = Teaching("van_der_pol", 200.0, 1e-4, **SHORT)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """One folder for all, so that a cycle is taught once."""
    folder = tmp_path_factory.mktemp("task2")
    BODY.to_json(folder / "body.json")
    return folder


@pytest.fixture
def reproduce(octoarm, out, monkeypatch):
    """Run an experiment on the short teachings; give its JSON and what was printed."""
    for target, teachings in (
        ("quadratic", QUADRATIC),
        ("van_der_pol", VAN_DER_POL),
        ("lissajous", LISSAJOUS),
    ):
        monkeypatch.setitem(CYCLES, target, teachings)
    for module in (limit_cycles, figure11):
        monkeypatch.setattr(module, "BURSTS", (1e-4, 10.0))
    for module in (trials, bursts, limit_cycles):
        monkeypatch.setattr(module, "BURST_RUN", 16_000)
    monkeypatch.setattr(taught, "NOISE_SEEDS", 2)

    def run(name, *options):
        options = ("--jobs", 1, "--out", out, "--arm", out / "body.json", *options)
        result = octoarm("reproduce", name, *options)
        assert result.exit_code == 0, result.output
        with Image.open(out / f"{name}.png") as image:
            assert image.format == "PNG"
            picture = np.asarray(image.convert("L"))
        assert min(picture.shape) > 500
        assert 0.005 < (picture < 200).mean() < 0.5
        content = json.loads((out / f"{name}.json").read_text(encoding="utf-8"))
        assert content["body"] == json.loads(BODY.to_json())
        return content, result.stdout

    return run


@pytest.fixture(scope="module")
def lissajous():
    """The settings of a trial on the Lissajous curve, direct base."""
    result = teach_cycle(BODY, teaching=vars(LISSAJOUS["weighted"]))
    return TaughtCycle(LISSAJOUS["weighted"], result).settings


def test_every_cycle_is_taught_in_both_ways_at_the_papers_amplitude():
    amplitudes = {"quadratic": 90.0, "van_der_pol": 130.0, "lissajous": 10.0}
    assert set(CYCLES) == set(PAPER_BURSTS) == set(PAPER_FINDINGS) == set(amplitudes)
    for target, trainings in CYCLES.items():
        assert tuple(trainings) == TRAININGS
        for teaching in trainings.values():
            assert (teaching.target, teaching.amplitude) == (target, amplitudes[target])
            assert (teaching.actuator, teaching.steps) == ("direct", 70_000)
        assert trainings["plain"].sampled
        assert any(trainings["weighted"].disturbances)
    noises = {target: trainings["plain"].noise for target, trainings in CYCLES.items()}
    assert noises == {"quadratic": 1e-6, "van_der_pol": 1.5e-6, "lissajous": 1e-11}


def test_the_limit_cycles(reproduce, monkeypatch):
    for target in ("quadratic", "van_der_pol"):
        monkeypatch.delitem(CYCLES, target)
    monkeypatch.setattr(limit_cycles, "NEIGHBOURS", (1e-6, 1e-4))
    content, printed = reproduce("limit-cycles", "--steps", 10_000, "--trials", 1)
    assert "weighted" in printed
    assert content["steps"] == 10_000
    assert "--steps 10000" in content["command"]

    plain = content["plain"]["lissajous"]
    assert plain["amplitude_deg"] == [20.0, 20.0]
    assert plain["noise"] == [1e-4, 1e-4]
    assert plain["held"] == [True, True]
    # Each seed has a noise of its own.
    assert len(set(plain["distance"])) == 2
    assert all(0 < distance < 0.05 for distance in plain["distance"])
    assert len(plain["series"]) == 2
    assert plain["paper"] == PAPER_FINDINGS["lissajous"]
    # The paper's own ν is not tried a second time; with this little noise all is lost.
    (neighbour,) = plain["neighbours"]
    assert neighbour == {"noise": 1e-6, "held": [False, False], "distance": [None, None]}

    weighted = content["weighted"]["lissajous"]
    assert weighted["amplitude_deg"] == 20.0
    assert weighted["noise"] == 1e-4
    assert weighted["disturbances"] == [0, 0, 0, 0, 0, 0]
    assert (weighted["steps"], weighted["survived"], weighted["held"]) == (10_000, True, True)
    assert 0 < weighted["distance"] < weighted["distance_max"] < 0.1
    assert weighted["period_ratio"] == pytest.approx(1.0, abs=0.01)
    assert len(weighted["exponents"]) >= 2
    assert weighted["series"][1]["step"][-1] < 10_000

    recovery = content["recovery"]["lissajous"]
    assert set(recovery) == set(TRAININGS)
    for entry in recovery.values():
        assert entry["recovered_fraction"] == {"0.0001": 1, "10": 0}
        assert entry["largest_recovered"] == 1e-4


def test_too_few_steps_are_refused(octoarm, out):
    run = octoarm("reproduce", "limit-cycles", "--steps", 100, "--out", out)
    assert run.exit_code == 2
    assert "--steps" in run.stderr
    assert "10,000" in run.stderr


def test_what_an_experiment_refuses_is_not_blamed_on_the_arm(octoarm, out, monkeypatch):
    monkeypatch.setattr(limit_cycles, "WINDOW_STEPS", 20_000)
    run = octoarm("reproduce", "limit-cycles", "--steps", 10_000, "--out", out)
    assert run.exit_code == 2
    assert "limit-cycles: steps = 10000: expected at least 40000" in run.stderr
    assert "--arm" not in run.stderr


def test_a_body_that_cannot_rest_is_blamed_on_the_arm(octoarm, out, tmp_path):
    BODY.replace(arm_density=60_000.0).to_json(tmp_path / "heavy.json")
    run = octoarm("reproduce", "figure12", "--arm", tmp_path / "heavy.json", "--out", out)
    assert run.exit_code == 2
    assert "--arm" in run.stderr
    assert "no static equilibrium" in run.stderr


def test_an_error_within_is_shown(octoarm, out, monkeypatch):
    def fail(*arguments, **settings):
        np.zeros(2).reshape(3)

    monkeypatch.setattr(figure12, "teach_cycles", fail)
    run = octoarm("reproduce", "figure12", "--out", out)
    assert run.exit_code == 1
    assert isinstance(run.exception, ValueError)
    assert "cannot reshape" in str(run.exception)


def test_figure9(reproduce, monkeypatch):
    monkeypatch.setitem(PAPER_BURSTS, "quadratic", (1e-2, 1e-3, 1e-4))
    # Long enough for what comes back: the window that tells begins 3,000 steps after the noise.
    for module in (bursts, trials):
        monkeypatch.setattr(module, "BURST_RUN", 15_000)
    content, printed = reproduce("figure9", "--trials", 2)
    assert "weighted" in printed
    assert set(content["trainings"]) == set(TRAININGS)
    for entry in content["trainings"].values():
        assert [burst["burst_deg"] for burst in entry["bursts"]] == [1e-2, 1e-3, 1e-4]
        for burst in entry["bursts"]:
            assert sum(burst["outcomes"].values()) == 2
            assert burst["outcomes"].get("recovered", 0) == 2 * burst["recovered_fraction"]
            series = burst["shown"]["series"]
            steps = len(series["step"])
            assert steps == len(series["outputs_deg"][0]) == len(series["target_deg"][1])


def test_figure10_and_figure11(reproduce, monkeypatch):
    monkeypatch.setitem(PAPER_BURSTS, "lissajous", (1e-3, 1e-4, 1e-5))
    content, _ = reproduce("figure10", "--trials", 1)
    (*_, smallest) = content["trainings"]["plain"]["bursts"]
    assert smallest["recovered"] is True
    assert 0 <= smallest["median_recovery_seconds"] < 20
    assert 0 <= smallest["median_phase_shift_turns"] < 0.5

    content, printed = reproduce("figure11", "--trials", 1)
    assert "left the domain" in printed
    small, large = content["trainings"]["plain"]["bursts"]
    assert (small["lost_fraction"], small["lost_trials"]) == (0, [])
    assert (large["lost_fraction"], large["lost_trials"]) == (1, [0])
    example = content["example"]
    assert (example["training"], example["trial"], example["burst_deg"]) == ("plain", 0, 10.0)


def test_figure12(reproduce):
    content, printed = reproduce("figure12")
    assert set(content["cycles"]) == set(CYCLES)
    for pair in content["cycles"].values():
        assert [len(pair[training]["readouts"]) for training in TRAININGS] == [2, 1]
        for readout in pair["plain"]["readouts"]:
            assert -1 <= readout["correlation_of_outputs"] <= 1
            for output in readout["outputs"]:
                assert np.shape(output["weights"]) == (20, 4)
                assert -1 <= output["correlation_of_pairs"] <= 1
                assert 0 < output["part_near_base"] < 1
    assert set(content["confirmed"]["plain"]) == set(content["paper"])
    assert all(len(each) == 2 for each in content["confirmed"]["plain"].values())
    assert "of 2" in printed


def test_figure13(reproduce, monkeypatch):
    monkeypatch.setattr(figure13, "NUDGES", (0.005, 0.1))
    content, _ = reproduce("figure13", "--trials", 2)
    assert set(content["confirmed"]) == set(content["paper"])
    entry = content["cycles"]["lissajous"]
    assert entry["failure"] is None
    small, large = entry["nudges"]
    for measure in figure13.MEASURES:
        assert 0 < small["mean"][measure] < large["mean"][measure]
    assert len(entry["dw"]) == 2
    for sizes in entry["dw"]:
        assert np.shape(sizes["springs"]) == (20, 4)
        np.testing.assert_allclose(sizes["compartments"], np.mean(sizes["springs"], axis=1))


def test_floquet(reproduce, monkeypatch):
    monkeypatch.setattr(floquet, "AMPLITUDES", (1.0, 15.0))
    monkeypatch.setattr(floquet, "NOISES", (1e-6, 1e-4))
    monkeypatch.setattr(floquet, "FACTORS", (0.0,))
    for target in ("quadratic", "van_der_pol"):
        monkeypatch.delitem(CYCLES, target)
    content, printed = reproduce("floquet", "--steps", 10_000)
    assert "leading two exponents" in printed
    own, beyond = content["cycles"]["lissajous"]
    assert (own["amplitude_deg"], beyond["amplitude_deg"]) == (20.0, 300.0)
    # The arm cannot follow a teacher of 300 degrees.
    assert own["failure"] is None
    assert beyond["failure"]["reason"] == "domain"
    assert beyond["loops"] == []
    assert beyond["failure"]["message"] in printed

    wild, good = own["loops"]
    assert [wild["noise"], good["noise"]] == [1e-6, 1e-4]
    assert good["factor"] == 0
    assert good["held"] is True
    assert good["leading_exponent"] < 0
    assert len(good["exponents"]) == 5
    assert good["training_error"] > wild["training_error"] > 0
    assert all(value > 0 for value in good["responses"])
    # Too little noise: a loop of huge gain.
    assert wild["held"] is False
    assert wild["leading_exponent"] > 10

    verdict = content["verdict"]
    assert (verdict["loops"], verdict["held"], verdict["held_and_stable"]) == (2, 1, 1)
    assert verdict["stable_but_lost"] == 0


def test_a_body_that_cannot_follow_is_reported(reproduce, monkeypatch):
    for target in ("quadratic", "lissajous"):
        monkeypatch.delitem(CYCLES, target)
    beyond = {"plain": replace(BEYOND, sampled=True), "weighted": BEYOND}
    monkeypatch.setitem(CYCLES, "van_der_pol", beyond)
    monkeypatch.setattr(limit_cycles, "NEIGHBOURS", ())
    content, printed = reproduce("limit-cycles", "--steps", 10_000, "--trials", 1)
    assert "left its domain" in printed
    weighted, plain = content["weighted"]["van_der_pol"], content["plain"]["van_der_pol"]
    assert weighted["teaching_failure"]["reason"] == "domain"
    assert (weighted["steps"], weighted["survived"], weighted["held"]) == (0, False, False)
    assert weighted["distance"] is None
    assert plain["teaching_failure"]["reason"] == "domain"
    assert (plain["held"], plain["distance"]) == ([False, False], [None, None])
    for entry in content["recovery"]["van_der_pol"].values():
        assert entry == {"recovered_fraction": {}, "largest_recovered": None}


class TestTrials:
    def test_a_run_is_scored_at_its_end(self, lissajous):
        result = hold_cycle(BODY, **lissajous, steps=10_000)
        assert result["survived"] is True
        assert result["steps"] == 10_000
        assert result["scores"]["held"] is True
        begin, end = result["series"]
        assert (begin["step"][0], end["step"][-1]) == (0, 9_995)
        # The target beside the end of the run has the outputs' phase; the one at the begin is the
        # teacher's, which the loop has just left.
        for series, bound in ((begin, 2.0), (end, 1.5)):
            difference = np.subtract(series["outputs_deg"], series["target_deg"])
            assert np.abs(difference).max() < bound
        assert begin["compartments"] == [1, 6, 11, 15, 20]
        assert np.shape(begin["lengths_metres"]) == (5, len(begin["step"]))

    def test_a_run_that_ends_early_has_no_scores(self, lissajous):
        weights = (3.0 * np.array(lissajous["loop"]["weights"])).tolist()
        result = hold_cycle(BODY, loop=lissajous["loop"] | {"weights": weights}, steps=10_000)
        assert result["survived"] is False
        assert result["scores"] is None
        assert result["steps"] == result["failure"]["step"] < 10_000
        json.dumps(result, allow_nan=False)

    def test_noise_is_renewed_and_depends_on_the_trial(self, lissajous):
        common = {"burst": 1e-3, "seed": 3, "series": True}
        first, again, other = (
            disturb_cycle(BODY, **lissajous, **common, trial=trial) for trial in (0, 0, 1)
        )
        assert first == again
        assert first["recovered"] is True
        assert first["farthest"] >= 0
        before = BURST_BEGIN // 10 + 1  # the output of the first step with noise is said before it
        outputs = [np.array(each["series"]["outputs_deg"]) for each in (first, other)]
        np.testing.assert_array_equal(outputs[0][:, :before], outputs[1][:, :before])
        during = slice(before + 1, BURST_END // 10)
        assert np.all(np.any(outputs[0][:, during] != outputs[1][:, during], axis=0))

    def test_too_much_noise_is_not_recovered_from(self, lissajous):
        result = disturb_cycle(BODY, **lissajous, burst=10.0, seed=0, trial=0)
        assert result["held_before"] is True
        assert result["recovered"] is False
        assert result["failure"]["reason"] == "domain"
        assert BURST_BEGIN <= result["failure"]["step"] < BURST_END
        assert "series" in result

    def test_a_small_nudge_goes_on_in_proportion(self, lissajous):
        # Differences are linear in a nudge far below what bends the body's answer: their squares
        # are as four to one.
        result = nudge_cycle(BODY, **lissajous, nudges=[0.0, 1e-6, 2e-6], seed=0, trial=0)
        none, small, large = result["results"]
        assert none == {"outputs": [0.0, 0.0], "springs": 0.0}
        np.testing.assert_allclose(
            np.array(large["outputs"]) / small["outputs"], [4.0, 4.0], rtol=0.05
        )
        assert large["springs"] / small["springs"] == pytest.approx(4.0, rel=0.05)


@pytest.mark.parametrize(
    ("fractions", "expected"),
    [
        ([(1.0, 1.0), (2.0, 1.0), (3.0, 0.5)], 2.0),
        ([(1.0, 1.0), (2.0, 0.9), (3.0, 1.0)], 1.0),
        ([(1.0, 0.0)], None),
        ([(1.0, 1.0)], 1.0),
        ([], None),
    ],
)
def test_the_largest_noise_recovered_from(fractions, expected):
    assert largest_recovered(fractions) == expected


@pytest.mark.parametrize(
    ("exponents", "expected"),
    [
        ([0.5, 0.01, -1.0], 0.5),
        ([0.01, -0.2, -1.0], -0.2),
        ([0.2, -0.1, -1.0], -0.1),
        ([-0.1, -0.2, -1.0], -0.2),
        ([300.0, 299.0, 0.0], 300.0),
        ([0.3], None),
        ([], None),
    ],
)
def test_the_phase_is_left_out_of_the_exponents(exponents, expected):
    assert leading_exponent(exponents) == expected


def test_what_can_throw_a_stable_loop_off_its_cycle():
    loop = {"leading_exponent": -0.2, "responses": [10.0, 20.0]}
    assert is_stable(loop)
    assert not is_thrown_far(loop)
    # Noise of 1e-4 R: its root mean square is 1e-4 / √3, and 5 % of R is too far.
    assert is_thrown_far(loop | {"responses": [10.0, 900.0]})
    assert is_thrown_far(loop | {"responses": [10.0, None]})
    assert not is_stable(loop | {"leading_exponent": 0.4})
    assert not is_stable(loop | {"leading_exponent": None})


def test_weights_are_described_by_compartment():
    weights = np.zeros(80)
    weights[:4] = [1.0, 2.0, -1.0, -2.0]
    described = figure12.describe_weights(weights)
    assert described["weights"][0] == [1.0, 2.0, -1.0, -2.0]
    assert described["correlation_of_pairs"] == pytest.approx(-1.0, abs=0.05)
    assert described["part_near_base"] == 1.0

    both = np.zeros((80, 2))
    both[:, 0] = 3 * np.repeat(np.arange(20, 0, -1), 4)
    both[:, 1] = 4 * np.repeat(np.arange(20, 0, -1), 4)
    sizes = figure13.describe_sizes(both)
    np.testing.assert_allclose(sizes["compartments"], 5.0 * np.arange(20, 0, -1))
    assert sizes["spread_within"] == pytest.approx(0.0, abs=1e-12)
    assert sizes["rank_correlation"] == pytest.approx(-1.0)
    assert sizes["part_near_base"] == pytest.approx((20 + 19 + 18 + 17 + 16) / 210)


def test_the_orbit_is_aligned_with_outputs_of_any_phase():
    cycle = LIMIT_CYCLES["van_der_pol"]
    settled = cycle.signal(9_000, 40.0)[5_123:]
    turn = cycle.period / BODY.timestep
    aligned = align_orbit(settled, cycle.orbit(40.0), turn)
    # A 2048th of a turn, at the cycle's fastest.
    assert np.abs(aligned - settled).max() < 0.2


def test_late_turns_are_a_shift_of_phase():
    time = np.arange(10_000) / 250.0
    signal = np.sin(2 * np.pi * time)
    late = np.sin(2 * np.pi * (time - 0.2))
    assert phase_shift(signal[:2_000], signal[7_777:], 7_777) == pytest.approx(0.0, abs=1e-4)
    assert phase_shift(signal[:2_000], late[7_777:], 7_777) == pytest.approx(0.2, abs=1e-4)
    assert phase_shift(signal[:2_000], np.zeros(100), 7_777) is None
    assert phase_shift(np.zeros(2_000), late, 7_777) is None
