"""The batch on a server: every bit of the local one, in every mode."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from clients import WithoutDisturbances, assert_same, nothing_left, step_request
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from octoarm_agents.common.serving import ServerProcess

from octoarm_env import ArmParameters, OctoArmVectorEnv
from octoarm_env.remote import RemoteOctoArmVectorEnv
from octoarm_env.testing import check_vector_env

MODES = list(AutoresetMode)
FAILING: dict[str, Any] = {
    "arm": ArmParameters.preset("inertial"),
    "actuator": "servo",
    "amplitude": 30.0,
    "action_range": 180.0,
}
"""Settings under which hasty actions drive arms out of their domain."""

Make = Callable[..., RemoteOctoArmVectorEnv]


@pytest.fixture
def make(server: ServerProcess) -> Iterator[Make]:
    made: list[RemoteOctoArmVectorEnv] = []

    def make(num_envs: int, **arguments: Any) -> RemoteOctoArmVectorEnv:
        made.append(RemoteOctoArmVectorEnv(num_envs, server.address, **arguments))
        return made[-1]

    yield make
    for envs in made:
        envs.close()


@pytest.mark.parametrize(
    "disturbed",
    [{}, {"length_noise": 1e-5, "delay": 2}, {"vary": {"arm_density": (0.9, 1.1)}, "bodies": 9}],
    ids=str,
)
@pytest.mark.parametrize("mode", MODES)
def test_conformance(server: ServerProcess, mode: AutoresetMode, disturbed: dict[str, Any]) -> None:
    options: dict[str, Any] = {"max_episode_steps": 7, **disturbed}
    envs = gym.make_vec(
        "OctoArmRemote-v0", num_envs=3, address=server.address, autoreset_mode=mode, **options
    )
    try:
        made = lambda: WithoutDisturbances(gym.make("OctoArm-v0", **options))  # noqa: E731
        check_vector_env(envs, made, steps=40)
    finally:
        envs.close()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    ("count", "steps", "arguments"),
    [
        (11, 1_000, {"max_episode_steps": 90}),
        (3, 500, FAILING),
        (2, 100, {"max_episode_steps": 9, "threads": 1}),
    ],
    ids=["many", "failing", "small"],
)
def test_every_bit_is_the_local_one(
    make: Make, mode: AutoresetMode, count: int, steps: int, arguments: dict[str, Any]
) -> None:
    arguments = {"max_episode_steps": 40, **arguments, "autoreset_mode": mode}
    remote, local = make(count, **arguments), OctoArmVectorEnv(count, **arguments)
    for name in ("observation_space", "action_space", "single_observation_space", "metadata"):
        assert getattr(remote, name) == getattr(local, name)
    random = np.random.default_rng(1)
    assert_same(remote.reset(seed=11), local.reset(seed=11))
    snapshots = [(remote.snapshot(), local.snapshot())]
    failures = ends = 0
    for step in range(steps):
        # A few steps in one direction, then in another.
        if step % 10 == 0:
            actions = random.choice([-1.0, 1.0], (count, 2)) * random.random()
        found = remote.step(actions.astype(np.float32) if step % 2 else actions)
        expected = local.step(actions.astype(np.float32) if step % 2 else actions)
        assert_same(found, expected)
        ended = expected[2] | expected[3]
        failures, ends = failures + expected[2].sum(), ends + ended.sum()
        kind = random.random()
        if mode is AutoresetMode.DISABLED and ended.any():
            options: dict[str, Any] = {"reset_mask": ended | (random.random(count) < 0.1)}
            seeds = [int(each) if each % 2 else None for each in random.integers(2**40, size=count)]
            assert_same(
                remote.reset(seed=seeds, options=options), local.reset(seed=seeds, options=options)
            )
        elif kind < 0.01:
            assert_same(remote.reset(), local.reset())
        elif kind < 0.02:
            options = {"phase": random.random(), "reset_mask": random.random(count) < 0.6}
            options["reset_mask"][0] = True
            assert_same(remote.reset(options=options), local.reset(options=options))
        elif kind < 0.03:
            snapshots.append((remote.snapshot(), local.snapshot()))
        elif kind < 0.04:
            one, other = snapshots[int(random.integers(len(snapshots)))]
            remote.restore(one)
            local.restore(other)
    assert ends > 10
    assert (failures > 0) == ("arm" in arguments)
    assert_same(remote.teacher_actions(), local.teacher_actions())
    assert remote.np_random_seed == local.np_random_seed
    names = ("action_range", "amplitude", "period", "orbit", "arm_joints", "arm_positions")
    for name in names:
        assert_same(remote.get_attr(name), local.get_attr(name))


def test_resets_of_some_before_all(make: Make) -> None:
    remote, local = make(3), OctoArmVectorEnv(3)
    some = {"reset_mask": np.array([True, False, True])}
    rest = {"reset_mask": ~some["reset_mask"]}
    outcomes = []
    for envs in (remote, local):
        with pytest.raises(ValueError, match="step of environment 0: no episode runs") as caught:
            envs.step(np.zeros((3, 2)))
        errors = [str(caught.value)]
        first = envs.reset(seed=1, options=some)[1]
        with pytest.raises(ValueError, match="step of environment 1: no episode runs") as caught:
            envs.step(np.zeros((3, 2)))
        errors.append(str(caught.value))
        outcomes.append((*errors, first, envs.reset(seed=5, options=rest)))
    assert_same(*outcomes)
    assert_same(remote.step(np.zeros((3, 2))), local.step(np.zeros((3, 2))))


def test_refusals_are_the_local_ones(make: Make) -> None:
    mode = AutoresetMode.DISABLED
    remote = make(2, max_episode_steps=1, autoreset_mode=mode)
    local = OctoArmVectorEnv(2, max_episode_steps=1, autoreset_mode=mode)
    still = np.zeros((2, 2), np.float32)
    calls: list[Callable[[OctoArmVectorEnv], Any]] = [
        lambda envs: envs.step(still),
        lambda envs: envs.reset(options={"phase": 1.5}),
        lambda envs: envs.reset(seed=[1, 2, 3]),
        lambda envs: envs.reset(options={"reset_mask": [True, True]}),
        lambda envs: envs.reset(seed=0)[0].tobytes(),
        lambda envs: envs.step(np.zeros((2, 3))),
        lambda envs: envs.step(np.full((2, 2), 1.5)),
        lambda envs: envs.step(np.full((2, 2), np.nan)),
        lambda envs: envs.step("left"),
        lambda envs: envs.step(still)[0].tobytes(),
        lambda envs: envs.step(still),
        lambda envs: envs.restore("here"),
        lambda envs: envs.set_attr("target", "lissajous"),
        lambda envs: envs.reset()[0].tobytes(),
    ]
    for call in calls:
        outcomes = []
        for envs in (remote, local):
            try:
                outcomes.append(call(envs))
            except (ValueError, TypeError, AttributeError) as error:
                outcomes.append((type(error), str(error).replace("OctoArmRemote", "OctoArm")))
        assert outcomes[0] == outcomes[1]


def test_a_world_has_one_of_everything(server: ServerProcess) -> None:
    for name, values in (
        ("target", ["quadratic", "lissajous"]),
        ("amplitude", [10.0, 20.0]),
        ("arm", ["nakajima2013", "inertial"]),
    ):
        with pytest.raises(ValueError, match=f"{name}: a world of a server has one for all"):
            RemoteOctoArmVectorEnv(2, server.address, **{name: values})
    with pytest.raises(ValueError, match=r"num_envs = 100000 is outside the allowed range"):
        RemoteOctoArmVectorEnv(100_000, server.address)


def test_copies_go_on_where_it_stands(make: Make) -> None:
    remote, local = make(3), OctoArmVectorEnv(3)
    assert_same(remote.reset(seed=4), local.reset(seed=4))
    actions = np.full((3, 2), 0.25)
    for _ in range(5):
        remote.step(actions)
        local.step(actions)
    copies = [copy.deepcopy(remote), pickle.loads(pickle.dumps(remote))]
    for envs in (remote, *copies):
        twin = copy.deepcopy(local)
        for _ in range(3):
            assert_same(envs.step(actions), twin.step(actions))
        assert_same(envs.reset(), twin.reset())
    for envs in copies:
        envs.close()


def test_snapshots_are_compact_and_those_of_the_local_batch_are_taken(make: Make) -> None:
    remote, local = make(9), OctoArmVectorEnv(9)
    remote.reset(seed=2)
    local.reset(seed=2)
    snapshot = remote.snapshot()
    text = local.snapshot()
    assert isinstance(snapshot.episodes, bytes)
    assert 2 * len(snapshot.episodes) < len(text.episodes)
    assert snapshot.seeds == text.seeds
    actions = np.full((9, 2), -0.5)
    expected = local.step(actions)
    for one in (text, snapshot, text):
        remote.restore(one)
        assert_same(remote.step(actions), expected)
    # What is cut or another batch's changes nothing.
    broken = copy.copy(snapshot)
    object.__setattr__(broken, "episodes", snapshot.episodes[:-1])
    with pytest.raises(ValueError, match="state_bytes"):
        remote.restore(broken)
    with pytest.raises(ValueError, match="state"):
        remote.restore(OctoArmVectorEnv(2).snapshot())
    assert_same(remote.step(actions), local.step(actions))


def test_pictures_are_the_local_ones(make: Make) -> None:
    arguments: dict[str, Any] = {"render_mode": "rgb_array", "width": 96, "height": 72}
    remote, local = make(2, **arguments), OctoArmVectorEnv(2, **arguments)
    remote.reset(seed=1)
    local.reset(seed=1)
    for _ in range(3):
        remote.step(remote.teacher_actions())
        local.step(local.teacher_actions())
    np.testing.assert_array_equal(remote.render(), local.render())
    # One without a past shows one that begins now.
    for envs in (remote, local):
        snapshot = envs.snapshot()
        object.__setattr__(snapshot, "past", None)
        envs.restore(snapshot)
    np.testing.assert_array_equal(remote.render(), local.render())


def test_arguments_survive_json(server: ServerProcess) -> None:
    envs = gym.make_vec(
        "OctoArmRemote-v0", num_envs=2, address=server.address, max_episode_steps=7, timeout=9.0
    )
    assert envs.spec is not None
    again = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))
    single = gym.make(envs.get_attr("spec")[0])
    try:
        assert_same(again.reset(seed=1), envs.reset(seed=1))
        np.testing.assert_array_equal(single.reset(seed=1)[0], envs.reset(seed=1)[0][0])
        for name in ("address", "timeout", "reconnect", "target", "num_envs"):
            with pytest.raises(AttributeError, match=rf"{name} .*make_vec\(\"OctoArmRemote-v0\""):
                setattr(envs, name, "other")
    finally:
        envs.close()
        again.close()
        single.close()


def test_closing_leaves_nothing(quiet_server: ServerProcess) -> None:
    with nothing_left(quiet_server):
        envs = RemoteOctoArmVectorEnv(2, quiet_server.address)
        envs.reset()
        envs.close()
        with pytest.raises(ConnectionError, match="is closed"):
            envs.step(np.zeros((2, 2)))
        forgotten = RemoteOctoArmVectorEnv(2, quiet_server.address)
        forgotten.reset()
        del forgotten


def test_after_a_lost_stream_only_a_reset_of_all_goes_on(make: Make) -> None:
    envs = make(2)
    expected = envs.reset(seed=3)
    envs._core.connection._end("lost")
    some = {"reset_mask": np.array([True, False])}
    for call in (lambda: envs.step(np.zeros((2, 2))), lambda: envs.reset(options=some)):
        with pytest.raises(ConnectionError, match=r"lost; reset\(\) connects anew"):
            call()
    assert_same(envs.reset(seed=3), expected)
    envs.step(np.zeros((2, 2)))


def test_any_client_reads_the_ends(server: ServerProcess) -> None:
    from clients import Client

    with Client(server.address) as client:
        client.enter(num_envs=2, autoreset_mode="same_step", max_episode_steps=1, seed=1)
        uids = {name: uid for uid, name in client._names.items()}
        assert uids["final_spring_lengths"] == 12
        first = client.named(client.step())
        wanted = sorted(client._names)
        step = client.named(
            client._answer(step=step_request(np.zeros((2, 2)), observations=wanted).step)
        )
        assert step["final_spring_lengths"].shape == (2, 80)
        assert step["truncated"].tolist() == [True, True]
        assert step["final_failure"].tolist() == ["", ""]
        assert (step["spring_lengths"] != step["final_spring_lengths"]).any()
        assert first["truncated"].tolist() == [False, False]
