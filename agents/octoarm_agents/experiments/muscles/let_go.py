"""A linear readout learns to let a bend travel along the arm, and does it alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octoarm_env import ArmParameters
from octoarm_env.arrays import Float
from octoarm_env.reach import OctoArmReachVectorEnv, bend_wave

PERIOD = 0.02
"""From one action to the next [s]."""
PULSE = 0.2
"""Length of the initiation command [s]."""
START = 3.0
"""When it begins, in a test [s]."""
ALONE = 1.5
"""When the readout takes over, in a test; until then the arm is bent by the clock [s]."""
LENGTH = 7.0
"""Of a test [s]."""
SPEED = 0.3
"""Of the wave that is taught [m/s]."""
WIDTH = 0.03
"""In which the muscles become active [m]."""
BEYOND = 1.0
"""How far the readout is taught beyond 0 and 1, between which its outputs are cut."""

_ROUNDS, _LESSON = 6, 6.0
_GUIDED = 3
"""Rounds in which the clock leads more than half of the time; in the others it does so less."""
_SHAKEN, _BLURRED = 0.1, 1e-6
"""Half widths of the noise on activations and lengths [m] in a lesson."""
_RIDGE = 1e-6
_SCALE = 100.0
"""Makes lengths as large as the bias."""

BENT, STRAIGHT = 45.0, 25.0
"""Least sum of all bends of an arm that waits, and largest of one that has reached [degrees]."""
SEEN = 5.0
"""Least bend that counts as the bend point [degrees]."""


class LeftDomainError(Exception):
    """An arm left its domain; the message says how."""


def make_arms(parameters: ArmParameters, count: int) -> tuple[OctoArmReachVectorEnv, Float]:
    """Arms at rest, whose every compartment has muscles of its own, and their lengths."""
    arms = OctoArmReachVectorEnv(
        count,
        arm=parameters,
        segments=parameters.compartments,
        control_period=PERIOD,
        goals=[(0.0, 0.0, 0.0)],
        max_episode_steps=None,
        threads=1,
    )
    seen, _ = arms.reset(seed=0)
    return arms, seen["observation"]


def taught_wave(time: Any, parameters: ArmParameters, beyond: float = 0.0) -> Float:
    """What the clock commands so long after the command, (…, 5 N)."""
    length = parameters.rest_length * parameters.compartments
    wave = bend_wave(time, parameters.compartments, length, speed=SPEED, width=WIDTH, beyond=beyond)
    return wave.reshape(*wave.shape[:-2], -1)


def bends_of(positions: Float) -> Float:
    """Angles between neighbouring struts of arms at these positions (…, N + 1, 3) [degrees]."""
    ways = np.diff(positions, axis=-2)
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    cosines = (ways[..., 1:, :] * ways[..., :-1, :]).sum(axis=-1)
    angles: Float = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    return angles


def _see(lengths: Float, commanded: Any, noise: float, generator: np.random.Generator) -> Float:
    """What the readout reads: lengths, a bias, the initiation command."""
    seen = lengths + noise * generator.uniform(-1.0, 1.0, lengths.shape)
    return np.column_stack((seen, np.ones(len(seen)), commanded))


def teach(parameters: ArmParameters, seed: Sequence[int], pupils: int = 48) -> Float:
    """Teach a readout: ridge regression on lessons in which clock and readout share the lead.

    In the first round the clock leads alone. In the next ones the readout of before does its part,
    while the clock goes on to say what should be done (dataset aggregation, Ross et al. 2011), so
    that the readout learns what to do where it leads the arm to. Some arms get no command.

    Args:
        parameters: the body.
        seed: of all noise.
        pupils: arms in a lesson.

    Returns:
        The weights, (4 N + 2, 5 N): of the lengths, the bias, and the command.
    """
    generator = np.random.default_rng(seed)
    seen: list[Float] = []
    wanted: list[Float] = []
    weights: Float | None = None
    for number in range(_ROUNDS):
        arms, lengths = make_arms(parameters, pupils)
        starts = generator.uniform(2.0, 3.5, pupils)
        starts[: pupils // 6] = np.inf
        share = generator.random(pupils)[:, np.newaxis] * (1.0 if number < _GUIDED else 0.5)
        for step in range(round(_LESSON / PERIOD)):
            time = step * PERIOD
            since = time - starts
            clock = taught_wave(since, parameters, BEYOND)
            reading = _see(lengths, (since >= 0) & (since < PULSE), _BLURRED, generator)
            action: Any = np.clip(clock, 0.0, 1.0)
            if time > 1.0:
                seen.append(reading)
                wanted.append(clock)
                if weights is not None:
                    alone = np.clip(reading @ weights, 0.0, 1.0)
                    action = share * action + (1.0 - share) * alone
            shaken = _SHAKEN * generator.uniform(-1.0, 1.0, action.shape)
            lengths = _step(arms, action + shaken)
        weights = _regress(np.concatenate(seen), np.concatenate(wanted))
    assert weights is not None
    return weights


def _step(arms: OctoArmReachVectorEnv, action: Any) -> Float:
    seen, _, terminated, _, infos = arms.step(np.clip(action, 0.0, 1.0).astype(np.float32))
    if terminated.any():
        raise LeftDomainError(next(text for text in infos["failure"] if text))
    lengths: Float = seen["observation"]
    return lengths


def _regress(seen: Float, wanted: Float) -> Float:
    scale = np.ones(seen.shape[1])
    scale[:-2] = _SCALE
    scaled = seen * scale
    square = scaled.T @ scaled / len(seen) + _RIDGE * np.eye(len(scale))
    weights: Any = np.linalg.solve(square, scaled.T @ wanted / len(seen))
    scaled_back: Float = weights * scale[:, np.newaxis]
    return scaled_back


def let_go(
    parameters: ArmParameters,
    weights: Float | None,
    generator: np.random.Generator,
    *,
    arms: int = 16,
    noise: float = 1e-6,
    push: float = 0.0,
    command: bool = True,
    unseen: int | None = None,
) -> Float:
    """Let the readout lead arms that the clock has bent, and command them to reach.

    Args:
        parameters: the body.
        weights: of the readout; None: the clock leads to the end.
        generator: of all noise.
        arms: how many.
        noise: half width of white noise on the lengths [m].
        push: half width of noise on the activations, for 0.2 s from 0.1 s after the command on.
        command: whether the command is given.
        unseen: a compartment whose springs are seen as they are on average before the command.

    Returns:
        The planes' centres after every period, (T, arms, N + 1, 3) [m].
    """
    envs, lengths = make_arms(parameters, arms)
    positions: list[Any] = []
    waiting: list[Float] = []
    for step in range(round(LENGTH / PERIOD)):
        since = step * PERIOD - START
        commanded = command and 0.0 <= since < PULSE
        reading = _see(lengths, np.full(arms, float(commanded)), noise, generator)
        if unseen is not None and waiting:
            place = slice(4 * unseen, 4 * unseen + 4)
            reading[:, place] = np.mean([each[:, place] for each in waiting], axis=0)
        if step * PERIOD < ALONE or weights is None:
            clock = taught_wave(np.full(arms, since if command else -1.0), parameters)
            action = np.array(clock)
        else:
            action = reading @ weights
            if unseen is None or since < 0:
                waiting.append(lengths)
        if 0.1 <= since < 0.3:
            action = np.clip(action, 0.0, 1.0) + push * generator.uniform(-1.0, 1.0, action.shape)
        lengths = _step(envs, action)
        positions.append(envs.get_attr("arm_positions"))
    return np.array(positions)


def bend_point(positions: Float) -> Float:
    """Where along an arm its largest bend is, (…) from 0 at the base to 1 at the tip; else NaN.

    Args:
        positions: of the planes' centres, (…, N + 1, 3) [m].
    """
    bends = bends_of(positions)
    largest = bends.max(axis=-1)
    place = (bends.argmax(axis=-1) + 1.0) / (bends.shape[-1] + 1.0)
    return np.where(largest >= SEEN, place, np.nan)


def judge(positions: Float) -> dict[str, NDArray[np.bool_]]:
    """Whether each arm waited bent, its bend travelled, and it was straight at the end.

    Args:
        positions: as `let_go` gives them.
    """
    times = np.arange(len(positions)) * PERIOD
    total = bends_of(positions).sum(axis=-1)
    waits = total[(times > START - 0.5) & (times < START)].min(axis=0) > BENT
    straight = total[times > LENGTH - 0.5].max(axis=0) < STRAIGHT
    point = np.nan_to_num(bend_point(positions)[times > START], nan=0.5)
    proximal, distal = (point > 0.1) & (point < 0.45), point > 0.75
    first = np.where(proximal.any(axis=0), proximal.argmax(axis=0), len(point))
    last = np.where(distal.any(axis=0), len(point) - 1 - distal[::-1].argmax(axis=0), -1)
    return {"waits": waits, "travels": first < last, "straight": straight}
