"""The driven arm in other libraries: a node of reservoirpy, a transformer of scikit-learn."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from reservoirpy.node import Node
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from octoarm_agents.analysis.drive import Drive, DrivenArm
from octoarm_env import ArmParameters
from octoarm_env.arrays import Float
from octoarm_env.parameters import BodyLike

Memory = dict[str, Float]
"""State of a node: ``out``, the lengths (springs,) [m]; ``body``, the state of all compartments;
``base``, (4,) [rad, rad/s]; ``last``, (1,), the value before."""


class ArmNode(Node):  # type: ignore[misc]
    """The arm as a node of reservoirpy: a value in, the lengths of its springs out.

    It stands where a ``reservoirpy.nodes.Reservoir`` stands: ``ArmNode() >> Ridge(ridge=1e-12)``.
    Each value of the input turns the base for one hold, as `Drive` says; it begins at rest.

    Args:
        arm: the body, as in `octoarm_env.Arm`; None: the default.
        drive: how values, of size at most 1, turn the base.
        name: of the node.

    Raises:
        ValueError, TypeError: a body or a drive that cannot be.
    """

    def __init__(
        self, arm: BodyLike | None = None, drive: Drive | None = None, name: str | None = None
    ) -> None:
        self.drive = Drive() if drive is None else drive
        self.name = name
        self._driven = DrivenArm(ArmParameters.of(arm), self.drive)
        self.output_dim = len(self._driven.arm.lengths)
        self._rest = self._memory(self._driven.arm.lengths)
        self.state = self._rest

    def initialize(self, x: Any, y: Any = None) -> None:
        """Take one value a time step.

        Raises:
            ValueError: an input of more than one feature.
        """
        del y
        self._set_input_dim(x)
        if self.input_dim != 1:
            raise ValueError(f"input of {self.input_dim} features: expected 1, the drive's value")
        self.initialized = True

    def reset(self) -> Memory:
        """Put the arm at rest; give the state before."""
        before: Memory = self.state
        self.state = self._rest
        return before

    def _step(self, state: Memory, x: Float) -> Memory:
        return self._run(state, x[np.newaxis])[0]

    def _run(self, state: Memory, x: Float) -> tuple[Memory, Float]:
        self._driven.place(state["body"], state["base"], float(state["last"][0]))
        lengths = self._driven.run(_values(x))
        return self._memory(lengths[-1]), lengths

    def _memory(self, lengths: Float) -> Memory:
        driven = self._driven
        base, last = driven.arm.state.base, np.array([driven.last])
        return {"out": lengths, "body": driven.vector, "base": base, "last": last}


class ArmTransformer(TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """The arm as a transformer of scikit-learn: a time series in, the lengths of its springs out.

    In a pipeline with a linear model it is the paper's reservoir:
    ``make_pipeline(ArmTransformer(), StandardScaler(), Ridge(1e-8))``. Rows are steps of time, in
    order; every `transform` begins at rest.

    Args:
        arm: the body, as in `octoarm_env.Arm`; None: the default.
        amplitude: R, the angle of an input of 1 [degrees].
        hold: time of one row [s].

    Attributes:
        n_features_in_: 1.
    """

    def __init__(
        self, arm: BodyLike | None = None, amplitude: float = 20.0, hold: float = 0.05
    ) -> None:
        self.arm = arm
        self.amplitude = amplitude
        self.hold = hold

    def fit(self, X: ArrayLike, y: Any = None) -> Self:  # noqa: N803
        """Check the input; nothing is learnt.

        Args:
            X: (T, 1), values of size at most 1.
            y: ignored.

        Raises:
            ValueError: another shape, larger values, or a body or drive that cannot be.
        """
        del y
        _values(validate_data(self, X, dtype=np.float64))
        self._driven()
        return self

    def transform(self, X: ArrayLike) -> Float:  # noqa: N803
        """Give the lengths after each hold.

        Args:
            X: (T, 1), values of size at most 1.

        Returns:
            The spring lengths, (T, springs) [m].

        Raises:
            ValueError: another shape, or larger values.
            sklearn.exceptions.NotFittedError: before `fit`.
            DomainError: the arm left the domain of the model.
        """
        check_is_fitted(self, "n_features_in_")
        return self._driven().run(_values(validate_data(self, X, dtype=np.float64, reset=False)))

    def _driven(self) -> DrivenArm:
        drive = Drive(amplitude=self.amplitude, hold=self.hold)
        return DrivenArm(ArmParameters.of(self.arm), drive)


def _values(x: Float) -> Float:
    if x.shape[1] != 1:
        raise ValueError(f"input of {x.shape[1]} features: expected 1, the drive's value")
    # A NaN is beyond the range too.
    if not (np.abs(x) <= 1).all():
        raise ValueError(f"input up to {np.abs(x).max()}: expected values in [-1, 1]")
    values: Float = x[:, 0]
    return values
