"""The linear readout: spring lengths times weights, and nothing else (Eq. 26)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_array, check_is_fitted, check_X_y, validate_data

from octoarm_agents.common.whole import whole_number

__all__ = ["Readout"]

Float = NDArray[np.float64]
Method = Literal["pinv", "ridge", "noise"]

METHODS = ("pinv", "ridge", "noise")


class Readout(MultiOutputMixin, RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """A linear readout of the spring lengths, a scikit-learn regressor.

    With S the M rows of lengths, T those of targets and W the weights, it is fitted by

    - ``"pinv"``: W = S⁺ T, the Moore-Penrose pseudo-inverse of section 2.2: least squares, of all
      solutions the one with the smallest weights;
    - ``"ridge"``: the least |S W - T|² + ridge |W|²;
    - ``"noise"``: least squares as if the lengths carried white noise, uniform in [-ν, ν], as the
      paper adds it to the recorded rows (section 2.2.2). On average such noise adds its variance
      ν²/3 to the diagonal of SᵀS for every row, so that the fit is that of ``"ridge"`` with
      M ν²/3. This expectation is used as it stands: nothing is drawn and the fit is the same each
      time. With `sampled` the noise is really drawn, once, and the pseudo-inverse follows.

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
            not negative; the other methods ignore it.
        noise: ν of method ``"noise"``, half width of the noise [m], not negative; the other methods
            ignore it.
        sampled: draw the noise of method ``"noise"``; the other methods ignore it.
        bias: fit a bias too.
        washout: rows dropped at the beginning, of every sequence by `fit_sequences`.
        random_state: seed (or generator) of the noise drawn; only used with `sampled`.

    Attributes:
        weights_: (springs, outputs), or (springs + 1, outputs) with the bias as the last row, in
            the unit of the targets per metre (the bias in that of the targets); with targets in
            degrees, just what `octoarm_env.Arm.run_closed_loop` takes.
        singular_values_: (springs,), of the lengths, largest first: with the noise drawn and the
            rows of `penalty`, without their means if there is a bias.
        rank_: how many of them are not zero by `tolerance`.
        training_error_: root mean square over rows of the residual's norm, without noise and
            penalties, in the unit of the targets.
        single_output_: whether the targets were one-dimensional; `predict` answers in kind.
        n_features_in_: number of springs.
        feature_names_in_: (springs,), only after a fit to a data frame with column names.
    """

    def __init__(
        self,
        method: Method = "pinv",
        *,
        tolerance: float | None = None,
        ridge: float = 0.0,
        noise: float = 0.0,
        sampled: bool = False,
        bias: bool = False,
        washout: int = 0,
        random_state: int | np.random.Generator | None = None,
    ) -> None:
        self.method = method
        self.tolerance = tolerance
        self.ridge = ridge
        self.noise = noise
        self.sampled = sampled
        self.bias = bias
        self.washout = washout
        self.random_state = random_state

    def fit(
        self,
        X: ArrayLike,  # noqa: N803, scikit-learn's name
        y: ArrayLike,
        penalty: ArrayLike | None = None,
    ) -> Self:
        """Fit the weights.

        Args:
            X: S, (M, springs), lengths [m], in the order of time.
            y: T, (M, outputs) or (M,); row t is what the readout must give for row t of `X`.
            penalty: P, (K, springs), deviations of the lengths to which the readout must not
                answer [m]: adds |P W|² to what is made least, as K more rows with target zero would
                (generalised Tikhonov regularisation). The larger a row, the less the readout
                answers to it; the bias is not part of the answer.

        Returns:
            This readout.

        Raises:
            ValueError: arrays that do not fit together, hold numbers that are not finite, or no row
                after the washout; a parameter outside its range.
        """
        self.check_parameters()
        lengths, targets = self._after_washout("X", self._validate(X, y))
        return self._fit(lengths, targets, penalty)

    def fit_sequences(
        self,
        X: Sequence[ArrayLike],  # noqa: N803, scikit-learn's name
        y: Sequence[ArrayLike],
        penalty: ArrayLike | None = None,
    ) -> Self:
        """Fit the weights to several runs at once; the washout is dropped from each.

        Args:
            X: one (M_i, springs) a run, lengths [m].
            y: one (M_i, outputs) or (M_i,) a run.
            penalty: as in `fit`.

        Returns:
            This readout.

        Raises:
            ValueError: as `fit`; the message names the run.
        """
        self.check_parameters()
        if len(X) != len(y) or len(X) == 0:
            raise ValueError(
                f"X holds {len(X)} sequences and y {len(y)}: expected as many, and at least one"
            )
        runs = []
        for index, (lengths, targets) in enumerate(zip(X, y, strict=True)):
            try:
                run = check_X_y(lengths, targets, multi_output=True, y_numeric=True)
            except ValueError as error:
                raise ValueError(f"sequence {index}: {error}") from None
            runs.append(self._after_washout(f"X[{index}]", run))
            shapes = [tuple(part.shape[1:] for part in runs[each]) for each in (0, index)]
            if shapes[0] != shapes[1]:
                raise ValueError(
                    f"sequence {index}: its rows of X and y have shapes {shapes[1]}, "
                    f"those of sequence 0 {shapes[0]}"
                )
        joined = (np.concatenate(parts) for parts in zip(*runs, strict=True))
        return self._fit(*self._validate(*joined), penalty)

    def predict(self, X: ArrayLike) -> Float:  # noqa: N803, scikit-learn's name
        """Outputs of the readout.

        Args:
            X: (T, springs), lengths [m].

        Returns:
            (T, outputs), or (T,) after a fit to one-dimensional targets.
        """
        check_is_fitted(self)
        lengths = validate_data(self, X, dtype=np.float64, reset=False)
        outputs = self._outputs(lengths)
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
        whole_number("washout", self.washout)

    def _validate(self, lengths: ArrayLike, targets: ArrayLike) -> tuple[Float, Float]:
        """Both as finite numbers with as many rows; notes the number of springs."""
        checked: tuple[Float, Float] = validate_data(
            self, lengths, targets, dtype=np.float64, multi_output=True, y_numeric=True
        )
        return checked

    def _after_washout(self, name: str, run: tuple[Float, Float]) -> tuple[Float, Float]:
        """Lengths and targets without the first `washout` rows."""
        lengths, targets = run
        if len(lengths) <= self.washout:
            raise ValueError(
                f"{name} has {len(lengths)} rows: expected more than the washout of {self.washout}"
            )
        return lengths[self.washout :], targets[self.washout :]

    def _fit(self, lengths: Float, targets: Float, penalty: ArrayLike | None) -> Self:
        """Fit to valid arrays, the washout already dropped."""
        rows, springs = lengths.shape
        self.single_output_ = targets.ndim == 1
        targets = targets.reshape(rows, -1).astype(np.float64, copy=False)
        seen, ridge = lengths, 0.0
        if self.method == "ridge":
            ridge = float(self.ridge)
        elif self.method == "noise" and self.sampled:
            random = self._generator()
            seen = lengths + random.uniform(-self.noise, self.noise, lengths.shape)
        elif self.method == "noise":
            ridge = rows * self.noise**2 / 3

        triangle, means = _triangle(seen, targets, _penalty_rows(penalty, springs), self.bias)
        # Singular values of the triangular factor: SᵀS would lose everything below 1e-8 of the
        # largest.
        left, singular, right = np.linalg.svd(triangle[:, :springs])
        eps = float(np.finfo(np.float64).eps)
        tolerance = max(rows, springs) * eps if self.tolerance is None else self.tolerance
        # What the means leave of lengths that do not vary is their rounding, not a signal.
        rounding = springs * eps * float(np.linalg.norm(means[1 : 1 + springs]))
        kept = singular > max(tolerance * singular[0], rounding)
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
        residuals = targets - self._outputs(lengths)
        self.training_error_ = math.sqrt(float(np.einsum("to,to->", residuals, residuals)) / rows)
        return self

    def _generator(self) -> np.random.Generator:
        try:
            return np.random.default_rng(self.random_state)
        except (TypeError, ValueError) as error:
            raise ValueError(f"random_state = {self.random_state!r}: {error}") from None

    def _outputs(self, lengths: Float) -> Float:
        springs = lengths.shape[1]
        outputs: Float = lengths @ self.weights_[:springs]
        return outputs + self.weights_[springs] if len(self.weights_) > springs else outputs


def _triangle(
    lengths: Float, targets: Float, penalty: Float | None, bias: bool
) -> tuple[Float, Float]:
    """The least-squares problem in as few rows as it has unknowns, by Householder's QR.

    Returns:
        (springs, springs + outputs), lengths and targets, without their means if there is a bias;
        and the row that determines the bias, (1 + springs + outputs,), else zeros.
    """
    rows, springs = lengths.shape
    # A column of ones first: what is below its row is the problem with the means taken out. The
    # rows of the penalty have a zero there, so that it does not act on the bias.
    columns = (np.ones((rows, 1)), lengths, targets) if bias else (lengths, targets)
    matrix = np.hstack(columns)
    first = int(bias)
    if penalty is not None:
        more = np.zeros((len(penalty), matrix.shape[1]))
        more[:, first : first + springs] = penalty
        matrix = np.vstack((matrix, more))
    # (NumPy's stubs know only the mode that returns a pair.)
    factor = cast("Float", np.linalg.qr(matrix, mode="r"))
    triangle = np.zeros((springs, matrix.shape[1] - first))
    body = factor[first : first + springs, first:]
    triangle[: len(body)] = body
    return triangle, factor[0] if bias else np.zeros(1 + matrix.shape[1])


def _penalty_rows(penalty: ArrayLike | None, springs: int) -> Float | None:
    if penalty is None:
        return None
    rows: Float = check_array(penalty, dtype=np.float64, input_name="penalty")
    if rows.shape[1] != springs:
        raise ValueError(f"penalty has shape {rows.shape}: expected (K, {springs}) as X has")
    return rows


def _check_number(name: str, value: Any, expected: str, below: float = math.inf) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ValueError(f"{name} = {value!r}: expected {expected}")
    if not 0 <= value < below:
        raise ValueError(f"{name} = {value!r}: expected {expected}")
