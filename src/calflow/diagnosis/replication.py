"""Confirmation of findings on an independent series: joint-error curves compared, and causes carried over to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from calflow.diagnosis.fitted import Fitted
from calflow.effects import Effect
from calflow.effects.base import JointError
from calflow.effects.cause import Carried, Cause
from calflow.estimation.accuracy import distances, errors
from calflow.estimation.fit import Fit, fit_reweighted
from calflow.estimation.noise import measured_noise
from calflow.estimation.registration import registered
from calflow.files.deferred import pd
from calflow.files.tables import column, to_frame, typed
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.observations import observations
from calflow.robot.mechanism import Row, State

GRID = 400  # angles at which two curves are compared
NAN = float("nan")
AGREE, AGREE_MAINLY = 0.95, 0.7  # correlations from which two curves count as the same, or nearly the same
WIDE = 0.3  # share of a joint's travel that two series must have in common for a meaningful comparison


@dataclass(frozen=True, kw_only=True)
class ConfirmedCause:
    """Agreement of a joint error with that of the other series."""

    cause: str = column("its id")
    joint: int = column("its joint")
    correlation: float = column("of both curves over the common travel, beyond their first order", default=NAN)
    correlation_with_first_order: float = column("of the whole curves", default=NAN)
    rms_here: float = column("size of this series' curve beyond its first order", "as `error_unit` says", default=NAN)
    rms_there: float = column("the same of the other series", "as `error_unit` says", default=NAN)
    common: float = column("travel that both series cover", "as `travel_unit` says")
    error_unit: str = column("urad, of a slide um")
    travel_unit: str = column("deg, of a slide mm")
    share_of_travel: float = column("the common travel as a share of this series' travel")
    words: str = column("the conclusion in words")


@dataclass(frozen=True, kw_only=True)
class ConfirmedPoint:
    """A point of a joint error's curves, fitted on either series, beyond the first order."""

    cause: str = column("its id")
    joint: int = column("its joint")
    travel: float = column("the joint's angle, or position", "as `travel_unit` says")
    here: float = column("as fitted on this series", "as `error_unit` says")
    there: float = column("as fitted on the other series", "as `error_unit` says")
    error_unit: str = column("urad, of a slide um")
    travel_unit: str = column("deg, of a slide mm")


@dataclass(frozen=True, kw_only=True)
class CarriedAccuracy:
    """The other series' held-out error with one of three models: no causes, its own fit of them, or those carried over."""

    model: str = column("without the causes, with its own fit of them, or with this series' carried over")
    n: int = column("held-out rows within the travel covered here")
    heldout_mean_mm: float = column("mean error at these rows", "mm")


def confirm(calibrated: Fitted, other: Measurements) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Fit the same effects to another series alone, and compare each joint error's curve over the common travel.

    The tables are of `ConfirmedCause`s, `ConfirmedPoint`s and `CarriedAccuracy`. other is split, with data faults corrected.
    """
    robot, observed = registered(other.robot, observations(other), other.only(other.train))
    other = other.on(robot)
    train = other.only(other.train)
    causes = [cause for cause in calibrated.causes if _is_curve(cause)]
    plain = tuple(replace(effect, robot=robot) for effect in calibrated.plain)
    matching = {cause: matched for cause in causes if (matched := _matched(cause, train)) is not None}
    noise = measured_noise(other, nominal=Model(robot, (), other.given, observed)).only(other.train)

    def fitted(effects: Sequence[Effect]) -> Fit:
        model = Model(robot, tuple(effects), other.given, observed)
        return fit_reweighted(model, train, noise, model.prior_mean[None], calibrated.fit.loss)[0]

    alone, without = fitted((*plain, *matching.values())), fitted(plain)
    rows, curves = [], []
    for cause in causes:
        row, curve = _compared(cause, calibrated, matching.get(cause), alone, train)
        rows.append(row)
        curves += [curve] if curve is not None else []
    values = [tuple(map(float, calibrated.fit.estimate[calibrated.model.columns(cause)])) for cause in causes]
    carried = fitted((*plain, *(Carried(robot, cause, v) for cause, v in zip(causes, values, strict=True))))
    heldout = other.only(other.held_out & _covered(calibrated, causes, other))
    steps = [
        ("without the causes", without),
        ("its own fit of the causes", alone),
        ("the causes carried over", carried),
    ]
    accuracy = [CarriedAccuracy(model=name, n=len(heldout), heldout_mean_mm=_mean(fit, heldout)) for name, fit in steps]
    together = pd.concat(curves, ignore_index=True) if curves else to_frame((), ConfirmedPoint)
    return to_frame(rows, ConfirmedCause), together, to_frame(accuracy, CarriedAccuracy)


def curve(cause: Cause, values: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return a joint error [rad] at angles (n,) [rad] of its joint (a slide's in m), the other joints at zero."""
    assert isinstance(cause.effect, JointError)
    state, row = State.symbols(cause.robot), Row.symbols(cause.robot)
    terms = [term.value for term in cause.effect.terms(cause.joint - 1, state, row)]
    function = ca.Function("curve", [state.q], [ca.dot(ca.DM(values), ca.vertcat(*terms))])
    q = np.zeros((cause.robot.n_joints, len(angle)))
    q[cause.joint - 1] = angle
    return np.array(function.map(len(angle))(q)).ravel()


def _is_curve(cause: Cause) -> bool:
    if not isinstance(cause.effect, JointError):
        return False
    state, row = State.symbols(cause.robot), Row.symbols(cause.robot)
    terms = ca.vertcat(*(term.value for term in cause.effect.terms(cause.joint - 1, state, row)))
    return all(symbol.name() == state.q[cause.joint - 1].name() for symbol in ca.symvar(terms))


def _matched(cause: Cause, data: Measurements) -> Cause | None:
    """Return the same cause for other data, an error map over their travel; None where they do not cover it."""
    variants = type(cause.effect).variants(data.robot, data)
    same = next((v for v in variants if v.detail == cause.effect.detail), None)
    if same is None and variants:
        same = replace(cause.effect, robot=data.robot)
    if same is None or cause.part not in {parameter.part for parameter in same.declared}:
        return None
    return Cause(data.robot, same, cause.part, cause.scale)


def _compared(
    cause: Cause, fitted: Fitted, matched: Cause | None, alone: Fit, data: Measurements
) -> tuple[ConfirmedCause, pd.DataFrame | None]:
    i = cause.joint - 1
    here, there = (m.joint_angles[:, i] for m in (fitted.data, data))
    unit, factor = data.robot.joints[i].shown
    error_unit = "urad" if unit == "deg" else "um"
    low, high = max(here.min(), there.min()), min(here.max(), there.max())
    common = max(float(high - low), 0.0)
    share = float(common / max(np.ptp(here), 1e-9))

    def told(words: str, **figures: float) -> ConfirmedCause:
        return ConfirmedCause(cause=cause.id, joint=cause.joint, common=factor * common, share_of_travel=share, words=words,
                              error_unit=error_unit, travel_unit=unit, **figures)  # fmt: skip

    if matched is None or high <= low:
        few = f"does not cover joint {cause.joint} densely enough to see it"
        none = f"has no reading of joint {cause.joint} within the travel that was seen here"
        return told(f"the other series {none if high <= low else few}"), None
    angle = np.linspace(low, high, GRID)
    amplitudes = fitted.fit.estimate[fitted.model.columns(cause)]
    other = alone.estimate[alone.model.columns(matched)]
    whole = [curve(c, v, angle) for c, v in ((cause, amplitudes), (matched, other))]
    first, second = (_beyond_first_order(values, angle) for values in whole)
    correlation = float(np.corrcoef(first, second)[0, 1])
    if correlation >= AGREE:
        words = "the independent series shows the same curve"
    elif share < WIDE:
        words = f"the two series have only {share:.0%} of the travel in common: too little to confirm or to contradict"
    elif correlation >= AGREE_MAINLY:
        words = "the two series agree in the main: a part of at least one curve belongs to something else"
    else:
        words = "the two series do not agree: at least one curve holds what belongs to something else"
    points = {
        "cause": cause.id, "joint": cause.joint, "travel": factor * angle, "here": 1e6 * first, "there": 1e6 * second,
        "error_unit": error_unit, "travel_unit": unit,
    }  # fmt: skip
    drawn = typed(pd.DataFrame(points), ConfirmedPoint)
    with_first_order = float(np.corrcoef(whole[0], whole[1])[0, 1])
    sizes = {"rms_here": 1e6 * float(first.std()), "rms_there": 1e6 * float(second.std())}
    return told(words, correlation=correlation, correlation_with_first_order=with_first_order, **sizes), drawn


def _beyond_first_order(values: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return a curve less its offset, slope and first harmonic, which the joint's zero, geometry and gravity can imitate."""
    imitated = np.column_stack([np.ones_like(angle), angle, np.cos(angle), np.sin(angle)])
    return np.asarray(values - imitated @ np.linalg.lstsq(imitated, values)[0])


def _covered(fitted: Fitted, causes: Sequence[Cause], other: Measurements) -> np.ndarray:
    """Return the mask of another series' rows within the travel on which the causes were fitted, shape (n_rows,)."""
    here, there = (m.joint_angles for m in (fitted.data, other))
    joints = [cause.joint - 1 for cause in causes]
    low, high = here.min(axis=0), here.max(axis=0)
    return np.asarray(((there >= low) & (there <= high))[:, joints].all(axis=1))


def _mean(fit: Fit, rows: Measurements) -> float:
    return 1e3 * float(np.nanmean(distances(errors(fit.model, fit.estimate, rows, METRE)))) if len(rows) else NAN
