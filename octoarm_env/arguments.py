"""Plain arguments; what does not fit is refused by name, value and range."""

from __future__ import annotations

import math
import operator
from typing import Any

import numpy as np


def actuator_name(value: Any) -> str:
    """Give the name of an actuator."""
    if not isinstance(value, str) or value not in ("direct", "servo"):
        raise ValueError(f"actuator = {value!r}: expected 'servo' or 'direct'")
    return value


def flag(name: str, value: Any) -> bool:
    """Give True or False; a text or a number is neither."""
    if not isinstance(value, bool | np.bool_):
        raise TypeError(f"{name} = {value!r}: expected True or False")
    return bool(value)


def generator_seed(seed: int) -> int:
    """Give the 64 bits that start a generator of phases: a seed below 2**64 as it is."""
    if seed < 2**64:
        return seed
    return int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0])


def thread_count(threads: Any) -> int | None:
    """Give a number of threads, or None for as many as the processor runs at once."""
    return None if threads is None else whole_number("threads", threads, 1, 1024)


def whole_number(name: str, value: Any, low: int, high: int | None = None) -> int:
    """Give an integer from `low` to `high`; True and 1.0 are none."""
    allowed = f", at least {low}" if high is None else f" from {low} to {high}"
    wanted = f"expected a whole number{allowed}"
    if isinstance(value, bool | np.bool_) or not hasattr(value, "__index__"):
        raise TypeError(f"{name} = {value!r}: {wanted}")
    number = operator.index(value)
    if number < low or (high is not None and number > high):
        raise ValueError(f"{name} = {number}: {wanted}")
    return number


def number(name: str, value: Any) -> float:
    """Give a finite number."""
    try:
        if isinstance(value, bool | np.bool_ | str | bytes):
            raise TypeError
        result = float(value)
    except TypeError:
        raise TypeError(f"{name} = {value!r}: expected a number") from None
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise ValueError(f"{name} = {result}: expected a finite number")
    return result


def positive(name: str, value: Any, kind: str = "number") -> float:
    """Give a finite number above 0; `kind` says of what, for the message."""
    result = number(name, value)
    if result <= 0:
        raise ValueError(f"{name} = {result}: expected a positive {kind}")
    return result
