"""The environment ``OctoArm-v0``."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, Literal, SupportsFloat

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from octoarm_env._core import Episode
from octoarm_env.arrays import Float
from octoarm_env.parameters import ArmParameters, BodyLike
from octoarm_env.rendering.camera import Camera
from octoarm_env.rendering.history import History
from octoarm_env.rendering.pictures import Pictures, Scene, render_fps
from octoarm_env.settings import EpisodeSettings, phase_option
from octoarm_env.single import SingleEnv
from octoarm_env.targets import TargetName

__all__ = ["OctoArmEnv"]


class OctoArmEnv(SingleEnv):
    r"""An octopus-like soft arm swings in water; only its base is driven, only its springs are seen.

    ## Description
    The body is the simulated arm of Nakajima et al. (2013), "A soft body as a reservoir": twenty
    compartments of springs, masses and dampers in water, driven by rotating the base. The agent turns
    the base so that its two angles follow a limit cycle. It is not told the time, the target or the
    base angles: all it has are the lengths of the arm's 80 longitudinal springs, so the phase of the
    motion must be read from the body. A linear readout of the lengths suffices to hold the cycle.

    What a turning base does to the arm is a parameter of the body, `arm.base_coupling`. With
    `"gravity"`, the paper's and that of the default body `"nakajima2013"`, the base turns the
    direction of gravity and nothing else: arm and water live in the frame of the base, and a base
    that jumps throws nothing about. With `"inertial"` the base accelerates the arm in the world, as
    a motor would: `arm="inertial"` is a body for that. Such a base needs a servo
    (`actuator="servo"`), since a jump is an endless acceleration, and a smaller `amplitude`: at 20
    degrees neither random nor bang-bang actions break it, at 30 bang-bang actions do.

    ## Action space
    `Box(-1, 1, (2,), float32)`: the base rotation as a fraction of `action_range`.

    | Num | Action                              | Min | Max | Unit                 |
    |-----|-------------------------------------|-----|-----|----------------------|
    | 0   | commanded θ, rotation about x       | -1  | 1   | `action_range` degrees |
    | 1   | commanded φ, rotation about (new) y | -1  | 1   | `action_range` degrees |

    With `actuator="direct"`, the paper's position control, the base reaches the command at the end
    of the control period at constant speed; with `"servo"` it follows the command through a
    critically damped second-order servo of natural frequency `arm.servo_frequency`, which lags by
    some 27 ms.

    ## Observation space
    `Box(low, high, (80,), float64)`: the lengths of the longitudinal springs in metres, in the paper's
    order: springs 1-4 of compartment 1 (at the base), springs 1-4 of compartment 2, …

    | Num            | Observation                      | Min   | Max  | Unit |
    |----------------|----------------------------------|-------|------|------|
    | 4(j-1) + (i-1) | length of spring i, compartment j | 0.001 | 0.06 | m    |

    The bounds are the limits of the model's domain, 0.05 and 3 times `arm.rest_length`. The lengths
    differ from it by a few parts in a hundred. A linear readout takes them as they are; a network
    wants them scaled: :class:`octoarm_env.wrappers.Strain` gives l / l_0 - 1 in percent, or let
    `VecNormalize` of stable-baselines3 normalise them. Untreated, PPO learns next to nothing.

    ## Rewards
    `reward = reward_tracking + reward_action_change`, both in `info`:

    - `reward_tracking = tracking_weight * exp(-(e / (reward_width * amplitude))**2)`, where *e* is the
      distance in degrees between the base angles and the target at the end of the control period;
    - `reward_action_change = -action_change_weight * |action - previous action|**2`.

    With the default weights a step is worth at most 1 and at least -0.08; an episode of 500 steps at
    most 500. The lead-compensated clock (:class:`octoarm_env.TeacherPolicy`) earns over 499.9.

    ## Starting state
    On the orbit: the base exactly on the target at a random phase, the body swinging along as if it
    had been forced so for seconds. The phase is drawn from 256 snapshots of such a swing.
    `reset(options={"phase": p})` takes the snapshot nearest to phase *p* in turns, 0 to 1, instead.

    ## Episode end
    *Termination*: the arm left the domain of the model; `info["failure"]` says which limit, which
    compartment, when. The observation is then the last valid one, and `reward_tracking` is 0. With
    the default body neither 400,000 random steps nor bang-bang actions of 0.5 to 10 Hz do it.
    *Truncation*: after 500 steps (`max_episode_steps` of `gym.make`).

    ## Information
    | Key                    | Type           | Meaning                                   |
    |------------------------|----------------|-------------------------------------------|
    | `base_angles`          | float64 (2,)   | actual θ, φ [degrees]                      |
    | `target`               | float64 (2,)   | target θ, φ at this instant [degrees]      |
    | `tracking_error`       | float64        | distance between the two [degrees]         |
    | `reward_tracking`      | float64        | see Rewards                                |
    | `reward_action_change` | float64        | see Rewards                                |
    | `body`                 | int64          | which of `settings.drawn_bodies` the arm is |
    | `failure`              | str            | only on termination                        |
    | `body_factors`         | float64 (K,)   | with `vary`: the factors that `body` was drawn with, for the K names in alphabetical order |
    | `action_noise`         | float64 (2,)   | with `action_noise`: what was added to the commanded angles in this step [degrees]; 0 after a reset |
    | `true_lengths`         | float64 (80,)  | with `length_noise`, `delay` or `dropout`: the spring lengths themselves, now [m] |
    | `dropped`              | bool (80,)     | with `dropout`: which springs are not seen in this episode |
    | `delay`                | int64          | with `delay`: control periods that what is seen is old |

    The last five are there only where their argument is on (not zero or None), and not over a server
    (`OctoArmRemote-v0`). They are for who looks from outside, a critic or a log: an agent that is to
    be robust must not see them.

    ## Arguments
    | Parameter              | Default       | Description                                             |
    |------------------------|---------------|---------------------------------------------------------|
    | `target`               | `"quadratic"` | `"quadratic"`, `"van_der_pol"`, `"lissajous"` (Eqs. 27-29), or an array (T, 2) of one period in degrees, one row a physics step |
    | `amplitude`            | `None`        | largest \|angle\| of the target in degrees; None: the paper's R, 90, 130 and 10 for the three names in this order, or the array's own |
    | `control_period`       | `0.01`        | seconds from action to action, a multiple of `arm.timestep` |
    | `actuator`             | `"direct"`    | `"direct"` or `"servo"`                                  |
    | `arm`                  | `None`        | the body: an `ArmParameters`, a name (`"nakajima2013"`, `"inertial"`), a mapping or a JSON file; None: `"nakajima2013"` |
    | `action_range`         | `None`        | degrees of base rotation at an action of 1; None: 1.3 × amplitude |
    | `tracking_weight`      | `1.0`         | see Rewards                                              |
    | `reward_width`         | `0.3`         | see Rewards                                              |
    | `action_change_weight` | `0.01`        | see Rewards                                              |
    | `length_noise`         | `0.0`         | half width of white noise on every length that is seen, 0 to 1 m; what is seen stays within the observation space |
    | `action_noise`         | `0.0`         | half width of white noise on the commanded angles, drawn every control period, 0 to 90 degrees |
    | `delay`                | `0`           | control periods that a reading takes to the agent, 0 to 1000; at the begin of an episode the first one is seen |
    | `dropout`              | `0`           | springs, drawn anew at every reset, whose rest length is seen in place of their length |
    | `vary`                 | `None`        | factors (low, high) in (0, 10] on numbers of the arm by their names, such as `{"longitudinal_stiffness": (0.8, 1.2)}`: bodies are drawn between them. Not `compartments`, `timestep`, `rest_length`, `servo_frequency` |
    | `bodies`               | `1`           | bodies that are drawn, 1 to 256, one of which each reset takes; the first environment of these settings takes up to a tenth of a second for each |
    | `body_seed`            | `0`           | of the bodies: the same ones whatever the seed of the episodes; another one gives bodies not seen before |
    | `render_mode`          | `None`        | `"rgb_array"` or `"human"`, see Rendering                |
    | `width`                | `640`         | of a picture, 16 to 4096 pixels                          |
    | `height`               | `480`         | of a picture, 16 to 4096 pixels                          |
    | `camera`               | `None`        | a `rendering.Camera`, a mapping of its fields, or `"perspective"` (default), `"front"`, `"side"`, `"top"`, `"base"` |
    | `overlay`              | `True`        | figures, phase portrait and strains in the picture; they show target and base angles, so switch them off for an agent that sees |

    Lists and mappings of any kind are taken, those of OmegaConf and Hydra too. `spec` holds all arguments
    as JSON can: `gym.make(EnvSpec.from_json(env.spec.to_json()))` is the same environment again. They
    cannot be changed in an environment that is made; assigning one is an AttributeError.

    Wrong arguments raise a ValueError or TypeError that names the argument, its value and its range.
    So does an action that is not two finite numbers in [-1, 1]; the episode is then unchanged
    (use `gymnasium.wrappers.ClipAction` for a policy that overshoots; what rounding in single
    precision adds to a bound is clipped). The same seed gives the same
    bits, on every machine. pickle and deepcopy continue an episode exactly where it stands.

    Many environments at once: `gym.make_vec("OctoArm-v0", num_envs=64)` makes the native batch,
    :class:`octoarm_env.OctoArmVectorEnv`, a hundred times as fast as single ones in a loop of Python.

    ## Rendering
    With `render_mode="rgb_array"`, `render()` gives the arm in three dimensions as an array
    (height, width, 3), uint8; no display is needed (`gym.make` takes `"rgb_array_list"` too). With
    `"human"` every step is shown in a window, in the time that it takes (drag: around the arm,
    wheel: zoom, h: keys; where the window is closed the arm goes on unseen). Both need pygame-ce,
    `pip install "octoarm-env[render]"`, and neither changes a bit of the simulation.
    `metadata["render_fps"]` is one frame a step.

    ## Version history
    * v0: initial version.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 100}  # noqa: RUF012, declared so by gymnasium.Env
    _core: Episode

    def __init__(
        self,
        target: TargetName | ArrayLike = "quadratic",
        amplitude: float | None = None,
        control_period: float = 0.01,
        actuator: Literal["direct", "servo"] = "direct",
        arm: BodyLike | None = None,
        action_range: float | None = None,
        tracking_weight: float = 1.0,
        reward_width: float = 0.3,
        action_change_weight: float = 0.01,
        length_noise: float = 0.0,
        action_noise: float = 0.0,
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
        self._settings = EpisodeSettings(
            target,  # type: ignore[arg-type]  # brought into its plain form there, as the body is
            amplitude,
            control_period,
            actuator,
            ArmParameters.of(arm),
            action_range,
            tracking_weight,
            reward_width,
            action_change_weight,
            length_noise,
            action_noise,
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
        self._history = None if render_mode is None else History(control_period)
        low, high = self._core.observation_bounds
        count = self._core.observation_len
        self.observation_space = spaces.Box(low, high, (count,), np.float64)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    _fixed = frozenset(inspect.signature(__init__).parameters) - {"self"}
    _remedy = 'gym.make("OctoArm-v0", {}=...)'

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float, dict[str, Any]]:
        """Begin an episode on the orbit.

        Args:
            seed: starts the generator of phases anew.
            options: ``{"phase": p}`` begins at phase p of the target, in turns from 0 to 1.

        Returns:
            The spring lengths, (80,) [m], and the info.

        Raises:
            ValueError: a phase outside [0, 1], or an unknown option.
        """
        phase = phase_option(options)
        given = self._drawn_seed(seed)
        if given is not None:
            self._core.seed(given)
        observation, info = self._core.reset(phase)
        if self._history is not None:
            self._history.begin(info)
            self._show(self._history)
        return observation, info

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Float, SupportsFloat, bool, bool, dict[str, Any]]:
        """Turn the base for one control period.

        Args:
            action: (2,), each entry in [-1, 1].

        Returns:
            Observation (80,) [m], reward, terminated, truncated (always False here), info.

        Raises:
            ValueError, TypeError: an action that is not two finite numbers in [-1, 1], or a step
                before `reset` or after the end of the episode; nothing is changed then.
        """
        observation, reward, terminated, info = self._core.step(action)
        if self._history is not None:
            self._history.add(info, reward)
            self._show(self._history)
        return observation, reward, terminated, False, info

    def teacher_action(self) -> Float:
        """Give the lead-compensated clock's action now, (2,); it depends on the time alone."""
        return self._core.teacher_action()

    @property
    def action_range(self) -> float:
        """Degrees of base rotation at an action of 1."""
        return self._core.action_range

    @property
    def amplitude(self) -> float:
        """Largest absolute angle of the target [degrees]."""
        return self._core.amplitude

    @property
    def period(self) -> float:
        """Time of one turn of the target [s]."""
        return self._core.period

    @property
    def orbit(self) -> Float:
        """The target over one period at equal intervals, (K, 2) [degrees]."""
        return self._core.orbit

    @property
    def arm_joints(self) -> Float:
        """Ends of the longitudinal springs, as :attr:`octoarm_env.Arm.joints`, (N + 1, 4, 3) [m]."""
        return self._core.joints

    @property
    def arm_positions(self) -> Float:
        """Centres of the arm's planes in the world frame, base first, (N + 1, 3) [m]."""
        return self._core.positions

    @property
    def settings(self) -> EpisodeSettings:
        """What the episodes are made of."""
        return self._settings

    def _new_core(self) -> Any:
        return Episode(self._settings.text)

    @property
    def _scene(self) -> Scene:
        return Scene(self._core.joints, lambda: (self.orbit, self.action_range))
