"""The choice of the columns that hold joints and measured point, by their names and by the fit of the nominal robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calflow.files.problems import refuse
from calflow.importing.column_role import ACTUAL, PLANNED, preferred
from calflow.importing.joined_rows import FEWEST_POSES, Joined
from calflow.importing.joint_mapping import (
    FACTORS,
    LARGEST_TURN,
    NOMINAL_ERROR,
    SCALES,
    FlangeKinematics,
    JointMapping,
    JointReading,
    family,
    mapped,
    readings_of,
    screened_errors,
    spread_of,
    unit_by_scale,
)
from calflow.robot.robot import Robot

CLOSE = 0.01  # error over the points' spread below which no further orders of unnamed joints are tried
EXACT = 1e-5  # m: smaller errors of the nominal robot mean that the points were computed with it
ONE_POSE = 3e-4  # rad or m within which joint readings belong to one pose
SLIDE = 10.0  # m: larger readings of a slide are taken as mm
MOST_WINDOWS = {1: 20, 2: 4}  # windows of unnamed columns up to which orders (1), and orders with signs (2), are tried
MOST_WEIGHED = 12  # trials of unnamed columns that are fitted with the marker free


@dataclass(frozen=True)
class Choice:
    """A joint mapping with the columns of the measured point (x, y, z), their unit and the words in common."""

    mapping: JointMapping
    points: tuple[int, ...]
    unit: str
    group: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Trial:
    """Candidate columns of joints and point: a plain reading and the width of its family of alternatives (None: none).

    figures (n_rows, n_columns) and measured (n_rows, 3) [m] hold the complete rows.
    """

    plain: JointReading
    width: int | None
    points: tuple[int, ...]
    unit: str
    group: tuple[str, ...]
    figures: np.ndarray
    measured: np.ndarray

    @property
    def asked(self) -> list[JointReading]:
        """The alternative readings to be compared with the plain one."""
        return [] if self.width is None else family(self.plain, self.width)

    def promise(self, flange: FlangeKinematics, marker: np.ndarray) -> float:
        """Return the error of the best reading over the points' spread, with the marker at its stated position."""
        errors = screened_errors(flange, [self.plain, *self.asked], self.figures, self.measured, marker)
        return float(errors.min() / spread_of(self.measured))


def chosen_columns(
    joined: Joined, flange: FlangeKinematics, marker: str, rows: np.ndarray, stated: Mapping[str, str]
) -> tuple[Choice, tuple[str, ...]]:
    """Return the columns with which the nominal robot fits the measured marker best, and notes on columns left out.

    rows (n_rows,) selects the rows of this marker; stated maps calflow's column names to those that the user states.

    Raises:
        InputError: no columns fit, or several choices fit equally well.
    """
    robot, here = flange.robot, np.array(flange.robot.markers[marker].point)
    marker_known, named = robot.markers[marker].known, bool(joined.roles.joints)
    choices: list[Choice] = []
    for width in (0,) if named else range(3):
        trials = list(_trials(joined, flange, rows, stated, width))
        if not named and len(trials) > MOST_WEIGHED:
            trials.sort(key=lambda trial: trial.promise(flange, here))
            trials = trials[:MOST_WEIGHED]
        for trial in trials:
            mapping = mapped(flange, trial.plain, trial.asked, trial.figures, trial.measured, here, marker_known)
            choices.append(Choice(mapping, trial.points, trial.unit, trial.group))
        if any(
            choice.mapping.fits and (named or choice.mapping.taken.error < CLOSE * choice.mapping.spread)
            for choice in choices
        ):
            break
    if not choices:
        raise refuse(
            f"{joined.title}: fewer than {FEWEST_POSES} different poses with all joints and a point: too few to tell columns by"
        )
    best, notes = _best(choices, joined)
    mapping = best.mapping
    if not mapping.fits:
        raise refuse(_misfit(mapping, joined, robot))
    if mapping.rivals and _other_readings(mapping, joined.figures):
        raise refuse(
            f"{joined.title}: {1 + len(mapping.rivals)} ways to read the joints fit equally well ({_ways(mapping, joined)}): "
            "name them: --column q1_deg=NAME …, with a minus before NAME where the joint counts the other way"
        )
    return best, notes


def _trials(
    joined: Joined, flange: FlangeKinematics, rows: np.ndarray, stated: Mapping[str, str], width: int
) -> Iterator[_Trial]:
    """The candidate columns with alternatives of this width about each plain reading; none if these were too many."""
    every = joined.figures
    windows = list(_joint_choices(joined, flange.robot))
    if width and len(windows) > MOST_WINDOWS[width]:
        return
    for joints in windows:
        for points, group in _point_choices(joined, joints):
            figures = every[rows & np.isfinite(every[:, [*joints, *points]]).all(axis=1)]
            if len(np.unique(np.round(figures[:, joints], 3), axis=0)) < FEWEST_POSES:
                continue
            for plain in _plain_hypotheses(joined, joints, flange.robot, figures, stated):
                for unit in _units(joined, points, figures, flange, plain):
                    asked = None if ("stated",) in joined.roles.joints else width
                    yield _Trial(plain, asked, points, unit, group, figures, figures[:, points] * SCALES[unit])


def _joint_choices(joined: Joined, robot: Robot) -> Iterator[tuple[int, ...]]:
    """Candidate columns of the driven joints, in order: by their names, else every window of unnamed columns."""
    driven = robot.driven
    for group in preferred(list(joined.roles.joints)):
        members = joined.roles.joints[group]
        if all(i in members for i in driven):
            yield tuple(members[i] for i in driven)
        elif len(members) == len(driven):
            yield tuple(members[i] for i in sorted(members))
    if joined.roles.joints:
        return
    free = joined.free
    for start in range(len(free) - len(driven) + 1):
        yield tuple(free[start : start + len(driven)])


def _point_choices(joined: Joined, joints: Sequence[int]) -> Iterator[tuple[tuple[int, ...], tuple[str, ...]]]:
    """Candidate columns of the measured x, y and z, with the words that their names share."""
    for group in preferred(list(joined.roles.points)):
        members = joined.roles.points[group]
        yield (members["x"], members["y"], members["z"]), group
    if joined.roles.points:
        return
    free = [k for k in joined.free if k not in joints]
    for x, two, three in zip(free, free[1:], free[2:], strict=False):
        if three == x + 2:
            yield (x, two, three), ()


def _plain_hypotheses(
    joined: Joined, joints: Sequence[int], robot: Robot, figures: np.ndarray, stated: Mapping[str, str]
) -> list[JointReading]:
    """The joint readings in the order of the names: in the stated units, else in each unit that the values allow."""
    reversed_joints = {ours.partition("_")[0] for ours, theirs in stated.items() if theirs.startswith("-")}
    signs = tuple(-1 if f"q{i + 1}" in reversed_joints else 1 for i in robot.driven)
    turning = np.array([robot.joints[i].kind == "revolute" for i in robot.driven])
    units = [joined.columns[k].unit for k in joints]
    largest = np.nanmax(np.abs(figures[:, joints]), axis=0)
    ways = []
    for turn in ("deg", "rad"):
        if turn == "rad" and turning.any() and (largest[turning] > LARGEST_TURN).any():
            continue
        titled = [
            unit if unit in FACTORS else turn if turns else "mm" if most > SLIDE else "m"
            for unit, turns, most in zip(units, turning, largest, strict=True)
        ]
        ways.append(JointReading(tuple(joints), signs, tuple(FACTORS[unit] for unit in titled)))
    return list(dict.fromkeys(ways))


def _units(
    joined: Joined, points: Sequence[int], figures: np.ndarray, flange: FlangeKinematics, plain: JointReading
) -> list[str]:
    """The candidate units of a point: the stated one, and the one in which the points' spread is the robot's."""
    unit = joined.columns[points[0]].unit
    fitting = unit_by_scale(figures[:, points], flange, readings_of(plain, figures))
    return list(dict.fromkeys([unit, fitting] if unit in SCALES else [fitting]))


def _best(choices: Sequence[Choice], joined: Joined) -> tuple[Choice, tuple[str, ...]]:
    """The best-fitting choice among measured columns, with notes on columns that fit to rounding, and so were computed.

    Raises:
        InputError: all points were computed, or two points fit and their names do not say which was measured.
    """
    fitting = [choice for choice in choices if choice.mapping.fits]
    computed = [choice for choice in fitting if choice.mapping.taken.error < EXACT and choice.group != ("stated",)]
    measured = [choice for choice in fitting if choice not in computed and not PLANNED & {*choice.group}]
    if fitting and not measured:
        raise refuse(
            f"{joined.title}: {_titles(fitting[0], joined)} are where the nominal robot is, or have the names of planned "
            f"positions. Which were measured? Name the columns: --column x_mm=NAME --column y_mm=NAME --column z_mm=NAME"
        )
    notes = tuple(
        f"{_titles(choice, joined)} are where the nominal robot is, to rounding: computed, and left out"
        for choice in computed[:1]
    )
    if not measured:
        return min(choices, key=lambda choice: choice.mapping.taken.error / choice.mapping.spread), notes
    apart = {choice.points: choice for choice in reversed(measured)}
    named = [points for points, choice in apart.items() if ACTUAL & {*choice.group}]
    if len(apart) > 1 and len(named) != 1 and joined.roles.points:
        each = " and ".join(_titles(choice, joined) for choice in apart.values())
        raise refuse(
            f"{joined.title}: {each} all fit the robot, and their names do not say which was measured. Name the columns: "
            "--column x_mm=NAME --column y_mm=NAME --column z_mm=NAME"
        )
    eligible = [choice for choice in measured if not named or choice.points == named[0]]
    best = min(eligible, key=lambda choice: choice.mapping.taken.error / choice.mapping.spread)
    # Among choices that fit equally well, the first is the one that the names prefer.
    good = max(2 * best.mapping.taken.error, best.mapping.taken.error + NOMINAL_ERROR)
    return next(choice for choice in eligible if choice is best or choice.mapping.taken.error <= good), notes


def _titles(choice: Choice, joined: Joined) -> str:
    return ", ".join(f"'{joined.columns[k].title}'" for k in choice.points)


def _misfit(mapping: JointMapping, joined: Joined, robot: Robot) -> str:
    return (
        f"{joined.title}: no order, unit or sign of its joints puts robot '{robot.name}' where the points were measured: "
        f"at best they are {1e3 * mapping.taken.error:.0f} mm off (median), while they lie {1e3 * mapping.spread:.0f} mm apart. Is "
        "it this robot, and are the rows of joints and points the same poses?"
    )


def _other_readings(mapping: JointMapping, figures: np.ndarray) -> bool:
    """Whether rivals give different joint readings, which those of a joint that never moves do not."""
    readings = readings_of(mapping.taken.hypothesis, figures)
    return any(
        np.nanmax(np.abs(readings_of(rival.hypothesis, figures) - readings)) > ONE_POSE for rival in mapping.rivals
    )


def _ways(mapping: JointMapping, joined: Joined) -> str:
    every = [mapping.taken, *mapping.rivals][:3]
    return "; ".join(
        ", ".join(
            f"{'-' * (s < 0)}{joined.columns[c].name}"
            for c, s in zip(choice.hypothesis.columns, choice.hypothesis.signs, strict=True)
        )
        for choice in every
    )
