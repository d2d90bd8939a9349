"""The examples run, learn, and do what their comments say."""

from __future__ import annotations

import importlib.util
import re
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

SCRIPT = Path(__file__).parents[2] / "agents" / "examples" / "ppo.py"
spec = importlib.util.spec_from_file_location("octoarm_example_ppo", SCRIPT)
ppo = importlib.util.module_from_spec(spec)
spec.loader.exec_module(ppo)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    """Run the script with arguments; give what it prints."""

    def run_script(*arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [str(SCRIPT), *map(str, arguments)])
        runpy.run_path(str(SCRIPT), run_name="__main__")
        return capsys.readouterr().out

    return run_script


def returned(output: str) -> str:
    return re.search(r"^return (\S+) of 500$", output, re.M)[1]


@pytest.mark.parametrize(
    ("steps", "rollouts", "least"),
    # Measured with 60,000 steps and seeds 0 to 2: 342, 388, 389 of 500; untrained 3.
    [(2048, 1, 0.0), pytest.param(60_000, 30, 150.0, marks=pytest.mark.long)],
)
def test_ppo_learns_and_keeps_what_it_has_learnt(
    steps: int, rollouts: int, least: float, tmp_path: Path, run: Any
) -> None:
    path = tmp_path / "arm.pt"
    output = run("--steps", steps, "--out", path)
    assert float(returned(output)) > least

    assert [file.name for file in tmp_path.iterdir()] == ["arm.pt"]
    content = torch.load(path, weights_only=True)
    assert content["arguments"]["steps"] == steps
    assert content["arguments"]["out"] == str(path)
    assert content["agent"]["observed.count"] == 8 * (1 + rollouts * 256)
    again = ppo.evaluate(ppo.load(path), "quadratic").mean()
    assert f"{again:.1f}" == returned(output)


def test_same_seed_same_output(run: Any) -> None:
    def figures(seed: int) -> str:
        few = ("--num-envs", 2, "--target", "van_der_pol")
        output = run("--steps", 1024, "--seed", seed, *few)
        return re.sub(r"\s*[\d,]+ steps/s\s*", "\n", output)

    first = figures(3)
    # Episodes of 100 steps have ended in the 512 of each arm.
    assert re.search(r"1,024 steps  reward 0\.\d+ a step", first)
    assert figures(3) == first
    assert figures(4) != first


def test_tensorboard(tmp_path: Path, run: Any) -> None:
    pytest.importorskip("tensorboard")
    run("--steps", 16, "--num-envs", 2, "--num-steps", 8, "--tensorboard", tmp_path)
    assert len(list(tmp_path.glob("events.*"))) == 1


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("--target", "square", "'quadratic', 'van_der_pol', 'lissajous'"),
        ("--steps", "0", "a whole number from 1 to 1000000000000"),
        ("--steps", "1e6", "a whole number from 1 to 1000000000000"),
        ("--num-envs", "2.5", "a whole number from 1 to 10000"),
        ("--seed", "-1", "a whole number from 0 to 9223372036854775807"),
        ("--gamma", "1.5", "a number from 0 to 1"),
        ("--learning-rate", "nan", "a number from 0 to 1"),
        ("--max-grad-norm", "inf", "a number from 0.001 to 1000"),
        ("--minibatch", "1", "a whole number from 2 to 1000000000"),
        ("--out", "nowhere/arm.pt", "a file in a folder that exists"),
    ],
)
def test_refuses_bad_arguments(
    name: str, value: str, allowed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as error:
        ppo.arguments([f"{name}={value}"])
    assert error.value.code == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert f"argument {name}: " in message
    assert f"'{value}'" in message
    assert allowed in message


@pytest.mark.parametrize("lam", [0.0, 0.95, 1.0])
def test_gae_is_the_plain_sum(lam: float) -> None:
    generator = torch.Generator().manual_seed(0)
    steps, envs, gamma = 30, 3, 0.9
    rewards, values, next_values = torch.randn(
        3, steps, envs, generator=generator, dtype=torch.float64
    )
    terminated, truncated = torch.zeros(2, steps, envs, dtype=torch.float64)
    truncated[11, 0] = truncated[29, 0] = 1
    terminated[17, 1] = 1
    truncated[20, 2] = terminated[20, 2] = terminated[25, 2] = 1
    ended = torch.maximum(terminated, truncated)

    expected = torch.zeros_like(rewards)
    for env in range(envs):
        for start in range(steps):
            for t in range(start, steps):
                following = 0.0 if terminated[t, env] else next_values[t, env]
                error = rewards[t, env] + gamma * following - values[t, env]
                expected[start, env] += (gamma * lam) ** (t - start) * error
                if ended[t, env]:
                    break
    rollout = ppo.Rollout(None, None, None, rewards, terminated, ended)
    found = ppo.gae(rollout, values, next_values, gamma, lam)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)


def test_a_truncated_step_leads_to_the_last_observation_of_its_own_episode(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The value of the next episode's first observation would be the classic mistake."""
    args = ppo.arguments(["--num-envs=2", "--num-steps=501", "--seed=5"])
    torch.manual_seed(0)
    agent = ppo.Agent(80, 2)
    monkeypatch.setattr(agent, "normalize", lambda seen: torch.as_tensor(seen).float())
    envs = ppo.make_envs(2, "quadratic")
    rollout = ppo.Collector(envs, agent, args).collect()
    envs.close()

    for index in range(2):
        env = gym.make("OctoArm-v0")
        first, _ = env.reset(seed=args.seed + index)
        seen = [first]
        for action in rollout.actions[:500, index]:
            observation, _, terminated, truncated, _ = env.step(np.clip(action.numpy(), -1, 1))
            seen.append(observation)
        assert truncated
        assert not terminated
        expected = torch.as_tensor(np.array(seen)).float()
        torch.testing.assert_close(rollout.observations[:500, index], expected[:500])
        torch.testing.assert_close(rollout.next_observations[:500, index], expected[1:])
        restarted, _ = env.reset()
        torch.testing.assert_close(
            rollout.observations[500, index], torch.as_tensor(restarted).float()
        )
        assert (rollout.next_observations[499, index] != rollout.observations[500, index]).any()
    assert torch.equal(rollout.ended.sum(1), 2.0 * (torch.arange(501) == 499))
    assert not rollout.terminated.any()


def test_moments_are_those_of_everything_seen() -> None:
    rng = np.random.default_rng(0)
    batches = [rng.normal(0.02, 1e-4, (count, 3)) for count in (1, 8, 8, 100, 3)]
    moments = ppo.Moments(3)
    for batch in batches:
        moments.update(torch.as_tensor(batch))
    everything = np.concatenate(batches)
    np.testing.assert_allclose(moments.mean.numpy(), everything.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(moments.var.numpy(), everything.var(axis=0), rtol=1e-9)
    assert moments.count == 120
