"""Reaching on a server: every bit of the local environments, one arm and many."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from clients import Client, WithoutDisturbances, assert_same, nothing_left
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from octoarm_agents.common.serving import ServerProcess

from octoarm_env import ArmParameters
from octoarm_env.reach import (
    BendPropagation,
    OctoArmReachEnv,
    OctoArmReachVectorEnv,
    reachable_goals,
)
from octoarm_env.remote import RemoteOctoArmReach, RemoteOctoArmReachVectorEnv, world
from octoarm_env.testing import check_vector_env

MODES = list(AutoresetMode)
GOALS = [[0.1, -0.2, 1 / 3], [0.0, 0.1, 0.35]]
SENSED: dict[str, Any] = {
    "length_noise": 1e-5,
    "delay": 2,
    "dropout": 3,
    "observe_rates": True,
    "vary": {"arm_density": (0.9, 1.0)},
    "bodies": 3,
}
FAILING: dict[str, Any] = {"max_force": 100.0, "activation_time": 0.01}
"""Muscles that tear the arm out of its domain."""

Make = Callable[..., Any]


@pytest.fixture
def make(server: ServerProcess) -> Iterator[Make]:
    with ExitStack() as stack:

        def make(**arguments: Any) -> Any:
            batch = "num_envs" in arguments
            kind = RemoteOctoArmReachVectorEnv if batch else RemoteOctoArmReach
            env = kind(address=server.address, **arguments)
            stack.callback(env.close)
            return env

        yield make


@pytest.mark.parametrize(
    ("steps", "arguments"),
    [
        (120, {}),
        (60, {"reward_type": "dense", "goals": GOALS, "segments": 2, "control_period": 0.02}),
        (60, SENSED),
        (40, {"arm": ArmParameters(compartments=7, area_scale=0.8), "observe_rates": True}),
        (20, {"arm": "inertial", "distance_threshold": 0.5}),
    ],
    ids=["default", "dense", "sensed", "body", "near"],
)
def test_every_bit_is_the_local_one(make: Make, steps: int, arguments: dict[str, Any]) -> None:
    remote, local = make(**arguments), OctoArmReachEnv(**arguments)
    for name in ("observation_space", "action_space", "metadata", "settings"):
        assert getattr(remote, name) == getattr(local, name)
    random = np.random.default_rng(1)
    assert_same(remote.reset(seed=11), local.reset(seed=11))
    for step in range(steps):
        kind = random.random()
        if kind < 0.03:
            assert_same(remote.reset(), local.reset())
        elif kind < 0.06:
            options = {"goal": (0.1, 0.0, random.random() / 3)}
            assert_same(
                remote.reset(seed=step, options=options), local.reset(seed=step, options=options)
            )
        action = random.random(remote.action_space.shape)
        if step % 2:
            action = action.astype(np.float32)
        found = remote.step(action)
        assert_same(found, local.step(action))
        observation, reward, _, _, info = found
        achieved, desired = observation["achieved_goal"], observation["desired_goal"]
        assert remote.compute_reward(achieved, desired, info) == reward
    for name in ("activations", "time", "arm_joints", "arm_positions"):
        assert_same(getattr(remote, name), getattr(local, name))


def test_rewards_of_other_goals_are_the_local_ones(make: Make) -> None:
    """What hindsight experience replay asks for."""
    random = np.random.default_rng(0)
    for reward_type in ("sparse", "dense"):
        remote, local = make(reward_type=reward_type), OctoArmReachEnv(reward_type=reward_type)
        observation, _ = remote.reset(seed=0)
        tips = observation["achieved_goal"] + random.normal(0.0, 0.02, (50, 3))
        goals = np.tile(observation["achieved_goal"], (50, 1))
        rewards = remote.compute_reward(tips, goals, [{}] * 50)
        assert_same(rewards, local.compute_reward(tips, goals, [{}] * 50))
        assert len(set(rewards.tolist())) > 1
        assert not remote.compute_terminated(tips[0], goals[0], {})


def test_hindsight_experience_replay_learns_the_same(server: ServerProcess) -> None:
    from stable_baselines3 import SAC, HerReplayBuffer

    learnt = []
    for name, access in (
        ("OctoArmReachRemote-v0", {"address": server.address}),
        ("OctoArmReach-v0", {}),
    ):
        env = gym.make(name, max_episode_steps=20, **access)
        model = SAC(
            "MultiInputPolicy",
            env,
            replay_buffer_class=HerReplayBuffer,
            learning_starts=30,
            batch_size=16,
            seed=0,
            policy_kwargs={"net_arch": [8]},
        ).learn(50)
        learnt.append({name: each.numpy() for name, each in model.policy.state_dict().items()})
        env.close()
    assert_same(*learnt)


@pytest.mark.parametrize("disturbed", [{}, SENSED], ids=["plain", "sensed"])
@pytest.mark.parametrize("mode", MODES)
def test_conformance(server: ServerProcess, mode: AutoresetMode, disturbed: dict[str, Any]) -> None:
    options: dict[str, Any] = {"max_episode_steps": 7, **disturbed}
    envs = gym.make_vec(
        "OctoArmReachRemote-v0", num_envs=3, address=server.address, autoreset_mode=mode, **options
    )
    try:
        made = lambda: WithoutDisturbances(gym.make("OctoArmReach-v0", **options))  # noqa: E731
        check_vector_env(envs, made, steps=40)
    finally:
        envs.close()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    ("count", "steps", "arguments"),
    [
        (9, 60, {"max_episode_steps": 9}),
        (3, 60, SENSED | {"max_episode_steps": 7}),
        (3, 40, FAILING),
        (1, 20, {"max_episode_steps": 5, "reward_type": "dense"}),
    ],
    ids=["many", "sensed", "failing", "one"],
)
def test_every_bit_of_a_batch_is_the_local_one(
    make: Make, mode: AutoresetMode, count: int, steps: int, arguments: dict[str, Any]
) -> None:
    arguments = {"num_envs": count, **arguments, "autoreset_mode": mode}
    remote, local = make(**arguments), OctoArmReachVectorEnv(**arguments)
    for name in ("observation_space", "action_space", "single_observation_space", "metadata"):
        assert getattr(remote, name) == getattr(local, name)
    random = np.random.default_rng(1)
    assert_same(remote.reset(seed=11), local.reset(seed=11))
    snapshots = remote.snapshot(), local.snapshot()
    failures = ends = 0
    for step in range(steps):
        actions = random.integers(0, 2, remote.action_space.shape) * random.random()
        found, expected = remote.step(actions), local.step(actions)
        assert_same(found, expected)
        ended = expected[2] | expected[3]
        failures, ends = failures + expected[2].sum(), ends + ended.sum()
        if mode is AutoresetMode.DISABLED and ended.any():
            options: dict[str, Any] = {"reset_mask": ended | (random.random(count) < 0.1)}
            seeds = [int(each) if each % 2 else None for each in random.integers(2**40, size=count)]
            given = {"seed": seeds, "options": options}
            assert_same(remote.reset(**given), local.reset(**given))
        elif step == 10:
            options = {"goal": GOALS[0], "reset_mask": np.arange(count) % 2 == 0}
            assert_same(remote.reset(options=options), local.reset(options=options))
        elif step == 25:
            remote.restore(snapshots[0])
            local.restore(snapshots[1])
    assert ends > 2
    assert (failures > 0) == ("max_force" in arguments)
    for name in ("activations", "time", "arm_joints", "arm_positions"):
        assert_same(remote.get_attr(name), local.get_attr(name))
    assert_same(remote._core.infos(), local._core.infos())


def test_the_end_of_an_arm_that_fails(make: Make) -> None:
    remote, local = make(**FAILING), OctoArmReachEnv(**FAILING)
    assert_same(remote.reset(seed=0), local.reset(seed=0))
    random = np.random.default_rng(0)
    for _ in range(200):
        action = random.integers(0, 2, 25).astype(np.float32)
        found, expected = remote.step(action), local.step(action)
        assert_same(found, expected)
        if expected[2]:
            break
    assert expected[2]
    assert expected[4]["failure"]
    messages = []
    for env in (remote, local):
        with pytest.raises(ValueError, match="call reset first") as caught:
            env.step(action)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]
    assert_same(remote.reset(), local.reset())


def test_gymnasium_checks_it(server: ServerProcess) -> None:
    env = gym.make("OctoArmReachRemote-v0", address=server.address, observe_rates=True)
    try:
        check_env(env.unwrapped)
        assert env.spec is not None
        assert env.spec.max_episode_steps == 100
    finally:
        env.close()


def test_copies_go_on_where_it_stands(make: Make) -> None:
    for count in (None, 3):
        arguments = dict(SENSED) if count is None else {"num_envs": count, **SENSED}
        remote = make(**arguments)
        local = (OctoArmReachEnv if count is None else OctoArmReachVectorEnv)(**arguments)
        assert_same(remote.reset(seed=4), local.reset(seed=4))
        action = np.full(remote.action_space.shape, 0.25)
        for _ in range(5):
            remote.step(action)
            local.step(action)
        copies = [copy.deepcopy(remote), pickle.loads(pickle.dumps(remote))]
        for env in (remote, *copies):
            twin = copy.deepcopy(local)
            for _ in range(3):
                assert_same(env.step(action), twin.step(action))
            assert_same(env.reset(), twin.reset())
        for env in copies:
            env.close()


def test_snapshots_of_the_local_batch_are_taken(make: Make) -> None:
    remote, local = make(num_envs=3), OctoArmReachVectorEnv(3)
    remote.reset(seed=2)
    local.reset(seed=2)
    snapshot, text = remote.snapshot(), local.snapshot()
    assert isinstance(snapshot.episodes, bytes)
    actions = np.full((3, 25), 0.5)
    expected = local.step(actions)
    for one in (text, snapshot, text):
        remote.restore(one)
        assert_same(remote.step(actions), expected)
    for broken, reason in (
        (snapshot.episodes[:-1], "state_bytes"),
        (OctoArmReachVectorEnv(2).snapshot().episodes, "state"),
        (OctoArmReachVectorEnv(3, segments=2).snapshot().episodes, "activation has shape"),
    ):
        bad = copy.copy(snapshot)
        object.__setattr__(bad, "episodes", broken)
        with pytest.raises(ValueError, match=reason):
            remote.restore(bad)
    assert_same(remote.step(actions), local.step(actions))


@pytest.mark.parametrize("count", [None, 3])
def test_the_trajectory_goes_on_over_a_killed_server(count: int | None) -> None:
    arguments = dict(SENSED) if count is None else {"num_envs": count, "max_episode_steps": 17}
    with ExitStack() as stack:
        server = stack.enter_context(ServerProcess())
        port = server.address.rpartition(":")[2]
        kinds = (
            (RemoteOctoArmReach, OctoArmReachEnv)
            if count is None
            else (RemoteOctoArmReachVectorEnv, OctoArmReachVectorEnv)
        )
        remote = kinds[0](address=server.address, reconnect=True, **arguments)
        stack.callback(remote.close)
        local = kinds[1](**arguments)
        random = np.random.default_rng(2)
        assert_same(remote.reset(seed=5), local.reset(seed=5))
        for step in range(world._KEPT + 10):
            if step in (3, world._KEPT + 2):
                server.process.kill()
                server.process.wait()
                server = stack.enter_context(ServerProcess("--port", port))
            action = random.random(remote.action_space.shape)
            assert_same(remote.step(action), local.step(action))


def test_refusals_are_the_local_ones(make: Make) -> None:
    mode = AutoresetMode.DISABLED
    batch = {"num_envs": 2, "max_episode_steps": 1, "autoreset_mode": mode}
    single_calls: list[Callable[[Any], Any]] = [
        lambda env: env.step(np.zeros(25)),
        lambda env: env.reset(options={"goal": (0.0, 0.0, 9.0)}),
        lambda env: env.reset(options={"goal": 1.0}),
        lambda env: env.reset(options={"phase": 0.5}),
        lambda env: env.reset(seed=0)[0]["desired_goal"].tobytes(),
        lambda env: env.step(np.full(25, 1.5)),
        lambda env: env.step(np.full(25, -0.1)),
        lambda env: env.step(np.full(25, np.nan)),
        lambda env: env.step(np.zeros(24)),
        lambda env: env.step("left"),
        lambda env: env.step(np.full(25, 0.5))[0]["observation"].tobytes(),
        lambda env: setattr(env, "segments", 3),
    ]
    batch_calls: list[Callable[[Any], Any]] = [
        lambda envs: envs.step(np.zeros((2, 25))),
        lambda envs: envs.reset(seed=[1, 2, 3]),
        lambda envs: envs.reset(seed=0)[0]["desired_goal"].tobytes(),
        lambda envs: envs.step(np.zeros((2, 24))),
        lambda envs: envs.step(np.full((2, 25), 1.5)),
        lambda envs: envs.step(np.zeros((2, 25)))[0]["achieved_goal"].tobytes(),
        lambda envs: envs.step(np.zeros((2, 25))),
        lambda envs: envs.restore("here"),
        lambda envs: envs.set_attr("goals", None),
        lambda envs: envs.reset()[0]["desired_goal"].tobytes(),
    ]
    for pair, calls in (
        ((make(), OctoArmReachEnv()), single_calls),
        ((make(**batch), OctoArmReachVectorEnv(**batch)), batch_calls),
    ):
        for call in calls:
            outcomes = []
            for env in pair:
                try:
                    outcomes.append(call(env))
                except (ValueError, TypeError, AttributeError) as error:
                    text = str(error).replace("OctoArmReachRemote", "OctoArmReach")
                    outcomes.append((type(error), text))
            assert outcomes[0] == outcomes[1]


def test_bad_settings_are_the_local_errors(server: ServerProcess) -> None:
    for arguments in (
        {"segments": 0},
        {"max_force": -1.0},
        {"activation_time": 0.0},
        {"distance_threshold": 2.0},
        {"reward_type": "rich"},
        {"control_period": 0.0505},
        {"goals": [[0.0, 0.0, 9.0]]},
        {"goals": []},
        {"bodies": 2},
        {"arm": {"timestep": 1.0}},
        {"colour": "red"},
    ):
        errors = []
        for kind, given in (
            (RemoteOctoArmReach, {"address": server.address}),
            (OctoArmReachEnv, {}),
        ):
            with pytest.raises((ValueError, TypeError)) as caught:
                kind(**given, **arguments)
            errors.append((caught.type, str(caught.value)))
        assert errors[0] == errors[1]


def test_arguments_survive_json_and_no_token_is_shown(server: ServerProcess) -> None:
    env = gym.make(
        "OctoArmReachRemote-v0",
        address=server.address,
        token="sesame-sesame-sesame",
        goals=np.array(GOALS),
        segments=2,
    )
    envs = gym.make_vec(
        "OctoArmReachRemote-v0",
        num_envs=2,
        address=server.address,
        token="sesame-sesame",
        segments=2,
    )
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    many = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()))
    single = gym.make(envs.get_attr("spec")[0])
    try:
        for one in (env, envs):
            assert "sesame" not in one.spec.to_json() + repr(one) + repr(one.unwrapped._access)
        assert again.spec == env.spec
        assert_same(again.reset(seed=1), env.reset(seed=1))
        assert_same(many.reset(seed=1), envs.reset(seed=1))
        first = {name: rows[0] for name, rows in envs.reset(seed=1)[0].items()}
        assert_same(single.reset(seed=1)[0], first)
        for name in ("address", "token", "timeout", "goals"):
            with pytest.raises(AttributeError, match=rf"{name} .*OctoArmReachRemote-v0\", {name}="):
                setattr(env.unwrapped, name, "other")
    finally:
        for one in (env, envs, again, many, single):
            one.close()


def test_a_wave_and_pictures_are_the_local_ones(make: Make) -> None:
    arguments: dict[str, Any] = {"render_mode": "rgb_array", "width": 96, "height": 72}
    for more in ({}, {"num_envs": 2}):
        remote = make(**arguments, **more)
        local = (OctoArmReachVectorEnv if more else OctoArmReachEnv)(**arguments, **more)
        observation, _ = remote.reset(seed=1)
        local.reset(seed=1)
        waves = [BendPropagation(env, start=0.1) for env in (remote, local)]
        for _ in range(3):
            actions = [wave.predict(observation)[0] for wave in waves]
            np.testing.assert_array_equal(*actions)
            observation = remote.step(actions[0])[0]
            assert_same(observation, local.step(actions[1])[0])
        np.testing.assert_array_equal(remote.render(), local.render())


def test_closing_leaves_nothing(quiet_server: ServerProcess) -> None:
    with nothing_left(quiet_server):
        env = RemoteOctoArmReach(quiet_server.address)
        env.reset()
        env.close()
        with pytest.raises(ConnectionError, match="is closed"):
            env.step(np.zeros(25))
        forgotten = RemoteOctoArmReachVectorEnv(2, quiet_server.address)
        forgotten.reset()
        del forgotten


def test_after_a_lost_stream_a_reset_goes_on(make: Make) -> None:
    env = make()
    expected = env.reset(seed=3)
    env._core.connection._end("lost")
    with pytest.raises(ConnectionError, match=r"lost; reset\(\) connects anew"):
        env.step(np.zeros(25))
    assert_same(env.reset(seed=3), expected)
    env.step(np.zeros(25))


def test_any_client_reaches(server: ServerProcess) -> None:
    """A world of one arm, without this package: states, repeated actions, resets, properties."""
    local = OctoArmReachEnv()
    with Client(server.address) as client:
        client.enter(task="reach", seed=3, max_episode_steps=3)
        numbers = sorted(client._names)
        assert [client._names[number] for number in numbers] == [
            *("spring_lengths", "reward", "achieved_goal", "desired_goal", "is_success"),
            *("distance", "body", "failure", "terminated", "truncated"),
        ]

        def step(action: Any = None) -> tuple[int, dict[str, Any]]:
            answer = client.step(action, numbers)
            return answer.state, client.named(answer)

        expected, info = local.reset(seed=3)
        state, found = step()
        assert state == 1
        assert_same(found["spring_lengths"], expected["observation"])
        assert_same(found["desired_goal"], expected["desired_goal"])
        assert found["distance"] == info["distance"]
        action = np.linspace(0.0, 1.0, 25)
        # Without an action the muscles rest at first, and then go on as before.
        for given, meant in ((None, np.zeros(25)), (action, action), (None, action)):
            state, found = step(given)
            expected, reward, _, _, info = local.step(meant)
            assert_same(found["spring_lengths"], expected["observation"])
            assert_same(found["achieved_goal"], expected["achieved_goal"])
            assert (found["reward"], found["is_success"]) == (reward, info["is_success"])
        # INTERRUPTED: the time is over.
        assert (state, found["truncated"].item()) == (3, True)
        assert client.property("elapsed_steps") == 3
        client.reset(goal=GOALS[0], seed=4)
        _, found = step()
        assert_same(found["desired_goal"], np.array(GOALS[0]))
        assert_same(
            found["spring_lengths"],
            local.reset(seed=4, options={"goal": GOALS[0]})[0]["observation"],
        )
        for given, reason in (
            ({"phase": 0.5}, 'unknown setting "phase"; known are goal, seed'),
            ({"goal": [0.0, 0.0, 99.0]}, r"goal\[2\] = 99 is outside the allowed range"),
        ):
            with pytest.raises(Exception, match=reason):
                client.reset(**given)
        # From another stream.
        with Client(server.address) as other:
            name = other.create(task="reach")
            other.reset_world(name, goal=GOALS[1])
            with pytest.raises(Exception, match="known are goal, seed"):
                other.reset_world(name, phase=0.5)
            other.join(name)
            found = other.named(other.step(None, numbers))
            assert_same(found["desired_goal"], np.array(GOALS[1]))
        assert client.property("begun")
        for key in ("orbit", "teacher_action", "amplitude"):
            with pytest.raises(Exception, match=f'key = "{key}" is unknown; known are version'):
                client.property(key)


def test_the_goals_of_client_and_server_are_the_same(make: Make) -> None:
    table = reachable_goals()
    assert table.shape == (1611, 3)
    with pytest.raises(ValueError, match="read-only"):
        table[0, 0] = 0.0
    remote = make()
    drawn = {tuple(remote.reset(seed=seed)[0]["desired_goal"].tolist()) for seed in range(20)}
    assert len(drawn) > 15
    assert drawn <= set(map(tuple, table.tolist()))
