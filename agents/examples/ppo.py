"""Proximal policy optimisation (PPO) of the octopus arm, all of it in this one file.

In the manner of CleanRL's `ppo_continuous_action.py`: what the method does is here to be read and
changed, and needs PyTorch, NumPy, Gymnasium (1.1 or newer) and octoarm_env, no framework::

    python agents/examples/ppo.py --target quadratic
    python agents/examples/ppo.py --target van_der_pol --steps 1_000_000 --seed 1 --out cycle.pt
    python agents/examples/ppo.py --help

300,000 steps take 40 seconds on one core (8,000 steps a second), the 500,000 of the default
setting 70. Measured after 200,000 steps (`--steps 200000`), over 16 episodes without noise, of 500
that can be earned (an untrained policy earns 3):

    quadratic     499.7, 499.8, 499.3 (seeds 0, 1, 2)
    van_der_pol   499.7 (seed 0)
    lissajous     498.3 (seed 0)

Episodes are cut after 100 steps in training, so that more of them begin on the orbit than in the
standard 500. On the Lissajous curve that decides it: with 500 (`--episode-steps 500`) PPO earns 32.

The arms are stepped natively, all at once. The same seed gives the same result on the same machine
and version of PyTorch. `--out` keeps weights, observation statistics and arguments; `load` below
makes the agent of them again.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from torch import Tensor, nn
from torch.distributions import Normal

import octoarm_env  # registers the environment

UPDATES_PER_LINE = 10
EVALUATION_SEED, EVALUATION_EPISODES = 10_000, 16


def make_envs(count: int, target: str, episode_steps: int = 500, threads: int = 1) -> VectorEnv:
    """Make the native batch of arms.

    In SAME_STEP mode the step that ends an episode already returns the first observation of the
    next one. So every step is a true transition; in NEXT_STEP mode, Gymnasium's default, the step
    after the end ignores its action, and must not be learnt from.
    """
    return gym.make_vec(
        "OctoArm-v0",
        num_envs=count,
        vectorization_mode="vector_entry_point",
        autoreset_mode=AutoresetMode.SAME_STEP,
        target=target,
        max_episode_steps=episode_steps,
        threads=threads,
    )


class Moments(nn.Module):
    """Mean and variance of all that has been seen so far, in double precision."""

    def __init__(self, *shape: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(shape, dtype=torch.float64))
        self.register_buffer("var", torch.zeros(shape, dtype=torch.float64))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    def update(self, batch: Tensor) -> None:
        """Take in a batch, one sample a row (Chan et al.'s parallel update)."""
        self.count += len(batch)
        share, shift = len(batch) / self.count, batch.mean(0) - self.mean
        self.mean += shift * share
        self.var += (batch.var(0, correction=0) - self.var + shift**2 * (1 - share)) * share


def network(inputs: int, outputs: int, last_gain: float) -> nn.Sequential:
    """Make a perceptron of two hidden layers, orthogonally initialised."""
    sizes, gains = (inputs, 128, 128, outputs), (math.sqrt(2), math.sqrt(2), last_gain)
    layers: list[nn.Module] = []
    for size_in, size_out, gain in zip(sizes[:-1], sizes[1:], gains, strict=True):
        linear = nn.Linear(size_in, size_out)
        nn.init.orthogonal_(linear.weight, gain)
        nn.init.zeros_(linear.bias)
        layers += [linear, nn.Tanh()]
    return nn.Sequential(*layers[:-1])


class Agent(nn.Module):
    """A Gaussian policy, its spread the same in all states, and a value function beside it."""

    def __init__(self, observation_len: int, action_len: int, log_std: float = -1.0) -> None:
        super().__init__()
        self.observed = Moments(observation_len)
        self.actor = network(observation_len, action_len, 0.01)
        self.critic = network(observation_len, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((action_len,), log_std))

    def normalize(self, observations: np.ndarray) -> Tensor:
        """Shift and scale to mean 0 and variance 1, within -10 to 10.

        Springs at the tip vary by no more than 0.0001 m: the usual 1e-8 in the place of 1e-12
        would be as large as their variance.
        """
        shifted = torch.as_tensor(observations) - self.observed.mean
        return (shifted / (self.observed.var + 1e-12).sqrt()).clamp(-10.0, 10.0).float()

    def policy(self, normalized: Tensor) -> Normal:
        """Give the distribution of actions; its mean is the deterministic policy."""
        # The check of the distribution's arguments costs more than the rest of it.
        return Normal(self.actor(normalized), self.log_std.exp(), validate_args=False)

    def value(self, normalized: Tensor) -> Tensor:
        """Give the expected discounted sum of (scaled) rewards."""
        return self.critic(normalized).squeeze(-1)


class Rollout(NamedTuple):
    """What `Collector.collect` has seen, (T, N, ...); observations normalised, rewards scaled.

    A next observation is of the same episode even where that ends. `terminated` is 1 where nothing
    is to be earned after the step, `ended` also where the time limit cut the episode: the next row
    is another one's.
    """

    observations: Tensor
    next_observations: Tensor
    actions: Tensor
    rewards: Tensor
    terminated: Tensor
    ended: Tensor


def gae(rollout: Rollout, values: Tensor, next_values: Tensor, gamma: float, lam: float) -> Tensor:
    """Estimate the advantage of every step (generalised advantage estimation), (T, N).

    Args:
        rollout: what was earned, and where episodes ended.
        values: of the observations, (T, N).
        next_values: of the next observations, (T, N).
        gamma: discount factor.
        lam: 0 trusts the values, 1 the rewards.
    """
    deltas = rollout.rewards + gamma * (1 - rollout.terminated) * next_values - values
    carry = gamma * lam * (1 - rollout.ended)
    advantages, following = torch.zeros_like(deltas), torch.zeros_like(deltas[0])
    for t in reversed(range(len(deltas))):
        following = deltas[t] + carry[t] * following
        advantages[t] = following
    return advantages


class Collector:
    """Steps the environments; normalises what they return; keeps count of episodes."""

    def __init__(self, envs: VectorEnv, agent: Agent, args: argparse.Namespace) -> None:
        self.envs, self.agent, self.args = envs, agent, args
        first, _ = envs.reset(seed=args.seed)
        self.observation = self._normalize(first)
        self.earned = Moments()
        self.discounted, self.totals = torch.zeros(2, envs.num_envs, dtype=torch.float64)
        self.returns: deque[float] = deque(maxlen=100)

    @torch.no_grad()
    def collect(self) -> Rollout:
        """Follow the policy for a number of steps in every environment."""
        rows = []
        for _ in range(self.args.num_steps):
            action = self.agent.policy(self.observation).sample()
            clamped = action.clamp(-1.0, 1.0).numpy()
            following, rewards, terminated, truncated, infos = self.envs.step(clamped)
            next_observation = self._normalize(following)
            # An episode cut short by the time limit would have gone on: its last step is worth
            # its reward and the value of where it led. That is `final_obs`; `following` is the
            # first observation of the next episode there. (Where it really ended, in `terminated`,
            # `gae` takes no value.) Episodes here nearly always end by the limit.
            true_next, cut = next_observation, truncated & ~terminated
            if cut.any():
                true_next = next_observation.clone()
                true_next[cut] = self.agent.normalize(np.stack(infos["final_obs"][cut]))
            scaled = self._scale(torch.as_tensor(rewards))
            ended = torch.as_tensor(terminated | truncated)
            ends = torch.as_tensor(terminated).float(), ended.float()
            rows.append((self.observation, true_next, action, scaled, *ends))
            self.returns.extend(self.totals[ended].tolist())
            self.totals[ended] = self.discounted[ended] = 0.0
            self.observation = next_observation
        return Rollout(*map(torch.stack, zip(*rows, strict=True)))

    def _normalize(self, observations: np.ndarray) -> Tensor:
        self.agent.observed.update(torch.as_tensor(observations))
        return self.agent.normalize(observations)

    def _scale(self, rewards: Tensor) -> Tensor:
        """Divide by the spread of the discounted return, so that values are of the order of 1."""
        self.totals += rewards
        self.discounted = self.discounted * self.args.gamma + rewards
        self.earned.update(self.discounted)
        return (rewards / (self.earned.var + 1e-8).sqrt()).clamp(-10.0, 10.0).float()


def update(
    agent: Agent, optimizer: torch.optim.Optimizer, rollout: Rollout, args: argparse.Namespace
) -> dict[str, float]:
    """Improve policy and value function by what has been collected; return figures to log."""
    with torch.no_grad():
        values = agent.value(rollout.observations)
        next_values = agent.value(rollout.next_observations)
        advantages = gae(rollout, values, next_values, args.gamma, args.gae_lambda)
        log_probs = agent.policy(rollout.observations).log_prob(rollout.actions).sum(-1)
        columns = (rollout.observations, rollout.actions, log_probs, advantages, values)
    observations, actions, old_log_probs, advantages, values = (
        column.flatten(0, 1) for column in columns
    )
    targets = values + advantages
    for _ in range(args.epochs):
        for chosen in torch.randperm(len(values)).split(args.minibatch):
            log_probs = agent.policy(observations[chosen]).log_prob(actions[chosen]).sum(-1)
            ratio = (log_probs - old_log_probs[chosen]).exp()
            advantage = advantages[chosen]
            advantage = (advantage - advantage.mean()) / (advantage.std(correction=0) + 1e-8)
            clipped = ratio.clamp(1 - args.clip, 1 + args.clip)
            policy_loss = -torch.min(advantage * ratio, advantage * clipped).mean()
            value_loss = nn.functional.mse_loss(agent.value(observations[chosen]), targets[chosen])
            optimizer.zero_grad()
            (policy_loss + 0.5 * value_loss).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), args.max_grad_norm)
            optimizer.step()
    spread = agent.log_std.exp().mean()
    last = {"policy_loss": policy_loss, "value_loss": value_loss, "action_std": spread}
    return {name: value.item() for name, value in last.items()}


@torch.no_grad()
def evaluate(agent: Agent, target: str) -> np.ndarray:
    """Run the policy without noise; return what each of the episodes earned."""
    envs = make_envs(EVALUATION_EPISODES, target)
    observation, _ = envs.reset(seed=EVALUATION_SEED)  # and the seeds after it
    totals, running = np.zeros(envs.num_envs), np.ones(envs.num_envs, bool)
    while running.any():
        action = agent.policy(agent.normalize(observation)).mean.clamp(-1.0, 1.0)
        observation, rewards, terminated, truncated, _ = envs.step(action.numpy())
        totals += rewards * running
        running &= ~(terminated | truncated)
    envs.close()
    return totals


def train(args: argparse.Namespace) -> Agent:
    """Train an agent."""
    torch.manual_seed(args.seed)
    envs = make_envs(args.num_envs, args.target, args.episode_steps, args.threads)
    agent = Agent(envs.single_observation_space.shape[0], envs.single_action_space.shape[0])
    optimizer = torch.optim.Adam(agent.parameters(), eps=1e-5)
    collector = Collector(envs, agent, args)
    writer = None
    if args.tensorboard:
        from torch.utils.tensorboard import SummaryWriter

        writer = SummaryWriter(args.tensorboard)
    steps_an_update = args.num_envs * args.num_steps
    updates = math.ceil(args.steps / steps_an_update)
    start = time.perf_counter()
    for done in range(1, updates + 1):
        learning_rate = args.learning_rate * (1 - (done - 1) / updates)
        optimizer.param_groups[0]["lr"] = learning_rate
        losses = update(agent, optimizer, collector.collect(), args)
        steps = done * steps_an_update
        speed = steps / (time.perf_counter() - start)
        # Of the last 100 episodes; none has ended in the very first steps.
        earned = np.mean(collector.returns) if collector.returns else math.nan
        if done % UPDATES_PER_LINE == 0 or done == updates:
            reward = f"reward {earned / args.episode_steps:.3f} a step"
            print(f"{steps:>9,} steps  {reward}  {speed:7,.0f} steps/s", flush=True)
        if writer:
            scalars = losses | {"learning_rate": learning_rate, "return": earned, "speed": speed}
            for name, value in scalars.items():
                if not math.isnan(value):
                    writer.add_scalar(name, value, steps)
    envs.close()
    if writer:
        writer.close()
    return agent


def save(path: Path, agent: Agent, args: argparse.Namespace) -> None:
    """Write weights, observation statistics and arguments. The file appears whole or not at all."""
    plain = vars(args) | {"out": str(path)}
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        torch.save({"agent": agent.state_dict(), "arguments": plain}, temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def load(path: Path) -> Agent:
    """Read the agent of such a file."""
    weights = torch.load(path, weights_only=True)["agent"]
    agent = Agent(len(weights["observed.mean"]), len(weights["log_std"]))
    agent.load_state_dict(weights)
    return agent


def number(kind: type[int] | type[float], low: float, high: float) -> Callable[[str], float]:
    """Make a reader of an argument that must lie in a range."""

    def read(text: str) -> float:
        name = "a whole number" if kind is int else "a number"
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: expected {name} from {low} to {high}")
        return value

    return read


def arguments(given: list[str] | None = None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description="PPO of the octopus arm, in one file.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    targets = list(octoarm_env.LIMIT_CYCLES)
    parser.add_argument("--target", default="quadratic", choices=targets, help="what to follow")
    for name, default, read, text in (
        ("steps", 500_000, number(int, 1, 10**12), "of all arms, rounded up to whole rollouts"),
        ("seed", 0, number(int, 0, 2**63 - 1), "of arms, weights and noise"),
        ("num-envs", 8, number(int, 1, 10_000), "arms stepped at once"),
        ("num-steps", 256, number(int, 1, 100_000), "steps of each arm from update to update"),
        ("episode-steps", 100, number(int, 1, 100_000), "after which a training episode is cut"),
        ("learning-rate", 1e-3, number(float, 0, 1), "at the start, falling linearly to 0"),
        ("gamma", 0.9, number(float, 0, 1), "discount factor"),
        ("gae-lambda", 0.95, number(float, 0, 1), "of the advantage estimate"),
        ("minibatch", 256, number(int, 2, 10**9), "steps a gradient is taken of"),
        ("epochs", 10, number(int, 1, 1000), "times each step is learnt from"),
        ("clip", 0.2, number(float, 0.001, 1), "of the ratio of new to old probability"),
        ("max-grad-norm", 0.5, number(float, 0.001, 1000), "largest norm of a gradient"),
        ("threads", 1, number(int, 1, 1024), "of PyTorch and of the arms"),
    ):
        parser.add_argument(f"--{name}", type=read, default=default, metavar="X", help=text)
    parser.add_argument("--out", type=Path, metavar="FILE", help="where to keep the checkpoint")
    parser.add_argument("--tensorboard", metavar="DIR", help="where to log, with tensorboard")
    args = parser.parse_args(given)
    if args.out and (args.out.is_dir() or not args.out.parent.is_dir()):
        parser.error(f"argument --out: '{args.out}': expected a file in a folder that exists")
    if args.tensorboard and not importlib.util.find_spec("tensorboard"):
        parser.error("argument --tensorboard: the package tensorboard is not installed")
    return args


def main() -> None:
    """Train, evaluate, and keep the result."""
    args = arguments()
    torch.set_num_threads(args.threads)
    agent = train(args)
    if args.out:
        save(args.out, agent, args)
    earned = evaluate(agent, args.target)
    print(f"lowest of {len(earned)} episodes {earned.min():.1f}")
    print(f"return {earned.mean():.1f} of 500")


if __name__ == "__main__":
    main()
