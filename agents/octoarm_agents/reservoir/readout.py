"""The linear readout: spring lengths times weights, and nothing else (Eq. 26)."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal, Self, cast

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_array, check_is_fitted, validate_data

from octoarm_env.arrays import Float

Method = Literal["pinv", "ridge", "noise"]

METHODS = ("pinv", "ridge", "noise")


def readout_outputs(lengths: Float, weights: Float) -> Float:
    """What a readout says (Eq. 26), (…, outputs).

    Args:
        lengths: (…, springs) [m].
        weights: (springs, outputs), or (springs + 1, outputs) with the bias last.
    """
    springs = lengths.shape[-1]
    outputs: Float = lengths @ weights[:springs]
    return outputs + weights[springs] if len(weights) > springs else outputs


def noise_ridge(rows: int, noise: float) -> float:
    """M ν²/3: what white noise, uniform in [-ν, ν], adds to the diagonal of SᵀS for M rows [m²]."""
    return rows * noise**2 / 3


@dataclass(eq=False, repr=False)
class Readout(MultiOutputMixin, RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """A linear readout of the spring lengths, a scikit-learn regressor.

    With S the M rows of lengths, T those of targets and W the weights, it is fitted by

    - ``"pinv"``: W = S⁺ T, the Moore-Penrose pseudo-inverse of section 2.2: least squares, of all
      solutions the one with the smallest weights;
    - ``"ridge"``: the least ‖S W - T‖² + ridge ‖W‖²;
    - ``"noise"``: least squares as if the lengths carried white noise, uniform in [-ν, ν], as the
      paper adds it to the recorded rows (section 2.2.2). On average such noise adds its variance
      ν²/3 to the diagonal of SᵀS for every row, so that the fit is that of ``"ridge"`` with
      M ν²/3. This expectation is used as it stands: nothing is drawn and the fit is the same each
      time.

    The paper's readout has no bias. With `bias` one is fitted too; no penalty and no noise acts on
    it. All penalties are taken as they stand, whatever the number of rows.

    Parameters that the method does not use are ignored, as scikit-learn's estimators ignore theirs,
    so that a search may vary them together with the method.

    Args:
        method: see above.
        tolerance: singular values up to `tolerance` times the largest count as zero, in [0, 1);
            None: max(M, springs) · eps. A fit without penalty gives no weight to their directions;
            for all methods it decides `rank_`.
        ridge: penalty of method ``"ridge"``, in the unit of a squared length times rows [m²],
            not negative.
        noise: ν of method ``"noise"``, half width of the noise [m], not negative.
        bias: fit a bias too.

    Attributes:
        weights_: (springs, outputs), or (springs + 1, outputs) with the bias as the last row, in
            the unit of the targets per metre (the bias in that of the targets); with targets in
            degrees, just what `octoarm_env.Arm.run_closed_loop` takes.
        singular_values_: (springs,), of the lengths, largest first: with the rows of `penalty`,
            without their means if there is a bias.
        rank_: how many of them are not zero by `tolerance`.
        training_error_: root mean square over rows of the residual's norm, without penalties, in
            the unit of the targets.
        single_output_: whether the targets were one-dimensional; `predict` answers in kind.
        n_features_in_: number of springs.
        feature_names_in_: (springs,), only after a fit to a data frame with column names.
    """

    method: Method = "pinv"
    _: KW_ONLY
    tolerance: float | None = None
    ridge: float = 0.0
    noise: float = 0.0
    bias: bool = False

    def fit(
        self,
        X: ArrayLike,  # noqa: N803, scikit-learn's name
        y: ArrayLike,
        penalty: ArrayLike | None = None,
    ) -> Self:
        """Fit the weights.

        Args:
            X: S, (M, springs), lengths [m].
            y: T, (M, outputs) or (M,); row t is what the readout must give for row t of `X`.
            penalty: P, (K, springs), deviations of the lengths to which the readout must not
                answer [m]: adds ‖P W‖² to what is made least, as K more rows with target zero would
                (generalised Tikhonov regularisation). The larger a row, the less the readout
                answers to it; the bias is not part of the answer.

        Returns:
            This readout.

        Raises:
            ValueError: arrays that do not fit together or hold numbers that are not finite; a
                parameter outside its range.
        """
        self.check_parameters()
        lengths, targets = validate_data(
            self, X, y, dtype=np.float64, multi_output=True, y_numeric=True
        )
        rows, springs = lengths.shape
        self.single_output_ = targets.ndim == 1
        targets = targets.reshape(rows, -1).astype(np.float64, copy=False)
        none = np.empty((0, springs))
        penalties = none if penalty is None else check_array(penalty, input_name="penalty")
        if penalties.shape[1] != springs:
            raise ValueError(
                f"penalty has shape {penalties.shape}: expected (K, {springs}) as X has"
            )

        triangle, means = _triangle(lengths, targets, penalties, self.bias)
        # Singular values of the triangular factor: SᵀS would lose everything below 1e-8 of the
        # largest.
        left, singular, right = np.linalg.svd(triangle[:, :springs])
        eps = float(np.finfo(np.float64).eps)
        tolerance = max(rows, springs) * eps if self.tolerance is None else self.tolerance
        # What the means leave of lengths that do not vary is their rounding, not a signal.
        rounding = springs * eps * float(np.linalg.norm(means[1 : 1 + springs]))
        kept = singular > max(tolerance * singular[0], rounding)
        ridge = 0.0
        if self.method != "pinv":
            ridge = self.ridge if self.method == "ridge" else noise_ridge(rows, self.noise)
        if ridge > 0:
            factors = singular / (singular**2 + ridge)
        else:
            factors = np.divide(1.0, singular, out=np.zeros(springs), where=kept)
        weights = right.T @ (factors[:, np.newaxis] * (left.T @ triangle[:, springs:]))
        if self.bias:
            bias = (means[1 + springs :] - means[1 : 1 + springs] @ weights) / means[0]
            weights = np.vstack((weights, bias))

        self.weights_ = weights
        self.singular_values_ = singular
        self.rank_ = int(np.count_nonzero(kept))
        residuals = targets - readout_outputs(lengths, self.weights_)
        self.training_error_ = math.sqrt(float(np.einsum("to,to->", residuals, residuals)) / rows)
        return self

    def predict(self, X: ArrayLike) -> Float:  # noqa: N803, scikit-learn's name
        """Outputs of the readout.

        Args:
            X: (T, springs), lengths [m].

        Returns:
            (T, outputs), or (T,) after a fit to one-dimensional targets.
        """
        check_is_fitted(self)
        lengths = validate_data(self, X, dtype=np.float64, reset=False)
        outputs = readout_outputs(lengths, self.weights_)
        return outputs[:, 0] if self.single_output_ else outputs

    @property
    def coef_(self) -> Float:
        """Weights without the bias as scikit-learn has them: (outputs, springs), or (springs,)."""
        weights: Float = self.weights_[: self.n_features_in_].T
        return weights[0] if self.single_output_ else weights

    @property
    def intercept_(self) -> Float | float:
        """The bias, (outputs,) or a number; zero where none is fitted."""
        bias: Float = self.weights_[self.n_features_in_ :].sum(axis=0)
        return float(bias[0]) if self.single_output_ else bias

    def check_parameters(self) -> None:
        """Check the parameters, as `fit` does first.

        Raises:
            ValueError: a parameter outside its range, even if the method does not use it.
        """
        if self.method not in METHODS:
            raise ValueError(f"method = {self.method!r}: expected one of {METHODS}")
        _check_number("ridge", self.ridge, "a penalty, finite and not negative")
        _check_number("noise", self.noise, "a number of metres, finite and not negative")
        if self.tolerance is not None:
            _check_number("tolerance", self.tolerance, "None or a number in [0, 1)", below=1.0)


def _triangle(lengths: Float, targets: Float, penalties: Float, bias: bool) -> tuple[Float, Float]:
    """The least-squares problem in as few rows as it has unknowns, by Householder's QR.

    Returns:
        (springs, springs + outputs), lengths and targets, without their means if there is a bias;
        and the row that determines the bias, (1 + springs + outputs,), else zeros.
    """
    rows, springs = lengths.shape
    # A column of ones first: what is below its row is the problem with the means taken out. The
    # rows of the penalty have a zero there, so that it does not act on the bias.
    columns = (np.ones((rows, 1)), lengths, targets) if bias else (lengths, targets)
    matrix, first = np.hstack(columns), int(bias)
    after = matrix.shape[1] - first - springs
    matrix = np.vstack((matrix, np.pad(penalties, ((0, 0), (first, after)))))
    # (NumPy's stubs know only the mode that returns a pair.)
    factor = cast("Float", np.linalg.qr(matrix, mode="r"))
    triangle = np.zeros((springs, matrix.shape[1] - first))
    body = factor[first : first + springs, first:]
    triangle[: len(body)] = body
    return triangle, factor[0] if bias else np.zeros(1 + matrix.shape[1])


def _check_number(name: str, value: Any, expected: str, below: float = math.inf) -> None:
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (number and 0 <= value < below):
        raise ValueError(f"{name} = {value!r}: expected {expected}")
