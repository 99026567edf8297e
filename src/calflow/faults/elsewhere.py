"""Gross errors of rows that are no positions in the measuring frame: lengths, contacts, further stations.

What is wrong with such rows is not searched for kind by kind, as with positions: rows are found that a robust fit of the
geometry leaves far off.
"""

from __future__ import annotations

import numpy as np

from calflow.estimation.accuracy import distances, errors
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.registration import in_measuring_frame, registered
from calflow.estimation.repeats import measured_noise
from calflow.estimation.reweighting import fit_reweighted
from calflow.faults.base import Correction, Fault, lines_in_words
from calflow.faults.outlier import MOST, Outlier, limit_of
from calflow.faults.reference import EQUATIONS, GROSS, LEAST_GROSS, NORMAL_LENGTH
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.observations import observations

MEDIAN_LENGTH = (np.nan, 0.6745, 1.1774, NORMAL_LENGTH)  # of so many unit normals


def is_position(data: Measurements) -> np.ndarray:
    """Return which rows are positions in the measuring frame, shape (n_rows,)."""
    return in_measuring_frame(observations(data), data)


def gross_rows(data: Measurements, which: np.ndarray) -> tuple[Fault, ...]:
    """Return the outliers among some rows (n_rows,), a fault a series, which a robust fit of all training rows leaves far off."""
    train = data.only(data.train)
    robot, observed = registered(data.robot, observations(train), train)
    here, train = data.on(robot), train.on(robot)
    model = build(robot, ("geometry",), data.given, observed)
    nominal = build(robot, (), data.given, observed)
    noise = measured_noise(here, "estimated", nominal).only(data.train)
    if LeastSquares.of(model, train, noise).size < EQUATIONS * len(model.parameters):
        return ()
    fit = fit_reweighted(model, train, noise, model.prior_mean[None], "cauchy")[0]
    miss = errors(model, fit.estimate, here)
    faults = []
    far = distances(miss)
    for k in np.unique(data.series_number[which]):
        own = which & data.of_series(int(k)) & (data.train | data.held_out)
        scale = float(np.median(far[own])) / MEDIAN_LENGTH[int((~np.isnan(miss[own][0])).sum())]
        found = own & (far > limit_of(far[own], scale, max(GROSS * scale, LEAST_GROSS)))
        if found.any() and found.sum() <= MOST * own.sum():
            faults.append(_outliers(data, int(k), found, far, float(np.median(far[own & ~found]))))
    return tuple(faults)


def _outliers(data: Measurements, k: int, found: np.ndarray, far: np.ndarray, others: float) -> Fault:
    """Tell the rows (n_rows,) of a series that are too far [m] from what all others say."""
    rows = np.flatnonzero(found)
    lines = tuple(dict.fromkeys(int(line) for line in data.table["line"].iloc[rows]))
    several = f" of measurements {data.series[k].name or k + 1}" if len(data.series) > 1 else ""
    low, high = (f"{1e3 * end:.3g}" for end in (far[found].min(), far[found].max()))
    statement = (
        f"what was measured in {lines_in_words(lines)}{several} is {low if low == high else f'{low} to {high}'} mm from what all "
        f"other rows say, which miss by {1e3 * others:.2g} mm; left out, measure again"
    )
    return Fault(Outlier.id, 0, lines, statement, "left out", tuple(Correction(int(row) + 1) for row in rows))
