"""Repeats: outliers among the measurements of one standstill, by the scatter of all repeats.

Repeats differ by noise alone, whatever the model, so that they show errors that no comparison with a robot would.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from calflow.estimation.accuracy import leading_errors
from calflow.estimation.lack_of_fit import NORMAL_MEDIAN
from calflow.estimation.noise import MIN_REPEATS, deviations, members
from calflow.estimation.registration import registered_model
from calflow.faults.base import Fault, faulty_rows
from calflow.faults.outlier import SMALL, in_range, limit_of_length, of_no_cause
from calflow.files.words import listed
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import numbered

FALSE_REMOVAL = 0.01  # probability that any of a series' repeats is compared with the others where all are normal
MOST_POSES = 8  # named in a message


def odd_repeats(data: Measurements) -> tuple[Fault, ...]:
    """Return the outliers among repeats, one fault per series, to be excluded.

    Errors are those of the nominal robot, so that joint readings may differ between repeats.
    """
    used, group = data.train | data.held_out, data.repeated
    repeated = used & (np.bincount(group, weights=used)[group] > 1)
    if not repeated.any():
        return ()
    (model, data), faults = registered_model(data), list[Fault]()
    error = leading_errors(model, model.nominal, data)

    def moved(joint: int, rows: np.ndarray) -> np.ndarray:
        column, there = numbered("q", data.robot.n_joints)[joint], data.table.iloc[rows].reset_index(drop=True)
        stepped = replace(data, table=there.assign(**{column: there[column] + SMALL}))
        return np.nan_to_num(leading_errors(model, model.nominal, stepped) - error[rows])

    for k in np.unique(data.series_number[repeated]):
        rows = repeated & data.of_series(int(k))
        far, times = np.zeros(error.shape), np.zeros(len(data))
        there = np.ix_(rows, ~np.isnan(error[rows]).all(axis=0))
        far[there], times[rows] = among_repeats(
            error[there], np.unique(group[rows], return_inverse=True)[1], data.session[rows]
        )
        off = of_no_cause(data, far, times > 0, rows, moved)
        if off.any():
            of_series = f" of measurements {data.series[k].name or k + 1}" if len(data.series) > 1 else ""
            size = model.observations[int(k)].units[0].shown(np.linalg.norm(far[off], axis=1))
            poses = list(dict.fromkeys(data.table["pose"][off].astype(str)))
            more = [f"{len(poses) - MOST_POSES} more"] if len(poses) > MOST_POSES else []
            differ = ", of two that differ both" if set(group[off]) - set(group[rows & ~off]) else ""
            statement = (
                f"what was measured in LINES{of_series} (pose{'s' * (len(poses) > 1)} {listed(poses[:MOST_POSES] + more)}) is "
                f"{in_range(size)} {model.observations[int(k)].units[0].label} off from the other repeats of its pose, "
                f"{in_range(times[off], 2)} times their scatter; left out{differ}; measure again or correct the file"
            )
            faults.append(faulty_rows("outlier", data, np.flatnonzero(off), "left out", statement))
    return tuple(faults)


def among_repeats(error: np.ndarray, group: np.ndarray, session: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far outliers lie from the other repeats of their group, and how many standard deviations that is.

    The first (n_rows, n_axes) is in the errors' unit, the second (n_rows,) 0 for rows that are none. Errors (n_rows, n_axes)
    further out than normal noise would show in one of a hundred series are compared with the group's others and the tail of
    all (see `limit_of_length`). Where fewer than half of a group remain, it is the group that scatters; of two repeats that
    differ, both are outliers. A session all of whose repeats scatter more is judged by its own scatter.
    """
    n, axes = error.shape
    kept, total, together = np.ones(n, dtype=bool), np.bincount(group)[group], members(group)
    size = np.abs(deviations(error, group, kept)[0]) / np.sqrt(1 - 1 / total)[:, None]
    scale = np.full(n, np.median(size))
    for name in np.unique(session):
        own = session == name
        if own.sum() >= MIN_REPEATS:
            scale[own] = np.maximum(scale[own], np.median(size[own]))
    scale /= NORMAL_MEDIAN
    if not scale.all():
        return np.zeros(error.shape), np.zeros(n)
    limit = np.sqrt(2 * scipy.special.gammainccinv(axes / 2, FALSE_REMOVAL / n))
    far, sd = _from_others(error, group, kept)
    while len(wild := np.unique(group[kept & (np.linalg.norm(far, axis=1) > limit * sd * scale)])):
        for rows in (together[k][kept[together[k]]] for k in wild):
            kept[rows[np.argmax(np.linalg.norm(error[rows] - np.median(error[rows], axis=0), axis=1))]] = False
        far, sd = _from_others(error, group, kept)
    scattered = 2 * np.bincount(group, weights=kept)[group] <= total
    far, sd = _from_others(error, group, kept | scattered)
    times = far / (sd * scale)[:, None]
    length = np.linalg.norm(times, axis=1)
    odd = np.where(scattered, total == 2, ~kept) & (length > limit_of_length(times))
    return far, np.where(odd, length, 0.0)


def _from_others(error: np.ndarray, group: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far each row is from the mean of its group's other kept rows, and its standard deviation by a row's own."""
    deviation, count = deviations(error, group, kept)
    others = np.maximum(count - kept, 1)
    return deviation * np.where(kept, count / others, 1.0)[:, None], np.sqrt(1 + 1 / others)
