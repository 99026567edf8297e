"""A tall matrix: regressors of all rows, held in memory where they fit, else worked out anew in every pass over them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from calflow.diagnosis.screening.correlation import Correlation
from calflow.estimation.groups import parts
from calflow.estimation.probing import ROWS, Probe
from calflow.estimation.sharing import group_means

HELD = 100_000_000  # numbers that are kept in memory

Rows = slice | np.ndarray


class TallMatrix:
    """A matrix (n, n_columns) that sums are taken over, some of its rows at a time."""

    @property
    def shape(self) -> tuple[int, int]:
        """Its size."""
        raise NotImplementedError

    def blocks(self) -> Iterator[tuple[Rows, np.ndarray]]:
        """Yield the numbers of some rows and these rows, each row once."""
        raise NotImplementedError

    def across(self, values: np.ndarray) -> np.ndarray:
        """Return its transpose times values (n, …)."""
        return reduce(np.add, (x.T @ values[rows] for rows, x in self.blocks()))

    def products(self, columns: np.ndarray) -> np.ndarray:
        """Return the products of some columns with each other, (n_own, n_own)."""
        parts = (x[:, columns] for _, x in self.blocks())
        return reduce(np.add, (own.T @ own for own in parts))

    def response(self, columns: np.ndarray) -> np.ndarray:
        """Return the products of all columns with some, (n_columns, n_own)."""
        return reduce(np.add, (x.T @ x[:, columns] for _, x in self.blocks()))

    def times(self, amplitudes: np.ndarray) -> np.ndarray:
        """Return it times amplitudes (n_columns, …)."""
        found = np.empty((self.shape[0], *amplitudes.shape[1:]))
        for rows, x in self.blocks():
            found[rows] = x @ amplitudes
        return found


@dataclass(frozen=True, eq=False)
class Held(TallMatrix):
    """One whose values (n, n_columns) are in memory."""

    values: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Its size."""
        return self.values.shape[0], self.values.shape[1]

    def blocks(self) -> Iterator[tuple[Rows, np.ndarray]]:
        """Yield all at once."""
        yield slice(None), self.values


@dataclass(frozen=True, eq=False)
class Remade(TallMatrix):
    """What a probe's effects do, of which each pass works out a block of rows after the other.

    poses (n_rows,) numbers the rows by pose, shared is the factor at which what a pose's rows have in common counts, correlation
    what errors of rows near each other share besides: see `Regressors.of`.
    """

    probe: Probe
    poses: np.ndarray
    shared: float
    correlation: Correlation | None

    @property
    def shape(self) -> tuple[int, int]:
        """Its size."""
        return self.probe.shape[0], self.probe.width

    def blocks(self) -> Iterator[tuple[Rows, np.ndarray]]:
        """Yield some hundred rows at a time."""
        for rows, x in self._as_they_are():
            if self.correlation is not None:
                x -= self.correlation.modes[rows] @ self._taken
            yield rows, x

    @cached_property
    def _taken(self) -> np.ndarray:
        """What the correlation takes off along its modes, (n_modes, n_columns)."""
        assert self.correlation is not None
        modes = self.correlation.modes
        return self.correlation.taken(reduce(np.add, (modes[rows].T @ x for rows, x in self._as_they_are())))

    def _as_they_are(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield rows in which what a pose's rows have in common counts as it should, but whitened by no correlation."""
        start = 0
        for number, block in enumerate(self.probe.problem.blocks):
            units = block.n_units
            order = np.argsort(self.poses[block.rows], kind="stable")
            for part in parts(self.poses[block.rows[order]], ROWS):
                own = order[part]
                out = np.zeros((len(own) * units, self.probe.shape[1]))
                self.probe.of_rows(number, own, out)
                x = out[:, self.probe.n_parameters :]
                if self.shared < 1:
                    pose = np.unique(self.poses[block.rows[own]], return_inverse=True)[1]
                    x = counted_once(x, (pose[:, None] * units + np.arange(units)).ravel(), self.shared)
                yield start + (own[:, None] * units + np.arange(units)).ravel(), x
            start += len(block.rows) * units


def counted_once(values: np.ndarray, group: np.ndarray, shared: float) -> np.ndarray:
    """Return values (n, …) in which what a group (n,) has in common counts once, by its factor (see `shared_error`)."""
    if shared >= 1:
        return values
    return np.asarray(values - (1 - shared) * group_means(values, group))
