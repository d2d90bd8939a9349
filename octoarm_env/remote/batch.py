"""Episodes of many arms in a world of their own on a server, whatever their task."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from octoarm_env._core import Request
from octoarm_env.arrays import Float
from octoarm_env.batch import Flags
from octoarm_env.remote.world import Access, RemoteWorld, StepAnswer

Infos = dict[str, Any]


class RemoteBatch(RemoteWorld):
    """Episodes in a world of their own on a server; methods as of the compiled batches.

    Errors are a ValueError or TypeError that names the argument, its value and what is allowed;
    nothing is changed then.

    Attributes:
        threads: that share a step on the server; 0: as many as it allows.
        ended: whether each episode is over.
    """

    _info: ClassVar[tuple[str, ...]]
    """What a step tells of an arm in numbers."""
    _ask: ClassVar[str]
    """What a reset may be asked to begin with."""

    def __init__(
        self,
        access: Access,
        settings: dict[str, Any],
        count: int,
        seen: tuple[str, ...],
        max_episode_steps: int | None,
        autoreset: AutoresetMode,
        threads: int | None,
    ) -> None:
        self._count = count
        self.threads = 0 if threads is None else threads
        told = (*seen, *self._info, "failure")
        self._observed = (*seen, "reward", "terminated", "truncated", *self._info, "failure")
        same_step = autoreset is AutoresetMode.SAME_STEP
        self._final = tuple(f"final_{name}" for name in told) if same_step else ()
        super().__init__(
            access,
            {
                **settings,
                "num_envs": count,
                "max_episode_steps": -1 if max_episode_steps is None else max_episode_steps,
                "autoreset_mode": autoreset.name.lower(),
                "threads": self.threads,
            },
        )
        self.ended: Flags = np.zeros(count, np.bool_)
        self._begun = False
        self._standing: dict[str, NDArray[Any]] = {}

    @abstractmethod
    def _checked(self, actions: ArrayLike) -> Float:
        """The actions after the checks that the step of a batch makes."""

    @abstractmethod
    def _seen(self, answer: StepAnswer, before: str = "") -> Any:
        """The observations of an answer, whose names have this before them."""

    @abstractmethod
    def _row(self, seen: Any, index: int) -> Any:
        """One arm's own copy of observations."""

    def reset(
        self, mask: list[bool] | None, seeds: list[int | None], ask: Any
    ) -> tuple[Any, Infos]:
        """Begin episodes, of those in the mask or of all."""
        settings: dict[str, Any] = {}
        chosen = np.ones(self._count, np.bool_) if mask is None else np.array(mask, np.bool_)
        given = np.array([each is not None for each in seeds])
        if not chosen.all():
            settings["reset_mask"] = chosen
        if given.any():
            settings["seed"] = np.array([each or 0 for each in seeds], np.uint64)
            settings["seed_mask"] = given
        if ask is not None:
            settings[self._ask] = ask

        def use(answer: StepAnswer) -> tuple[Any, Infos]:
            seen, _, _, _, infos = self._result(answer, chosen)
            self.ended = self.ended & ~chosen
            return seen, infos

        return self.change(Request.reset(settings), self.step_request(self._observed), use=use)

    def step(self, actions: ArrayLike) -> tuple[Any, Float, Flags, Flags, Infos]:
        """Make a step of all arms."""

        def use(answer: StepAnswer) -> tuple[Any, Float, Flags, Flags, Infos]:
            result = self._result(answer, np.ones(self._count, np.bool_))
            _, _, terminated, truncated, infos = result
            self.ended = terminated | truncated
            if self._final and self.ended.any():
                self._add_finals(infos, answer, self.ended)
                self.ended = np.zeros(self._count, np.bool_)
            return result

        with self.lock:
            self.assure()
            request = self.step_request(self._observed + self._final, self._checked(actions))
            if not self._begun:
                raise ValueError(
                    "step of environment 0: no episode runs before reset or after its end; call "
                    "reset first"
                )
            return self.change(request, use=use)

    def _result(self, answer: StepAnswer, chosen: Flags) -> tuple[Any, Float, Flags, Flags, Infos]:
        """What an answer brings; infos of those that are chosen."""
        self._begun = True
        self._standing = {}
        rewards, terminated, truncated = (
            self._observation(answer, name) for name in ("reward", "terminated", "truncated")
        )
        everybody = chosen.all()
        infos: Infos = {}
        for name in self._info:
            values = self._observation(answer, name)
            if not everybody:
                values[~chosen] = 0
            infos |= {name: values, f"_{name}": chosen.copy()}
        if everybody and terminated.any():
            # An episode that begins has no failure.
            self._add_failures(infos, self._observation(answer, "failure"), np.arange(self._count))
        return self._seen(answer), rewards, terminated, truncated, infos

    def _observation(self, answer: StepAnswer, name: str) -> Any:
        return answer[1][self._numbers[name]]

    def _add_failures(self, infos: Infos, texts: list[str], places: NDArray[np.int64]) -> None:
        """Add why episodes failed, where they did."""
        pairs = [(place, text) for place, text in zip(places.tolist(), texts, strict=True) if text]
        if pairs:
            infos["failure"] = np.full(self._count, None, object)
            infos["_failure"] = np.zeros(self._count, np.bool_)
            for place, text in pairs:
                infos["failure"][place], infos["_failure"][place] = text, True

    def _add_finals(self, infos: Infos, answer: StepAnswer, ended: Flags) -> None:
        """Add the ends of episodes in whose places others have begun within the same step."""
        places = np.flatnonzero(ended)
        final: Infos = {}
        for name in self._info:
            rows = self._observation(answer, f"final_{name}")
            values = np.zeros((self._count, *rows.shape[1:]), rows.dtype)
            values[places] = rows
            final |= {name: values, f"_{name}": ended.copy()}
        self._add_failures(final, self._observation(answer, "final_failure"), places)
        last = np.full(self._count, None, object)
        seen = self._seen(answer, "final_")
        for index, place in enumerate(places.tolist()):
            last[place] = self._row(seen, index)
        infos |= {"final_info": final, "_final_info": ended.copy()}
        infos |= {"final_obs": last, "_final_obs": ended.copy()}

    def infos(self) -> Infos:
        """Give the infos of all episodes as they stand."""
        found = self.read(*self._info)
        infos: Infos = {}
        for name, values in zip(self._info, found, strict=True):
            infos |= {name: values, f"_{name}": np.ones(self._count, np.bool_)}
        return infos

    def _loaded(self, begun: bool, ended: Any) -> None:
        self._begun, self.ended = begun, ended
        self._standing = {}

    def joints(self, index: int) -> Float:
        """Give the ends of an arm's springs [m]."""
        return np.array(self._of_all("arm_joints")[index])

    def positions(self, index: int) -> Float:
        """Give the centres of an arm's planes [m]."""
        return np.array(self._of_all("arm_positions")[index])

    def _of_all(self, key: str) -> NDArray[Any]:
        """A property of all arms, which is asked for once where they stand."""
        if key not in self._standing:
            self._standing[key] = np.asarray(self.read(key))
        return self._standing[key]
