"""OctoArm-v0 as Gymnasium and stable-baselines3 see it."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import json
import pickle
import re
from collections import UserDict, UserList
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_checker import data_equivalence as equivalent
from gymnasium.wrappers import RescaleAction

import octoarm_env
from octoarm_env import ArmParameters, EpisodeSettings, OctoArmEnv, TeacherPolicy, _core
from octoarm_env.rendering.camera import Camera

TARGETS = ["quadratic", "van_der_pol", "lissajous"]


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("actuator", ["servo", "direct"])
def test_gymnasium_s_checker(target: str, actuator: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")  # it opens windows
    check_env(gym.make("OctoArm-v0", target=target, actuator=actuator).unwrapped)


def test_stable_baselines3_s_checker() -> None:
    from stable_baselines3.common.env_checker import check_env as check

    check(gym.make("OctoArm-v0"), warn=True)


def test_registration() -> None:
    env = gym.make("octoarm_env:OctoArm-v0")
    assert isinstance(env.unwrapped, OctoArmEnv)
    assert env.spec is not None
    assert env.spec.max_episode_steps == 500
    assert env.action_space == gym.spaces.Box(-1, 1, (2,), np.float32)
    assert env.observation_space == gym.spaces.Box(0.001, 0.06, (80,), np.float64)
    env.reset(seed=0)
    for step in range(1, 501):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        assert not terminated
        assert truncated == (step == 500)


@pytest.mark.parametrize("target", TARGETS)
def test_the_teacher_earns_what_can_be_earned(target: str) -> None:
    env = gym.make("OctoArm-v0", target=target)
    teacher = TeacherPolicy(env)
    observation, info = env.reset(seed=1)
    assert info["tracking_error"] < 1e-9
    total = 0.0
    for _ in range(500):
        action, _ = teacher.predict(observation)
        observation, reward, terminated, _, info = env.step(action)
        assert not terminated
        # Actions are float32: 1e-7 of 26 degrees.
        assert info["tracking_error"] < 1e-4
        assert reward == info["reward_tracking"] + info["reward_action_change"]
        total += float(reward)
    # The whole of the loss is the cost of moving.
    assert total > 0.9995 * 500


def test_same_seed_same_bits() -> None:
    def trace(seed: int) -> list:
        env = gym.make("OctoArm-v0")
        env.action_space.seed(seed)
        rows = [env.reset(seed=seed)]
        rows += [env.step(env.action_space.sample()) for _ in range(50)]
        rows.append(env.reset())
        return rows

    assert equivalent(trace(3), trace(3), exact=True)
    assert not equivalent(trace(3)[0], trace(4)[0], exact=True)


def test_unseeded_environments_differ() -> None:
    starts = [tuple(gym.make("OctoArm-v0").reset()[1]["target"]) for _ in range(6)]
    assert len(set(starts)) > 1


def test_reset_begins_on_the_orbit_at_every_phase() -> None:
    env = OctoArmEnv(target="lissajous", amplitude=15.0)
    seen = []
    for seed in range(60):
        observation, info = env.reset(seed=seed)
        assert observation in env.observation_space
        assert info["tracking_error"] < 1e-9
        np.testing.assert_allclose(info["base_angles"], info["target"], atol=1e-9)
        seen.append(info["target"])
    quadrants = {(theta > 0, phi > 0) for theta, phi in seen}
    assert len(quadrants) == 4
    _, info = env.reset(options={"phase": 0.25})
    np.testing.assert_allclose(info["target"], [0.0, 15.0], atol=1.0)


def test_targets_and_arguments() -> None:
    env = OctoArmEnv()
    assert env.amplitude == pytest.approx(90.0)
    assert env.action_range == pytest.approx(117.0)
    assert np.abs(env.orbit).max() == pytest.approx(90.0)
    assert OctoArmEnv(target="van_der_pol").amplitude == pytest.approx(130.0)
    assert OctoArmEnv(target="lissajous").amplitude == pytest.approx(10.0)
    turn = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    circle = 12.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    env = OctoArmEnv(target=circle, action_range=30.0)
    assert env.amplitude == pytest.approx(12.0)
    assert env.period == pytest.approx(0.4)
    _, info = env.reset(seed=0)
    assert np.hypot(*info["target"]) == pytest.approx(12.0, abs=1e-6)
    assert OctoArmEnv(target=circle, amplitude=6.0).amplitude == pytest.approx(6.0)
    short = OctoArmEnv(arm=ArmParameters(compartments=5))
    assert short.observation_space.shape == (20,)
    assert short.reset(seed=0)[0].shape == (20,)


@pytest.mark.parametrize(
    ("arguments", "kind", "words"),
    [
        ({"target": "circle"}, ValueError, "target = 'circle'.*quadratic"),
        ({"target": np.zeros((5, 3))}, ValueError, r"target has shape \(5, 3\)"),
        ({"target": np.zeros((50, 2))}, ValueError, "all zeros"),
        ({"target": [[0.0, np.nan]] * 9}, ValueError, "finite"),
        ({"target": np.array([["a", "b"]])}, TypeError, "target"),
        ({"target": np.ones((2, 2))}, ValueError, r"target has shape \(2, 2\)"),
        ({"amplitude": -1.0}, ValueError, r"amplitude = -1 .*\(0, 360\]"),
        ({"amplitude": "big"}, TypeError, "amplitude"),
        ({"amplitude": np.nan}, ValueError, "amplitude = nan"),
        ({"amplitude": 10**400}, ValueError, "amplitude = inf"),
        ({"amplitude": np.ones(2)}, TypeError, r"amplitude = array\(\[1., 1.\]\)"),
        ({"amplitude": np.True_}, TypeError, "amplitude = .*True"),
        ({"amplitude": 300.0, "arm": "inertial"}, ValueError, "amplitude = 300.*left its domain"),
        ({"control_period": 0.0015}, ValueError, "control_period = 0.0015.*multiples"),
        ({"actuator": "magic"}, ValueError, "actuator = 'magic'"),
        ({"arm": {"timestep": 1.0}}, ValueError, "timestep = 1"),
        ({"arm": 3.0}, TypeError, "ArmParameters"),
        ({"action_range": 0.0}, ValueError, "action_range = 0"),
        ({"reward_width": np.inf}, ValueError, "reward_width = inf"),
        ({"tracking_weight": -2}, ValueError, "tracking_weight = -2"),
        ({"action_change_weight": None}, TypeError, "action_change_weight"),
        ({"length_noise": -1e-6}, ValueError, r"length_noise = -0.000001 .*\[0, 1\]"),
        ({"length_noise": None}, TypeError, "length_noise"),
        ({"action_noise": 91}, ValueError, r"action_noise = 91 .*\[0, 90\]"),
        ({"delay": 1.0}, TypeError, "delay = 1.0: expected a whole number"),
        ({"delay": -1}, ValueError, "delay = -1: expected a whole number, at least 0"),
        ({"delay": 1001}, ValueError, r"delay = 1001 .*\[0, 1000\]"),
        ({"dropout": 81}, ValueError, r"dropout = 81 .*\[0, 80\]"),
        ({"dropout": True}, TypeError, "dropout = True: expected a whole number"),
        ({"render_mode": "ansi"}, ValueError, "render_mode = 'ansi'.*'human', 'rgb_array'"),
        ({"width": 15}, ValueError, "width = 15: expected a whole number from 16 to 4096"),
        ({"height": 480.0}, TypeError, "height = 480.0: expected a whole number"),
        ({"camera": "moon"}, ValueError, "camera = 'moon'.*'perspective'"),
        ({"camera": 3}, TypeError, "camera = 3"),
        ({"overlay": "no"}, TypeError, "overlay = 'no'"),
        ({"colour": 3}, TypeError, "colour"),
        (
            {"target": [[20.0, 0.0], [0.0, 20.0], [-20.0, 0.0], [0.0, -20.0]], "arm": "inertial"},
            ValueError,
            "target = 4 rows of up to 20 degrees, one a physics step of 0.001 s, so a period",
        ),
    ],
)
def test_bad_arguments_are_named(arguments: dict, kind: type[Exception], words: str) -> None:
    with pytest.raises(kind, match=words):
        OctoArmEnv(**arguments)


@pytest.mark.parametrize(
    ("action", "kind", "words"),
    [
        (np.array([np.nan, 0.0]), ValueError, r"action\[0\] = NaN"),
        (np.array([0.0, np.inf], np.float32), ValueError, r"action\[1\] = inf"),
        (np.array([0.0, 1.5]), ValueError, r"action\[1\] = 1.5 .*\[-1, 1\]"),
        (np.array([0.0, 1.000002]), ValueError, r"action\[1\] = 1.000002 .*\[-1, 1\]"),
        (np.zeros(3), ValueError, r"action has shape \(3,\)"),
        (np.zeros((1, 2)), ValueError, r"action has shape \(1, 2\)"),
        (0.5, ValueError, "action has shape"),
        (None, TypeError, "action"),
        ("no", TypeError, "action"),
        (np.zeros(2, complex), TypeError, "action"),
    ],
)
def test_bad_actions_are_refused_and_change_nothing(action, kind, words) -> None:
    env, twin = OctoArmEnv(), OctoArmEnv()
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(kind, match=words):
        env.step(action)
    good = np.array([0.3, -0.4])
    assert equivalent(env.step(good), twin.step(good), exact=True)


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        (5, TypeError, "options must be a mapping, not int"),
        ({"phase": "early"}, TypeError, r"options\['phase'\] = 'early'"),
        ({"phase": 1.5}, ValueError, "phase = 1.5"),
        ({"turn": 0.5}, ValueError, r"unknown reset options \['turn'\]"),
    ],
)
def test_bad_options_are_refused(options, kind, words) -> None:
    with pytest.raises(kind, match=words):
        OctoArmEnv().reset(seed=0, options=options)


def test_order_of_calls() -> None:
    env = OctoArmEnv()
    with pytest.raises(ValueError, match="reset"):
        env.step(np.zeros(2))
    for options in ({"phase": 2.0}, {"phase": np.nan}, {"angle": 1.0}):
        with pytest.raises(ValueError, match="phase"):
            env.reset(options=options)
    with pytest.raises(TypeError, match="phase"):
        env.reset(options={"phase": "x"})


def test_integer_and_list_actions_are_actions() -> None:
    env, twin = OctoArmEnv(), OctoArmEnv()
    env.reset(seed=0)
    twin.reset(seed=0)
    assert equivalent(env.step([1, 0]), twin.step(np.array([1.0, 0.0], np.float32)), exact=True)


def test_pickle_and_deepcopy_go_on_with_the_same_bits() -> None:
    env = gym.make("OctoArm-v0", target="van_der_pol")
    env.reset(seed=9)
    for _ in range(25):
        env.step(np.array([0.2, 0.6], np.float32))
    twins = [pickle.loads(pickle.dumps(env)), copy.deepcopy(env)]
    action = np.array([-0.7, 0.1], np.float32)
    expected = [env.step(action) for _ in range(30)] + [env.reset(), env.step(action)]
    for twin in twins:
        got = [twin.step(action) for _ in range(30)] + [twin.reset(), twin.step(action)]
        assert equivalent(got, expected, exact=True)


@pytest.mark.filterwarnings("ignore:.*precision lowered by casting:UserWarning")
def test_rounding_past_a_bound_is_clipped() -> None:
    """Wrappers that scale actions round in single precision."""
    wrapped = RescaleAction(OctoArmEnv(), -5.0, 3.2)
    twin = OctoArmEnv()
    wrapped.reset(seed=1)
    twin.reset(seed=1)
    scaled = wrapped.action(wrapped.action_space.high)
    assert scaled[0] > 1.0
    one = twin.step(np.ones(2, np.float32))
    assert equivalent(wrapped.step(wrapped.action_space.high), one, exact=True)
    assert _core.check_step(scaled, True).tolist() == [1.0, 1.0]


def test_every_copy_is_an_environment_of_its_own() -> None:
    env = OctoArmEnv()
    env.reset(seed=3)
    twin = copy.copy(env)
    twin.action_space.seed(1)
    twin.np_random.random()
    assert env.np_random.bit_generator.state != twin.np_random.bit_generator.state
    twin.step(np.zeros(2))
    expected = OctoArmEnv()
    expected.reset(seed=3)
    action = np.full(2, 0.5)
    assert equivalent(env.step(action), expected.step(action), exact=True)


def test_every_seed_counts() -> None:
    env = OctoArmEnv()
    seeds = [5, 2**64 + 5, 2**65 + 5, 2**64 - 1]
    starts = [[env.reset(seed=seed)[0], env.reset()[0], env.reset()[0]] for seed in seeds]
    assert len({np.array(start).tobytes() for start in starts}) == len(seeds)


def test_an_assigned_generator_draws_the_next_seed() -> None:
    env = OctoArmEnv()
    env.reset(seed=0)
    starts = []
    for seed in (1, 2, 1):
        env.np_random = np.random.default_rng(seed)
        assert env.np_random_seed == -1
        starts.append(np.array([env.reset()[0], env.reset()[0]]))
    assert np.array_equal(starts[0], starts[2])
    assert not np.array_equal(starts[0], starts[1])


@pytest.mark.parametrize("steps", [2_000, pytest.param(20_000, marks=pytest.mark.long)])
def test_observations_are_fresh_and_in_bounds(steps: int) -> None:
    env = OctoArmEnv()
    env.action_space.seed(0)
    first, _ = env.reset(seed=0)
    kept = first.copy()
    rng = np.random.default_rng(0)
    for step in range(steps):
        bang = 1.0 if (step // 18) % 2 == 0 else -1.0
        action = rng.uniform(-1, 1, 2) if step < steps // 2 else np.array([bang, -bang])
        observation, reward, terminated, _, _ = env.step(action)
        assert not terminated
        assert np.isfinite(reward)
        assert -0.08 <= reward <= 1.0
        assert observation in env.observation_space
    assert np.array_equal(first, kept)


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vector_environments_of_gymnasium(mode: str) -> None:
    envs = gym.make_vec("OctoArm-v0", num_envs=2, vectorization_mode=mode, target="lissajous")
    try:
        teacher = TeacherPolicy(envs)
        observations, _ = envs.reset(seed=5)
        single = gym.make("OctoArm-v0", target="lissajous")
        observation, _ = single.reset(seed=6)
        for _ in range(20):
            assert np.array_equal(observations[1], observation)
            actions, _ = teacher.predict(observations)
            assert actions.shape == (2, 2)
            observations, rewards, _, _, infos = envs.step(actions)
            observation, reward, _, _, info = single.step(actions[1])
            assert rewards[1] == reward
            assert infos["tracking_error"][1] == info["tracking_error"]
    finally:
        envs.close()


def test_termination_reports_the_failure() -> None:
    env = gym.make("OctoArm-v0", arm="inertial", amplitude=20.0, control_period=0.001)
    env.reset(seed=0)
    for step in range(1000):
        sign = 1.0 if step % 2 else -1.0
        observation, _, terminated, _, info = env.step(np.array([sign, sign], np.float32))
        if terminated:
            break
    assert terminated
    assert "compartment" in info["failure"]
    assert info["reward_tracking"] == 0.0
    assert observation in env.observation_space
    _, info = env.reset()
    assert "failure" not in info


def test_teacher_wants_this_environment() -> None:
    with pytest.raises(TypeError, match="OctoArm-v0"):
        TeacherPolicy(gym.make("CartPole-v1"))


def test_settings_are_what_the_environment_was_made_with() -> None:
    samples = 5.0 * np.stack([np.sin(np.arange(700) / 111), np.cos(np.arange(700) / 111)], 1)
    env = OctoArmEnv(samples, arm={"compartments": 4}, reward_width=1, action_range=9)
    settings = env.settings
    assert settings.arm == ArmParameters(compartments=4)
    assert (settings.amplitude, settings.action_range, settings.reward_width) == (None, 9.0, 1.0)
    np.testing.assert_array_equal(settings.target, samples)
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.reward_width = 2.0
    assert EpisodeSettings.from_dict(json.loads(json.dumps(settings.to_dict()))) == settings
    assert EpisodeSettings.from_dict({}) == OctoArmEnv().settings == EpisodeSettings()
    again = gym.make("OctoArm-v0", **settings.to_dict()).unwrapped
    assert again.settings == settings
    assert hash(again.settings) == hash(settings)
    observations = [each.reset(seed=3)[0] for each in (env, again)]
    np.testing.assert_array_equal(*observations)
    assert pickle.loads(pickle.dumps(env)).settings == settings

    envs = gym.make_vec("OctoArm-v0", num_envs=2, target=["lissajous", "quadratic"])
    assert [each.target for each in envs.settings] == ["lissajous", "quadratic"]
    with pytest.raises(ValueError, match=r"unknown settings \['colour'\]; known are"):
        EpisodeSettings.from_dict({"colour": 1})


def test_defaults_are_those_of_the_episode_itself() -> None:
    ours = json.loads(OctoArmEnv()._core.config)
    assert ours == json.loads(_core.Episode("{}").config)


def test_the_docstring_tells_every_argument() -> None:
    text = inspect.getdoc(OctoArmEnv) or ""
    for name in inspect.signature(OctoArmEnv.__init__).parameters:
        if name != "self":
            assert f"| `{name}`" in text
    assert octoarm_env.__version__.count(".") == 2


def test_setting_an_argument_is_an_error_that_names_the_remedy() -> None:
    """It was accepted and changed nothing."""
    env = gym.make("OctoArm-v0")
    for name in inspect.signature(OctoArmEnv).parameters:
        remedy = re.escape(f'gym.make("OctoArm-v0", {name}=...)')
        with pytest.raises(AttributeError, match=f"{name} .*cannot be changed.*{remedy}"):
            setattr(env.unwrapped, name, "other")
        # As vector environments and adapters set attributes, through every wrapper.
        with pytest.raises(AttributeError, match=f"{name}.* (cannot be changed|has no setter)"):
            env.set_wrapper_attr(name, "other")
    env.unwrapped.label = "own"
    env.set_wrapper_attr("label", "other")
    assert env.unwrapped.label == "other"


def test_a_class_below_may_declare_an_argument_s_name() -> None:
    class Own(OctoArmEnv):
        arm: str | None = None

        def __init__(self, **options: Any) -> None:
            super().__init__(**options)
            self.arm, self.note = "own", 1

    env = Own()
    assert (env.arm, env.note) == ("own", 1)
    with pytest.raises(AttributeError, match="target of an environment cannot be changed"):
        env.target = "lissajous"
    copied = pickle.loads(pickle.dumps(OctoArmEnv(render_mode="rgb_array")))
    assert copied.render_mode == "rgb_array"


@pytest.mark.parametrize(
    "options",
    [
        {"arm": ArmParameters(arm_density=1042.0, gravity=(0.0, 1.0, 9.0))},
        {"arm": {"gravity": np.array([0.0, 1.0, 9.0])}},
        {"target": np.array([[0.0, 1], [1, 0], [0, -1], [-1, 0.1]])},
        {"target": ((0, 1), (1, 0), (0, -1), (-1, 0))},
        {"camera": Camera(zoom=2.0), "overlay": np.bool_(False), "width": np.int64(64)},
        {"amplitude": np.float32(9.1), "reward_width": np.float64(0.1)},
    ],
)
def test_arguments_survive_json(options: dict[str, Any]) -> None:
    env = gym.make("OctoArm-v0", max_episode_steps=7, **options)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.spec == env.spec
    assert again.unwrapped._core.config == env.unwrapped._core.config
    assert again.unwrapped._pictures._camera == env.unwrapped._pictures._camera


def test_a_body_s_file_survives_json(tmp_path: Path) -> None:
    ArmParameters(arm_density=1042.0).to_json(tmp_path / "arm.json")
    env = gym.make("OctoArm-v0", arm=tmp_path / "arm.json")
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped._core.config == env.unwrapped._core.config


def test_sequences_and_mappings_of_any_kind() -> None:
    """Such as those of OmegaConf, which are no lists and dictionaries."""
    rows = [[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.1]]
    env = gym.make(
        "OctoArm-v0",
        target=UserList(UserList(row) for row in rows),
        arm=UserDict(gravity=UserList([0, 0, 9.0])),
        camera=UserDict(zoom=2.0),
    )
    plain = OctoArmEnv(target=rows, arm=ArmParameters(gravity=(0, 0, 9.0)))
    assert env.unwrapped._core.config == plain._core.config
    with pytest.raises(ValueError, match=r"camera has unknown fields \['zom'\]"):
        OctoArmEnv(camera={"zom": 2.0})
    with pytest.raises(ValueError, match="zoom = 99"):
        OctoArmEnv(camera={"zoom": 99})


def test_numbers_in_the_info_are_numpy_s() -> None:
    """Readers of infos, torchrl's for one, ask every entry for its dtype."""
    env = gym.make("OctoArm-v0")
    for info in (env.reset(seed=0)[1], env.step(np.zeros(2, np.float32))[4]):
        assert {name: value.dtype for name, value in info.items()} == dict.fromkeys(
            ("base_angles", "target", "tracking_error", "reward_tracking", "reward_action_change"),
            np.dtype(np.float64),
        ) | {"body": np.dtype(np.int64)}
