"""The native batch: the bits of single environments in every mode, and nothing else."""

from __future__ import annotations

import copy
import gc
import hashlib
import inspect
import os
import pickle
import re
import subprocess
import sys
from collections import UserDict, UserList
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import data_equivalence as equivalent
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

import octoarm_env
from octoarm_env import ArmParameters, OctoArmEnv, OctoArmVectorEnv, TeacherPolicy
from octoarm_env.rendering.camera import Camera
from octoarm_env.testing import check_vector_env

MODES = list(AutoresetMode)
FAILING = {"arm": "inertial", "amplitude": 20.0, "control_period": 0.001}
"""Settings with which bang-bang actions take the arm out of its domain."""

DISTURBED = {"length_noise": 1e-5, "action_noise": 3.0, "delay": 2, "dropout": 5}


def native(num_envs: int, **options: Any) -> OctoArmVectorEnv:
    envs = gym.make_vec("OctoArm-v0", num_envs=num_envs, **options)
    assert isinstance(envs, OctoArmVectorEnv)
    return envs


def singles(num_envs: int, mode: AutoresetMode, **options: Any) -> SyncVectorEnv:
    make = [lambda: gym.make("OctoArm-v0", **options)] * num_envs
    return SyncVectorEnv(make, autoreset_mode=mode)


def actions(num_envs: int, seed: int = 0) -> Iterator[np.ndarray]:
    """Uniform noise for most, bang-bang for the first and the last environment."""
    rng = np.random.default_rng(seed)
    step = 0
    while True:
        action = rng.uniform(-1, 1, (num_envs, 2)).astype(np.float32)
        action[[0, -1]] = 1.0 if step % 60 < 30 else -1.0
        step += 1
        yield action


def steps(envs: VectorEnv, count: int, seed: int = 0) -> Iterator[tuple]:
    """Results of many steps; environments without autoreset are reset when they have ended."""
    disabled = envs.metadata["autoreset_mode"] == AutoresetMode.DISABLED
    ended = np.zeros(envs.num_envs, bool)
    for action, _ in zip(actions(envs.num_envs, seed), range(count), strict=False):
        if disabled and ended.any():
            yield envs.reset(options={"reset_mask": ended})
        result = envs.step(action)
        ended = result[2] | result[3]
        yield result


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("num_envs", [1, 3, 10])
def test_conformance(mode: AutoresetMode, num_envs: int) -> None:
    options = {"max_episode_steps": 7, "target": "van_der_pol", "reward_width": 0.2}
    envs = native(num_envs, autoreset_mode=mode, **options)
    check_vector_env(envs, lambda: gym.make("OctoArm-v0", **options), steps=20)


@pytest.mark.parametrize("mode", MODES)
def test_conformance_with_failures(mode: AutoresetMode) -> None:
    options = FAILING | {"max_episode_steps": 300}
    envs = native(2, autoreset_mode=mode, **options)
    check_vector_env(envs, lambda: gym.make("OctoArm-v0", **options), steps=60)


@pytest.mark.parametrize("mode", MODES)
def test_conformance_of_different_environments(mode: AutoresetMode) -> None:
    turn = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    circle = 12.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    targets: list[Any] = ["quadratic", circle, "lissajous"]
    amplitudes = [None, 10.0, 25.0]
    bodies = [
        ArmParameters(),
        ArmParameters(longitudinal_stiffness=235.0, rest_length=0.021),
        ArmParameters(area_scale=20.0, timestep=0.0005),
    ]
    envs = native(
        3,
        target=targets,
        amplitude=amplitudes,
        arm=bodies,
        autoreset_mode=mode,
        max_episode_steps=9,
    )
    factories = [
        lambda target=target, amplitude=amplitude, arm=arm: gym.make(
            "OctoArm-v0", target=target, amplitude=amplitude, arm=arm, max_episode_steps=9
        )
        for target, amplitude, arm in zip(targets, amplitudes, bodies, strict=True)
    ]
    check_vector_env(envs, factories, steps=40)
    assert envs.get_attr("amplitude") == pytest.approx((90.0, 10.0, 25.0))
    assert envs.get_attr("period")[1] == pytest.approx(0.3)
    assert not np.array_equal(envs.observation_space.high[0], envs.observation_space.high[1])


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "options",
    [
        {"max_episode_steps": 37},
        FAILING | {"max_episode_steps": 120},
        DISTURBED | {"max_episode_steps": 37},
    ],
    ids=str,
)
@pytest.mark.parametrize("count", [200, pytest.param(1000, marks=pytest.mark.long)])
def test_many_steps_to_the_bit(count: int, mode: AutoresetMode, options: dict) -> None:
    num_envs = 10
    batches = [native(num_envs, autoreset_mode=mode, threads=n, **options) for n in (1, 2)]
    loop = singles(num_envs, mode, **options)
    starts = [envs.reset(seed=3) for envs in (*batches, loop)]
    assert equivalent(starts[0], starts[2], exact=True)
    ends = failures = 0
    streams = zip(*(steps(envs, count) for envs in (*batches, loop)), strict=True)
    for one, two, alone in streams:
        assert equivalent(one, alone, exact=True)
        assert equivalent(two, alone, exact=True)
        if len(one) == 5:
            ends += int((one[2] | one[3]).sum())
            failures += int(one[2].sum())
    assert ends > (count // 5 if "arm" not in options else count // 20)
    assert (failures > 0) == ("arm" in options)


TRACE = """
import hashlib, sys
import gymnasium as gym
from gymnasium.vector import AutoresetMode
import octoarm_env
sys.path.insert(0, sys.argv[1])
from test_vector_env import native, steps
assert octoarm_env.instruction_set() == sys.argv[2], octoarm_env.instruction_set()
for mode in AutoresetMode:
    digest = hashlib.sha256()
    envs = native(10, autoreset_mode=mode, max_episode_steps=11)
    digest.update(envs.reset(seed=1)[0].tobytes())
    for result in steps(envs, 30):
        for part in result[:-1]:
            digest.update(part.tobytes())
    print(digest.hexdigest())
"""


def test_every_instruction_set_gives_the_same_bits() -> None:
    best = ("baseline", "avx2", "avx512").index(octoarm_env.instruction_set())
    traces = {}
    for name in ("baseline", "avx2", "avx512")[: best + 1]:
        run = subprocess.run(
            [sys.executable, "-c", TRACE, str(Path(__file__).parent), name],
            env=os.environ | {"OCTOARM_INSTRUCTION_SET": name},
            capture_output=True,
            text=True,
            check=False,
        )
        assert run.returncode == 0, run.stderr
        traces[name] = run.stdout.split()
        assert len(traces[name]) == 3
    assert len({tuple(trace) for trace in traces.values()}) == 1, traces


def test_what_stands_beside_an_environment_does_not_matter() -> None:
    small, large = native(2, max_episode_steps=25), native(19, max_episode_steps=25)
    first = small.reset(seed=[5, 6])[0]
    assert np.array_equal(first, large.reset(seed=[*range(100, 109), 5, 6, *range(8)])[0][9:11])
    for action in actions(2):
        results = small.step(action)
        around = np.resize(action[::-1], (19, 2))
        around[9:11] = action
        others = large.step(around)
        for ours, theirs in zip(results[:4], others[:4], strict=True):
            assert np.array_equal(ours, theirs[9:11])
        if results[3].all():
            break


def test_an_arm_that_fails_disturbs_no_neighbour() -> None:
    envs = native(8, autoreset_mode=AutoresetMode.SAME_STEP, max_episode_steps=None, **FAILING)
    calm = native(8, autoreset_mode=AutoresetMode.SAME_STEP, max_episode_steps=None, **FAILING)
    envs.reset(seed=0)
    calm.reset(seed=0)
    failures = 0
    for step in range(400):
        action, _ = TeacherPolicy(envs).predict()
        ours = action.copy()
        # One action changes its sign every step, and its arm is torn apart again and again.
        ours[3] = 1.0 if step % 2 else -1.0
        result, expected = envs.step(ours), calm.step(action)
        failures += int(result[2][3])
        if result[2][3]:
            assert "compartment" in result[4]["final_info"]["failure"][3]
            assert np.isfinite(result[4]["final_obs"][3]).all()
        others = np.arange(8) != 3
        for one, other in zip(result[:4], expected[:4], strict=True):
            assert np.array_equal(one[others], other[others])
        assert all(np.isfinite(result[0]).ravel())
    assert failures > 5


@pytest.mark.parametrize(
    ("bad", "kind", "words"),
    [
        (np.array([[0.0, 0.0], [np.nan, 0.0], [0.0, 0.0]]), ValueError, r"actions\[1, 0\] = NaN"),
        (np.array([[0, 0], [0, 0], [0, np.inf]]), ValueError, r"actions\[2, 1\] = inf"),
        (np.array([[0, 0], [0, 1.5], [0, 0]]), ValueError, r"actions\[1, 1\] = 1.5 .*\[-1, 1\]"),
        (np.zeros((2, 2)), ValueError, r"actions has shape \(2, 2\), expected \(3, 2\)"),
        (np.zeros(6), ValueError, r"actions has shape \(6,\)"),
        (np.zeros((3, 2), complex), TypeError, "actions"),
        (None, TypeError, "actions"),
        ([["a", "b"]] * 3, TypeError, "actions"),
    ],
)
@pytest.mark.parametrize("mode", MODES)
def test_bad_actions_are_refused_before_anything_changes(mode, bad, kind, words) -> None:
    envs, twin = native(3, autoreset_mode=mode), native(3, autoreset_mode=mode)
    envs.reset(seed=0)
    twin.reset(seed=0)
    before = envs.snapshot()
    with pytest.raises(kind, match=words):
        envs.step(bad)
    assert envs.snapshot() == before
    good = np.full((3, 2), 0.25, np.float32)
    assert equivalent(envs.step(good), twin.step(good), exact=True)


def test_fuzzed_actions() -> None:
    envs, twin = native(4), native(4)
    envs.reset(seed=1)
    twin.reset(seed=1)
    rng = np.random.default_rng(0)
    poisons = [np.nan, np.inf, -np.inf, 1.000001, -3.0, 1e300]
    for action, _ in zip(actions(4), range(300), strict=False):
        fuzzed = action.astype(np.float64)
        fuzzed[rng.integers(4), rng.integers(2)] = poisons[rng.integers(len(poisons))]
        with pytest.raises(ValueError, match=r"actions\["):
            envs.step(fuzzed)
        assert equivalent(envs.step(action), twin.step(action), exact=True)


@pytest.mark.parametrize(
    ("arguments", "kind", "words"),
    [
        ({"num_envs": 0}, ValueError, "num_envs = 0: expected a whole number, at least 1"),
        ({"num_envs": 2.5}, TypeError, "num_envs = 2.5"),
        ({"threads": 0}, ValueError, "threads = 0: .* 1 to 1024"),
        ({"threads": -1}, ValueError, "threads = -1"),
        ({"threads": "all"}, TypeError, "threads|int"),
        ({"max_episode_steps": 0}, ValueError, "max_episode_steps = 0"),
        ({"max_episode_steps": 2**63}, ValueError, f"max_episode_steps = {2**63}: .*{2**63 - 1}"),
        ({"max_episode_steps": 7.0}, TypeError, "max_episode_steps = 7.0"),
        ({"threads": 2**70}, ValueError, f"threads = {2**70}: .* 1 to 1024"),
        ({"threads": 1.5}, TypeError, "threads = 1.5"),
        ({"autoreset_mode": "Sometimes"}, ValueError, "Sometimes"),
        ({"target": ["quadratic"] * 2}, ValueError, "target has 2 entries, expected one or 3"),
        ({"target": ["quadratic", "circle", "lissajous"]}, ValueError, "target = 'circle'"),
        ({"amplitude": [1.0, 2.0]}, ValueError, "amplitude has 2 entries"),
        ({"amplitude": [1.0, 2.0, -3.0]}, ValueError, "amplitude = -3"),
        ({"amplitude": [1.0, "x", 2.0]}, TypeError, "amplitude = 'x'"),
        ({"arm": [ArmParameters()] * 2}, ValueError, "arm has 2 entries"),
        (
            {"arm": [ArmParameters(), ArmParameters(compartments=5), ArmParameters()]},
            ValueError,
            "compartments = 5 .*one number for all",
        ),
        ({"actuator": "magic"}, ValueError, "actuator = 'magic'"),
        ({"render_mode": "human"}, ValueError, "render_mode = 'human'.*'rgb_array'"),
        ({"width": 5000}, ValueError, "width = 5000: expected a whole number from 16 to 4096"),
    ],
)
def test_bad_arguments_are_named(arguments: dict, kind: type[Exception], words: str) -> None:
    with pytest.raises(kind, match=words):
        OctoArmVectorEnv(**({"num_envs": 3} | arguments))


def test_bad_resets_are_refused_before_anything_changes() -> None:
    envs = native(2)
    with pytest.raises(ValueError, match="step of environment 0.*call reset first"):
        envs.step(np.zeros((2, 2)))
    envs.reset(seed=0)
    before = envs.snapshot()
    mask = np.array([True, False])
    for arguments, kind, words in [
        ({"seed": [1, 2, 3]}, ValueError, "seed has 3 entries, expected 2"),
        ({"seed": [1, "x"]}, TypeError, r"seed\[1\] = 'x'"),
        ({"seed": -1}, ValueError, "seed = -1"),
        ({"seed": 1.5}, TypeError, "seed = 1.5"),
        ({"options": {"phase": 2.0}}, ValueError, "phase = 2"),
        ({"options": {"angle": 2.0}}, ValueError, r"\['angle'\].*'phase' and 'reset_mask'"),
        ({"options": {"reset_mask": [True, False]}}, TypeError, "reset_mask.*not list"),
        ({"options": {"reset_mask": mask.astype(int)}}, TypeError, "reset_mask.*not dtype int64"),
        ({"options": {"reset_mask": mask[:1]}}, ValueError, r"reset_mask.*\(1,\), expected \(2,\)"),
        ({"options": {"reset_mask": ~mask & mask}}, ValueError, "no True"),
    ]:
        with pytest.raises(kind, match=words):
            envs.reset(**arguments)
    assert envs.snapshot() == before


def test_no_autoreset_wants_a_reset() -> None:
    envs = native(2, autoreset_mode="Disabled", max_episode_steps=3)
    envs.reset(seed=0)
    for _ in range(3):
        result = envs.step(np.zeros((2, 2), np.float32))
    assert result[3].all()
    with pytest.raises(ValueError, match="step of environment 0.*call reset first"):
        envs.step(np.zeros((2, 2), np.float32))
    options = {"reset_mask": np.array([True, False]), "phase": 0.5}
    _, infos = envs.reset(options=options)
    assert infos["_target"].tolist() == [True, False]
    assert set(options) == {"reset_mask", "phase"}
    with pytest.raises(ValueError, match="step of environment 1"):
        envs.step(np.zeros((2, 2), np.float32))


@pytest.mark.parametrize("disturbed", [{}, DISTURBED], ids=["quiet", "disturbed"])
@pytest.mark.parametrize("mode", MODES)
def test_saved_batches_go_on_with_the_same_bits(mode: AutoresetMode, disturbed: dict) -> None:
    options = {"max_episode_steps": 11, "target": ["lissajous"] * 9, "autoreset_mode": mode}
    options |= disturbed
    envs = native(9, **options)
    envs.reset(seed=2)
    for _ in steps(envs, 27):
        pass
    snapshot = envs.snapshot()
    twins = [pickle.loads(pickle.dumps(envs)), copy.deepcopy(envs), native(9, threads=1, **options)]
    twins[2].restore(pickle.loads(pickle.dumps(snapshot)))
    if mode == AutoresetMode.DISABLED:
        # What ended last waits for its reset; begin anew, with the generators where they were.
        assert all(equivalent(twin.reset(), envs.reset(), exact=True) for twin in twins[:1])
        envs.restore(snapshot)
        twins[0].restore(snapshot)
        starts = [one.reset() for one in (envs, *twins)]
        assert all(equivalent(start, starts[0], exact=True) for start in starts[1:])
    expected = list(steps(envs, 40, seed=8))
    for twin in twins:
        assert twin.metadata == envs.metadata
        assert twin.np_random_seed == envs.np_random_seed
        assert equivalent(list(steps(twin, 40, seed=8)), expected, exact=True)
    with pytest.raises(TypeError, match="VectorSnapshot"):
        envs.restore("snapshot")  # type: ignore[arg-type]
    before = envs.snapshot()
    with pytest.raises(ValueError, match=r"\(9,\), expected \(2,\)"):
        native(2).restore(snapshot)
    assert envs.snapshot() == before


def test_limits_beyond_32_bits() -> None:
    envs = native(1, max_episode_steps=2**40)
    envs.reset(seed=0)
    assert not any(step[3].any() for step in steps(envs, 5))


def test_every_copy_is_a_batch_of_its_own() -> None:
    envs = native(2)
    envs.reset(seed=3)
    twin = copy.copy(envs)
    twin.reset(seed=[8, None])
    twin.set_attr("label", "twin")
    assert envs.np_random_seed == (3, 4)
    assert twin.np_random_seed == (8, 4)
    with pytest.raises(AttributeError):
        envs.get_attr("label")
    assert twin.np_random is not envs.np_random


@pytest.mark.parametrize("render_mode", [None, "rgb_array"])
def test_snapshots_compare_and_hash(render_mode: str | None) -> None:
    envs = native(2, render_mode=render_mode)
    # Before the first reset, what draws the seeds belongs to the snapshot too.
    before = envs.snapshot()
    start = envs.reset()[0]
    envs.restore(before)
    assert np.array_equal(envs.reset()[0], start)
    one, two = envs.snapshot(), envs.snapshot()
    assert one == two
    assert len({one, two, before}) == 2
    for _ in steps(envs, 1):
        pass
    assert envs.snapshot() != one


def test_seeds_and_generators_are_those_of_single_environments() -> None:
    envs, single = native(2), OctoArmEnv()
    for seed in (2**64 - 1, 2**64 + 3):
        starts = envs.reset(seed=seed)[0]
        assert np.array_equal(starts, [single.reset(seed=seed + i)[0] for i in range(2)])
    starts = []
    for seed in (1, 2, 1):
        envs.np_random = np.random.default_rng(seed)
        starts.append(envs.reset()[0])
    assert np.array_equal(starts[0], starts[2])
    assert not np.array_equal(starts[0], starts[1])


def test_unseeded_batches_differ() -> None:
    starts = [native(4).reset()[0] for _ in range(2)]
    assert not np.array_equal(*starts)
    assert len(np.unique(starts[0], axis=0)) == 4
    envs = native(2)
    assert envs.np_random_seed == (None, None)
    envs.reset(seed=[7, None])
    assert envs.np_random_seed[0] == 7
    assert isinstance(envs.np_random_seed[1], int)


def test_teacher_earns_what_can_be_earned() -> None:
    targets = ["quadratic", "van_der_pol", "lissajous"]
    envs = native(3, target=targets)
    teacher = TeacherPolicy(envs)
    observations, _ = envs.reset(seed=0)
    total = np.zeros(3)
    for _ in range(500):
        action, _ = teacher.predict(observations)
        observations, rewards, _, _, infos = envs.step(action)
        assert (infos["tracking_error"] < 1e-4).all()
        total += rewards
    assert (total > 0.9995 * 500).all()
    assert np.array_equal(np.array(envs.call("teacher_action")), envs.teacher_actions())


def test_attributes_and_calls() -> None:
    envs, loop = native(3, amplitude=[10.0, 20.0, 30.0]), singles(1, MODES[0], amplitude=30.0)
    envs.reset(options={"phase": 0.3})
    loop.reset(options={"phase": 0.3})
    for name in (
        "action_range",
        "amplitude",
        "period",
        "orbit",
        "arm_positions",
        "arm_joints",
        "render_mode",
    ):
        assert equivalent(envs.get_attr(name)[2], loop.get_attr(name)[0], exact=True), name
        assert equivalent(envs.call_at([2], name), loop.call(name), exact=True), name
    assert equivalent(envs.call_at([2], "teacher_action"), loop.call("teacher_action"), exact=True)
    with pytest.warns(UserWarning, match="render_mode is None"):
        assert envs.call("render") == (None,) * 3
    envs.set_attr("label", ["a", "b", "c"])
    assert envs.get_attr("label") == ("a", "b", "c")
    with pytest.raises(AttributeError, match="no attribute 'colour'"):
        envs.get_attr("colour")
    with pytest.raises(ValueError, match="values has 2 entries, expected 3"):
        envs.set_attr("label", [1, 2])
    assert "num_envs=3" in repr(envs)
    envs.close()
    envs.close()


OWN = {
    "target": "lissajous",
    "amplitude": [5.0, 6.0],
    "control_period": 0.02,
    "actuator": "servo",
    "arm": {"arm_density": 1042.0},
    "action_range": 5.0,
    "tracking_weight": 2.0,
    "reward_width": 0.1,
    "action_change_weight": 0.0,
    "length_noise": 1e-5,
    "action_noise": 1.0,
    "delay": 1,
    "dropout": 1,
    "vary": {"arm_density": (0.9, 1.1)},
    "bodies": 1,
    "body_seed": 1,
    "render_mode": "rgb_array",
    "width": 32,
    "height": 32,
    "camera": "top",
    "overlay": False,
    "max_episode_steps": 7,
    "autoreset_mode": AutoresetMode.DISABLED,
    "threads": 2,
    "num_envs": 3,
}
"""A value for every argument that is not the default's."""


def test_setting_an_argument_is_an_error_that_names_the_remedy() -> None:
    """It was accepted, confirmed by get_attr, and changed nothing."""
    envs, loop = native(2), singles(2, MODES[0])
    assert set(OWN) == set(inspect.signature(OctoArmVectorEnv).parameters)
    for name, value in OWN.items():
        remedy = re.escape(f'gym.make_vec("OctoArm-v0", ..., {name}=...)')
        for values in (value, [value] * 2):
            with pytest.raises(AttributeError, match=f"{name} .*cannot be changed.*{remedy}"):
                envs.set_attr(name, values)
        with pytest.raises(AttributeError, match=f"{name} .*cannot be changed.*{remedy}"):
            setattr(envs, name, value)
        if name in inspect.signature(OctoArmEnv).parameters:
            with pytest.raises(AttributeError, match=f"{name}.* (cannot be changed|has no setter)"):
                loop.set_attr(name, [value] * 2)
    # What only looks like the environments' own, such as the attribute of Gymnasium's time limit.
    for name in ("observation_space", "action_space", "_max_episode_steps", "reset", "spec"):
        with pytest.raises(AttributeError, match=f"{name} .*cannot be changed"):
            envs.set_attr(name, None)


def test_specs_are_those_of_the_single_environments() -> None:
    targets = ["quadratic", np.eye(4)[:, :2].tolist(), "lissajous"]
    arms = [ArmParameters(arm_density=1042.0), "nakajima2013", {"arm_density": 1000.0}]
    shared = {"max_episode_steps": 7, "camera": Camera(zoom=2.0), "reward_width": np.float32(0.2)}
    envs = native(
        3, target=targets, arm=arms, amplitude=np.full(3, 5.0), autoreset_mode=MODES[1], **shared
    )
    found = envs.get_attr("spec")
    for index, (target, arm) in enumerate(zip(targets, arms, strict=True)):
        one = gym.make("OctoArm-v0", target=target, arm=arm, amplitude=5.0, **shared)
        assert found[index] == one.spec
        assert found[index].max_episode_steps == 7
    assert envs.spec.max_episode_steps == 7
    assert native(1, max_episode_steps=-1).get_attr("spec")[0].max_episode_steps is None
    assert OctoArmVectorEnv(2).get_attr("spec") == (None, None)


def test_a_batch_survives_json() -> None:
    square = np.array([[0.0, 1], [1, 0], [0, -1], [-1, 0]])
    for options in (
        {
            "target": [square, "lissajous"],
            "arm": [ArmParameters(), ArmParameters(gravity=(0, 0, 9))],
        },
        {"target": square, "camera": Camera(zoom=2.0), "arm": ArmParameters(arm_density=1042.0)},
        {"amplitude": np.array([5.0, 6.0]), "autoreset_mode": MODES[1], "threads": np.int64(1)},
    ):
        envs = native(2, **options)
        again = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))
        assert again.spec == envs.spec
        assert again.autoreset_mode is envs.autoreset_mode
        assert equivalent(again.reset(seed=1), envs.reset(seed=1), exact=True)
        action = next(actions(2))
        assert equivalent(again.step(action), envs.step(action), exact=True)


def test_sequences_and_mappings_of_any_kind() -> None:
    """Such as those of OmegaConf, which are no lists and dictionaries."""
    square = UserList([UserList([0.0, 1]), UserList([1, 0]), UserList([0, -1]), UserList([-1, 0])])
    body = UserDict(arm_density=1042.0, gravity=UserList([0, 0, 9.0]))
    envs = native(
        2,
        target=UserList([square, "lissajous"]),
        arm=UserList([body, "nakajima2013"]),
        amplitude=UserList([5.0, None]),
        camera=UserDict(zoom=2.0),
    )
    plain = native(
        2,
        target=[[list(row) for row in square], "lissajous"],
        arm=[ArmParameters(arm_density=1042.0, gravity=(0, 0, 9.0)), "nakajima2013"],
        amplitude=[5.0, None],
    )
    assert equivalent(envs.reset(seed=1), plain.reset(seed=1), exact=True)
    gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))


def test_bodies_that_swing_side_by_side_begin_as_each_alone() -> None:
    # More than fit into one group of lanes, and than are kept: the first ones are made anew below.
    settings = [
        {
            "target": ("quadratic", "lissajous")[index % 2],
            "amplitude": 20.0 + index,
            "arm": {"arm_density": 1042.0 + index},
        }
        for index in range(11)
    ]
    given = {name: [each[name] for each in settings] for name in settings[0]}
    envs = native(11, **given)
    observations, infos = envs.reset(seed=5)
    for index in (0, 1, 10):
        env = OctoArmEnv(**settings[index])
        observation, info = env.reset(seed=5 + index)
        assert observation.tobytes() == observations[index].tobytes()
        assert info["target"].tobytes() == infos["target"][index].tobytes()
    given["arm"][9], given["amplitude"][9] = "inertial", 90.0
    with pytest.raises(ValueError, match=r"amplitude = 90 .*that this body can be swung along"):
        native(11, **given)


def test_registration() -> None:
    envs = native(2)
    assert envs.spec.max_episode_steps == 500
    assert envs.threads == (
        os.process_cpu_count() if sys.version_info >= (3, 13) else len(os.sched_getaffinity(0))
    )
    assert isinstance(gym.make_vec("octoarm_env:OctoArm-v0", num_envs=2), OctoArmVectorEnv)
    again = gym.make_vec(envs.spec)
    assert again.num_envs == 2
    envs = native(2, max_episode_steps=-1)
    envs.reset(seed=0)
    for _ in range(600):
        assert not envs.step(np.zeros((2, 2), np.float32))[3].any()


def test_works_under_gymnasium_s_wrappers() -> None:
    envs = gym.wrappers.vector.RecordEpisodeStatistics(native(4, max_episode_steps=10))
    envs = gym.wrappers.vector.RescaleObservation(envs, -1.0, 1.0)
    observations, _ = envs.reset(seed=0)
    assert (np.abs(observations) <= 1.0).all()
    lengths = []
    for action, _ in zip(actions(4), range(25), strict=False):
        infos = envs.step(action)[4]
        if "episode" in infos:
            lengths += infos["episode"]["l"].tolist()
    assert lengths == [10] * 8


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1]) * os.sysconf(
        "SC_PAGE_SIZE"
    )


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_many_resets_leak_nothing() -> None:
    envs = native(64)
    envs.reset(seed=0)

    def resets(count: int) -> None:
        for _ in range(count // 64):
            envs.reset()

    resets(20_000)
    gc.collect()
    before = resident_bytes()
    resets(200_000)
    gc.collect()
    # An allocation takes at least 16 bytes: one that leaks at every reset would show. The
    # allocator itself moves by some pages.
    assert resident_bytes() - before < 1_000_000


def test_digest_is_that_of_the_single_environments() -> None:
    """The hash of a whole run, as a check that the comparison above compares something."""
    digests = []
    for envs in (native(3, max_episode_steps=20), singles(3, MODES[0], max_episode_steps=20)):
        digest = hashlib.sha256(envs.reset(seed=4)[0].tobytes())
        for result in steps(envs, 60):
            digest.update(result[0].tobytes())
        digests.append(digest.hexdigest())
    assert digests[0] == digests[1]
    assert digests[0] != hashlib.sha256().hexdigest()
