"""Sharing: errors that the rows of one standstill have in common, as its markers have the robot's error of repeating a pose.

Whitened errors of a standstill's n rows have, axis by axis, the covariance (1 - r) I + r 1 1ᵀ (compound symmetry), r being
their intraclass correlation. It is 1 - r of what they have apart, and 1 + (n - 1) r of their mean, n times.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class Sharing:
    """The number of each row's standstill (n_rows,), from 0 without gaps, and the intraclass correlation of its rows."""

    standstill: np.ndarray
    correlation: float

    def only(self, rows: np.ndarray | slice) -> Sharing:
        """Return that of some rows, whole standstills."""
        return Sharing(np.unique(self.standstill[rows], return_inverse=True)[1], self.correlation)

    @cached_property
    def size(self) -> np.ndarray:
        """Number of rows of each standstill."""
        return np.bincount(self.standstill)

    @cached_property
    def _sorted(self) -> tuple[np.ndarray, np.ndarray]:
        return np.argsort(self.standstill, kind="stable"), np.append(0, np.cumsum(self.size)[:-1])

    def decorrelated(self, values: np.ndarray) -> np.ndarray:
        """Return whitened errors, or their derivatives (n_rows, …), whose rows are independent and of variance 1."""
        r = self.correlation
        kept = np.sqrt((1 - r) / (1 + (self.size - 1) * r))[self.standstill]
        shape = (-1, *[1] * (values.ndim - 1))
        return np.asarray((values - (1 - kept).reshape(shape) * group_means(values, self.standstill)) / np.sqrt(1 - r))

    def squares(self, errors: np.ndarray) -> np.ndarray:
        """Return the sum of squares of what is independent in whitened errors (n_rows, n_units, n_sets), shape (n_sets,)."""
        r = self.correlation
        order, starts = self._sorted
        sums = np.add.reduceat(errors[order], starts)
        counted = r / (1 + (self.size - 1) * r)
        common = np.einsum("g,gus,gus->s", counted, sums, sums)
        return np.asarray(((errors**2).sum(axis=(0, 1)) - common) / (1 - r))


def group_means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return the mean over the values (n, …) of each group (n,) in every one's place."""
    count = np.bincount(group)
    if (count <= 1).all():
        return values
    total = np.zeros((len(count), *values.shape[1:]))
    np.add.at(total, group, values)
    return np.asarray((total.T / np.maximum(count, 1)).T[group])
