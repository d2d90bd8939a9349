"""Bodies that vary: drawn around the arm, one of them at hand for each episode."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from octoarm_env import ArmParameters, EpisodeSettings, OctoArmEnv, OctoArmVectorEnv, TeacherPolicy

VARY = {"longitudinal_stiffness": (0.8, 1.2), "transverse_damping": (0.5, 2.0)}
POOL: dict[str, Any] = {"target": "lissajous", "vary": VARY, "bodies": 11, "body_seed": 5}
"""More bodies than stand in the lanes of one group."""


def actions(steps: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(3).uniform(-1, 1, (steps, *shape, 2)).astype(np.float32)


@pytest.fixture(scope="module")
def env() -> OctoArmEnv:
    return OctoArmEnv(**POOL)


def test_a_body_is_drawn_at_every_reset(env: OctoArmEnv) -> None:
    env.reset(seed=0)
    drawn = [int(env.reset()[1]["body"]) for _ in range(400)]
    counts = np.bincount(drawn, minlength=11)
    # Four standard deviations of a binomial distribution.
    assert np.abs(counts - 400 / 11).max() < 4 * np.sqrt(400 / 11)
    env.reset(seed=0)
    assert [int(env.reset()[1]["body"]) for _ in range(20)] == drawn[:20]
    _, info = env.reset(seed=1)
    assert isinstance(info["body"], np.int64)
    assert env.step(env.action_space.sample())[4]["body"] == info["body"]


def test_the_arm_is_the_body_that_info_names(env: OctoArmEnv) -> None:
    bodies = env.settings.drawn_bodies
    assert len(set(bodies)) == len(bodies) == 11
    nominal = ArmParameters()
    for body in bodies:
        stiffness = body.longitudinal_stiffness / nominal.longitudinal_stiffness
        damping = body.transverse_damping / nominal.transverse_damping
        assert 0.8 <= stiffness <= 1.2
        assert 0.5 <= damping <= 2.0
        kept = {name: getattr(nominal, name) for name in VARY}
        assert body.replace(**kept) == nominal
    for seed in range(4):
        observation, info = env.reset(seed=seed, options={"phase": 0.25})
        alone = OctoArmEnv("lissajous", arm=bodies[info["body"]])
        expected, _ = alone.reset(options={"phase": 0.25})
        np.testing.assert_array_equal(observation, expected)
        for action in actions(20):
            np.testing.assert_array_equal(env.step(action)[0], alone.step(action)[0])
    other = EpisodeSettings(**POOL | {"body_seed": 6}).drawn_bodies
    assert not set(other) & set(bodies)


def test_the_teacher_holds_every_body(env: OctoArmEnv) -> None:
    teacher = TeacherPolicy(env)
    for seed in range(5):
        observation, _ = env.reset(seed=seed)
        rewards = []
        for _ in range(100):
            action, _ = teacher.predict(observation)
            observation, reward, *_ = env.step(action)
            rewards.append(float(reward))
        assert np.mean(rewards) > 0.99


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_the_batch_has_the_bits_of_single_environments(mode: AutoresetMode) -> None:
    count = 9
    single = [lambda: gym.make("OctoArm-v0", max_episode_steps=4, **POOL)] * count
    loop = SyncVectorEnv(single, autoreset_mode=mode)
    for threads in (1, 2):
        batch = OctoArmVectorEnv(
            count, **POOL, max_episode_steps=4, autoreset_mode=mode, threads=threads
        )
        seen = set()
        pairs = zip(batch.reset(seed=2), loop.reset(seed=2), strict=True)
        for step in range(12):
            for ours, theirs in pairs:
                if isinstance(ours, dict):
                    assert ours.keys() == theirs.keys()
                    np.testing.assert_array_equal(ours["body"], theirs["body"])
                    assert ours["body"].dtype == theirs["body"].dtype == np.int64
                    seen |= set(ours["body"].tolist())
                else:
                    np.testing.assert_array_equal(ours, theirs)
            given = actions(12, count)[step]
            pairs = zip(batch.step(given), loop.step(given), strict=True)
        assert len(seen) > 8


def test_copies_and_snapshots_go_on_with_their_bodies(env: OctoArmEnv) -> None:
    batch = OctoArmVectorEnv(9, **POOL, max_episode_steps=5)
    batch.reset(seed=7)
    env.reset(seed=7)
    batch.step(actions(1, 9)[0])
    env.step(actions(1)[0])
    snapshot = batch.snapshot()
    others = [pickle.loads(pickle.dumps(batch)), copy.deepcopy(batch)]
    copies = [pickle.loads(pickle.dumps(env)), copy.deepcopy(env)]
    expected = [batch.step(each) for each in actions(9, 9)]
    batch.reset(seed=8)
    batch.restore(snapshot)
    for each in (batch, *others):
        for given, (observations, rewards, *_, infos) in zip(actions(9, 9), expected, strict=True):
            again = each.step(given)
            np.testing.assert_array_equal(again[0], observations)
            np.testing.assert_array_equal(again[1], rewards)
            np.testing.assert_array_equal(again[4]["body"], infos["body"])
    for given in actions(9):
        observation, _, _, _, info = env.step(given)
        for each in copies:
            again = each.step(given)
            np.testing.assert_array_equal(again[0], observation)
            assert again[4]["body"] == info["body"]
    _, info = env.reset(seed=9)
    assert info["body"] > 0
    damaged = env._core.save().replace('"body":', '"body":7')
    with pytest.raises(ValueError, match=r"body = 7\d+ is outside the allowed range \[0, 10\]"):
        env._core.load(damaged)


def test_gymnasium_takes_it(env: OctoArmEnv) -> None:
    check_env(env, skip_render_check=True)
    made = gym.make("OctoArm-v0", **POOL)
    again = gym.make(EnvSpec.from_json(made.spec.to_json()))
    assert again.unwrapped.settings == made.unwrapped.settings
    assert EpisodeSettings.from_dict(made.unwrapped.settings.to_dict()) == env.settings
    np.testing.assert_array_equal(again.reset(seed=1)[0], made.reset(seed=1)[0])


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"bodies": 2}, ValueError, r"bodies = 2 .*\[1, 1\] of whole numbers without vary"),
        ({"bodies": 300, "vary": VARY}, ValueError, r"bodies = 300 .*\[1, 256\]"),
        ({"bodies": 1.5, "vary": VARY}, TypeError, r"bodies = 1\.5"),
        ({"body_seed": -1}, ValueError, r"body_seed = -1"),
        ({"vary": [1, 2]}, TypeError, r"vary must be a mapping"),
        ({"vary": {"arm_density": 1.1}}, ValueError, r"vary\['arm_density'\] = 1\.1: expected two"),
        ({"vary": {"arm_density": (0.9, "b")}}, TypeError, r"vary\['arm_density'\]\[1\] = 'b'"),
        ({"vary": {"arm_density": (1.1, 0.9)}}, ValueError, r"vary\.arm_density\[1\] = 0\.9"),
        ({"vary": {"timestep": (0.9, 1.1)}}, ValueError, r'vary = "timestep" .*area_scale'),
        # The body itself would be no body.
        (
            {"vary": {"longitudinal_mass_share": (2.0, 2.0)}},
            ValueError,
            r"longitudinal_mass_share = 1\.28",
        ),
    ],
)
def test_bad_arguments_are_named(options: Any, error: type[Exception], message: str) -> None:
    for make in (OctoArmEnv, lambda **given: OctoArmVectorEnv(2, **given)):
        with pytest.raises(error, match=message):
            make(**options)
