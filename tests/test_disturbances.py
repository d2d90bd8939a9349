"""Noise, delay and springs that are not seen: what lies between the agent and the body."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from octoarm_env import ArmParameters, OctoArmEnv, OctoArmVectorEnv

ALL = {"length_noise": 1e-5, "action_noise": 3.0, "delay": 3, "dropout": 5}


def run(steps: int, seed: int = 4, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Observations, the first one included, and base angles, under the same actions."""
    env = OctoArmEnv("lissajous", **options)
    actions = np.random.default_rng(0).uniform(-1, 1, (steps, 2)).astype(np.float32)
    observation, info = env.reset(seed=seed)
    rows, bases = [observation], [info["base_angles"]]
    for action in actions:
        observation, _, _, _, info = env.step(action)
        assert env.observation_space.contains(observation)
        rows.append(observation)
        bases.append(info["base_angles"])
    return np.array(rows), np.array(bases)


def test_a_delay_is_so_many_control_periods() -> None:
    clean, bases = run(12)
    late, late_bases = run(12, delay=4)
    np.testing.assert_array_equal(late[4:], clean[:-4])
    np.testing.assert_array_equal(late[:4], clean[[0] * 4])
    # What is rewarded is where the base is, not what is seen of it.
    np.testing.assert_array_equal(late_bases, bases)


def test_noise_on_the_lengths() -> None:
    clean, _ = run(200)
    noisy, _ = run(200, length_noise=1e-5)
    off = noisy - clean
    assert np.abs(off).max() <= 1e-5
    # 16,080 draws of a uniform distribution.
    assert abs(off.mean()) < 4 * 1e-5 / np.sqrt(3 * off.size)
    assert off.std() == pytest.approx(1e-5 / np.sqrt(3), rel=0.02)
    assert len(np.unique(off)) > 0.99 * off.size
    np.testing.assert_array_equal(run(200, length_noise=1e-5)[0], noisy)
    assert not np.array_equal(run(200, seed=5, length_noise=1e-5)[0] - run(200, seed=5)[0], off)
    # What is seen stays within the observation space.
    assert run(5, length_noise=1.0)[0].min() > 0


def test_noise_on_the_actions() -> None:
    _, clean = run(100)
    _, noisy = run(100, action_noise=2.0)
    off = (noisy - clean)[1:]
    assert np.abs(off).max() <= 2.0
    assert off.std() == pytest.approx(2.0 / np.sqrt(3), rel=0.15)
    assert np.abs(off.mean()) < 0.4
    np.testing.assert_array_equal(noisy[0], clean[0])


def test_springs_that_are_not_seen() -> None:
    env = OctoArmEnv("lissajous", dropout=6)
    rest = env.settings.arm.rest_length
    unseen = []
    for seed in (1, None, None):
        observation, _ = env.reset(seed=seed)
        unseen.append(frozenset(np.flatnonzero(observation == rest).tolist()))
        assert len(unseen[-1]) == 6
        for _ in range(3):
            observation, *_ = env.step(np.zeros(2, np.float32))
            assert frozenset(np.flatnonzero(observation == rest).tolist()) == unseen[-1]
    assert len(set(unseen)) == 3
    blind = OctoArmEnv(dropout=80)
    assert set(blind.reset(seed=0)[0].tolist()) == {rest}


def test_nothing_changes_without_them() -> None:
    off = dict.fromkeys(ALL, 0)
    for one, other in zip(run(20), run(20, **off), strict=True):
        np.testing.assert_array_equal(one, other)
    assert OctoArmEnv(**off).settings == OctoArmEnv().settings


def test_the_checker_finds_nothing() -> None:
    check_env(gym.make("OctoArm-v0", **ALL).unwrapped, skip_render_check=True)


def test_an_episode_goes_on_where_it_stands() -> None:
    env = OctoArmEnv(**ALL)
    env.reset(seed=0)
    action = np.full(2, 0.3, np.float32)
    for _ in range(5):
        env.step(action)
    twins = pickle.loads(pickle.dumps(env)), copy.deepcopy(env)
    for _ in range(5):
        expected = env.step(action)[0]
        for twin in twins:
            np.testing.assert_array_equal(twin.step(action)[0], expected)
    plain = OctoArmEnv()
    plain.reset(seed=0)
    with pytest.raises(ValueError, match="senses = none .*of states with disturbances"):
        env._core.load(plain._core.save())
    with pytest.raises(ValueError, match="senses = some .*of states without disturbances"):
        plain._core.load(env._core.save())


KEYS = {"body_factors", "action_noise", "true_lengths", "dropped", "delay"}
VARY = {"transverse_damping": (0.5, 2.0), "arm_density": (0.9, 1.1)}


@pytest.mark.parametrize(
    ("options", "keys"),
    [
        ({}, set()),
        ({"action_noise": 3.0}, {"action_noise"}),
        ({"length_noise": 1e-5}, {"true_lengths"}),
        ({"delay": 2}, {"true_lengths", "delay"}),
        ({"dropout": 80}, {"true_lengths", "dropped"}),
        ({"vary": VARY, "bodies": 2}, {"body_factors"}),
        (ALL | {"vary": VARY}, KEYS),
    ],
)
@pytest.mark.parametrize("name", ["OctoArm-v0", "OctoArmReach-v0"])
def test_info_tells_of_what_is_on_alone(name: str, options: dict, keys: set[str]) -> None:
    if name == "OctoArmReach-v0":
        options = {key: options[key] for key in options if key != "action_noise"}
        keys = keys - {"action_noise"}
    env, envs = gym.make(name, **options), gym.make_vec(name, num_envs=2, **options)
    action = env.action_space.sample()
    infos = [env.reset(seed=0)[1], env.step(action)[4]]
    rows = [envs.reset(seed=0)[1], envs.step(np.stack([action] * 2))[4]]
    for info, row in zip(infos, rows, strict=True):
        assert set(info) & KEYS == keys
        assert set(row) & KEYS == keys
        for key in keys:
            assert row[f"_{key}"].tolist() == [True, True]
            np.testing.assert_array_equal(row[key][0], info[key])
            assert row[key].dtype == info[key].dtype
    envs.close()


def test_info_is_what_was_done() -> None:
    disturbed = OctoArmEnv("lissajous", action_range=13.0, **ALL | {"vary": VARY})
    body = disturbed.settings.drawn_bodies[0]
    nominal = ArmParameters()
    plain = OctoArmEnv("lissajous", action_range=13.0, arm=body)
    observation, info = disturbed.reset(seed=3, options={"phase": 0.5})
    plain.reset(options={"phase": 0.5})
    assert info["action_noise"].tolist() == [0, 0]
    assert info["delay"] == 3
    expected = (body.arm_density / nominal.arm_density, body.transverse_damping)
    np.testing.assert_allclose(info["body_factors"], expected, rtol=1e-15)
    dropped, history = info["dropped"], [info["true_lengths"]]
    assert dropped.sum() == 5
    for step in range(12):
        action = np.array([0.2, -0.1]) * (step % 3)
        observation, _, _, _, info = disturbed.step(action)
        # The same step of a body that is told what the noise made of the command.
        moved = action + info["action_noise"] / 13.0
        true, *_, undisturbed = plain.step(moved)
        assert np.abs(info["action_noise"]).max() <= 3.0
        np.testing.assert_allclose(undisturbed["base_angles"], info["base_angles"], atol=1e-12)
        np.testing.assert_allclose(info["true_lengths"], true, atol=1e-12)
        np.testing.assert_array_equal(info["dropped"], dropped)
        history.append(info["true_lengths"])
        assert (observation[dropped] == 0.02).all()
        late = history[max(0, len(history) - 1 - 3)]
        assert np.abs(observation - late)[~dropped].max() <= 1e-5
    assert np.abs(info["action_noise"]).max() > 0


def test_the_end_of_an_episode_has_its_own() -> None:
    envs = OctoArmVectorEnv(
        3, "lissajous", dropout=4, max_episode_steps=3, autoreset_mode="SameStep"
    )
    dropped = envs.reset(seed=0)[1]["dropped"]
    for _ in range(3):
        infos = envs.step(np.zeros((3, 2), np.float32))[4]
    np.testing.assert_array_equal(infos["final_info"]["dropped"], dropped)
    assert (infos["dropped"] != dropped).any(axis=1).all()
    assert (infos["dropped"].sum(axis=1) == 4).all()
    for row, seen, true in zip(
        dropped, infos["final_obs"], infos["final_info"]["true_lengths"], strict=True
    ):
        np.testing.assert_array_equal(seen[~row], true[~row])
    envs.close()
