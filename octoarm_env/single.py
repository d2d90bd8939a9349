"""What the single environments share: seeds, pictures, arguments that stay as they are."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from octoarm_env.arguments import generator_seed
from octoarm_env.rendering.history import History
from octoarm_env.rendering.pictures import Pictures, Scene, warn_without_mode
from octoarm_env.settings import MadeOnce


class SingleEnv(MadeOnce, gym.Env[Any, NDArray[np.float32]]):
    """An environment of one arm; what those of the tasks have in common."""

    _pictures: Pictures
    _history: Any
    _seeded = False

    @property
    @abstractmethod
    def _scene(self) -> Scene:
        """What is in a picture."""

    def _drawn_seed(self, seed: int | None) -> int | None:
        """Give what starts the generator of resets: of a seed, or, the first time, of none."""
        super().reset(seed=seed)
        if seed is not None:
            given: int | None = generator_seed(seed)
        else:
            given = None if self._seeded else int(self.np_random.integers(2**63))
        self._seeded = True
        return given

    def set_wrapper_attr(self, name: str, value: Any, *, force: bool = True) -> bool:
        """Set an attribute of your own, as every wrapper and vector environment does it.

        Raises:
            AttributeError: the name of an argument, which only another environment takes.
        """
        if not hasattr(self, name):
            # A wrapper would keep it for itself, without effect.
            self._check_free(name)
        return super().set_wrapper_attr(name, value, force=force)

    def render(self) -> NDArray[np.uint8] | None:
        """Give a picture, or show it, as `render_mode` says.

        Returns:
            (height, width, 3), 0 to 255, with "rgb_array"; else None.

        Raises:
            gymnasium.error.ResetNeeded: no episode has begun.
            gymnasium.error.DependencyNotInstalled: pygame-ce is not installed.
        """
        if self._history is None:
            warn_without_mode()
            return None
        if self.render_mode == "human":
            self._show(self._history, again=True)
            return None
        return self._pictures.frame(0, self._history, self._scene)

    def close(self) -> None:
        """Close the window, if there is one; the arm could go on."""
        self._pictures.close()

    @property
    def np_random(self) -> np.random.Generator:
        """What draws the seed of the first reset without one.

        After another was assigned, the next reset without a seed draws one from it.
        """
        return super().np_random

    @np_random.setter
    def np_random(self, value: np.random.Generator) -> None:
        self._np_random = value
        self._np_random_seed = -1
        self._seeded = False

    def _show(self, history: History, *, again: bool = False) -> None:
        if self.render_mode == "human":
            self._pictures.show(history, self._scene, again=again)
