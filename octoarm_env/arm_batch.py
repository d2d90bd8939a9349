"""Many bodies at once, without episodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from octoarm_env import _core
from octoarm_env.arguments import thread_count, whole_number
from octoarm_env.arm import Arm, ArmState, core_state, pair
from octoarm_env.arrays import Float


class BatchRun(NamedTuple):
    """What a run of N arms over T steps gave.

    Attributes:
        lengths: (N, T // stride, 4 n), the spring lengths after every `stride`-th step [m]; those
            of an arm that was stopped are repeated from there on.
        steps: (N,) int64, the steps that each arm has made.
        failures: N entries, the :class:`octoarm_env.DomainError` that stopped an arm, or None.
        outputs: (N, T, 2), the readouts' outputs in closed loop [degrees]; None in open loop.
    """

    lengths: Float
    steps: NDArray[np.int64]
    failures: tuple[_core.DomainError | None, ...]
    outputs: Float | None = None


class ArmBatch:
    """Many arms that run together, several times as fast as one after the other.

    Eight arms stand in the lanes of vector instructions, and threads share the groups of eight;
    every arm has the very bits that :class:`octoarm_env.Arm` has alone. Parameters and actuators
    may differ from arm to arm, the number of compartments may not.

    Args:
        arms: at least one; their states and muscle inputs are copied.
        threads: threads that share the work, the calling one included; None: as many as the
            processor runs at once.

    Raises:
        ValueError: no arms, or arms with different numbers of compartments.
        TypeError: something else than arms.
    """

    def __init__(self, arms: Sequence[Arm], *, threads: int | None = None) -> None:
        for index, arm in enumerate(arms):
            if not isinstance(arm, Arm):
                raise TypeError(f"arms[{index}] must be an Arm, not {type(arm).__name__}")
        self._arms = len(arms)
        self._core = _core.ArmBatch([arm._core for arm in arms], thread_count(threads))

    def __len__(self) -> int:
        return self._arms

    @property
    def lengths(self) -> Float:
        """The spring lengths now, (N, 4 n) [m]."""
        return self._core.lengths

    @property
    def states(self) -> list[ArmState]:
        """The arms' complete states; assigning N of them restores them to the bit."""
        return [ArmState(*state) for state in self._core.get_states()]

    @states.setter
    def states(self, states: Sequence[ArmState]) -> None:
        self._core.set_states(
            [core_state(f"states[{index}]", state) for index, state in enumerate(states)]
        )

    @property
    def muscles(self) -> tuple[Float, Float]:
        """Muscle inputs (ξ_c, δ_c) of all arms, each (N, n, 4) [N], as those of an `Arm`.

        They act until changed; what a run of many steps needs differently is set between runs.
        """
        return self._core.get_muscles()

    @muscles.setter
    def muscles(self, inputs: tuple[ArrayLike, ArrayLike]) -> None:
        self._core.set_muscles(*pair("muscles", inputs))

    def run(self, angles: ArrayLike, *, stride: int = 1) -> BatchRun:
        """Follow sequences of commands, one a physics step.

        Args:
            angles: (T, 2), θ and φ for all arms, or (N, T, 2) [degrees].
            stride: steps from one row of lengths to the next.

        Returns:
            Lengths, steps and failures. An arm whose step would leave the domain of the model stops
            there, keeps its state and disturbs no other.

        Raises:
            ValueError, TypeError: a wrong shape or dtype, numbers that are not finite, or angles
                beyond ±3600 degrees.
            MemoryError: the lengths of so many steps do not fit into memory.
            KeyboardInterrupt: heard within a fraction of a second. No step is made then, nor after
                the errors above.
        """
        stride = whole_number("stride", stride, 1, 2**63 - 1)
        lengths, (steps, failures) = self._core.run(angles, stride)
        return BatchRun(lengths, steps, tuple(failures))

    def run_closed_loop(
        self,
        weights: ArrayLike,
        steps: int,
        perturbation: ArrayLike | None = None,
        *,
        stride: int = 1,
    ) -> BatchRun:
        """Feed linear readouts of the spring lengths back as base commands (Eqs. 24-26).

        Args:
            weights: (4 n, 2) for all arms, or (N, 4 n, 2); with one row more, the last is the bias.
            steps: number of physics steps T.
            perturbation: (T, 2) for all arms, or (N, T, 2), added to the outputs [degrees].
            stride: steps from one row of lengths to the next; outputs are given for every step.

        Returns:
            Lengths, steps, failures and outputs, as :meth:`run`.

        Raises:
            ValueError, TypeError, MemoryError, KeyboardInterrupt: as :meth:`run`.
        """
        steps = whole_number("steps", steps, 0, 2**63 - 1)
        stride = whole_number("stride", stride, 1, 2**63 - 1)
        outputs, lengths, (made, failures) = self._core.run_closed_loop(
            weights, steps, perturbation, stride
        )
        return BatchRun(lengths, made, tuple(failures), outputs)

    def __getstate__(self) -> Any:
        raise TypeError("an ArmBatch cannot be pickled; pickle its arms and states")

    def __repr__(self) -> str:
        return f"ArmBatch({self._arms} arms)"
