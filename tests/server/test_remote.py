"""The environment over the wire is the local one, bit for bit."""

from __future__ import annotations

import copy
import functools
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from clients import assert_same
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from octoarm_agents.common.serving import ServerProcess

import octoarm_env
from octoarm_env import ArmParameters, OctoArmEnv, TeacherPolicy
from octoarm_env.remote import RemoteError, RemoteOctoArm
from octoarm_env.rendering.camera import Camera

Make = Callable[..., RemoteOctoArm]


@pytest.fixture
def make(server: ServerProcess) -> Iterator[Make]:
    made: list[RemoteOctoArm] = []

    def make(**arguments: Any) -> RemoteOctoArm:
        made.append(RemoteOctoArm(server.address, **arguments))
        return made[-1]

    yield make
    for env in made:
        env.close()


UNEVEN = ArmParameters(
    longitudinal_stiffness=np.linspace(220, 180, 20),
    transverse_damping=[1.0, 0.9] * 10,
    plane_mass=1e-4 * np.arange(20),
)
BODY = ArmParameters(compartments=7, area_scale=0.8, longitudinal_damping=1.5)
SAMPLES = 15.0 * np.array([[np.sin(t), np.cos(3 * t)] for t in np.linspace(0, 6.28, 629)])


@pytest.mark.parametrize(
    ("steps", "arguments"),
    [
        (1_000, {}),
        pytest.param(10_000, {}, marks=pytest.mark.long),
        (500, {"target": "van_der_pol", "amplitude": 1 / 3, "actuator": "servo"}),
        (500, {"target": "lissajous", "arm": BODY, "control_period": 0.003}),
        (500, {"target": SAMPLES, "action_range": 17.3, "reward_width": 0.1}),
        (200, {"target": "lissajous", "arm": UNEVEN}),
        (200, {"length_noise": 1e-5, "action_noise": 3.0, "delay": 3, "dropout": 5}),
        (30, {"vary": {"arm_density": (0.9, 1.1)}, "bodies": 3, "body_seed": 2**64 - 1}),
    ],
    ids=["default", "long", "servo", "body", "samples", "uneven", "disturbed", "bodies"],
)
def test_every_bit_is_the_local_one(make: Make, steps: int, arguments: dict[str, Any]) -> None:
    remote, local = make(**arguments), OctoArmEnv(**arguments)
    assert remote.observation_space == local.observation_space
    assert remote.action_space == local.action_space
    assert remote.metadata == local.metadata
    random = np.random.default_rng(1)
    assert_same(remote.reset(seed=11), local.reset(seed=11))
    for step in range(steps):
        kind = random.random()
        if kind < 0.01:
            assert_same(remote.reset(), local.reset())
        elif kind < 0.017:
            seed = int(random.integers(2**63))
            assert_same(remote.reset(seed=seed), local.reset(seed=seed))
        elif kind < 0.02:
            options = {"phase": random.random()}
            assert_same(remote.reset(options=options), local.reset(options=options))
        action = random.uniform(-1.0, 1.0, 2)
        if step % 2:
            action = action.astype(np.float32)
        assert_same(remote.step(action), local.step(action))
    assert_same(remote.teacher_action(), local.teacher_action())
    for name in ("orbit", "arm_joints", "arm_positions", "action_range", "amplitude", "period"):
        assert_same(getattr(remote, name), getattr(local, name))


RECORDS = np.zeros(3, dtype=[("step", "i4"), ("action", "f8", 2), ("small", "f4", 2)])
RECORDS["action"], RECORDS["small"] = [0.5, -0.25], [0.25, 0.75]


@pytest.mark.parametrize(
    "action",
    [
        # Strides that are no multiple of the items' size.
        RECORDS["action"][1],
        RECORDS["small"][2],
        RECORDS["action"][:, 0][1:],
        np.array([9.0, 0.5, 9.0, -0.25])[::-2],
        np.asfortranarray(np.full((2, 2), 0.125))[1],
        np.array([0.5, -0.25], ">f8"),
        np.array([0.5, -0.25], np.float16),
        np.array([1, 0]),
        [0.5, np.float32(-0.25)],
        (0, 1),
        memoryview(np.array([0.5, -0.25])),
    ],
    ids=lambda action: type(action).__name__,
)
def test_any_array_like_is_an_action(make: Make, action: Any) -> None:
    remote, local = make(), OctoArmEnv()
    assert_same(remote.reset(seed=3), local.reset(seed=3))
    expected = local.step(np.array(np.asarray(action), np.float64, order="C", copy=True))
    assert_same(remote.step(action), expected)


def test_any_array_like_is_a_target(make: Make) -> None:
    records = np.zeros(len(SAMPLES), dtype=[("step", "i4"), ("angles", "f8", 2)])
    records["angles"] = SAMPLES
    expected = OctoArmEnv(target=SAMPLES).reset(seed=3)
    for target in (records["angles"], np.asfortranarray(SAMPLES), SAMPLES.tolist()):
        assert_same(make(target=target).reset(seed=3), expected)


def test_the_end_of_an_arm_that_fails(make: Make) -> None:
    arguments = {
        "arm": ArmParameters.preset("inertial"),
        "actuator": "servo",
        "amplitude": 30.0,
        "action_range": 180.0,
    }
    remote, local = make(**arguments), OctoArmEnv(**arguments)
    assert_same(remote.reset(seed=0), local.reset(seed=0))
    for step in range(2000):
        action = np.full(2, 1.0 if step // 10 % 2 else -1.0)
        found, expected = remote.step(action), local.step(action)
        assert_same(found, expected)
        if expected[2]:
            break
    assert expected[2]
    for env in (remote, local):
        with pytest.raises(ValueError, match="call reset first"):
            env.step(np.zeros(2))
    assert_same(remote.reset(), local.reset())


def test_copies_go_on_where_it_stands(make: Make) -> None:
    remote, local = make(), OctoArmEnv()
    assert_same(remote.reset(seed=4), local.reset(seed=4))
    action = np.array([0.5, -0.25])
    for _ in range(7):
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


def test_refusals_are_the_local_ones(make: Make) -> None:
    remote, local = make(), OctoArmEnv()
    calls: list[Callable[[OctoArmEnv], Any]] = [
        lambda env: env.step([0.0, 0.0]),
        lambda env: env.reset(options={"phase": 1.5}),
        lambda env: env.reset(options={"angle": 1.5}),
        lambda env: env.reset(seed=0)[0].tobytes(),
        lambda env: env.step([0.0, 1.5]),
        lambda env: env.step([0.0, np.nan]),
        lambda env: env.step([0.0]),
        lambda env: env.step("left"),
        lambda env: env.step([0.0, 0.5])[0].tobytes(),
    ]
    for call in calls:
        outcomes = []
        for env in (remote, local):
            try:
                outcomes.append(call(env))
            except (ValueError, TypeError) as error:
                outcomes.append((type(error), str(error)))
        assert outcomes[0] == outcomes[1]


def test_gymnasium_checks_it(server: ServerProcess) -> None:
    env = gym.make("OctoArmRemote-v0", address=server.address, target="lissajous")
    try:
        check_env(env.unwrapped)
        assert env.spec is not None
        assert env.spec.max_episode_steps == 500
    finally:
        env.close()


def test_arguments_survive_json_and_stay(server: ServerProcess, tmp_path: Path) -> None:
    square = np.array([[0.0, 1], [1, 0], [0, -1], [-1, 0.1]])
    env = gym.make(
        "OctoArmRemote-v0",
        address=server.address,
        target=square,
        arm=ArmParameters(arm_density=1042.0),
        camera=Camera(zoom=2.0),
        max_episode_steps=7,
    )
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    try:
        assert again.spec == env.spec
        for one, other in zip(again.reset(seed=1), env.reset(seed=1), strict=True):
            assert_same(one, other)
        for name in ("address", "token", "certificate", "timeout", "target"):
            with pytest.raises(
                AttributeError, match=rf"{name} .*OctoArmRemote-v0\", {name}=\.\.\."
            ):
                setattr(env.unwrapped, name, "other")
    finally:
        env.close()
        again.close()
    # Of the arguments that it has alone, a path is the one that JSON has not.
    env = OctoArmEnv()
    env.spec = EnvSpec("OctoArmRemote-v0", kwargs={"certificate": tmp_path})
    assert env.spec.kwargs == {"certificate": str(tmp_path)}


def test_without_a_seed_every_environment_begins_elsewhere(make: Make) -> None:
    targets = {tuple(make().reset()[1]["target"]) for _ in range(6)}
    assert len(targets) > 1


def test_the_teacher_and_pictures_work(make: Make) -> None:
    arguments: dict[str, Any] = {"render_mode": "rgb_array", "width": 160, "height": 120}
    remote, local = make(**arguments), OctoArmEnv(**arguments)
    teacher = TeacherPolicy(remote)
    remote.reset(seed=1)
    local.reset(seed=1)
    rewards = []
    for _ in range(20):
        action, _ = teacher.predict()
        rewards.append(remote.step(action)[1])
        local.step(action)
    assert min(rewards) > 0.99
    np.testing.assert_array_equal(remote.render(), local.render())


def _make_env(address: str) -> gym.Env[Any, Any]:
    return gym.make("OctoArmRemote-v0", address=address)


def test_many_in_processes_of_their_own(server: ServerProcess) -> None:
    makers = [functools.partial(_make_env, server.address)] * 2
    envs = gym.vector.AsyncVectorEnv(makers, context="forkserver")
    twins = gym.vector.SyncVectorEnv([lambda: gym.make("OctoArm-v0")] * 2)
    try:
        found, _ = envs.reset(seed=9)
        expected, _ = twins.reset(seed=9)
        np.testing.assert_array_equal(found, expected)
        action = np.zeros((2, 2), np.float32)
        np.testing.assert_array_equal(envs.step(action)[0], twins.step(action)[0])
    finally:
        envs.close()
        twins.close()


def test_bad_settings_are_the_local_errors(server: ServerProcess) -> None:
    for arguments in (
        {"amplitude": -1.0},
        {"control_period": 0.0105},
        {"target": "square"},
        {"target": [[0.0, 0.0]] * 10},
        {"actuator": "rope"},
        {"arm": {"timestep": 1.0}},
        {"colour": "red"},
    ):
        errors = []
        for make in (functools.partial(RemoteOctoArm, server.address), OctoArmEnv):
            with pytest.raises((ValueError, TypeError)) as caught:
                make(**arguments)
            errors.append((caught.type, str(caught.value)))
        assert errors[0] == errors[1]


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("ftp://localhost:1", "expected 'host:port'"),
        ("localhost:seven", "expected 'host:port'"),
        ("", "expected 'host:port'"),
        ("http://localhost", "a certificate needs https"),
    ],
)
def test_bad_addresses_are_named(address: str, expected: str) -> None:
    certificate = "server.pem" if address == "http://localhost" else None
    with pytest.raises(ValueError, match="address") as caught:
        RemoteOctoArm(address, certificate=certificate)
    assert expected in str(caught.value)
    assert repr(address) in str(caught.value)


def test_a_token_is_not_sent_in_the_open() -> None:
    with pytest.raises(ValueError, match=r"without TLS; use https://, a certificate, or an SSH"):
        RemoteOctoArm("192.0.2.1:50051", token="0123456789abcdef")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"timeout": 0}, "timeout = 0.0: expected a positive time"),
        ({"timeout": float("nan")}, "timeout = nan: expected a finite number"),
        ({"timeout": "long"}, "timeout = 'long': expected a number"),
        ({"token": "sesame open"}, "token: expected a text of printable ASCII"),
        ({"token": "sesame\n"}, "token: expected a text of printable ASCII"),
        ({"token": ""}, "token: expected a text of printable ASCII"),
    ],
)
def test_bad_arguments_are_named(
    server: ServerProcess, arguments: dict[str, Any], expected: str
) -> None:
    with pytest.raises((ValueError, TypeError), match=expected) as caught:
        RemoteOctoArm(server.address, **arguments)
    assert "sesame" not in str(caught.value)


def test_nobody_there() -> None:
    with pytest.raises(ConnectionError, match=r"no server answers at 127\.0\.0\.1:1 .* 0\.2 s"):
        RemoteOctoArm("127.0.0.1:1", timeout=0.2)


def test_a_closed_environment_says_so(make: Make) -> None:
    env = make()
    env.reset()
    env.close()
    env.close()
    with pytest.raises(ConnectionError, match="is closed"):
        env.step([0.0, 0.0])


def test_a_server_that_stops_is_an_error_that_says_so() -> None:
    with ServerProcess() as server:
        env = RemoteOctoArm(server.address)
        env.reset()
        assert server.stop() == 0
        with pytest.raises(ConnectionError, match="is broken"):
            env.step([0.0, 0.0])
        env.close()


def test_too_many_worlds_are_refused() -> None:
    with ServerProcess("--max-worlds", "1") as server:
        first = RemoteOctoArm(server.address)
        with pytest.raises(
            RemoteError, match="1 worlds are taken of the 1 that this server may have"
        ) as caught:
            RemoteOctoArm(server.address)
        assert caught.value.code == 8
        first.close()


def test_a_wait_of_any_length(server: ServerProcess) -> None:
    env = RemoteOctoArm(server.address, timeout=1e300, reconnect=True)
    env.reset(seed=1)
    env.step(np.zeros(2))
    env.close()


def test_a_forked_process_has_no_stream(server: ServerProcess) -> None:
    program = (
        "import os, sys\nimport numpy as np\nfrom octoarm_env.remote import RemoteOctoArm\n"
        "env = RemoteOctoArm(sys.argv[1]); env.reset(seed=1)\n"
        "child = os.fork()\n"
        "if not child:\n"
        "    try: env.step(np.zeros(2))\n"
        "    except ConnectionError as error: print(error, flush=True)\n"
        "    env.close(); del env; os._exit(0)\n"
        "os.waitpid(child, 0)\n"
        "print(env.step(np.zeros(2))[1])\n"
    )
    command = [sys.executable, "-c", program, server.address]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    said, reward = result.stdout.splitlines()
    assert "was opened by the process that this one was forked from" in said
    local = OctoArmEnv()
    local.reset(seed=1)
    assert float(reward) == local.step(np.zeros(2))[1]


@pytest.mark.parametrize("ending", ["", "raise SystemExit", "del env; print('freed')"])
def test_a_process_ends_without_close(server: ServerProcess, ending: str) -> None:
    program = (
        "import sys\nfrom octoarm_env.remote import RemoteOctoArm\n"
        f"env = RemoteOctoArm(sys.argv[1]); env.reset()\n{ending}"
    )
    subprocess.run(
        [sys.executable, "-W", "error", "-c", program, server.address], check=True, timeout=60
    )


def test_importing_the_package_needs_no_grpc() -> None:
    program = "import sys, octoarm_env; assert 'grpc' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], check=True)
    assert octoarm_env.__version__
