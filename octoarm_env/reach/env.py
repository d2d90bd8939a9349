"""The environment ``OctoArmReach-v0``."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, Literal, SupportsFloat

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from octoarm_env._core import ReachBatch
from octoarm_env.arrays import Float
from octoarm_env.parameters import ArmParameters, BodyLike
from octoarm_env.reach.settings import ReachSettings, goal_option, reach_bound
from octoarm_env.rendering.camera import Camera
from octoarm_env.rendering.history import ReachHistory
from octoarm_env.rendering.pictures import Pictures, Scene, render_fps
from octoarm_env.single import SingleEnv

__all__ = ["OctoArmReachEnv"]


class OctoArmReachEnv(SingleEnv):
    r"""The muscles of an octopus-like arm bring its tip to a goal; its base stands still.

    ## Description
    The body is that of ``OctoArm-v0``, the simulated arm of Nakajima et al. (2013). It hangs in
    water from a base that does not move, and is driven by the muscles in its springs: forces ξ_c and
    δ_c of Eqs. 1 and 4, with the forces of Eqs. 7 and 8 that keep the volume. A goal is a point that
    the tip has been held at by some activation of the muscles. The interface is that of the goal
    environments of Gymnasium-Robotics, as hindsight experience replay wants it.

    ## Action space
    `Box(0, 1, (5 * segments,), float32)`: what the activation of the muscles is to be. Of every
    segment, from the base on:

    | Num     | Action                                       | Min | Max |
    |---------|----------------------------------------------|-----|-----|
    | 5s + 0… 5s + 3 | longitudinal muscles on the side +x, +y, -x, -y | 0 | 1 |
    | 5s + 4  | transverse muscles, all four                 | 0   | 1   |

    The activation a of a muscle follows its action u with da/dt = (u - a) / `activation_time`, and
    the muscle pulls with a · `max_force` · (r / r_0)², r being the compartment's mean radius and r_0
    that of the base: the same stress everywhere.

    ## Observation space
    `Dict`:

    | Key             | Space                 | Meaning                                     |
    |-----------------|-----------------------|---------------------------------------------|
    | `observation`   | `Box(80,)`, float64; with `observe_rates` `Box(160,)` | lengths of the longitudinal springs [m], as in `OctoArm-v0`; then their rates [m/s] |
    | `achieved_goal` | `Box(3,)`, float64    | where the tip is [m]; the base is at the origin, the arm hangs along +z |
    | `desired_goal`  | `Box(3,)`, float64    | where it should be [m]                      |

    ## Rewards
    `reward_type="sparse"`: 0 where the tip is within `distance_threshold` of the goal, else -1.
    `"dense"`: minus the distance in metres. :meth:`octoarm_env.reach.OctoArmReachEnv.compute_reward` gives the same for other goals.

    ## Starting state
    At rest, no muscle active. The goal is drawn from `goals`; `reset(options={"goal": (x, y, z)})`
    takes that one.

    ## Episode end
    *Termination*: the arm left the domain of the model; `info["failure"]` says how. With the default
    `max_force` neither random nor bang-bang actions do it. A reached goal ends nothing.
    *Truncation*: after 100 steps (`max_episode_steps` of `gym.make`).

    ## Information
    | Key          | Type    | Meaning                                       |
    |--------------|---------|-----------------------------------------------|
    | `is_success` | bool    | the tip is within `distance_threshold` of the goal |
    | `distance`   | float64 | from tip to goal [m]                          |
    | `body`       | int64   | which of `settings.drawn_bodies` the arm is    |
    | `failure`    | str     | only on termination                           |
    | `body_factors` | float64 (K,) | with `vary`: the factors that `body` was drawn with, for the K names in alphabetical order |
    | `true_lengths` | float64 (80,) | with `length_noise`, `delay` or `dropout`: the spring lengths themselves, now [m] |
    | `dropped`    | bool (80,) | with `dropout`: which springs are not seen in this episode |
    | `delay`      | int64   | with `delay`: control periods that what is seen is old |

    The last four are there only where their argument is on (not zero or None).

    ## Arguments
    | Parameter            | Default    | Description                                     |
    |----------------------|------------|-------------------------------------------------|
    | `reward_type`        | `"sparse"` | `"sparse"` or `"dense"`                         |
    | `control_period`     | `0.05`     | seconds from action to action, a multiple of `arm.timestep` |
    | `segments`           | `5`        | parts along the arm whose muscles act as one, 1 to `arm.compartments` |
    | `max_force`          | `1.0`      | of a fully active muscle at the base, in (0, 100] N |
    | `activation_time`    | `0.1`      | time constant of the activation, in (0, 10] s   |
    | `distance_threshold` | `0.02`     | see Rewards, in (0, 1] m                         |
    | `observe_rates`      | `False`    | whether `observation` holds, after the 80 lengths, how fast each has changed in the last control period on average [m/s], 0 after a reset |
    | `goals`              | `None`     | array (G, 3) of goals in metres; None: :func:`octoarm_env.reach.reachable_goals`, those of the default body |
    | `arm`                | `None`     | the body, as in `OctoArm-v0`                    |
    | `length_noise`, `delay`, `dropout` | `0` | what disturbs the observed lengths, as in `OctoArm-v0` |
    | `vary`, `bodies`, `body_seed` | `None`, `1`, `0` | bodies that are drawn, as in `OctoArm-v0` |
    | `render_mode`, `width`, `height`, `camera`, `overlay` | | pictures, as in `OctoArm-v0`: muscles shine as they are active, and the goal is drawn |

    Wrong arguments and actions raise a ValueError or TypeError that names what is wrong, its value
    and its range; nothing is changed then. The same seed gives the same bits, on every machine.
    pickle and deepcopy continue an episode exactly where it stands. Many environments at once:
    `gym.make_vec("OctoArmReach-v0", num_envs=64)`.

    ## Version history
    * v0: initial version.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012, declared so by gymnasium.Env
    _core: ReachBatch

    def __init__(
        self,
        reward_type: Literal["sparse", "dense"] = "sparse",
        control_period: float = 0.05,
        segments: int = 5,
        max_force: float = 1.0,
        activation_time: float = 0.1,
        distance_threshold: float = 0.02,
        observe_rates: bool = False,
        goals: ArrayLike | None = None,
        arm: BodyLike | None = None,
        length_noise: float = 0.0,
        delay: int = 0,
        dropout: int = 0,
        vary: Mapping[str, tuple[float, float]] | None = None,
        bodies: int = 1,
        body_seed: int = 0,
        render_mode: Literal["human", "rgb_array"] | None = None,
        width: int = 640,
        height: int = 480,
        camera: Camera | Mapping[str, Any] | str | None = None,
        overlay: bool = True,
    ) -> None:
        self.render_mode = render_mode
        self._settings = ReachSettings(
            ArmParameters.of(arm),
            control_period,
            segments,
            max_force,
            activation_time,
            distance_threshold,
            reward_type,
            observe_rates,
            goals,  # type: ignore[arg-type]  # brought into its plain form there
            length_noise,
            delay,
            dropout,
            {} if vary is None else vary,
            bodies,
            body_seed,
        )
        self._core = self._new_core()
        self.metadata = self.metadata | {"render_fps": render_fps(control_period)}
        modes = self.metadata["render_modes"]
        self._pictures = Pictures(
            [self._settings], render_mode, modes, width, height, camera, overlay
        )
        self._history = None if render_mode is None else ReachHistory(control_period)
        self.observation_space, self.action_space = goal_spaces(self._settings, self._core)

    _fixed = frozenset(inspect.signature(__init__).parameters) - {"self"}
    _remedy = 'gym.make("OctoArmReach-v0", {}=...)'

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Float], dict[str, Any]]:
        """Begin an episode at rest.

        Args:
            seed: starts the generator of goals anew.
            options: ``{"goal": (x, y, z)}`` sets the goal [m].

        Returns:
            The observation and the info.

        Raises:
            ValueError, TypeError: a goal that no part of the arm can ever reach, or an unknown
                option.
        """
        goal = goal_option(options, reach_bound(self._settings.arm))
        observations, infos = self._core.reset(None, [self._drawn_seed(seed)], goal)
        observation, info = _first(observations, infos)
        if self._history is not None:
            self._history.begin(info)
            self._show(self._history)
        return observation, info

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[dict[str, Float], SupportsFloat, bool, bool, dict[str, Any]]:
        """Let the muscles pull for one control period.

        Args:
            action: (5 * segments,), each entry in [0, 1].

        Returns:
            Observation, reward, terminated, truncated (always False here), info.

        Raises:
            ValueError, TypeError: an action of another shape, an entry that is not a finite number
                in [0, 1], or a step before `reset` or after the end of the episode; nothing is
                changed then.
        """
        observations, rewards, terminated, _, infos = self._core.step(np.asanyarray(action)[None])
        observation, info = _first(observations, infos)
        reward = float(rewards[0])
        if self._history is not None:
            self._history.add(info, reward)
            self._show(self._history)
        return observation, reward, bool(terminated[0]), False, info

    def compute_reward(
        self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any = None
    ) -> Any:
        """Give the reward of a tip for a goal, whatever the episode's own is.

        Args:
            achieved_goal: where the tip is, (3,) or (K, 3) [m].
            desired_goal: where it should be, of the same shape [m].
            info: not used.

        Returns:
            The reward, or (K,) of them.
        """
        return self._settings.reward(achieved_goal, desired_goal)

    def compute_terminated(
        self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any = None
    ) -> bool:
        """Tell that a goal ends nothing: False."""
        return False

    def compute_truncated(
        self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any = None
    ) -> bool:
        """Tell that a goal ends nothing: False."""
        return False

    @property
    def activations(self) -> Float:
        """How active the muscles are, (segments, 5), each in [0, 1]."""
        return self._core.activations(0)

    @property
    def time(self) -> float:
        """Since the reset [s]."""
        return self._core.elapsed[0] * self._settings.control_period

    @property
    def arm_joints(self) -> Float:
        """Ends of the springs, as :attr:`octoarm_env.Arm.joints`, (N + 1, 4, 3) [m]."""
        return self._core.joints(0)

    @property
    def arm_positions(self) -> Float:
        """Centres of the arm's planes in the world frame, base first, (N + 1, 3) [m]."""
        return self._core.positions(0)

    @property
    def settings(self) -> ReachSettings:
        """What the episodes are made of."""
        return self._settings

    def _new_core(self) -> ReachBatch:
        settings = self._settings
        return ReachBatch(settings.text, settings.goal_table, 1, None, "disabled", 1)

    @property
    def _scene(self) -> Scene:
        return reach_scene(self._core, 0, self._history)


def goal_spaces(settings: ReachSettings, core: ReachBatch) -> tuple[Any, Any]:
    """Give the spaces of an environment."""
    bound = reach_bound(settings.arm)
    point = spaces.Box(-bound, bound, (3,), np.float64)
    low, high = core.observation_bounds
    fastest = (high - low) / settings.control_period
    springs = 4 * settings.arm.compartments
    rates = core.observation_len - springs
    seen = spaces.Box(
        np.repeat((low, -fastest), (springs, rates)),
        np.repeat((high, fastest), (springs, rates)),
        dtype=np.float64,
    )
    observation = spaces.Dict({"observation": seen, "achieved_goal": point, "desired_goal": point})
    return observation, spaces.Box(0.0, 1.0, (core.action_len,), np.float32)


def reach_scene(core: ReachBatch, index: int, history: ReachHistory) -> Scene:
    """Give what is in the picture of an environment, and tell its past where the goal is."""
    history.activations = core.activations(index)
    history.goal = core.goals[index]
    return Scene(core.joints(index), lambda: (np.zeros((1, 2)), 30.0))


def _first(
    observations: dict[str, Float], infos: dict[str, Any]
) -> tuple[dict[str, Float], dict[str, Any]]:
    """Give the only environment's part."""
    info = {key: values[0] for key, values in infos.items() if not key.startswith("_")}
    # As vector environments join flags, those of Python.
    info["is_success"] = bool(info["is_success"])
    return {key: values[0] for key, values in observations.items()}, info
