"""Attained poses: measured positions and orientations averaged by pose, beside those that models expect.

Includes pose accuracy AP and pose repeatability RP (ISO 9283:1998, clauses 7.2 and 7.3), the five test poses of its
cube (clause 6), and the alignment of a device's frame with the calibration's by a rigid motion (least squares).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from calflow.deployment.figures_alone import FiguresAlone
from calflow.estimation.accuracy import judged_unit
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.noise import group_means, members
from calflow.files.deferred import Rotation, pd
from calflow.files.problems import refuse
from calflow.files.units import METRE, MeasurementUnit
from calflow.files.words import plural
from calflow.measurements.measurements import Measurements
from calflow.observations import leading_units
from calflow.robot.frames import crossing

FREEDOM = 6  # degrees of freedom of a fitted frame
FEWEST_FOR_FRAME = 4  # poses: with fewer, a fitted frame leaves no residual to judge
IN_LINE = 1e-3  # second singular value of centred points over the first, below which they are collinear
CYCLES = 30  # cycles per pose in the standard
ALIKE = 0.05  # relative tolerance of distances within which poses count as placed as the standard says
INSET = 0.8  # share of a diagonal between two poses, which are 10 % from either end
DIAGONAL, LONG, SHORT = np.sqrt([3.0, 2.0, 1.0])  # of a unit cube: space diagonal, face diagonal, edge
TARGET = ("target_x", "target_y", "target_z")
NOMINAL, CALIBRATED, FIGURES, COMMANDED = "nominal", "calibrated", "figures", "commanded"
ELSEWHERE = 20e-3  # m: mean error above which the device stands elsewhere, as no calibrated robot errs so much
NOT_FITTED = np.zeros(0, dtype=bool)  # before it is asked where the device stands

Station = Literal["auto", "known", "fitted"]


@dataclass(frozen=True)
class Alignment:
    """A rigid motion from the measured into the expected frame: rotation turn (3, 3), translation shift (3,) [m]."""

    turn: np.ndarray
    shift: np.ndarray

    @staticmethod
    def best(measured: np.ndarray, expected: np.ndarray) -> Alignment:
        """Return the motion of measured onto expected points (n, 3) [m] by least squares (Kabsch 1976)."""
        share = np.full(len(measured), 1 / len(measured))
        centre, aim = share @ measured, share @ expected
        turn, _ = Rotation.align_vectors(expected - aim, measured - centre, weights=share)
        return Alignment(turn.as_matrix(), aim - turn.apply(centre))

    def of(self, points: np.ndarray) -> np.ndarray:
        """Return points (n, 3) [m] transformed by the motion."""
        return np.asarray(points @ self.turn.T + self.shift)

    def moved(self, points: np.ndarray) -> float:
        """Return the mean displacement of points (n, 3) [m] under the motion [m]."""
        return float(np.linalg.norm(self.of(points) - points, axis=1).mean())

    @property
    def angle(self) -> float:
        """Rotation angle [rad]."""
        return float(Rotation.from_matrix(self.turn).magnitude())


def placed_anew(station: Station, by_session: bool) -> bool:
    """Whether all frames are fitted: it is asked for, or the calibration's sessions had frames of their own (see `Model`)."""
    return station == "fitted" or (station == "auto" and by_session)


def can_align(points: np.ndarray) -> bool:
    """Whether points (n, 3) suffice to fit a frame with residuals left: enough of them, and not collinear."""
    if len(points) < FEWEST_FOR_FRAME:
        return False
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] > IN_LINE * spread[0])


def rigid_slope(points: np.ndarray) -> np.ndarray:
    """Return the Jacobian of points (n, 3) by translation and rotation about their mean (n, 3, 6) [m per m, rad]."""
    arm = points - points.mean(axis=0)
    return np.concatenate([np.tile(np.eye(3), (len(arm), 1, 1)), crossing(-arm)], axis=2)


def restored(errors: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return residuals (n, 3, …) of a fitted frame, enlarged to the variance of independent errors before the fit.

    Each is divided by the root of one minus its leverage (MacKinnon and White 1985, HC2), from points (n, 3).
    """
    slope = rigid_slope(points)
    whole = np.linalg.inv(np.einsum("nai,naj->ij", slope, slope))
    left = np.eye(3) - slope @ whole @ slope.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(left)
    root = np.maximum(values, 1e-12) ** -0.5
    return np.asarray(np.einsum("nai,ni,nbi,nb...->na...", vectors, root, vectors, errors))


def beside_motion(errors: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return errors (n, 3, …) of points (n, 3) without what a rigid motion of them all removes (least squares)."""
    slope = rigid_slope(points).reshape(3 * len(points), FREEDOM)
    stacked = errors.reshape(len(slope), -1)
    return np.asarray(stacked - slope @ np.linalg.lstsq(slope, stacked, rcond=None)[0]).reshape(errors.shape)


def errors_left_out(measured: np.ndarray, expected: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return leave-one-out errors (n, 3) [m]: measured minus expected points in the frame of all other poses (n,).

    They are the errors of a further pose, which include the error of the fitted frame; the residuals of the fit itself
    understate it, the more so the fewer the poses. nan where the other poses are too few or collinear.
    """
    centred = np.full_like(measured, np.nan)
    for name in np.unique(pose):
        members = pose == name
        if can_align(measured[~members]):
            frame = Alignment.best(measured[~members], expected[~members])
            centred[members] = frame.of(measured[members]) - expected[members]
    return centred


def pose_repeatability(attained: np.ndarray) -> float:
    """Return RP = mean + 3 S of the distances from attained positions (n, 3) to their barycentre, in their unit.

    S is the distances' standard deviation with n - 1 degrees of freedom; nan for a single position.
    """
    if len(attained) < 2:
        return float("nan")
    distance = np.linalg.norm(attained - attained.mean(axis=0), axis=1)
    return float(distance.mean() + 3 * distance.std(ddof=1))


def angle_repeatability(attained: np.ndarray) -> np.ndarray:
    """Return RP of orientations: 3 S of each of the attained angles (n, 3), in their unit; nan for a single one."""
    if len(attained) < 2:
        return np.full(3, np.nan)
    return np.asarray(3 * attained.std(axis=0, ddof=1))


def cube_edge(points: np.ndarray) -> float:
    """Return the edge of ISO 9283's cube in whose inclined plane five points (5, 3) lie; nan where they do not."""
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


def unit_of(data: Measurements) -> MeasurementUnit:
    """Return the unit in which rows are judged."""
    units = leading_units(data)
    return judged_unit([units[k] for k in np.unique(data.series_number)])


@dataclass(frozen=True)
class Attained:
    """Points, each measured once or several times under the same conditions (attained poses of ISO 9283).

    table: labels and number of rows of each point; group (n_rows,): each row's point; measured (n, 3) [m]: barycentres in
    the device's frame; expected: the position (n, 3) [m] by each model; shared (n, 3, n_errors) [m]: loadings of the
    calibrated model's errors on independent standard normals; apart (n,) [m]: standard deviation of the length of each
    point's independent error, device noise included; noise (n,) [m]: device noise per axis; repeatability (n,) [m]: RP;
    turns: orientations.

    fitted (n_frames,): the sessions whose frame is fitted (see `standing`).

    Without measured positions (in_space) all of these are in `unit`: measured and expected are then relative to the
    calibrated model's prediction, with as many columns as a row has values, and there is no repeatability. taken: degrees
    of freedom of new objects (a socket, a surface), which these rows place; values: number of values of a pose, on average.
    by_session: as of the calibration's model.
    """

    table: pd.DataFrame
    group: np.ndarray
    measured: np.ndarray
    expected: Mapping[str, np.ndarray]
    shared: np.ndarray
    apart: np.ndarray
    noise: np.ndarray
    repeatability: np.ndarray
    turns: AttainedTurns | None
    fitted: np.ndarray
    unit: MeasurementUnit = METRE
    in_space: bool = True
    taken: int = 0
    values: float = 3.0
    by_session: bool = False

    @staticmethod
    def of(
        calibrated: CalibratedModel, data: Measurements, station: Station, figures: FiguresAlone | None = None,
        places: np.ndarray | None = None,
    ) -> Attained:  # fmt: skip
        """Return the points of measured rows; the nominal model has the calibration's placement.

        station: as of `validate`; figures: those of the controller while measuring; their deviation from the calibrated model adds
        an error; places (n_rows, 3) [m]: where on the flange the points were to be, if the flange was sent there, not the marker.

        Raises:
            InputError: a frame cannot be fitted.
        """
        if not data.has_positions:
            return Attained.in_its_unit(calibrated, data)
        rows = calibrated.conditions_of(data)
        table, group = _points(data)
        expected = {
            NOMINAL: group_means(calibrated.model.point(calibrated.model.nominal, rows), group),
            CALIBRATED: group_means(calibrated.expected_point(rows), group),
        }
        if TARGET[0] in data.table:
            expected[COMMANDED] = group_means(data.table[[*TARGET]].to_numpy(dtype=float), group)
        noise = np.sqrt(
            group_means(np.nan_to_num(calibrated.device_sigma(data)) ** 2, group) / table["rows"].to_numpy()
        )
        shared = group_means(calibrated.shared_errors(rows, places), group)
        left = group_means(calibrated.position_variance(rows, places).sum(axis=1), group) - (shared**2).sum(axis=(1, 2))
        if figures is not None:
            model = replace(figures.model.later(data), given=calibrated.model.given)
            expected[FIGURES] = group_means(model.point(figures.estimate, rows), group)
            shared = np.concatenate([shared, (expected[FIGURES] - expected[CALIBRATED])[:, :, None]], axis=2)
        row_numbers = members(group)
        return Attained(
            table, group, group_means(data.position, group), expected, shared, np.sqrt(np.maximum(left, 0.0) + 3 * noise**2), noise,
            np.array([pose_repeatability(data.position[k]) for k in row_numbers]),
            AttainedTurns.of(calibrated, data, rows, row_numbers), NOT_FITTED, by_session=calibrated.model.by_session,
        ).standing(station)  # fmt: skip

    @staticmethod
    def in_its_unit(calibrated: CalibratedModel, data: Measurements) -> Attained:
        """Return the points of the series that report in the unit in which their model is judged."""
        unit = unit_of(data)
        stated = data.stating(calibrated.model.given)
        found = calibrated.errors_in_unit(stated, unit)
        nominal = replace(calibrated, estimate=calibrated.model.nominal).errors_in_unit(stated, unit).error
        there = np.isfinite(found.error)
        values = there.sum(axis=1)
        rows = values > 0
        if not rows.any():
            raise refuse(
                "expected more rows of each object than it takes to place it: none of these shows an error", key="data"
            )
        off = {NOMINAL: np.nan_to_num(nominal[rows]), CALIBRATED: np.nan_to_num(found.error[rows])}
        table, group = _points(data.only(rows))
        of_device = group_means(calibrated.device_sigma(data)[rows] ** 2, group) / table["rows"].to_numpy()
        variance = group_means((there * found.variance).sum(axis=1)[rows], group)
        expected = {name: group_means(errors_of - off[CALIBRATED], group) for name, errors_of in off.items()}
        return Attained(
            table, group, -group_means(off[CALIBRATED], group), expected, np.zeros((len(table), off[CALIBRATED].shape[1], 0)),
            np.sqrt(variance + group_means(values[rows], group) * of_device), np.sqrt(of_device),
            np.full(len(table), np.nan), None, NOT_FITTED, unit, in_space=False,
            taken=found.taken, values=float(values.sum() / data.table["pose"].nunique()),
        ).standing("known")  # fmt: skip

    @property
    def pose(self) -> np.ndarray:
        """Index of each point's pose, shape (n,)."""
        return np.asarray(self.table.groupby("pose", sort=False).ngroup())

    @property
    def frame(self) -> np.ndarray:
        """Index of each point's session, shape (n,): each session has its own frame."""
        if "session" not in self.table:
            return np.zeros(len(self.table), dtype=int)
        return np.asarray(self.table.groupby("session", sort=False).ngroup())

    @cached_property
    def of_sessions(self) -> tuple[np.ndarray, ...]:
        """The mask (n,) of each session's points."""
        return tuple(self.frame == k for k in range(self.frame.max() + 1))

    @cached_property
    def motions(self) -> tuple[Alignment | None, ...]:
        """The motion of each session's points onto the calibrated robot's; None for too few points, or points on one line."""
        return tuple(
            Alignment.best(self.measured[rows], self.expected[CALIBRATED][rows])
            if self.in_space and can_align(self.measured[rows])
            else None
            for rows in self.of_sessions
        )

    @cached_property
    def motion_p(self) -> float | None:
        """The p-value of the motions of all sessions, where nothing moved (F test); None where one has none.

        The motions are held against what the calibrated model's errors, which the points share, and the scatter of the points
        beside the motions move them by.
        """
        if None in self.motions:
            return None
        error = (self.measured - self.expected[CALIBRATED]).ravel()
        of_frames = np.zeros((len(self.measured), 3, len(self.motions), FREEDOM))
        for k, rows in enumerate(self.of_sessions):
            of_frames[rows, :, k] = rigid_slope(self.measured[rows])
        slope = of_frames.reshape(error.size, -1)
        solved = np.linalg.pinv(slope)
        motion = solved @ error
        taken, rest = len(motion), error.size - len(motion)
        own = ((error - slope @ motion) ** 2).sum() / rest
        if not own > 0:
            return 1.0
        shared = solved @ self.shared.reshape(error.size, -1)
        covariance = own * solved @ solved.T + shared @ shared.T
        return float(scipy.special.fdtrc(taken, rest, motion @ np.linalg.solve(covariance, motion) / taken))

    def standing(self, station: Station) -> Attained:
        """Return the points with the frames fitted of those sessions in which the device stands elsewhere, or of all.

        Raises:
            InputError: a frame is to be fitted to too few points, or to points on one line.
        """
        sessions = list(zip(self.sessions, self.motions, self.of_sessions, strict=True))
        if not self.in_space or not placed_anew(station, self.by_session):
            elsewhere = [
                motion is not None and motion.moved(self.measured[rows]) > ELSEWHERE for _, motion, rows in sessions
            ]
            return replace(self, fitted=np.array(elsewhere) & (station == "auto"))
        for name, motion, rows in sessions:
            if motion is None:
                named = f"session '{name}'" if name else "the whole"
                raise refuse(
                    f"the device's frame cannot be fitted: {named} has {plural(int(rows.sum()), 'point')}; "
                    f"expected at least {FEWEST_FOR_FRAME} that are not on one line, or say that the station stands where it stood "
                    "(--station known)"
                )
        return replace(self, fitted=np.full(len(sessions), True))

    @property
    def refitted(self) -> list[tuple[np.ndarray, Alignment]]:
        """The mask (n,) of the points of each session whose frame is fitted, and their motion onto the calibrated robot's."""
        sessions = zip(self.of_sessions, self.motions, self.fitted, strict=True)
        return [(rows, motion) for rows, motion, fitted in sessions if fitted and motion]

    def errors(self, model: str) -> np.ndarray:
        """Return measured minus expected points (n, 3) [m]; what a fitted frame leaves is enlarged by `restored`."""
        errors = np.array(self.measured - self.expected[model])
        for rows, _ in self.refitted:
            measured, expected = self.measured[rows], self.expected[model][rows]
            errors[rows] = restored(Alignment.best(measured, expected).of(measured) - expected, measured)
        return errors

    @cached_property
    def promised(self) -> np.ndarray:
        """Standard deviation of the length of each point's calibrated error, as predicted (n,) [m].

        In sessions whose frame is fitted the rigid part of the shared errors is removed, and the rest is enlarged as in `errors`.
        """
        shared = self.shared.copy()
        for rows, _ in self.refitted:
            points = self.measured[rows]
            shared[rows] = restored(beside_motion(shared[rows], points), points)
        return np.asarray(np.sqrt((shared**2).sum(axis=(1, 2)) + self.apart**2))

    def errors_of_further(self, model: str) -> np.ndarray:
        """Return the errors (n, 3) [m] to expect at further poses; nan where no frame can be fitted without a pose."""
        errors = np.array(self.measured - self.expected[model])
        for rows, _ in self.refitted:
            errors[rows] = errors_left_out(self.measured[rows], self.expected[model][rows], self.pose[rows])
        return errors

    @property
    def turned(self) -> np.ndarray:
        """The rotation (n, 3, 3) of each point by its session's frame, the identity where that is not fitted."""
        turned = np.tile(np.eye(3), (len(self.table), 1, 1))
        for rows, motion in self.refitted:
            turned[rows] = motion.turn
        return turned

    @property
    def refitted_words(self) -> str:
        """Words that name the sessions whose frames are fitted where others are not."""
        names = [f"'{name}'" for name, fitted in zip(self.sessions, self.fitted, strict=True) if fitted]
        return "" if self.fitted.all() else f" in session {', '.join(names)}"

    @property
    def sessions(self) -> tuple[str, ...]:
        """Name of each frame's session; a single empty name where sessions have none."""
        return tuple(self.table["session"].astype(str).unique()) if "session" in self.table else ("",)

    def in_mm(self, value: float) -> float:
        """Return a value in the unit of measurement in mm; nan where that is not a length."""
        return 1e3 * float(value) if self.unit == METRE else float("nan")

    def position_in_mm(self, value: float) -> float:
        """Return a value of measured positions [m] in mm; nan where none were measured."""
        return self.in_mm(value) if self.in_space else float("nan")

    def by_pose(self, values: np.ndarray, how: str) -> np.ndarray:
        """Return the mean or maximum of values (n,) over each pose, shape (n_poses,)."""
        return np.asarray(pd.Series(values).groupby(self.pose).agg(how))


def _points(data: Measurements) -> tuple[pd.DataFrame, np.ndarray]:
    """Return the points with labels and row counts, and each row's point index."""
    group = np.unique(data.repeated, return_inverse=True)[1]
    first = np.unique(group, return_index=True)[1]
    labels = [name for name in ("pose", "marker", "payload", "session") if name in data.table]
    return data.table.iloc[first][labels].reset_index(drop=True).assign(rows=np.bincount(group)), group


@dataclass(frozen=True)
class AttainedTurns:
    """Tool orientations by point: measured and by the calibrated robot (n, 3, 3); repeatability (n, 3): RP [rad]."""

    measured: np.ndarray
    expected: np.ndarray
    repeatability: np.ndarray

    @staticmethod
    def of(
        calibrated: CalibratedModel, data: Measurements, conditions: np.ndarray, own: Sequence[np.ndarray]
    ) -> AttainedTurns | None:
        """Return mean orientations of points with rows own, by packed conditions; None without orientations."""
        if data.rotation is None or not np.isfinite(data.rotation).all():
            return None
        seen = Rotation.from_matrix(data.rotation)
        predicted = Rotation.from_matrix(calibrated.model.rotation(calibrated.estimate, conditions))
        measured, expected = (np.stack([turns[k].mean().as_matrix() for k in own]) for turns in (seen, predicted))
        about = [(seen[k] * seen[k].mean().inv()).as_rotvec() for k in own]
        return AttainedTurns(measured, expected, np.stack([angle_repeatability(angles) for angles in about]))

    def errors(self, turn: np.ndarray) -> np.ndarray:
        """Return rotation errors (n, 3) [rad], measured relative to expected, about the measuring frame's axes.

        turn (n, 3, 3): that of each point's frame, if it is fitted.
        """
        return Rotation.from_matrix(turn @ self.measured @ self.expected.transpose(0, 2, 1)).as_rotvec()
