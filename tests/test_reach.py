"""``OctoArmReach-v0``: alone, many at once, what it earns, what it refuses."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from octoarm_env import Arm, ArmParameters
from octoarm_env.reach import (
    OctoArmReachEnv,
    OctoArmReachVectorEnv,
    ReachSettings,
    reachable_goals,
)
from octoarm_env.testing import check_vector_env

LENGTH = 20 * 0.02


def actions(count: int, seed: int = 0, muscles: int = 25) -> Any:
    return np.random.default_rng(seed).random((count, muscles), np.float32)


def only(side: int, active: float = 1.0) -> Any:
    action = np.zeros((5, 5), np.float32)
    action[:, side] = active
    return action.ravel()


def test_gymnasium_checks_it() -> None:
    check_env(gym.make("OctoArmReach-v0", render_mode="rgb_array").unwrapped)


@pytest.mark.parametrize("rates", [False, True])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_batch_is_the_single_one_to_the_bit(mode: AutoresetMode, rates: bool) -> None:
    arguments: dict[str, Any] = {
        "reward_type": "dense",
        "length_noise": 1e-5,
        "delay": 1,
        "dropout": 3,
        "observe_rates": rates,
        "bodies": 2,
        "vary": {"longitudinal_stiffness": (0.8, 1.2)},
    }
    batch = OctoArmReachVectorEnv(
        3, **arguments, max_episode_steps=4, autoreset_mode=mode, threads=2
    )
    make = lambda: gym.make("OctoArmReach-v0", **arguments, max_episode_steps=4)  # noqa: E731
    check_vector_env(batch, make, steps=12)


def test_threads_and_neighbours_change_nothing() -> None:
    few, many = OctoArmReachVectorEnv(1, threads=1), OctoArmReachVectorEnv(11, threads=3)
    few.reset(seed=4)
    many.reset(seed=4)
    moves = actions(5 * 11).reshape(5, 11, 25)
    for each in moves:
        alone, *_ = few.step(each[:1])
        beside, *_ = many.step(each)
    for key, value in alone.items():
        np.testing.assert_array_equal(value[0], beside[key][0])


def test_muscles_shorten_their_side_and_bend_the_arm_there() -> None:
    env = OctoArmReachEnv()
    for side, (x, y) in enumerate([(1, 0), (0, 1), (-1, 0), (0, -1)]):
        seen, _ = env.reset(seed=0)
        for _ in range(40):
            seen, *_ = env.step(only(side))
        lengths = seen["observation"].reshape(20, 4)
        assert (lengths[:, side] < lengths[:, (side + 2) % 4]).all()
        assert seen["achieved_goal"][:2] @ (x, y) > 0.1


def test_transverse_muscles_thin_and_lengthen_the_arm() -> None:
    env = OctoArmReachEnv()
    rest = env.reset(seed=0)[0]["achieved_goal"][2]
    radius = np.linalg.norm(env.arm_joints[10] - env.arm_positions[10], axis=1).mean()
    for _ in range(40):
        seen, *_ = env.step(only(4))
    assert seen["achieved_goal"][2] > rest + 0.005
    thin = np.linalg.norm(env.arm_joints[10] - env.arm_positions[10], axis=1).mean()
    assert thin < radius


def test_activation_is_of_first_order() -> None:
    env = OctoArmReachEnv(activation_time=0.2, control_period=0.05, segments=2)
    env.reset(seed=0)
    action = actions(1, muscles=10)[0]
    env.step(action)
    wanted = action.reshape(2, 5) * (1 - np.exp(-0.05 / 0.2))
    np.testing.assert_allclose(env.activations, wanted, rtol=1e-12)


def test_it_is_the_arm_with_these_muscle_forces() -> None:
    """Against `Arm` with forces set by hand, step for step."""
    env = OctoArmReachEnv(segments=3, max_force=0.7, activation_time=0.05, control_period=0.01)
    seen, _ = env.reset(seed=0)
    arm = Arm()
    parameters = ArmParameters()
    radii = np.linspace(parameters.base_radius, parameters.tip_radius, 21)
    forces = 0.7 * ((radii[:-1] + radii[1:]) / 2 / radii[0]) ** 2
    segment = np.arange(20) * 3 // 20
    active = np.zeros((3, 5))
    for action in actions(5, muscles=15).reshape(-1, 3, 5):
        seen, *_ = env.step(action.ravel())
        for _ in range(10):
            active += (1 - np.exp(-0.001 / 0.05)) * (action - active)
            pull = -forces[:, None] * active[segment]
            arm.muscles = pull[:, :4], np.repeat(pull[:, 4:], 4, axis=1)
            lengths = arm.step(0.0, 0.0)
    np.testing.assert_allclose(seen["observation"], lengths, atol=1e-13)
    np.testing.assert_allclose(seen["achieved_goal"], arm.positions[-1], atol=1e-12)


def test_volume_is_kept_where_muscles_work() -> None:
    """Eqs. 7 and 8 push where a compartment is too small: without them the volume errs more."""

    def worst(gain: float) -> float:
        body = ArmParameters().replace(longitudinal_volume_gain=gain, transverse_volume_gain=gain)
        env = OctoArmReachEnv(arm=body)
        env.reset(seed=0)
        rest = _volumes(env)
        for _ in range(60):
            env.step(only(4))
        return float(np.abs(_volumes(env) / rest - 1).max())

    assert worst(1e6) < 0.11
    assert worst(1e6) < worst(0.0)


def _volumes(env: OctoArmReachEnv) -> Any:
    """Of the cones between the planes [m³]."""
    joints, centres = env.arm_joints, env.arm_positions
    radii = np.linalg.norm(joints - centres[:, None], axis=2).mean(axis=1)
    heights = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    low, high = radii[:-1], radii[1:]
    return np.pi * heights / 3 * (low**2 + low * high + high**2)


def test_slack_muscles_leave_the_arm_at_rest() -> None:
    env = OctoArmReachEnv()
    first, _ = env.reset(seed=0)
    for _ in range(40):
        seen, *_ = env.step(np.zeros(25, np.float32))
    np.testing.assert_allclose(seen["observation"], first["observation"], atol=1e-9)


@pytest.mark.parametrize("period", [1, 3, 10])
def test_bang_bang_actions_do_not_break_it(period: int) -> None:
    """Switched every so many steps of 50 ms."""
    envs = OctoArmReachVectorEnv(16, max_episode_steps=None)
    envs.reset(seed=0)
    generator = np.random.default_rng(period)
    for _ in range(60 // period):
        action = generator.integers(0, 2, (16, 25)).astype(np.float32)
        for _ in range(period):
            seen, rewards, terminated, *_ = envs.step(action)
            assert not terminated.any()
    assert np.isfinite(seen["observation"]).all()
    assert np.isfinite(rewards).all()
    assert envs.observation_space.contains(seen)


@pytest.mark.long
def test_400_000_random_and_bang_bang_steps() -> None:
    envs = OctoArmReachVectorEnv(256, max_episode_steps=None)
    envs.reset(seed=0)
    generator = np.random.default_rng(0)
    hold = generator.integers(1, 12, 256)
    action = generator.random((256, 25), np.float32)
    for step in range(1563):
        new = generator.random((256, 25), np.float32)
        new[::2] = new[::2] > 0.5
        action = np.where((step % hold == 0)[:, None], new, action)
        seen, _, terminated, _, _ = envs.step(action)
        assert not terminated.any()
    assert all(np.isfinite(value).all() for value in seen.values())


@pytest.mark.parametrize("kind", ["sparse", "dense"])
def test_rewards_are_those_of_the_goals(kind: Any) -> None:
    env = OctoArmReachEnv(kind, distance_threshold=0.05)
    seen, info = env.reset(seed=0, options={"goal": (0.0, 0.0, 0.36)})
    np.testing.assert_array_equal(seen["desired_goal"], (0.0, 0.0, 0.36))
    assert info["is_success"]
    for action in actions(5):
        seen, reward, *_, info = env.step(action)
        distance = np.linalg.norm(seen["achieved_goal"] - seen["desired_goal"])
        assert info["distance"] == pytest.approx(distance, abs=1e-15)
        assert info["is_success"] == (distance <= 0.05)
        assert reward == env.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
        assert reward == (-info["distance"] if kind == "dense" else float(distance <= 0.05) - 1)
    tips = np.array([[0.0, 0.0, 0.0], [0.0, 0.03, 0.04], [0.0, 0.03, 0.05]])
    rewards = env.compute_reward(tips, np.zeros((3, 3)), {})
    expected = [0, 0, -1] if kind == "sparse" else -np.linalg.norm(tips, axis=1)
    np.testing.assert_allclose(rewards, expected, atol=1e-15)


def test_goals_are_those_that_are_shipped_or_given() -> None:
    goals = reachable_goals()
    assert goals.shape[1] == 3
    assert len(goals) > 1000
    assert (np.linalg.norm(goals, axis=1) < 1.05 * LENGTH).all()
    env = OctoArmReachEnv()
    drawn = {tuple(env.reset(seed=seed)[0]["desired_goal"]) for seed in range(20)}
    assert len(drawn) > 15
    assert drawn <= set(map(tuple, goals))
    env = OctoArmReachEnv(goals=[[0.1, 0.0, 0.3]])
    np.testing.assert_array_equal(env.reset(seed=1)[0]["desired_goal"], (0.1, 0.0, 0.3))


def test_rates_are_those_of_the_lengths() -> None:
    env, plain = OctoArmReachEnv(observe_rates=True), OctoArmReachEnv()
    seen, _ = env.reset(seed=0)
    plain.reset(seed=0)
    np.testing.assert_array_equal(seen["observation"][80:], 0.0)
    for action in actions(4):
        before = seen["observation"][:80]
        seen, *_ = env.step(action)
        np.testing.assert_array_equal(
            seen["observation"][:80], plain.step(action)[0]["observation"]
        )
        rates = (seen["observation"][:80] - before) / 0.05
        np.testing.assert_array_equal(seen["observation"][80:], rates)
    assert np.abs(rates).max() > 1e-3
    assert env.observation_space.contains(seen)


@pytest.mark.parametrize("rates", [False, True])
def test_a_saved_episode_goes_on(rates: bool) -> None:
    env = OctoArmReachEnv(delay=2, length_noise=1e-6, observe_rates=rates)
    env.reset(seed=3)
    moves = actions(8)
    for action in moves[:4]:
        env.step(action)
    others = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    for action in moves[4:]:
        seen, reward, *_ = env.step(action)
        for other in others:
            found, earned, *_ = other.step(action)
            assert earned == reward
            for key, value in seen.items():
                np.testing.assert_array_equal(found[key], value)


def test_a_batch_goes_on_from_a_snapshot() -> None:
    envs = OctoArmReachVectorEnv(3)
    envs.reset(seed=0)
    envs.step(actions(3))
    saved = envs.snapshot()
    after = [envs.step(actions(3, seed)) for seed in range(3)]
    envs.restore(saved)
    for seed, (seen, rewards, _, _, _) in enumerate(after):
        found, earned, _, _, _ = envs.step(actions(3, seed))
        np.testing.assert_array_equal(earned, rewards)
        np.testing.assert_array_equal(found["observation"], seen["observation"])


def test_every_argument_survives_json() -> None:
    env = gym.make("OctoArmReach-v0", goals=np.ones((2, 3)) / 4, vary={"arm_density": (0.9, 1)},
                   bodies=3, segments=4, reward_type="dense", arm={"timestep": 5e-4})  # fmt: skip
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    settings = env.unwrapped.settings  # type: ignore[attr-defined]
    assert again.unwrapped.settings == settings  # type: ignore[attr-defined]
    assert ReachSettings.from_dict(settings.to_dict()) == settings
    assert len(settings.drawn_bodies) == 3
    envs = gym.make_vec("OctoArmReach-v0", num_envs=2, segments=4, threads=1)
    single = gym.make(envs.get_attr("spec")[0])
    assert single.action_space.shape == (20,)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"segments": 21}, "segments = 21"),
        ({"segments": 0}, "segments = 0"),
        ({"max_force": -1.0}, "max_force = -1"),
        ({"activation_time": 0.0}, "activation_time = 0"),
        ({"distance_threshold": 2.0}, "distance_threshold = 2"),
        ({"control_period": 0.0505}, "control_period = 0.0505"),
        ({"reward_type": "rich"}, "reward_type = 'rich'"),
        ({"goals": []}, "goals = "),
        ({"goals": [[0.0, 0.0]]}, r"goals\[0\] = "),
        ({"goals": [[0.0, 0.0, 1.3]]}, r"goals\[0\]\[2\] = 1.3"),
        ({"goals": [[0.0, np.nan, 0.3]]}, r"goals\[0\]\[1\]"),
        ({"observe_rates": 1}, "observe_rates = 1"),
        ({"delay": -1}, "delay = -1"),
        ({"length_noise": 2.0}, "length_noise = 2"),
        ({"bodies": 2}, "bodies = 2"),
        ({"vary": {"colour": (1.0, 1.0)}}, "colour"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        OctoArmReachEnv(**arguments)
    with pytest.raises((ValueError, TypeError), match=message):
        OctoArmReachVectorEnv(2, **arguments)


def test_wrong_actions_and_options_change_nothing() -> None:
    env = OctoArmReachEnv()
    with pytest.raises(ValueError, match="reset"):
        env.step(only(0))
    env.reset(seed=0)
    twin = copy.deepcopy(env)
    bad = only(0)
    bad[3] = 1.5
    for action in (bad, only(0)[:24], np.full(25, np.nan), -only(1), "all"):
        with pytest.raises((ValueError, TypeError), match="action"):
            env.step(action)  # type: ignore[arg-type]
    for options in ({"goal": (0, 0, 9)}, {"goal": 3}, {"phase": 0.5}, {"goal": (0, np.inf, 0)}):
        with pytest.raises(ValueError, match="goal|phase"):
            env.reset(options=options)
    np.testing.assert_array_equal(
        env.step(only(0))[0]["observation"], twin.step(only(0))[0]["observation"]
    )


def test_arguments_are_kept() -> None:
    env = gym.make("OctoArmReach-v0")
    with pytest.raises(AttributeError, match="OctoArmReach-v0"):
        env.unwrapped.max_force = 2.0  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="OctoArmReach-v0"):
        env.set_wrapper_attr("max_force", 2.0)
    envs = OctoArmReachVectorEnv(2)
    assert len(envs.get_attr("activations")) == 2
    with pytest.raises(AttributeError, match="segments"):
        envs.set_attr("segments", 3)
    with pytest.raises(AttributeError, match="OctoArmReach-v0"):
        envs.get_attr("teacher_action")


def test_pictures_show_muscles_and_goal() -> None:
    env = gym.make("OctoArmReach-v0", render_mode="rgb_array", width=320, height=240)
    env.reset(seed=0)
    still = env.render()
    env.unwrapped.reset(seed=0, options={"goal": (0.15, 0.0, 0.3)})
    elsewhere = env.render()
    for _ in range(3):
        env.step(only(0))
    active = env.render()
    assert still.shape == (240, 320, 3)  # type: ignore[union-attr]
    assert not np.array_equal(still, elsewhere)
    assert not np.array_equal(elsewhere, active)
    envs = OctoArmReachVectorEnv(2, render_mode="rgb_array", width=320, height=240)
    envs.reset(seed=0)
    frames = envs.render()
    assert frames is not None
    np.testing.assert_array_equal(frames[0], still)
