"""The environments in torchrl; docs/clients.md says what is shown here."""

from __future__ import annotations

import multiprocessing
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import octoarm_env
from octoarm_env.wrappers import Strain

torch = pytest.importorskip("torch")


def torchrl_envs() -> Any:
    """Import torchrl's environments, and undo that it says how this whole process starts others."""
    before = multiprocessing.get_start_method(allow_none=True)
    found = pytest.importorskip("torchrl.envs")
    multiprocessing.set_start_method(before, force=True)
    return found


envs = torchrl_envs()

INFOS = {
    *("base_angles", "target", "tracking_error", "reward_tracking", "reward_action_change"),
    "body",
}


def check(env: Any, steps: int) -> Any:
    """Check the specs with and without a reset on the way; the data of a run over many ends."""
    torch.manual_seed(0)
    envs.check_env_specs(env, seed=0)
    envs.check_env_specs(env, break_when_any_done=False)
    run = env.rollout(steps, break_when_any_done=False)
    assert run.shape[-1] == steps
    assert bool(run["next", "done"].any())
    return run


@pytest.mark.parametrize("strain", [False, True])
def test_single_environment(strain: bool) -> None:
    env = gym.make("OctoArm-v0", max_episode_steps=7)
    wrapped = envs.GymWrapper(Strain(env) if strain else env).auto_register_info_dict()
    run = check(wrapped, 30)
    assert set(run["next"].keys()) >= INFOS


@pytest.mark.parametrize("strain", [False, True])
def test_batch_that_is_reset_by_torchrl(strain: bool) -> None:
    batch = gym.make_vec(
        "OctoArm-v0", num_envs=3, max_episode_steps=7, autoreset_mode=AutoresetMode.DISABLED
    )
    wrapped = envs.GymWrapper(Strain(batch) if strain else batch).auto_register_info_dict()
    run = check(wrapped, 30)
    assert set(run["next"].keys()) >= INFOS


def test_batch_that_resets_itself() -> None:
    options = {"num_envs": 3, "max_episode_steps": 7, "autoreset_mode": AutoresetMode.SAME_STEP}
    wrapped = envs.GymWrapper(Strain(gym.make_vec("OctoArm-v0", **options)))
    run = check(wrapped, 30)
    assert set(run["next"].keys()) >= INFOS
    # What comes next at an end is the episode's own last observation and info.
    actions = run["action"].numpy()
    left = list(run["action"].unbind(1))
    twin = Strain(gym.make_vec("OctoArm-v0", **options))
    wrapped.set_seed(5)
    twin.reset(seed=5)
    twin.reset()  # as a rollout does at its begin
    run = wrapped.rollout(30, policy=lambda *_: left.pop(0), break_when_any_done=False)
    ends = 0
    for step in range(30):
        strains, _, _, truncated, infos = twin.step(actions[:, step])
        for index in range(3):
            errors = infos["tracking_error"]
            if truncated[index]:
                ends += 1
                strains[index] = infos["final_obs"][index]
                errors = infos["final_info"]["tracking_error"]
            found = run["next"][index, step]
            np.testing.assert_array_equal(found["observation"].numpy(), strains[index])
            assert found["tracking_error"].item() == errors[index]
        if truncated.all():
            twin.reset()  # as torchrl does where all have ended
    assert ends == 12


def test_the_page_s_example_runs_as_printed(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "clients.md").read_text(encoding="utf-8")
    (code,) = (code for code in re.findall(r"```python\n(.*?)```", page, re.S) if "torchrl" in code)
    exec(code, {})
    assert "torch.Size([8, 1000, 1])" in capsys.readouterr().out


class Lengths(gym.Env):
    """An environment of somebody else whose observations, as lengths, are never 0."""

    observation_space = spaces.Box(1.0, 2.0, (1,))
    action_space = spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return np.ones(1, np.float32), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return np.ones(1, np.float32), 0.0, False, False, {}


def test_what_torchrl_itself_does_not_take() -> None:
    """Both are torchrl's, whoever's environment it is; docs/clients.md names the way round."""
    for make in (lambda: gym.make("OctoArm-v0"), Lengths):
        batch = SyncVectorEnv([make] * 2, autoreset_mode=AutoresetMode.NEXT_STEP)
        with pytest.raises(RuntimeError, match="must be one of SAME_STEP or DISABLED"):
            envs.GymWrapper(batch)
        # It fills up the last observations with zeros, and then finds them outside the space.
        batch = SyncVectorEnv([make] * 2, autoreset_mode=AutoresetMode.SAME_STEP)
        with pytest.raises(AssertionError, match="spec check failed"):
            envs.GymWrapper(batch)
    for mode, error in (
        (AutoresetMode.NEXT_STEP, "must be one of SAME_STEP or DISABLED"),
        (AutoresetMode.SAME_STEP, "spec check failed"),
    ):
        with pytest.raises((RuntimeError, AssertionError), match=error):
            envs.GymWrapper(gym.make_vec("OctoArm-v0", num_envs=2, autoreset_mode=mode))
    assert octoarm_env.OctoArmVectorEnv(2).autoreset_mode is AutoresetMode.NEXT_STEP


@pytest.mark.parametrize("batch", [False, True])
def test_reaching(batch: bool) -> None:
    """The specs of the goal environment, alone and in a batch."""
    make: Any = gym.make_vec if batch else gym.make
    more = {"num_envs": 3, "autoreset_mode": AutoresetMode.DISABLED} if batch else {}
    env = envs.GymWrapper(make("OctoArmReach-v0", max_episode_steps=5, **more))
    envs.check_env_specs(env, seed=0)
    env.close()
