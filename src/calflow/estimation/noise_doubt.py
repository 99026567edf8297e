"""Doubts about a stated noise: repeats that scatter otherwise, or a fit that leaves far less."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.stats import chi2

from calflow.estimation.accuracy import judged_unit
from calflow.estimation.lack_of_fit import LackOfFit
from calflow.estimation.noise import Noise
from calflow.estimation.repeats import MIN_REPEATS, averaged, repeats_scatter, stated_noise
from calflow.files.tables import column
from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.measurements import Measurements

DOUBTED = 1e-3  # chance below which a stated noise is doubted
WORTH_TELLING = 1.25  # times by which it must be off: less changes nobody's mind
USELESS = 3.0  # times from which a fit that believed it is not to be used


@dataclass(frozen=True, kw_only=True)
class NoiseDoubt:
    """A stated noise that the measurements contradict."""

    series: str = column("name of the series; empty: the only one")
    stated_mm: float | None = column("the noise per axis as file or study state it; null: `unit` is another", "mm")
    shown_mm: float | None = column(
        "the noise per axis that repeats show, or the most that the fit leaves room for", "mm"
    )
    shown_by: Literal["repeats", "residuals"] = column("what contradicts it")
    believed: bool = column("whether the fit used the stated noise")
    p: float = column("chance of such a contradiction if the stated noise were right")
    unit: str = column("the unit that stated and shown are in: mm, mrad, px, …")
    stated: float = column("as stated_mm, in `unit`")
    shown: float = column("as shown_mm, in `unit`")

    @property
    def times(self) -> float:
        """By how much it is off, at least 1."""
        return max(self.shown / self.stated, self.stated / self.shown)

    @property
    def useless(self) -> bool:
        """Whether the fit believed a noise that is off by so much that nothing it says of certainty holds."""
        return self.believed and self.times > USELESS

    @property
    def statement(self) -> str:
        """The contradiction in words."""
        where = f" of {self.series}" if self.series else ""
        way = "small" if self.shown > self.stated else "large"
        times = f"{self.times:,.0f}" if self.times >= 10 else f"{self.times:.2g}"
        shown = "repeats of one pose scatter by" if self.shown_by == "repeats" else "the fit leaves only"
        return (f"The stated noise{where}, {self.stated:.3g} {self.unit} per axis, is {times} times too {way}: {shown} "
                f"{self.shown:.3g} {self.unit}. Correct sigma.")  # fmt: skip

    @property
    def words(self) -> str:
        """The same, with what a fit did about it."""
        used = "The fit believed it all the same." if self.believed else "The fit used the repeats' instead."
        return f"{self.statement} {used}"


def doubts_of_repeats(data: Measurements, error: np.ndarray, believed: tuple[bool, ...]) -> tuple[NoiseDoubt, ...]:
    """Hold the stated noise of each series against the repeats of its training poses; believed says of which it is used.

    error (n_rows, n_axes) are the nominal robot's. The test is a chi² test to both sides whose degrees of freedom are reduced
    by the kurtosis of the scatter; gross repeats are left out.
    """
    train, found = data.only(data.train), []
    stated = stated_noise(train)
    scattered = repeats_scatter(train, error[data.train])
    means, noise = averaged(train, replace(stated, scatter=scattered))
    scattered = noise.scatter or scattered
    for k, series in enumerate(data.series):
        own = noise.of_series(k) & (scattered.freedom > 0) & ~scattered.gross & np.isfinite(noise.sigma)
        freedom = scattered.freedom[own]
        if freedom.sum() < MIN_REPEATS:
            continue
        sigma = noise.sigma[own] * np.sqrt(means.repeats[own])
        squared = scattered.squared[own] / sigma**2
        reduced = float(squared.sum() / freedom.sum())
        if not reduced > 0:
            continue
        p = _contradiction(squared, freedom, reduced)
        off = float(np.sqrt(reduced))
        if p < DOUBTED and max(off, 1 / off) > WORTH_TELLING:
            level = float(np.sqrt(np.average(sigma**2, weights=freedom)))
            found.append(
                _doubt(stated.leading[k], level, off, series=series.name, shown_by="repeats", believed=believed[k], p=p)
            )
    return tuple(found)


def doubts_of_residuals(noise: Noise, lack: LackOfFit, names: tuple[str, ...]) -> tuple[NoiseDoubt, ...]:
    """Hold stated noise against what the fit left: far less than the noise says the noise is not.

    More than the noise is a lack of fit. Only where all noise is stated can it be told whose it is.
    """
    if any(source != "file" for source in noise.sources) or not lack.reduced_chi2 > 0:
        return ()
    p, off = 1 - lack.p, float(np.sqrt(lack.reduced_chi2))
    if p >= DOUBTED or off * WORTH_TELLING > 1:
        return ()
    name, unit = names[0] if len(names) == 1 else "", judged_unit(noise.leading)
    return (_doubt(unit, noise.typical(unit), off, series=name, shown_by="residuals", believed=True, p=p),)


def _doubt(unit: MeasurementUnit, level: float, off: float, **more: Any) -> NoiseDoubt:
    """The doubt of a noise of so much [unit], which is off by a factor."""
    stated, shown = unit.shown(level), unit.shown(level) * off
    lengths = (stated, shown) if unit == METRE else (None, None)
    return NoiseDoubt(unit=unit.label, stated=stated, shown=shown, stated_mm=lengths[0], shown_mm=lengths[1], **more)


def _contradiction(squared: np.ndarray, freedom: np.ndarray, reduced: float) -> float:
    """The chance of scatter (n_poses,), in units of the stated noise, as far off to either side."""
    total = float(freedom.sum())
    spread = float(((squared / reduced - freedom) ** 2).sum())
    fewer = total * min(1.0, 2 * total / spread) if spread else total
    return float(2 * min(chi2.sf(reduced * fewer, fewer), chi2.cdf(reduced * fewer, fewer)))
