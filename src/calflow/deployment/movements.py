"""Movements: what may be elsewhere, or otherwise, than when a robot was calibrated, and the test of each by check poses.

What the check poses miss the calibrated robot by is normal with the device's noise and what the calibration itself did not know:
the parameters, and the smooth errors that the model leaves. Every movement is tested against that; the smallest p-value of all is
compared with those of draws where nothing moved, so that false alarms are as rare as asked for; where that is rarer than draws
can tell, with the number of tests times itself (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca
import numpy as np
import scipy

from calflow.deployment.attained import Alignment, can_align, rigid_slope
from calflow.effects.base import unmet
from calflow.effects.geometry import Geometry
from calflow.effects.misstated_payload import PayloadMass
from calflow.effects.thermal_growth import ThermalGrowth
from calflow.effects.warming import REFERENCE
from calflow.estimation.calibrated_model import CalibratedModel, shared_errors
from calflow.estimation.noise import conditions
from calflow.files.deferred import pd
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements
from calflow.robot.parts import Parameter

Kind = Literal["zero", "station", "tool", "dimension", "cause", "condition"]
ZERO_SD = 1e-3  # rad or m: what a joint's zero is off by after a collision, or a new motor
PLACED_SD = 1e-3  # m and rad: what station, base or tool have moved by
EASILY, HARDLY = 1.0, 0.1  # relative odds: zeros, tools and stations move, while lengths of castings do not
CHANGED = 0.3  # of a cause's usual size, by which it changes as a robot ages
EXPANSION_SD = 1e-4  # share by which links grow with temperature: some 8 K of steel
WARMER = 1.0  # K: growth is linear in it
MOST_OF_ONE_PART = 6  # parameters of one part, beyond which it is no single movement
SAME_MOVEMENT = 0.9999  # cosine from which two movements do the same
UNRESTRICTED = 1e4  # times its usual size: what a movement may be of which nothing is to be told
ANYWHERE = 1.0  # m and rad, about where it was fitted: of a frame that nobody knows
GAP = 3600.0  # s without a measurement, after which a new session begins
FALSE_ALARM = 0.01
NULL_DRAWS = 4000  # of check poses where nothing moved
MOST_MOVED = 3  # things that are told to have moved at once
FOUND = 0.95  # share of movements that a detection limit is found of
WITHIN = 5.0  # in logarithms of evidence: what is nearer to the best is not told from it


@dataclass(frozen=True)
class Movement:
    """One thing that may have moved: its name, what it is in words, and the derivatives of points by it (n, 3, k) [m per unit].

    sd (k,) is what it usually moves by, odds how easily beside others; joint is its number, 0 for none, parameter the name of the
    model's parameter that it changes, empty where it is none.
    """

    name: str
    kind: Kind
    meaning: str
    joint: int
    units: tuple[str, ...]
    symbols: tuple[str, ...]
    slope: np.ndarray
    sd: np.ndarray
    odds: float = EASILY
    parameter: str = ""

    @property
    def is_known(self) -> bool:
        """Whether it is a condition under which the robot works, and no drift of the robot."""
        return self.kind == "condition"


def movements(calibrated: CalibratedModel, data: Measurements, station: bool) -> tuple[Movement, ...]:
    """Return what may have moved, with what it does to the rows' points.

    Args:
        calibrated: the calibrated model, for the conditions that it is told of a row.
        data: the rows.
        station: whether the device's place, or the base's, is among them; not where it was fitted.
    """
    conditions = data.stating(calibrated.model.given).on(calibrated.model.robot).conditions
    movements = [*_zeros(calibrated, conditions), *_tool(calibrated, data, conditions)]
    if station:
        movements.append(_station(calibrated.model.point(calibrated.estimate, conditions)))
    movements += [
        movement
        for movement in _parameters(calibrated, conditions)
        if not any(_same(movement, other) for other in movements)
    ]
    return (*movements, *_conditions(calibrated, data))


def _zeros(calibrated: CalibratedModel, conditions: np.ndarray) -> Iterator[Movement]:
    """The zero of each joint's reading, which couplings and loops carry on to where they lead."""
    model, n = calibrated.model, calibrated.model.robot.n_joints
    (slope,) = model.figures("zeros", lambda p, c, at: [ca.jacobian(at.point, c[:n])], calibrated.estimate, conditions)
    for i in model.robot.driven:
        unit = model.robot.joints[i].unit
        yield Movement(f"joint{i + 1}.zero", "zero", f"zero of joint {i + 1}", i + 1, (unit,), ("zero",), slope[:, :, i : i + 1],
                       np.array([ZERO_SD]))  # fmt: skip


def _tool(calibrated: CalibratedModel, data: Measurements, conditions: np.ndarray) -> Iterator[Movement]:
    """The place of all markers on the tool, in the flange's axes, and of each alone where there are several."""
    model = calibrated.model
    (turn,) = model.figures("flange", lambda p, c, at: [at.rotation @ at.tool.T], calibrated.estimate, conditions)
    names = list(dict.fromkeys(data.table["marker"]))
    sd, units = np.full(3, PLACED_SD), ("m",) * 3
    tool = Movement("tool", "tool", "tool on its flange", 0, units, ("x", "y", "z"), turn, sd)
    yield tool
    for name in names if len(names) > 1 else []:
        rows = (data.table["marker"] == name).to_numpy()[:, None, None]
        yield replace(tool, name=f"marker {name}", meaning=f"marker {name} on the tool", slope=turn * rows)


def _station(points: np.ndarray) -> Movement:
    """The device, or the robot's foot: a shift of all points, and a turn about their middle."""
    symbols = ("x", "y", "z", "rx", "ry", "rz")
    words = "station of the device, or the robot's foot"
    return Movement(
        "station", "station", words, 0, ("m",) * 3 + ("rad",) * 3, symbols, rigid_slope(points), np.full(6, PLACED_SD)
    )


def _parameters(calibrated: CalibratedModel, rows: np.ndarray) -> Iterator[Movement]:
    """Every dimension of a link, and every cause that the model has; where robot and tool stand is told otherwise."""
    model = calibrated.model
    slope = model.point_jacobian(calibrated.estimate, rows)
    for effect in model.effects:
        columns = [int(k) for k in model.columns(effect) if not effect.of_device()]
        if isinstance(effect, Geometry):
            pairs = zip(effect.declared, effect.errors, strict=True)
            of_links = {declared.identity for declared, error in pairs if error.field in ("steps", "bars")}
            columns_of_link = [k for k in columns if model.parameters[k].identity in of_links]
            yield from (_of([model.parameters[k]], slope[:, :, [k]], "dimension", HARDLY) for k in columns_of_link)
            continue
        parts: dict[str, list[int]] = {}
        for k in columns:
            parts.setdefault(model.parameters[k].part, []).append(k)
        for columns_of_link in parts.values():
            if len(columns_of_link) <= MOST_OF_ONE_PART:
                yield _of([model.parameters[k] for k in columns_of_link], slope[:, :, columns_of_link], "cause", EASILY)


def _of(parameters: list[Parameter], slope: np.ndarray, kind: Kind, odds: float) -> Movement:
    first = parameters[0]
    single = len(parameters) == 1
    name = first.name if single else ".".join(filter(None, (first.part, first.tag)))
    sd = np.array([parameter.prior_sd for parameter in parameters]) * (1.0 if kind == "dimension" else CHANGED)
    units, symbols = (tuple(getattr(parameter, name) for parameter in parameters) for name in ("unit", "symbol"))
    return Movement(
        name, kind, first.meaning, first.joint, units, symbols, slope, sd, odds, first.name if single else ""
    )


def _conditions(calibrated: CalibratedModel, data: Measurements) -> Iterator[Movement]:
    """What is no drift: warmth of all links, and a payload that is not as heavy as stated; not where that is held."""
    model, robot = calibrated.model, calibrated.model.robot
    plain = data.on(robot).stating(model.given)
    rows = replace(plain, table=plain.table.assign(temperature=REFERENCE + WARMER))
    probes = [kind(robot) for kind in (ThermalGrowth, PayloadMass) if not unmet(kind.needs, robot, rows.given)]
    probing, n = replace(model, given=rows.given, probes=tuple(probes)), len(calibrated.estimate)
    at = {parameter.identity: k for k, parameter in enumerate(probing.parameters[n:])}
    start = np.concatenate([calibrated.estimate, probing.nominal[n:]])
    (slope,) = probing.figures("probed", lambda p, c, at: [ca.jacobian(at.point, p[n:])], start, rows.conditions)
    places = [at.get(probe.declared[0].identity) for probe in probes]
    for probe, k in zip(probes, places, strict=True):
        if k is None:
            continue
        if isinstance(probe, ThermalGrowth):
            yield Movement("temperature", "condition", "temperature of all links", 0, ("1",), ("growth",),
                           slope[:, :, [k]] / WARMER, np.array([EXPANSION_SD]))  # fmt: skip
        elif np.abs(slope[:, :, k]).max() > 0:
            yield Movement("payload", "condition", "mass of the payload", 0, ("1",), ("error",), slope[:, :, [k]],
                           np.array([CHANGED]))  # fmt: skip


def _same(first: Movement, other: Movement) -> bool:
    """Whether two movements by a single number do the same to all points."""
    if first.slope.shape[2] != 1 or other.slope.shape[2] != 1:
        return False
    a, b = first.slope.ravel(), other.slope.ravel()
    return bool(abs(a @ b) >= SAME_MOVEMENT * np.linalg.norm(a) * np.linalg.norm(b))


@dataclass(frozen=True)
class CheckProblem:
    """Check poses (data) of a calibrated robot as a linear problem: error (n,) [m] of their coordinates, its covariance (n, n), and
    each one's session (n,).

    points are the coordinates' points (n / 3, 3) [m], table their labels, names those of the sessions in order, share (n / 3, m)
    what each of the m rows counts in its point, own (n / 3,) the part of the variance that a point has for itself [m²].
    """

    calibrated: CalibratedModel
    data: Measurements
    error: np.ndarray
    covariance: np.ndarray
    session: np.ndarray
    points: np.ndarray
    table: pd.DataFrame
    names: tuple[str, ...]
    share: np.ndarray
    own: np.ndarray

    @staticmethod
    def of(calibrated: CalibratedModel, data: Measurements, fitted: np.ndarray) -> CheckProblem:
        """Set it up from rows; fitted (n_rows,) says of which the device's frame, one a session, is to be fitted to them.

        Repeats of a session are brought together. The covariance is that of the parameters, the choice among models and the smooth
        errors, of what each pose errs by for itself, of the device's noise, and of conditions that the rows lack.

        Raises:
            InputError: a frame cannot be fitted.
        """
        model = calibrated.model
        rows = data.stating(model.given).on(model.robot).conditions
        date, names = _sessions(data.table)
        group = np.unique(date * len(data) + conditions(data), return_inverse=True)[1]
        first = np.unique(group, return_index=True)[1]
        share = (group == np.arange(len(first))[:, None]) / np.bincount(group)[:, None]
        table = data.table.iloc[first].reset_index(drop=True)
        session = date[first]
        points, seen = share @ model.point(calibrated.estimate, rows), share @ data.position
        together = np.einsum("nm,mai->nai", share, shared_errors(calibrated, rows)).reshape(3 * len(first), -1)
        noise = calibrated.noise(data).sigma if calibrated.noise_known else np.zeros(len(data))
        variance = (share**2) @ noise**2 + calibrated.errors.rest**2
        variance += sum((need.spread_mm / 1e3) ** 2 for need in calibrated.needed if need.condition not in data.given)
        covariance = together @ together.T + np.diag(np.repeat(variance, 3))
        if fitted.any():
            for k in np.unique(session[fitted[first]]):
                there = session == k
                if not can_align(seen[there]):
                    raise refuse(
                        "the device's frame cannot be fitted to so few check poses, or they lie on one line: expected at "
                        "least 4 a session, or say that the station stands where it stood (--station known)"
                    )
                seen[there] = Alignment.best(seen[there], points[there], np.ones(there.sum())).of(seen[there])
                frame = rigid_slope(points).reshape(len(covariance), 6) * np.repeat(there, 3)[:, None] * ANYWHERE
                covariance += frame @ frame.T
        error, of_session = (seen - points).ravel(), np.repeat(session, 3)
        return CheckProblem(calibrated, data, error, covariance, of_session, points, table, names, share, variance)

    @property
    def sessions(self) -> int:
        """How many there are."""
        return len(self.names)

    def without(self, movement: Movement, since: int) -> CheckProblem:
        """Return the check with a movement of unknown size in its covariance: what it does tells nothing more."""
        effect = self.columns(movement, since) * (UNRESTRICTED * movement.sd)
        return replace(self, covariance=self.covariance + effect @ effect.T)

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


@dataclass(frozen=True)
class Explained:
    """A movement since a session (counted from 0): its size (k,) with covariance, p-value, and logarithm of its evidence.

    limit (k,) is the size that would be found in FOUND of cases, of each number alone.
    """

    movement: Movement
    since: int
    size: np.ndarray
    covariance: np.ndarray
    p: float
    evidence: float
    limit: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of the size (k,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True)
class SearchRound:
    """One round of the search: every movement explained, best first, and the chance of so small a p-value where nothing moved."""

    explained: tuple[Explained, ...]
    family_p: float

    @property
    def best(self) -> Explained:
        """The movement that explains most."""
        return self.explained[0]

    @property
    def probabilities(self) -> np.ndarray:
        """The probability of each, one of them being true, shape (n,)."""
        evidence = np.array([explained.evidence for explained in self.explained])
        share = np.exp(evidence - evidence.max())
        return np.asarray(share / share.sum())

    @property
    def names(self) -> dict[str, float]:
        """The probability of each movement by name, since whenever, the largest first."""
        by_name: dict[str, float] = {}
        for explained, probability in zip(self.explained, self.probabilities, strict=True):
            by_name[explained.movement.name] = by_name.get(explained.movement.name, 0.0) + float(probability)
        return dict(sorted(by_name.items(), key=lambda item: -item[1]))


def searched(
    check: CheckProblem, every: Sequence[Movement], alarm: float, rng: np.random.Generator
) -> tuple[SearchRound, ...]:
    """Return the rounds of the search: the last found nothing, or is the one after which no more is told."""
    rounds: list[SearchRound] = []
    for _ in range(MOST_MOVED):
        step = search_round(check, every, alarm, rng)
        rounds.append(step)
        if step.family_p >= alarm:
            break
        check = check.without(step.best.movement, step.best.since)
        every = [movement for movement in every if movement.name != step.best.movement.name]
    return tuple(rounds)


def search_round(check: CheckProblem, every: Sequence[Movement], alarm: float, rng: np.random.Generator) -> SearchRound:
    """Test every movement since every session against all at once.

    A movement explains q of the error's whitened square Q with k numbers; q is divided by what is left per degree of freedom
    where that is more than 1, so that a device that scatters more than stated raises no alarm.
    """
    factor = np.linalg.inv(np.linalg.cholesky(check.covariance))
    whitened, n = factor @ check.error, len(check.error)
    tested, bases = [], []
    for movement in every:
        for since in range(check.sessions):
            slope = factor @ check.columns(movement, since)
            basis = _basis(slope)
            if 0 < basis.shape[1] < n - 1:
                bases.append(basis)
                p = float(scipy.stats.chi2.sf(_taken(whitened[:, None], basis)[0], basis.shape[1]))
                tested.append((movement, since, slope, p))
    if not tested:
        return SearchRound((), 1.0)
    least = _least_p(rng.standard_normal((n, NULL_DRAWS)), bases)
    threshold = max(float(np.quantile(least, alarm)), alarm / len(tested))
    results = sorted(
        (_explained(whitened, *movement, threshold) for movement in tested), key=lambda result: -result.evidence
    )
    smallest = min(result.p for result in results)
    counted = (1 + (least <= smallest).sum()) / (1 + NULL_DRAWS)
    return SearchRound(tuple(results), float(min(counted, len(tested) * smallest)))


def joint_sizes(check: CheckProblem, steps: Sequence[SearchRound]) -> tuple[Explained, ...]:
    """Return the best movement of each round, the sizes of all of them estimated together."""
    if not steps:
        return ()
    best = [step.best for step in steps]
    sd = np.concatenate([explained.movement.sd for explained in best])
    factor = np.linalg.cholesky(check.covariance)
    columns = np.hstack([check.columns(explained.movement, explained.since) for explained in best]) * sd
    scaled, whitened = np.linalg.solve(factor, columns), np.linalg.solve(factor, check.error)
    inverse = np.linalg.inv(scaled.T @ scaled + np.eye(len(sd)))
    size, covariance = sd * (inverse @ scaled.T @ whitened), np.outer(sd, sd) * inverse
    ends = np.cumsum([len(explained.size) for explained in best])
    spans = [slice(end - len(explained.size), end) for explained, end in zip(best, ends, strict=True)]
    return tuple(
        replace(explained, size=size[span], covariance=covariance[span, span])
        for explained, span in zip(best, spans, strict=True)
    )


def remaining_error_p(check: CheckProblem, step: Sequence[SearchRound]) -> float:
    """Return the chance of so much error where nothing moved but what was found (chi² test of all coordinates)."""
    taken = 0
    for explained in step:
        check = check.without(explained.best.movement, explained.best.since)
        taken += len(explained.best.size)
    return float(scipy.stats.chi2.sf(check.square, max(1, len(check.error) - taken)))


def _basis(slope: np.ndarray) -> np.ndarray:
    """Orthonormal directions (n, rank) that a movement's columns span."""
    scale = np.linalg.norm(slope, axis=0)
    if not (scale > 0).any():
        return np.zeros((len(slope), 0))
    left, values, _ = np.linalg.svd(slope[:, scale > 0] / scale[scale > 0], full_matrices=False)
    return np.asarray(left[:, values > 1e-6 * values[0]])


def _taken(whitened: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """What of whitened errors (n, m) lies along a basis (n, k), over what is left a degree of freedom where that is more than 1."""
    k, n = basis.shape[1], len(whitened)
    taken = ((basis.T @ whitened) ** 2).sum(axis=0)
    left = ((whitened**2).sum(axis=0) - taken) / (n - k)
    return np.asarray(taken / np.maximum(1.0, left))


def _least_p(drawn: np.ndarray, bases: Sequence[np.ndarray]) -> np.ndarray:
    """The smallest p-value of all bases for each draw (n, m), shape (m,): of bases of one rank it is that of the largest share."""
    most: dict[int, np.ndarray] = {}
    for basis in bases:
        k = basis.shape[1]
        most[k] = np.maximum(most.get(k, 0.0), _taken(drawn, basis))
    return np.min([scipy.stats.chi2.sf(taken, k) for k, taken in most.items()], axis=0)


def _explained(
    whitened: np.ndarray, movement: Movement, since: int, slope: np.ndarray, p: float, threshold: float
) -> Explained:
    """A movement's size by generalised least squares with its usual size as prior, and its evidence beside none."""
    scaled = slope * movement.sd
    information = scaled.T @ scaled + np.eye(scaled.shape[1])
    moment = scaled.T @ whitened
    inverse = np.linalg.inv(information)
    size = movement.sd * (inverse @ moment)
    evidence = 0.5 * float(moment @ inverse @ moment) - 0.5 * float(np.linalg.slogdet(information)[1])
    seen = scipy.stats.norm.isf(threshold / 2) + scipy.stats.norm.ppf(FOUND)
    strength = np.linalg.norm(slope, axis=0)
    limit = np.divide(seen, strength, out=np.full(len(strength), np.inf), where=strength > 0)
    covariance = np.outer(movement.sd, movement.sd) * inverse
    return Explained(movement, since, size, covariance, p, evidence + float(np.log(movement.odds)), limit)
