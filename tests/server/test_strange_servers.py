"""Servers that answer nonsense: it is told as such, and nothing is taken for what it is not."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import grpc
import pytest
from dm_env_rpc.v1 import dm_env_rpc_pb2 as pb
from dm_env_rpc.v1.extensions import properties_pb2

from octoarm_env.remote import RemoteOctoArm


@contextmanager
def server_that_answers(answer: bytes) -> Iterator[str]:
    """Serve the protocol's method, and answer this to every request."""
    process = grpc.stream_stream_rpc_method_handler(
        lambda requests, context: (answer for _ in requests)
    )
    service = grpc.method_handlers_generic_handler(
        "dm_env_rpc.v1.Environment", {"Process": process}
    )
    server = grpc.server(ThreadPoolExecutor(2))
    server.add_generic_rpc_handlers((service,))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    try:
        yield f"127.0.0.1:{port}"
    finally:
        server.stop(None).wait()


def value(tensor: pb.Tensor) -> bytes:
    """The answer that holds a property of this value."""
    message = properties_pb2.PropertyResponse()
    message.read_property.value.CopyFrom(tensor)
    response = pb.EnvironmentResponse()
    response.extension.Pack(message)
    return response.SerializeToString()


@pytest.mark.parametrize(
    ("answer", "kind"),
    [
        (b"\xff\xff", "an unreadable message"),
        (b"", "an unreadable message"),
        (pb.EnvironmentResponse(step=pb.StepResponse()).SerializeToString(), "step"),
        (pb.EnvironmentResponse(leave_world={}).SerializeToString(), "leave_world"),
    ],
)
def test_an_answer_of_another_kind(answer: bytes, kind: str) -> None:
    with (
        server_that_answers(answer) as address,
        pytest.raises(ConnectionError, match=f"answered extension by {kind}"),
    ):
        RemoteOctoArm(address)


@pytest.mark.parametrize(
    ("tensor", "told"),
    [
        (pb.Tensor(), "a tensor that holds nothing"),
        (pb.Tensor(doubles={"array": [1.0, 2.0]}), "a scalar of 2 elements"),
        (pb.Tensor(doubles={"array": [1.0, 2.0]}, shape=[3]), r"2 elements for the shape \[3\]"),
        (
            pb.Tensor(bools={"array": [True]}, shape=[-1, -1]),
            r"1 elements for the shape \[-1, -1\]",
        ),
        (pb.Tensor(floats={"array": [1.0]}), "a scalar of another kind"),
        (pb.Tensor(protos={}, shape=[0]), "an array of another kind"),
    ],
)
def test_a_tensor_that_is_none(tensor: pb.Tensor, told: str) -> None:
    with (
        server_that_answers(value(tensor)) as address,
        pytest.raises(ValueError, match=f"the server sent {told}"),
    ):
        RemoteOctoArm(address)
