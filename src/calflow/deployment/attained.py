"""Attained poses: where a device saw the robot, brought together pose by pose, beside where models say that it is.

ISO 9283: pose accuracy and pose repeatability, and the five poses of its test cube.

Formulas of ISO 9283:1998, clauses 7.2 (pose accuracy AP) and 7.3 (pose repeatability RP); poses of clause 6.

Alignment: the frame in which a device stood when it stood elsewhere, by the rigid motion that fits its points best.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calflow.deployment.figures_alone import FiguresAlone
from calflow.estimation.accuracy import errors, judged_unit
from calflow.estimation.calibrated_model import (
    CalibratedModel,
    expected_point,
    position_variance,
    shared_errors,
    variance_in_unit,
)
from calflow.estimation.noise import conditions, members
from calflow.files.deferred import Rotation, pd
from calflow.files.problems import refuse
from calflow.files.units import METRE, MeasurementUnit
from calflow.measurements.measurements import Measurements
from calflow.observations import leading_units

FREEDOM = 6  # numbers that a frame takes away
FEWEST_FOR_FRAME = 4  # poses, of fewer a frame leaves nothing to judge
IN_LINE = 1e-3  # of their spread, by which points must leave a line to show a turn
CYCLES = 30  # times that the standard has each pose attained
ALIKE = 0.05  # share by which distances may be off, and poses still count as placed as the standard says
INSET = 0.8  # share of a diagonal that is left between two poses, 10 % from either end
DIAGONAL, LONG, SHORT = np.sqrt([3.0, 2.0, 1.0])  # of a cube with edges of 1: diagonals of cube and of face, edge
TARGET = ("target_x", "target_y", "target_z")
NOMINAL, CALIBRATED, FIGURES, COMMANDED = "nominal", "calibrated", "figures", "commanded"


@dataclass(frozen=True)
class Alignment:
    """A rigid motion of measured points: turned (3, 3) and shifted (3,) [m] into the frame of the expected ones."""

    turn: np.ndarray
    shift: np.ndarray

    @staticmethod
    def best(measured: np.ndarray, expected: np.ndarray, weight: np.ndarray) -> Alignment:
        """Return the motion that takes measured to expected points (n, 3) [m] with least weighted squares (Kabsch 1976)."""
        share = weight / weight.sum()
        centre, aim = share @ measured, share @ expected
        turn, _ = Rotation.align_vectors(expected - aim, measured - centre, weights=share)
        return Alignment(turn.as_matrix(), aim - turn.apply(centre))

    @staticmethod
    def none() -> Alignment:
        """Return the motion that leaves everything where it is."""
        return Alignment(np.eye(3), np.zeros(3))

    def of(self, points: np.ndarray) -> np.ndarray:
        """Return points (n, 3) [m] moved."""
        return np.asarray(points @ self.turn.T + self.shift)

    def moved(self, points: np.ndarray) -> float:
        """Return how far the motion takes points (n, 3) [m], on average [m]."""
        return float(np.linalg.norm(self.of(points) - points, axis=1).mean())

    @property
    def angle(self) -> float:
        """By how much it turns [rad]."""
        return float(Rotation.from_matrix(self.turn).magnitude())


def can_align(points: np.ndarray) -> bool:
    """Whether points (n, 3) are many enough, and not on one line, so that a frame can be fitted and something be left."""
    if len(points) < FEWEST_FOR_FRAME:
        return False
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] > IN_LINE * spread[0])


def rigid_slope(points: np.ndarray) -> np.ndarray:
    """Return what a shift, and a turn about their middle, do to points (n, 3), shape (n, 3, 6) [m per m and rad]."""
    arm = points - points.mean(axis=0)
    cross = np.zeros((len(arm), 3, 3))
    cross[:, [1, 2, 0], [2, 0, 1]], cross[:, [2, 0, 1], [1, 2, 0]] = arm, -arm
    return np.concatenate([np.tile(np.eye(3), (len(arm), 1, 1)), cross], axis=2)


def restored(errors: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return errors (n, 3, …) that a fitted frame has made smaller, as large as errors independent of each other were before.

    Each is divided by the root of one minus its leverage in the fit (MacKinnon and White 1985, HC2); points (n, 3) say where.
    """
    slope = rigid_slope(points)
    whole = np.linalg.inv(np.einsum("nai,naj->ij", slope, slope))
    left = np.eye(3) - slope @ whole @ slope.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(left)
    root = np.maximum(values, 1e-12) ** -0.5
    return np.asarray(np.einsum("nai,ni,nbi,nb...->na...", vectors, root, vectors, errors))


def placed_anew(errors: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return errors (n, 3, …) of points (n, 3) as a frame that is fitted to them leaves and `restored` enlarges them."""
    slope = rigid_slope(points).reshape(3 * len(points), FREEDOM)
    stacked = errors.reshape(len(slope), -1)
    left = stacked - slope @ np.linalg.lstsq(slope, stacked, rcond=None)[0]
    return restored(left.reshape(errors.shape), points)


def errors_left_out(measured: np.ndarray, expected: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return measured minus expected points (n, 3) [m], those of each pose (n,) in the frame that fits all other poses best.

    So a further pose is seen: it errs by what the frame is off there besides, of which the frame's own poses show the less the
    fewer they are. nan where the other poses are too few, or lie on one line.
    """
    centred = np.full_like(measured, np.nan)
    for name in np.unique(pose):
        members = pose == name
        if can_align(measured[~members]):
            frame = Alignment.best(measured[~members], expected[~members], np.ones((~members).sum()))
            centred[members] = frame.of(measured[members]) - expected[members]
    return centred


def pose_repeatability(attained: np.ndarray) -> float:
    """Return RP = mean + 3 S of the distances from attained positions (n, 3) to their barycentre, in their unit.

    S is the distances' standard deviation with n - 1 degrees of freedom; nan of a single position.
    """
    if len(attained) < 2:
        return float("nan")
    distance = np.linalg.norm(attained - attained.mean(axis=0), axis=1)
    return float(distance.mean() + 3 * distance.std(ddof=1))


def angle_repeatability(attained: np.ndarray) -> np.ndarray:
    """Return RP of orientations: 3 S of each of the attained angles (n, 3), in their unit; nan of a single one."""
    if len(attained) < 2:
        return np.full(3, np.nan)
    return np.asarray(3 * attained.std(axis=0, ddof=1))


def cube_edge(points: np.ndarray) -> float:
    """Return the edge of the cube in whose inclined plane five points (5, 3) lie as the standard says; nan where they do not."""
    if len(points) != 5:
        return float("nan")
    centre = int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))
    others = np.delete(points, centre, axis=0)
    apart = np.sort(np.linalg.norm(others[:, None] - others[None], axis=2)[np.triu_indices(4, 1)])
    edge = float(apart[4:].mean() / (INSET * DIAGONAL))
    expected = INSET * edge * np.repeat([SHORT, LONG, DIAGONAL], 2)
    out = np.linalg.norm(points[centre] - others.mean(axis=0))
    right = edge > 0 and (np.abs(apart - expected) < ALIKE * expected).all() and out < ALIKE * edge
    return edge if right else float("nan")


@dataclass(frozen=True)
class Attained:
    """Points that were measured, each once or several times under the same conditions (ISO 9283's attained poses).

    table has a row a point with its labels and number of rows; measured (n, 3) are the barycentres [m] in the frame that the
    device reported in, expected maps each model to where it says they are (n, 3) [m]. shared (n, 3, n_errors) is
    what each of independent standard normals does to the errors that the calibrated model promises, apart (n,) the standard
    deviation of the length of what is each point's own besides, the device's noise in it, noise (n,) that noise alone per axis [m].
    repeatability (n,) is RP [m]. turns is there where orientations were measured.

    Where rows without positions were measured all of these are in `unit`: measured is then what was measured less what the
    calibrated model expects, from which expected counts too, in as many columns as a row has values.
    """

    table: pd.DataFrame
    measured: np.ndarray
    expected: Mapping[str, np.ndarray]
    shared: np.ndarray
    apart: np.ndarray
    noise: np.ndarray
    repeatability: np.ndarray
    turns: AttainedTurns | None
    unit: MeasurementUnit = METRE

    @staticmethod
    def of(calibrated: CalibratedModel, data: Measurements, figures: FiguresAlone | None = None) -> Attained:
        """Bring rows together; the nominal model is the robot as its maker says, placed where the calibration had it.

        figures are those that the controller had when the rows were measured: what they leave out is promised as an error.
        """
        if not data.has_positions:
            return Attained.in_its_unit(calibrated, data)
        rows = data.stating(calibrated.model.given).on(calibrated.model.robot).conditions
        table, group, mean = _points(data)
        count = table["rows"].to_numpy()
        estimates = {NOMINAL: calibrated.model.nominal, CALIBRATED: calibrated.estimate}
        expected = {
            NOMINAL: mean(calibrated.model.point(calibrated.model.nominal, rows)),
            CALIBRATED: mean(expected_point(calibrated, rows)),
        }
        if TARGET[0] in data.table:
            expected[COMMANDED] = mean(data.table[[*TARGET]].to_numpy(dtype=float))
        sigma = calibrated.noise(data).sigma if calibrated.noise_known else np.zeros(len(data))
        noise = np.sqrt(np.bincount(group, weights=np.nan_to_num(sigma) ** 2)) / count
        every = shared_errors(calibrated, rows)
        shared = mean(every.reshape(len(every), -1)).reshape(-1, *every.shape[1:])
        left = mean(position_variance(calibrated, rows)).sum(axis=1) - (shared**2).sum(axis=(1, 2))
        if figures is not None:
            model = replace(figures.model, given=calibrated.model.given)
            expected[FIGURES] = mean(model.point(figures.estimate, rows))
            shared = np.concatenate([shared, (expected[FIGURES] - expected[CALIBRATED])[:, :, None]], axis=2)
        row_numbers = members(group)
        return Attained(
            table, mean(data.position), expected, shared, np.sqrt(np.maximum(left, 0.0) + 3 * noise**2), noise,
            np.array([pose_repeatability(data.position[k]) for k in row_numbers]),
            AttainedTurns.of(calibrated, estimates, data, rows, row_numbers),
        )  # fmt: skip

    @staticmethod
    def in_its_unit(calibrated: CalibratedModel, data: Measurements) -> Attained:
        """Bring together the rows of the series that report in the unit by which a model of them is judged."""
        unit = judged_unit(leading_units(data))
        stated, noise = data.stating(calibrated.model.given), calibrated.noise(data)
        estimates = {NOMINAL: calibrated.model.nominal, CALIBRATED: calibrated.estimate}
        every = {name: errors(calibrated.model, p, stated, unit) for name, p in estimates.items()}
        rows = np.isfinite(every[CALIBRATED]).any(axis=1)
        off = {name: np.nan_to_num(values[rows]) for name, values in every.items()}
        table, group, mean = _points(data.only(rows))
        count = table["rows"].to_numpy()
        values = np.isfinite(every[CALIBRATED]).sum(axis=1)
        device = noise.sigma[rows] if calibrated.noise_known else np.zeros(rows.sum())
        of_device = np.sqrt(np.bincount(group, weights=device**2)) / count
        variance = mean(variance_in_unit(calibrated, stated, unit, values)[rows, None])[:, 0]
        expected = {name: mean(errors_of - off[CALIBRATED]) for name, errors_of in off.items()}
        return Attained(
            table, -mean(off[CALIBRATED]), expected, np.zeros((len(table), off[CALIBRATED].shape[1], 0)),
            np.sqrt(variance + mean(values[rows, None])[:, 0] * of_device**2), of_device,
            np.array([pose_repeatability(off[CALIBRATED][k]) for k in members(group)]), None, unit,
        )  # fmt: skip

    @property
    def pose(self) -> np.ndarray:
        """The number of each point's pose, from 0, shape (n,)."""
        return np.asarray(self.table.groupby("pose", sort=False).ngroup())

    @property
    def frame(self) -> np.ndarray:
        """The number of each point's session, from 0: a frame that is fitted is one a session, shape (n,)."""
        if "session" not in self.table:
            return np.zeros(len(self.table), dtype=int)
        return np.asarray(self.table.groupby("session", sort=False).ngroup())

    def alignment(self, model: str, fitted: np.ndarray) -> tuple[Alignment, ...]:
        """Return the motion that takes each session's points onto those of a model; none of those that are not fitted (n_frames,).

        Raises:
            InputError: a session has too few poses, or they lie on one line.
        """
        alignments = []
        for frame, wanted in enumerate(fitted):
            rows = self.frame == frame
            if not wanted:
                alignments.append(Alignment.none())
                continue
            if not can_align(self.measured[rows]):
                named = (
                    f"session '{self.table['session'][rows].iloc[0]}' has" if "session" in self.table else "there are"
                )
                raise refuse(
                    f"the device's frame cannot be fitted: {named} {rows.sum()} points; expected at least {FEWEST_FOR_FRAME} that "
                    "are not on one line, or say that the station stands where it stood (--station known)"
                )
            alignments.append(Alignment.best(self.measured[rows], self.expected[model][rows], np.ones(rows.sum())))
        return tuple(alignments)

    def errors(self, model: str, fitted: np.ndarray) -> np.ndarray:
        """Return measured minus expected points (n, 3) [m]; of a fitted frame as large as they were before (see `restored`).

        fitted (n_frames,) says of which sessions it is.
        """
        errors = np.array(self.measured - self.expected[model])
        alignments = self.alignment(model, fitted)
        for frame in np.flatnonzero(fitted):
            rows, alignment = self.frame == frame, alignments[frame]
            left = alignment.of(self.measured[rows]) - self.expected[model][rows]
            errors[rows] = restored(left, self.measured[rows])
        return errors

    def promised(self, fitted: np.ndarray) -> np.ndarray:
        """Return the standard deviation of the length of each point's calibrated error as it is promised (n,) [m].

        In a fitted frame (fitted (n_frames,) says where) what all points of it err by alike is taken off, and what is left is as
        large as `errors` makes it.
        """
        shared = self.shared.copy()
        for frame in np.flatnonzero(fitted):
            rows = self.frame == frame
            shared[rows] = placed_anew(shared[rows], self.measured[rows])
        return np.asarray(np.sqrt((shared**2).sum(axis=(1, 2)) + self.apart**2))

    def errors_of_further(self, model: str, fitted: np.ndarray) -> np.ndarray:
        """Return errors (n, 3) [m] as further poses would show them; nan where a frame cannot be fitted without a pose."""
        errors = self.errors(model, np.zeros_like(fitted))
        for frame in np.flatnonzero(fitted):
            rows = self.frame == frame
            errors[rows] = errors_left_out(self.measured[rows], self.expected[model][rows], self.pose[rows])
        return errors

    def of_rows(self, data: Measurements, fitted: np.ndarray) -> np.ndarray:
        """Return of each of the rows (n_rows,) what is so of its session (n_frames,)."""
        if "session" not in data.table:
            return np.full(len(data), fitted[0])
        return np.asarray(
            data.table["session"].astype(str).map(dict(zip(self.sessions, fitted, strict=True))), dtype=bool
        )

    @property
    def sessions(self) -> tuple[str, ...]:
        """Each frame's session by name; empty where they have none."""
        return tuple(self.table["session"].astype(str).unique()) if "session" in self.table else ("",)

    def in_mm(self, value: float) -> float:
        """Return a value of the unit of what was measured in mm; nan where that is none of length."""
        return 1e3 * float(value) if self.unit == METRE else float("nan")

    def by_pose(self, values: np.ndarray, how: str) -> np.ndarray:
        """Return the mean or max of each pose's values (n,), shape (n_poses,)."""
        return np.asarray(pd.Series(values).groupby(self.pose).agg(how))


def _points(data: Measurements) -> tuple[pd.DataFrame, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """The points that rows are of, with their labels and number of rows, each row's point, and what takes a mean over them."""
    group = np.unique(conditions(data), return_inverse=True)[1]
    count, first = np.bincount(group), np.unique(group, return_index=True)[1]
    labels = [name for name in ("pose", "marker", "payload", "session") if name in data.table]
    table = data.table.iloc[first][labels].reset_index(drop=True).assign(rows=count)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(group, weights=column) / count for column in values.T], axis=1)

    return table, group, mean


@dataclass(frozen=True)
class AttainedTurns:
    """How the tool was turned at each point: measured (n, 3, 3), and what each model expects; repeatability (n, 3) is RP [rad]."""

    measured: np.ndarray
    expected: Mapping[str, np.ndarray]
    repeatability: np.ndarray

    @staticmethod
    def of(
        calibrated: CalibratedModel,
        estimates: Mapping[str, np.ndarray],
        data: Measurements,
        conditions: np.ndarray,
        own: Sequence[np.ndarray],
    ) -> AttainedTurns | None:
        """Bring packed conditions (n_conditions, n_rows) together, own holding those of each point; None without orientations."""
        if data.rotation is None or not np.isfinite(data.rotation).all():
            return None
        seen = Rotation.from_matrix(data.rotation)
        means = [seen[k].mean() for k in own]
        about = [(seen[k] * mean.inv()).as_rotvec() for k, mean in zip(own, means, strict=True)]
        expected = {}
        for name, p in estimates.items():
            every = Rotation.from_matrix(calibrated.model.rotation(p, conditions))
            expected[name] = np.stack([every[k].mean().as_matrix() for k in own])
        return AttainedTurns(
            np.stack([mean.as_matrix() for mean in means]), expected, np.stack([angle_repeatability(a) for a in about])
        )

    def errors(self, model: str, frames: Sequence[Alignment], frame: np.ndarray) -> np.ndarray:
        """Return measured beside expected turns about the measuring frame's axes (n, 3) [rad], in frames that were fitted."""
        turn = np.stack([frames[k].turn for k in frame])
        return Rotation.from_matrix(turn @ self.measured @ self.expected[model].transpose(0, 2, 1)).as_rotvec()
