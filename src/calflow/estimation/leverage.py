"""Leverage of rows and poses: studentised residuals, and errors of poses left out of the fit.

Studentised residuals show which rows the model does not explain. The parameters of an incomplete model absorb part of its error
at the fitted poses, most at those of high leverage, so that residuals understate the error elsewhere; leave-one-pose-out errors
do not (Stone 1974). One Jacobian yields them without a refit (Allen's PRESS 1974): with V the covariance of a pose's whitened
errors and H = J Σ Jᵀ that of its prediction, they are V (V - H)⁻¹ times the residual, and have the covariance V (V - H)⁻¹ V where
the model is complete.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from calflow.estimation.accuracy import Residual, completed, leading_errors, residuals
from calflow.estimation.fit import Fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import Noise, PerUnit
from calflow.files.deferred import pd
from calflow.files.tables import column, typed
from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.measurements import Measurements

FALSE_FLAGS = 0.01  # chance that any good row of a whole data set is flagged
LEAST_LEFT = 1e-3  # lower limit of a residual's variance, as a share of the row's variance
UNSURE = 0.05  # probability that the error at new poses exceeds its upper limit
BY_CHANCE = 0.05  # p-value of the leave-one-out errors of a complete model, above which they show no excess
KNOWN = 1e9  # degrees of freedom of a size that is known


@dataclass(frozen=True, kw_only=True)
class JudgedResidual(Residual):
    """The residual of a measured row with the identified model, and whether it is significant."""

    whitened: float = column("root mean square of its components in standard deviations of noise and discrepancy")
    flagged: bool = column("whether it is significant against noise, discrepancy and leverage")


@dataclass(frozen=True)
class Studentised:
    """Studentised residuals of rows: over their standard deviation by noise, discrepancy and leverage.

    squared (n_rows,) is the squared Mahalanobis length of each row; values (n_rows, n_units) are the components, nan where a row
    has fewer; whitened (n_rows,) is the root mean square in standard deviations of noise and discrepancy alone.
    """

    squared: np.ndarray
    values: np.ndarray
    whitened: np.ndarray

    @property
    def units(self) -> np.ndarray:
        """Number of components of each row, shape (n_rows,)."""
        return np.asarray((~np.isnan(self.values)).sum(axis=1))

    @staticmethod
    def of(result: Fit, data: Measurements, noise: Noise, beside: np.ndarray | None = None) -> Studentised:
        """Studentise the residuals of rows by their leverage, so that a row that pulls the fit to itself still shows.

        With the variance h of the prediction that of a whitened residual is 1 - h in fitted rows and 1 + h in held-out ones. beside
        is the covariance of the estimate including smooth errors that the fit ignored; it serves held-out rows alone, as those
        errors did not reduce the residuals of fitted rows.
        """
        model, estimate = completed(result.model, result.estimate, data)
        places = [model.parameters.index(parameter) for parameter in result.model.parameters]
        squared, whitened = np.empty(len(data)), np.empty(len(data))
        values = np.full((len(data), max(len(observation.units) for observation in model.observations)), np.nan)
        unsure = result.covariance if beside is None else beside
        for part in LeastSquares.of(model, data, noise).parts():
            rows, (residual, whole) = part.rows, part.linearised(estimate)
            jacobian, held = whole[:, :, places], ~data.train[rows]
            spread = np.eye(residual.shape[1]) - jacobian @ result.covariance @ jacobian.transpose(0, 2, 1)
            of_held = jacobian[held]
            spread[held] = np.eye(residual.shape[1]) + of_held @ unsure @ of_held.transpose(0, 2, 1)
            inverse = np.linalg.pinv(spread, hermitian=True)
            squared[rows] = np.maximum(np.einsum("ni,nij,nj->n", residual, inverse, residual), 0.0)
            sd = np.sqrt(np.maximum(np.einsum("nii->ni", spread), LEAST_LEFT))
            values[np.asarray(rows)[:, None], np.arange(residual.shape[1])] = residual / sd
            whitened[rows] = np.sqrt((residual**2).mean(axis=1))
        return Studentised(squared, values, whitened)


def judged(result: Fit, data: Measurements, noise: Noise) -> pd.DataFrame:
    """Return the table of `JudgedResidual`s; rows are flagged where noise and discrepancy do not explain their residual.

    The fit's covariance may include smooth errors that its problem ignores; it then serves held-out rows (see `Studentised.of`).
    """
    alone = Fit.at(result.problem, result.estimate, result.loss)
    studentised = Studentised.of(alone, data, noise, beside=result.covariance)
    limit = scipy.special.chdtri(studentised.units, FALSE_FLAGS / len(data))
    return judged_table(result, data, studentised, (studentised.squared > limit) & (data.train | data.held_out))


def judged_table(result: Fit, data: Measurements, studentised: Studentised, flagged: np.ndarray) -> pd.DataFrame:
    """Return the table of `JudgedResidual`s, given the mask (n_rows,) of flagged rows."""
    table = residuals(leading_errors(result.model, result.estimate, data), data)
    return typed(table.assign(whitened=studentised.whitened, flagged=flagged), JudgedResidual)


@dataclass(frozen=True)
class LeftOut:
    """Leave-one-pose-out errors, whitened: the sum of their squares, its expectation, and the number of errors.

    directions: effective number of those along which the parameters' errors add to them; degrees_of_freedom: those by which their
    size is known from the residuals; share: median over poses of the expected squared error; scatter [m, or another
    unit]: standard deviation per axis about the model, see `LeastSquares`; by_parameters, discrepancy: that of the error by
    the parameters alone, and of the model beyond the device's noise; residual_freedom: degrees of freedom of the residuals.
    """

    sum_of_squares: float
    expected: float
    number: int
    directions: float
    degrees_of_freedom: float
    share: float
    scatter: float
    by_parameters: float
    discrepancy: float
    residual_freedom: float

    @property
    def rms(self) -> float:
        """Root mean square distance of left-out positions, noise included [m]; nan without any."""
        return float(np.sqrt(3 * self.sum_of_squares / self.number)) * self.scatter if self.number else float("nan")

    @property
    def at_new_poses(self) -> float:
        """Root mean square error [m] at new poses without noise, the larger of expected and observed; nan without any."""
        if not self.number:
            return float("nan")
        beyond = self.scatter**2 * max(self.sum_of_squares - self.expected, 0.0) / self.number
        return float(np.sqrt(3 * (self.by_parameters**2 + self.discrepancy**2 + beyond)))

    @property
    def of_new_measurements(self) -> float:
        """The same [m] of positions measured there, with the noise, which holds what the model lacks where it was estimated."""
        device = self.scatter**2 - self.discrepancy**2
        return float(np.sqrt(self.at_new_poses**2 + 3 * device))

    def upper_limit(self, noise_tells: bool) -> float:
        """Return the upper 95 % confidence limit of the error at new poses [m]; nan without any.

        Its square over that of at_new_poses has an F distribution: the parameters' errors add up over a few directions, and their
        size is as uncertain as the residuals leave it. If noise_tells, a known noise determines it where there is no discrepancy.
        """
        freedom = KNOWN if noise_tells and not self.discrepancy else self.degrees_of_freedom
        return self.at_new_poses * float(np.sqrt(scipy.special.fdtri(self.directions, freedom, 1 - UNSURE)))

    def excess(self, level: np.ndarray | float = 1.0) -> np.ndarray:
        """Return the model's excess error, standard deviation per axis, with the squares scaled by level; at least 0."""
        if not self.number:
            return np.zeros(np.shape(level))
        more = np.maximum(level * np.float64(self.sum_of_squares / self.expected) - 1.0, 0.0) * self.share
        return np.asarray(np.sqrt(more)) * self.scatter

    def drawn(self, number: int, rng: np.random.Generator) -> np.ndarray:
        """Draw values of the excess (number,) [m] from its posterior, 0 where chance explains it beside a complete model."""
        if (
            not self.number
            or scipy.stats.chi2.sf(self.residual_freedom * self.sum_of_squares / self.expected, self.residual_freedom)
            > BY_CHANCE
        ):
            return np.zeros(number)
        return self.excess(self.residual_freedom / rng.chisquare(self.residual_freedom, number))


def excess(fit: Fit, pose: np.ndarray, lengths: LeftOut) -> PerUnit:
    """Return the excess of leave-one-pose-out errors over noise and parameters for each unit; lengths are those in metres."""
    every = ((unit, lengths if unit == METRE else left_out(fit, pose, unit)) for unit in fit.problem.units)
    return PerUnit(tuple((unit, float(out.excess())) for unit, out in every))


def left_out(fit: Fit, pose: np.ndarray, unit: MeasurementUnit = METRE) -> LeftOut:
    """Return the leave-one-pose-out errors of a fitted model in a unit; rows of one pose (n_rows,) are left out together."""
    parts = list(_by_pose(fit, pose, unit))
    squares, covered, sizes, variances = np.concatenate([*(figures for figures, _ in parts), np.zeros((4, 0))], axis=1)
    number, problem = int(sizes.sum()), fit.problem
    share = float(np.median(covered / sizes)) if number else 0.0
    freedom = max(1.0, number - fit.effective_parameters)
    # Summed pose by pose, so that the partition of rows does not affect the last digit.
    total, expected = float(sum(squares)), float(sum(covered))
    # All rows of a pose share the model's error, poses of high leverage dominate the mean (Satterthwaite 1946), and the parameters
    # have absorbed a share.
    of_size = max(1.0, expected**2 / float(sum(covered**2)) * freedom / number) if number else 1.0
    along = fit.covariance @ sum((gram for _, gram in parts), np.zeros_like(fit.covariance))
    directions = np.trace(along) ** 2 / np.trace(along @ along) if number else 1.0
    by_parameters = float(np.sqrt(max(0.0, (covered - sizes) @ variances / max(1, number))))
    return LeftOut(total, expected, number, float(directions), of_size, share, problem.scatter(unit), by_parameters,
                   problem.discrepancy(unit), freedom)  # fmt: skip


def _by_pose(fit: Fit, pose: np.ndarray, unit: MeasurementUnit) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield, for poses of equal size, figures (4, n_poses) and the sum over poses of JᵀJ with the slopes J of left-out errors.

    The figures are the squared whitened leave-one-out error, its expectation, the number of residuals, and their variance [unit²].
    """
    for block in fit.problem.reweighted(fit.estimate, fit.loss).blocks:
        judged = np.array([other == unit for other in block.observation.units])
        if not judged.any():
            continue
        block = block.at(np.argsort(pose[block.rows], kind="stable"))
        for part in block.parts(pose[block.rows]):
            residual, jacobian = (of[:, judged] for of in part.linearised(fit.estimate))
            _, first, count = np.unique(pose[part.rows], return_index=True, return_counts=True)
            for many in np.unique(count):
                rows_of = first[count == many, None] + np.arange(many)
                error = residual[rows_of].reshape(len(rows_of), -1)
                n_poses, size = error.shape
                slopes = jacobian[rows_of].reshape(n_poses, size, -1)
                spread = np.einsum("nij,ab->niajb", part.covariance(rows_of), np.eye(judged.sum()))
                spread = spread.reshape(n_poses, size, size)
                weighed = np.linalg.solve(spread - slopes @ fit.covariance @ slopes.transpose(0, 2, 1), spread)
                missed = np.einsum("nji,nj->ni", weighed, error)
                expected = np.einsum("nij,nij->n", spread, weighed)
                slopes = (weighed.transpose(0, 2, 1) @ slopes).reshape(n_poses * size, -1)
                variance = (part.total[judged] ** 2).mean(axis=0)[rows_of].mean(axis=1)
                figures = np.array([np.vecdot(missed, missed), expected, np.full(n_poses, float(size)), variance])
                yield figures, slopes.T @ slopes


def halved(places: np.ndarray, levels: int) -> np.ndarray:
    """Return the leaf (n,) of each point (n, n_axes) in a k-d tree (Bentley 1975): each block is halved along its longest axis."""
    block = np.zeros(len(places), dtype=int)
    for _ in range(levels):
        upper = np.zeros(len(places), dtype=bool)
        for leaf in np.unique(block):
            members = np.flatnonzero(block == leaf)
            along = places[members, int(np.argmax(np.ptp(places[members], axis=0)))]
            upper[members[np.argsort(along, kind="stable")[len(members) // 2 :]]] = True
        block = 2 * block + upper
    return block
