"""Outliers: rows with gross errors of unknown reason.

Positions are judged by the robust fit of their set-up. Other rows (lengths, contacts, further stations, images) are
judged by a robust fit of the geometry, which also corrects lengths in another unit, mistyped names of objects, and images
whose points are numbered from another corner. Odd rows are outliers against the final model, by a limit that follows from
the tail of the other residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import scipy

from calflow.estimation.accuracy import distances, leading_errors
from calflow.estimation.fit import Fit
from calflow.estimation.leverage import Studentised
from calflow.estimation.registration import in_measuring_frame
from calflow.faults.base import MISNAMED, Correction, Fault, correct, fault, faulty_rows
from calflow.faults.camera_elsewhere import check_cameras
from calflow.faults.marker_elsewhere import GeometryFit, check_markers
from calflow.faults.mistake import LENGTH_UNITS
from calflow.faults.reference import Reference
from calflow.faults.rough import FAR_BETTER, GROSS, LEAST_GROSS
from calflow.files.problems import refuse
from calflow.files.units import METRE, MeasurementUnit
from calflow.files.words import rounded
from calflow.measurements.measurements import Measurements, image_numbers
from calflow.observations import Observation, observations
from calflow.observations.camera import Camera

# The only evidence for an outlier is its size, so the limit allows for heavy tails: the largest of n rows exceeds it in
# one of 300 data sets if each axis has Student's t with 3 degrees of freedom, scaled by the 90 % quantile of rows without
# gross errors (4.1 for the length of three such t's). At 120 rows that is 38 standard deviations of normal noise. Many or
# clustered outliers are a cause that the model lacks.
DEGREES, TAIL_QUANTILE, TAIL_LENGTH = 3, 0.9, 4.0972
# Error, as a share of the images' extent, that three quarters of the points exceed where images belong to other readings or to
# another set-up. A camera or board that was moved leaves the images before or after it in agreement.
MISTAKEN, MOST = 0.01, 0.25
FALSE_ALARM = 1 / 300  # share of data sets without a fault in which one is found
MAX_OUTLIER_SHARE = 0.15  # of the rows: more are not outliers
GROUP = 0.5  # share of a payload's or marker's rows from which these are a cluster
RUN, SAME_WAY = 4, 0.7  # consecutive poses with errors in one direction (mean resultant length): a step or drift
SMALL = 1e-4  # rad or m: difference step of a joint
ALONG, SHARE = 0.9, 0.8  # cosine to a joint's direction of motion, in this share of the rows: an error of that joint
# Poses, and the share of a joint's travel in which fewer than RUN of them lie: chance takes 1 in 5,000.
FEWEST, NEARBY = 3, 0.15
STAYING = "have little weight in the fit, but count in the accuracy"
FLIPPED = "flipped-image"
FLIPS = {"from the opposite corner": ("px_x", "px_y"), "mirrored along x": ("px_x",), "mirrored along y": ("px_y",)}
MOSTLY = 0.8  # least share of an image's points: central ones hardly move
ODD_ROW_FALSE_ALARM = 1 / 500  # false-alarm rate per gap; below 1 / 300 for all gaps tried
REMOVED, LEAST_REMOVED = 0.1, 3  # largest share and number of rows tested against the others
GAPS = 3  # number of gaps tried
TAIL_DEGREES = (2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 11.0, 15.0, 22.0, 35.0, 60.0, 1e3)  # of Student's t, candidates
TAIL_STEPS = 8  # Newton's, more than its scale needs
DOUBT = 2.0  # fall of twice the log-likelihood within which heavier tails are considered
MIN_TAIL_VALUES = 60  # least number of values for a tail
TINY = 1e-12  # standard deviations: below it residuals are rounding
TOGETHER = 1.06  # ratio of the norm of three heavy-tailed values to the largest of them


def outlier(data: Measurements, reference: Reference) -> tuple[Fault, ...]:
    """Return one fault with all rows whose errors exceed the limit by the others' noise, to be excluded."""
    fit, used = reference.fit, data.train | data.held_out
    error = data.position - fit.predicted(data.conditions)
    if not (used & (reference.miss > fit.gross)).any():
        return ()
    far = reference.miss > limit_of(reference.miss[used], fit.scale, fit.gross)
    off = of_no_cause(data, error, far, used, lambda joint, rows: fit.moved(data.conditions[:, rows], joint, SMALL))
    if not off.any():
        return ()
    usual = float(np.median(reference.miss[used]))
    return (_excluded(data, off, "the position in LINES", np.linalg.norm(error[off], axis=1), usual, METRE),)


def limit_of(miss: np.ndarray, scale: float, gross: float) -> float:
    """Return the error [m] beyond which a row is an outlier, for the errors (n_rows,) of all rows.

    scale [m]: their robust standard deviation per axis; gross [m]: the threshold of gross errors.
    """
    usual = np.quantile(miss[miss < gross], TAIL_QUANTILE) if (miss < gross).any() else scale
    largest = -scipy.special.stdtrit(DEGREES, FALSE_ALARM / (6 * len(miss)))  # three axes, two-sided
    return max(gross, float(usual / TAIL_LENGTH * largest))


def clustered(data: Measurements, error: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Return the outliers that form a cluster: of one payload or marker, or consecutive and in one direction."""
    groups = np.zeros(len(off), dtype=bool)
    for label in ("payload", "marker"):
        share = data.table.assign(off=off).groupby(label)["off"].transform("mean").to_numpy()
        groups |= share > GROUP
    pose = data.table["pose"].to_numpy()
    begins = np.flatnonzero(np.r_[True, off[1:] != off[:-1]])
    for run in np.split(np.arange(len(off)), begins[1:]):
        if off[run[0]] and len(set(pose[run])) >= RUN:
            way = error[run] / np.linalg.norm(error[run], axis=1, keepdims=True)
            groups[run] |= np.linalg.norm(way.mean(axis=0)) > SAME_WAY
    return groups


def of_no_cause(
    data: Measurements,
    error: np.ndarray,
    far: np.ndarray,
    used: np.ndarray,
    moved: Callable[[int, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return which of the rows that are far off (n_rows,) are outliers: few of those used, in no cluster, along no one joint.

    error (n_rows, n_axes): by how much; moved: returns the change of rows' errors by a small step of a joint (from 0).
    """
    off = far & used
    off &= ~clustered(data, error, off)
    few = off.sum() <= MAX_OUTLIER_SHARE * used.sum()
    return off & (few and not _along_one_joint(data, moved, error, np.flatnonzero(off)))


def _along_one_joint(
    data: Measurements, moved: Callable[[int, np.ndarray], np.ndarray], error: np.ndarray, rows: np.ndarray
) -> bool:
    """Return whether nearly all these rows have errors in the direction of motion of one joint.

    Of few poses, the joint must also stand nearly alike: a chipped tooth shows there alone, each time. Lengths have no direction.
    """
    poses = len(data.table["pose"].iloc[rows].unique())
    if poses < FEWEST or not error[rows, 1:].any():
        return False
    wrong = error[rows] / np.linalg.norm(error[rows], axis=1, keepdims=True)
    for joint in range(data.robot.n_joints):
        by = moved(joint, rows)
        along = np.abs((by * wrong).sum(axis=1)) > ALONG * np.linalg.norm(by, axis=1)
        spread = np.ptp(data.joint_angles[rows, joint]) / max(np.ptp(data.joint_angles[:, joint]), SMALL)
        if along.mean() >= SHARE and (poses >= RUN or spread < NEARBY):
            return True
    return False


def is_position(data: Measurements) -> np.ndarray:
    """Return which rows are positions in the measuring frame, shape (n_rows,)."""
    return in_measuring_frame(observations(data), data)


def gross_rows(data: Measurements, which: np.ndarray) -> tuple[Fault, ...]:
    """Return the outliers among some rows (n_rows,) by a robust fit of all training rows, one fault per series.

    Raises:
        InputError: no such robot explains images, or a marker, camera or target is far from where it is stated.
    """
    check_cameras(data)
    if (fitted := GeometryFit.of(data)) is None:
        return ()
    check_markers(data, fitted)
    here, observed = fitted.here, fitted.model.observations
    miss = fitted.errors(here)
    faults: list[Fault] = []
    far = distances(miss)
    for k in np.unique(data.series_number[which]):
        rows = which & data.of_series(int(k)) & (data.train | data.held_out)
        unit = observed[int(k)].units[0]
        axes = int((~np.isnan(miss[rows][0])).sum())
        scale = float(np.median(far[rows]) / np.sqrt(scipy.special.chdtri(axes, 0.5)))
        least = LEAST_GROSS * unit.usual / METRE.usual
        limit = limit_of(far[rows], scale, max(GROSS * scale, least))
        gross = rows & (far > limit)
        if isinstance(observed[int(k)], Camera) and (off := _mistaken(data, far, rows)):
            raise refuse(
                f"three quarters of the points in the images are {off:.0f} px or more from where any robot like this one has "
                "them: check that each image stands beside its own joint readings, camera_on and target_on, order, signs and units "
                "of the joints, the target's points (px_x …), that u is to the right and v down, and the stated lens"
            )
        of_series = f" of measurements {data.series[k].name or k + 1}" if len(data.series) > 1 else ""
        better = np.minimum(limit, far / FAR_BETTER)
        explained = _read_otherwise(here, observed[int(k)], gross, better, of_series, fitted)
        gross[[correction.row - 1 for fault in explained for correction in fault.corrections]] = False
        if gross.sum() > MAX_OUTLIER_SHARE * rows.sum():  # the fit is wrong: a row agrees with it by chance alone
            continue
        faults += explained
        if gross.any():
            what = f"what was measured in LINES{of_series}"
            faults.append(_excluded(data, gross, what, far[gross], float(np.median(far[rows & ~gross])), unit))
    return tuple(faults)


def _mistaken(data: Measurements, far: np.ndarray, rows: np.ndarray) -> float:
    """Return the error [px] that most of the rows of images exceed, 0 unless no robot has it; an arm that moves may."""
    least = float(np.quantile(far[rows], MOST))
    extent = np.ptp(data.table.loc[rows, ["u", "v"]].to_numpy(), axis=0).max()
    return least if least > MISTAKEN * extent and "speed" not in data.given else 0.0


def _read_otherwise(
    data: Measurements, observation: Observation, gross: np.ndarray, limit: np.ndarray, of_series: str,
    fitted: GeometryFit,
) -> tuple[Fault, ...]:  # fmt: skip
    """Return a fault for each other reading by which rows or images with gross errors (n_rows,) agree with the others.

    limit (n_rows,): the greatest error that is mended, in the leading unit. What two readings would mend is left alone.
    """
    group = image_numbers(data.table) if data.in_images else np.arange(len(data))
    size = np.bincount(group)
    rows = np.flatnonzero((np.bincount(group, gross) >= MOSTLY * size)[group]).tolist()
    readings = [*_readings(data, observation, rows)] if rows else []
    fits = [
        np.bincount(group, distances(fitted.errors(correct(data, reading))) < limit) >= MOSTLY * size
        for reading in readings
    ]
    unique = np.sum(fits, axis=0) == 1
    mended = [[made for made in reading.corrections if (fit & unique)[group[made.row - 1]]]
              for reading, fit in zip(readings, fits, strict=True)]  # fmt: skip
    return tuple(
        fault(reading.cause, data, 0, corrections, "corrected",
              f"{reading.statement} in LINES{of_series}; corrected for this run only; correct the file, too")
        for reading, corrections in zip(readings, mended, strict=True) if corrections
    )  # fmt: skip


def _readings(data: Measurements, observation: Observation, rows: list[int]) -> Iterator[Fault]:
    """Yield other readings of rows (from 0) of a series: lengths in other units, other names, points in another order."""
    table = data.table
    if "length" in observation.columns.values:
        for factor, unit in LENGTH_UNITS.items():
            scaled = tuple(Correction(row + 1, "length", float(f"{factor:.10g}")) for row in rows)
            yield Fault("unit-mistake", 0, (), f"lengths are in {unit}", "corrected", scaled)
    own = np.flatnonzero(data.of_series(int(data.series_number[rows[0]])))
    labels = [label for label in observation.columns.labels if label in table and table[label].iloc[own].notna().all()]
    names = table[labels].astype(str).to_numpy()
    for first in own[~table[labels].iloc[own].duplicated()].tolist() if labels else ():
        renamed = tuple(Correction(row + 1, label, source=first + 1)
                        for k, label in enumerate(labels) for row in rows if names[row, k] != names[first, k])  # fmt: skip
        name = ", ".join(f"{label} '{written}'" for label, written in zip(labels, names[first], strict=True) if written)
        yield Fault(MISNAMED, 0, (), f"what was measured fits {name}, but another is written", "corrected", renamed)
    if data.in_images and {"px_x", "px_y"} <= {*table}:
        points = table[["px_x", "px_y"]].groupby(table["target"] if "target" in table else np.zeros(len(data)))
        ends = points.transform("min") + points.transform("max")
        for how, columns in FLIPS.items():
            turned = tuple(
                Correction(row + 1, name, -1.0, float(ends[name].iloc[row])) for name in columns for row in rows
            )
            yield Fault(FLIPPED, 0, (), f"the points of whole images are numbered {how}", "corrected", turned)


def _excluded(
    data: Measurements, off: np.ndarray, what: str, far: np.ndarray, usual: float, unit: MeasurementUnit
) -> Fault:
    """Return the fault of rows off (n_rows,) with errors far (n_off,), given the usual error."""
    statement = (
        f"{what} is {in_range(unit.shown(far))} {unit.label} off from the fit of all other rows, whose median error is "
        f"{unit.words(usual, '.2g')}; left out; measure again or correct the file"
    )
    return faulty_rows("outlier", data, np.flatnonzero(off), "left out", statement)


def limit_of_length(values: np.ndarray) -> float:
    """Return the limit of the norm of a row of residuals for outliers; infinite if no row exceeds it.

    values (n_rows, size): studentised residuals of all rows. A false alarm occurs in fewer than one of 300 data sets.
    The longest rows are tested against the tail of the others, Student's t with as few degrees of freedom as these
    allow; all rows above a gap at once, so that outliers neither mask each other nor make the tail heavy.
    """
    n_rows, size = values.shape
    if values.size < MIN_TAIL_VALUES:
        return np.inf
    length = np.linalg.norm(values, axis=1)
    order = np.argsort(length)[::-1]
    most = max(LEAST_REMOVED, round(REMOVED * n_rows))
    ratio = length[order[:most]] / np.maximum(length[order[1 : most + 1]], TINY)
    for removed in sorted(1 + np.argsort(ratio)[::-1][:GAPS], reverse=True):
        limit = _limit(np.abs(values[order[removed:]]).ravel(), size, n_rows)
        if length[order[removed - 1]] > limit:
            return limit
    return np.inf


def _limit(good: np.ndarray, size: int, rows: int) -> float:
    """Return the limit for so many rows of size values each, by the tail of the good values' magnitudes (n,)."""
    cost, scales = _tails(good)
    heaviest = int(np.argmax(2 * (cost - cost.min()) <= DOUBT))
    chance = ODD_ROW_FALSE_ALARM / rows
    alone = -scipy.special.stdtrit(TAIL_DEGREES[heaviest], chance / (2 * size))
    return float(scales[heaviest] * max(np.sqrt(scipy.special.chdtri(size, chance)), TOGETHER * alone))


def _tails(good: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return minus the log-likelihood and the scale of Student's t of each of `TAIL_DEGREES` fitted to magnitudes (n,)."""
    degrees = np.array(TAIL_DEGREES)[:, None]
    squared = good**2 / degrees
    middle = np.log(max(float(np.median(good)), TINY) / scipy.special.stdtrit(degrees, 0.75))
    log_scale = middle
    for _ in range(TAIL_STEPS):  # Newton's: the slope vanishes where the mean share is that of the scale's own t
        share = squared / (squared + np.exp(2 * log_scale))
        slope = (degrees + 1) * share.mean(axis=1, keepdims=True) - 1
        curvature = 2 * (degrees + 1) * (share * (1 - share)).mean(axis=1, keepdims=True)
        log_scale = np.clip(log_scale + slope / np.maximum(curvature, TINY), middle - 1.0, middle + 1.0)
    log_gamma = scipy.special.gammaln
    constant = log_gamma((degrees + 1) / 2) - log_gamma(degrees / 2) - np.log(degrees * np.pi) / 2
    tail = (degrees + 1) / 2 * np.log1p(squared / np.exp(2 * log_scale)).mean(axis=1, keepdims=True)
    return len(good) * (log_scale + tail - constant)[:, 0], np.exp(log_scale)[:, 0]


def odd_rows(result: Fit, data: Measurements, studentised: Studentised) -> tuple[np.ndarray, tuple[Fault, ...]]:
    """Return which rows (n_rows,) are outliers against the final model, and their fault.

    The limit follows from the tail of the residuals; clusters (see `clustered`) are not outliers. The rows are reported,
    not excluded: their weight in the fit is small, and accuracy includes them. Of those that fit another payload's name, that is
    reported.
    """
    used = data.train | data.held_out
    odd = np.zeros(len(data), dtype=bool)
    length = np.sqrt(studentised.squared)
    for size in np.unique(studentised.units[used]):
        alike = used & (studentised.units == size)
        values = studentised.values[alike]
        odd[alike] = length[alike] > limit_of_length(values[~np.isnan(values)].reshape(-1, int(size)))
    odd &= ~result.model.undecided(data)
    error = leading_errors(result.model, result.estimate, data)
    odd &= ~clustered(data, np.nan_to_num(error), odd)
    if not 0 < odd.sum() <= MAX_OUTLIER_SHARE * used.sum():
        return np.zeros(len(data), dtype=bool), ()
    far, leading = distances(error), np.array([o.units[0] for o in result.model.observations])[data.series_number]
    carried = _fitting_payloads(result, data, far, odd)
    faults = [
        faulty_rows(MISNAMED, data, np.flatnonzero(rows), "told",
                    f"what was measured in LINES fits {what}, which is not what is written; they {STAYING}: correct the file")
        for what, rows in carried.items()
    ]  # fmt: skip
    rest = odd & ~sum(carried.values(), np.zeros(len(data), dtype=bool))
    if rest.any():
        off = [
            f"{in_range(unit.shown(far[rest & (leading == unit)]))} {unit.label}"
            for unit in dict.fromkeys(leading[rest])
        ]
        statement = (
            f"the measured values in LINES do not fit the final model: off by {' or '.join(off)}, "
            f"{in_range(studentised.whitened[rest], 2)} times the expected; they {STAYING}: measure again"
        )
        faults.append(faulty_rows("outlier", data, np.flatnonzero(rest), "told", statement))
    return odd, tuple(faults)


def _fitting_payloads(result: Fit, data: Measurements, far: np.ndarray, odd: np.ndarray) -> dict[str, np.ndarray]:
    """Return, by payload in words, the odd rows (n_rows,), by errors far, that agree with it as others do, and with no other.

    The others are those of a row's series, whose errors are in its unit.
    """
    table, names, used = data.table, data.table["payload"].unique().tolist(), (data.train | data.held_out) & ~odd
    usual = np.array([far[used & data.of_series(k)].max(initial=0.0) for k in range(len(data.series))])
    limit = np.minimum(usual[data.series_number], far / FAR_BETTER)
    carrying = (replace(data, table=table.assign(payload=table["payload"].where(~odd, name))) for name in names)
    fits = [odd & (distances(leading_errors(result.model, result.estimate, other)) < limit) for other in carrying]
    words = [f"payload '{name}'" if name else "no payload" for name in names]
    only = {what: fit & (np.sum(fits, axis=0) == 1) for what, fit in zip(words, fits, strict=True)}
    return {what: rows for what, rows in only.items() if rows.any()}


def in_range(values: np.ndarray, digits: int = 3) -> str:
    """Return the range of values (n,) in words."""
    return " to ".join(dict.fromkeys(rounded(float(end), digits) for end in (values.min(), values.max())))
