"""The noise of a measurement, beside the discrepancy that the model leaves beyond it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calflow.estimation.scatter import Scatter

LEAST_SCATTER = 1e-7  # m; repeats that scatter less are one reading written twice, and no robot leaves less

Source = Literal["repeats", "file", "estimated"]


@dataclass(frozen=True, eq=False)
class Noise:
    """The device's noise of each row, and the model's discrepancy, alike in all rows.

    sigma (n_rows,) is that of lengths, per axis [m]; rotation (n_rows,) that of orientations [rad], where they were measured.
    Where lengths are not as sure in all directions, axes (n_rows, 3, 3) holds the principal directions (rows) of their
    covariance and ratios (n_rows, 3) the standard deviations along them over sigma. sources says of each series where its
    noise comes from, series (n_rows,) which one a row is of (None: all of the first). discrepancy [m] and
    rotation_discrepancy [rad] are the model's. intraclass is the correlation of what positions measured at one standstill err
    about the model, axis by axis (see `sharing`). scatter is that of the rows' repeats.
    """

    sigma: np.ndarray
    sources: tuple[Source, ...]
    discrepancy: float = 0.0
    rotation: np.ndarray | None = None
    rotation_discrepancy: float = 0.0
    intraclass: float = 0.0
    axes: np.ndarray | None = None
    ratios: np.ndarray | None = None
    series: np.ndarray | None = None
    scatter: Scatter | None = None

    @property
    def known(self) -> bool:
        """Whether any of it is known apart from the fit, so that a lack of fit can be told from noise."""
        return any(source != "estimated" for source in self.sources)

    @property
    def source(self) -> str:
        """Where it comes from, in a word a series."""
        return ";".join(dict.fromkeys(self.sources))

    def of_series(self, k: int) -> np.ndarray:
        """Which rows are of a series, shape (n_rows,)."""
        return np.full(len(self.sigma), k == 0) if self.series is None else np.asarray(self.series == k)

    @property
    def estimated(self) -> np.ndarray:
        """Which rows' noise only the fit tells, shape (n_rows,)."""
        return np.any(
            [self.of_series(k) for k, s in enumerate(self.sources) if s == "estimated"] or [self.sigma < 0], axis=0
        )

    @property
    def total(self) -> np.ndarray:
        """Standard deviation of each row's lengths about the model, per axis, shape (n_rows,) [m]."""
        return np.hypot(self.sigma, self.discrepancy)

    @property
    def total_rotation(self) -> np.ndarray | None:
        """The same of orientations [rad], where they were measured."""
        return None if self.rotation is None else np.hypot(self.rotation, self.rotation_discrepancy)

    def principal(self, units: tuple[str, ...]) -> np.ndarray:
        """Return the device's standard deviations of residuals of these units along their principal axes, (n_units, n_rows)."""
        directed = self.ratios is not None and units.count("m") == 3
        rotation = self.sigma if self.rotation is None else self.rotation
        rows = [rotation if unit == "rad" else self.sigma for unit in units]
        if directed and self.ratios is not None:
            rows[:3] = list(self.sigma * self.ratios.T)
        return np.array(rows)

    def about_model(self, units: tuple[str, ...]) -> np.ndarray:
        """Return the same with the model's discrepancy."""
        own = [self.rotation_discrepancy if unit == "rad" else self.discrepancy for unit in units]
        return np.hypot(self.principal(units), np.array(own)[:, None])

    def whitening(self, units: tuple[str, ...]) -> np.ndarray:
        """Return what whitens residuals of these units: (n_units, n_rows), or (n_units², n_rows) where axes are correlated.

        The latter holds a matrix a row, column by column, which turns residuals onto their principal axes.
        """
        weight = 1 / self.about_model(units)
        if self.axes is None or units.count("m") != 3:
            return weight
        n = len(units)
        whole = np.zeros((len(self.sigma), n, n))
        whole[:, np.arange(n), np.arange(n)] = 1.0
        whole[:, :3, :3] = self.axes
        whole *= weight.T[:, :, None]
        return whole.transpose(2, 1, 0).reshape(n * n, -1)

    def only(self, rows: np.ndarray) -> Noise:
        """Return the noise of some rows, given by a mask or by their numbers."""

        def own(part: np.ndarray | None) -> np.ndarray | None:
            return None if part is None else np.asarray(part[rows])

        return replace(self, sigma=self.sigma[rows], rotation=own(self.rotation), axes=own(self.axes),
                       ratios=own(self.ratios), series=own(self.series),
                       scatter=None if self.scatter is None else self.scatter.only(rows))  # fmt: skip

    @property
    def words(self) -> str:
        """The noise in words."""
        return "; ".join(self._words(source) for source in dict.fromkeys(self.sources))

    def _words(self, source: Source) -> str:
        own = np.any([self.of_series(k) for k, other in enumerate(self.sources) if other == source], axis=0)
        level = f"{1e3 * np.sqrt(np.mean(self.sigma[own] ** 2)):.3g} mm per axis"
        return {
            "repeats": f"{level}, from repeated measurements of one pose (train poses, pooled)",
            "file": f"{level}, as the measurement file states it",
            "estimated": f"{level}, estimated from what the fit leaves; without repeats or a stated sigma a lack of fit "
            "cannot be told from noise",
        }[source]
