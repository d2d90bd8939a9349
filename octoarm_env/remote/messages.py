"""The messages of dm_env_rpc, and tensors as NumPy has them."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from numpy.typing import NDArray

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
    """Write a number, text, bytes, or array of numbers, booleans or unsigned integers."""
    if isinstance(value, np.generic):
        # An integer of NumPy's is one of 64 bits too, not a double.
        value = value.item()
    if isinstance(value, str):
        tensor.strings.array.append(value)
    elif isinstance(value, bytes):
        tensor.uint8s.array = value
        tensor.shape.append(len(value))
    elif isinstance(value, bool):
        tensor.bools.array.append(value)
    elif isinstance(value, int):
        (tensor.uint64s if value >= 0 else tensor.int64s).array.append(value)
    elif isinstance(value, float):
        tensor.doubles.array.append(value)
    elif isinstance(value, np.ndarray) and value.dtype.kind == "u":
        tensor.uint64s.array.extend(value.ravel().tolist())
        tensor.shape.extend(value.shape)
    elif isinstance(value, np.ndarray) and value.dtype == np.bool_:
        _fill(tensor.bools, value.astype(np.uint8))
        tensor.shape.extend(value.shape)
    else:
        array = np.asarray(value, dtype=np.float64)
        _fill(tensor.doubles, array.astype("<f8"))
        tensor.shape.extend(array.shape)


def _fill(elements: Any, array: NDArray[Any]) -> None:
    """Write all elements of a packed field, number 1, as the bytes that they have on the wire."""
    content = array.tobytes()
    length, rest = bytearray(), len(content)
    while rest > 0x7F:
        length.append(rest & 0x7F | 0x80)
        rest >>= 7
    length.append(rest)
    if content:
        elements.MergeFromString(b"\x0a" + bytes(length) + content)


def _content(elements: Any, dtype: str) -> NDArray[Any]:
    """Read all elements of a packed field, the message's only one, from the bytes on the wire."""
    count, content = len(elements.array), elements.SerializeToString()
    return np.frombuffer(content, dtype, count, len(content) - count * np.dtype(dtype).itemsize)


def unpack(tensor: Any) -> Any:
    """Read a tensor.

    Returns:
        Without a shape, a number or text; else an array of float64, int64 or bool, a list of
        texts, or bytes.

    Raises:
        ValueError: a tensor of another kind, or one whose elements do not fill its shape.
    """
    kind = tensor.WhichOneof("payload")
    elements: Any = getattr(tensor, kind).array if kind is not None else ()
    if not tensor.shape:
        if len(elements) != 1:
            raise ValueError(f"the server sent a scalar of {len(elements)} elements")
        return elements[0]
    if kind == "strings":
        return list(elements)
    if kind == "uint8s":
        return elements
    if kind == "doubles":
        array = _content(tensor.doubles, "<f8").astype(np.float64)
    elif kind == "bools":
        array = _content(tensor.bools, "u1").astype(np.bool_)
    elif kind == "int64s":
        array = np.array(elements, np.int64)
    else:
        raise ValueError(f"the server sent an array of {kind}")
    # An array has the shape that is wanted mostly.
    return array if len(tensor.shape) == 1 else array.reshape(tuple(tensor.shape))
