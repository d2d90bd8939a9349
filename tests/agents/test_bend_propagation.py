"""A wave of stiffening lets a bend travel along the arm, and a readout learns it."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from octoarm_agents.experiments.muscles import let_go as muscles
from octoarm_agents.experiments.muscles.bend_propagation import scripted

from octoarm_env import ArmParameters
from octoarm_env.reach import BendPropagation, OctoArmReachVectorEnv, bend_wave

BODY = ArmParameters()


def test_wave_stiffens_from_the_base_on() -> None:
    before, amid, after = bend_wave([-1.0, 0.5, 5.0], 5, 0.4, speed=0.4, width=0.01)
    one_side = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(before, np.tile(one_side, (5, 1)))
    np.testing.assert_array_equal(amid[:2], np.ones((2, 5)))
    np.testing.assert_array_equal(amid[3:], np.tile(one_side, (2, 1)))
    np.testing.assert_array_equal(after, np.ones((5, 5)))
    aside = bend_wave(-1.0, 1, 0.4, side=np.pi / 4)[0]
    np.testing.assert_allclose(aside, [np.sqrt(0.5), np.sqrt(0.5), 0, 0, 0], atol=1e-15)


def test_the_bend_travels_to_the_tip() -> None:
    told = muscles.judge(muscles.let_go(BODY, None, np.random.default_rng(0), arms=1))
    assert all(each.all() for each in told.values())
    series = scripted(BODY)
    assert 0.15 < series["peak_m_s"] < 1.0
    assert series["along_m_s"] == pytest.approx(muscles.SPEED, rel=0.35)


def test_no_command_no_wave() -> None:
    generator = np.random.default_rng(0)
    told = muscles.judge(muscles.let_go(BODY, None, generator, arms=1, command=False))
    assert told["waits"].all()
    assert not told["travels"].any()
    assert not told["straight"].any()


def test_a_readout_does_it_alone() -> None:
    weights = muscles.teach(BODY, (0, 0), pupils=24)
    assert weights.shape == (82, 100)
    generator = np.random.default_rng(1)
    alone = muscles.judge(muscles.let_go(BODY, weights, generator, arms=4))
    reached = alone["waits"] & alone["travels"] & alone["straight"]
    assert reached.sum() >= 3


def test_bend_point_of_a_kinked_line() -> None:
    line = np.zeros((21, 3))
    line[:, 2] = np.arange(21.0)
    assert np.isnan(muscles.bend_point(line))
    line[12:, 0] = np.arange(1.0, 10.0)
    assert muscles.bend_point(line) == pytest.approx(11 / 20)
    np.testing.assert_allclose(muscles.bends_of(line)[10], 45.0)


def test_policy_bends_towards_the_goal_then_stiffens() -> None:
    env = gym.make("OctoArmReach-v0", max_episode_steps=100)
    policy = BendPropagation(env, start=1.0)
    seen, _ = env.reset(seed=0, options={"goal": (0.0, -0.15, 0.3)})
    for _ in range(20):
        action, _ = policy.predict(seen)
        seen, *_ = env.step(action)
    assert seen["achieved_goal"][1] < -0.05
    for _ in range(60):
        action, _ = policy.predict(seen)
        seen, *_ = env.step(action)
    np.testing.assert_array_equal(action, np.ones(25))
    envs = OctoArmReachVectorEnv(3)
    seen, _ = envs.reset(seed=0)
    action, _ = BendPropagation(envs).predict(seen)
    assert action.shape == (3, 25)
    with pytest.raises(TypeError, match="OctoArmReach-v0"):
        BendPropagation(gym.make("OctoArm-v0"))
    with pytest.raises(ValueError, match="speed = -1"):
        BendPropagation(env, speed=-1.0)
