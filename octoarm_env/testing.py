"""A conformance test for vector environments, as Gymnasium's ``check_env`` is for single ones."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from copy import deepcopy
from typing import Any, NamedTuple, NoReturn

import gymnasium as gym
import numpy as np
from gymnasium.spaces.utils import is_space_dtype_shape_equiv
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate
from numpy.typing import NDArray

__all__ = ["VectorEnvError", "check_vector_env"]

# Both tolerances of `exact=False`: those of Gymnasium's own `data_equivalence`.
_TOLERANCE = 1e-5
# Results that are recorded and compared when the first run is repeated.
_REPLAYED = 100
# Results kept to see that no later call changes them: finds up to as many buffers used in turn.
_KEPT = 8

_STEP_RULE = "a step must give what the single environment gives"
_AUTORESET_RULES = {
    AutoresetMode.NEXT_STEP: "NEXT_STEP: the step after an episode's end must ignore the action, "
    "and return the reset with reward 0 and both flags False",
    AutoresetMode.SAME_STEP: "SAME_STEP: the step that ends an episode must return the reset, and "
    "the episode's last observation and info as final_obs and final_info",
    AutoresetMode.DISABLED: _STEP_RULE,
}

_Factory = Callable[[], gym.Env[Any, Any]]
_Seed = int | list[int | None] | None
_Mask = NDArray[np.bool_]


class VectorEnvError(AssertionError):
    """A vector environment breaks a rule; the message says which, where and when."""


def check_vector_env(
    vec_env: VectorEnv[Any, Any, Any],
    single_env_factory: _Factory | Sequence[_Factory],
    *,
    steps: int = 200,
    seed: int = 0,
    exact: bool = True,
) -> None:
    """Check that a vector environment does what Gymnasium says, whatever its spaces.

    Single environments go through the same seeds and actions beside it, and everything returned is
    compared, in the autoreset mode that ``vec_env.metadata["autoreset_mode"]`` declares:

    - the attributes and spaces are those of `num_envs` copies of the single environment;
    - ``reset`` seeds sub-environment i with ``seed + i``, or from a list in which None goes on with
      the present generator, as ``reset()`` does; a list of the wrong length is refused;
    - observations, float64 rewards and bool flags are those of the single environments, and infos
      are exactly what ``VectorEnv._add_info`` builds of theirs, with no other keys;
    - an ended episode is reset as the mode says; ``options={"reset_mask": mask}`` resets the masked
      sub-environments alone, at any time, with or without seeds; malformed masks are refused, and
      what is refused changes nothing;
    - arguments are not written to; results do not change later, and may be written to;
    - the same seed and actions give the same results again.

    The vector environment is left open, and reset.

    Limits: one generator for all sub-environments, as some vector environments have, breaks the
    rule of seeds. Infos that tell the time (the ``"t"`` of ``RecordEpisodeStatistics``) differ and
    are reported; so are objects that a sub-environment changes later, where they are passed on as
    they are (``final_obs``, objects in infos). Objects that ``==`` cannot compare count as equal.
    Not tried: steps after an end without a reset in DISABLED mode, other options, rendering.

    Args:
        vec_env: the environment to check.
        single_env_factory: makes a single environment like those in `vec_env`; or a sequence of
            `num_envs` such functions, one for each.
        steps: length of each of the three long runs; episodes must end within.
        seed: of the sub-environments, and of the actions, which are sampled from the action space.
        exact: compare bit by bit; otherwise floating-point numbers with a relative and an absolute
            tolerance of 1e-5, which suits a short run of an environment that is not chaotic.

    Raises:
        VectorEnvError: a rule is broken (an AssertionError), or no episode was reset during the
            first run, so that the rules about ends could not be checked.
        ValueError: `steps` is not positive, or the number of factories is not `num_envs`.
    """
    if steps < 1:
        raise ValueError(f"steps = {steps}: expected a positive number")
    mode = _check_attributes(vec_env)
    factories = single_env_factory
    if callable(factories):
        factories = [factories] * vec_env.num_envs
    if len(factories) != vec_env.num_envs:
        raise ValueError(f"{len(factories)} factories for num_envs = {vec_env.num_envs}")
    with ExitStack() as stack:
        envs = []
        for factory in factories:
            envs.append(factory())
            stack.callback(envs[-1].close)
        _check_spaces(vec_env, envs)
        check = _Check(vec_env, _Singles(envs, mode), seed, exact)
        check.run("first run", steps)
        if check.singles.autoresets == 0:
            raise VectorEnvError(
                f"no episode was reset within steps = {steps}, so the autoreset rules were not "
                "exercised: take more steps, or environments with a shorter max_episode_steps"
            )
        check.arguments()
        check.run("same run again", min(steps, _REPLAYED))
        check.run("run with resets", steps, resets=True)
        check.write = True
        check.arguments()
        check.run("run with resets", steps, resets=True)
        vec_env.reset(seed=seed)


def _check_attributes(vec_env: VectorEnv[Any, Any, Any]) -> AutoresetMode:
    if not isinstance(vec_env, VectorEnv):
        raise VectorEnvError(f"a gymnasium.vector.VectorEnv is expected, not {type(vec_env)}")
    mode = vec_env.metadata.get("autoreset_mode")
    if not isinstance(mode, AutoresetMode):
        raise VectorEnvError(f"metadata['autoreset_mode'] must be an AutoresetMode, not {mode!r}")
    count = getattr(vec_env, "num_envs", None)
    if type(count) is not int or count < 1:
        raise VectorEnvError(f"num_envs must be a positive int, not {count!r}")
    if not isinstance(getattr(vec_env, "render_mode", 0), str | None):
        raise VectorEnvError("render_mode must be there, and None or a str")
    return mode


def _check_spaces(vec_env: VectorEnv[Any, Any, Any], envs: Sequence[gym.Env[Any, Any]]) -> None:
    count = len(envs)
    for kind in ("observation_space", "action_space"):
        singles = [getattr(env, kind) for env in envs]
        # As SyncVectorEnv(observation_mode="different") batches spaces that differ in their bounds.
        loose = kind == "observation_space" and (
            getattr(vec_env, "observation_mode", "same") != "same"
            or singles.count(singles[0]) < count
        )
        for index, expected in enumerate([*singles, batch_space(singles[0], count)]):
            name, rule = kind, f"batch_space(single_{kind}, {count})"
            if index < count:
                name, rule = f"single_{kind}", f"sub-environment {index}'s"
            found = getattr(vec_env, name, None)
            if not (_alike(found, expected) if loose else found == expected):
                raise VectorEnvError(f"{name} must be {rule}: expected {expected}, found {found}")


def _alike(found: Any, expected: gym.Space[Any]) -> bool:
    try:
        return bool(is_space_dtype_shape_equiv(expected, found))
    except NotImplementedError:  # a space of the environment's own
        return bool(found == expected)


class _Singles:
    """The single environments, and what a vector environment must make of their results."""

    def __init__(self, envs: Sequence[gym.Env[Any, Any]], mode: AutoresetMode) -> None:
        self.count = len(envs)
        self.mode = mode
        self.ended = np.zeros(self.count, np.bool_)  # and not yet reset
        self.autoresets = 0
        self._envs = envs
        self._observations: list[Any] = [None] * self.count
        self._base: Any = VectorEnv()
        self._base.num_envs = self.count

    def reset(self, seeds: Sequence[int | None], mask: _Mask | None = None) -> tuple[Any, ...]:
        infos: dict[str, Any] = {}
        options: dict[str, Any] | None = None if mask is None else {}
        for index in range(self.count) if mask is None else np.flatnonzero(mask).tolist():
            info = self._reset(index, seed=seeds[index], options=options)
            infos = self._base._add_info(infos, info, index)
        return self._batch(), infos

    def step(self, actions: Sequence[Any]) -> tuple[Any, ...]:
        rewards = np.zeros(self.count, np.float64)
        terminations, truncations = np.zeros((2, self.count), np.bool_)
        infos: dict[str, Any] = {}
        for index, (env, action) in enumerate(zip(self._envs, actions, strict=True)):
            if self.ended[index]:
                self.autoresets += 1
                info = self._reset(index)
            else:
                result = _copied(env.step(_copied(action)))
                self._observations[index], rewards[index] = result[:2]
                terminations[index], truncations[index], info = result[2:]
                self.ended[index] = terminations[index] or truncations[index]
                if self.ended[index] and self.mode is AutoresetMode.SAME_STEP:
                    self.autoresets += 1
                    last = {"final_obs": self._observations[index], "final_info": info}
                    infos = self._base._add_info(infos, last, index)
                    info = self._reset(index)
            infos = self._base._add_info(infos, info, index)
        return self._batch(), rewards, terminations, truncations, infos

    def _reset(self, index: int, **arguments: Any) -> dict[str, Any]:
        self._observations[index], info = _copied(self._envs[index].reset(**arguments))
        self.ended[index] = False
        return dict(info)

    def _batch(self) -> Any:
        space = self._envs[0].observation_space
        empty: Any = create_empty_array(space, self.count)
        return _copied(concatenate(space, self._observations, empty))


class _Check:
    """Drives the vector environment beside the single ones and compares."""

    def __init__(
        self, vec_env: VectorEnv[Any, Any, Any], singles: _Singles, seed: int, exact: bool
    ) -> None:
        self.singles = singles
        self.write = False  # overwrite all results
        self._vec: Any = vec_env
        self._seed = seed
        self._exact = exact
        self._actions = deepcopy(vec_env.action_space)
        self._run, self._when, self._steps = "", "", 0
        self._kept: deque[tuple[str, Any, Any]] = deque(maxlen=_KEPT)
        self._recorded: list[Any] = []  # the first results
        self._to_replay: deque[Any] = deque()

    def run(self, name: str, steps: int, *, resets: bool = False) -> None:
        """Reset with the seed, then step with actions that are the same in every run.

        With `resets`, all or some are reset at random times, often just after an end. Without, the
        results must be those of the first run.
        """
        self._run, self._steps = name, 0
        self._to_replay = deque([] if resets else self._recorded)
        rng = np.random.default_rng(self._seed)
        self._actions.seed(self._seed)
        self.reset(self._seed)
        for _ in range(steps):
            if resets and rng.random() < (0.5 if self.singles.ended.any() else 1 / 8):
                mask = rng.random(self.singles.count) < 0.5
                mask[rng.integers(len(mask))] = True
                first = int(rng.integers(2**30))
                listed = [first + 5 * i if rng.random() < 0.5 else None for i in range(len(mask))]
                seeds: list[_Seed] = [None, first, listed]
                self.reset(seeds[rng.integers(3)], None if rng.random() < 0.25 else mask)
            self.advance()

    def arguments(self) -> None:
        """Try all that `reset` takes, and what it must refuse, in the middle of episodes."""
        self._run, self._steps = "test of reset's arguments", 0
        count = self.singles.count
        seeds: list[int | None] = [self._seed + 11 + 3 * i for i in range(count)]
        some = [None if i % 2 else value for i, value in enumerate(seeds)]
        choice: list[_Seed] = [seeds, some, None, self._seed]
        for some_or_all in (None, *np.eye(count, dtype=np.bool_), np.ones(count, np.bool_)):
            for seed in choice:
                self.reset(seed, some_or_all)
                self.advance()
        refused: list[dict[str, Any]] = [{"seed": [*seeds, 0]}, {"seed": seeds[1:]}]
        flags = np.ones(count + 1, np.bool_)
        for mask in (flags[1:].tolist(), flags[1:].astype(int), flags, flags[1:, None], ~flags[1:]):
            refused.append({"options": {"reset_mask": mask}})
        for arguments in refused:
            what = f"{_shown(arguments)} with num_envs = {count}"
            try:
                self._vec.reset(**arguments)
            except Exception:
                self._run = f"run in which reset has just refused {what}"
                self.advance()
            else:
                raise VectorEnvError(f"reset must refuse {what}: no exception was raised")

    def reset(self, seed: _Seed, mask: _Mask | None = None) -> None:
        """Reset both; in DISABLED mode always those that have ended, too."""
        count = self.singles.count
        arguments: dict[str, Any] = {"seed": deepcopy(seed)}
        given, extra = None, ""
        if seed is None:
            seeds: Sequence[int | None] = [None] * count
            rule = "reset() without a seed must go on with the present generators"
        elif isinstance(seed, list):
            seeds = seed
            rule = "reset(seed=list) must seed each from its own entry, None going on as it was"
        else:
            seeds = [seed + i for i in range(count)]
            rule = "reset(seed=int) must seed sub-environment i with seed + i"
        if mask is not None:
            if self.singles.mode is AutoresetMode.DISABLED:
                mask = mask | self.singles.ended
            given = mask.copy()
            arguments["options"] = {"reset_mask": given}
            extra = f", reset_mask={mask.tolist()}"
            rule = f"options['reset_mask'] must reset the masked ones alone, and {rule}"
        self._when = f"reset(seed={seed}{extra}) after step {self._steps}"
        result = self._call(self._vec.reset, **arguments)
        self._untouched((arguments["seed"], given), (seed, mask), "seed and reset_mask: ")
        observation, infos = self.singles.reset(seeds, mask)
        self._compare(result, {"observation": observation, "infos": infos}, [rule] * count)

    def advance(self) -> None:
        """Step both, after the reset that DISABLED mode wants."""
        mode = self.singles.mode
        special = self.singles.ended.copy()
        if mode is AutoresetMode.DISABLED and special.any():
            self.singles.autoresets += 1
            self.reset(None, special)
        actions = self._actions.sample()
        given = deepcopy(actions)
        self._steps += 1
        self._when = f"step {self._steps}"
        result = self._call(self._vec.step, given)
        self._untouched(given, actions, "actions")
        values = self.singles.step(list(iterate(self._vec.action_space, actions)))
        names = ("observation", "rewards", "terminations", "truncations", "infos")
        if mode is AutoresetMode.SAME_STEP:
            special = values[2] | values[3]
        rules = [_AUTORESET_RULES[mode] if it else _STEP_RULE for it in special]
        self._compare(result, dict(zip(names, values, strict=True)), rules)

    def _call(self, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        try:
            return function(*arguments, **named)
        except Exception as error:
            found = f"{type(error).__name__}: {error}"
            self._fail("what is allowed must not raise", _Difference("result", None, "one", found))

    def _untouched(self, found: Any, expected: Any, name: str) -> None:
        for difference in _differences(found, expected, True, name):
            self._fail("the caller's arguments must not be written to", difference)

    def _compare(self, result: Any, expected: dict[str, Any], rules: Sequence[str]) -> None:
        if not isinstance(result, tuple) or len(result) != len(expected):
            found = f"{len(result)} things" if isinstance(result, tuple) else _shown(result)
            difference = _Difference("result", None, f"{len(expected)} things", found)
            self._fail(f"a tuple of {', '.join(expected)} must be returned", difference)
        snapshot = _copied(result)
        replayed = self._to_replay.popleft() if self._to_replay else result
        for difference in _differences(result, replayed, self._exact, "result"):
            self._fail("the same seed and actions must give the same results", difference)
        for (name, wanted), found in zip(expected.items(), result, strict=True):
            differences = _differences(found, wanted, self._exact, name)
            if name == "observation":
                differences = self._observation_differences(found, wanted)
            for difference in differences:
                # Of a fault of the batch as a whole, the most special rule at work is to blame.
                special = max(rules, key=lambda rule: rule != _STEP_RULE)
                self._fail(special if difference.env is None else rules[difference.env], difference)
        space = self._vec.observation_space
        if not space.contains(result[0]):
            difference = _Difference("observation", None, f"one in {space}", _shown(result[0]))
            self._fail("observations must be in observation_space", difference)
        if len(self._recorded) < _REPLAYED:
            self._recorded.append(snapshot)
        # The last result shows a single buffer at once, the oldest one several buffers in turn.
        for when, old, before in (self._kept[-1], self._kept[0]) if self._kept else ():
            for difference in _differences(old, before, True, "result"):
                self._fail(f"results must stay; those of {when} are buffers used again", difference)
        if self.write:
            self._kept.clear()
            _overwrite(result)
        else:
            self._kept.append((f"{self._when} of the {self._run}", result, snapshot))

    def _observation_differences(self, found: Any, expected: Any) -> Iterator[_Difference]:
        """Give those by sub-environment, unless the structure of the whole is wrong."""
        whole = next(_differences(found, expected, self._exact, "observation"), None)
        if whole is None:
            return
        space = self._vec.observation_space
        try:
            pairs = list(zip(iterate(space, found), iterate(space, expected), strict=True))
        except Exception:
            pairs = []
        for env, (one, other) in enumerate(pairs):
            yield from _differences(one, other, self._exact, "observation", env)
        yield whole

    def _fail(self, rule: str, difference: _Difference) -> NoReturn:
        where, env, expected, found = difference
        if self.write:
            rule = f"results may be written to without disturbing the environment, and {rule}"
        raise VectorEnvError(
            f"{rule}: {'all sub-environments' if env is None else f'sub-environment {env}'}, "
            f"{self._when} of the {self._run}: {where}: expected {expected}, found {found}"
        )


class _Difference(NamedTuple):
    where: str
    env: int | None  # None: of the batch as a whole
    expected: str
    found: str


def _differences(
    found: Any, expected: Any, exact: bool, where: str, env: int | None = None
) -> Iterator[_Difference]:
    """Give the differences; without `env`, the first axis of arrays counts sub-environments."""
    if isinstance(found, dict) and isinstance(expected, dict):
        missing, extra = expected.keys() - found.keys(), found.keys() - expected.keys()
        if missing or extra:
            keys, less, more = (sorted(some, key=str) for some in (expected, missing, extra))
            faults = f"missing keys {less}, extra keys {more}"
            yield _Difference(where, env, f"the keys {keys}", faults)
            return
        for key, entry in found.items():
            yield from _differences(entry, expected[key], exact, f"{where}[{key!r}]", env)
    elif type(found) is not type(expected):
        shown = (f"{type(it).__name__} {_shown(it)}" for it in (expected, found))
        yield _Difference(where, env, *shown)
    elif (form := _form(expected)) != _form(found):
        yield _Difference(where, env, form, _form(found))
    elif isinstance(found, tuple | list):
        for key, (one, other) in enumerate(zip(found, expected, strict=True)):
            yield from _differences(one, other, exact, f"{where}[{key}]", env)
    elif isinstance(found, np.ndarray) and found.ndim:
        if found.dtype.kind != "O" and _same(found, expected, exact):
            return
        for place, one in np.ndenumerate(found):
            index = place[0] if env is None else env
            inner = f"{where}{list(place)}"
            yield from _differences(one, expected[place], exact, inner, index)
    elif not _same(found, expected, exact):
        yield _Difference(where, env, _shown(expected), _shown(found))


def _form(value: Any) -> str:
    """What two things must share before their parts are compared."""
    if isinstance(value, np.ndarray):
        return f"dtype {value.dtype}, shape {value.shape}"
    if isinstance(value, tuple | list):
        return f"length {len(value)}"
    return ""


def _same(found: Any, expected: Any, exact: bool) -> bool:
    if isinstance(found, np.ndarray | np.generic | float | complex):
        one, other = np.asarray(found), np.asarray(expected)
        if exact or one.dtype.kind not in "fc":
            return one.tobytes() == other.tobytes()
        return np.allclose(one, other, _TOLERANCE, _TOLERANCE, equal_nan=True)
    compare: Any = type(found).__eq__
    if compare is object.__eq__:
        return True
    try:
        return bool(found == expected)
    except (TypeError, ValueError):
        return True


def _copied(value: Any) -> Any:
    """Copy all that can be copied."""
    if type(value) is dict:
        return {key: _copied(entry) for key, entry in value.items()}
    if type(value) is tuple:
        return tuple(_copied(entry) for entry in value)
    try:
        return deepcopy(value)
    except Exception:  # such as a handle of a simulator in an info
        return value


def _overwrite(value: Any, objects: bool = False) -> None:
    """Fill arrays with other values; but objects in infos belong to the sub-environments."""
    if isinstance(value, dict):
        for key, entry in value.items():
            _overwrite(entry, objects or key == "final_obs")
    elif isinstance(value, tuple | list):
        for entry in value:
            _overwrite(entry, objects)
    elif isinstance(value, np.ndarray) and value.flags.writeable:
        if value.dtype.kind == "O":
            if objects:
                _overwrite(value.ravel().tolist(), objects)
            value.fill(None)
        elif value.dtype.kind in "fc":
            value.fill(np.nan)
        elif value.dtype.kind in "biu":
            np.invert(value, out=value)


def _shown(value: Any) -> str:
    text = " ".join((str(value) if isinstance(value, np.generic) else repr(value)).split())
    return text if len(text) <= 200 else f"{text[:200]}…"
