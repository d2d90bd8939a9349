"""The readout as an agent: taught by the clock, acts like a policy of stable-baselines3."""

import gymnasium as gym
import numpy as np
import pytest
from octoarm_agents.policies import evaluation, load_policy
from octoarm_agents.policies.rollout import Noise
from octoarm_agents.reservoir import Readout, train_policy
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from octoarm_env import ArmParameters


def weights(policy):
    """Of its one layer, (springs, 2)."""
    return policy.network.layers[0][0].T


@pytest.fixture(scope="module")
def policy():
    return train_policy()


@pytest.fixture
def env():
    return gym.make("OctoArm-v0")


class TestActing:
    def test_it_earns_nearly_all(self, policy, env):
        mean, deviation = evaluate_policy(policy, Monitor(env), n_eval_episodes=3)
        # Measured 0.996 of the most that an episode of 500 steps is worth.
        assert 0.98 * 500 <= mean <= 500
        assert deviation < 0.01 * 500

    def test_it_acts_in_many_environments_at_once(self, policy):
        envs = DummyVecEnv([lambda: Monitor(gym.make("OctoArm-v0"))] * 3)
        returns, lengths = evaluate_policy(
            policy, envs, n_eval_episodes=3, return_episode_rewards=True
        )
        assert lengths == [500] * 3
        assert min(returns) > 0.98 * 500

    def test_one_observation_and_a_batch_give_the_same(self, policy, env):
        observations = np.stack([env.reset(seed=seed)[0] for seed in range(5)])
        batch, _ = policy.predict(observations)
        assert batch.shape == (5, 2)
        assert batch.dtype == env.action_space.dtype
        for observation, row in zip(observations, batch, strict=True):
            action, state = policy.predict(observation, ("state",), np.array([True]), False)
            # Another order of summation, then float32.
            np.testing.assert_allclose(action, row, atol=1e-6)
            assert state == ("state",)
            assert env.action_space.contains(action)

    def test_its_actions_are_clipped(self, policy, env):
        observation, _ = env.reset(seed=0)
        rest = ArmParameters().rest_length
        wild = rest + 1000 * (observation - rest)
        action, _ = policy.predict(np.stack((wild, 2 * rest - wild)))
        assert np.abs(action).max() == 1.0
        raw = np.stack((wild, 2 * rest - wild)) @ weights(policy)
        np.testing.assert_allclose(action, np.clip(raw, -1, 1), atol=1e-6)


class TestTeaching:
    def test_the_same_seed_teaches_the_same(self, policy, env):
        np.testing.assert_array_equal(weights(train_policy(env)), weights(policy))
        other = train_policy(seed=1)
        assert not np.array_equal(weights(other), weights(policy))

    def test_it_goes_on_when_the_time_is_up(self, env):
        """Steps beyond one episode come from others, begun at other phases."""
        starts = []

        class Starts(gym.Wrapper):
            def reset(self, **keywords):
                observation, info = super().reset(**keywords)
                starts.append(tuple(info["target"]))
                return observation, info

        train_policy(Starts(env), steps=1_600)
        assert len(set(starts)) == 4

    def test_it_learns_the_settings_of_its_environment(self):
        body = ArmParameters(arm_density=1100.0, compartments=10)
        orbit = 8 * np.sin(np.linspace(0, 2 * np.pi, 500, endpoint=False)[:, None] + [0, 1.5])
        policy = train_policy(
            {"target": orbit, "control_period": 0.02, "actuator": "direct", "arm": body}, steps=80
        )
        assert policy.parameters == body
        assert policy.settings == {
            "target": orbit.tolist(),
            "amplitude": pytest.approx(np.abs(orbit).max(), rel=1e-12),
            "control_period": 0.02,
            "actuator": "direct",
            "action_range": pytest.approx(1.3 * np.abs(orbit).max(), rel=1e-12),
        }
        assert policy.predict(np.full(40, 0.02))[0].shape == (2,)

    def test_with_its_past_it_hears_less_noise(self, policy):
        longer = train_policy(noise=1e-5, past=4)
        assert longer.training["past"] == 4
        assert longer.parameter_count in (800, 802)
        alone = train_policy(noise=1e-5)
        returns = [
            evaluation.evaluate_policy(each, each, episodes=8, noise=Noise(1e-4))["return"]
            for each in (alone, longer)
        ]
        assert returns[1] > returns[0]
        assert evaluation.evaluate_policy(longer, longer, episodes=4)["return"] > 490

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"past": -1}, "past = -1"),
            ({"steps": 239, "past": 2}, "steps = 239: expected a whole number, at least 240"),
            ({"steps": 79}, "steps = 79: expected a whole number, at least 80"),
            ({"steps": 100.5}, "steps = 100.5"),
            ({"action_noise": 1.5}, "action_noise = 1.5.*0 to 1"),
            ({"action_noise": np.nan}, "action_noise = nan"),
            ({"noise": -1e-5}, "noise = -1e-05"),
            ({"seed": -1}, "seed = -1"),
        ],
    )
    def test_a_bad_argument_is_named(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            train_policy(**arguments)

    def test_environments_of_another_kind_are_refused(self):
        with pytest.raises(TypeError, match="OctoArm-v0.*CartPole"):
            train_policy(gym.make("CartPole-v1"))
        with pytest.raises(TypeError, match="OctoArm-v0.*str"):
            train_policy("OctoArm-v0")

    def test_wrappers_must_leave_lengths_and_actions_alone(self, env):
        train_policy(gym.wrappers.ClipAction(Monitor(env)), steps=80)
        box = gym.spaces.Box(-np.inf, np.inf, (80,), np.float64)
        strained = gym.wrappers.TransformObservation(env, lambda lengths: lengths / 0.02 - 1, box)
        with pytest.raises(ValueError, match="env has observations"):
            train_policy(strained)
        with pytest.raises(ValueError, match="env has actions"):
            train_policy(gym.wrappers.RescaleAction(env, *np.float32([-2, 2])))


def test_what_was_saved_acts_the_same(policy, env, tmp_path):
    policy.save(tmp_path / "policy.npz")
    loaded = load_policy(tmp_path / "policy.npz", Monitor(env))
    observation, _ = env.reset(seed=3)
    np.testing.assert_array_equal(loaded.predict(observation)[0], policy.predict(observation)[0])
    assert loaded.settings == policy.settings
    assert loaded.parameters == policy.parameters
    assert (loaded.algorithm, loaded.seed) == ("readout", 0)
    assert loaded.training == {
        "steps": 3500,
        "action_noise": 0.01,
        "readout": Readout("noise", noise=1e-8).get_params(),
        "past": 0,
        "rank": 80,
        "training_error": pytest.approx(0.002, rel=0.5),
    }
