"""Results as JSON takes them."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np


def plain(result: Any) -> dict[str, Any]:
    """The fields of a dataclass and of those in it by their names, arrays as lists."""
    return asdict(result, dict_factory=_without_arrays)


def _without_arrays(items: list[tuple[str, Any]]) -> dict[str, Any]:
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in items
    }
