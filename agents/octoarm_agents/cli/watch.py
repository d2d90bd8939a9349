"""`octoarm watch`."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from octoarm_agents.cli.evaluate import find_policy
from octoarm_agents.cli.options import (
    EpisodeSeed,
    EpisodeSteps,
    NoiseSize,
    OtherArm,
    PushSize,
    number_between,
    read_body,
)

if TYPE_CHECKING:
    import gymnasium as gym
    import numpy as np
    from numpy.typing import NDArray
    from rich.console import Console
    from rich.text import Text

    from octoarm_agents.policies.loading import Policy
    from octoarm_agents.policies.terminal import Moment
    from octoarm_env import OctoArmEnv

    Float = NDArray[np.float64]

__all__ = ["Episode", "watch"]

_LATE = 2.0
"""How much of the past is drawn [s]."""

_FASTEST = 100.0
_FRAME_TIME = 0.04
"""Least time between frames [s]."""


def _check_speed(value: float) -> float:
    if not 0 < value <= _FASTEST:
        raise typer.BadParameter(f"{value} is not above 0 and at most {_FASTEST:g}.")
    return value


def watch(
    policy: Annotated[
        str,
        typer.Argument(
            help="File of an agent (.json, .npz), or AGENT/TARGET for one that comes along.",
            show_default=False,
        ),
    ],
    episodes: Annotated[
        int, typer.Option(help="Number of episodes.", callback=number_between(1, 4096))
    ] = 1,
    steps: EpisodeSteps = 500,
    seed: EpisodeSeed = 0,
    speed: Annotated[
        float,
        typer.Option(
            help=f"Times real time, above 0 and at most {_FASTEST:g}.", callback=_check_speed
        ),
    ] = 1.0,
    push: PushSize = 0.0,
    noise: NoiseSize = 0.0,
    arm: OtherArm = None,
) -> None:
    """Watch a saved agent drive the arm, live in the terminal.

    On the left the base: its angles, where they were in the last two seconds, and the orbit that
    they are to follow. On the right the arm from the side, above the strain of its 80 springs:
    blue where they are shorter than at rest, red where they are longer.

    Where standard output is no terminal, nothing waits: the last frame of each episode and its
    figures are printed. Ctrl-C ends the show.
    """
    from rich.console import Console

    console = Console(highlight=False)
    try:
        "⣿●".encode(console.encoding)
    except (UnicodeEncodeError, LookupError):
        typer.echo(
            f"Standard output is {console.encoding}, which cannot show the arm: "
            "set PYTHONIOENCODING=utf-8.",
            err=True,
        )
        raise typer.Exit(1) from None
    agent: Policy = find_policy(policy)
    env = _make_env(agent, arm, steps)
    shown = (
        Episode(
            agent,
            env,
            f"{policy} · episode {index + 1} of {episodes} · seed {seed + index}",
            seed=seed + index,
            steps=steps,
            push=push,
            noise=noise,
        )
        for index in range(episodes)
    )
    # FORCE_COLOR and the like make a terminal of a pipe in the eyes of rich.
    live = sys.stdout.isatty() and console.is_terminal and not console.is_dumb_terminal
    try:
        if live:
            _show_live(console, shown, speed)
        else:
            _print_all(console, shown)
    except KeyboardInterrupt:
        typer.echo("Stopped.")
    finally:
        env.close()


class Episode:
    """An agent in one environment, step by step: what `policies.rollout.roll_out` does, to watch.

    Course and rewards are those of ``roll_out(policy, envs, seed=seed, …)`` in a single
    environment, to the bit; the direction of the push and the noise are drawn as there.

    Args:
        policy: the agent.
        env: in which `steps` are allowed; it is reset.
        title: of the frames.
        seed: of the episode.
        steps: that it lasts.
        push: size of the push [degrees]; 0: none.
        noise: half width of the noise on the lengths that the agent sees [m]; 0: none.
    """

    def __init__(
        self,
        policy: Policy,
        env: gym.Env[Any, Any],
        title: str,
        *,
        seed: int,
        steps: int,
        push: float = 0.0,
        noise: float = 0.0,
    ) -> None:
        import numpy as np

        from octoarm_agents.environment import inspect_env
        from octoarm_agents.policies.rollout import Noise, Push
        from octoarm_agents.policies.terminal import Scene

        self._policy, self._env = policy, env
        self._arm_env = cast("OctoArmEnv", env.unwrapped)
        self.seed, self.steps, self.steps_made = seed, steps, 0
        self.failure = ""
        self.period = float(policy.settings["control_period"])
        self._push = Push.after_a_second(push, self.period)
        self._noise = Noise(noise)
        self._random = np.random.default_rng(seed)
        direction = self._random.uniform(0, 2 * np.pi, 1)
        self._offset = np.stack((np.cos(direction), np.sin(direction)), axis=1)
        self._offset *= push / self._arm_env.action_range
        self._state: Any = None
        self._rewards, self._errors = np.zeros((steps, 1)), np.zeros((steps, 1))
        self._angles, self._actions = np.zeros((steps, 1, 2)), np.zeros((steps, 1, 2))

        self._lengths, self._info = env.reset(seed=seed)
        rest_length = inspect_env(env)[0].rest_length
        self.scene = Scene(title, self._arm_env.orbit, rest_length, steps * self.period, steps)
        late = max(2, round(_LATE / self.period))
        self._trace: deque[Float] = deque(maxlen=late)
        self._shapes: deque[Float] = deque(maxlen=late)
        self._earned = self._reach = self._strain = 0.0
        self._remember()

    @property
    def ended(self) -> bool:
        """Whether all steps are made, or the arm left its domain."""
        return self.steps_made == self.steps or bool(self.failure)

    def step(self) -> None:
        """Let the agent act once."""
        import numpy as np

        step, seen = self.steps_made, self._lengths[np.newaxis]
        if self._noise.size:
            seen = seen + self._noise.size * self._random.uniform(-1, 1, seen.shape)
        # A batch of one, as in an evaluation: a lone observation is summed in another order.
        chosen, self._state = self._policy.predict(
            seen, state=self._state, episode_start=np.array([step == 0])
        )
        command = np.asarray(chosen, dtype=np.float32)
        if self._pushed:
            command = np.clip(command + self._offset, -1, 1).astype(np.float32)
        self._lengths, reward, terminated, _, self._info = self._env.step(command[0])
        self._rewards[step], self._errors[step] = reward, self._info["tracking_error"]
        self._angles[step], self._actions[step] = self._info["base_angles"], chosen
        self._earned += float(reward)
        self.steps_made += 1
        if terminated:
            self.failure = str(self._info["failure"])
        self._remember()

    def moment(self, speed: str) -> Moment:
        """What is to be seen now; `speed` is that of the show, in words."""
        import numpy as np

        from octoarm_agents.policies.terminal import Moment
        from octoarm_agents.reservoir.orbit import orbit_distance

        trace, shapes = np.array(self._trace), np.array(self._shapes)
        disturbances = ["PUSHED"] if self._pushed else []
        disturbances += ["NOISE"] if self._noise.size else []
        disturbances += ["LEFT ITS DOMAIN"] if self.failure else []
        return Moment(
            time=self.steps_made * self.period,
            trace=trace,
            target=self._info["target"],
            arm=self._arm_env.arm_positions,
            sway=np.stack((shapes.min(axis=0), shapes.max(axis=0))),
            reach=self._reach,
            lengths=self._lengths,
            strain=self._strain,
            earned=self._earned,
            possible=float(self.steps_made),
            error=float(self._info["tracking_error"]),
            distance=float(orbit_distance(trace[-1:], self.scene.orbit)[0]),
            speed=speed,
            disturbance=" + ".join(disturbances),
        )

    def figures(self) -> dict[str, Any]:
        """Give the figures of the episode that has ended, as `evaluate_policy` does."""
        import numpy as np

        from octoarm_agents.policies.measures import orbit_measures, tracking_measures
        from octoarm_agents.policies.rollout import Rollout

        rollout = Rollout(
            self._rewards,
            self._angles,
            self._errors,
            alive=np.arange(self.steps)[:, np.newaxis] < self.steps_made,
            failed=np.array([bool(self.failure)]),
            actions=self._actions,
        )
        orbit = orbit_measures(
            rollout,
            self.scene.orbit,
            amplitude=self._arm_env.amplitude,
            period=self._arm_env.period,
            control_period=self.period,
            window=self.steps // 2,
        )
        return {**orbit, **tracking_measures(rollout)}

    def report(self) -> str:
        """Give the figures in words."""
        figures = self.figures()
        parts = [
            f"return {figures['return']:.1f} of {self.steps}",
            f"error {figures['tracking_error']:.3f}°",
            *(
                f"{name} {'-' if figures[key] is None else format(figures[key], '.4f')}"
                for name, key in (("orbit distance", "orbit_distance"), ("period", "period"))
            ),
        ]
        if self.failure:
            end = f"left its domain after {self.steps_made * self.period:.2f} s: {self.failure}"
            parts.append(end)
        return f"seed {self.seed}: {', '.join(parts)}"

    @property
    def _pushed(self) -> bool:
        begin = self._push.begin
        return self._push.size > 0 and begin <= self.steps_made < begin + self._push.steps

    def _remember(self) -> None:
        import numpy as np

        self._trace.append(np.asarray(self._info["base_angles"]))
        across = self._arm_env.arm_positions[:, 0]
        self._shapes.append(across)
        self._reach = max(self._reach, float(np.abs(across).max()))
        # The most strained twentieth, next to the base, would leave no colours for the others.
        strains = np.sort(np.abs(self._lengths / self.scene.rest_length - 1))
        self._strain = max(self._strain, float(strains[int(0.95 * (len(strains) - 1))]))


class _Pace:
    """Keeps the time of the show to the clock on the wall.

    Args:
        speed: seconds of the show in a second.
        period: seconds of the show in a step.
    """

    def __init__(self, speed: float, period: float) -> None:
        self._speed, self._period = speed, period
        self._due = time.monotonic()
        self._steps: deque[float] = deque([self._due])

    def wait(self) -> None:
        """Wait until a step more is due."""
        self._due += self._period / self._speed
        while (left := self._due - time.monotonic()) > 0:
            time.sleep(min(left, 0.1))
        now = time.monotonic()
        if now - self._due > 0.2:  # too slow, or stopped for a while: what is lost is lost
            self._due = now
        self._steps.append(now)
        while len(self._steps) > 2 and self._steps[0] < now - 1:
            self._steps.popleft()

    def __str__(self) -> str:
        wanted, passed = f"{self._speed:g}×", self._steps[-1] - self._steps[0]
        if passed < 0.5:
            return wanted
        reached = (len(self._steps) - 1) * self._period / passed
        return wanted if reached > 0.95 * self._speed else f"{reached:.2g}× of {wanted}"


def _make_env(policy: Policy, arm: Path | None, steps: int) -> gym.Env[Any, Any]:
    import gymnasium as gym

    from octoarm_agents.environment import ENV_ID

    body, hint = policy.parameters, "'POLICY'"
    if arm is not None:
        body, hint = read_body(arm), "'--arm'"
        if body.compartments != policy.parameters.compartments:
            raise typer.BadParameter(
                f"{arm} has {body.compartments} compartments, the agent is for a body with "
                f"{policy.parameters.compartments}.",
                param_hint=hint,
            )
    try:
        return gym.make(ENV_ID, max_episode_steps=steps, arm=body, **policy.settings)
    except (TypeError, ValueError) as error:  # a body that cannot swing along the target
        raise typer.BadParameter(f"{error}.", param_hint=hint) from None


def _draw(console: Console, episode: Episode, speed: str, height: int) -> Text:
    from octoarm_agents.policies.terminal import draw_frame

    colour = console.color_system is not None and not console.no_color
    moment = episode.moment(speed)
    return draw_frame(episode.scene, moment, console.width, max(1, height), colour=colour)


def _print_all(console: Console, episodes: Iterable[Episode]) -> None:
    for episode in episodes:
        while not episode.ended:
            episode.step()
        console.print(_draw(console, episode, "unlimited", console.height - 1))
        typer.echo(f"{episode.report()}\n")


def _show_live(console: Console, episodes: Iterable[Episode], speed: float) -> None:
    from rich.live import Live

    reports: list[str] = []
    episode: Episode | None = None
    words = f"{speed:g}×"
    try:
        with Live(console=console, screen=True, auto_refresh=False) as live:
            for episode in episodes:
                pace = _Pace(speed, episode.period)
                next_frame = time.monotonic()
                while not episode.ended:
                    pace.wait()
                    episode.step()
                    now = time.monotonic()
                    if now < next_frame and not episode.ended:
                        continue
                    words = str(pace)
                    live.update(_draw(console, episode, words, console.height), refresh=True)
                    # At most half of the time goes into drawing.
                    next_frame = now + max(_FRAME_TIME, 2 * (time.monotonic() - now))
                reports.append(episode.report())
    except KeyboardInterrupt:
        reports.append("Stopped.")
    # The screen of before is back; what was seen last stays on it.
    if episode is not None:
        console.print(_draw(console, episode, words, console.height - 2 - len(reports)))
    typer.echo("\n".join(reports))
