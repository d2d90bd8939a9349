"""DeepMind's own compliance tests of dm_env_rpc, against a running server.

The classes are the package's; what stands here tells them where the server is and what its worlds
take. Their `has_...`, `required_...` and `invalid_...` are the package's names.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import dm_env
import grpc
import numpy as np
import pytest
from absl.testing import absltest
from clients import open_channel
from dm_env import test_utils
from dm_env_rpc.v1 import (
    compliance,
    connection,
    dm_env_adaptor,
    dm_env_rpc_pb2,
    error,
    tensor_utils,
)
from dm_env_rpc.v1.extensions import properties
from octoarm_agents.common.serving import ServerProcess

import octoarm_env

pack = tensor_utils.pack_tensor


@pytest.fixture
def channel(server: ServerProcess) -> Iterator[grpc.Channel]:
    with open_channel(server.address) as channel:
        yield channel


@pytest.fixture
def stream(channel: grpc.Channel) -> connection.Connection:
    return connection.Connection(channel)


class _OnServer:
    """A compliance test with a connection, and a world where one is needed."""

    world_settings: ClassVar[dict[str, Any]] = {}

    @pytest.fixture(autouse=True)
    def _connect(self, stream: connection.Connection) -> None:
        self._stream = stream
        settings = {name: pack(value) for name, value in self.world_settings.items()}
        request = dm_env_rpc_pb2.CreateWorldRequest(settings=settings)
        self._world = stream.send(request).world_name

    @property
    def connection(self) -> connection.Connection:
        return self._stream

    @property
    def world_name(self) -> str:
        return self._world

    def join_world(self, **arguments: Any) -> Any:
        request = dm_env_rpc_pb2.JoinWorldRequest(**({"world_name": self._world} | arguments))
        return self._stream.send(request).specs


class TestCreateDestroyWorld(_OnServer, compliance.CreateDestroyWorld):
    required_world_settings: ClassVar[dict[str, Any]] = {}
    invalid_world_settings: ClassVar[dict[str, Any]] = {
        "amplitude": pack(-1.0),
        "target": pack("square"),
        "arm.timestep": pack(0.0),
        "num_envs": pack(0),
        "seed": pack(-1),
        "colour": pack("red"),
        "task": pack("grasp"),
        # Of another task.
        "segments": pack(5),
    }
    has_multiple_world_support = True


class TestJoinLeaveWorld(_OnServer, compliance.JoinLeaveWorld):
    invalid_join_settings: ClassVar[dict[str, Any]] = {"target": pack("lissajous")}


class TestReset(_OnServer, compliance.Reset):
    pass


class TestResetWorld(_OnServer, compliance.ResetWorld):
    pass


class TestStep(_OnServer, compliance.Step):
    @pytest.fixture(autouse=True)
    def _join(self, _connect: None) -> None:
        self._specs = self.join_world()

    @property
    def specs(self) -> Any:
        return self._specs


class TestStepOfABatch(TestStep):
    world_settings: ClassVar[dict[str, Any]] = {"num_envs": 3, "target": "lissajous"}


class TestStepOfReaching(TestStep):
    world_settings: ClassVar[dict[str, Any]] = {"task": "reach", "observe_rates": True}


class TestStepOfABatchThatReaches(TestStep):
    world_settings: ClassVar[dict[str, Any]] = {
        "task": "reach",
        "num_envs": 3,
        "autoreset_mode": "same_step",
    }


class TestResetOfReaching(_OnServer, compliance.Reset):
    world_settings: ClassVar[dict[str, Any]] = {"task": "reach"}


class TestResetWorldOfReaching(_OnServer, compliance.ResetWorld):
    world_settings: ClassVar[dict[str, Any]] = {"task": "reach"}


class TestAdaptor:
    """DeepMind's `dm_env` adaptor."""

    def test_an_episode_from_begin_to_end(self, stream: connection.Connection) -> None:
        settings = {"target": "van_der_pol", "seed": 5, "max_episode_steps": 20}
        env, world = dm_env_adaptor.create_and_join_world(stream, settings, {})
        local = octoarm_env.OctoArmEnv(target="van_der_pol")
        lengths, info = local.reset(seed=5)
        random = np.random.default_rng(0)

        step = env.reset()
        assert step.step_type is dm_env.StepType.FIRST
        assert step.reward is None
        for count in range(1, 21):
            np.testing.assert_array_equal(step.observation["spring_lengths"], lengths)
            np.testing.assert_array_equal(step.observation["target"], info["target"])
            assert step.observation["tracking_error"] == info["tracking_error"]
            action = random.uniform(-1.0, 1.0, 2)
            step = env.step({"action": action})
            lengths, reward, _, _, info = local.step(action)
            assert step.reward == reward
            last = count == 20
            assert step.step_type is (dm_env.StepType.LAST if last else dm_env.StepType.MID)
            # The time is over, the arm is well: there would be more to earn.
            assert step.discount == 1.0
        assert step.observation["truncated"]
        assert env.step({}).first()

        env.close()
        stream.send(dm_env_rpc_pb2.DestroyWorldRequest(world_name=world))

    def test_the_end_of_an_arm_that_fails(self, stream: connection.Connection) -> None:
        # A weak arm, thrown to and fro.
        settings = {
            "arm": "inertial",
            "actuator": "servo",
            "amplitude": 30.0,
            "action_range": 180.0,
            "max_episode_steps": -1,
            "seed": 0,
        }
        env, _ = dm_env_adaptor.create_and_join_world(stream, settings, {})
        step = env.reset()
        for count in range(2000):
            step = env.step({"action": np.full(2, 1.0 if count // 10 % 2 else -1.0)})
            if step.last():
                break
        assert step.discount == 0.0
        assert step.observation["terminated"]
        assert "the arm left its domain" in step.observation["failure"]
        assert env.reset().first()

    def test_specs_are_those_of_the_environment(self, stream: connection.Connection) -> None:
        env, _ = dm_env_adaptor.create_and_join_world(stream, {"arm.compartments": 3}, {})
        local = octoarm_env.OctoArmEnv(arm=octoarm_env.ArmParameters(compartments=3))
        lengths = env.observation_spec()["spring_lengths"]
        assert lengths.shape == local.observation_space.shape
        assert lengths.dtype == local.observation_space.dtype
        assert lengths.minimum == local.observation_space.low[0]
        assert lengths.maximum == local.observation_space.high[0]
        action = env.action_spec()["action"]
        assert (action.shape, action.minimum, action.maximum) == ((2,), -1.0, 1.0)

    def test_a_batch_goes_on_by_itself(self, stream: connection.Connection) -> None:
        settings = {"num_envs": 9, "seed": 3, "max_episode_steps": 4}
        env, _ = dm_env_adaptor.create_and_join_world(stream, settings, {})
        local = octoarm_env.OctoArmVectorEnv(9, max_episode_steps=4)
        expected, _ = local.reset(seed=3)
        step = env.reset()
        for count in range(12):
            np.testing.assert_array_equal(step.observation["spring_lengths"], expected)
            action = np.full((9, 2), 0.1 * count - 0.5)
            step = env.step({"action": action})
            expected, rewards, terminated, truncated, _ = local.step(action.astype(np.float64))
            np.testing.assert_array_equal(step.reward, rewards)
            np.testing.assert_array_equal(step.observation["terminated"], terminated)
            np.testing.assert_array_equal(step.observation["truncated"], truncated)
            assert step.mid()


class TestDmEnvConformance(test_utils.EnvironmentTestMixin, absltest.TestCase):
    """`dm_env`'s own test of an environment, through the adaptor."""

    world_settings: ClassVar[dict[str, Any]] = {"max_episode_steps": 15}

    @pytest.fixture(autouse=True)
    def _connect(self, stream: connection.Connection) -> None:
        self._adaptor, _ = dm_env_adaptor.create_and_join_world(stream, self.world_settings, {})

    def make_object_under_test(self) -> dm_env.Environment:
        return self._adaptor

    def make_action_sequence(self) -> Iterator[Any]:
        for _ in range(40):
            yield self.make_action()


class TestDmEnvConformanceOfReaching(TestDmEnvConformance):
    """The same of an arm that reaches."""

    world_settings: ClassVar[dict[str, Any]] = {"task": "reach", "max_episode_steps": 15}


class TestProperties:
    """The properties extension, by DeepMind's helper."""

    def test_before_and_after_a_world_is_joined(self, stream: connection.Connection) -> None:
        extension = properties.PropertiesExtension(stream)
        assert set(extension.specs()) == {"version", "worlds"}
        assert extension["version"] == octoarm_env.__version__
        env, _ = dm_env_adaptor.create_and_join_world(stream, {"seed": 1}, {})
        env.reset()
        specs = extension.specs()
        assert extension["worlds"] >= 1
        local = octoarm_env.OctoArmEnv()
        local.reset(seed=1)
        for key in ("action_range", "amplitude", "period"):
            assert extension[key] == getattr(local, key)
        for key in ("orbit", "arm_positions", "arm_joints"):
            np.testing.assert_array_equal(extension[key], getattr(local, key))
            assert specs[key].spec.shape == getattr(local, key).shape
        np.testing.assert_array_equal(extension["teacher_action"], local.teacher_action())
        for key, spec in specs.items():
            assert spec.readable == (key != "seed")
            assert spec.writable == (key in ("elapsed_steps", "seed", "state", "state_bytes"))
            assert not spec.listable
            assert spec.description

    def test_a_state_is_restored_exactly(self, stream: connection.Connection) -> None:
        env, _ = dm_env_adaptor.create_and_join_world(stream, {"seed": 1}, {})
        extension = properties.PropertiesExtension(stream)
        env.reset()
        saved = extension["state"]
        first = [env.step({"action": np.full(2, 0.3)}).reward for _ in range(5)]
        extension["state"] = saved
        again = [env.step({"action": np.full(2, 0.3)}).reward for _ in range(5)]
        assert first == again

    def test_refusals(self, stream: connection.Connection) -> None:
        extension = properties.PropertiesExtension(stream)
        with pytest.raises(KeyError):
            extension["orbit"]
        with pytest.raises(PermissionError):
            extension["version"] = "2"
        dm_env_adaptor.create_and_join_world(stream, {}, {})
        with pytest.raises(PermissionError):
            extension["seed"]
        with pytest.raises(PermissionError):
            extension["orbit"] = 1.0
        for value in ("", "{}", 3.0):
            with pytest.raises(ValueError, match="value"):
                extension["state"] = value
        with pytest.raises(ValueError, match="value"):
            extension["seed"] = -1
        with pytest.raises(ValueError, match="value"):
            extension.list("orbit")


def test_a_sparse_step_keeps_the_last_action(stream: connection.Connection) -> None:
    env, _ = dm_env_adaptor.create_and_join_world(stream, {"seed": 2}, {})
    local = octoarm_env.OctoArmEnv()
    local.reset(seed=2)
    env.reset()
    action = np.array([0.25, -0.5])
    env.step({"action": action})
    local.step(action)
    kept = env.step({})
    lengths, reward, *_ = local.step(action)
    assert kept.reward == reward
    np.testing.assert_array_equal(kept.observation["spring_lengths"], lengths)


def test_a_reset_takes_a_seed_and_a_phase(stream: connection.Connection) -> None:
    env, _ = dm_env_adaptor.create_and_join_world(stream, {}, {})
    local = octoarm_env.OctoArmEnv()

    def first(**settings: Any) -> Any:
        settings = {name: pack(value) for name, value in settings.items()}
        stream.send(dm_env_rpc_pb2.ResetRequest(settings=settings))
        return (
            stream.send(dm_env_rpc_pb2.StepRequest(requested_observations=[1]))
            .observations[1]
            .doubles.array
        )

    assert list(first(seed=7)) == local.reset(seed=7)[0].tolist()
    # A reset alone draws the next phase.
    assert list(first()) == local.reset()[0].tolist()
    assert list(first(phase=0.25)) == local.reset(options={"phase": 0.25})[0].tolist()
    with pytest.raises(error.DmEnvRpcError, match=r"phase = 2 is outside"):
        first(phase=2.0)
    env.close()
