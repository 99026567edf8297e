"""Unexplained structure: a dependence of the residual on inputs that no cause of the catalogue explains.

Decoys are smooth functions of the inputs without a physical meaning, tested as a family of their own, as causes are. A significant
one is reported as unexplained, with the general errors along its input and causes that failed their test as suspects. It is
predicted by the error model's posterior mean with that structure's functions alone, and never part of the model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import comb

import casadi as ca
import numpy as np
import scipy

from calflow.diagnosis.background import Field
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.regressors import Background
from calflow.diagnosis.screening import MATERIAL, Score, Screening, by_place, place_probabilities
from calflow.diagnosis.trial import Detection
from calflow.effects.base import IN_TIME, ITS_ANGLE, ITS_TORQUE, NEEDS
from calflow.effects.cause import Cause
from calflow.estimation.accuracy import error_jacobian
from calflow.estimation.error_model import beside_smooth_errors
from calflow.estimation.needed_conditions import depended_on
from calflow.estimation.noise import NO_DISCREPANCY
from calflow.estimation.smooth_functions import (
    JointField,
    OfTorque,
    Shift,
    SmoothFunction,
    moved_together,
    of_images,
    of_place,
    pairs_of,
    under_payloads,
)
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.robot.mechanism import Deflection, Row, State

MOST_PARTS = 3  # unexplained dependences that are reported
POSE = "pose"  # as an input: changes from pose to pose that no other input explains
SUSPECTED = 0.05  # probability from which a cause that failed its test is reported beside unexplained structure
MOMENTS = 20  # parts of the rows, between which a slip may have occurred
FREQUENCIES = 800  # of a disturbance in time, at most
# Highest frequency, in cycles per pose: uneven times resolve more than one cycle between poses (Lomb 1976).
FASTEST = 2.0
LONG = 600.0  # s: periods from here on are told in hours
RESOLUTION = 32  # parts of the mean time between poses in which times are told apart
FORGOTTEN, RECURRED = 0.5, 0.9  # spectral window below which two rates differ, and above which they look alike again


@dataclass(frozen=True)
class UnexplainedStructure:
    """A dependence that no cause explains: its inputs, family-wise p-value, share of chi², and basis functions.

    along: the inputs on which a part of it depends alone; suspects: the causes that it may be. As for a cause, a share below
    MATERIAL is too small to matter, however many rows show it.
    """

    inputs: tuple[str, ...]
    p: float
    share: float
    functions: tuple[SmoothFunction, ...]
    detail: str = ""
    along: tuple[str, ...] = ()
    suspects: tuple[Cause, ...] = ()


def suspected(left: Sequence[UnexplainedStructure], scores: Sequence[Score[Cause]]) -> tuple[UnexplainedStructure, ...]:
    """Return the structures with their suspects, the likeliest first; scores are those of all candidates beside the model.

    The family of errors along an input is suspected wherever a part depends on that alone. Any other cause is reported with the
    strongest dependence: a priori one of them is as probable as none.
    """
    places = by_place(scores)
    likeliest = sorted(place_probabilities(places).items(), key=lambda item: -item[1])
    causes = {places[place][1].cause: probability for place, probability in likeliest}
    structures = []
    for k, structure in enumerate(left):
        least = SUSPECTED if k == 0 else np.inf
        suspects = (c for c, likely in causes.items() if likely >= least or is_any_error_along(c, structure.along))
        structures.append(replace(structure, suspects=tuple(suspects)))
    return tuple(structures)


def is_any_error_along(cause: Cause, inputs: tuple[str, ...]) -> bool:
    """Whether a cause is of the family of general errors along one of these inputs."""
    of_joint = (ITS_ANGLE, ITS_TORQUE)
    own = {f"{name}{cause.joint}" if name in of_joint else name for name in cause.effect.named_in()}
    return not own.isdisjoint(inputs)


def left_along(cause: Cause, model: Model, left: Sequence[UnexplainedStructure]) -> UnexplainedStructure | None:
    """Return unexplained structure along an input through which a cause acts: its joint's angle, time or order, or the payload."""
    through = set(depended_on(replace(model, effects=(cause,)))) if left else set()
    of_joint = {f"{of}{cause.joint}" for of in (ITS_ANGLE, ITS_TORQUE)}
    inputs = of_joint if cause.joint and not cause.of_measuring() else set()
    inputs |= set(IN_TIME) if cause.of_measuring() or not through.isdisjoint((*IN_TIME, "temperature")) else set()
    inputs |= {"payload"} & through
    return next((structure for structure in left if inputs & set(structure.inputs)), None)


def is_of_its_curve(left: UnexplainedStructure, cause: Cause) -> bool:
    """Whether a part of what is left is a curve of the cause's own input alone: more of the cause's family explains that."""
    return is_any_error_along(cause, left.inputs if left.inputs[0] == POSE else left.along)


def share_unnamed(finding: Detection[Cause], model: Model, left: Sequence[UnexplainedStructure]) -> float:
    """Return the share of what is left along an input through which a cause acts in what both explain of chi²; 0: nothing is."""
    along = left_along(finding.cause, model, left)
    if along is None or is_of_its_curve(along, finding.cause):
        return 0.0
    explained = finding.own.share
    unnamed = along.share * (1 - explained)
    return unnamed / (unnamed + explained)


def _alone(*parts: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(part[0] for part in parts if len(part) == 1))


def unexplained(
    fitted: Fitted,
    significance: float,
    rng: np.random.Generator,
    say: Callable[[str], None],
    at_rest: Sequence[UnexplainedStructure] = (),
    beside: Background | None = None,
) -> list[UnexplainedStructure]:
    """Return the significant dependences of a fitted model's residual on inputs, the strongest first.

    Single functions are tested first, as they show a sharp dependence best; then the background as a whole. Joints that do not
    repeat, at_rest, are reported where no function is significant beside their errors, or alone: to tests that take rows as
    independent, errors of a pose look like many inputs. Functions that such errors hide otherwise are reported with them.
    """
    surest, beside_rest = list(at_rest), list[UnexplainedStructure]()
    if beside is not None and surest:
        beside_rest = _single(replace(fitted, background=beside, shared=0.0), rng)
    if not beside_rest or beside_rest[0].p < significance:
        without = [*_single(replace(fitted, background=None), rng), *_together(fitted), *_of_poses(fitted)]
        shown = any(structure.p < significance for structure in without)
        surest = without if shown or not beside_rest else [*surest, *beside_rest]
    accepted: list[UnexplainedStructure] = []
    for structure in surest:
        if structure.p >= significance or structure.share < MATERIAL or len(accepted) == MOST_PARTS:
            continue
        if not any(set(structure.inputs) - {POSE} & set(other.inputs) for other in accepted):
            accepted.append(structure)
            say(f"the residuals depend on {' and '.join(structure.inputs)}: p = {structure.p:.2g}")
    return accepted


def _single(fitted: Fitted, rng: np.random.Generator) -> list[UnexplainedStructure]:
    screening = Screening.of(fitted.regressors(decoys(fitted)))
    family = screening.family(rng)
    tested = []
    for score in screening.scores:
        decoy = score.cause.effect
        assert isinstance(decoy, SmoothFunction)
        tested.append(
            UnexplainedStructure(
                decoy.inputs, family.p(score), score.share, (decoy,), score.cause.detail, _alone(decoy.inputs)
            )
        )
    return sorted(tested, key=lambda structure: structure.p)


def _together(fitted: Fitted) -> list[UnexplainedStructure]:
    """Return the test of the background as a whole, corrected for every choice of as many parts.

    Twice the log likelihood ratio is a mixture of chi² with at most as many degrees of freedom as variances and correlation
    lengths: half of each variance's distribution is at its bound of zero (Self and Liang 1987), where lengths do not matter.
    """
    left = fitted.background
    if left is None:
        return []
    n = len(left.inputs)
    lengths = sum(len(part.lengths) for part in left.functions if isinstance(part, Field))
    p = comb(left.tried, n) * 0.5**n * float(scipy.stats.chi2.sf(left.gain, n + lengths))
    inputs = tuple(dict.fromkeys(name for part in left.inputs for name in part))
    share = -float(np.expm1(-left.gain / fitted.fit.residual.size))
    return [UnexplainedStructure(inputs, min(1.0, p), share, left.functions, along=_alone(*left.inputs))]


def _of_poses(fitted: Fitted) -> list[UnexplainedStructure]:
    """Return the test of errors that the markers of a pose share; a correlation of zero is at its bound, as variances are."""
    if not (fitted.intraclass and fitted.intraclass_likelihood):
        return []
    return [
        UnexplainedStructure(
            (POSE,), float(scipy.stats.chi2.sf(fitted.intraclass_likelihood.gain, 1)) / 2, fitted.intraclass, ()
        )
    ]


def predicted(fitted: Fitted, functions: Sequence[SmoothFunction], data: Measurements) -> np.ndarray:
    """Return the change of positions (n_rows, 3) [m] by smooth functions, their posterior mean beside the parameters."""
    sizes = fitted.smooth_in([((), [*functions])])
    errors = beside_smooth_errors(sizes, sizes.components.most_likely(np.ones(1)), NO_DISCREPANCY)[1]
    slopes = errors.slopes_of(partial(error_jacobian, measured=data), fitted.model, fitted.fit.estimate)
    return np.asarray(slopes @ np.append(errors.offset, errors.mean))


@dataclass(frozen=True)
class Since(SmoothFunction):
    """A step of all joints' zeros, and of the marker on the tool, from a row on."""

    moment: float = 0.5

    inputs = ("order",)

    @property
    def detail(self) -> str:
        return f"since row {int(np.floor(self.moment)) + 1} in measuring order"

    @property
    def units(self) -> Sequence[str]:
        return [joint.unit for joint in self.robot.joints] + 3 * ["m"]

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        after, n = row.order > self.moment, self.robot.n_joints
        link = ca.SX(still.link)
        link[:3, -1] = p[n:] * after
        return replace(still, joint=p[:n] * after, link=link)


@dataclass(frozen=True)
class Oscillation(SmoothFunction):
    """A shift of the reported point that is periodic in time, with a cosine and a sine along each axis."""

    rate: float = 1.0  # rad/s

    inputs = ("time",)
    units = 6 * ("m",)

    @property
    def detail(self) -> str:
        period = 2 * np.pi / self.rate
        return f"period {period:.3g} s" if period < LONG else f"period {period / 3600:.2g} h"

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        angle = self.rate * row.time
        return point + p[:3] * ca.cos(angle) + p[3:] * ca.sin(angle) if row.time.nnz() else point


def decoys(fitted: Fitted) -> list[SmoothFunction]:
    """Return the decoys for a fitted model's rows."""
    data, robot = fitted.data, fitted.data.robot
    turning = [i for i, joint in enumerate(robot.joints) if joint.kind == "revolute"]
    chosen: list[SmoothFunction] = [JointField(robot, (i,)) for i in turning]
    chosen += [Shift(robot, (i,)) for i in turning]
    pairs = pairs_of(moved_together(fitted.problem, fitted.fit.estimate))
    chosen += [kind(robot, pair) for pair in pairs if set(pair) <= set(turning) for kind in (JointField, Shift)]
    if NEEDS["torques"].met(robot, data.given):
        chosen += [OfTorque(robot, erring=i) for i in range(robot.n_joints)]
    chosen += of_images(data) or [of_place(fitted.model, fitted.fit.estimate, data)]
    chosen += under_payloads(data)
    if "order" in data.given:
        order = np.unique(data.table["order"].to_numpy(float))
        chosen += [Since(robot, float(moment)) for moment in np.quantile(order, np.arange(1, MOMENTS) / MOMENTS)]
    if "time" in data.given:
        chosen += [Oscillation(robot, float(rate)) for rate in _rates(data.table["time"].to_numpy())]
    return chosen


def _rates(time: np.ndarray) -> np.ndarray:
    """Return angular frequencies from one cycle per session to the highest that these times resolve, half a cycle apart."""
    span, time = float(np.ptp(time)), np.unique(time)
    if span <= 0:
        return np.array([])
    turns = min(FASTEST * len(time), _resolved((time - time[0]) / span))
    return 2 * np.pi / span * np.linspace(1.0, turns, min(FREQUENCIES, int(2 * turns)))


def _resolved(time: np.ndarray) -> float:
    """Return the most cycles from 0 to 1 that these times (n,) tell from fewer, as at even times a drift looks like a fast wave."""
    parts = RESOLUTION * len(time)
    counts = np.bincount(np.rint(parts * time).astype(int), minlength=2 * parts)
    window = np.abs(np.fft.rfft(counts)) / len(time)  # at every half cycle
    lobe = np.append(np.flatnonzero(window < FORGOTTEN), len(window))[0]
    recurring = np.flatnonzero(window[lobe:] > RECURRED)
    return float(lobe + recurring[0]) / 4 if len(recurring) else np.inf
