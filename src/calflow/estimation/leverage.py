"""Leverage: what a fit leaves of its rows once their own pull on it is taken into account.

Residuals studentised by it show which measured rows the model does not explain. Where a model lacks something, its parameters make
up for it at the poses that they were fitted to, and most at those that hang on few others. What is left there tells too little of
other poses; errors of poses that were left out tell it (Stone 1974). They come from one Jacobian, without a refit (Allen's PRESS
1974): with V the covariance of a pose's residuals, over the noise, and H what the fit is unsure of there, they are V (V - H)⁻¹
times the residual, and V (V - H)⁻¹ V is their covariance where the model lacks nothing.

Extrapolation: joints whose readings lie beyond what was fitted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from calflow.estimation.accuracy import Residual, completed, leading_errors, residuals
from calflow.estimation.fit import Fit, restated
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.model_tables import Extrapolation
from calflow.estimation.noise import Noise
from calflow.files.deferred import pd
from calflow.files.tables import column, typed
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements

FALSE_FLAGS = 0.01  # chance that any good row of a whole data set is flagged
TINY = 1e-12  # standard deviations: below it errors are rounding
LEAST_LEFT = 1e-3  # of a row's variance, that a fit leaves


@dataclass(frozen=True, kw_only=True)
class JudgedResidual(Residual):
    """What the identified model leaves of a measured row, and whether that is too much."""

    whitened: float = column("root mean square of the error's parts in standard deviations of noise and discrepancy")
    flagged: bool = column("whether it is too large for noise and for the spread of the rest")


@dataclass(frozen=True)
class Studentised:
    """Residuals of rows over what noise, discrepancy and the fit's own leverage let expect.

    squared (n_rows,) is their square, values (n_rows, n_units) are their parts, nan where a row has fewer; whitened (n_rows,) is
    the root mean square in standard deviations of noise and discrepancy alone.
    """

    squared: np.ndarray
    values: np.ndarray
    whitened: np.ndarray

    @property
    def units(self) -> np.ndarray:
        """How many parts each row has, shape (n_rows,)."""
        return np.asarray((~np.isnan(self.values)).sum(axis=1))

    @staticmethod
    def of(
        result: Fit, data: Measurements, noise: Noise, far: float = np.inf, beside: np.ndarray | None = None
    ) -> Studentised:
        """Studentise the residuals of rows by their leverage, so that a row that pulls the fit to itself still shows.

        Rows beyond far robust standard deviations counted in the fit as if they were there (Huber 1964). The variance of a row
        of weight w is 1 + (1 - 2 w) times what the fit is unsure of there; held-out rows have no weight. beside is the covariance
        of the estimate beside errors that the fit did not count, which is that of held-out rows: of its own rows those errors
        took away nothing.
        """
        model, estimate = completed(result.model, result.estimate, data)
        places = [model.parameters.index(parameter) for parameter in result.model.parameters]
        squared, whitened = np.empty(len(data)), np.empty(len(data))
        values = np.full((len(data), max(len(observation.units) for observation in model.observations)), np.nan)
        parts = []
        for rows, residual, whole in LeastSquares.of(model, data, noise).linearised(estimate):
            jacobian = whole[:, :, places]
            predicted = jacobian @ result.covariance @ jacobian.transpose(0, 2, 1)
            if beside is not None:
                held = ~data.train[rows]
                predicted[held] = jacobian[held] @ beside @ jacobian[held].transpose(0, 2, 1)
            parts.append((rows, residual, predicted))
            whitened[rows] = np.sqrt((residual**2).mean(axis=1))
        usual = max(float(np.median(whitened[data.train])), TINY)
        weight = np.where(data.train, np.minimum(1.0, far * usual / np.maximum(whitened, TINY)) ** 2, 0.0)
        for rows, residual, predicted in parts:
            spread = np.eye(residual.shape[1]) + (1 - 2 * weight[rows])[:, None, None] * predicted
            inverse = np.linalg.pinv(spread, hermitian=True)
            squared[rows] = np.maximum(np.einsum("ni,nij,nj->n", residual, inverse, residual), 0.0)
            sd = np.sqrt(np.maximum(np.einsum("nii->ni", spread), LEAST_LEFT))
            values[np.asarray(rows)[:, None], np.arange(residual.shape[1])] = residual / sd
        return Studentised(squared, values, whitened)


def judged(result: Fit, data: Measurements, noise: Noise) -> pd.DataFrame:
    """Return the table of `JudgedResidual`s; flagged is what noise and the discrepancy of the rest do not explain.

    The fit may be less sure than its problem says: that is beside errors that it did not count.
    """
    studentised = Studentised.of(restated(result, result.problem), data, noise, beside=result.covariance)
    limit = scipy.stats.chi2.isf(FALSE_FLAGS / len(data), studentised.units)
    return judged_table(result, data, studentised, (studentised.squared > limit) & (data.train | data.held_out))


def judged_table(result: Fit, data: Measurements, studentised: Studentised, flagged: np.ndarray) -> pd.DataFrame:
    """Return the table of `JudgedResidual`s with the rows (n_rows,) that are flagged."""
    table = residuals(leading_errors(result.model, result.estimate, data), data)
    return typed(table.assign(whitened=studentised.whitened, flagged=flagged), JudgedResidual)


UNSURE = 0.05  # chance that new poses are missed by more than is promised at most
BY_CHANCE = 0.05  # chance of errors as large where nothing is lacking, above which they show no excess


@dataclass(frozen=True)
class LeftOut:
    """Errors of poses left out in turn, over the noise: the sum of their squares, what was to be expected, and how many they are.

    squares are the degrees of freedom of their mean, share is the median of what is expected of a pose, scatter what single errors
    are per axis [m], device that of the measuring device alone [m], freedom the degrees of freedom left to the fit.
    """

    found: float
    expected: float
    number: int
    squares: float
    share: float
    scatter: float
    device: float
    freedom: float

    @property
    def rms(self) -> float:
        """Root mean square of the errors of positions, noise in it [m]; nan without any."""
        return float(np.sqrt(3 * self.found / self.number)) * self.scatter if self.number else float("nan")

    @property
    def at_new_poses(self) -> float:
        """Root mean square distance [m] by which poses like these will be missed, the device's noise not in it; nan without any.

        It is what is expected of poses left out, or what was found where that is more.
        """
        if not self.number:
            return float("nan")
        squared = self.scatter**2 * max(self.found, self.expected) / self.number
        return float(np.sqrt(3 * max(squared - self.device**2, 0.0)))

    @property
    def at_most(self) -> float:
        """What that is no more than with a probability of 95 % [m]; nan without any.

        Its square is as unsure as a mean of squares, one a pose, as what a model errs by all points of a pose share.
        """
        return self.at_new_poses * float(np.sqrt(self.squares / scipy.special.chdtri(self.squares or 1.0, 1 - UNSURE)))

    def excess(self, level: np.ndarray | float = 1.0) -> np.ndarray:
        """Return by how much more than expected the model errs, sd per axis [m], were squares by a level larger; at least 0."""
        if not self.number:
            return np.zeros(np.shape(level))
        more = np.maximum(level * np.float64(self.found / self.expected) - 1.0, 0.0) * self.share
        return np.asarray(np.sqrt(more)) * self.scatter

    def drawn(self, number: int, rng: np.random.Generator) -> np.ndarray:
        """Draw so many values of the excess as the errors, by their degrees of freedom, allow (number,) [m].

        Errors that are no larger than chance makes them now and then show none: what may be there besides is not in them.
        """
        if not self.number or scipy.stats.chi2.sf(self.freedom * self.found / self.expected, self.freedom) > BY_CHANCE:
            return np.zeros(number)
        return self.excess(self.freedom / rng.chisquare(self.freedom, number))


def left_out(fit: Fit, pose: np.ndarray) -> LeftOut:
    """Return the errors of poses left out in turn of a fitted model.

    Args:
        fit: the model as it was fitted; lengths alone are taken into account.
        pose: the number of each row's pose, (n_rows,): rows of one pose are left out together.
    """
    squares, covered, sizes = np.concatenate([*_by_pose(fit, pose), np.zeros((3, 0))], axis=1)
    number = int(sizes.sum())
    share = float(np.median(covered / sizes)) if number else 0.0
    freedom = max(1.0, number - fit.effective_parameters)
    # Added pose by pose, so that where parts end does not show in the last digit.
    total, expected = float(sum(squares)), float(sum(covered))
    # Poses that hang on few others make up most of the mean (Satterthwaite 1946).
    independent = expected**2 / float(sum(covered**2)) if number else 0.0
    return LeftOut(total, expected, number, independent, share, fit.problem.scatter, fit.problem.device, freedom)


def _by_pose(fit: Fit, pose: np.ndarray) -> Iterator[np.ndarray]:
    """Yield for poses, of as many lengths, what each errs by when left out, what is expected, and how many lengths; (3, n_poses).

    Errors are squared, and over the noise.
    """
    for block in fit.problem.reweighted(fit.estimate, fit.loss).blocks:
        lengths = np.array([unit == METRE for unit in block.observation.units])
        if not lengths.any():
            continue
        block = block.together(pose[block.rows])
        for part, (rows, residual, jacobian) in zip(
            block.parts(pose[block.rows]), block.linearised(fit.estimate, pose[block.rows]), strict=True
        ):
            _, first, count = np.unique(pose[rows], return_index=True, return_counts=True)
            for many in np.unique(count):
                rows_of = first[count == many, None] + np.arange(many)
                spread = block.sharing.only(part).covariance(rows_of)
                yield _left_out(
                    residual[rows_of][..., lengths], jacobian[rows_of][:, :, lengths], spread, fit.covariance
                )


def _left_out(residual: np.ndarray, jacobian: np.ndarray, spread: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """The same of poses with as many rows: residuals (n_poses, n_rows, n_lengths), their Jacobian and covariance between rows."""
    n_poses, _, n_lengths = residual.shape
    residual = residual.reshape(n_poses, -1)
    jacobian = jacobian.reshape(*residual.shape, len(covariance))
    size = residual.shape[1]
    spread = np.einsum("nij,ab->niajb", spread, np.eye(n_lengths)).reshape(n_poses, size, size)
    weighed = np.linalg.solve(spread - jacobian @ covariance @ jacobian.transpose(0, 2, 1), spread)
    missed = np.einsum("nji,nj->ni", weighed, residual)
    return np.array(
        [np.vecdot(missed, missed), np.einsum("nij,nij->n", spread, weighed), np.full(n_poses, float(size))]
    )


def halved(places: np.ndarray, levels: int) -> np.ndarray:
    """Number places (n, n_axes) by the leaves of a k-d tree (Bentley 1975): each block is halved where it is longest."""
    block = np.zeros(len(places), dtype=int)
    for _ in range(levels):
        upper = np.zeros(len(places), dtype=bool)
        for leaf in np.unique(block):
            members = np.flatnonzero(block == leaf)
            along = places[members, int(np.argmax(np.ptp(places[members], axis=0)))]
            upper[members[np.argsort(along, kind="stable")[len(members) // 2 :]]] = True
        block = 2 * block + upper
    return block


BEYOND = 0.1  # share of a joint's travel by which a held-out reading may lie outside the fitted ones


def extrapolation(data: Measurements) -> tuple[Extrapolation, ...]:
    """Return the joints whose held-out readings lie beyond what was fitted: their accuracy is a guess, good or bad."""
    train, heldout = data.joints[data.train], data.joints[data.held_out]
    if not len(heldout):
        return ()
    low, high = train.min(axis=0), train.max(axis=0)
    margin = BEYOND * np.maximum(high - low, np.ptp(data.joints[data.train | data.held_out], axis=0))
    beyond = (heldout < low - margin) | (heldout > high + margin)
    return tuple(
        Extrapolation(joint=int(i) + 1, rows=int(beyond[:, i].sum())) for i in np.flatnonzero(beyond.any(axis=0))
    )


def beyond(readings: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return which joint readings (n_rows, n_joints) lie outside those measured (n_measured, n_joints) by a tenth of the range."""
    low, high = measured.min(axis=0), measured.max(axis=0)
    margin = BEYOND * (high - low)
    return np.asarray((readings < low - margin) | (readings > high + margin))
