"""Hypotheses of user mistakes in robot file and table, each with its correction, prior odds and wording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations, permutations

import numpy as np

from calflow.effects.misstated_payload import PayloadMass
from calflow.faults.base import AXES, EXCHANGED, MEASUREMENT_FILE, POSITION, ROBOT_FILE, Correction
from calflow.faults.rough import PLACED_SD, level, motion
from calflow.faults.setup import STATED_SD, FittedSetup, Setup
from calflow.files.deferred import Rotation
from calflow.files.words import listed, rounded
from calflow.measurements.measurements import Measurements
from calflow.robot.frames import CONVENTIONS, Convention, angles, convention_of
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter

POUND, INCH, DEGREE = 0.45359237, 25.4, 180 / np.pi
LOG_ODDS, LOG_ODDS_MORE = -np.log(300.0), -np.log(20.0)  # prior odds of any one mistake, and of each further one alike
ARBITRARY = -np.log(10.0)  # prior odds of an arbitrary value against a definite error
ANYWHERE = np.log(PLACED_SD / STATED_SD)  # prior odds of each coordinate of a displaced part, uniform over positions
MOST_COMBINED = 7  # most joints for which all combinations of signs are tried, else up to two joints
MIN_TWIST = 0.1  # rad: least twist whose sign matters
RADIANS = 0.12  # rad: largest angle that may be radians read as degrees
DIFFERENT = 1e-3  # m: least difference of exchanged lengths
TYPO = 0.01  # m: tolerance between an estimate and the value without a typing error
TRIED = 25  # values of a dimension from which its fit may begin
MOST_ROTATION = 2.5  # rad: beyond it the axis of a relative rotation is ambiguous

Undo = Callable[[Setup], Setup]
LENGTH_UNITS = {
    INCH: "inches instead of mm",
    1 / INCH: "mm instead of inches",
    1e3: "m instead of mm",
    1e-3: "mm instead of m",
}
IDENTITY = np.eye(3)
REFLECTIONS = {  # of the axes, by the corrected quantity
    "x": np.diag([-1.0, 1.0, 1.0]),
    "y": np.diag([1.0, -1.0, 1.0]),
    "z": np.diag([1.0, 1.0, -1.0]),
    "x and y": IDENTITY[[1, 0, 2]],
    "x and z": IDENTITY[[2, 1, 0]],
    "y and z": IDENTITY[[0, 2, 1]],
}


@dataclass(frozen=True)
class Mistake:
    """The hypothesis of a single mistake: id, joint (0: none), inverse, wording given the corrected robot, and remedy.

    log_prior: logarithm of its prior odds; where: the file, or set-up, that contains it; corrections: those of the
    table, empty for a mistake of the robot file or with an unknown right value, which the user must correct; in_rows:
    corrections that replace those of row 0 if only some rows have the mistake.
    """

    id: str
    joint: int
    undo: Undo
    words: str | Callable[[FittedSetup], str]
    log_prior: float = LOG_ODDS
    corrections: tuple[Correction, ...] = ()
    where: str = ROBOT_FILE
    remedy: str = ""
    in_rows: tuple[Correction, ...] = ()

    def within(self, rows: np.ndarray, which: str, log_prior: float) -> Mistake:
        """Return the same mistake of the table limited to some rows (n_rows,), which its wording names."""

        def undo(setup: Setup) -> Setup:
            undone, there = self.undo(setup), rows[setup.numbers]
            return replace(
                setup,
                conditions=np.where(there, undone.conditions, setup.conditions),
                position=np.where(there[:, None], undone.position, setup.position),
                magnification=np.where(there, undone.magnification, setup.magnification),
            )

        corrections = [replace(made, row=int(row) + 1) for row in np.flatnonzero(rows) for made in self.in_rows]
        return replace(
            self, undo=undo, words=f"{which}: {self.words}", log_prior=log_prior, corrections=tuple(corrections),
            where=MEASUREMENT_FILE, remedy="correct these rows of the measurement file",
        )  # fmt: skip


def mistakes(data: Measurements, setup: Setup) -> Iterator[Mistake]:
    """Yield every single mistake of robot dimensions and table that is observable when base and tool are fitted."""
    figures = LinkDimensions(data, setup)
    yield from _signs(data)
    yield from _columns(data)
    yield from _coupled(data)
    yield from _axes(data, setup)
    yield from _conventions(setup)
    yield from figures.lengths_exchanged()
    yield from figures.joints_exchanged()
    yield from figures.misread()


def row_mistakes(data: Measurements) -> Iterator[Mistake]:
    """Yield every single mistake of the table that may concern a subset of rows, but for exchanged names."""
    yield from (mistake for mistake in _signs(data) if len(mistake.in_rows) == 1)
    yield from _columns(data)
    for name in REFLECTIONS:
        yield _reflected(name, "", (0,))


def misplaced(data: Measurements, setup: Setup) -> Iterator[Mistake]:
    """Yield markers and a base with a wrong stated pose."""
    yield from LinkDimensions(data, setup).markers()
    if setup.turn is not None:
        yield Mistake("base-elsewhere", 0, _freed(*setup.base), _base, ANYWHERE * 6 + LOG_ODDS)


def loads(data: Measurements, setup: Setup) -> Iterator[Mistake]:
    """Yield every single mistake of the loads, observable only by elastic deflection."""
    yield from exchanged_names(data, "payload")
    yield from LinkDimensions(data, setup).pounds()


# --- The table -----------------------------------------------------------------------------------------


def _mapped(changes: Mapping[int, tuple[int, float]]) -> Undo:
    """Return the function that replaces packed conditions, by index, by those of another index times a factor."""

    def undo(setup: Setup) -> Setup:
        conditions = setup.conditions.copy()
        for target, (source, factor) in changes.items():
            conditions[target] = factor * setup.conditions[source]
        return replace(setup, conditions=conditions)

    return undo


def _linear(matrix: np.ndarray) -> Undo:
    """Return the function that multiplies positions by a matrix (3, 3)."""
    magnification = float(np.cbrt(abs(np.linalg.det(matrix))))
    return lambda setup: replace(setup, position=setup.position @ matrix.T, magnification=magnification)


def _signs(data: Measurements) -> Iterator[Mistake]:
    n = data.robot.n_joints
    for size in range(1, n + 1 if n <= MOST_COMBINED else 3):
        for joints in combinations(data.robot.driven, size):
            names = [str(joint + 1) for joint in joints]
            columns = listed([f"q{name}" for name in names])
            signs = listed([f"{-data.robot.joints[joint].sign}" for joint in joints])
            where = f"joint {names[0]}" if size == 1 else f"joints {listed(names)}"
            remedy = (
                f"change the sign of column{'s' * (size > 1)} {columns}, or state sign = {signs} for "
                f"{'this joint' if size == 1 else 'these joints'} in the robot file"
            )
            corrections = tuple(Correction(0, f"q{name}", factor=-1.0) for name in names)
            yield Mistake(
                "joint-sign", joints[0] + 1, _mapped({joint: (joint, -1.0) for joint in joints}),
                f"{where}: all readings have the wrong sign", LOG_ODDS + (size - 1) * LOG_ODDS_MORE, corrections,
                MEASUREMENT_FILE, remedy, corrections,
            )  # fmt: skip


def _columns(data: Measurements) -> Iterator[Mistake]:
    """Yield exchanged columns of readings or marker names, wrong units, and columns a pose late or early."""
    for i, j in combinations(data.robot.driven, 2):
        words, remedy = f"columns q{i + 1} and q{j + 1} are exchanged", "exchange their names in the measurement file"
        undo = _mapped({i: (j, 1.0), j: (i, 1.0)})
        yield Mistake("columns-exchanged", i + 1, undo, words, where=MEASUREMENT_FILE, remedy=remedy)
    yield from exchanged_names(data, "marker")
    yield from _table_units(data)
    for i in data.robot.driven:
        for by, when in ((1, "late"), (-1, "early")):
            words = f"the readings in column q{i + 1} are a pose too {when} against all others"
            yield Mistake(
                "column-shifted", i + 1, _shifted(data, i, by), words, where=MEASUREMENT_FILE, remedy="shift them back"
            )


def _shifted(data: Measurements, joint: int, by: int) -> Undo:
    """Return the function that shifts a joint's readings by a number of poses."""
    pose = data.table["pose"].to_numpy()
    begins = np.flatnonzero(np.r_[True, pose[1:] != pose[:-1]])
    of = np.searchsorted(begins, np.arange(len(pose)), side="right") - 1
    reading = data.joints[begins[np.clip(of + by, 0, len(begins) - 1)], joint]
    return lambda setup: setup.with_reading(joint, reading[setup.numbers])


def _coupled(data: Measurements) -> Iterator[Mistake]:
    """Yield joints whose readings count from the link before the previous one, as with a parallelogram's motors."""
    joints = data.robot.joints
    for i, j in zip(data.robot.driven[1:], data.robot.driven, strict=False):
        if joints[i].kind == joints[j].kind == "revolute":
            for factor in (1, -1):
                words = f"the readings in column q{i + 1} do not count from the previous link: joint {j + 1} turns that joint, too"
                remedy = f"state joint = {i + 1}, source = {j + 1}, factor = {factor} in [[couplings]] (robot file)"
                yield Mistake("joint-coupled", i + 1, _added(i, j, factor * joints[i].sign), words, remedy=remedy)


def _added(joint: int, other: int, times: float) -> Undo:
    """Return the function that adds a multiple of another joint's reading to a joint's."""
    return lambda setup: setup.with_reading(joint, setup.conditions[joint] + times * setup.conditions[other])


def _axes(data: Measurements, setup: Setup) -> Iterator[Mistake]:
    """Yield left-handed frames and cyclic exchanges of axes; one of those that only the base's pose distinguishes."""
    names, meant = list(REFLECTIONS), "; or other axes, with another rotation of the base"
    if setup.turn is not None:
        meant = ""
        for order in list(permutations(range(3)))[3:5]:
            columns = ", ".join(AXES[k] for k in order)
            words = f"columns x, y, z are in another order: they fit as {columns}"
            undo = _linear(IDENTITY[list(order)])
            yield Mistake("axes-exchanged", 0, undo, words, where=MEASUREMENT_FILE, remedy="name them so")
    elif (expected := _base_rotation(data, setup)) is not None:
        mirror = REFLECTIONS["y"]
        turn = motion(setup.points(), setup.position @ mirror.T)[0]
        away = {name: np.trace(expected.T @ mend @ mirror @ turn) for name, mend in REFLECTIONS.items()}
        names, meant = [max(away, key=away.__getitem__)], ""
    else:
        names = ["y"]
    every = (0,) if len(data.series) == 1 else range(1, len(data) + 1)  # other series use these columns, too
    # One representative has the probability of all.
    for name in names:
        yield replace(_reflected(name, meant, every), log_prior=LOG_ODDS + np.log(len(REFLECTIONS) / len(names)))


def _reflected(name: str, meant: str, every: Sequence[int]) -> Mistake:
    """Return the mistake that an axis, or two, make a frame left-handed in every row."""
    both = name in EXCHANGED
    what = f"the axes {name} are exchanged" if both else f"the axis {name} is reversed"
    words, row = f"x, y, z are no right-handed frame: {what}{meant}", Correction(0, name, 1.0 if both else -1.0)
    corrections = tuple(replace(row, row=number) for number in every)
    return Mistake(
        "frame-mirrored", 0, _linear(REFLECTIONS[name]), words, LOG_ODDS, corrections, MEASUREMENT_FILE,
        "correct the measurement file", (row,),
    )  # fmt: skip


def _base_rotation(data: Measurements, setup: Setup) -> np.ndarray | None:
    """Return the base's rotation (3, 3) by the measured orientations, for any tool; None without these."""
    if data.rotation is None:
        return None
    there = np.flatnonzero(np.isfinite(data.rotation).all(axis=(1, 2)) & data.train)
    predicted = Rotation.from_matrix(setup.model.rotation(setup.mean, data.conditions[:, there]))
    seen = Rotation.from_matrix(data.rotation[there])
    axes, wanted = ((turns[1:] * turns[:-1].inv()).as_rotvec() for turns in (predicted, seen))
    clear = np.linalg.norm(axes, axis=1) < MOST_ROTATION
    return Rotation.align_vectors(wanted[clear], axes[clear])[0].as_matrix() if clear.sum() > 1 else None


def exchanged_names(data: Measurements, label: str) -> Iterator[Mistake]:
    """Yield exchanged names of payloads or markers."""
    names = list(data.robot.payloads if label == "payload" else data.robot.markers)
    first = Row.spans(data.robot)[label].start
    there = set(data.table[label])
    for (i, name), (j, other) in combinations(enumerate(names), 2):
        if {name, other} & there:
            words = f"{label}s {name} and {other} are exchanged"
            remedy = "exchange their names in the measurement file, or in the robot file"
            undo = _mapped({first + i: (first + j, 1.0), first + j: (first + i, 1.0)})
            where = f"{MEASUREMENT_FILE} or {ROBOT_FILE}"
            yield Mistake(f"{label}s-exchanged", 0, undo, words, where=where, remedy=remedy)


def _table_units(data: Measurements) -> Iterator[Mistake]:
    for factor, words in LENGTH_UNITS.items():
        yield Mistake(
            "unit-mistake", 0, _linear(factor * IDENTITY), f"x, y, z are in {words}", where=MEASUREMENT_FILE,
            remedy="correct their unit", in_rows=(Correction(0, POSITION, float(f"{factor:.10g}")),),
        )  # fmt: skip
    turning = [i for i in data.robot.driven if data.robot.joints[i].kind == "revolute"]
    for joints in [*([i] for i in turning), *([turning] if len(turning) > 1 else [])]:
        for factor, words in ((DEGREE, "radians instead of degrees"), (1 / DEGREE, "degrees instead of radians")):
            one = len(joints) == 1
            which, remedy = (
                (f"column q{joints[0] + 1} is", "correct its unit") if one else ("all angles are", "correct their unit")
            )
            in_rows = tuple(Correction(0, f"q{i + 1}", float(f"{factor:.10g}")) for i in joints)
            yield Mistake(
                "unit-mistake", joints[0] + 1 if one else 0, _mapped({i: (i, factor) for i in joints}), f"{which} in {words}",
                where=MEASUREMENT_FILE, remedy=remedy, in_rows=in_rows,
            )  # fmt: skip


# --- The robot file ------------------------------------------------------------------------------------


def _conventions(setup: Setup) -> Iterator[Mistake]:
    """Yield the other convention in which the same parameters may be stated."""
    joints = setup.model.robot.joints
    stated = convention_of([joint.frame for joint in joints])
    for name, frame in CONVENTIONS.items() if stated else ():
        if name != stated:

            def undo(setup: Setup, frame: Convention = frame) -> Setup:
                robot, joints = setup.model.robot, []
                for joint in robot.joints:
                    other = frame(**replace(joint.frame, origin=()).figures)
                    joints.append(replace(joint, frame=replace(other, origin=joint.frame.origin)))
                return setup.with_robot(replace(robot, joints=tuple(joints)))

            words = f"the dimensions of the robot file are of the convention {name}, but read as {stated}"
            yield Mistake("other-convention", 0, undo, words, remedy=f'expected convention = "{name}"')


@dataclass(frozen=True)
class LinkDimensions:
    """The robot's dimensions, as parameters of the set-up's model."""

    data: Measurements
    setup: Setup

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters."""
        return self.setup.model.parameters

    @cached_property
    def steps(self) -> list[list[int]]:
        """The parameters of each joint's steps, in table order."""
        of = {(p.joint, p.symbol): k for k, p in enumerate(self.parameters) if p.effect == "geometry" and p.joint}
        return [[of[i, step.symbol] for step in frame.every] for i, frame in enumerate(self.data.robot.frames, start=1)]

    @cached_property
    def lengths(self) -> list[int]:
        """The parameters of all lengths of the links."""
        return [k for steps in self.steps for k in steps if self.parameters[k].unit == "m"]

    @cached_property
    def turns(self) -> list[int]:
        """The parameters of the joints' zeros."""
        return [
            next(k for k in steps if self.parameters[k].symbol == frame.turn.symbol)
            for steps, frame in zip(self.steps, self.data.robot.frames, strict=True)
        ]

    def misread(self) -> Iterator[Mistake]:
        """Yield definite errors of dimensions: a twist's sign, a zero by right angles, another unit."""
        for joint, steps in enumerate(self.steps, start=1):
            for k in steps:
                for kind, right, what in self._intended(joint, k):
                    change = _changed({k: right - self.parameters[k].figure})
                    yield Mistake(kind, joint, change, f"{what}; {self._stated(k, right)}")
        for factor, words in ((INCH, "in inches"), (1 / INCH, "in mm read as inches")):
            lengths = {k: (factor - 1) * self.parameters[k].figure for k in self.lengths}
            yield Mistake("unit-mistake", 0, _changed(lengths), f"all lengths of the robot file are {words}")

    def _intended(self, joint: int, k: int) -> Iterator[tuple[str, float, str]]:
        """Yield the intended values of a joint's angle: the mistake's id, the right value [rad], and the wording."""
        value, is_turn = self.parameters[k].figure, k in self.turns
        if self.parameters[k].unit != "rad":
            return
        if not is_turn and MIN_TWIST < abs(value) < np.pi - MIN_TWIST:
            yield "twist-sign", -value, f"joint {joint}: the twist {self.parameters[k].symbol} has the wrong sign"
        if is_turn and self.data.robot.joints[joint - 1].kind == "revolute":
            for off in (90, -90, 180):
                right = value + np.deg2rad(off)
                yield (
                    "zero-offset",
                    np.arctan2(np.sin(right), np.cos(right)),
                    f"joint {joint}: its zero is off by {abs(off)} deg",
                )
        if 0 < abs(value) < RADIANS:
            yield "unit-mistake", DEGREE * value, f"{self._name(k)} is in radians"
        if abs(value) > 2 * np.pi:
            yield "unit-mistake", value / DEGREE, f"{self._name(k)} is in degrees"

    def lengths_exchanged(self) -> Iterator[Mistake]:
        """Yield exchanged lengths."""
        for k, other in combinations(self.lengths, 2):
            here, there = self.parameters[k].figure, self.parameters[other].figure
            if abs(here - there) > DIFFERENT:
                right = f"{self._stated(k, there)}, {self._stated(other, here)}"
                words = f"{self._name(k)} and {self._name(other)} are exchanged; {right}"
                undo = _changed({k: there - here, other: here - there})
                yield Mistake("lengths-exchanged", self.parameters[k].joint, undo, words)

    def joints_exchanged(self) -> Iterator[Mistake]:
        """Yield joints with exchanged parameters."""
        for i, j in combinations(range(len(self.steps)), 2):
            pairs = [*zip(self.steps[i], self.steps[j], strict=False)]
            values = [(k, self.parameters[k].figure, m, self.parameters[m].figure) for k, m in pairs]
            if len(self.steps[i]) == len(self.steps[j]) and sum(a != b for _, a, _, b in values) > 1:
                change = {k: b - a for k, a, _, b in values} | {m: a - b for _, a, m, b in values}
                words = f"the dimensions of joints {i + 1} and {j + 1} are exchanged; exchange them in the robot file"
                yield Mistake("joints-exchanged", i + 1, _changed(change), words)

    def mistyped(self) -> Iterator[Mistake]:
        """Yield lengths and zeros with an arbitrary value."""
        for k in (*self.lengths, *self.turns):
            joint, log_prior = self.parameters[k].joint, LOG_ODDS + ARBITRARY
            yield Mistake(
                "figure-mistyped", joint, _freed_from(k, self._changes(k)), partial(self._mistyped, k), log_prior
            )

    def _changes(self, k: int) -> np.ndarray:
        """Return changes of a dimension (n,) [m or rad], one of which brings a wrong one near its right value."""
        if self.parameters[k].unit != "m":
            return np.linspace(-np.pi, np.pi, TRIED)
        reach = float(np.ptp(self.setup.position, axis=0).max())
        return np.append(np.linspace(-reach, reach, TRIED) - self.parameters[k].figure, 0.0)

    def _mistyped(self, k: int, explanation: FittedSetup) -> str:
        right, typed = explanation.figure(self.parameters[k]), self.parameters[k].figure
        slip = _slip(typed, right) if self.parameters[k].unit == "m" else ""
        return f"{self._name(k)} is mistyped{slip}; {self._stated(k, right, 'about ')}"

    def markers(self) -> Iterator[Mistake]:
        """Yield markers with a wrong stated position."""
        for name in self.data.robot.markers:
            columns = [k for k in self.setup.stated if self.parameters[k].part == name]
            if columns:
                log_prior = 3 * ANYWHERE + LOG_ODDS
                yield Mistake("marker-elsewhere", 0, _freed(*columns), partial(self._marker, name, columns), log_prior)

    def _marker(self, name: str, columns: list[int], explanation: FittedSetup) -> str:
        right = np.array([explanation.figure(self.parameters[k]) for k in columns])
        return marker_mistyped(name, np.array([self.parameters[k].figure for k in columns]), right)

    def pounds(self) -> Iterator[Mistake]:
        """Yield payloads stated in pounds."""
        for k, p in enumerate(self.parameters):
            if p.effect == PayloadMass.id:
                load = self.data.robot.payloads.get(p.part)
                what = "the masses of all payloads are" if load is None else f"the mass of payload {p.part} is"
                right = f"; expected mass_kg = {load.mass * POUND:.4g}" if load and load.mass else ""
                statement = f"{what} in pounds{right} in the robot file"
                yield Mistake("unit-mistake", 0, _changed({k: POUND - 1}), statement)

    def _name(self, k: int) -> str:
        return f"{self.parameters[k].symbol} of joint {self.parameters[k].joint}"

    def _stated(self, k: int, right: float, about: str = "") -> str:
        """Return in words the right value of a parameter, and the robot file's."""
        p = self.parameters[k]
        factor, unit = (1e3, "mm") if p.unit == "m" else (DEGREE, "deg")
        expected, stated = (f"{round(factor * value, 1) + 0.0:g}" for value in (right, p.figure))
        return f"expected {about}{p.symbol}_{unit} = {expected} for joint {p.joint} in the robot file, found {stated}"


def _changed(changes: dict[int, float]) -> Undo:
    return lambda setup: setup.with_dimensions(changes)


def _freed(*figures: int) -> Undo:
    return lambda setup: setup.freed(*figures)


def _freed_from(figure: int, changes: np.ndarray) -> Undo:
    """Return the function that frees a dimension from that of some changes (n,) with which a rigid motion fits best.

    Far from its right value the base of best fit lies elsewhere, and the fit ends in a minimum of its own.
    """

    def undo(setup: Setup) -> Setup:
        tried = [setup.with_dimensions({figure: float(change)}) for change in changes]
        left = level(motion(np.stack([each.points() for each in tried]), setup.position)[2])
        return tried[int(left.argmin())].freed(figure)

    return undo


def marker_mistyped(name: str, typed: np.ndarray, right: np.ndarray) -> str:
    """Return in words that a marker is not where it is typed, each (3,) [m]."""
    far = np.linalg.norm(right - typed)
    other_axes = np.abs(np.sort(np.abs(right)) - np.sort(np.abs(typed))).max() < max(TYPO, 0.2 * far)
    axes = "on another axis" if other_axes else f"{rounded(1e3 * float(far))} mm off"
    expected = f"expected about point_mm = [{_mm(right)}] in the robot file, found [{_mm(typed)}]"
    return f"marker {name} is mistyped, {axes}; {expected}"


def _mm(point: np.ndarray) -> str:
    return ", ".join(f"{round(1e3 * value, 1) + 0.0:g}" for value in point)


def _slip(typed: float, right: float) -> str:
    """Return in words the typing error that turns the right length [m] into the typed one; empty if none does."""
    slips = {"its sign": -1.0, "a digit too few": 10.0, "a digit too many": 0.1, "inches": INCH, "mm": 1 / INCH}
    for words, factor in slips.items():
        if abs(factor * typed - right) < min(TYPO, abs(right) / 4):
            return f" ({words})"
    digits = f"{abs(round(1e3 * typed, 3)):.10g}"
    for i, j in combinations(range(len(digits)), 2):
        swapped = [*digits]
        swapped[i], swapped[j] = swapped[j], swapped[i]
        value = "".join(swapped)
        if value.count(".") < 2 and abs(np.copysign(float(value) / 1e3, typed) - right) < TYPO / 2:
            return f" (digits exchanged: {value})"
    return ""


def _base(explanation: FittedSetup) -> str:
    turn, origin = explanation.base
    degrees = ", ".join(f"{value:.4g}" for value in np.rad2deg(angles(Rotation.from_matrix(turn))) + 0.0)
    return (
        f"the base is not where the robot file states it; expected about origin_mm = [{_mm(origin)}], rotation_deg = "
        f"[{degrees}] in [base] (a rotation about joint 1's axis may equally be that joint's zero), or known = false, to "
        "estimate it"
    )
