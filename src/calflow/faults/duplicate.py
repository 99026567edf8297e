"""Duplicate: an observation written several times, identical to the last digit, unlike a repeat measurement."""

from __future__ import annotations

import numpy as np

from calflow.faults.base import Fault, faulty_rows, lines_in_words
from calflow.files.deferred import pd
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import IN_ORDER, SIGMAS, condition_columns, numbered

LABELS = ("marker", "payload", "session", "series")
OF_THE_ROW = ("pose", "repeat", "line", "split", "order", "time", "temperature", "range", "of_repeats", *SIGMAS)
CHANCE = 0.01  # expected number of genuine repeats identical to the last digit, frequent if a device rounds coarsely
BEST = 1e-5  # m or rad: assumed scatter of a good device, without repeats or stated noise
FINEST = 9  # decimals


def duplicate(data: Measurements) -> tuple[Fault, ...]:
    """Return one fault with all rows identical to an earlier row, so that each observation counts once."""
    setting, values = _setting(data), _measured(data)
    if not values:
        return ()
    keys = [*setting, *values]
    again = data.table.duplicated(keys).to_numpy()
    if not again.any() or _by_chance(data, setting, values, again) > CHANCE:
        return ()
    copies = np.flatnonzero(again)
    group = data.table.groupby(keys, sort=False, dropna=False).ngroup().to_numpy()
    first = np.unique(group, return_index=True)[1]
    lines = data.table["line"].to_numpy()
    written = lines_in_words(sorted({int(lines[first[group[row]]]) for row in copies}))
    statement = (
        f"LINES: identical to the last digit to {written}: one observation written several times; it counts once; remove the "
        "copies from the file"
    )
    return (faulty_rows("duplicate", data, copies, "left out", statement),)


def rows_held_by(before: Measurements, data: Measurements) -> np.ndarray:
    """Return which rows equal a row measured before, in all columns of both tables, to the last digit, (n_rows,)."""
    keys = [name for name in (*_setting(data), *_measured(data)) if name in before.table]
    group = (
        pd.concat([before.table[keys], data.table[keys]]).groupby(keys, sort=False, dropna=False).ngroup().to_numpy()
    )
    return np.isin(group[len(before) :], group[: len(before)])


def _setting(data: Measurements) -> list[str]:
    """Return the columns of the conditions of a row."""
    joints = numbered("q", data.robot.n_joints)
    stated = [name for name in ("approach", "wrench") if name in data.given]
    if IN_ORDER in data.notes:  # approach then only follows from the row before
        stated = [name for name in stated if name != "approach"]
    touched = [name for series in data.series for name in series.labels]
    there = [name for name in dict.fromkeys((*LABELS, *touched)) if name in data.table]
    return [*joints, *there, *(column for name in stated for column in condition_columns(name, data.robot))]


def _measured(data: Measurements) -> list[str]:
    """Return the columns of measured values."""
    conditions = {column for name in data.given for column in condition_columns(name, data.robot)}
    stated = conditions | set(numbered("q", data.robot.n_joints)) | set(OF_THE_ROW)
    return [str(name) for name in data.table if name not in stated and data.table[name].dtype.kind == "f"]


def _by_chance(data: Measurements, setting: list[str], values: list[str], again: np.ndarray) -> float:
    """Return the expected number of identical pairs of genuine repeats, by the device's scatter and resolution."""
    table = data.table
    distinct = table[~again].groupby(setting, sort=False, dropna=False)[values]
    size = distinct.transform("size").to_numpy()
    apart = (table.loc[~again, values] - distinct.transform("mean")).to_numpy()[size > 1]
    shrunk = np.sqrt(1 - 1 / size[size > 1])[:, None]
    stated = BEST if data.sigma is None else float(np.nanmedian(data.sigma))
    alike = 1.0
    for k, name in enumerate(values):
        numbers = table[name].to_numpy()[~np.isnan(table[name].to_numpy())]
        scatter = float(np.sqrt(np.nanmean((apart[:, k] / shrunk[:, 0]) ** 2))) if len(apart) else stated
        alike *= min(1.0, _last_digit(numbers) / max(2 * np.sqrt(np.pi) * scatter, 1e-12))
    sizes = table.groupby(setting, sort=False, dropna=False).size().to_numpy()
    return float(alike * (sizes * (sizes - 1) / 2).sum())


def _last_digit(values: np.ndarray) -> float:
    """Return the resolution [m or rad] of values written in a file in mm (or mrad)."""
    for decimals in range(FINEST):
        scaled = values * 10.0 ** (3 + decimals)
        if np.allclose(scaled, np.rint(scaled), rtol=0, atol=1e-3):
            return float(10.0 ** -(3 + decimals))
    return float(10.0 ** -(3 + FINEST))
