"""Counts and seeds: whole numbers, and an error that names what is none."""

from __future__ import annotations

from typing import Any

from octoarm_env import arguments


def whole_number(name: str, value: Any, low: int = 0) -> int:
    """Give a whole number, Python's or NumPy's, as Python's.

    Args:
        name: of the argument, for the message.
        value: what was given.
        low: the least that is allowed.

    Raises:
        ValueError: no whole number (10.0 is none, nor is True), or one below `low`.
    """
    try:
        return arguments.whole_number(name, value, low)
    except TypeError as error:
        raise ValueError(str(error)) from None


def whole_fields(instance: Any, **lows: int) -> None:
    """Check fields of a dataclass, frozen or not, by name and the least that is allowed.

    None is let through where a field may be None: where that is its default.

    Raises:
        ValueError: as `whole_number`.
    """
    for name, low in lows.items():
        value = getattr(instance, name)
        if value is None and getattr(type(instance), name, low) is None:
            continue
        object.__setattr__(instance, name, whole_number(name, value, low))
