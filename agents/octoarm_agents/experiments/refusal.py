"""What an experiment says to settings that it cannot be run with."""

from __future__ import annotations

__all__ = ["RefusedError"]


class RefusedError(ValueError):
    """An experiment cannot be run with this body or these settings; the message says why.

    Told apart from any other `ValueError`, which is an error within.
    """
