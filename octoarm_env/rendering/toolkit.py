"""pygame, which draws: the one place that imports it."""

import os

from gymnasium.error import DependencyNotInstalled

__all__ = ["PygameMissingError", "pygame"]


class PygameMissingError(DependencyNotInstalled, ImportError):
    """There is no pygame; the message says how to install it."""


# Its greeting on standard output would end up in the output of commands.
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
try:
    import pygame
except ImportError as error:
    raise PygameMissingError(
        'rendering needs pygame-ce: pip install "octoarm-env[render]"'
    ) from error
