"""The messages of dm_env_rpc, and tensors as NumPy has them."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_POOL = descriptor_pool.DescriptorPool()
"""A pool of its own, beside what others have of the protocol."""
_CONTENT = files("octoarm_env.remote").joinpath("dm_env_rpc.binpb").read_bytes()
for _file in descriptor_pb2.FileDescriptorSet.FromString(_CONTENT).file:
    _POOL.Add(_file)

_PROPERTIES = "dm_env_rpc.v1.extensions.properties"


def _message(name: str) -> Any:
    return message_factory.GetMessageClass(_POOL.FindMessageTypeByName(name))


EnvironmentRequest = _message("dm_env_rpc.v1.EnvironmentRequest")
EnvironmentResponse = _message("dm_env_rpc.v1.EnvironmentResponse")
PropertyRequest = _message(f"{_PROPERTIES}.PropertyRequest")
PropertyResponse = _message(f"{_PROPERTIES}.PropertyResponse")


def pack(tensor: Any, value: Any) -> None:
    """Write a number, text or array of numbers into a tensor."""
    if isinstance(value, np.generic):
        # An integer of NumPy's is one of 64 bits too, not a double.
        value = value.item()
    if isinstance(value, str):
        tensor.strings.array.append(value)
    elif isinstance(value, bool):
        tensor.bools.array.append(value)
    elif isinstance(value, int):
        (tensor.uint64s if value >= 0 else tensor.int64s).array.append(value)
    elif isinstance(value, float):
        tensor.doubles.array.append(value)
    else:
        array = np.asarray(value, dtype=np.float64)
        tensor.doubles.array.extend(array.ravel().tolist())
        tensor.shape.extend(array.shape)


def unpack(tensor: Any) -> Any:
    """Read a tensor: an array of float64, or, if it has no shape, a number or text.

    Raises:
        ValueError: a tensor of another kind, or one whose elements do not fill its shape.
    """
    kind = tensor.WhichOneof("payload")
    elements: Any = getattr(tensor, kind).array if kind is not None else ()
    if not tensor.shape:
        if len(elements) != 1:
            raise ValueError(f"the server sent a scalar of {len(elements)} elements")
        return elements[0]
    if kind != "doubles":
        raise ValueError(f"the server sent an array of {kind}, expected doubles")
    array = np.fromiter(elements, np.float64, len(elements))
    # An array has the shape that is wanted mostly.
    return array if len(tensor.shape) == 1 else array.reshape(tuple(tensor.shape))
