"""Blocks: the rows in which a joint's reading is off by a given step, where the fit itself may have gone with either part.

Segments: the sequence of states that explains the rows best, where a change of state is dear.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calflow.faults.reference import Reference
from calflow.faults.rough import LEAST_GROSS, lengths, rows_with_reading
from calflow.measurements.measurements import Measurements

FEWEST = 3  # rows inside and outside
FAR = 3.0  # times the largest step up to which a row's error counts


@dataclass(frozen=True)
class RowBlock:
    """Rows (n_rows,) that step is to be added to, in the readings of a joint (index from 0) [rad, or m].

    gain is the fall of the squared errors and of the squared deviations from the nominal robot, in standard deviations.
    """

    joint: int
    step: float
    rows: np.ndarray
    gain: float

    @property
    def others(self) -> RowBlock:
        """The same with all other rows, to the other side: only the joint's zero tells them apart."""
        return replace(self, step=-self.step, rows=~self.rows)


@dataclass(frozen=True)
class Linear:
    """The robot of a rough fit, linear in its parameters: what it can do is taken from errors, at the price of its priors."""

    data: Measurements
    rows: np.ndarray
    predicted: np.ndarray
    fitted: np.ndarray
    left: np.ndarray
    reference: Reference

    @staticmethod
    def of(data: Measurements, reference: Reference, step: float) -> Linear:
        """Linearise at the fit of a reference, at the rows whose errors a step [m] may explain."""
        fit = reference.fit
        here = reference.explained.setup.numbers
        predicted = fit.predicted(data.conditions[:, here])
        error = data.position[here] - predicted
        usable = lengths(error) < FAR * step
        here, predicted, error = here[usable], predicted[usable], error[usable]
        jacobian = np.einsum(
            "ij,njk->nik", fit.turn, fit.model.position_jacobian(fit.estimate, data.conditions[:, here])
        )
        n = len(fit.estimate)
        jacobian = (jacobian * fit.expected.sd).reshape(-1, n) / LEAST_GROSS
        at_nominal = error.ravel() / LEAST_GROSS + jacobian @ fit.deviations
        factor = np.linalg.cholesky(np.linalg.inv(jacobian.T @ jacobian + np.eye(n)))
        fitted = jacobian @ factor
        left = at_nominal - fitted @ (fitted.T @ at_nominal)
        return Linear(
            data, here, predicted, fitted.reshape(len(here), 3, fitted.shape[-1]), left.reshape(-1, 3), reference
        )

    def best(self, joint: int, step: float) -> RowBlock | None:
        """Return the rows between two that gain most from a step, to either side."""
        there, n = {sign: self._moved(joint, sign * step) for sign in (1, -1)}, len(self.rows)
        if n < 2 * FEWEST or any(not np.isfinite(moved).all() for moved in there.values()):
            return None
        sums = {sign: self._sums(moved) for sign, moved in there.items()}
        best: tuple[float, int, int, int] | None = None
        for sign, (along, square, parts) in sums.items():
            gram = parts @ parts.T
            diagonal = np.diag(gram)
            gain = 2 * (along - along[:, None]) - (square - square[:, None]) + diagonal + diagonal[:, None] - 2 * gram
            size = np.arange(n + 1) - np.arange(n + 1)[:, None]
            gain[(size < FEWEST) | (size > n - FEWEST)] = -np.inf
            begin, end = np.unravel_index(gain.argmax(), gain.shape)
            if best is None or gain[begin, end] > best[0]:
                best = (float(gain[begin, end]), sign, int(begin), int(end))
        if best is None:
            return None
        gain, sign, begin, end = best
        rows = np.zeros(len(self.data), dtype=bool)
        rows[self.rows[begin] : self.rows[end - 1] + 1] = True
        return RowBlock(joint, sign * step, rows, gain)

    def _moved(self, joint: int, step: float) -> np.ndarray:
        """Return how a step of the reading moves what is predicted, shape (n_rows, 3), in standard deviations."""
        read = rows_with_reading(self.data, joint, self.data.joints[self.rows, joint] + step, self.rows)
        return np.asarray((self.reference.fit.predicted(read) - self.predicted) / LEAST_GROSS)

    def _sums(self, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return, of all rows before each (n_rows + 1,), how far a step goes along the errors, its square, and its fitted parts."""
        along, square = (moved * self.left).sum(axis=1), (moved**2).sum(axis=1)
        parts = np.einsum("nip,ni->np", self.fitted, moved)
        added = (
            np.concatenate([np.zeros((1, *terms.shape[1:])), np.cumsum(terms, axis=0)])
            for terms in (along, square, parts)
        )
        first, second, third = added
        return first, second, third


ABSENT = 10.0  # what a row costs that a state says nothing about


def state_cost(error: np.ndarray, scale: float) -> np.ndarray:
    """Return what errors (…) [m] cost against a scale [m]: hardly anything where usual, and growing slowly."""
    return np.where(np.isfinite(error), np.log1p((error / (3 * max(scale, 1e-9))) ** 2), ABSENT)


def states(costs: np.ndarray, change: float) -> np.ndarray:
    """Return the cheapest sequence of states (n_rows,) for costs (n_states, n_rows) and of a change (Viterbi 1967)."""
    n_states, n_rows = costs.shape
    total, came = costs[:, 0].copy(), np.empty((n_rows, n_states), dtype=int)
    for k in range(1, n_rows):
        best = int(total.argmin())
        stay = total <= total[best] + change
        came[k] = np.where(stay, np.arange(n_states), best)
        total = np.where(stay, total, total[best] + change) + costs[:, k]
    path = np.empty(n_rows, dtype=int)
    path[-1] = total.argmin()
    for k in range(n_rows - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    return path
