"""The conformance test of vector environments: Gymnasium's own pass, faulty ones do not."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv

import octoarm_env  # noqa: F401, registers OctoArm-v0
from octoarm_env.testing import VectorEnvError, check_vector_env

NEXT, SAME, OFF = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED
MODES = pytest.mark.parametrize("mode", [NEXT, SAME, OFF], ids=lambda mode: mode.value)


class Drifter(gym.Env):
    """Observations and actions of many kinds, infos that come and go, ends at random times."""

    observation_space = spaces.Dict(
        {
            "position": spaces.Box(-np.inf, np.inf, (2,), np.float32),
            "level": spaces.Discrete(5, start=1),
            "marks": spaces.Tuple((spaces.MultiBinary(3), spaces.MultiDiscrete([2, 4]))),
            "word": spaces.Text(3),
        }
    )
    action_space = spaces.Dict(
        {"push": spaces.Box(-1, 1, (2,), np.float64), "kind": spaces.Discrete(3)}
    )

    def __init__(self) -> None:
        self.position = np.zeros(2)
        self.time = 0

    def observe(self) -> tuple[dict, dict]:
        rng = self.np_random
        observation = {
            "position": self.position.astype(np.float32),
            "level": rng.integers(1, 6),
            "marks": (
                rng.integers(0, 2, 3, dtype=np.int8),
                np.array([self.time % 2, self.time % 4]),
            ),
            "word": "abc"[: 1 + self.time % 3],
        }
        info = {
            "time": self.time,
            "nested": {"vector": self.position.copy(), "deeper": {"flag": bool(self.time % 2)}},
            "word": "even" if self.time % 2 == 0 else ["odd", self.time],
        }
        if rng.random() < 0.5:
            info["sometimes"] = np.float32(rng.random())
            info["nested"]["now and then"] = None
        return observation, info

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        self.position = self.np_random.normal(size=2)
        self.time = 0
        observation, info = self.observe()
        return observation, {**info, "fresh": True}

    def step(self, action: dict) -> tuple:
        self.time += 1
        self.position = self.position + action["push"] * (1 + action["kind"])
        terminated, truncated = self.np_random.random(2) < 0.1
        observation, info = self.observe()
        return observation, int(self.time), bool(terminated), bool(truncated), info


class Counter(gym.Env):
    """Counts its steps up to four; small, for the faulty vector environments."""

    observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        self.state = self.np_random.random(2)
        self.time = 0
        return self.state.copy(), {"start": self.state[0]}

    def step(self, action: np.ndarray) -> tuple:
        self.time += 1
        self.state = self.state + action
        info = {"time": self.time, "part": {"state": self.state.copy()}}
        return self.state.copy(), self.state.sum(), self.state[0] < -0.5, self.time == 4, info


class Endless(Counter):
    def step(self, action: np.ndarray) -> tuple:
        observation, reward, _, _, info = super().step(action)
        return observation, reward, False, False, info


def cart_pole() -> gym.Env:
    return gym.make("CartPole-v1")


def pendulum() -> gym.Env:
    return gym.make("Pendulum-v1", max_episode_steps=9)


def octo_arm() -> gym.Env:
    return gym.make("OctoArm-v0", max_episode_steps=7)


@pytest.mark.parametrize(
    ("make", "steps"), [(cart_pole, 60), (pendulum, 20), (Drifter, 25), (octo_arm, 16)]
)
@MODES
def test_gymnasium_s_own_passes(make: Callable, steps: int, mode: AutoresetMode) -> None:
    vec_env = SyncVectorEnv([make] * 3, autoreset_mode=mode)
    check_vector_env(vec_env, make, steps=steps)
    vec_env.close()


def test_octo_arm_of_make_vec_passes() -> None:
    vec_env = gym.make_vec(
        "OctoArm-v0", num_envs=3, vectorization_mode="sync", target="lissajous", max_episode_steps=7
    )
    check_vector_env(
        vec_env,
        lambda: gym.make("OctoArm-v0", target="lissajous", max_episode_steps=7),
        steps=20,
        seed=5,
    )
    vec_env.close()


def test_other_processes_pass() -> None:
    vec_env = AsyncVectorEnv([cart_pole] * 2)
    check_vector_env(vec_env, cart_pole, steps=60)
    vec_env.close()


@MODES
def test_one_environment_passes(mode: AutoresetMode) -> None:
    check_vector_env(SyncVectorEnv([Drifter], autoreset_mode=mode), Drifter, steps=50)


def test_each_may_have_its_own_factory() -> None:
    makes = [lambda g=g: gym.make("Pendulum-v1", g=g, max_episode_steps=9) for g in (9.81, 1.62)]
    check_vector_env(SyncVectorEnv(makes), makes, steps=20)
    with pytest.raises(VectorEnvError, match="sub-environment 1.*step 1 of the first run"):
        check_vector_env(SyncVectorEnv(makes), makes[0], steps=20)


def test_spaces_may_differ_where_they_are_batched_so() -> None:
    def bounded(high: float) -> gym.Env:
        env = Counter()
        env.observation_space = spaces.Box(-np.inf, high, (2,), np.float64)
        return env

    makes = [lambda: bounded(50.0), lambda: bounded(60.0)]
    vec_env = SyncVectorEnv(makes, observation_mode="different")
    check_vector_env(vec_env, makes, steps=20)
    with pytest.raises(VectorEnvError, match="single_observation_space must be .*60"):
        check_vector_env(SyncVectorEnv(makes[:1] * 2), makes[1], steps=20)


@MODES
def test_it_leaves_the_environment_open_and_closes_its_own(mode: AutoresetMode) -> None:
    closed = []

    class Closing(Counter):
        def close(self) -> None:
            closed.append(self)

    vec_env = SyncVectorEnv([Closing] * 2, autoreset_mode=mode)
    check_vector_env(vec_env, Closing, steps=20)
    assert len(closed) == 2
    assert not set(closed) & set(vec_env.envs)
    assert not vec_env.closed
    vec_env.step(vec_env.action_space.sample())
    vec_env.close()


def test_it_does_the_same_every_time() -> None:
    seen: list[list] = []

    class Watched(SyncVectorEnv):
        def step(self, actions: Any) -> tuple:
            seen[-1].append(actions.tolist())
            return super().step(actions)

    for seed in (1, 1, 2):
        seen.append([])
        check_vector_env(Watched([Counter] * 2), Counter, steps=20, seed=seed)
    assert seen[0] == seen[1]
    assert seen[0] != seen[2]


@MODES
def test_episodes_must_end(mode: AutoresetMode) -> None:
    vec_env = SyncVectorEnv([Endless] * 2, autoreset_mode=mode)
    with pytest.raises(VectorEnvError, match="steps = 30.*max_episode_steps"):
        check_vector_env(vec_env, Endless, steps=30)


def test_wrong_arguments_are_no_fault_of_the_environment() -> None:
    vec_env = SyncVectorEnv([Counter] * 2)
    with pytest.raises(ValueError, match="steps = 0"):
        check_vector_env(vec_env, Counter, steps=0)
    with pytest.raises(ValueError, match="3 factories for num_envs = 2"):
        check_vector_env(vec_env, [Counter] * 3)


class Rounding(SyncVectorEnv):
    def step(self, actions: Any) -> tuple:
        observation, rewards, *rest = super().step(actions)
        return observation, rewards * (1 + 1e-9), *rest


def test_rounding_is_a_fault_only_when_exact() -> None:
    check_vector_env(Rounding([Counter] * 2), Counter, steps=20, exact=False)
    with pytest.raises(VectorEnvError, match=r"step 1 of the first run: rewards\[0\]"):
        check_vector_env(Rounding([Counter] * 2), Counter, steps=20)


def test_nan_equals_nan() -> None:
    class Blank(Counter):
        def step(self, action: np.ndarray) -> tuple:
            observation, _, terminated, truncated, info = super().step(action)
            return observation, np.nan, terminated, truncated, {**info, "blank": float("nan")}

    for exact in (True, False):
        check_vector_env(SyncVectorEnv([Blank] * 2), Blank, steps=20, exact=exact)


# Each of the following has one fault.


class Faulty(SyncVectorEnv):
    """Has none yet: `after_step` and `after_reset` change results."""

    def step(self, actions: Any) -> tuple:
        return self.after_step(*super().step(actions))

    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        return self.after_reset(*super().reset(seed=seed, options=options))

    def after_step(self, *results: Any) -> tuple:
        return results

    def after_reset(self, observation: Any, infos: dict) -> tuple:
        return observation, infos


class NoMode(Faulty):
    metadata: dict = {}  # noqa: RUF012

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.metadata = {}


class ModeAsText(Faulty):
    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.metadata = {"autoreset_mode": self.autoreset_mode.value}


class WrongMode(Faulty):
    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.metadata = {"autoreset_mode": NEXT if self.autoreset_mode is SAME else SAME}


class NumpyCount(Faulty):
    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.num_envs = np.int64(self.num_envs)


class UnbatchedSpace(Faulty):
    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.observation_space = self.single_observation_space


class NarrowActions(Faulty):
    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.action_space = spaces.Box(-0.5, 0.5, self.action_space.shape, np.float64)


class FourThings(Faulty):
    def after_step(self, *results: Any) -> tuple:
        return results[:4]


class ListOfResults(Faulty):
    def after_reset(self, observation: Any, infos: dict) -> Any:
        return [observation, infos]


class SingleRewards(Faulty):
    def after_step(self, observation: Any, rewards: Any, *rest: Any) -> tuple:
        return observation, rewards.astype(np.float32), *rest


class ColumnRewards(Faulty):
    def after_step(self, observation: Any, rewards: Any, *rest: Any) -> tuple:
        return observation, rewards[:, np.newaxis], *rest


class IntegerFlags(Faulty):
    def after_step(self, observation: Any, rewards: Any, terminations: Any, *rest: Any) -> tuple:
        return observation, rewards, terminations.astype(np.int8), *rest


class SingleObservations(Faulty):
    def after_reset(self, observation: Any, infos: dict) -> tuple:
        return observation.astype(np.float32), infos


class SwappedFlags(Faulty):
    def after_step(self, observation: Any, rewards: Any, *rest: Any) -> tuple:
        return observation, rewards, rest[1], rest[0], rest[2]


class LateEnd(Faulty):
    def __init__(self, env_fns: Any, **named: Any) -> None:
        class Late(Counter):
            def step(self, action: np.ndarray) -> tuple:
                observation, reward, terminated, _, info = super().step(action)
                return observation, reward, terminated, self.time == 5, info

        super().__init__([*env_fns[:-1], Late], **named)


class RewardOfReset(Faulty):
    def after_step(self, observation: Any, rewards: Any, *rest: Any) -> tuple:
        fresh = rest[-1].get("_start", np.zeros(self.num_envs, bool))
        return observation, np.where(fresh, 1.0, rewards), *rest


class StillEnded(Faulty):
    def after_step(self, *results: Any) -> tuple:
        results[3][results[4].get("_start", False)] = True
        return results


class ActsOnReset(Faulty):
    def step(self, actions: Any) -> tuple:
        ended = np.flatnonzero(self._autoreset_envs)
        results = super().step(actions)
        for index in ended:
            results[0][index] = self.envs[index].step(actions[index])[0]
        return results


class NeverResets(Faulty):
    def step(self, actions: Any) -> tuple:
        self._autoreset_envs[:] = False
        return super().step(actions)


class NoFinalObservation(Faulty):
    def after_step(self, *results: Any) -> tuple:
        results[4].pop("final_obs", None)
        results[4].pop("_final_obs", None)
        return results


class ResetAsFinalObservation(Faulty):
    def after_step(self, *results: Any) -> tuple:
        for index in np.flatnonzero(results[4].get("_final_obs", [])):
            results[4]["final_obs"][index] = results[0][index].copy()
        return results


class BatchedFinalObservation(Faulty):
    def after_step(self, *results: Any) -> tuple:
        if "final_obs" in results[4]:
            final = results[4]["final_obs"]
            rows = [np.zeros(2) if row is None else row for row in final]
            results[4]["final_obs"] = np.array(rows)
        return results


class EmptyFinalInfo(Faulty):
    def after_step(self, *results: Any) -> tuple:
        if "final_info" in results[4]:
            results[4]["final_info"] = {}
        return results


class FinalInfoOfOthers(Faulty):
    def after_step(self, *results: Any) -> tuple:
        if "final_info" in results[4]:
            results[4]["final_info"]["time"] += 1
        return results


class NoMask(Faulty):
    def after_step(self, *results: Any) -> tuple:
        results[4].pop("_time", None)
        return results


class MaskOfIntegers(Faulty):
    def after_reset(self, observation: Any, infos: dict) -> tuple:
        return observation, {**infos, "_start": infos["_start"].astype(int)}


class FullMask(Faulty):
    def after_step(self, *results: Any) -> tuple:
        if "_start" in results[4]:
            results[4]["_start"][:] = True
        return results


class MoreInfo(Faulty):
    def after_step(self, *results: Any) -> tuple:
        results[4]["steps_per_second"] = np.ones(self.num_envs)
        return results


class ListOfInfos(Faulty):
    def after_reset(self, observation: Any, infos: dict) -> tuple:
        return observation, [infos]


class NestedInfo(Faulty):
    def after_step(self, *results: Any) -> tuple:
        if "part" in results[4]:
            results[4]["part"]["state"] = results[4]["part"]["state"].astype(np.float32)
        return results


class SameBuffer(Faulty):
    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, copy=False, **named)


class BuffersInTurn(Faulty):
    def after_step(self, observation: Any, rewards: Any, *rest: Any) -> tuple:
        if not hasattr(self, "buffers"):
            self.buffers = [np.zeros(self.num_envs) for _ in range(3)]
        self.buffers.append(self.buffers.pop(0))
        self.buffers[0][:] = rewards
        return observation, self.buffers[0], *rest


class RemembersWhatItReturned(Faulty):
    """Returns new arrays, but takes what it does not reset from the last one."""

    last: Any = None

    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        mask = (options or {}).get("reset_mask")
        observation, infos = super().reset(seed=seed, options=options)
        if mask is not None:
            observation = np.where(mask[:, np.newaxis], observation, self.last)
        self.last = observation
        return observation, infos

    def step(self, actions: Any) -> tuple:
        results = super().step(actions)
        self.last = results[0]
        return results


class WritesToActions(Faulty):
    def step(self, actions: Any) -> tuple:
        results = super().step(actions)
        actions *= 0.5
        return results


class WritesToMask(Faulty):
    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        mask = (options or {}).get("reset_mask")
        results = super().reset(seed=seed, options=options)
        if mask is not None:
            mask[:] = False
        return results


class DisturbsItsNeighbour(Faulty):
    def step(self, actions: Any) -> tuple:
        results = super().step(actions)
        if results[2][0] or results[3][0]:
            self.envs[1].state[0] += 1e-12
        return results


class SameSeeds(Faulty):
    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        seed = [seed] * self.num_envs if isinstance(seed, int) else seed
        return super().reset(seed=seed, options=options)


class FirstOfSeeds(Faulty):
    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        seed = seed[0] if isinstance(seed, list) and seed[0] is not None else seed
        return super().reset(seed=seed, options=options)


class RefusesNone(Faulty):
    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        seed = [int(one) for one in seed] if isinstance(seed, list) else seed
        return super().reset(seed=seed, options=options)


class SeedsAgain(Faulty):
    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        self.seed = self.seed if seed is None else seed
        return super().reset(seed=self.seed, options=options)


class AnyLength(Faulty):
    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        if isinstance(seed, list):
            seed = (seed + [None] * self.num_envs)[: self.num_envs]
        return super().reset(seed=seed, options=options)


class SeedsBeforeItRefuses(Faulty):
    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        if isinstance(seed, list) and len(seed) > self.num_envs:
            self.envs[0].reset(seed=seed[0])
        return super().reset(seed=seed, options=options)


class ResetsAll(Faulty):
    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        return super().reset(seed=seed)


class ResetsOthersSilently(Faulty):
    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        mask = (options or {}).get("reset_mask")
        results = super().reset(seed=seed, options=options)
        if mask is not None and mask.shape == (self.num_envs,):
            for index in np.flatnonzero(~mask):
                self.envs[index].time = 0
        return results


class SeedsWithoutMask(Faulty):
    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        results = super().reset(seed=seed, options=options)
        if options is not None and isinstance(seed, int):
            for index, env in enumerate(self.envs):
                env.np_random = np.random.default_rng(seed + index)
        return results


class ForgetsToReset(Faulty):
    """A reset does not clear what the last step left for the next one."""

    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        ended = self._autoreset_envs.copy()
        results = super().reset(seed=seed, options=options)
        self._autoreset_envs = ended
        return results


class AnyMask(Faulty):
    kind: Callable

    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        if options is not None and type(self).kind(options["reset_mask"], self.num_envs):
            return deepcopy(self._observations), {}
        return super().reset(seed=seed, options=options)


class MaskOfList(AnyMask):
    kind = staticmethod(lambda mask, count: isinstance(mask, list))


class IntegerMask(AnyMask):
    kind = staticmethod(lambda mask, count: getattr(mask, "dtype", None) == np.int64)


class LongMask(AnyMask):
    kind = staticmethod(lambda mask, count: np.shape(mask) == (count + 1,))


class ColumnMask(AnyMask):
    kind = staticmethod(lambda mask, count: np.ndim(mask) == 2)


class EmptyMask(AnyMask):
    kind = staticmethod(lambda mask, count: not np.any(mask))


class Wears(Faulty):
    """The second run of the same seed differs."""

    resets = 0

    def after_reset(self, observation: Any, infos: dict) -> tuple:
        return observation, infos

    def reset(self, *, seed: Any = None, options: dict | None = None) -> tuple:
        results = super().reset(seed=seed, options=options)
        self.resets += seed == 0 and options is None
        if self.resets > 2:
            results[0][0] += 1e-3
        return results


class Raises(Faulty):
    def after_step(self, *results: Any) -> tuple:
        raise RuntimeError("no more memory")


class OutOfBounds(Counter):
    observation_space = spaces.Box(-0.1, 1.1, (2,), np.float64)


FAULTS = [
    (NoMode, NEXT, "metadata.*autoreset_mode.*None"),
    (ModeAsText, NEXT, "must be an AutoresetMode, not 'NextStep'"),
    (WrongMode, NEXT, "SAME_STEP: .*final_obs"),
    (WrongMode, SAME, r"single environment gives: .*observation\[0\]: expected"),
    (NumpyCount, NEXT, "num_envs must be a positive int"),
    (UnbatchedSpace, NEXT, r"observation_space must be batch_space\(single_observation_space, 3\)"),
    (NarrowActions, NEXT, r"action_space must be batch_space\(single_action_space, 3\)"),
    (FourThings, NEXT, "expected 5 things, found 4 things"),
    (ListOfResults, NEXT, "a tuple of observation, infos must be returned"),
    (SingleRewards, NEXT, r"rewards: expected dtype float64, .* found dtype float32"),
    (ColumnRewards, NEXT, r"rewards: expected .*shape \(3,\), found .*shape \(3, 1\)"),
    (IntegerFlags, NEXT, "terminations: expected dtype bool, .*int8"),
    (SingleObservations, NEXT, r"reset\(seed=0\).*observation: expected dtype float64.*float32"),
    (SwappedFlags, NEXT, r"single environment gives.*(truncations|terminations)\[\d\]: expected"),
    (LateEnd, NEXT, r"sub-environment 2, step 6 of .*truncations\[2\]: expected True, found False"),
    (RewardOfReset, NEXT, r"NEXT_STEP: .*reward 0.* rewards\[\d\]: expected .*0\.0.* found .*1\.0"),
    (StillEnded, NEXT, r"NEXT_STEP: .*truncations\[\d\]: expected False, found True"),
    (ActsOnReset, NEXT, r"must ignore the action.*: observation\[0\]: expected"),
    (NeverResets, NEXT, r"NEXT_STEP: .*: observation\[0\]: expected"),
    (NoFinalObservation, SAME, "missing keys .*'_final_obs', 'final_obs'"),
    (ResetAsFinalObservation, SAME, r"sub-environment \d, .*infos\['final_obs'\]\[\d\]\[0\]"),
    (BatchedFinalObservation, SAME, r"infos\['final_obs'\]: expected dtype object"),
    (EmptyFinalInfo, SAME, r"infos\['final_info'\]: expected the keys .*missing keys"),
    (FinalInfoOfOthers, SAME, r"infos\['final_info'\]\['time'\]\[\d\]: expected"),
    (NoMask, OFF, r"missing keys \['_time'\]"),
    (MaskOfIntegers, NEXT, r"infos\['_start'\]: expected dtype bool"),
    (FullMask, NEXT, r"infos\['_start'\]\[\d\]: expected False, found True"),
    (MoreInfo, NEXT, r"extra keys \['steps_per_second'\]"),
    (ListOfInfos, NEXT, "infos: expected dict .*found list"),
    (NestedInfo, SAME, r"infos\['part'\]\['state'\]: expected dtype float64"),
    (SameBuffer, NEXT, "results must stay"),
    (BuffersInTurn, SAME, r"results must stay.*result\[1\]"),
    (RemembersWhatItReturned, SAME, "results may be written to without disturbing"),
    (WritesToActions, NEXT, "arguments must not be written to.*actions"),
    (WritesToMask, NEXT, r"arguments must not be written to.*reset_mask: \[1\]\[0\]"),
    (DisturbsItsNeighbour, NEXT, r"sub-environment 1, .*(observation|infos)"),
    (SameSeeds, NEXT, r"seed sub-environment i with seed \+ i: sub-environment 1"),
    (FirstOfSeeds, NEXT, r"seed=list.*each from its own entry.*sub-environment 1"),
    (RefusesNone, NEXT, "what is allowed must not raise.*TypeError"),
    (SeedsAgain, NEXT, "go on with the present generators|None going on"),
    (AnyLength, NEXT, r"must refuse {'seed': \[11, 14, 17, 0\]}"),
    (SeedsBeforeItRefuses, NEXT, r"reset has just refused {'seed': \[11, 14, 17, 0\]}"),
    (ResetsAll, NEXT, "reset_mask'] must reset the masked ones alone.*sub-environment 1"),
    (ResetsAll, OFF, "reset_mask'] must reset the masked ones alone"),
    (ResetsOthersSilently, NEXT, r"\['time'\]\[\d\]: expected"),
    (SeedsWithoutMask, NEXT, "sub-environment 1"),
    (ForgetsToReset, NEXT, "sub-environment"),
    (MaskOfList, NEXT, r"must refuse .*'reset_mask': \[True, True, True\]"),
    (IntegerMask, SAME, r"must refuse .*'reset_mask': array\(\[1, 1, 1\]\)"),
    (LongMask, NEXT, r"must refuse .*'reset_mask': array\(\[ True, True, True, True\]\)"),
    (ColumnMask, NEXT, r"must refuse .*'reset_mask': array\(\[\[ True\], \[ True\], \[ True\]\]\)"),
    (EmptyMask, OFF, r"must refuse .*'reset_mask': array\(\[False, False, False\]\)"),
    (Wears, NEXT, "the same seed and actions must give the same results.*same run again"),
    (Raises, NEXT, "step 1 of the first run.*RuntimeError: no more memory"),
]


@pytest.mark.parametrize(
    ("faulty", "mode", "words"), FAULTS, ids=lambda value: getattr(value, "__name__", None)
)
def test_faults_are_found(faulty: type[Faulty], mode: AutoresetMode, words: str) -> None:
    with pytest.raises(VectorEnvError, match=words) as caught:
        check_vector_env(faulty([Counter] * 3, autoreset_mode=mode), Counter, steps=40)
    assert isinstance(caught.value, AssertionError)


@MODES
def test_what_the_faults_are_faults_of_has_none(mode: AutoresetMode) -> None:
    check_vector_env(Faulty([Counter] * 3, autoreset_mode=mode), Counter, steps=40)


def test_observations_out_of_their_space_are_found() -> None:
    with pytest.raises(VectorEnvError, match="must be in observation_space"):
        check_vector_env(SyncVectorEnv([OutOfBounds] * 2), OutOfBounds, steps=40)


def test_faults_within_nested_observations_are_found() -> None:
    class Marks(Faulty):
        def after_step(self, *results: Any) -> tuple:
            results[0]["marks"][1][2, 0] ^= 1
            return results

    class Words(Faulty):
        def after_step(self, observation: Any, *rest: Any) -> tuple:
            word = observation["word"]
            return {**observation, "word": (word[0], word[1] + "?", word[2])}, *rest

    with pytest.raises(VectorEnvError, match=r"sub-environment 2, .*\['marks'\]\[1\]\[0\]"):
        check_vector_env(Marks([Drifter] * 3), Drifter, steps=40)
    with pytest.raises(VectorEnvError, match=r"sub-environment 1, .*\['word'\]: expected 'ab'"):
        check_vector_env(Words([Drifter] * 3), Drifter, steps=40)


def test_only_vector_environments_are_checked() -> None:
    with pytest.raises(VectorEnvError, match="VectorEnv is expected"):
        check_vector_env(Counter(), Counter)
    with pytest.raises(VectorEnvError, match="autoreset_mode"):
        check_vector_env(VectorEnv(), Counter)
