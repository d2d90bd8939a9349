"""Observations as strains: the formula, the bounds, what is refused."""

import pickle
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from octoarm_env import ArmParameters
from octoarm_env.testing import check_vector_env
from octoarm_env.wrappers import Strain, VectorStrain


def test_a_single_environment_gives_strains_in_percent() -> None:
    bare, env = gym.make("OctoArm-v0"), Strain(gym.make("OctoArm-v0"))
    lengths, _ = bare.reset(seed=3)
    strains, _ = env.reset(seed=3)
    for _ in range(5):
        assert strains.dtype == np.float32
        assert env.observation_space.contains(strains)
        np.testing.assert_allclose(strains, 100 * (lengths / 0.02 - 1), rtol=1e-6, atol=1e-5)
        lengths, *_ = bare.step(np.array([0.5, -0.5], np.float32))
        strains, *_ = env.step(np.array([0.5, -0.5], np.float32))
    # Of the size that networks like.
    assert 0.1 < np.abs(strains).max() < 10
    again = pickle.loads(pickle.dumps(env))
    action = np.zeros(2, np.float32)
    np.testing.assert_array_equal(again.step(action)[0], env.step(action)[0])


@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version")
def test_gymnasiums_checker() -> None:
    check_env(Strain(gym.make("OctoArm-v0").unwrapped, scale=1.0), skip_render_check=True)


def test_every_body_of_a_batch_has_its_own_rest_length() -> None:
    bodies = [ArmParameters(), ArmParameters(rest_length=0.025)]
    envs = gym.make_vec("OctoArm-v0", num_envs=2, arm=bodies, amplitude=5.0)
    strains = Strain(envs, scale=10.0)
    assert isinstance(strains, VectorStrain)
    assert strains.single_observation_space.shape == (80,)
    observations, _ = strains.reset(seed=1)
    assert observations.shape == (2, 80)
    assert strains.observation_space.contains(observations)
    for index, body in enumerate(bodies):
        one = Strain(gym.make("OctoArm-v0", arm=body, amplitude=5.0), scale=10.0)
        expected, _ = one.reset(seed=1 + index)
        np.testing.assert_array_equal(observations[index], expected)
    actions = strains.action_space.sample()
    assert strains.observation_space.contains(strains.step(actions)[0])


def test_what_cannot_be_is_refused() -> None:
    env = gym.make("OctoArm-v0")
    for scale in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match=f"scale = {scale}"):
            Strain(env, scale)
    with pytest.raises(TypeError, match="expected spring lengths"):
        Strain(Strain(env))
    with pytest.raises(TypeError, match="expected spring lengths"):
        Strain(gym.make("CartPole-v1"))


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("kind", ["vector_entry_point", "sync"])
def test_strains_of_a_batch_are_those_of_single_environments(
    mode: AutoresetMode, kind: str
) -> None:
    options = {"max_episode_steps": 7, "amplitude": 5.0}
    bodies = [ArmParameters(), ArmParameters(rest_length=0.025)]
    if kind == "sync":
        make = [partial(gym.make, "OctoArm-v0", arm=body, **options) for body in bodies]
        envs = SyncVectorEnv(make, autoreset_mode=mode, observation_mode="different")
    else:
        envs = gym.make_vec("OctoArm-v0", 2, arm=bodies, autoreset_mode=mode, **options)
    strains = Strain(envs)
    assert strains.autoreset_mode is mode
    check_vector_env(
        strains,
        [
            partial(lambda arm: Strain(gym.make("OctoArm-v0", arm=arm, **options)), b)
            for b in bodies
        ],
        steps=30,
    )
