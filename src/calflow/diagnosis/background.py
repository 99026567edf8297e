"""What no cause explains: smooth functions of the inputs without a physical meaning.

One at a time they are decoys, which are tested as causes are. Together they are the background: random functions of joints,
place and time, whose sizes the data tell.

The sizes are those of the greatest restricted likelihood (Patterson and Thompson 1971): the model's own parameters, its causes
among them, are integrated out, so that only what they cannot imitate counts. They grow and shrink by the ratio of what is seen
to what is expected; a part is taken in where that ratio is beyond chance (a score test) and the likelihood gains by it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, pairwise
from typing import ClassVar, Literal

import casadi as ca
import numpy as np
from scipy.stats import norm

from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import Background, Held, RegressorProducts, Regressors
from calflow.diagnosis.screening import Screening
from calflow.effects import Effect
from calflow.effects.cause import Cause
from calflow.effects.joint_error import JointError, Term
from calflow.robot.mechanism import Deflection, Row, State
from calflow.robot.parts import Parameter

SIZE = 3e-4  # rad or m, of a decoy before any data
ORDERS = 6  # of a function of one joint
MOMENTS = 20  # parts of the rows, between which something may have slipped
FREQUENCIES = 800  # at most, of a disturbance in time
FASTEST = 2.0  # turns a pose: poses at uneven times tell also what turns more than once between them (Lomb 1976)


class Decoy(Effect):
    """A smooth function of some inputs."""

    id: ClassVar[str] = "unexplained"
    title: ClassVar[str] = "unexplained"

    @property
    def inputs(self) -> tuple[str, ...]:
        """What it depends on."""
        raise NotImplementedError

    @property
    def spectrum(self) -> np.ndarray:
        """How large each of its waves is beside the others in what is smooth, shape (n_parameters,)."""
        return np.ones(len(self.declared))


@dataclass(frozen=True)
class JointField(JointError, Decoy):
    """Every joint's error as a smooth function of one joint's angle, or of two together (without what either does alone)."""

    of: tuple[int, ...] = (0,)
    orders: int = ORDERS

    @property
    def inputs(self) -> tuple[str, ...]:
        """The joints it depends on."""
        return tuple(f"q{i + 1}" for i in self.of)

    @property
    def spectrum(self) -> np.ndarray:
        """Waves that fall with their order."""
        waves = _spectrum(self.of, self.orders)
        return np.tile(waves, len(self.declared) // len(waves))

    def terms(self, joint: int, state: State, row: Row) -> Sequence[Term]:
        """Return waves of the joint's angle, or products of waves of both."""
        waves = _waves(state.q, self.of, self.orders)
        return [Term(f"wave{k + 1}", self.unit(joint), SIZE, 1.0, value) for k, value in enumerate(waves)]


@dataclass(frozen=True)
class Shift(Decoy):
    """A shift of the reported point as a smooth function of one joint's angle, or of two together."""

    of: tuple[int, ...] = (0,)
    orders: int = ORDERS

    @property
    def inputs(self) -> tuple[str, ...]:
        """The joints it depends on."""
        return tuple(f"q{i + 1}" for i in self.of)

    @property
    def spectrum(self) -> np.ndarray:
        """Waves that fall with their order."""
        return np.repeat(_spectrum(self.of, self.orders), 3)

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the waves along each axis."""
        number = len(_spectrum(self.of, self.orders))
        return tuple(
            Parameter(self.id, "point", f"wave{k + 1}{axis}", "m", SIZE, -1.0, 1.0)
            for k in range(number)
            for axis in "xyz"
        )

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported."""
        return point + ca.reshape(p, 3, p.numel() // 3) @ ca.vertcat(*_waves(row.q, self.of, self.orders))


@dataclass(frozen=True)
class InTime(Decoy):
    """A shift of the reported point that comes and goes with time."""

    rate: float = 1.0  # rad/s, or rad a row
    clock: Literal["time", "order"] = "time"
    share: float = 1.0  # of its size beside other waves

    @property
    def spectrum(self) -> np.ndarray:
        """Its size beside others'."""
        return np.full(len(self.declared), self.share)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Time, or the order of the rows."""
        return (self.clock,)

    @property
    def detail(self) -> str:
        """Say the period."""
        return f"period {2 * np.pi / self.rate:.3g} s"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return both phases along each axis."""
        return tuple(
            Parameter(self.id, "device", f"{phase}{axis}", "m", SIZE, -1.0, 1.0)
            for phase in ("cos", "sin")
            for axis in "xyz"
        )

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported."""
        angle = self.rate * (row.time if self.clock == "time" else row.order)
        return point + p[:3] * ca.cos(angle) + p[3:] * ca.sin(angle)


@dataclass(frozen=True)
class Since(Decoy):
    """Zeros of all joints, and the marker on the tool, that are others from a row on."""

    moment: float = 0.5

    @property
    def inputs(self) -> tuple[str, ...]:
        """The order of the rows."""
        return ("order",)

    @property
    def detail(self) -> str:
        """Say when."""
        return f"since row {int(np.floor(self.moment)) + 1} in measuring order"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the joints' offsets, and the marker's."""
        units = [joint.unit for joint in self.robot.joints] + ["m"] * 3
        return tuple(
            Parameter(self.id, "since", f"offset{k + 1}", unit, SIZE, -1.0, 1.0) for k, unit in enumerate(units)
        )

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Turn the joints, and shift the flange with what it carries."""
        after, n = row.order > self.moment, self.robot.n_joints
        link = ca.SX(still.link)
        link[:3, -1] = p[n:] * after
        return replace(still, joint=p[:n] * after, link=link)


@dataclass(frozen=True)
class UnderPayload(Decoy):
    """Under one payload: zeros of all joints, a wave of each, the marker on the tool and the device's place, which are others."""

    payload: str = ""

    @property
    def inputs(self) -> tuple[str, ...]:
        """The payload."""
        return ("payload",)

    @property
    def detail(self) -> str:
        """Say which."""
        return f"under {self.payload}"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return offset and wave of each joint, and the shifts of marker and device."""
        symbols = [(f"{term}{i + 1}", joint.unit) for i, joint in enumerate(self.robot.joints)
                   for term in ("offset", "cos", "sin")]  # fmt: skip
        symbols += [(f"{whose}{axis}", "m") for whose in ("marker", "device") for axis in "xyz"]
        return tuple(Parameter(self.id, "payload", symbol, unit, SIZE, -1.0, 1.0) for symbol, unit in symbols)

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        """Turn the joints, and shift the flange with what it carries."""
        on, n = self._carried(row), self.robot.n_joints
        waves = [ca.vertcat(1, ca.cos(state.q[i]), ca.sin(state.q[i])) for i in range(n)]
        turned = [on * ca.dot(p[3 * i : 3 * i + 3], wave) for i, wave in enumerate(waves)]
        link = ca.SX(still.link)
        link[:3, -1] = on * p[3 * n : 3 * n + 3]
        return replace(still, joint=ca.vertcat(*turned), link=link)

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported."""
        return point + self._carried(row) * p[-3:]

    def _carried(self, row: Row) -> ca.SX:
        return row.payload[list(self.robot.payloads).index(self.payload)]


@dataclass(frozen=True)
class InPlace(Decoy):
    """A shift of the reported point that depends smoothly on where it is."""

    centre: tuple[float, ...] = (0.0, 0.0, 0.0)
    reach: float = 1.0

    @property
    def inputs(self) -> tuple[str, ...]:
        """The place."""
        return "x", "y", "z"

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the cubic terms along each axis; lower ones are geometry's."""
        return tuple(
            Parameter(self.id, "place", f"{axis}{k}", "m", SIZE, -1.0, 1.0)
            for axis in "xyz"
            for k in range(len(_powers()))
        )

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Shift what is reported."""
        near = (point - ca.DM(self.centre)) / self.reach
        terms = ca.vertcat(*(near[0] ** i * near[1] ** j * near[2] ** k for i, j, k in _powers()))
        return point + ca.reshape(p, len(_powers()), 3).T @ terms


def decoys(fitted: Fitted) -> list[Decoy]:
    """Return the functions to try on a fitted model's rows."""
    data, robot = fitted.data, fitted.data.robot
    turning = [i for i, joint in enumerate(robot.joints) if joint.kind == "revolute"]
    chosen: list[Decoy] = [JointField(robot, (i,)) for i in turning]
    chosen += [Shift(robot, (i,)) for i in turning]
    chosen += [kind(robot, pair) for pair in combinations(turning, 2) for kind in (JointField, Shift)]
    chosen.append(placed_decoys(fitted))
    chosen += under_payloads(fitted)
    if "order" in data.given:
        order = np.unique(data.table["order"].to_numpy(float))
        chosen += [Since(robot, float(moment)) for moment in np.quantile(order, np.arange(1, MOMENTS) / MOMENTS)]
    if "time" in data.given:
        chosen += [InTime(robot, float(rate)) for rate in _rates(data.table["time"].to_numpy())]
    return chosen


def under_payloads(fitted: Fitted) -> list[UnderPayload]:
    """Return what may differ from payload to payload."""
    carried = list(
        dict.fromkeys(fitted.data.table["payload"])
    )  # what differs from one of them differs from the first, too
    return [UnderPayload(fitted.data.robot, name) for name in carried[1 if all(carried) else 0 :] if name]


def placed_decoys(fitted: Fitted) -> InPlace:
    """Return the smooth functions of place where a fitted model's rows are."""
    place = fitted.model.point(fitted.fit.estimate, fitted.data.conditions)
    centre = place.mean(axis=0)
    return InPlace(fitted.data.robot, tuple(map(float, centre)), float(np.abs(place - centre).max()) or 1.0)


def _spectrum(of: tuple[int, ...], orders: int) -> np.ndarray:
    """The waves' sizes beside each other, those of `_waves`."""
    return np.repeat(1 / np.arange(1.0, orders + 1), 2) if len(of) == 1 else np.ones(4)


def _waves(q: ca.SX, of: tuple[int, ...], orders: int) -> list[ca.SX]:
    """Waves of one joint's angle, or products of two joints' without what either does alone."""
    if len(of) == 1:
        return [wave(k * q[of[0]]) for k in range(1, orders + 1) for wave in (ca.cos, ca.sin)]
    first, second = (q[i] for i in of)
    return [a(first) * b(second) for a in (ca.cos, ca.sin) for b in (ca.cos, ca.sin)]


def _rates(time: np.ndarray) -> np.ndarray:
    """Angular rates from one turn a session to the fastest, half a turn a session apart."""
    span = float(np.ptp(time))
    if span <= 0:
        return np.array([])
    turns = FASTEST * len(np.unique(time))
    return 2 * np.pi / span * np.linspace(1.0, turns, min(FREQUENCIES, int(2 * turns)))


def _powers() -> list[tuple[int, int, int]]:
    return [(i, j, k) for i in range(4) for j in range(4) for k in range(4) if 2 <= i + j + k <= 3]


SMOOTH_ORDERS = 4  # of a joint's angle
TURNS = 8  # half turns that a slow wander makes in the course of the measurement, at most
MODES = 240  # directions in which all functions together are largest: the rest is lost in the noise
FAINT = 1e-4  # of the largest of a part's functions: smaller ones, turned to be apart, are lost in the noise as well
SIZE_STEPS = 30  # of the sizes
SETTLED = 0.03  # relative change of the sizes' squares below which they stay
PROMISING = 1.0  # standard deviations beyond what is expected, from which a part is tried
GONE = 1e-6  # of a decoy's variance: nothing
BELIEVED = 3.0  # in twice the logarithm of the likelihood: what a part must add to be kept


@dataclass(frozen=True, eq=False)
class BackgroundBasis:
    """What a background may be made of, for the rows of one diagnosis: modes (n, n_modes), orthonormal over the noise.

    parts hold each input's functions in these modes, (n_modes, n_waves), of a decoy's size. weight (n,) is what the rows'
    residuals were multiplied by when they were worked out.
    """

    modes: np.ndarray
    inputs: tuple[tuple[str, ...], ...]
    parts: tuple[np.ndarray, ...]
    weight: np.ndarray

    @staticmethod
    def of(fitted: Fitted) -> BackgroundBasis:
        """Work out all functions at a fitted model, without inputs on which nothing here depends."""
        kinds = functions(fitted)
        regressors = replace(fitted, background=None).regressors([effect for _, effects in kinds for effect in effects])
        spectrum = np.concatenate([effect.spectrum for _, effects in kinds for effect in effects])
        scale = regressors.prior_sd * spectrum
        shown = regressors.matrix.products(np.arange(len(scale))) * scale[:, None] * scale
        ends = np.cumsum([0, *(sum(len(effect.declared) for effect in effects) for _, effects in kinds)])
        spans = [slice(i, j) for i, j in pairwise(ends)]
        # A wire, or a socket, asks for no place that a device would report: what errs with that place moves nothing here.
        moving = [k for k, span in enumerate(spans) if shown.diagonal()[span].any()]
        square, turns = np.linalg.eigh(shown)
        kept = np.argsort(-square)[: min(MODES, int(np.count_nonzero(square > 1e-12 * square[-1])))]
        whole = np.sqrt(square[kept])[:, None] * turns[:, kept].T
        parts = tuple(_few(whole[:, spans[k]]) for k in moving)
        modes = regressors.matrix.times(scale[:, None] * turns[:, kept] / np.sqrt(square[kept]))
        return BackgroundBasis(modes, tuple(kinds[k][0] for k in moving), parts, fitted.problem.weight)

    @cached_property
    def waves(self) -> np.ndarray:
        """All functions side by side, (n_modes, n_waves)."""
        return np.hstack(self.parts)

    @cached_property
    def spans(self) -> tuple[slice, ...]:
        """Which of all functions are each part's."""
        ends = np.cumsum([0, *(part.shape[1] for part in self.parts)]).tolist()
        return tuple(slice(*span) for span in pairwise(ends))

    @cached_property
    def part(self) -> np.ndarray:
        """The number of each function's part, (n_waves,)."""
        return np.repeat(np.arange(len(self.parts)), [part.shape[1] for part in self.parts])

    def weighed(self, weight: np.ndarray) -> np.ndarray:
        """Return the modes of residuals multiplied by other weights (n,), of the same noise but for its level."""
        ratio = weight / self.weight
        return np.asarray((ratio / np.median(ratio))[:, None] * self.modes)


def _few(waves: np.ndarray) -> np.ndarray:
    """Return fewer functions (n_modes, …) of the same covariance as these (n_modes, n_waves)."""
    left, size, _ = np.linalg.svd(waves, full_matrices=False)
    kept = size > FAINT * size[0]
    return np.asarray(left[:, kept] * size[kept])


def functions(fitted: Fitted) -> list[tuple[tuple[str, ...], list[Decoy]]]:
    """Return inputs and functions of what may be left: of each joint, two together, place, payload, and time or order."""
    robot, data = fitted.data.robot, fitted.data
    turning = [i for i, joint in enumerate(robot.joints) if joint.kind == "revolute"]
    bases: list[tuple[tuple[str, ...], list[Decoy]]] = [
        ((f"q{i + 1}",), [JointField(robot, (i,), SMOOTH_ORDERS), Shift(robot, (i,), SMOOTH_ORDERS)]) for i in turning
    ]
    if len(turning) > 1:
        bases.append((("joints",), [Shift(robot, pair) for pair in combinations(turning, 2)]))
    bases.append((("x", "y", "z"), [placed_decoys(fitted)]))
    if loaded := under_payloads(fitted):
        bases.append((("payload",), [*loaded]))
    clock = next((clock for clock in ("time", "order") if clock in data.given), None)
    if clock:
        span = float(np.ptp(data.table[clock].to_numpy(float))) or 1.0
        bases.append(((clock,), [InTime(robot, np.pi * k / span, clock, 1 / k) for k in range(1, TURNS + 1)]))
    return bases


def background(fitted: Fitted, basis: BackgroundBasis) -> Background | None:
    """Return the background that a fitted model leaves; none where the data show none.

    Along an input of which one of its causes is any smooth function there is none: that cause is its name.
    """
    sizes = Sizes.beside(fitted, basis)
    variance = sizes.believed([name for cause in fitted.causes for name in cause.effect.smooth_in])
    return sizes.background(variance) if variance.any() else None


def possible(fitted: Fitted, basis: BackgroundBasis) -> Background:
    """Return the background that a fitted model may leave as well as not: each part's size as it is to be expected.

    What the data do not show is not excluded by them. Intervals go by this, tests by what is shown.
    """
    sizes = Sizes.beside(fitted, basis)
    return sizes.background(sizes.expected(sizes.believed()))


@dataclass(frozen=True, eq=False)
class Sizes:
    """The likelihood of a background's variances, beside a linearised model.

    Along the modes (n, n_modes), which are the basis' by the weight (n,) of the residuals, shown (n_modes, n_modes) is what they
    show beside the model's own parameters, plain the same without these, score (n_modes,) what the residual shows of them; chi2
    is what the model leaves, of n residuals, with total degrees of freedom. shared is as in `Background`.
    """

    basis: BackgroundBasis
    weight: np.ndarray
    shared: float
    modes: np.ndarray
    shown: np.ndarray
    plain: np.ndarray
    score: np.ndarray
    chi2: float
    n: int
    total: float

    @property
    def parts(self) -> tuple[np.ndarray, ...]:
        """The functions that variances are of, (n_modes, n_waves) each."""
        return self.basis.parts

    @cached_property
    def _gram(self) -> np.ndarray:
        """What functions show of each other beside the model, (n_waves, n_waves)."""
        return np.asarray(self.basis.waves.T @ (self.shown @ self.basis.waves))

    @cached_property
    def _along(self) -> np.ndarray:
        """What the residual shows of the functions, (n_waves,)."""
        return np.asarray(self.basis.waves.T @ self.score)

    @staticmethod
    def beside(fitted: Fitted, basis: BackgroundBasis) -> Sizes:
        """Take a fitted model's own parameters out of the modes."""
        return Sizes.of(fitted.alone, basis, fitted.problem.weight)

    @staticmethod
    def of(regressors: Regressors[Cause], basis: BackgroundBasis, weight: np.ndarray) -> Sizes:
        """Take the model's own parameters out of the modes."""
        modes = basis.weighed(weight)
        held = Held(modes)
        products = RegressorProducts.of(regressors.residual, regressors.jacobian, held, ())
        reduced = replace(regressors, matrix=held, candidates=(), products=products)
        seen = Screening(reduced)
        columns = np.arange(modes.shape[1])
        return Sizes(basis, weight, regressors.shared, modes, seen.information(columns), modes.T @ modes, seen.score,
                     seen.chi2, len(modes), seen.degrees_of_freedom)  # fmt: skip

    def background(self, variance: np.ndarray) -> Background:
        """Return the background of these variances (n_parts,), without parts that have none."""
        kept = np.flatnonzero(variance > 0)
        return Background(
            tuple(self.basis.inputs[k] for k in kept),
            self.modes,
            tuple(self.parts[k] * np.sqrt(variance[k]) for k in kept),
            self.weight,
            self.shared,
            tuple(map(float, self.degrees_of_freedom(variance)[kept])),
            self.cost(np.zeros(len(variance))) - self.cost(variance),
            len(variance),
        )

    def expected(self, variance: np.ndarray) -> np.ndarray:
        """Return each part's mean variance (n_parts,) over all that the data allow, about the most likely ones.

        The likelihood is about normal beside zero, below which no variance is: the mean of a normal that is cut off there.
        """
        beyond, size = self._beyond(variance)
        spread = np.divide(size, beyond, out=np.zeros_like(size), where=beyond != 0) * np.sqrt(2)
        off = (variance + size) / np.maximum(spread, 1e-300)
        return np.where(spread > 0, spread * (off + norm.pdf(off) / np.maximum(norm.cdf(off), 1e-12)), 0.0)

    def _solved(self, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Put a background of these variances beside the model, by the functions that act alone (Woodbury 1950).

        Returned are their numbers (n,), their sizes (n,), the inverse of I + what they show of each other at these sizes, and
        what is left of chi².
        """
        here = np.flatnonzero(variance[self.basis.part] > 0)
        size = np.sqrt(variance[self.basis.part[here]])
        inverse = np.linalg.inv(np.eye(len(here)) + size[:, None] * self._gram[np.ix_(here, here)] * size)
        along = size * self._along[here]
        return here, size, inverse, max(self.chi2 - float(along @ inverse @ along), 1e-12)

    def cost(self, variance: np.ndarray) -> float:
        """Twice minus the logarithm of the restricted likelihood, the noise's level at its best."""
        *_, inverse, chi2 = self._solved(variance)
        return self.total * float(np.log(chi2 / self.total)) - float(np.linalg.slogdet(inverse)[1])

    def evidence(self, variance: np.ndarray) -> float:
        """Twice minus the logarithm of the likelihood, to be compared with models of other parameters."""
        here, size, _, chi2 = self._solved(variance)
        waves = self.basis.waves[:, here] * size
        determinant = np.linalg.slogdet(np.eye(len(here)) + waves.T @ (self.plain @ waves))[1]
        return self.n * float(np.log(chi2)) + float(determinant)

    def most_likely(self, variance: np.ndarray) -> np.ndarray:
        """Return the variances (n_parts,) of the greatest restricted likelihood, from these; zero stays zero."""
        for _ in range(SIZE_STEPS):
            here, size, inverse, chi2 = self._solved(variance)
            left = inverse @ (size * self._along[here])
            seen = self._by_part(left**2, here) * self.total / chi2
            expected = self._by_part(1 - inverse.diagonal(), here)
            grown = variance * seen / np.maximum(expected, 1e-300)
            settled = np.allclose(grown, variance, rtol=SETTLED, atol=GONE)
            variance = np.where(grown < GONE, 0.0, grown)
            if settled:
                break
        return variance

    def _by_part(self, values: np.ndarray, here: np.ndarray) -> np.ndarray:
        """Sums over the functions of each part (n_parts,) of values (n,), those of the functions of these numbers."""
        return np.bincount(self.basis.part[here], values, len(self.parts))

    def _beyond(self, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How much more of each part is seen than expected, in standard deviations, and the variance which that speaks for."""
        here, size, inverse, chi2 = self._solved(variance)
        taken = self._gram[:, here] * size
        along = self._along - taken @ (inverse @ (size * self._along[here]))
        seen = np.array([along[span] @ along[span] for span in self.basis.spans]) * self.total / chi2
        each = [self._gram[span, span] - taken[span] @ inverse @ taken[span].T for span in self.basis.spans]
        expected = np.array([np.trace(block) for block in each])
        information = np.array([np.vdot(block, block) for block in each])
        return (seen - expected) / np.sqrt(2 * information), (seen - expected) / information

    def believed(self, without: Collection[str] = ()) -> np.ndarray:
        """Return the most likely variances (n_parts,), part by part while one adds enough to be believed.

        Parts of some inputs may be left out.
        """
        variance = np.zeros(len(self.parts))
        tried = np.array([bool(set(inputs) & set(without)) for inputs in self.basis.inputs])
        # Once each: parts much alike would come and go.
        while not tried.all():
            beyond, size = self._beyond(variance)
            best = int(np.argmax(np.where(tried, -np.inf, beyond)))
            if beyond[best] < PROMISING:
                break
            tried[best] = True
            larger = variance.copy()
            larger[best] = size[best]
            larger = self.most_likely(larger)
            if self.cost(variance) - self.cost(larger) >= BELIEVED:
                variance = larger
        for k in np.flatnonzero(variance > 0):
            without = np.where(np.arange(len(variance)) == k, 0.0, variance)
            if self.cost(without) - self.cost(variance) < BELIEVED:
                variance = self.most_likely(without)
        return variance

    def degrees_of_freedom(self, variance: np.ndarray) -> np.ndarray:
        """Return how well each part's variance is known, shape (n_parts,): that of as many squares of normals."""
        here, _, inverse, _ = self._solved(variance)
        part = self.basis.part[here]
        determined = np.where(part[:, None] == part, np.eye(len(here)) - inverse, 0.0) ** 2
        return np.maximum(self._by_part(determined.sum(axis=1), here), 1.0)
