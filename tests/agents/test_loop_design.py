"""Readouts designed from the linearised loop: the model foretells the simulation."""

import numpy as np
import pytest
from octoarm_agents.policies import load_policy
from octoarm_agents.policies.evaluation import evaluate_policy
from octoarm_agents.policies.rollout import Noise
from octoarm_agents.reservoir import LoopModel, Readout, design, design_policy, weighted_policy

from octoarm_env import EpisodeSettings, OctoArmVectorEnv

PERIODS = 100
NOISE = 1e-4


@pytest.fixture(scope="module")
def model() -> LoopModel:
    return LoopModel.measure(EpisodeSettings(), PERIODS, seed=3)


@pytest.fixture(scope="module")
def ridge(model: LoopModel) -> Readout:
    return Readout("noise", noise=3e-5, bias=True).fit(model.lengths, model.actions)


def test_the_model_foretells_what_small_errors_do(model: LoopModel) -> None:
    envs = OctoArmVectorEnv(1, max_episode_steps=None)
    phase = float(np.random.default_rng(3).uniform())
    lengths, _ = envs.reset(seed=0, options={"phase": phase})
    assert np.array_equal(lengths[0], model.lengths[0])
    random, errors = np.random.default_rng(0), np.zeros((PERIODS, 2))
    for period in range(PERIODS):
        if period:
            foretold = model.responses[period] @ errors[:period].ravel()
            found = lengths[0] - model.lengths[period]
            assert np.linalg.norm(found - foretold) < 1e-3 * np.linalg.norm(found)
        actions = (envs.teacher_actions() + 1e-5 * random.normal(size=2)).astype(np.float32)
        errors[period] = actions[0] - model.actions[period]
        lengths, *_ = envs.step(actions)


def test_the_gradient_is_that_of_the_share(model: LoopModel, ridge: Readout) -> None:
    noises = (0.0, 1e-5, NOISE)
    weights = ridge.weights_
    _, gradient = model.expected_share(weights, noises)
    random = np.random.default_rng(1)
    for _ in range(3):
        way = 1e-3 * np.abs(weights) * random.normal(size=weights.shape)
        shares = [model.expected_share(weights + sign * 0.01 * way, noises)[0] for sign in (1, -1)]
        assert (shares[0] - shares[1]) / 0.02 == pytest.approx((gradient * way).sum(), rel=1e-4)


def test_a_designed_readout_earns_what_was_expected_and_more_than_a_ridge(
    model: LoopModel, ridge: Readout, tmp_path
) -> None:
    policy = design_policy(noises=(0.0, NOISE), periods=PERIODS, iterations=40, seed=3)
    again = design(model, (0.0, NOISE), iterations=40)
    assert np.array_equal(policy.network.layers[0][0], again.weights_[:-1].T)
    expected = policy.training["expected_shares"]
    before = [model.expected_share(ridge.weights_, (noise,))[0] for noise in (0.0, NOISE)]
    assert sum(expected) > sum(before) + 0.001
    policy.save(tmp_path / "designed.npz")
    kept = load_policy(tmp_path / "designed.npz", settings=policy.settings)
    for noise, share in zip((0.0, NOISE), expected, strict=True):
        found = evaluate_policy(kept, kept, episodes=32, steps=PERIODS, noise=Noise(noise))
        assert found["return"] / PERIODS == pytest.approx(share, abs=0.015)


def test_a_weighted_readout_answers_less_to_what_errors_do(model: LoopModel) -> None:
    plain, weighted = (
        weighted_policy(noise=1e-6, error=error, periods=PERIODS, seed=3) for error in (0.0, 0.1)
    )
    assert weighted.training == {
        "noise": 1e-6,
        "error": 0.1,
        "steps": PERIODS * (2 * PERIODS + 1),
    }
    answers = [
        np.linalg.norm(model.responses[-1].T @ policy.network.layers[0][0].T)
        for policy in (plain, weighted)
    ]
    assert answers[1] < 0.9 * answers[0]
    assert evaluate_policy(weighted, weighted, episodes=8, steps=PERIODS)["return"] > 0.9 * PERIODS
    with pytest.raises(ValueError, match=r"error = -0\.1: expected a part of the action range"):
        weighted_policy(error=-0.1)


@pytest.mark.parametrize(
    ("noises", "error"),
    [((), "noises = ()"), ((0.0, -1e-6), "noises = "), ((np.nan,), "noises = ")],
)
def test_what_is_no_noise_is_refused(model: LoopModel, noises, error: str) -> None:
    with pytest.raises(ValueError, match=error.replace("(", r"\(").replace(")", r"\)")):
        design(model, noises)


def test_a_loop_that_explodes_earns_nothing(model: LoopModel, ridge: Readout) -> None:
    share, gradient = model.expected_share(1e9 * ridge.weights_, (0.0, NOISE))
    assert share == 0.0
    assert not gradient.any()
