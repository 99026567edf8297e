"""Check poses: how far a calibrated robot is from where it was, and how far it may be where nothing moved."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calflow.deployment.alignment import Alignment, can_align, rigid_slope
from calflow.deployment.movements import Movement
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.certainty import unexplained
from calflow.estimation.needed_conditions import NeededCondition
from calflow.estimation.repeats import conditions
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements

FLAT = 1e4  # times its usual size: what a movement may be of which nothing is to be told
ANYWHERE = 1.0  # m and rad, about where it was fitted: of a frame that nobody knows
GAP = 3600.0  # s without a measurement, after which a new session begins


@dataclass(frozen=True)
class Check:
    """Check poses as a linear problem: error (n,) [m] of their coordinates, its covariance (n, n), and each one's session (n,).

    points are the coordinates' points (n / 3, 3) [m], table their labels, names those of the sessions in order, share (n / 3, m)
    what each of the m rows counts in its point, own (n / 3,) the part of the variance that
    a point has for itself [m²].
    """

    error: np.ndarray
    covariance: np.ndarray
    session: np.ndarray
    points: np.ndarray
    table: pd.DataFrame
    names: tuple[str, ...]
    share: np.ndarray
    own: np.ndarray

    @staticmethod
    def of(known: CalibratedModel, needed: list[NeededCondition], data: Measurements, fitted: np.ndarray) -> Check:
        """Set it up from rows; fitted (n_rows,) says of which the device's frame, one a session, is to be fitted to them.

        Repeats of a session are brought together. The covariance is that of the parameters, of the choice among models, of the
        discrepancy, which is another at each pose, of the device's noise, and of conditions that the rows lack.

        Raises:
            InputError: a frame cannot be fitted.
        """
        model = known.model
        rows = data.stating(model.given).on(model.robot).rows
        date, names = _sessions(data.table)
        group = np.unique(date * len(data) + conditions(data), return_inverse=True)[1]
        first = np.unique(group, return_index=True)[1]
        share = (group == np.arange(len(first))[:, None]) / np.bincount(group)[:, None]
        table = data.table.iloc[first].reset_index(drop=True)
        session = date[first]
        points, seen = share @ model.point(known.estimate, rows), share @ data.position
        slope = np.einsum("nm,mai->nai", share, model.point_jacobian(known.estimate, rows)).reshape(3 * len(first), -1)
        noise = known.noise(data).sigma if known.noise_known else np.zeros(len(data))
        own = (share**2) @ noise**2 + unexplained(known) ** 2
        own += sum((one.spread_mm / 1e3) ** 2 for one in needed if one.condition not in data.given)
        covariance = slope @ known.covariance @ slope.T + np.diag(np.repeat(own, 3))
        for other in known.alternatives:
            apart = replace(other.model, given=model.given).point(other.estimate, rows) - model.point(
                known.estimate, rows
            )
            off = (share @ apart).ravel()
            covariance += other.probability * np.outer(off, off)
        if fitted.any():
            for k in np.unique(session[fitted[first]]):
                there = session == k
                if not can_align(seen[there]):
                    raise refuse("the device's frame cannot be fitted to so few check poses, or they lie on one line: expected at "
                                 "least 4 a session, or say that the station stands where it stood (--station known)")  # fmt: skip
                seen[there] = Alignment.best(seen[there], points[there], np.ones(there.sum())).of(seen[there])
                frame = rigid_slope(points).reshape(len(covariance), 6) * np.repeat(there, 3)[:, None] * ANYWHERE
                covariance += frame @ frame.T
        return Check((seen - points).ravel(), covariance, np.repeat(session, 3), points, table, names, share, own)

    @property
    def sessions(self) -> int:
        """How many there are."""
        return len(self.names)

    def without(self, movement: Movement, since: int) -> Check:
        """Return the check with a movement of unknown size in its covariance: what it does tells nothing more."""
        own = self.columns(movement, since) * (FLAT * movement.sd)
        return replace(self, covariance=self.covariance + own @ own.T)

    def columns(self, movement: Movement, since: int) -> np.ndarray:
        """Return what a movement since a session (counted from 0) does (n, k) [m per unit]."""
        slope = np.einsum("nm,mak->nak", self.share, movement.slope).reshape(len(self.error), -1)
        return np.asarray(slope * (self.session >= since)[:, None])

    @property
    def square(self) -> float:
        """The square of the whitened error: of so many degrees of freedom as coordinates where nothing moved."""
        whitened = np.linalg.solve(np.linalg.cholesky(self.covariance), self.error)
        return float(whitened @ whitened)

    def size(self) -> np.ndarray:
        """Return the length of each point's error, shape (n / 3,) [m]."""
        return np.linalg.norm(self.error.reshape(-1, 3), axis=1)


def _sessions(table: pd.DataFrame) -> tuple[np.ndarray, tuple[str, ...]]:
    """The number of each row's session in order of time, or of the rows, and their names; hours apart are sessions too."""
    if "session" in table:
        order = table.sort_values("time", kind="stable") if "time" in table else table
        names = tuple(dict.fromkeys(order["session"].astype(str)))
        return table["session"].astype(str).map({name: k for k, name in enumerate(names)}).to_numpy(), names
    if "time" not in table:
        return np.zeros(len(table), dtype=int), ("",)
    time = np.sort(table["time"].to_numpy(dtype=float))
    starts = time[np.concatenate([[True], np.diff(time) > GAP])]
    number = np.searchsorted(starts, table["time"].to_numpy(dtype=float), side="right") - 1
    return number, tuple(f"{start / 3600:.1f} h" for start in starts) if len(starts) > 1 else ("",)
