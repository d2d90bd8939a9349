"""Readouts taught in the loop: what is labelled, with what, and that it is told."""

import numpy as np
import pytest
from octoarm_agents.policies.evaluation import evaluate_policy
from octoarm_agents.reservoir import Readout, aggregated_policy

from octoarm_env import OctoArmVectorEnv

PERIODS = 150


def test_without_disturbance_the_first_round_is_a_fit_to_the_clock() -> None:
    policy = aggregated_policy(rounds=1, episodes=2, periods=PERIODS, noise=1e-7, shake=0.0, seed=4)
    envs = OctoArmVectorEnv(2, max_episode_steps=None)
    seen, _ = envs.reset(seed=5)
    lengths, actions = [], []
    for _ in range(PERIODS):
        lengths.append(seen)
        actions.append(envs.teacher_actions().astype(np.float32))
        seen, *_ = envs.step(actions[-1])
    readout = Readout("noise", noise=1e-7, bias=True)
    readout.fit(np.concatenate(lengths[2:]), np.concatenate(actions[2:]))
    # The nearest phase that was seen is at most half a control period off, and in a whole one the
    # clock's command moves by a tenth.
    found, expected = (
        np.concatenate(lengths) @ weights[:-1] + weights[-1]
        for weights in (readout.weights_, _weights(policy))
    )
    assert np.abs(found - expected).max() < 0.05
    assert policy.training["rewards"][0] > 0.99


def test_every_round_is_told_and_the_same_for_a_seed() -> None:
    several = {"episodes": 2, "periods": PERIODS, "noise": 1e-6, "shake": 0.1}
    once, again = (aggregated_policy(rounds=2, seed=1, **several) for _ in range(2))
    first = aggregated_policy(rounds=1, seed=1, **several)
    assert np.array_equal(_weights(once), _weights(again))
    assert once.training == again.training
    assert once.training["rewards"][:1] == first.training["rewards"]
    assert len(once.training["rewards"]) == once.training["rounds"] == 2
    assert once.training["steps"] == 3 * 2 * PERIODS
    assert not np.array_equal(_weights(once), _weights(first))
    assert evaluate_policy(once, once, episodes=4, steps=PERIODS)["return"] > 0.9 * PERIODS


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ({"rounds": 0}, "rounds = 0: "),
        ({"episodes": 0}, "episodes = 0: "),
        ({"periods": 2}, "periods = 2: "),
        ({"noise": -1e-6}, "noise = -1e-06: expected a number, not negative"),
        ({"shake": float("nan")}, "shake = nan: expected a number, not negative"),
    ],
)
def test_what_cannot_be_is_refused(argument, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        aggregated_policy(**argument)


def _weights(policy) -> np.ndarray:
    matrix, bias = policy.network.layers[0]
    return np.vstack((matrix.T, bias))
