"""The searches for the body and for how a cycle is taught, on small slices."""

import dataclasses
import json
import math

import numpy as np
import pytest
from octoarm_agents.calibration.body import measure_again
from octoarm_agents.calibration.evaluation import (
    Evaluation,
    Judgement,
    append_evaluations,
    read_evaluations,
)
from octoarm_agents.calibration.outcomes import (
    PAPER_OUTCOMES,
    count_contradictions,
    describe_outcomes,
    plain_outcomes,
)
from octoarm_agents.calibration.score import (
    FAILURE,
    TEACHER_STEPS,
    evaluate_bodies,
    follow_teachers,
    initial_steps,
    measure_task1,
    score_ratios,
)
from octoarm_agents.calibration.search import POPULATION, search_bodies
from octoarm_agents.calibration.sensitivity import changes_of, probe_change
from octoarm_agents.calibration.space import (
    OPEN_NUMBERS,
    OPEN_PARAMETERS,
    SearchSpace,
    tilt_gravity,
)
from octoarm_agents.experiments.emulation.protocol import INITIAL_STEPS, TASKS, TrialInput
from octoarm_agents.experiments.emulation.trials import score_arm

from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError

# Stays in its domain in Task 1 and under a gentle teacher, whatever the defaults are.
BODY = ArmParameters(
    base_coupling="inertial",
    longitudinal_mass_share=1.0,
    area_scale=48.0,
    plane_mass=0.044,
    plane_inertia=0.0,
    arm_density=1303.0,
    gravity=(0.0, 0.0, 9.81),
    lift_scale=-1.0,
    volume_force="applied",
    reference_area="wetted",
)
# As slack as a body can be: it leaves its domain, whatever moves it.
SLACK = BODY.replace(longitudinal_stiffness=2.0, transverse_stiffness=16.0)


def spaces(*, tilt=False, signs=(1.0, -1.0), base=BODY):
    return [SearchSpace(base, sign, "applied", "wetted", tilt) for sign in signs]


def evaluate_body(body, *settings, **more):
    return evaluate_bodies([body], *settings, **more)[0]


def read(path):
    return json.loads(path.read_text(encoding="utf-8"))


def test_the_score_is_as_it_says():
    def score(*ratios):
        return score_ratios(dict(zip(TASKS, ratios, strict=True)))

    assert score(1.0, 1.0, 1.0) == 0.0
    assert score(math.e, 1.0, math.e**2) == pytest.approx(1 + 2 + 0.5 * 2)
    # Little is gained by what is better than the paper's.
    assert score(0.1, 1.0, math.e) == pytest.approx(-0.1 + 1 + 0.5)
    assert score(0.2, 0.3, 0.99) == pytest.approx(-0.2 + math.log(0.99))
    # More than ten times better is another body.
    assert score(1e-2, 1.0, 1.0) == pytest.approx(-0.1 + math.log(10))
    assert score(1e300, 1e300, 1e300) == FAILURE


def test_the_papers_training_makes_of_its_body_what_the_paper_reports(monkeypatch):
    outcomes = plain_outcomes(ArmParameters.preset("nakajima2013"), 1)
    assert outcomes == {target: [outcome] for target, outcome in PAPER_OUTCOMES.items()}
    assert count_contradictions(outcomes) == 0
    assert count_contradictions(outcomes | {"lissajous": ["lost", "held"]}) == 0.5
    assert describe_outcomes(outcomes).endswith("lissajous 1 of 1")
    lost = plain_outcomes(BODY, 1)
    assert lost["quadratic"] == ["lost"]
    monkeypatch.setattr("octoarm_agents.calibration.score.plain_outcomes", lambda *_: lost)
    judged = evaluate_body(BODY, 500, noise_seeds=1)
    assert judged.outcomes == lost
    expected = score_ratios(judged.ratios) + 10 * count_contradictions(lost)
    assert judged.score == pytest.approx(expected)


def test_ratios_are_those_of_the_trials_of_table_2():
    drive = TrialInput.make("sines", 0, 0)
    trial = score_arm(BODY, kind="sines", amplitude=60.0, seed=0, trial=0)
    assert trial["failure"] is None
    (ratios,) = measure_task1([Arm(BODY)], [drive.initial])
    paper = {"second_order": 1.84e-7, "tenth_order": 3.77e-6, "volterra": 8.89e-5}
    for task in TASKS:
        assert ratios[task] == pytest.approx(trial["arm"]["test"][task] / paper[task], rel=1e-6)


def test_failures_are_graded_by_how_far_the_body_got():
    sound = evaluate_body(BODY, 500, {"lissajous": 5.0})
    assert sound.failure is None
    assert sound.score == score_ratios(sound.ratios) < FAILURE
    # A teacher of 400 degrees breaks any arm, one of 200 later.
    graded = [evaluate_body(BODY, 500, {"lissajous": 5.0, "van_der_pol": R}) for R in (400, 200)]
    for each in graded:
        assert each.ratios == sound.ratios
        assert each.failure["stage"] == "van_der_pol"
        assert 0 < each.failure["part"] < 1
        assert each.score == FAILURE + 1 - each.failure["part"]
    assert graded[0].score > graded[1].score
    # One more stage is left if the first of two cycles breaks it, and all of them if Task 1 does.
    first, slack = evaluate_bodies([BODY, SLACK], 500, {"van_der_pol": 400.0, "lissajous": 5.0})
    assert first.score == pytest.approx(graded[0].score + 1)
    assert slack.ratios is None
    assert slack.failure["stage"] in ("task1", "rest")
    assert slack.score == FAILURE + 3 - slack.failure["part"] > first.score


def test_a_teacher_is_followed_or_not():
    arm = Arm(BODY)
    targets = ["lissajous", "van_der_pol", "van_der_pol", "quadratic"]
    amplitudes = [5.0, 400.0, 200.0, 10.0]
    steps = follow_teachers([arm] * 4, targets, amplitudes)
    assert steps[0] == steps[3] == TEACHER_STEPS
    assert 0 < steps[1] < steps[2] < TEACHER_STEPS
    assert arm.state == Arm(BODY).state
    for made, target, amplitude in zip(steps, targets, amplitudes, strict=True):
        assert follow_teachers([arm], [target], [amplitude]) == [made]


def test_bodies_are_judged_together_as_alone():
    bodies = [
        BODY,
        SLACK,
        BODY.replace(arm_density=1100.0, area_scale=20.0),
        # Of fewer compartments than its neighbours, which is more than a search varies.
        BODY.replace(compartments=18),
        BODY.replace(area_scale=5.0),
        # Rests, and leaves its domain in Task 1.
        BODY.replace(longitudinal_damping=0.0, transverse_damping=0.0),
        BODY.replace(timestep=0.0005),
        BODY.replace(lift_scale=1.0),
    ]
    amplitudes = {"lissajous": 5.0, "van_der_pol": 75.0}
    alone = [evaluate_body(body, 300, amplitudes) for body in bodies]
    assert evaluate_bodies(bodies[::-1], 300, amplitudes) == alone[::-1]
    stages = [each.failure and each.failure["stage"] for each in alone]
    assert stages == [
        *(None, "rest", None, None),
        *("van_der_pol", "task1", "rest", "van_der_pol"),
    ]
    assert "timestep = 0.0005" in alone[6].failure["message"]
    assert "equilibrium" in alone[1].failure["message"]
    assert evaluate_bodies([], 300, amplitudes) == []


def test_the_errors_of_several_starts_are_those_of_each():
    slack = BODY.replace(longitudinal_damping=0.0, transverse_damping=0.0)
    arms = [Arm(BODY), Arm(slack), Arm(BODY), Arm(BODY)]
    starts = [1000, 500, 0, 250]
    together = measure_task1(arms, starts)
    assert isinstance(together[1], DomainError)
    for index in (0, 2, 3):
        assert [together[index]] == measure_task1([Arm(BODY)], [starts[index]])
    assert len({each["volterra"] for each in together if isinstance(each, dict)}) == 3


def test_starts_are_spread_over_the_papers_range():
    assert initial_steps(1) == [500]
    assert initial_steps(3) == [0, 500, INITIAL_STEPS]
    assert initial_steps(5) == [0, 250, 500, 750, INITIAL_STEPS]
    with pytest.raises(ValueError, match="trials = 0: expected a whole number, at least 1"):
        initial_steps(0)


@pytest.mark.parametrize("tilt", [False, True])
def test_a_space_is_spanned_by_the_open_parameters_alone(tilt):
    space = SearchSpace(BODY, 1.0, "total", "planform", tilt)
    fixed = set(BODY.to_dict()) - set(OPEN_PARAMETERS)
    for coordinate in (0.0, 0.5, 1.0):
        changes = space.changes([coordinate] * len(space.begin))
        assert set(changes) == set(OPEN_PARAMETERS)
        body = BODY.replace(**changes)
        assert {name: getattr(body, name) for name in fixed} == {
            name: getattr(BODY, name) for name in fixed
        }
        assert (body.lift_scale, body.volume_force, body.reference_area) == (1, "total", "planform")
        assert math.hypot(*body.gravity) == pytest.approx(9.81)
        for name, number in OPEN_NUMBERS.items():
            ends = {0.0: number.low, 1.0: number.high}
            assert getattr(body, name) == pytest.approx(ends.get(coordinate, getattr(body, name)))
            assert number.low * (1 - 1e-12) <= getattr(body, name) <= number.high * (1 + 1e-12)
    middle = space.changes([0.5] * len(space.begin))
    assert middle["area_scale"] == pytest.approx(5.0)
    assert middle["plane_mass"] == pytest.approx(math.sqrt(1e-4 * 0.1))
    assert middle["arm_density"] == pytest.approx(1172.5)
    assert middle["gravity"] == pytest.approx([0, 0, 9.81])


def test_gravity_is_tilted_by_the_angle_asked_for():
    space = SearchSpace(BODY, 1.0, "applied", "wetted", tilt=True)
    middle = [0.5] * len(OPEN_NUMBERS)
    for coordinates, expected in (
        ((0.75, 0.5), (9.81, 0, 0)),
        ((0.5, 0.25), (0, -9.81, 0)),
        ((1.0, 0.5), (0, 0, -9.81)),
        ((1.0, 1.0), (0, 0, -9.81)),
    ):
        gravity = space.changes([*middle, *coordinates])["gravity"]
        assert gravity == pytest.approx(expected, abs=1e-12)
    assert tilt_gravity((0, 0, 9.81), 90.0) == pytest.approx([9.81, 0, 0])
    assert tilt_gravity((0, 2.0, 0), 30.0) == [0, 2.0, 0]
    half = 9.81 / math.sqrt(2)
    assert tilt_gravity((half, 0, half), 45.0) == pytest.approx([9.81, 0, 0])


def bowl(bodies, initial, amplitudes, noise_seeds):
    """Scores that know where they are lowest: light planes, much drag."""
    assert amplitudes == {"quadratic": 60.0}
    return [
        Judgement(
            score=math.log(body.plane_mass / 1e-3) ** 2 + math.log(body.area_scale / 20) ** 2,
            ratios=dict.fromkeys(TASKS, 1.0),
        )
        for body in bodies
    ]


def test_a_search_goes_on_where_it_was_interrupted(tmp_path, monkeypatch):
    monkeypatch.setattr("octoarm_agents.calibration.search.evaluate_bodies", bowl)
    settings = {"evaluations": 14, "seed": 3, "amplitudes": {"quadratic": 60.0}}
    whole = search_bodies(spaces(), file=tmp_path / "whole.jsonl", **settings)
    assert len(whole) == 28
    signs = [each.body["lift_scale"] for each in whole]
    assert signs == [1] * 12 + [-1] * 12 + [1] * 2 + [-1] * 2
    assert whole == read_evaluations(tmp_path / "whole.jsonl")
    lines = (tmp_path / "whole.jsonl").read_text(encoding="utf-8").splitlines(keepends=True)

    file = tmp_path / "part.jsonl"
    # Ended in the middle of the first generation, and of a line.
    file.write_text("".join(lines[:5]) + lines[5][:40], encoding="utf-8")
    state = np.random.get_state()[1].copy()  # noqa: NPY002, that nothing touches it is the point
    assert search_bodies(spaces(), file=file, **settings) == whole
    np.testing.assert_array_equal(np.random.get_state()[1], state)  # noqa: NPY002
    assert sorted(file.read_text(encoding="utf-8").splitlines(keepends=True)) == sorted(lines)
    # Once more: nothing is computed.
    before = file.read_bytes()
    assert search_bodies(spaces(), file=file, **settings) == whole
    assert file.read_bytes() == before


def test_a_search_does_not_depend_on_jobs_nor_on_others_in_its_file(tmp_path):
    space = spaces(tilt=True, signs=(-1.0,))
    alone = search_bodies(space, evaluations=3, file=tmp_path / "alone.jsonl", seed=1)
    together = tmp_path / "together.jsonl"
    other = search_bodies(space, evaluations=1, file=together, seed=2)
    assert other[0].body != alone[0].body
    assert search_bodies(space, evaluations=3, file=together, seed=1, jobs=2) == alone
    assert read_evaluations(together) == other + alone


def test_a_search_learns_from_its_scores_and_begins_again_when_it_has(tmp_path, monkeypatch):
    monkeypatch.setattr("octoarm_agents.calibration.search.evaluate_bodies", bowl)
    found = search_bodies(
        spaces(signs=(1.0,)),
        evaluations=3_000,
        amplitudes={"quadratic": 60.0},
        file=tmp_path / "evaluations.jsonl",
    )
    scores = np.array([each.score for each in found])
    assert [each.index for each in found] == list(range(3_000))
    assert scores[:POPULATION].min() > 1e-2
    assert scores.min() < 1e-8
    best = found[int(scores.argmin())].body
    assert best["plane_mass"] == pytest.approx(1e-3, rel=1e-3)
    assert best["area_scale"] == pytest.approx(20, rel=1e-3)
    # After the lowest score there are wide generations again.
    assert scores[int(scores.argmin()) :].max() > 1


@pytest.mark.parametrize("text", ["not JSON\n", "[1]\n", '{"index": 0, "score": 1}\n'])
def test_a_file_of_something_else_is_refused(tmp_path, text):
    file = tmp_path / "evaluations.jsonl"
    known = dict.fromkeys(field.name for field in dataclasses.fields(Evaluation))
    file.write_text(f"{json.dumps(known)}\n{text}", encoding="utf-8")
    with pytest.raises(ValueError, match=r"evaluations.jsonl, line 2: not an evaluation"):
        search_bodies(spaces(), evaluations=1, file=file)
    assert file.read_text(encoding="utf-8").endswith(text)


def test_a_changed_file_is_noticed(tmp_path, monkeypatch):
    monkeypatch.setattr("octoarm_agents.calibration.search.evaluate_bodies", bowl)
    file = tmp_path / "evaluations.jsonl"
    settings = {"evaluations": 1, "file": file, "amplitudes": {"quadratic": 60.0}}
    search_bodies(spaces(), **settings)
    changed = read_evaluations(file)
    changed[0].body["area_scale"] += 1e-3
    file.unlink()
    append_evaluations(file, changed)
    with pytest.raises(ValueError, match="the file has been changed"):
        search_bodies(spaces(), **settings)


@pytest.mark.parametrize("setting", [{"evaluations": 0}, {"seed": -1}, {"jobs": 0}], ids=str)
def test_bad_settings_are_named(tmp_path, setting):
    ((name, value),) = setting.items()
    arguments = {"evaluations": 1, "file": tmp_path / "evaluations.jsonl"} | setting
    with pytest.raises(ValueError, match=f"{name} = {value}: expected a whole number, at least"):
        search_bodies(spaces(), **arguments)
    with pytest.raises(ValueError, match="spaces: expected the same base in each"):
        search_bodies([*spaces(), *spaces(base=SLACK)], evaluations=1, file=arguments["file"])
    with pytest.raises(ValueError, match="spaces is empty: expected at least one"):
        search_bodies([], evaluations=1, file=tmp_path / "evaluations.jsonl")


def test_a_body_is_measured_again_from_several_starts():
    again = measure_again(BODY, [0, 500])
    assert again["ratios"] == measure_task1([Arm(BODY)] * 2, [0, 500])
    assert again["ratios"][0] != again["ratios"][1]
    for task in TASKS:
        mean = np.mean([each[task] for each in again["ratios"]])
        assert again["mean_ratios"][task] == pytest.approx(mean)
    assert again["score"] == score_ratios(again["mean_ratios"])
    undamped = measure_again(BODY.replace(longitudinal_damping=0.0, transverse_damping=0.0), [0])
    assert undamped["ratios"] == [None]
    assert undamped["mean_ratios"] is undamped["score"] is None


def test_calibrate_body(octoarm, tmp_path):
    arm = tmp_path / "arm.json"
    BODY.to_json(arm)
    command = ["calibrate", "body", "--arm", arm, "--evaluations", 2, "--trials", 2]
    command += ["--noise-seeds", 0, "--amplitudes", "lissajous=5", "--seed", 4, "--lift-sign"]
    out = tmp_path / "out"
    run = octoarm(*command, "both", "--jobs", 1, "--out", out)
    assert run.exit_code == 0, run.output
    assert "measured again" in run.stdout
    content = read(out / "calibration.json")
    tried = read_evaluations(out / "evaluations.jsonl")
    assert len(tried) == 4
    assert {each.body["lift_scale"] for each in tried} == {1, -1}
    best = min(tried, key=lambda each: each.score)
    assert content["best"] == dataclasses.asdict(best)
    assert content["body"] == json.loads(BODY.replace(**best.body).to_json())
    assert ArmParameters.from_json(out / "body.json") == BODY.replace(**best.body)
    assert content["measured_again"]["initial_steps"] == [0, 1000]
    assert [space["lift_scale"] for space in content["spaces"]] == [1, -1]
    assert min(space["best"]["score"] for space in content["spaces"]) == best.score
    assert content["settings"]["amplitudes_degrees"] == {"lissajous": 5}
    assert content["settings"]["seed"] == 4
    assert (out / "calibration.png").read_bytes().startswith(b"\x89PNG")

    # One sign of the two is the same search: it is taken from the file.
    run = octoarm(*command, "-1", "--tilt", "--jobs", 1, "--out", tmp_path / "tilted")
    assert run.exit_code == 0, run.output
    tilted = read_evaluations(tmp_path / "tilted" / "evaluations.jsonl")
    assert len(tilted) == 2
    assert all(each.body["gravity"] != [0, 0, 9.81] for each in tilted)
    before = (out / "evaluations.jsonl").read_bytes()
    assert octoarm(*command, "-1", "--jobs", 1, "--out", out).exit_code == 0
    assert (out / "evaluations.jsonl").read_bytes() == before
    assert len(read(out / "calibration.json")["spaces"]) == 1


def test_calibrate_body_tells_when_there_is_none(octoarm, tmp_path):
    run = octoarm(
        *("calibrate", "body", "--evaluations", 1, "--lift-sign", "+1", "--jobs", 1),
        *("--amplitudes", "quadratic=360", "--noise-seeds", 0, "--arm", "inertial"),
        *("--out", tmp_path),
    )
    assert run.exit_code == 1
    assert "No body stayed in its domain" in run.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["evaluations.jsonl"]


@pytest.mark.parametrize(
    ("amplitudes", "base"),
    [(text, {}) for text in ("quadratic", "circle=4", "quadratic=0", "lissajous=nan", "", ",")]
    + [(None, {"timestep": 0.0005})],
)
def test_calibrate_body_names_bad_options(octoarm, tmp_path, amplitudes, base):
    arm = tmp_path / "arm.json"
    BODY.replace(**base).to_json(arm)
    options = () if amplitudes is None else ("--amplitudes", amplitudes)
    run = octoarm("calibrate", "body", "--arm", arm, "--out", tmp_path / "out", *options)
    assert run.exit_code == 2
    assert "timestep = 0.0005" in run.stderr or "above 0 and up to 360 degrees" in run.stderr
    assert list((tmp_path / "out").iterdir()) == []


def test_every_open_parameter_is_moved_alone():
    for base in (BODY, BODY.replace(plane_inertia=1e-7, lift_scale=1.0, reference_area="planform")):
        changes = changes_of(base)
        assert changes[0].fields == {}
        moved = {each.parameter for each in changes[1:]}
        assert moved == {*OPEN_PARAMETERS, "base_coupling"}
        for each in changes[1:]:
            body = base.replace(**each.fields)
            moved = {name for name, value in body.to_dict().items() if value != getattr(base, name)}
            with_area = {"area_scale"} if each.parameter == "reference_area" else set()
            assert moved == {each.parameter} | with_area
        assert len({(each.parameter, each.label) for each in changes}) == len(changes)
    areas = [each for each in changes_of(BODY) if each.parameter == "area_scale"]
    factors = [each.fields["area_scale"] / BODY.area_scale for each in areas]
    assert factors == pytest.approx([0.5, 0.8, 1.25, 2.0])


def test_a_moved_body_is_measured():
    result = probe_change(BODY, fields={}, starts=[500], amplitudes=[5.0, 200.0])
    assert result["error"] is None
    assert [result["task1"]["mean_ratios"]] == measure_task1([Arm(BODY)], [500])
    assert set(result["largest_amplitudes"]) == set(LIMIT_CYCLES)
    assert result["largest_amplitudes"]["lissajous"] == 5.0
    refused = probe_change(BODY, fields={"area_scale": -1.0}, starts=[500], amplitudes=[5.0])
    assert "area_scale" in refused["error"]
    assert refused["task1"] is refused["largest_amplitudes"] is None


def test_analyse_sensitivity(octoarm, tmp_path, monkeypatch):
    expected = [changes_of(ArmParameters())[index] for index in (0, 3, -1)]
    module = "octoarm_agents.calibration.sensitivity"
    monkeypatch.setattr(f"{module}.changes_of", lambda base: expected)
    command = ["analyse", "sensitivity", "--trials", 1, "--ranges", "360,5", "--jobs", 1]
    command[2:2] = ["--noise-seeds", 0]
    run = octoarm(*command, "--out", tmp_path)
    assert run.exit_code == 0, run.output
    content = read(tmp_path / "sensitivity.json")
    changes = content["changes"]
    assert [each["label"] for each in changes] == [each.label for each in expected]
    assert content["settings"]["amplitudes_degrees"] == [5, 360]
    for each in changes:
        assert each["error"] is None or "equilibrium" in each["error"]
        if each["error"] is None:
            assert set(each["largest_amplitudes"].values()) <= {None, 5, 360}
    text = (tmp_path / "sensitivity.md").read_text(encoding="utf-8")
    assert text in run.stdout
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len(rows) == 2 + len(changes)
    assert len({row.count("|") for row in rows}) == 1
    # The other reading of the area is the same body, once the area is rescaled.
    own, area = changes[0]["task1"], changes[-1]["task1"]
    assert area["mean_ratios"] == pytest.approx(own["mean_ratios"], rel=0.05)
    assert (tmp_path / "sensitivity.png").read_bytes().startswith(b"\x89PNG")
    assert len(list((tmp_path / ".sensitivity-trials").iterdir())) == len(changes)

    run = octoarm(*command[:-4], "--ranges", "5,-1", "--out", tmp_path)
    assert run.exit_code == 2
    assert "amplitudes = [5.0, -1.0]: expected 0 to 360 degrees" in run.stderr


def test_calibrate_cycle(octoarm, tmp_path):
    # Few compartments make a quick body.
    body = ArmParameters(compartments=10)
    body.to_json(tmp_path / "body.json")
    command = ["calibrate", "cycle", "van_der_pol", "-R", 45, "--evaluations", 8]
    command += ["--actuator", "servo", "--steps", 10_000, "--seed", 0, "--out", tmp_path]
    run = octoarm(*command, "--arm", tmp_path / "body.json")
    assert run.exit_code in (0, 1), run.output
    found = read(tmp_path / "van_der_pol-servo.json")
    loop = found["closed_loop"]
    held = loop["scores"] is not None and loop["scores"]["held"]
    assert run.exit_code == (0 if held else 1)
    assert "Floquet exponents" in run.stdout
    assert (loop["scores"] is None) == (loop["failure"] is not None)
    assert len(found["record"]) == 8
    best = min(found["record"], key=lambda each: each["score"])
    teaching = found["teaching"]
    assert (teaching["noise"], teaching["disturbances"]) == (best["noise"], best["disturbances"])
    assert (teaching["actuator"], teaching["amplitude"]) == ("servo", 45)
    assert found["tuned_distance"] == best["distance"]
    assert found["body"] == json.loads(body.to_json())


def test_calibrate_cycle_tells_when_the_arm_cannot_follow(octoarm, tmp_path):
    run = octoarm(
        "calibrate", "cycle", "quadratic", "-R", 360, "--arm", "inertial", "--out", tmp_path
    )
    assert run.exit_code == 1
    assert "The arm cannot follow the teacher" in run.stderr
    assert list(tmp_path.iterdir()) == []
    run = octoarm("calibrate", "cycle", "circle", "-R", 10, "--out", tmp_path)
    assert run.exit_code == 2
    run = octoarm("calibrate", "cycle", "quadratic", "--out", tmp_path)
    assert run.exit_code == 2
    assert "--amplitude" in run.stderr
