"""How long a picture takes, beside MuJoCo's; and what a step pays where nobody draws.

Between two pictures the arm moves; that is not timed. The garbage collector is on while pictures
are drawn, as it is when they are used, and off while steps are made.
"""

from __future__ import annotations

import functools
import importlib
import os
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from octoarm_agents.benchmark.contenders import ringing_twin, walk
from octoarm_agents.benchmark.turns import (
    NOT_INSTALLED,
    Advance,
    Comparison,
    Contender,
    Result,
    fitted,
    has_mujoco,
    take_turns,
    timed,
)
from octoarm_env import OctoArmEnv, OctoArmVectorEnv

Size = tuple[int, int]

SIZES: tuple[Size, ...] = ((160, 120), (320, 240), (640, 480), (1280, 960))
COMPARED: Size = (640, 480)
MUJOCO = f"MuJoCo's twin {COMPARED[0]}×{COMPARED[1]}"
OFF, ON = "render_mode=None", "rgb_array, undrawn"

CASES = ((1, 0.01), (1, 0.001), (64, 0.01))
"""Environments and control periods [s] of the timed steps; of one physics step, where what Python
adds is easiest to see, too."""

_LATE_STEPS = 200
"""After so many the traces in a picture have their full length."""


def picture_name(size: Size) -> str:
    """Name of the pictures of `OctoArmEnv` of a size."""
    return f"OctoArmEnv {size[0]}×{size[1]}"


def step_name(kind: str, envs: int, period: float) -> str:
    """Name of the steps of a kind, `OFF` or `ON`."""
    env = "OctoArmEnv" if envs == 1 else f"OctoArmVectorEnv of {envs}"
    return f"{env}, {1000 * period:g} ms: {kind}"


def measure_pictures(
    seconds: float = 30.0, rounds: int = 11, advance: Advance | None = None
) -> Result:
    """Time all that draw, and steps with and without a render mode.

    Args:
        seconds: time for all slices together; making the contenders and moving what is drawn comes
            on top.
        rounds: slices of each contender.
        advance: called with a contender's name and the number of slices in all, after each slice.
    """
    contenders, left_out, more = [_picture(size) for size in SIZES], {}, {}
    try:
        twin, more["opengl"] = _twin()
        contenders.append(twin)
    except Exception as error:  # of whichever library it has tried to draw with
        left_out[MUJOCO] = f"it cannot draw here: {error}" if has_mujoco() else NOT_INSTALLED
    contenders += [_steps(kind, *case) for case in CASES for kind in (OFF, ON)]
    result = take_turns(contenders, seconds, rounds, advance)
    own = picture_name(COMPARED)
    result.comparisons = [Comparison("picture_over_mujoco", f"{own} / {MUJOCO}", own, MUJOCO)]
    for envs, period in CASES:
        on, off = (step_name(kind, envs, period) for kind in (ON, OFF))
        key = f"{1000 * period:g}_ms_{envs}_envs"
        result.comparisons += [
            Comparison(f"undrawn_minus_off_{key}", f"{on} − {OFF}", on, off, "µs"),
            Comparison(f"undrawn_over_off_{key}", f"{on} / {OFF}", on, off, "%"),
        ]
    result.left_out, result.more = left_out, more
    result.packages = ["pygame-ce", "mujoco"]
    return result


def _painter(
    name: str, move: Callable[[], Any], draw: Callable[[], Any], close: Callable[[], Any]
) -> Contender:
    """What draws, and is moved before every picture, which is not timed."""

    def take(pictures: int) -> float:
        taken = 0.0
        for _ in range(pictures):
            move()
            started = time.perf_counter()
            draw()
            taken += time.perf_counter() - started
        return taken

    measure = fitted("milliseconds_per_picture", 1e3, take, 100_000)
    return Contender(name, measure, {"pictures_per_second": 1e3}, close)


def _picture(size: Size) -> Contender:
    """The arm, led by its teacher."""
    env = OctoArmEnv(render_mode="rgb_array", width=size[0], height=size[1])

    def move() -> None:
        env.step(env.teacher_action().astype(np.float32))

    env.reset(seed=0)
    for _ in range(_LATE_STEPS):
        move()
    return _painter(picture_name(size), move, env.render, env.close)


def _twin() -> tuple[Contender, str]:
    """MuJoCo's twin of the arm: capsules and balls without light and water; and what draws it."""
    if sys.platform == "linux":
        # MuJoCo reads it when it is imported: it is not to look for a display.
        os.environ.setdefault("MUJOCO_GL", "egl")
    # What finds no display warns, and fails afterwards.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        twin, prepare = ringing_twin()
        prepare()
        twin.step()
        renderer = importlib.import_module("mujoco").Renderer(twin.model, *COMPARED[::-1])
        graphics = importlib.import_module("OpenGL.GL")
        opengl = graphics.glGetString(graphics.GL_RENDERER).decode()

    def draw() -> Any:
        renderer.update_scene(twin.data)
        return renderer.render()

    return _painter(MUJOCO, twin.step, draw, renderer.close), opengl


def _steps(kind: str, envs: int, period: float) -> Contender:
    """Steps of one environment or a vector environment, on one thread: another may not be free."""
    mode = None if kind == OFF else "rgb_array"
    settings: dict[str, Any] = {"control_period": period, "render_mode": mode}
    env: Any = (
        OctoArmEnv(**settings)
        if envs == 1
        else OctoArmVectorEnv(envs, **settings, max_episode_steps=None, threads=1)
    )
    env.reset(seed=0)
    actions = []
    for _ in range(5_000 if envs == 1 else 500):
        teacher = env.teacher_action() if envs == 1 else env.teacher_actions()
        actions.append(teacher.astype(np.float32))
        env.step(actions[-1])
    take = timed(functools.partial(env.reset, seed=0), walk(env.step, actions))
    measure = fitted("microseconds_per_step", 1e6, take, len(actions))
    return Contender(step_name(kind, envs, period), measure, close=env.close)
