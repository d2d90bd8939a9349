"""How long a picture takes, beside Gymnasium's and MuJoCo's; and what a step pays without one.

As in :mod:`octoarm_agents.benchmark.speed`, contenders take turns and ratios are formed within a
round. Between two pictures the arm moves; that is not timed. The garbage collector is on while
pictures are drawn, as it is when they are used, and off while steps are made.
"""

from __future__ import annotations

import importlib
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from octoarm_agents.benchmark.contenders import Contender, dry_body, has_mujoco
from octoarm_agents.benchmark.mujoco_twin import MujocoTwin
from octoarm_agents.benchmark.speed import Ratio, Spread, take_turns, time_slice
from octoarm_agents.common.provenance import describe_machine, package_versions
from octoarm_env import OctoArmEnv, OctoArmVectorEnv
from octoarm_env.rendering.toolkit import pygame

__all__ = [
    "MUJOCO",
    "PEERS",
    "SIZES",
    "TARGET_RATE",
    "TARGET_SIZE",
    "TILES",
    "Painter",
    "PictureResult",
    "measure_pictures",
    "picture_name",
    "step_name",
]

Float = NDArray[np.float64]
Size = tuple[int, int]

SIZES: tuple[Size, ...] = ((160, 120), (320, 240), (640, 480), (1280, 960))
TARGET_SIZE: Size = (640, 480)
TARGET_RATE = 60.0
"""Frames a second that are wanted at that size, with the overlay."""

PEERS = ("CartPole-v1", "Pendulum-v1", "Acrobot-v1")
"""Gymnasium's own environments that draw with pygame, in their own sizes."""
MUJOCO = f"MuJoCo's twin {TARGET_SIZE[0]}×{TARGET_SIZE[1]}"

TILE: Size = (160, 120)
ENVS = 64
TILES = f"{ENVS} tiles from OctoArmVectorEnv"

PERIODS = (0.01, 0.001)
"""Control periods of the timed steps [s]: the default, and one physics step, where what Python adds
to a step is easiest to see."""
CORE, PLAIN = "core alone", "no pictures at all"
OFF, ON = "render_mode=None", "rgb_array, undrawn"

_LATE_STEPS = 200
"""After so many the traces in a picture have their full length."""
_STEPS = 5_000
"""Most steps in a slice of an environment, and of the vector environment a tenth."""


def picture_name(size: Size, *, overlay: bool = True) -> str:
    """Name of the pictures of `OctoArmEnv` of a size."""
    return f"OctoArmEnv {size[0]}×{size[1]}{'' if overlay else ', no overlay'}"


def step_name(kind: str, period: float, envs: int = 1) -> str:
    """Name of the steps of a kind (`CORE`, `PLAIN`, `OFF` or `ON`) at a control period [s]."""
    env = "OctoArmEnv" if envs == 1 else f"OctoArmVectorEnv of {envs}"
    return f"{env}, {1000 * period:g} ms: {kind}"


@dataclass(frozen=True)
class Painter:
    """Something that draws pictures.

    Attributes:
        name: its row in the table.
        move: called before every drawing, not timed.
        draw: makes `pictures` arrays.
        size: of a picture, (width, height) [pixels].
        pictures: in one drawing.
        peer: its name in the keys of comparisons; empty if it is an arm's own picture.
        close: called when it is not needed any more.
    """

    name: str
    move: Callable[[], Any]
    draw: Callable[[], Any]
    size: Size
    pictures: int = 1
    peer: str = ""
    close: Callable[[], Any] = lambda: None

    @property
    def pixels(self) -> int:
        """Of a picture."""
        return self.size[0] * self.size[1]

    def seconds(self, drawings: int) -> float:
        """Draw so many times; give the time without the moves."""
        taken, clock = 0.0, time.perf_counter
        for _ in range(drawings):
            self.move()
            started = clock()
            self.draw()
            taken += clock() - started
        return taken


class _PlainEnv(OctoArmEnv):
    """An arm whose step does not ask whether there are pictures: what the others' asking costs."""

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Float, SupportsFloat, bool, bool, dict[str, Any]]:
        observation, reward, terminated, info = self._core.step(action)
        return observation, reward, terminated, False, info


@dataclass
class PictureResult:
    """Milliseconds of pictures and microseconds of steps, by round.

    Attributes:
        rounds: number of rounds.
        painters: what drew, by name.
        steppers: what made steps, by name.
        counts: drawings or steps in one slice, by name.
        milliseconds: time of a picture in each round, by name.
        microseconds: time of a step, of all environments, in each round, by name.
        left_out: peers that could not be timed, and why.
        opengl: what MuJoCo drew with; None where it did not.
    """

    rounds: int
    painters: dict[str, Painter]
    steppers: dict[str, Contender]
    counts: dict[str, int]
    milliseconds: dict[str, list[float]] = field(default_factory=dict)
    microseconds: dict[str, list[float]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    opengl: str | None = None

    @property
    def pictures(self) -> dict[str, Spread]:
        """Spread of every painter's milliseconds a picture."""
        return {name: Spread.of(values) for name, values in self.milliseconds.items()}

    @property
    def steps(self) -> dict[str, Spread]:
        """Spread of every stepper's microseconds a step."""
        return {name: Spread.of(values) for name, values in self.microseconds.items()}

    def rate(self, name: str) -> float:
        """Pictures a second; the median."""
        return 1000.0 / self.pictures[name].median

    def ratios(self) -> list[Ratio]:
        """All comparisons of which both sides were measured."""
        return [*self._of_pictures(), *self._of_steps()]

    def _of_pictures(self) -> Iterator[Ratio]:
        times, own = self.milliseconds, picture_name(TARGET_SIZE)
        if own in times:
            rates = Spread.of([1000.0 / each for each in times[own]])
            yield Ratio("frames_per_second", f"{own}: frames", rates, "a second")
            bare = picture_name(TARGET_SIZE, overlay=False)
            if bare in times:
                yield Ratio("overlay", "with overlay / without", self._divided(own, bare))
            for name, painter in self.painters.items():
                if not painter.peer or name not in times:
                    continue
                whole = self._divided(own, name)
                yield Ratio(f"picture_over_{painter.peer}", f"{own} / {name}: a picture", whole)
                share = painter.pixels / self.painters[own].pixels
                if share == 1.0:
                    continue
                pixel = Spread(*(share * each for each in whole.to_dict().values()))
                yield Ratio(f"pixel_over_{painter.peer}", f"{own} / {name}: a pixel", pixel)
        if TILES in times:
            rates = Spread.of([1000.0 / each for each in times[TILES]])
            yield Ratio("tiles_per_second", f"{TILES}: tiles", rates, "a second")
            alone = picture_name(TILE)
            if alone in times:
                divided = self._divided(TILES, alone)
                yield Ratio("tile_over_picture", f"one of {TILES} / {alone}", divided)

    def _of_steps(self) -> Iterator[Ratio]:
        pairs = (("off_core", OFF, CORE), ("off_plain", OFF, PLAIN), ("on_off", ON, OFF))
        for envs, periods in ((1, PERIODS), (ENVS, PERIODS[:1])):
            for period in periods:
                for key, kind, other in pairs:
                    name, base = (step_name(each, period, envs) for each in (kind, other))
                    if not {name, base} <= set(self.microseconds):
                        continue
                    both = zip(self.microseconds[name], self.microseconds[base], strict=True)
                    times = list(both)
                    suffix = f"{key}_{1000 * period:g}_ms{'' if envs == 1 else f'_{envs}_envs'}"
                    more = Spread.of([one - two for one, two in times])
                    yield Ratio(f"difference_{suffix}", f"{name} − {other}", more, "µs")
                    share = Spread.of([100 * one / two for one, two in times])
                    yield Ratio(f"percent_{suffix}", f"{name} / {other}", share, "%")

    def _divided(self, above: str, below: str) -> Spread:
        pairs = zip(self.milliseconds[above], self.milliseconds[below], strict=True)
        return Spread.of([one / other for one, other in pairs])

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain numbers for a JSON file; units in the keys."""
        wanted = picture_name(TARGET_SIZE)
        machine = describe_machine() | {
            "opengl": self.opengl,
            "sdl": ".".join(map(str, pygame.get_sdl_version())),
        }
        return {
            "rounds": self.rounds,
            "target": {
                "picture": wanted,
                "frames_per_second": TARGET_RATE,
                "reached": self.rate(wanted) >= TARGET_RATE,
            },
            "milliseconds_per_picture": {
                name: spread.to_dict()
                | {
                    "width": self.painters[name].size[0],
                    "height": self.painters[name].size[1],
                    "pictures_per_round": self.painters[name].pictures * self.counts[name],
                    "pictures_per_second": self.rate(name),
                    "nanoseconds_per_pixel": 1e6 * spread.median / self.painters[name].pixels,
                }
                for name, spread in self.pictures.items()
            },
            "microseconds_per_step": {
                name: spread.to_dict()
                | {"envs": self.steppers[name].arms, "steps_per_round": self.counts[name]}
                for name, spread in self.steps.items()
            },
            "ratios": {
                ratio.key: ratio.spread.to_dict() | {"label": ratio.label, "unit": ratio.unit}
                for ratio in self.ratios()
            },
            "left_out": self.left_out,
            "milliseconds_by_round": self.milliseconds,
            "microseconds_by_round": self.microseconds,
            "machine": machine,
            "versions": package_versions(
                "octoarm-env", "octoarm-agents", "numpy", "gymnasium", "pygame-ce", "mujoco"
            ),
        }


def measure_pictures(
    seconds: float = 30.0, rounds: int = 11, advance: Callable[[str, int], Any] | None = None
) -> PictureResult:
    """Time all that draw, and steps with and without a render mode.

    Args:
        seconds: time for all slices together; making the contenders and moving what is drawn comes
            on top.
        rounds: slices of each contender.
        advance: called with a contender's name and the number of slices in all, after each slice.
    """
    # No window is wanted: neither SDL nor MuJoCo is to look for a display.
    with _defaults(SDL_VIDEODRIVER="dummy", **_headless()):
        made, left_out, opengl = _make_painters()
        painters = {painter.name: painter for painter in made}
        steppers = {stepper.name: stepper for stepper in _make_steppers()}
        try:
            slices: dict[str, Callable[[int], float]] = {
                name: painter.seconds for name, painter in painters.items()
            }
            slices |= {name: partial(time_slice, each) for name, each in steppers.items()}
            limits = dict.fromkeys(painters, 100_000)
            limits |= {name: each.limit for name, each in steppers.items()}
            counts, times = take_turns(slices, limits, seconds, rounds, advance)
        finally:
            for painter in painters.values():
                painter.close()
            for stepper in steppers.values():
                stepper.close()
    milliseconds = {
        name: [1e3 * each / painter.pictures for each in times[name]]
        for name, painter in painters.items()
    }
    microseconds = {name: [1e6 * each for each in times[name]] for name in steppers}
    return PictureResult(
        rounds, painters, steppers, counts, milliseconds, microseconds, left_out, opengl
    )


def _make_painters() -> tuple[list[Painter], dict[str, str], str | None]:
    """All of them; what had to be left out, and why; what MuJoCo draws with."""
    painters = [_arm(size) for size in SIZES]
    painters.append(_arm(TARGET_SIZE, overlay=False))
    painters.append(_tiles())
    painters += [_peer(name) for name in PEERS]
    if not has_mujoco():
        return painters, {MUJOCO: 'not installed: pip install "octoarm-agents[benchmark]"'}, None
    try:
        # What finds no display warns, and fails afterwards.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            twin, opengl = _twin()
    except Exception as error:  # of whichever library it has tried to draw with
        return painters, {MUJOCO: f"it cannot draw here: {error}"}, None
    return [*painters, twin], {}, opengl


def _arm(size: Size, *, overlay: bool = True) -> Painter:
    """The arm, led by its teacher."""
    env = OctoArmEnv(render_mode="rgb_array", width=size[0], height=size[1], overlay=overlay)

    def move() -> None:
        env.step(env.teacher_action().astype(np.float32))

    env.reset(seed=0)
    for _ in range(_LATE_STEPS):
        move()
    return Painter(picture_name(size, overlay=overlay), move, env.render, size, close=env.close)


def _tiles() -> Painter:
    """The arms of a vector environment, led by their teachers."""
    width, height = TILE
    envs = OctoArmVectorEnv(
        ENVS, render_mode="rgb_array", width=width, height=height, max_episode_steps=None
    )

    def move() -> None:
        envs.step(envs.teacher_actions().astype(np.float32))

    envs.reset(seed=0)
    for _ in range(_LATE_STEPS):
        move()
    return Painter(TILES, move, envs.render, TILE, pictures=ENVS, close=envs.close)


def _peer(name: str) -> Painter:
    """An environment of Gymnasium's without its wrappers, under random actions."""
    env: gym.Env[Any, Any] = gym.make(name, render_mode="rgb_array").unwrapped
    env.action_space.seed(0)
    env.reset(seed=0)

    def move() -> None:
        if env.step(env.action_space.sample())[2]:
            env.reset()

    frame = env.render()
    assert isinstance(frame, np.ndarray)
    size = (frame.shape[1], frame.shape[0])
    key = name.lower().replace("-", "_")
    row = f"{name} {size[0]}×{size[1]}"
    return Painter(row, move, env.render, size, peer=key, close=env.close)


def _twin() -> tuple[Painter, str]:
    """MuJoCo's twin of the arm: capsules and balls without light and water; and what draws it."""
    mujoco = importlib.import_module("mujoco")
    twin = MujocoTwin(dry_body())
    coordinates, rates, base = twin.state
    coordinates[:, 1:3] += 0.02  # so that its springs ring
    twin.set_state(coordinates, rates, base)
    twin.step()
    width, height = TARGET_SIZE
    renderer = mujoco.Renderer(twin.model, height, width)
    graphics = importlib.import_module("OpenGL.GL")
    opengl = graphics.glGetString(graphics.GL_RENDERER).decode()

    def draw() -> Any:
        renderer.update_scene(twin.data)
        return renderer.render()

    painter = Painter(MUJOCO, twin.step, draw, TARGET_SIZE, peer="mujoco", close=renderer.close)
    return painter, opengl


def _make_steppers() -> list[Contender]:
    """Steps of the core, without pictures, and with pictures that nobody asks for."""
    steppers = []
    for period in PERIODS:
        made = {
            CORE: OctoArmEnv(control_period=period),
            PLAIN: _PlainEnv(control_period=period),
            OFF: OctoArmEnv(control_period=period),
            ON: OctoArmEnv(control_period=period, render_mode="rgb_array"),
        }
        actions = _teacher_actions(made[OFF])
        for kind, env in made.items():
            step: Callable[[Any], Any] = env._core.step if kind == CORE else env.step
            prepare = partial(env.reset, options={"phase": 0.0})
            name = step_name(kind, period)
            steppers.append(Contender(name, prepare, _walk(step, actions), _STEPS))
    envs = {kind: _vector(None) for kind in (CORE, OFF)} | {ON: _vector("rgb_array")}
    many = _vector_actions(envs[OFF])
    for kind, batch in envs.items():
        run = _walk(batch._core.step if kind == CORE else batch.step, many)
        prepare = partial(batch.reset, seed=0)
        name = step_name(kind, PERIODS[0], ENVS)
        steppers.append(Contender(name, prepare, run, len(many), arms=ENVS, close=batch.close))
    return steppers


def _vector(render_mode: Any) -> OctoArmVectorEnv:
    # One thread: the second core is not always free.
    return OctoArmVectorEnv(ENVS, render_mode=render_mode, max_episode_steps=None, threads=1)


def _teacher_actions(env: OctoArmEnv) -> list[NDArray[np.float32]]:
    env.reset(seed=0, options={"phase": 0.0})
    actions = []
    for _ in range(_STEPS):
        actions.append(env.teacher_action().astype(np.float32))
        env.step(actions[-1])
    return actions


def _vector_actions(envs: OctoArmVectorEnv) -> list[NDArray[np.float32]]:
    envs.reset(seed=0)
    actions = []
    for _ in range(_STEPS // 10):
        actions.append(envs.teacher_actions().astype(np.float32))
        envs.step(actions[-1])
    return actions


def _walk(step: Callable[[Any], Any], actions: list[NDArray[np.float32]]) -> Callable[[int], None]:
    def run(steps: int) -> None:
        for action in actions[:steps]:
            step(action)

    return run


def _headless() -> dict[str, str]:
    return {"MUJOCO_GL": "egl"} if sys.platform == "linux" else {}


@contextmanager
def _defaults(**variables: str) -> Iterator[None]:
    """Set environment variables that are not set; all is as before in the end."""
    before = set(os.environ)
    for name, value in variables.items():
        os.environ.setdefault(name, value)
    try:
        yield
    finally:
        # PyOpenGL's own too, which MuJoCo sets.
        for name in set(os.environ) - before:
            del os.environ[name]
