"""Mistakes observable with a fitted robot: payloads and gravity, changes of the set-up between rows, misread rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter, itemgetter

import numpy as np

from calflow.effects import catalogue
from calflow.effects.base import JointError
from calflow.effects.base_off_level import TILT_BOUND
from calflow.effects.session_frame import SessionFrame
from calflow.faults.base import MEASUREMENT_FILE, MISNAMED, ROBOT, SET_UP, Correction, line_in_words, lines_in_words
from calflow.faults.mistake import ARBITRARY, LOG_ODDS, Mistake, exchanged_names, row_mistakes
from calflow.faults.rough import FAR_BETTER, lengths, level, motion, rigid_errors, rigid_sums, split_errors
from calflow.faults.segments import states
from calflow.faults.setup import FittedSetup, Setup
from calflow.files.words import listed, rounded
from calflow.measurements.measurements import Measurements, sessions_of, spaced
from calflow.robot.frames import Vector, vector
from calflow.robot.mechanism import Row

MIN_SHIFT = 5e-3  # m: smaller shifts are causes, as of a bumped device, a joint's zero or a compliant tool
MIN_ROWS, PLACING = 5, 3  # least rows on either side of a change, and fitted ones in each frame
MAX_ROWS = 3000  # largest number of rows tried as a change
ALONE = 3.0  # least error of a row off by itself, over that of as many rows as a change concerns
HALVED = 0.5  # largest share of the squared errors left by a change worth a fit
FITTED = 4  # largest number of mistakes in some rows that are fitted
SAME = 0.05  # share of rows below whose difference two subsets are the same
SMALL = 1e-5  # rad or m: difference step of a joint, and tolerance of its estimated step
ROUNDS = 12  # largest number of updates of a joint's step, part of which each fit absorbs
MULTIPLES = np.arange(0.0, 3.0, 0.01)  # of a load's stated mass
LATEST = 15  # largest shift of payload names, in rows
BY_SESSION = "state by_session = true in [measurements.station]"
LEVEL = TILT_BOUND  # rad: a smaller deviation of gravity is a cause

# A mistake in some rows: its cost, the mistake, the rows (n_rows,), these in words, and its log prior.
Part = tuple[float, Mistake, np.ndarray, str, float]


def causes_of_loads(data: Measurements, as_read: FittedSetup) -> list[Mistake]:
    """Return the load-dependent causes that the robust fit lacks, as rivals of mistakes."""
    robot, there = as_read.setup.model.robot, {effect.id for effect in as_read.setup.model.effects}
    kinds = [kind for kind in catalogue().values() if kind.id not in there and not kind.superseded(robot, data)]
    of_loads = [
        kind
        for kind in kinds
        if not kind.of_measuring() and ("torques" in kind.needs or not issubclass(kind, JointError))
    ]
    effects = [effect for kind in of_loads if not kind.lacking(robot, data) for effect in kind.variants(robot, data)]
    return [
        Mistake(effect.id, 0, partial(Setup.beside, effect=effect), f"no mistake, but {effect.in_words().name}",
                -np.log(len(effects)), where=ROBOT)
        for effect in effects
    ]  # fmt: skip


def loads_late(data: Measurements, as_read: FittedSetup) -> Iterator[Mistake]:
    """Yield the shift of payload names in rows, by the fit without the mistake."""
    payload, by = data.table["payload"].to_numpy(), range(-LATEST, LATEST + 1)
    if (payload == payload[0]).all():
        return
    some, undone = _judged_rows(data, as_read), [partial(_shifted_payloads, data, rows) for rows in by]

    def best(robot: FittedSetup) -> int:
        return int(np.argmin([level(robot.errors_at(undo(some))) for undo in undone]))

    first = best(as_read)
    moved = payload[np.clip(np.arange(len(data)) + by[first], 0, len(data) - 1)] != payload
    if moved.sum() < MIN_ROWS:
        return
    rows = by[best(undone[first](as_read.setup).fitted)]
    moved = payload[np.clip(np.arange(len(data)) + rows, 0, len(data) - 1)] != payload
    which = lines_in_words(data.table["line"].to_numpy()[moved])
    words = f"in {which}: payloads are named {abs(rows)} rows too {'late' if rows > 0 else 'early'}"
    remedy, log_prior = "name the payload of each row", LOG_ODDS - np.log(len(by))
    yield Mistake("payloads-late", 0, undone[rows + LATEST], words, log_prior, where=MEASUREMENT_FILE, remedy=remedy)


def loads_misnamed(data: Measurements, as_read: FittedSetup) -> Iterator[Mistake]:
    """Yield the rows that bear one payload's name and agree with another's, by the fit without the mistake.

    Each is a mistake of its own, as likely in any row: by the other name it must be as much likelier.
    """
    rows, every = np.flatnonzero(data.train | data.held_out), np.arange(len(data))
    first = _first_of_names(data, rows)
    names = data.table["payload"].to_numpy(str)[first]
    if len(names) < 2 or len(rows) > MAX_ROWS:
        return
    some, odds = as_read.setup.at(data, rows), -np.log(len(rows) * (len(names) - 1.0))
    carrying = [_with_payloads(data, np.full(len(data), row), some) for row in first]
    explanation, source = as_read, every
    for _ in range(ROUNDS):
        before, after = explanation.errors_at(some), np.stack([explanation.errors_at(setup) for setup in carrying])
        other, after = first[after.argmin(axis=0)], after.min(axis=0)
        likelier = explanation.surprise(before) - explanation.surprise(after) > -odds
        better, known, source = likelier & (after < before / FAR_BETTER), source, every.copy()
        source[rows[better]] = other[better]
        if (source == known).all():
            break
        explanation = _with_payloads(data, source, as_read.setup).fitted
    misnamed, line = np.flatnonzero(source != every), data.table["line"].to_numpy()
    if not len(misnamed):
        return
    fitting = [
        f"{lines_in_words(line[misnamed][source[misnamed] == row])} fits {f'payload {name}' if name else 'no payload'}"
        for name, row in zip(names, first, strict=True)
        if row in source[misnamed]
    ]
    yield Mistake(
        MISNAMED, 0, partial(_with_payloads, data, source), f"what was measured in {listed(fitting)}, which is not what is written",
        LOG_ODDS + odds * np.isin(as_read.setup.numbers, misnamed).sum(),
        tuple(Correction(int(row) + 1, "payload", source=int(source[row]) + 1) for row in misnamed),
        MEASUREMENT_FILE, "correct the file, too",
    )  # fmt: skip


def loads_unknown(data: Measurements, as_read: FittedSetup, named: bool) -> Iterator[Mistake]:
    """Yield the rows whose load weighs one multiple of what is written, by the fit without the mistake.

    named: whether other payloads' names explain rows, than which a multiple has to be likelier.

    They are sought as states of successive rows, each change as likely at any row: a single one is a `payload-step`, a cause.
    """
    rows, every = np.flatnonzero(data.train | data.held_out), np.arange(len(data))
    if len(rows) > MAX_ROWS:
        return
    some, change = as_read.setup.at(data, rows), float(np.log(len(rows)))
    empty, explanation, there = _weighing(0.0, every, some), as_read, np.zeros(len(rows), dtype=bool)
    for _ in range(ROUNDS):
        points, known = explanation.predicted(some.conditions), there
        lifted = explanation.predicted(empty.conditions) - points
        before = explanation.surprise(lengths(some.position - points))
        # Deflections are linear in the load.
        after = explanation.surprise(lengths(some.position - points - (1 - MULTIPLES[:, None, None]) * lifted))
        gained = (before - after)[:, known] if known.any() else (before - after - change).clip(min=0.0)
        best = int(gained.sum(axis=1).argmax())
        there = states(np.stack([before, after[best]]), change) == 1
        if (there == known).all():
            break
        explanation = _weighing(MULTIPLES[best], rows[there], as_read.setup).fitted
    changes, multiple, theirs = int(np.diff(there).sum()), float(MULTIPLES[best]), there & (after[best] < before)
    if named:
        carrying = (_with_payloads(data, np.full(len(data), row), some) for row in _first_of_names(data, rows))
        before = np.min([explanation.surprise(explanation.errors_at(setup)) for setup in carrying], axis=0)
    if theirs.sum() < MIN_ROWS or changes < 2 or (before - after[best])[theirs].sum() < -LOG_ODDS - ARBITRARY:
        return
    found = rows[theirs]
    which = lines_in_words(data.table["line"].to_numpy()[found])
    yield Mistake(
        "load-unknown", 0, partial(_weighing, multiple, found),
        f"what was measured in {which} fits a load of {multiple:.2g} times the mass that is written",
        LOG_ODDS + ARBITRARY - changes * change, tuple(Correction(int(row) + 1) for row in found), MEASUREMENT_FILE,
        "weigh it, and give these rows a payload of its mass",
    )  # fmt: skip


def _first_of_names(data: Measurements, rows: np.ndarray) -> np.ndarray:
    """Return, of some rows (n,), the first one of each payload's name."""
    return rows[np.unique(data.table["payload"].to_numpy(str)[rows], return_index=True)[1]]


def _judged_rows(data: Measurements, as_read: FittedSetup) -> Setup:
    """Return the set-up at the rows, held out or not, at which a change is sought.

    It is without rows that are off by themselves: a single one would outweigh a change of all others in sums of squares.
    """
    rows = spaced(np.flatnonzero(data.train | data.held_out), MAX_ROWS)
    miss = as_read.errors_at(as_read.setup.at(data, rows))
    return as_read.setup.at(data, rows[~(miss > ALONE * np.sort(miss)[-MIN_ROWS:].min(initial=np.inf))])


def _shifted_payloads(data: Measurements, rows: int, setup: Setup) -> Setup:
    """Return the set-up with payloads shifted by a number of rows."""
    return _with_payloads(data, np.clip(np.arange(len(data)) + rows, 0, len(data) - 1), setup)


def _with_payloads(data: Measurements, of: np.ndarray, setup: Setup) -> Setup:
    """Return the set-up with each row's payload that of another, of (n_rows,)."""
    conditions, loaded = setup.conditions.copy(), Row.spans(data.robot)["payload"]
    conditions[loaded] = data.conditions[loaded, of[setup.numbers]]
    return replace(setup, conditions=conditions)


def _weighing(multiple: float, rows: np.ndarray, setup: Setup) -> Setup:
    """Return the set-up with the masses of some rows' payloads multiplied."""
    conditions, loaded = setup.conditions.copy(), Row.spans(setup.model.robot)["payload"]
    conditions[loaded] *= np.where(np.isin(setup.numbers, rows), multiple, 1.0)
    return replace(setup, conditions=conditions)


def gravity_elsewhere(as_read: FittedSetup) -> Iterator[Mistake]:
    """Yield other directions of gravity: along the measuring frame's z, and those of a ceiling- or wall-mounted robot.

    The first follows from the frame. The others resemble a joint's eccentricity, and are tried only on suspicious errors.
    """
    robot = as_read.setup.model.robot
    size = float(np.linalg.norm(robot.gravity))
    if robot.ground or not (robot.has_masses and size):
        return
    stated = np.array(robot.gravity) / size
    hung = (*np.eye(3), *-np.eye(3)) if as_read.suspicious else ()
    for way in (-as_read.base[0][2], *hung):
        away = float(np.arccos(np.clip(way @ stated, -1, 1)))
        if away > LEVEL:
            pulled = vector(size * way)
            angle = f"{np.rad2deg(away):.3g} deg"
            words = f"gravity is {angle} from its direction in the robot file: the base is mounted otherwise"
            shown = ", ".join(f"{value:.4g}" for value in np.array(pulled) + 0.0)
            remedy = f"expected gravity = [{shown}] (m/s², in the base's axes) in the robot file"
            yield Mistake("gravity-elsewhere", 0, partial(_with_gravity, pulled), words, remedy=remedy)


def _with_gravity(gravity: Vector, setup: Setup) -> Setup:
    return setup.with_robot(replace(setup.model.robot, gravity=gravity))


def setup_changes(data: Measurements, as_read: FittedSetup) -> Iterator[Mistake]:
    """Yield a device or tool that changed at some row, and sessions with separate frames, if the errors indicate it."""
    some = _judged_rows(data, as_read)
    sums = rigid_sums(as_read.predicted(some.conditions), some.position)
    if "session" in data.given:
        yield from _sessions(data, as_read, some, sums)
    yield from _device(data, as_read, some, sums)
    yield from _tool(data, as_read, some)
    yield from _joint(data, as_read, some)
    if as_read.suspicious and len(some.numbers) >= 2 * MIN_ROWS:
        yield from _in_some_rows(data, as_read, some)


def _in_some_rows(data: Measurements, as_read: FittedSetup, some: Setup) -> Iterator[Mistake]:
    """Yield mistakes of the table before or after some row, in a session, or in rows that their correction explains.

    Rows that bear another payload's name are sought one by one: see `loads_misnamed`.
    """
    plain, number, line = rigid_sums(some.points(), some.position), np.arange(len(data)), data.table["line"].to_numpy()
    ends, once = np.arange(MIN_ROWS - 1, len(plain) - MIN_ROWS), LOG_ODDS - np.log(len(plain))
    sessions, before = sessions_of(data), as_read.errors_at(some)
    near: list[Part] = []
    mending: list[Part] = []
    anywhere = [*row_mistakes(data)]
    for mistake in (*anywhere, *exchanged_names(data, "payload")):
        undone = mistake.undo(some)
        other = rigid_sums(undone.points(), undone.position)
        for name in sessions:
            rows = data.session == name
            error = float(rigid_errors(np.where(rows[some.numbers][:, None], other, plain).sum(axis=0)))
            near.append((error, mistake, rows, f"in session {name}, in no other", LOG_ODDS))
        for later, errors in enumerate(split_errors(plain, other, ends)):
            k = int(errors.argmin())
            first = int(some.numbers[ends[k] + 1])
            which = f"from {line_in_words(data, first)} on, not before"
            if not later:
                which = f"up to {line_in_words(data, first - 1)}, not after"
            near.append((float(errors[k]), mistake, (number >= first) == bool(later), which, once))
        better = some.numbers[as_read.better(before, as_read.errors_at(undone))]
        if mistake in anywhere and len(better) >= MIN_ROWS:
            which = f"in {lines_in_words(line[better])}"
            mending.append((-len(better), mistake, np.isin(number, better), which, once))
    whole = float(rigid_errors(plain.sum(axis=0)))
    near = [part for part in sorted(near, key=itemgetter(0))[:FITTED] if part[0] < HALVED * whole]
    mending = [
        part for part in mending if not any(part[1] is m and (part[2] != rows).mean() < SAME for _, m, rows, *_ in near)
    ]
    for _, mistake, rows, which, log_prior in (*near, *sorted(mending, key=itemgetter(0))[:FITTED]):
        yield mistake.within(rows, which, log_prior)


@dataclass(frozen=True)
class ZeroChange:
    """A step of a joint's (from 0) readings from a row on [rad or m], and the squared residuals that it leaves [m²]."""

    joint: int
    first: int
    size: float
    left: float

    def undone(self, later: bool, setup: Setup) -> Setup:
        """Return a set-up without it: the readings from its row on, or those before, are corrected."""
        there = (setup.numbers >= self.first) == later
        return setup.with_reading(
            self.joint, setup.conditions[self.joint] + (self.size if later else -self.size) * there
        )


def _joint(data: Measurements, as_read: FittedSetup, some: Setup) -> Iterator[Mistake]:
    """Yield the joint whose zero changes at some row, by remastering or a lost encoder count."""
    steps = [found for joint in data.robot.driven if (found := _step(as_read, some, some, joint))]
    if not steps:
        return
    step = min(steps, key=attrgetter("left"))
    miss, later = as_read.errors_at(some), some.numbers >= step.first
    off = bool(level(miss[later]) > level(miss[~later]))  # whether the later rows are off
    for _ in range(ROUNDS):
        explanation, before = step.undone(off, as_read.setup).fitted, step
        step = _step(explanation, some, step.undone(off, some), step.joint) or step
        if step.first == before.first and abs(step.size - before.size) < SMALL:
            break
    if np.median(lengths(_joint_residuals(as_read, some, step.joint)[1])) * abs(step.size) < MIN_SHIFT:
        return
    unit, factor = data.robot.joints[step.joint].shown
    words = (
        f"from {line_in_words(data, step.first)} on the readings of joint {step.joint + 1} are "
        f"{abs(factor * step.size):.2g} {unit} too {'small' if step.size > 0 else 'large'} against the rows before: it was "
        "remastered, or its encoder lost count"
    )
    remedy = f"add {factor * step.size:.4g} {unit} to them in the measurement file, or subtract it from the others"
    undo, log_prior = partial(step.undone, off), LOG_ODDS + ARBITRARY - np.log(len(miss))
    yield Mistake("zero-changed", step.joint + 1, undo, words, log_prior, where=SET_UP, remedy=remedy)


def _step(explanation: FittedSetup, some: Setup, undone: Setup, joint: int) -> ZeroChange | None:
    """Return the step of a joint that leaves least, or None where it explains too little.

    undone are the same rows with readings at which the explanation is linearised.
    """
    error, lever = _joint_residuals(explanation, undone, joint)
    error = error + lever * (undone.conditions[joint] - some.conditions[joint])[:, None]
    along, square = (error * lever).sum(axis=1).cumsum(), (lever**2).sum(axis=1).cumsum() + SMALL
    later, later_square = along[-1] - along, square[-1] - square + SMALL
    left = float((error**2).sum()) - along**2 / square - later**2 / later_square
    first = _change(some, left, float(left[-1]))
    if first is None:
        return None
    end = int(np.searchsorted(some.numbers, first)) - 1
    size = float(later[end] / later_square[end] - along[end] / square[end])
    return ZeroChange(joint, first, size, float(left[end]))


def _joint_residuals(explanation: FittedSetup, setup: Setup, joint: int) -> tuple[np.ndarray, np.ndarray]:
    """Return position residuals [m], and their derivatives by a joint [m/rad], each (n_rows, 3)."""
    error = setup.position - explanation.predicted(setup.conditions)
    return np.nan_to_num(error), np.nan_to_num(explanation.moved(setup.conditions, joint, SMALL) / SMALL)


def _device(data: Measurements, as_read: FittedSetup, some: Setup, sums: np.ndarray) -> Iterator[Mistake]:
    """Yield the row from which the device's pose changed, unless a session begins there."""
    before, whole = np.cumsum(sums, axis=0), sums.sum(axis=0)
    first = _change(some, _squares(before) + _squares(whole - before), float(_squares(whole)))
    named = data.session
    if first is not None and named[first] == named[first - 1]:
        later = np.arange(len(data)) >= first
        apart = replace(data, table=data.table.assign(session=np.where(later, "after", "before")))
        names = (
            "name the rows before and after in a column 'session'" if "session" not in data.given else
            f"give the rows of session '{named[first]}' from there on a session's name of their own"
        )  # fmt: skip
        words = f"from {line_in_words(data, first)} on the positions are in another frame ({{far}} off)"
        remedy = f"the measuring device, or the robot, was moved: {names} and {BY_SESSION}"
        yield from _separate_frames("device-moved", apart, as_read, words, remedy, len(sums))


def _sessions(data: Measurements, as_read: FittedSetup, some: Setup, sums: np.ndarray) -> Iterator[Mistake]:
    """Yield sessions with separate frames."""
    names = sessions_of(data)
    of = data.session[some.numbers]
    totals = np.stack([sums[of == name].sum(axis=0) for name in names])
    whole = float(_squares(sums.sum(axis=0)))
    if len(names) > 1 and _explains(float(_squares(totals).sum()), whole) and totals[:, 0].min() >= MIN_ROWS:
        words = f"the sessions {', '.join(names)} are not in one frame (up to {{far}} apart)"
        remedy = f"robot or device was moved: {BY_SESSION}"
        yield from _separate_frames("sessions-apart", data, as_read, words, remedy, 1)


def _separate_frames(
    kind: str, data: Measurements, as_read: FittedSetup, words: str, remedy: str, moments: int
) -> Iterator[Mistake]:
    """Yield the mistake that sessions have separate frames, aligned before the fit."""
    names = sessions_of(data)
    setup = Setup.of(data).beside(SessionFrame(data.robot, names))
    setup = setup.freed(*(k for k, p in enumerate(setup.model.parameters) if p.effect == SessionFrame.id))
    points, position, far = as_read.predicted(as_read.setup.conditions), setup.position.copy(), 0.0
    of = data.session[setup.numbers]
    if min(np.count_nonzero(of == name) for name in names) < PLACING:
        return
    turn, shift, _ = motion(points[of == names[0]], position[of == names[0]])
    for name in names[1:]:
        rows = of == name
        other, moved, _ = motion(points[rows], position[rows])
        position[rows] = (position[rows] - moved) @ other @ turn.T + shift
        far = max(far, float(np.median(np.linalg.norm(position[rows] - setup.position[rows], axis=1))))
    if far > MIN_SHIFT:
        together = replace(setup, position=position)
        statement, log_prior = words.replace("{far}", f"{rounded(1e3 * far)} mm"), LOG_ODDS - np.log(moments)
        yield Mistake(kind, 0, lambda _: together, statement, log_prior, where=SET_UP, remedy=remedy)


def _tool(data: Measurements, as_read: FittedSetup, some: Setup) -> Iterator[Mistake]:
    """Yield the row from which another tool is measured, with other marker positions on the flange."""
    errors = _flange_residuals(as_read, some)
    before, n = np.cumsum(errors, axis=0), np.arange(1, len(errors) + 1.0)
    after, square = before[-1] - before, float((errors**2).sum())
    gained = (before**2).sum(axis=1) / n + (after**2).sum(axis=1) / np.maximum(len(errors) - n, 1)
    first = _change(some, square - gained, square - float((before[-1] ** 2).sum()) / len(errors))
    if first is None:
        return
    later = some.numbers >= first
    by = errors[later].mean(axis=0) - errors[~later].mean(axis=0)
    if np.linalg.norm(by) < MIN_SHIFT:
        return
    line, robot = line_in_words(data, first), data.robot
    named = data.table["marker"].astype(str)
    names = {name: f"{name} from {line}" for name in named[first:].unique()}
    others = {
        names[name]: replace(
            robot.markers[name], point=vector(robot.markers[name].point + by), known=False, relative_sd=None
        )
        for name in names
    }
    table = data.table.assign(marker=named.where(np.arange(len(data)) < first, named.map(names)))
    setup = Setup.of(replace(data, robot=replace(robot, markers=dict(robot.markers) | others), table=table))
    words = (
        f"from {line} on another tool is measured, its point about {rounded(1e3 * float(np.linalg.norm(by)), 2)} mm from "
        "the one before on the flange; give these rows a marker of their own in robot file and table"
    )
    yield Mistake("tool-changed", 0, lambda _: setup, words, LOG_ODDS - np.log(len(errors)), where=SET_UP)


def _flange_residuals(explanation: FittedSetup, setup: Setup) -> np.ndarray:
    """Return position residuals in the flange's frame, shape (n_rows, 3) [m]."""
    model = explanation.model
    error = (setup.position - explanation.predicted(setup.conditions)) @ explanation.turn
    markers = [k for k, p in enumerate(model.parameters) if p.part in model.robot.markers]
    moved = model.position_jacobian(explanation.estimate, setup.conditions)[:, :, markers]
    flange = moved.reshape(len(moved), 3, -1, 3).sum(axis=2)
    return np.nan_to_num(np.einsum("nij,ni->nj", flange, error))


def _squares(sums: np.ndarray) -> np.ndarray:
    """Return the squared residuals (…) [m²] of the best rigid motion, from sums (…, 17); infinite if undetermined."""
    errors = rigid_errors(sums)
    return np.where(np.isfinite(errors), sums[..., 0] * np.where(np.isfinite(errors), errors, 0.0), np.inf)


def _change(some: Setup, left: np.ndarray, whole: float) -> int | None:
    """Return the first row after the change with the least squared residuals (n_rows,); None if it explains too little."""
    inside = left[MIN_ROWS - 1 : -MIN_ROWS]
    if not len(inside) or not _explains(float(inside.min()), whole):
        return None
    return int(some.numbers[int(inside.argmin()) + MIN_ROWS])


def _explains(left: float, whole: float) -> bool:
    """Return whether a change reduces the squared residuals [m²] enough to be worth a fit."""
    return left < HALVED * whole and whole - left > MIN_ROWS * (MIN_SHIFT / 2) ** 2
