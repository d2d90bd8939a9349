"""The trained agents that come along: all there, small, and as good as recorded."""

from __future__ import annotations

import itertools
import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from octoarm_agents.common.environment import TARGETS
from octoarm_agents.comparison.agents import TRAINED
from octoarm_agents.policies import load_policy, load_trained, trained_agents
from octoarm_agents.policies.evaluation import evaluate_policy
from octoarm_agents.policies.loading import TRAINED_FOLDER

LISTED = json.loads((TRAINED_FOLDER / "trained.json").read_text(encoding="utf-8"))
AGENTS: list[dict[str, Any]] = LISTED["agents"]


def test_all_are_there() -> None:
    expected = set(itertools.product(TRAINED, TARGETS))
    assert set(trained_agents()) == expected
    assert {(each["agent"], each["target"]) for each in AGENTS} == expected
    assert max(path.stat().st_size for path in trained_agents().values()) < 300_000


@pytest.mark.parametrize("entry", AGENTS, ids=lambda each: each["file"])
def test_it_earns_what_is_recorded(entry: dict[str, Any]) -> None:
    policy = load_trained(entry["agent"], entry["target"])
    assert policy.seed == entry["seed"]
    assert policy.settings["target"] == entry["target"]
    assert f"--target {entry['target']}" in entry["command"] or "compare" in entry["command"]
    found = evaluate_policy(policy, policy, threads=1, **LISTED["evaluation"])
    # Another machine's linear algebra rounds otherwise; that is all that may differ.
    assert found["return"] == pytest.approx(entry["return"], abs=0.5)
    assert found["tracking_error"] == pytest.approx(entry["tracking_error"], rel=0.1)


def test_one_line_loads_one() -> None:
    policy = load_trained("ppo", "quadratic")
    env = gym.make("OctoArm-v0", target="quadratic")
    observation, _ = env.reset(seed=0)
    action, _ = policy.predict(observation)
    assert env.action_space.contains(action)
    np.testing.assert_array_equal(
        action, load_policy(trained_agents()["ppo", "quadratic"], env).predict(observation)[0]
    )


def test_unknown_agents_are_named() -> None:
    with pytest.raises(ValueError, match="agent, target = 'ppo', 'square': expected one of"):
        load_trained("ppo", "square")
