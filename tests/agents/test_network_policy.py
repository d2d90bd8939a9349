"""Policies: what their networks compute, their files, and what is refused."""

from __future__ import annotations

import dataclasses
import itertools
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from octoarm_agents.policies import Lstm, Network, Policy, load_policy
from octoarm_agents.policies.network import Past
from octoarm_agents.reservoir import Readout, readout_network

from octoarm_env import ArmParameters

SPRINGS = 80
SETTINGS = {
    "target": "quadratic",
    "amplitude": 90.0,
    "control_period": 0.01,
    "actuator": "direct",
    "action_range": 117.0,
}


SCALE = np.full(SPRINGS, 20.0)


def make_network(
    widths: tuple[int, ...] = (16, 8), *, memory: int = 0, output: str = "clip", **changes: Any
) -> Network:
    random = np.random.default_rng(0)

    def numbers(*shape: int) -> np.ndarray:
        return random.normal(size=shape, scale=0.5).astype(np.float32)

    sizes = (memory or SPRINGS, *widths, 2)
    layers = tuple(
        (numbers(after, before), numbers(after)) for before, after in itertools.pairwise(sizes)
    )
    lstm = None
    if memory:
        lstm = Lstm(numbers(4 * memory, SPRINGS), numbers(4 * memory, memory), numbers(4 * memory))
    fields = {
        "mean": np.full(SPRINGS, 0.02),
        "scale": np.full(SPRINGS, 1e3),
        "clip": 10.0,
        "layers": layers,
        "activation": "tanh",
        "output": output,
        "memory": lstm,
    }
    return Network(**(fields | changes))


def make_policy(network: Network | None = None, **settings: Any) -> Policy:
    return Policy(
        network or make_network(), "ppo", ArmParameters(), SETTINGS | settings, {"steps": 10}, 3
    )


def lengths(*shape: int) -> np.ndarray:
    return 0.02 + 1e-3 * np.random.default_rng(1).normal(size=(*shape, SPRINGS))


def test_a_network_by_hand() -> None:
    network = make_network((3,), output="tanh")
    (first, bias), (second, last) = network.layers
    seen = lengths()
    hidden = np.tanh(first @ np.clip((seen - 0.02) * 1e3, -10, 10) + bias)
    expected = np.tanh(second @ hidden + last)
    action, state = make_policy(network).predict(seen)
    assert state is None
    assert action.dtype == np.float32
    np.testing.assert_allclose(action, expected, rtol=1e-5)


def test_outputs_are_clipped() -> None:
    actions, _ = make_policy().predict(lengths(200))
    assert actions.shape == (200, 2)
    assert np.abs(actions).max() == 1.0


def test_rows_are_independent() -> None:
    for memory in (0, 5):
        policy = make_policy(make_network((8,), memory=memory))
        rows = lengths(6)
        together, _ = policy.predict(rows)
        for row, action in zip(rows, together, strict=True):
            alone, _ = policy.predict(row)
            np.testing.assert_allclose(alone, action, rtol=1e-5, atol=1e-6)


def test_memory_is_carried_and_emptied() -> None:
    policy = make_policy(make_network((8,), memory=5))
    rows = lengths(2)
    first, state = policy.predict(rows)
    second, state = policy.predict(rows, state, np.zeros(2, dtype=bool))
    assert not np.allclose(first, second)
    # The first episode begins anew, the second goes on.
    third, _ = policy.predict(rows, state, np.array([True, False]))
    np.testing.assert_array_equal(third[0], first[0])
    assert not np.allclose(third[1], first[1])


def test_the_past_is_carried_and_begins_anew(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    layer = (random.normal(size=(2, 3 * SPRINGS)), random.normal(size=2))
    whole = Network(np.full(SPRINGS, 0.02), SCALE, 1e9, (layer,), memory=Past(2))
    policy = make_policy(whole)
    policy.save(tmp_path / "past.npz")
    policy = Policy.load(tmp_path / "past.npz")
    assert policy.network.memory == Past(2)
    assert policy.parameter_count == 2 * (3 * SPRINGS + 1)
    rows, state, seen = lengths(5, 2), None, []
    begins = np.array([[True, True], [False, False], [False, False], [False, True], [False, False]])
    for now, begin in zip(rows, begins, strict=True):
        action, state = policy.predict(now, state, begin)
        seen.append(action)

    def expected(*latest_first: int, episode: int) -> np.ndarray:
        read = np.concatenate([(rows[step, episode] - 0.02) * SCALE for step in latest_first])
        return np.clip(layer[0] @ read + layer[1], -1, 1)

    for step, episode, read in (
        (0, 0, (0, 0, 0)),
        (1, 0, (1, 0, 0)),
        (4, 0, (4, 3, 2)),
        (3, 1, (3, 3, 3)),
        (4, 1, (4, 3, 3)),
    ):
        np.testing.assert_allclose(
            seen[step][episode], expected(*read, episode=episode), rtol=1e-5, atol=1e-6
        )


def test_parameters_are_counted() -> None:
    assert make_policy(make_network((16, 8))).parameter_count == 81 * 16 + 17 * 8 + 9 * 2
    lstm = 4 * 5 * (80 + 5 + 1)
    assert make_policy(make_network((8,), memory=5)).parameter_count == lstm + 6 * 8 + 9 * 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"activation": "gelu"}, "activation = 'gelu'"),
        ({"output": "none"}, "output = 'none'"),
        ({"clip": 0.0}, "clip = 0.0"),
        ({"layers": ()}, "layers is empty"),
        ({"mean": np.full(SPRINGS, np.nan)}, "not finite"),
        ({"scale": np.ones(3)}, r"\(3,\)"),
        ({"layers": ((np.ones((2, 7), np.float32), np.ones(2, np.float32)),)}, "80 inputs"),
    ],
)
def test_bad_networks(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_network(**changes)


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        (np.ones(79), r"shape \(79,\)"),
        (np.ones((2, 2, 80)), r"shape \(2, 2, 80\)"),
        (np.full(80, np.nan), "not finite"),
    ],
)
def test_bad_observations(observation: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_policy().predict(observation)


def test_a_policy_fits_its_body() -> None:
    with pytest.raises(ValueError, match="80 lengths, the body has 40 springs"):
        Policy(make_network(), "ppo", ArmParameters(compartments=10), SETTINGS)
    with pytest.raises(ValueError, match="settings holds"):
        Policy(make_network(), "ppo", ArmParameters(), {"target": "quadratic"})


@pytest.mark.parametrize("memory", [0, 5])
def test_file_round_trip(tmp_path: Path, memory: int) -> None:
    policy = make_policy(make_network((8,), memory=memory))
    policy.save(tmp_path / "policy.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["policy.npz"]
    loaded = load_policy(tmp_path / "policy.npz")
    assert (loaded.algorithm, loaded.seed, loaded.training) == ("ppo", 3, {"steps": 10})
    assert loaded.settings == policy.settings
    assert loaded.parameters == policy.parameters
    first, state = policy.predict(lengths(4))
    second, other = loaded.predict(lengths(4))
    np.testing.assert_array_equal(first, second)
    if memory:
        np.testing.assert_array_equal(
            policy.predict(lengths(4), state)[0], loaded.predict(lengths(4), other)[0]
        )


def rewrite(path: Path, **changes: Any) -> None:
    """Change entries of a file's description, or its arrays."""
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    description = json.loads(str(arrays["description"]))
    for name, value in changes.items():
        if name in description:
            description[name] = value
        elif value is None:
            del arrays[name]
        else:
            arrays[name] = value
    arrays["description"] = np.array(json.dumps(description))
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, 'lacks "format"'),
        ({"version": 2}, "version = 2: this release reads version 1"),
        ({"version": True}, "version = True"),
        ({"id": "OctoArm-v9"}, "'OctoArm-v9', expected 'OctoArm-v0'"),
        ({"observation": {"layout": "strains"}}, "observation layout = 'strains'"),
        ({"observation": 3}, "observation layout = None"),
        ({"seed": "x"}, "seed = 'x'"),
        ({"environment": []}, "environment ="),
        ({"body": {}}, "body lacks"),
        ({"network": {"layers": 0}}, "layers = 0"),
        ({"network": {"layers": 2, "memory": 0, "clip": 10.0}}, "'activation' is missing"),
        ({"weights_0": None}, "is missing"),
        ({"weights_0": np.ones((3, 3), np.float32)}, "layers"),
        ({"mean": np.full(80, np.inf)}, "not finite"),
    ],
)
def test_damaged_files(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = tmp_path / "policy.npz"
    make_policy().save(path)
    rewrite(path, **changes)
    with pytest.raises(ValueError, match=message) as caught:
        load_policy(path)
    assert str(path) in str(caught.value)


def test_cut_and_foreign_files(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    make_policy().save(path)
    whole = path.read_bytes()
    # Wherever it is cut, and whatever else it is.
    for content in (b"", b"PK", whole[:100], whole[: len(whole) // 2], whole[:-1], b"no archive"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"policy\.npz"):
            load_policy(path)
    np.savez(path, numbers=np.ones(3))
    with pytest.raises(ValueError, match="lacks a description"):
        load_policy(path)
    with pytest.raises(FileNotFoundError):
        load_policy(tmp_path / "missing.npz")
    (tmp_path / "readout.json").write_text("{}", encoding="utf-8")
    with pytest.raises(ValueError, match=r"readout.json: readouts in JSON .* teach it again"):
        load_policy(tmp_path / "readout.json")


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("policy.json", {}, r"expected a name that ends in \.npz"),
        ("policy.npz", {"steps": float("nan")}, "cannot be written as JSON"),
        ("policy.npz", {"seeds": np.ones(2)}, "cannot be written as JSON"),
    ],
)
def test_what_cannot_be_saved_leaves_the_old_file(
    tmp_path: Path, name: str, changes: dict[str, Any], message: str
) -> None:
    (tmp_path / name).write_bytes(b"old")
    policy = make_policy()
    policy.training |= changes
    with pytest.raises(ValueError, match=message):
        policy.save(tmp_path / name)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"old"]


def test_networks_of_before_are_read(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    make_policy().save(path)
    rewrite(path, format="octoarm-network")
    np.testing.assert_array_equal(
        load_policy(path).predict(lengths())[0], make_policy().predict(lengths())[0]
    )


@pytest.mark.parametrize("bias", [False, True])
def test_a_readout_acts_in_double_precision(tmp_path: Path, bias: bool) -> None:
    """Its weights are large and cancel each other, in the order of summation that they have."""
    random = np.random.default_rng(2)
    # Springs that move together, a billionth of their length apart.
    seen = 0.02 + 1e-3 * random.normal(size=(500, 1)) + 1e-10 * random.normal(size=(500, SPRINGS))
    targets = 0.5 * np.tanh(1e10 * (seen[:, :2] - seen[:, 2:4]))
    readout = Readout(bias=bias).fit(seen, targets)
    assert np.abs(readout.weights_).max() > 1e8
    policy = Policy(readout_network(readout), "readout", ArmParameters(), SETTINGS)
    assert policy.parameter_count == 160 + 2 * bias
    expected = np.clip(seen @ readout.weights_[:80] + readout.weights_[80:].sum(axis=0), -1, 1)
    policy.save(tmp_path / "policy.npz")
    for each in (policy, load_policy(tmp_path / "policy.npz")):
        actions, state = each.predict(seen, ("state",))
        np.testing.assert_array_equal(actions, expected.astype(np.float32))
        np.testing.assert_allclose(each.predict(seen[0])[0], actions[0], atol=1e-4)
        assert state == ("state",)


def test_other_readouts_are_no_policies() -> None:
    with pytest.raises(ValueError, match="readout is not fitted"):
        readout_network(Readout())
    network = readout_network(Readout().fit(np.ones((9, 80)), np.ones((9, 3))))
    with pytest.raises(ValueError, match="layers lead to 3 outputs, expected 2"):
        dataclasses.replace(make_policy(), network=network)


def test_no_pickle_is_read(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    make_policy().save(path)
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    arrays["mean"] = np.array([object()], dtype=object)
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match="allow_pickle=False"):
        load_policy(path)


def test_other_environments_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    env = gym.make("OctoArm-v0", reward_width=0.1, max_episode_steps=50)
    # Rewards and the length of episodes may differ; the default amplitude is that of the file.
    make_policy().save(path)
    load_policy(path, gym.wrappers.ClipAction(env))
    with pytest.raises(ValueError, match=r"observations .*expected the spring lengths"):
        load_policy(path, gym.wrappers.FrameStackObservation(env, 2))
    with pytest.raises(TypeError, match="OctoArm-v0"):
        load_policy(path, gym.make("Pendulum-v1"))
    make_policy(target="lissajous", amplitude=10.0).save(path)
    with pytest.raises(
        ValueError, match="target is 'lissajous' in the file and 'quadratic' where.* amplitude is"
    ) as caught:
        load_policy(path, env)
    assert str(path) in str(caught.value)
    rewrite(path, body=ArmParameters(arm_density=1100.0).to_dict())
    with pytest.raises(ValueError, match=r"another body: arm_density is 1100\.0 in the file and"):
        load_policy(path, env)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("control_period", 0.02, "control_period is 0.01 in the file and 0.02 where"),
        ("actuator", "servo", "actuator is 'direct' in the file and 'servo' where"),
        ("action_range", 22.0, r"environment: action_range is 117\.0 in the file and 22\.0 where"),
    ],
)
def test_other_settings_are_refused(tmp_path: Path, name: str, value: Any, message: str) -> None:
    make_policy().save(tmp_path / "policy.npz")
    with pytest.raises(ValueError, match=message):
        load_policy(tmp_path / "policy.npz", settings={name: value})


def test_policies_act_without_what_trained_them(tmp_path: Path) -> None:
    make_policy().save(tmp_path / "policy.npz")
    code = (
        "import sys, numpy; from octoarm_agents.policies import load_policy;"
        f"load_policy({str(tmp_path / 'policy.npz')!r}).predict(numpy.full(80, 0.02));"
        "print({'torch', 'sklearn'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
