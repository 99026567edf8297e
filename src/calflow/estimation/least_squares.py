"""The least-squares problem: data arranged for the CasADi graph, as stacked whitened residuals and their Jacobian.

Rows of one standstill share errors, as its markers share the robot's error of repeating a pose. The whitened errors of its n rows
have, axis by axis, the covariance (1 - r) I + r 1 1ᵀ (compound symmetry), r being their intraclass correlation. Its eigenvalues are
1 - r for differences between rows (n - 1 times) and 1 + (n - 1) r for their mean.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np
import scipy

from calflow.estimation.accuracy import observing
from calflow.estimation.noise import Noise
from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.measurements import Measurements
from calflow.model import Asked, Model
from calflow.observations import Observation

LINEARISED_ROWS = 4096  # rows whose Jacobian is evaluated at once
EXPECTED_PASSES = 20  # evaluations of all rows in a typical fit

Loss = Literal["linear", "soft_l1", "cauchy"]


@dataclass(frozen=True, eq=False)
class SeriesBlock:
    """The rows of one series: indices, packed conditions, reported values, and the whitening of their residuals.

    whitening is (n_units, n_rows) where the axes are independent, else (n_units², n_rows): one matrix per row, in column-major
    order. sigma (n_units, n_rows) is the device's noise along the whitened axes, total its root sum of squares with the model's
    discrepancy. standstill (n_rows,) numbers the standstills, whose rows are adjacent and share errors by an intraclass
    correlation.
    """

    model: Model
    observation: Observation
    rows: np.ndarray
    conditions: np.ndarray
    reported: np.ndarray
    whitening: np.ndarray
    sigma: np.ndarray
    total: np.ndarray
    standstill: np.ndarray
    intraclass: float = 0.0

    @property
    def weight(self) -> np.ndarray:
        """Factor of the residuals along the whitened axes, shape (n_units, n_rows)."""
        n = self.n_units
        if len(self.whitening) == n:
            return self.whitening
        return np.sqrt((self.whitening.reshape(n, n, -1) ** 2).sum(axis=0))

    @property
    def n_units(self) -> int:
        return len(self.observation.units)

    def expression(self, asked: Asked | None = None) -> tuple[list[ca.SX], ca.SX]:
        """Return symbols (p, conditions, reported, whitening) and a row's whitened residual (n_units,); see `Model.error`."""
        p, c, _ = self.model.symbols
        y, error = self.model.error(self.observation, asked)
        w = ca.SX.sym("w", len(self.whitening))
        n = self.n_units
        residual = error * w if len(self.whitening) == n else ca.reshape(w, n, n) @ error
        return [p, c, y, w], ca.densify(residual)

    @property
    def data(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values of the symbols after p (conditions, reported, whitening), one column per row."""
        return self.conditions, self.reported, self.whitening

    @cached_property
    def graph(self) -> ca.Function:
        """The function of (p, conditions, reported, whitening): whitened residual and its Jacobian, transposed."""
        key, made = f"linearised {self.key}", self.model.graph.made
        if key not in made:
            inputs, residual = self.expression()
            residual = ca.cse(residual)  # a third of the operations are duplicates
            jacobian = ca.densify(ca.jacobian(residual, inputs[0])).T
            made[key] = ca.Function("linearised", inputs, [residual, jacobian])
        return made[key]

    @property
    def key(self) -> str:
        """Key of its function in the model's cache: index of the observation, and number of weights per row."""
        return f"{self.model.observations.index(self.observation)} {len(self.whitening)}"

    def at(self, places: np.ndarray | slice) -> SeriesBlock:
        """Return the rows at the given indices (n,), in this order; they must be whole standstills."""
        # Rows are along the last axis of every array.
        of_rows: dict[str, Any] = {
            name: value[..., places] for name, value in vars(self).items() if isinstance(value, np.ndarray)
        }
        return replace(self, **of_rows)

    def parts(self, group: np.ndarray | None = None, size: int | None = None) -> Iterator[SeriesBlock]:
        """Yield successive parts of about `size` rows, to bound memory, which end between groups, by default standstills."""
        group, size = self.standstill if group is None else group, size or LINEARISED_ROWS
        ends, start = np.append(np.flatnonzero(np.diff(group)) + 1, len(group)), 0
        while start < len(group):
            end = int(ends[np.searchsorted(ends, min(start + size, len(group)))])
            yield self.at(slice(start, end))
            start = end

    def linearised(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the whitened residuals (n_rows, n_units) and their Jacobian (n_rows, n_units, n_parameters) at p."""
        residual, jacobian = self.model.over_rows(self.graph, p, *self.data, passes=EXPECTED_PASSES)
        return residual.T, jacobian.T.reshape(len(self.rows), self.n_units, -1)

    @property
    def begins(self) -> np.ndarray:
        """Index of the first row of each standstill, shape (n_standstills,)."""
        return np.flatnonzero(np.diff(self.standstill, prepend=-1))

    @property
    def size(self) -> np.ndarray:
        """Number of rows of each standstill, shape (n_standstills,)."""
        return np.diff(np.append(self.begins, len(self.standstill)))

    def decorrelated(self, values: np.ndarray) -> np.ndarray:
        """Return whitened errors or their derivatives (n_rows, …), decorrelated: rows independent, of variance 1."""
        if not (r := self.intraclass):
            return values
        flat, n = values.reshape(len(values), -1), self.size
        ends = np.append(self.begins, len(values))
        # A product, as NumPy's sums of rows of thousands of derivatives take several times as long.
        sums = scipy.sparse.csr_array((np.ones(len(values)), np.arange(len(values)), ends)) @ flat
        left = np.repeat(((1 - np.sqrt((1 - r) / (1 + (n - 1) * r))) / n)[:, None] * sums, n, axis=0)
        np.subtract(flat, left, out=left)  # in place: derivatives by thousands of effects are large
        return np.asarray(np.divide(left, np.sqrt(1 - r), out=left)).reshape(values.shape)

    def covariance(self, places: np.ndarray) -> np.ndarray:
        """Return the covariance of the whitened errors of rows given by indices (n_groups, n), shape (n_groups, n, n)."""
        r, standstill = self.intraclass, self.standstill[places]
        return np.asarray((1 - r) * np.eye(places.shape[1]) + r * (standstill[:, :, None] == standstill[:, None]))


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """The least-squares problem of a model and its data, with one block per series."""

    model: Model
    blocks: tuple[SeriesBlock, ...]

    @staticmethod
    def of(model: Model, data: Measurements, noise: Noise) -> LeastSquares:
        """Return the problem of measurements with their noise; a model without observations takes those of the data."""
        model = observing(model, data)
        blocks = []
        for k, observation in enumerate(model.observations):
            rows = np.flatnonzero(data.of_series(k))
            if not len(rows):
                continue
            standstill = sharing(observation, noise, data)[rows]
            order = np.argsort(standstill, kind="stable")
            rows, standstill, units = rows[order], standstill[order], observation.units
            noise_of_rows, reported = noise.only(rows), observation.reported(data.table.iloc[rows])
            blocks.append(SeriesBlock(model, observation, rows, data.conditions[:, rows], reported,
                                      noise_of_rows.whitening(units), noise_of_rows.principal(units),
                                      noise_of_rows.about_model(units), standstill,
                                      noise.intraclass if (np.diff(standstill) == 0).any() else 0.0))  # fmt: skip
        return LeastSquares(model, tuple(blocks))

    @property
    def log_determinant(self) -> float:
        """Log-determinant of the covariance of the whitened residuals, which is 0 without correlation within standstills."""
        shared = ((block, block.size - 1, block.intraclass) for block in self.blocks)
        return sum(block.n_units * float((n * np.log1p(-r) + np.log1p(n * r)).sum()) for block, n, r in shared)

    @property
    def n_rows(self) -> int:
        return sum(len(block.rows) for block in self.blocks)

    @property
    def size(self) -> int:
        """Number of residuals."""
        return sum(block.n_units * len(block.rows) for block in self.blocks)

    def _stacked(self, values: Callable[[SeriesBlock], np.ndarray | Sequence[float]]) -> np.ndarray:
        """Return values of all residuals, given those of a block or of one of its rows, (n_rows, n_units) or (n_units,)."""
        shapes = ((block, (len(block.rows), block.n_units)) for block in self.blocks)
        return np.concatenate([np.broadcast_to(values(block), shape).ravel() for block, shape in shapes])

    @cached_property
    def row(self) -> np.ndarray:
        """The row of each stacked residual, shape (n,)."""
        return self._stacked(lambda block: block.rows[:, None])

    @cached_property
    def place(self) -> np.ndarray:
        """The place of each stacked residual among those of its row, shape (n,)."""
        return self._stacked(lambda block: np.arange(block.n_units))

    @cached_property
    def leading(self) -> np.ndarray:
        """Mask of the stacked residuals in their observation's first unit, shape (n,)."""
        return self._stacked(lambda block: [unit == block.observation.units[0] for unit in block.observation.units])

    def in_unit(self, unit: MeasurementUnit) -> np.ndarray:
        """Mask of the stacked residuals in a unit, shape (n,)."""
        return self._stacked(lambda block: [other == unit for other in block.observation.units])

    @cached_property
    def sigma(self) -> np.ndarray:
        """The device's noise of each stacked residual, shape (n,) [its unit]."""
        return self._stacked(lambda block: block.sigma.T)

    @cached_property
    def total(self) -> np.ndarray:
        """Root sum of squares of sigma and the model's discrepancy, shape (n,) [its unit]."""
        return self._stacked(lambda block: block.total.T)

    @cached_property
    def weight(self) -> np.ndarray:
        """Factor that whitens each stacked residual, robust weights included, shape (n,)."""
        return self._stacked(lambda block: block.weight.T)

    @property
    def units(self) -> tuple[MeasurementUnit, ...]:
        return tuple(dict.fromkeys(unit for block in self.blocks for unit in block.observation.units))

    def scatter(self, unit: MeasurementUnit = METRE) -> float:
        """Return the standard deviation about the model of residuals in a unit, whose variance is a harmonic mean; 0 without any.

        An error of one size in all rows has, whitened, a mean square of its square over that variance.
        """
        return _harmonic(self.total[self.in_unit(unit)])

    def device(self, unit: MeasurementUnit = METRE) -> float:
        """Return the device's part of it."""
        return _harmonic(self.sigma[self.in_unit(unit)])

    def discrepancy(self, unit: MeasurementUnit = METRE) -> float:
        """Return the model's part of it, which is the same in all rows."""
        here = self.in_unit(unit)
        return float(np.sqrt((self.total[here] ** 2 - self.sigma[here] ** 2).max(initial=0.0)))

    def parts(self) -> Iterator[SeriesBlock]:
        """Yield the rows of all series, part by part (see `SeriesBlock.parts`)."""
        for block in self.blocks:
            yield from block.parts()

    def on(self, model: Model) -> LeastSquares:
        """Return the same data with another model, which takes over this model's observations."""
        model = replace(model, observations=self.model.observations)
        return LeastSquares(model, tuple(replace(block, model=model) for block in self.blocks))

    def only(self, kept: np.ndarray) -> LeastSquares:
        """Return the problem of the rows in a mask (n_rows,), renumbered from 0; they must be whole standstills."""
        if kept.all():
            return self
        number = np.cumsum(kept) - 1
        blocks = (block.at(np.flatnonzero(kept[block.rows])) for block in self.blocks)
        numbered = (replace(block, rows=number[block.rows]) for block in blocks if len(block.rows))
        return LeastSquares(self.model, tuple(numbered))

    def decorrelated(self, values: np.ndarray) -> np.ndarray:
        """Return values of the stacked residuals (n, …), decorrelated within standstills."""
        if not any(block.intraclass for block in self.blocks):
            return values
        ends = np.cumsum([block.n_units * len(block.rows) for block in self.blocks])[:-1]
        parts = (
            (block, part.reshape(len(block.rows), -1))
            for block, part in zip(self.blocks, np.split(values, ends), strict=True)
        )
        return np.concatenate([block.decorrelated(part) for block, part in parts]).reshape(values.shape)

    def reweighted(self, p: np.ndarray, loss: Loss) -> LeastSquares:
        """Return the problem with each row weighted by the slope of a robust loss at p (iteratively reweighted squares)."""
        if loss == "linear":
            return self
        blocks = []
        for block in self.blocks:
            squared = np.concatenate([(part.linearised(p)[0] ** 2).sum(axis=1) for part in block.parts()])
            blocks.append(replace(block, whitening=block.whitening * np.sqrt(rho_slope(squared, loss))))
        return replace(self, blocks=tuple(blocks))

    def r_factor(self, p: np.ndarray) -> np.ndarray:
        """Return Householder's R (n, n) of the whitened Jacobian at p, with directions that JᵀJ loses to round-off."""
        factor = np.zeros((0, len(p)))
        for part in self.parts():
            jacobian = part.decorrelated(part.linearised(p)[1])
            factor = np.asarray(np.linalg.qr(np.vstack([factor, jacobian.reshape(-1, len(p))]), mode="r"))
        return factor


def _harmonic(sizes: np.ndarray) -> float:
    return float(np.mean(sizes**-2.0) ** -0.5) if len(sizes) else 0.0


def sharing(observation: Observation, noise: Noise, data: Measurements) -> np.ndarray:
    """Return the number (n_rows,) of the standstill with whose rows each shares errors: isotropic positions, or an image."""
    shared = observation.series.within or (observation.units == (METRE,) * 3 and noise.axes is None)
    return data.standstill if shared else np.arange(len(data))


def rho(squared: np.ndarray, loss: Loss) -> np.ndarray:
    """Return the loss of a row's squared whitened residual."""
    if loss == "soft_l1":
        return 2 * (np.sqrt(1 + squared) - 1)
    return np.log1p(squared) if loss == "cauchy" else squared


def rho_slope(squared: np.ndarray, loss: Loss) -> np.ndarray:
    """Return the derivative of `rho`, the weight of a row."""
    if loss == "soft_l1":
        return (1 + squared) ** -0.5
    return 1 / (1 + squared) if loss == "cauchy" else 1 + 0 * squared
