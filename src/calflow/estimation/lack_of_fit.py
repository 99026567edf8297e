"""Lack of fit: F and chi² tests of a model's residuals against the noise, the discrepancy, and doubts of a stated noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import scipy

from calflow.estimation.accuracy import judged_unit
from calflow.estimation.noise import MIN_REPEATS, Noise, Scatter, averaged, repeats_scatter, stated_noise
from calflow.files.tables import column
from calflow.files.units import MeasurementUnit
from calflow.files.words import rounded
from calflow.measurements.measurements import Measurements

NORMAL_MEDIAN = 0.6745  # median of |x| of a standard normal
SIGNIFICANT = 0.01  # p-value below which a lack of fit is believed
GROSS = 4.0  # robust standard deviations beyond which an error of a robust fit is an outlier
DOUBTED = 1e-3  # p-value below which a stated noise is doubted
WORTH_TELLING = 1.25  # least factor by which it must be wrong to be reported
USELESS = 3.0  # factor beyond which a fit that used it is not to be used


@dataclass(frozen=True)
class LackOfFit:
    """Result of a test of residuals in one unit: chi² per degree of freedom, its p-value, and the discrepancy [unit]."""

    reduced_chi2: float
    p: float
    discrepancy: float


@dataclass(frozen=True, eq=False)
class Evidence(Scatter):
    """Independent evidence on the noise of a fit's rows, each attribute an array (n_rows,).

    squared: scatter of the repeats of which a row is the mean, in units of the noise's variance; freedom: its degrees of freedom,
    zero where the noise is stated; pose: number of the pose, whose rows may share errors; count: number of repeats; series: number
    of the series, each with its own noise.
    """

    pose: np.ndarray
    count: np.ndarray
    series: np.ndarray

    @staticmethod
    def of(data: Measurements, noise: Noise) -> Evidence:
        """Return the evidence from the means of repeats (see `averaged`) and their noise."""
        pose, single = np.unique(data.table["pose"], return_inverse=True)[1], noise.sigma * np.sqrt(data.repeats)
        repeats = np.any([noise.of_series(k) & (s == "repeats") for k, s in enumerate(noise.sources)], axis=0)
        scatter = noise.scatter or Scatter(np.zeros(len(data)), np.zeros(len(data)))
        every = Evidence(scatter.squared / single**2, scatter.freedom, pose, data.repeats, data.series_number)
        return every.only_where(repeats)

    def only_where(self, rows: np.ndarray) -> Evidence:
        """Return a copy that uses the repeats of the rows in a mask alone, and takes the others' noise as stated."""
        return replace(self, squared=np.where(rows, self.squared, 0.0), freedom=np.where(rows, self.freedom, 0.0))


def lack_of_fit(
    error: np.ndarray, sigma: np.ndarray, determined: float, rows: np.ndarray, evidence: Evidence, trimmed: bool = False
) -> LackOfFit:
    """Test errors (n,) against their noise (n,); determined is the number of parameters fitted to them.

    The discrepancy is the standard deviation that, added in quadrature to the noise, makes chi² equal to its degrees of freedom;
    zero where the noise explains the errors (p above 1 %). rows (n,) are the errors' rows in the evidence. After a robust fit
    errors are trimmed, as outliers are not a discrepancy.
    """
    reduced, p = _tested((error / sigma) ** 2, determined / error.size, rows, evidence)
    if trimmed:
        size = np.abs(error) / sigma
        scale = max(1.0, float(np.median(size)) / NORMAL_MEDIAN)
        kept = ~np.isin(rows, rows[size >= GROSS * scale])
        error, sigma = error[kept], sigma[kept]
        reduced = float(((error / sigma) ** 2).sum()) / max(1.0, error.size - determined)
    degrees_of_freedom = max(1.0, error.size - determined)

    def excess(discrepancy: float) -> float:
        return float(((error / np.hypot(sigma, discrepancy)) ** 2).sum()) - degrees_of_freedom

    if p > SIGNIFICANT or excess(0.0) <= 0:
        return LackOfFit(reduced, p, 0.0)
    return LackOfFit(reduced, p, scipy.optimize.brentq(excess, 0.0, 10 * float(np.abs(error).max())))


def _tested(squared: np.ndarray, share: float, rows: np.ndarray, known_noise: Evidence) -> tuple[float, float]:
    """Return chi² per degree of freedom of squared errors (n,) in units of the noise's variance, and its p-value.

    An F test against the scatter of repeats, a chi² test against stated noise, in between where only some series have repeats;
    share is the share of the degrees of freedom used by the fit. The test's degrees of freedom are reduced by the kurtosis of the
    noise (Box and Andersen 1955), estimated from the spread over poses of both squared errors and squared scatter, so that
    neither heavy tails nor errors shared within a pose count as evidence.
    """
    here, row = np.unique(rows, return_inverse=True)
    known = known_noise.only(here)
    units, of_series = np.bincount(known.series[row]), known.gathered(known.series)
    level = np.where(of_series.freedom > 0, of_series.squared / np.maximum(of_series.freedom, 1e-9), 1.0)
    level = np.where(level > 0, level, 1.0)
    share_of = units / units.sum() / np.maximum(of_series.freedom, 1e-9)
    weight = np.where(of_series.freedom > 0, share_of, 0.0)[known.series]
    squared = squared / level[known.series[row]]

    pose = np.unique(known.pose, return_inverse=True)[1]
    squares, n = np.bincount(pose[row], weights=squared), np.bincount(pose[row])
    repeats = np.bincount(pose, weights=known.count) / np.bincount(pose)
    between, within = n * (1 - share), np.bincount(pose, weights=known.freedom)
    shown = np.bincount(pose, weights=known.squared / level[known.series])
    against = np.bincount(pose, weights=weight * known.freedom)

    d1 = max(1.0, float(between.sum()))
    reduced = float(squares.sum()) / d1
    scaled = squares / max(reduced, 1e-300)
    tails = float(((scaled - between) ** 2 - 2 * between + (shown - within) ** 2 - 2 * within).sum())
    kurtosis = max(0.0, tails / float(((between**2 + within**2) / (n * repeats)).sum()))
    of_scatter = float(2 * (weight**2 * known.freedom).sum())
    plain = 2 / d1 + of_scatter
    reduction = plain / (plain + kurtosis * float((n / repeats * (between / (n * d1) - against / n) ** 2).sum()))
    if not of_scatter:
        return reduced, float(scipy.special.chdtrc(d1 * reduction, reduced * d1 * reduction))
    return reduced, float(scipy.special.fdtrc(d1 * reduction, 2 / of_scatter * reduction, reduced))


@dataclass(frozen=True, kw_only=True)
class NoiseDoubt:
    """A stated noise that the measurements contradict."""

    series: str = column("name of the series; empty: the only one")
    session: str = column("the session in which it is wrong; empty: in all", default="")
    marker: str = column("the marker of which it is wrong; empty: of all", default="")
    shown_by: Literal["repeats", "residuals"] = column("the evidence against it")
    believed: bool = column("whether the fit used the stated noise")
    p: float = column("p-value of the contradiction")
    unit: str = column("the unit that stated and shown are in: mm, mrad, px, …")
    stated: float = column("the noise per axis stated by file or study, in `unit`")
    shown: float = column("that by the scatter of repeats, or by the fit's residuals, its upper limit, in `unit`")

    @property
    def times(self) -> float:
        """Factor by which the stated noise is wrong, at least 1."""
        return max(self.shown / self.stated, self.stated / self.shown)

    @property
    def useless(self) -> bool:
        """Whether the fit used a noise so wrong that none of its standard deviations holds."""
        return self.believed and self.times > USELESS

    @property
    def statement(self) -> str:
        where = (f" of {self.series}" if self.series else "") + (f" in session {self.session}" if self.session else "")
        where += f" for marker {self.marker}" if self.marker else ""
        way = "small" if self.shown > self.stated else "large"
        times = f"{self.times:,.0f}" if self.times >= 10 else f"{self.times:.2g}"
        shown = (
            "repeats of one pose scatter by"
            if self.shown_by == "repeats"
            else "the fit leaves" + " only" * (way == "large")
        )
        there = " there" if self.session or self.marker else ""
        # Errors that a robot makes on one day only look like noise of that day.
        unless = ", unless the robot repeated worse then" if self.session and self.shown_by == "residuals" else ""
        unless += ", unless that marker does not sit firmly" if self.marker else ""
        return (f"The stated noise{where}, {rounded(self.stated)} {self.unit} per axis, is {times} times too {way}: {shown} "
                f"{rounded(self.shown)} {self.unit}{there}. Correct sigma{unless}.")  # fmt: skip

    @property
    def words(self) -> str:
        """The statement, and which noise the fit used."""
        instead = "the repeats'" if self.shown_by == "repeats" else "the latter"
        used = "it all the same" if self.believed else f"{instead} instead"
        return f"{self.statement} The fit used {used}."


def doubts_of_repeats(data: Measurements, error: np.ndarray, believed: tuple[bool, ...]) -> tuple[NoiseDoubt, ...]:
    """Test the stated noise of each series, believed or not, against its repeats, given the nominal robot's error (n_rows, n_axes).

    A two-sided chi² test, with degrees of freedom reduced by the kurtosis of the scatter.
    """
    train, lacks = data.only(data.train), []
    stated = stated_noise(train)
    scattered = repeats_scatter(train, error[data.train])
    means, noise = averaged(train, replace(stated, scatter=scattered))
    scattered = noise.scatter or scattered
    for k, series in enumerate(data.series):
        rows = noise.of_series(k) & (scattered.freedom > 0) & np.isfinite(noise.sigma)
        freedom = scattered.freedom[rows]
        if freedom.sum() < MIN_REPEATS:
            continue
        sigma = noise.sigma[rows] * np.sqrt(means.repeats[rows])
        squared = scattered.squared[rows] / sigma**2
        reduced = float(squared.sum() / freedom.sum())
        if not reduced > 0:
            continue
        p = _contradiction(squared, freedom, reduced)
        off = float(np.sqrt(reduced))
        if p < DOUBTED and max(off, 1 / off) > WORTH_TELLING:
            level = float(np.sqrt(np.average(sigma**2, weights=freedom)))
            lacks.append(
                doubt(stated.leading[k], level, off, series=series.name, shown_by="repeats", believed=believed[k], p=p)
            )
    return tuple(lacks)


def doubts_of_residuals(noise: Noise, lack: LackOfFit, names: tuple[str, ...]) -> tuple[NoiseDoubt, ...]:
    """Test stated noise of all series against the residuals: far smaller ones contradict it, larger ones are a lack of fit."""
    if any(source != "file" for source in noise.sources) or not lack.reduced_chi2 > 0:
        return ()
    p, off = 1 - lack.p, float(np.sqrt(lack.reduced_chi2))
    if p >= DOUBTED or off * WORTH_TELLING > 1:
        return ()
    name, unit = names[0] if len(names) == 1 else "", judged_unit(noise.leading)
    return (doubt(unit, noise.typical(unit), off, series=name, shown_by="residuals", believed=True, p=p),)


def doubt(unit: MeasurementUnit, level: float, off: float, **more: Any) -> NoiseDoubt:
    """Return the doubt of a stated noise of the given level [unit], which is wrong by a factor."""
    return NoiseDoubt(unit=unit.label, stated=unit.shown(level), shown=unit.shown(level) * off, **more)


def _contradiction(squared: np.ndarray, freedom: np.ndarray, reduced: float) -> float:
    """Return the two-sided p-value of the scatter of poses (n_poses,), in units of the stated noise's variance."""
    total = float(freedom.sum())
    spread = float(((squared / reduced - freedom) ** 2).sum())
    fewer = total * min(1.0, 2 * total / spread) if spread else total
    return float(2 * min(scipy.special.chdtrc(fewer, reduced * fewer), scipy.special.chdtr(fewer, reduced * fewer)))
