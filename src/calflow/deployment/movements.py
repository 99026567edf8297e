"""Movements: candidate changes of a robot since its calibration, and the statistical test of each by check poses.

The errors of check poses are normal with the device's noise and the calibration's own uncertainty: that of the
parameters, and the smooth errors that the model leaves. Each movement is tested against that; the smallest p-value is
calibrated by simulated checks where nothing moved, so that false alarms have the rate asked for. For rates too small to
simulate it is multiplied by the number of tests (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca
import numpy as np
import scipy

from calflow.deployment.attained import CALIBRATED, Attained, Station, rigid_slope
from calflow.effects.base import unmet
from calflow.effects.geometry import Geometry
from calflow.effects.misstated_payload import PayloadMass
from calflow.effects.thermal_growth import ThermalGrowth
from calflow.effects.warming import REFERENCE
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.noise import group_means
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements
from calflow.model import consecutive
from calflow.robot.parts import Parameter

Kind = Literal["zero", "station", "tool", "dimension", "cause", "condition"]
ZERO_SD = 1e-3  # rad or m: prior standard deviation of a joint's zero after a collision or a change of motor
PLACED_SD = 1e-3  # m and rad: of the displacement of station, base or tool
EASILY, HARDLY = 1.0, 0.1  # prior odds: zeros, tools and stations move, lengths of castings hardly do
CHANGED = 0.3  # change of a cause as a robot ages, as a share of its prior standard deviation
EXPANSION_SD = 1e-4  # thermal strain of links: some 8 K of steel
WARMER = 1.0  # K: temperature step of the derivative; growth is linear in it
MOST_OF_ONE_PART = 6  # parameters of one part, above which they are not tested as a single movement
SAME_MOVEMENT = 0.9999  # cosine above which two movements are indistinguishable
UNRESTRICTED = 1e4  # prior standard deviations that leave a movement unconstrained
ANYWHERE = 1.0  # m and rad: standard deviation of an unknown frame about its fit
GAP = 3600.0  # s without a measurement, after which a new session begins
FALSE_ALARM = 0.01
NULL_DRAWS = 4000  # simulated checks where nothing moved
MOST_MOVED = 3  # movements at once
FOUND = 0.95  # detection probability of the detection limit
WITHIN = 5.0  # difference in log evidence from the best below which movements are not distinguished


@dataclass(frozen=True)
class Movement:
    """A candidate movement: name, meaning in words, and the Jacobian slope (n, 3, k) [m per unit] of points.

    sd (k,): prior standard deviations; odds: prior odds relative to others; joint: its number, 0 for none; parameter:
    name of the model's parameter that it changes, empty for none.
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
        """Whether it is a working condition rather than a drift of the robot."""
        return self.kind == "condition"


def movements(calibrated: CalibratedModel, data: Measurements, station: bool) -> tuple[Movement, ...]:
    """Return the candidate movements with their Jacobians at the rows.

    Args:
        calibrated: the calibrated model, restricted to the conditions that rows state.
        data: the rows.
        station: whether the pose of the device or base is a candidate; not where it was fitted.
    """
    conditions = calibrated.conditions_of(data)
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
    """Yield the zero of each joint's reading, with its effect through couplings and loops."""
    model, n = calibrated.model, calibrated.model.robot.n_joints
    (slope,) = model.figures("zeros", lambda p, c, at: [ca.jacobian(at.point, c[:n])], calibrated.estimate, conditions)
    for i in model.robot.driven:
        unit = model.robot.joints[i].unit
        yield Movement(f"joint{i + 1}.zero", "zero", f"zero of joint {i + 1}", i + 1, (unit,), ("zero",), slope[:, :, i : i + 1],
                       np.array([ZERO_SD]))  # fmt: skip


def _tool(calibrated: CalibratedModel, data: Measurements, conditions: np.ndarray) -> Iterator[Movement]:
    """Yield a displacement of all markers in the flange's axes, and of each marker where there are several."""
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
    """Return a displacement of the device or base: a translation of all points, and a rotation about their mean."""
    symbols = ("x", "y", "z", "rx", "ry", "rz")
    words = "station of the device, or the robot's foot"
    return Movement(
        "station", "station", words, 0, ("m",) * 3 + ("rad",) * 3, symbols, rigid_slope(points), np.full(6, PLACED_SD)
    )


def _parameters(calibrated: CalibratedModel, rows: np.ndarray) -> Iterator[Movement]:
    """Yield every link dimension and every cause of the model; placement of robot and tool is among other movements."""
    model = calibrated.model
    slope = model.point_jacobian(calibrated.estimate, rows)
    for effect in model.effects:
        columns = [int(k) for k in model.columns(effect) if not effect.of_measuring()]
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
    """Yield conditions that are not drift: temperature of all links and payload mass, unless the model fixes them."""
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
    """Whether two movements of one parameter each have proportional Jacobians."""
    if first.slope.shape[2] != 1 or other.slope.shape[2] != 1:
        return False
    a, b = first.slope.ravel(), other.slope.ravel()
    return bool(abs(a @ b) >= SAME_MOVEMENT * np.linalg.norm(a) * np.linalg.norm(b))


@dataclass(frozen=True)
class CheckProblem:
    """Check poses of a calibrated robot as a linear problem in n coordinates.

    attained: its n / 3 points; error (n,) [m], its covariance (n, n) [m²]; own (n / 3,) [m²]: variance per axis of a point
    that is independent of other points.
    """

    calibrated: CalibratedModel
    data: Measurements
    attained: Attained
    error: np.ndarray
    covariance: np.ndarray
    own: np.ndarray

    @staticmethod
    def of(calibrated: CalibratedModel, data: Measurements, station: Station) -> CheckProblem:
        """Return the problem of measured rows, whose sessions are in order of time; station: as of `validate`.

        Repeats within a session are averaged. The covariance includes parameters, model choice and smooth errors,
        independent errors of poses, the device's noise, and the effects of conditions that the rows lack.

        Raises:
            InputError: a frame cannot be fitted.
        """
        attained = Attained.of(calibrated, data, station)
        points, seen = attained.expected[CALIBRATED], attained.measured.copy()
        shared = attained.shared.reshape(seen.size, -1)
        own = attained.noise**2 + calibrated.errors.rest[METRE] ** 2
        own += sum((need.spread_mm / 1e3) ** 2 for need in calibrated.needed if need.condition not in data.given)
        covariance = shared @ shared.T + np.diag(np.repeat(own, 3))
        for there, motion in attained.refitted:
            seen[there] = motion.of(seen[there])
            frame = rigid_slope(points).reshape(seen.size, 6) * np.repeat(there, 3)[:, None] * ANYWHERE
            covariance += frame @ frame.T
        return CheckProblem(calibrated, data, attained, (seen - points).ravel(), covariance, own)

    @property
    def points(self) -> np.ndarray:
        """Positions of the points by the calibrated robot, shape (n / 3, 3) [m]."""
        return self.attained.expected[CALIBRATED]

    def beside(self, rounds: Sequence[SearchRound]) -> CheckProblem:
        """Return the check with the movements found, of unconstrained size, marginalised through its covariance."""
        covariance = self.covariance
        for found in (step.best for step in rounds):
            effect = self.columns(found.movement, found.since) * (UNRESTRICTED * found.movement.sd)
            covariance = covariance + effect @ effect.T
        return replace(self, covariance=covariance)

    def columns(self, movement: Movement, since: int) -> np.ndarray:
        """Return the Jacobian of a movement since a session (counted from 0), shape (n, k) [m per unit]."""
        slope = self.means(movement.slope) * (self.attained.frame >= since)[:, None, None]
        return np.asarray(slope.reshape(len(self.error), -1))

    def means(self, values: np.ndarray) -> np.ndarray:
        """Return the means (n / 3, …) of values (n_rows, …) over the rows of each point."""
        return group_means(values, self.attained.group)

    @property
    def square(self) -> float:
        """Squared norm of the whitened error: chi-squared with n degrees of freedom where nothing moved."""
        whitened = np.linalg.solve(np.linalg.cholesky(self.covariance), self.error)
        return float(whitened @ whitened)

    def size(self) -> np.ndarray:
        """Return the length of each point's error, shape (n / 3,) [m]."""
        return np.linalg.norm(self.error.reshape(-1, 3), axis=1)

    def searched(self, every: Sequence[Movement], alarm: float, rng: np.random.Generator) -> tuple[SearchRound, ...]:
        """Return the rounds of a forward search; the last is not significant, or reaches MOST_MOVED."""
        check, rounds = self, list[SearchRound]()
        for _ in range(MOST_MOVED):
            step = check._search_round(every, alarm, rng)
            rounds.append(step)
            if step.family_p >= alarm:
                break
            check = check.beside([step])
            every = [movement for movement in every if movement.name != step.best.movement.name]
        return tuple(rounds)

    def _search_round(self, every: Sequence[Movement], alarm: float, rng: np.random.Generator) -> SearchRound:
        """Test every movement since every session.

        The statistic is the part q of the error's whitened square that a movement of k parameters explains; it is divided
        by the remaining square per degree of freedom where that exceeds 1, so that a noisier device raises no alarm.
        """
        factor = np.linalg.inv(np.linalg.cholesky(self.covariance))
        whitened, n = factor @ self.error, len(self.error)
        tested, bases = [], []
        for movement in every:
            for since in range(len(self.attained.sessions)):
                slope = factor @ self.columns(movement, since)
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

    def joint_sizes(self, steps: Sequence[SearchRound]) -> tuple[Explained, ...]:
        """Return the best movement of each round, with sizes estimated jointly."""
        if not steps:
            return ()
        best = [step.best for step in steps]
        sd = np.concatenate([explained.movement.sd for explained in best])
        factor = np.linalg.cholesky(self.covariance)
        columns = np.hstack([self.columns(explained.movement, explained.since) for explained in best]) * sd
        mean, inverse = _posterior(np.linalg.solve(factor, columns), np.linalg.solve(factor, self.error))
        size, covariance = sd * mean, np.outer(sd, sd) * inverse
        own = consecutive(len(explained.size) for explained in best)
        return tuple(
            replace(explained, size=size[span], covariance=covariance[span, span])
            for explained, span in zip(best, own, strict=True)
        )

    def remaining_error_p(self, rounds: Sequence[SearchRound]) -> float:
        """Return the p-value of the error that remains beside the movements found (chi-squared test of all coordinates)."""
        taken = sum(len(step.best.size) for step in rounds)
        return float(scipy.stats.chi2.sf(self.beside(rounds).square, max(1, len(self.error) - taken)))


def by_sessions(data: Measurements) -> Measurements:
    """Return rows by session in order of time, or of rows; where none is named, hour-long gaps separate them."""
    table = data.table.sort_values("time", kind="stable") if "time" in data.table else data.table
    if "session" in table:
        order = table.groupby(table["session"].astype(str), sort=False).ngroup()
    elif "time" in table:
        order = (table["time"].diff() > GAP).astype(int).cumsum()
        if order.any():
            begun = table.groupby(order)["time"].transform("first")
            table = table.assign(session=[f"{time / 3600:.1f} h" for time in begun])
    else:
        return data
    rows = order.loc[data.table.index].sort_values(kind="stable").index
    return replace(data, table=table.loc[rows].reset_index(drop=True))


@dataclass(frozen=True)
class Explained:
    """A movement since a session (counted from 0): estimated size (k,) and covariance, p-value, and log evidence.

    limit (k,) is the detection limit of each component alone, with detection probability FOUND.
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
        """Standard deviations of the estimated size (k,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True)
class SearchRound:
    """One round of the search: the movements tested, best first, and the family-wise p-value."""

    explained: tuple[Explained, ...]
    family_p: float

    @property
    def best(self) -> Explained:
        """The movement with the largest evidence."""
        return self.explained[0]

    @property
    def probabilities(self) -> np.ndarray:
        """Posterior probability of each, given that one of them is true, shape (n,)."""
        return np.asarray(scipy.special.softmax([explained.evidence for explained in self.explained]))

    @property
    def names(self) -> dict[str, float]:
        """Posterior probability of each movement by name, summed over sessions, the largest first."""
        by_name: dict[str, float] = {}
        for explained, probability in zip(self.explained, self.probabilities, strict=True):
            by_name[explained.movement.name] = by_name.get(explained.movement.name, 0.0) + float(probability)
        return dict(sorted(by_name.items(), key=lambda item: -item[1]))


def _basis(slope: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (n, rank) of the column space of a movement."""
    scale = np.linalg.norm(slope, axis=0)
    if not (scale > 0).any():
        return np.zeros((len(slope), 0))
    left, values, _ = np.linalg.svd(slope[:, scale > 0] / scale[scale > 0], full_matrices=False)
    return np.asarray(left[:, values > 1e-6 * values[0]])


def _taken(whitened: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Return squares of errors (n, m) in a basis (n, k), over the rest per degree of freedom if that exceeds 1."""
    k, n = basis.shape[1], len(whitened)
    taken = ((basis.T @ whitened) ** 2).sum(axis=0)
    left = ((whitened**2).sum(axis=0) - taken) / (n - k)
    return np.asarray(taken / np.maximum(1.0, left))


def _least_p(drawn: np.ndarray, bases: Sequence[np.ndarray]) -> np.ndarray:
    """Return the smallest p-value over bases of draws (n, m), shape (m,), by the largest statistic of each rank."""
    most: dict[int, np.ndarray] = {}
    for basis in bases:
        k = basis.shape[1]
        most[k] = np.maximum(most.get(k, 0.0), _taken(drawn, basis))
    return np.min([scipy.stats.chi2.sf(taken, k) for k, taken in most.items()], axis=0)


def _explained(
    whitened: np.ndarray, movement: Movement, since: int, slope: np.ndarray, p: float, threshold: float
) -> Explained:
    """Return a movement's size by generalised least squares with its prior, and its log evidence relative to none."""
    scaled = slope * movement.sd
    mean, inverse = _posterior(scaled, whitened)
    evidence = 0.5 * float(whitened @ scaled @ mean + np.linalg.slogdet(inverse)[1])
    seen = scipy.stats.norm.isf(threshold / 2) + scipy.stats.norm.ppf(FOUND)
    strength = np.linalg.norm(slope, axis=0)
    limit = np.divide(seen, strength, out=np.full(len(strength), np.inf), where=strength > 0)
    covariance = np.outer(movement.sd, movement.sd) * inverse
    return Explained(movement, since, movement.sd * mean, covariance, p, evidence + float(np.log(movement.odds)), limit)


def _posterior(slope: np.ndarray, whitened: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (k,) and covariance (k, k) of standard normal sizes with slopes (n, k), given whitened errors (n,)."""
    covariance = np.linalg.inv(slope.T @ slope + np.eye(slope.shape[1]))
    return covariance @ (slope.T @ whitened), covariance
