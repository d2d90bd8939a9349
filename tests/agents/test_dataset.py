"""`octoarm dataset`, and the page about it."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from documents import check_links, code_blocks, run_python
from octoarm_agents.cli.policy_names import NamedPolicy
from octoarm_agents.common.environment import inspect_env
from octoarm_agents.policies import load_trained
from octoarm_agents.policies.evaluation import NAMED

minari = pytest.importorskip("minari", reason='needs pip install "./agents[dataset]"')

from octoarm_agents.policies.dataset import DatasetSettings, record_dataset  # noqa: E402

PAGE = "docs/dataset.md"


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Where Minari keeps its data sets."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


def record(octoarm: Any, *arguments: object) -> Any:
    done = octoarm("dataset", *arguments)
    assert done.exit_code == 0, done.output
    name = done.output.split('"')[1]
    return minari.load_dataset(name)


@pytest.mark.parametrize("policy", ["ppo/lissajous", "readout_pinv/lissajous", "random/lissajous"])
def test_the_environment_repeats_what_was_recorded(octoarm: Any, policy: str) -> None:
    data = record(octoarm, policy, "--episodes", 3, "--steps", 20, "--seed", 7, "--action-noise", 1)
    assert data.spec.dataset_id == f"octoarm/lissajous/{policy.removesuffix('/lissajous')}-v0"
    assert (data.total_episodes, data.total_steps) == (3, 60)
    assert sorted(minari.list_local_datasets()) == [data.spec.dataset_id]
    env = data.recover_environment()
    assert env.spec.kwargs["target"] == "lissajous"
    assert env.spec.max_episode_steps == 20
    seeds = [each["seed"] for each in data.storage.get_episode_metadata(range(3))]
    assert seeds == [7, 8, 9]
    for seed, episode in zip(seeds, data, strict=True):
        observation, info = env.reset(seed=seed)
        steps = [(observation, info)]
        for index, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, info = env.step(action)
            steps.append((observation, info))
            assert reward == episode.rewards[index]
            assert terminated == episode.terminations[index]
            assert truncated == episode.truncations[index]
        assert truncated
        assert np.array_equal(episode.observations, [lengths for lengths, _ in steps])
        assert sorted(episode.infos) == sorted(info)
        for key, values in episode.infos.items():
            assert np.array_equal(values, [info[key] for _, info in steps])


def test_noise_is_in_the_actions_and_drawn_from_the_seed(octoarm: Any) -> None:
    def actions(name: str, *arguments: object) -> Any:
        few = ("--episodes", 2, "--steps", 30, "--name", name)
        return np.stack(
            [each.actions for each in record(octoarm, "clock/quadratic", *few, *arguments)]
        )

    plain = actions("plain-v0")
    shaken = actions("shaken-v0", "--action-noise", 2)
    again = actions("again-v0", "--action-noise", 2)
    other = actions("other-v0", "--action-noise", 2, "--seed", 5)
    assert np.array_equal(shaken, again)
    assert not np.array_equal(shaken, other)
    # 2 degrees of a range of 1.3 times 90.
    difference = np.abs(shaken - plain)
    assert difference.min() > 0
    assert 1.5 / 117 < difference.max() <= 2 / 117 + 1e-6


def test_arms_that_fail_end_their_episodes() -> None:
    env = gym.make("OctoArm-v0", arm="inertial", actuator="servo", amplitude=20.0, action_range=180)
    home = NamedPolicy("random", "random", *inspect_env(env))
    data = record_dataset("failing-v0", "random", home, DatasetSettings(episodes=5, steps=100))
    ends = {len(each.rewards): (each.terminations, each.truncations) for each in data}
    assert min(ends) < 100
    for length, (terminations, truncations) in ends.items():
        assert terminations.tolist() == [False] * (length - 1) + [length < 100]
        assert truncations.tolist() == [False] * (length - 1) + [length == 100]
    for each in data:
        assert len(each.observations) == len(each.rewards) + 1 == len(each.infos["target"])
        assert np.isfinite(each.observations).all()
    again = data.recover_environment().unwrapped
    assert again.settings == env.unwrapped.settings  # type: ignore[attr-defined]


def test_long_episodes_are_recorded_one_after_the_other(
    octoarm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same episodes, however many fit into memory."""
    arguments = ("hold/lissajous", "--episodes", 3, "--steps", 20)
    together = record(octoarm, *arguments, "--name", "together-v0")
    monkeypatch.setattr("octoarm_agents.policies.dataset._ROWS", 45)
    apart = record(octoarm, *arguments, "--name", "apart-v0")
    for one, other in zip(together, apart, strict=True):
        assert np.array_equal(one.observations, other.observations)


def test_a_name_is_taken_once(octoarm: Any) -> None:
    few = ("hold/quadratic", "--episodes", 1, "--steps", 10)
    data = record(octoarm, *few)
    done = octoarm("dataset", *few)
    assert done.exit_code == 2
    assert "octoarm/quadratic/hold-v0 exists; choose another name or version" in done.output
    assert len(minari.load_dataset(data.spec.dataset_id)) == 1


@pytest.mark.parametrize("name", ["", "a b-v0", "../up-v0", "/tmp/x-v0"])
def test_bad_names(octoarm: Any, folder: Path, name: str) -> None:
    done = octoarm("dataset", "hold/quadratic", "--name", name, "--episodes", 1, "--steps", 10)
    assert done.exit_code == 2
    assert "Malformed dataset ID" in done.output
    assert list(folder.iterdir()) == []


def test_a_file_needs_a_name(octoarm: Any, tmp_path: Path) -> None:
    load_trained("readout_pinv", "lissajous").save(tmp_path / "mine.npz")
    few = ("--episodes", 1, "--steps", 10)
    done = octoarm("dataset", tmp_path / "mine.npz", *few)
    assert done.exit_code == 2
    assert "mine.npz needs a name" in done.output
    assert record(octoarm, tmp_path / "mine.npz", *few, "--name", "mine-v0").total_steps == 10


@dataclass
class Interrupted:
    """A policy during whose third step somebody presses Ctrl-C."""

    steps: list[int] = field(default_factory=list)

    def predict(self, observation: Any, *_: Any, **__: Any) -> Any:
        self.steps.append(len(observation))
        if len(self.steps) == 3:
            raise KeyboardInterrupt
        return np.zeros((len(observation), 2)), None


def test_an_interrupt_leaves_nothing(
    octoarm: Any, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("octoarm_agents.policies.dataset.acting", lambda *_, **__: Interrupted())
    done = octoarm("dataset", "hold/quadratic", "--episodes", 2, "--steps", 10)
    assert done.exit_code == 130
    assert "nothing was written" in done.output
    assert [path for path in folder.rglob("*") if path.is_file()] == []
    assert minari.list_local_datasets() == {}


def test_without_minari(octoarm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "octoarm_agents.policies.dataset", raising=False)
    monkeypatch.setitem(sys.modules, "minari", None)
    done = octoarm("dataset", "hold/quadratic")
    assert done.exit_code == 1
    assert 'pip install "octoarm-agents[dataset]"' in done.output


@pytest.mark.parametrize("kind", NAMED)
def test_every_named_agent_acts(octoarm: Any, kind: str) -> None:
    data = record(octoarm, f"{kind}/lissajous", "--episodes", 1, "--steps", 10)
    assert np.abs(data[0].actions).max() <= 1


def test_the_page_s_clone_earns_what_it_says(octoarm: Any, tmp_path: Path) -> None:
    (command,), (code,) = code_blocks(PAGE, "sh"), code_blocks(PAGE, "python")
    program, *arguments = shlex.split(command)
    assert (program, arguments[0]) == ("octoarm", "dataset")
    record(octoarm, *arguments[1:])
    (printed,) = code_blocks(PAGE, "text")
    assert run_python(code, tmp_path) == printed


def test_links_lead_somewhere() -> None:
    check_links(PAGE)
