"""The tables of causes: candidates with their detection limits, errors along the causes found, and models in reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calflow.diagnosis.amplitude import SIZE, amplitude, sizes
from calflow.diagnosis.diagnosis import Diagnosis
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.form_error import variable_values
from calflow.diagnosis.models_in_reach import Change, ModelInReach, probabilities
from calflow.diagnosis.noise_model import RANGE, Growth
from calflow.diagnosis.regressors import candidates_of
from calflow.diagnosis.screening import Score, by_place, f_threshold, place_probabilities
from calflow.diagnosis.trial import Screened
from calflow.effects import Effect, catalogue
from calflow.effects.base import NOTHING
from calflow.effects.cause import Cause
from calflow.estimation.accuracy import completed, error_jacobian, errors, judged_unit
from calflow.estimation.extrapolation import Curve
from calflow.estimation.parameters import UNIT
from calflow.estimation.smooth_functions import JointField
from calflow.files.deferred import pd
from calflow.files.tables import column, to_frame, typed
from calflow.measurements.measurements import Measurements
from calflow.observations import leading_units

NAN = float("nan")
POWER = 0.95
LEAST_SHOWN, MOST_SHOWN = 1e-3, 1e5  # bracket of the noncentrality
DRAWN = 256  # causes drawn from the prior for a limit
CLOSE = 1e-3  # relative precision of a limit
PARALLEL = 0.02  # share of an effect across its joint's direction, below which it counts as an error of that joint
ONLY = "-"  # stands for the form of a cause that has a single one


@dataclass(frozen=True, kw_only=True)
class CandidateRow:
    """A place of an effect in its best variant, by the first screening, or why it was not tested."""

    cause: str = column("id of the effect")
    joint: int | None = column("number of its joint or link; empty: none", default=None)
    statistic: float = column("reduction of chi²", default=NAN)
    p_family: float = column("family-wise p-value over all tests, by noise alone", default=NAN)
    delta_bic: float = column(
        "minus twice the log evidence, which BIC approximates: negative where the cause is favoured", default=NAN
    )
    probability: float = column("posterior probability of this place against the others and none", default=NAN)
    visible_share: float = column(
        "share of its effect that neither the model's parameters nor a background imitate", default=NAN
    )
    estimate: float = column(SIZE, UNIT, sd="sd", default=NAN)
    sd: float = column("standard deviation of the size", UNIT, default=NAN)
    unit: str = column("of the size (SI)", default="")
    limit: float = column(
        "the size that is detected 95 times in 100, to be compared with `estimate`; empty where no size would be",
        UNIT,
        default=NAN,
    )
    tests: float = column("equivalent number of tests by which its p-value is corrected", default=NAN)
    part: str = column("the part of the robot", default="")
    detail: str = column("the variant, in words", default="")
    note: str = column("why it was not tested, or how, in words", default="")
    lacking: str = column("what a test would need; empty: nothing", default="")
    asked: tuple[str, ...] = column("the names of what is lacking: `approach`, `time`, `masses`, …", default=())
    imitated: bool = column("not testable: the model's parameters imitate it", default=False)


def candidates_table(diagnosis: Diagnosis, data: Measurements, rng: np.random.Generator) -> pd.DataFrame:
    """Return diagnose/candidates.csv: every place in its best variant, by the first screening, and effects not tested."""
    first = diagnosis.first
    places = by_place(first.scores)
    probability = place_probabilities(places)
    ordered = sorted(places.items(), key=lambda item: item[1][0])
    limits = detection_limits([score for _, (_, score) in ordered], first, diagnosis.false_alarm, rng)
    rows = []
    for (place, (cost, score)), limit in zip(ordered, limits.tolist(), strict=True):
        cause, curve = score.cause, Curve.of(score.cause, score.estimate, score.covariance)
        estimate, sd = curve.rms_over_travel if curve else amplitude(cause, score.estimate, score.covariance)
        rows.append(
            CandidateRow(
                cause=cause.id, joint=cause.joint or None, statistic=score.drop, p_family=first.family.p(score),
                delta_bic=cost, probability=probability[place], visible_share=score.visible_share, estimate=estimate, sd=sd,
                unit=cause.declared[0].unit, limit=limit, tests=first.family.tests(score), part=cause.part, detail=cause.detail,
            )
        )  # fmt: skip
    imitated = "not testable: these data cannot show it, the model's own parameters imitate it"
    wanted = diagnosis.catalogue
    every = {candidate.cause.place: candidate.cause for candidate in candidates_of(wanted.effects)}
    rows += [
        CandidateRow(cause=cause.id, joint=cause.joint or None, part=cause.part, note=imitated, imitated=True)
        for place, cause in every.items() if place not in places
    ]  # fmt: skip
    untested = {**wanted.lacking, **wanted.superseded}
    rows += [
        _noise(kind, diagnosis.growth) for name, kind in catalogue().items() if kind.is_noise() and name not in untested
    ]
    for name in (name for name in catalogue() if name in untested):
        lacking, why = wanted.lacking.get(name, ""), wanted.superseded.get(name)
        note = f"not tested: {why}" if why else f"not testable: needs {lacking}"
        asked = catalogue()[name].asks(data.robot, data) if lacking else ()
        rows.append(CandidateRow(cause=name, note=note, lacking=lacking, asked=asked))
    return to_frame(rows, CandidateRow)


def _noise(kind: type[Effect], grown: Growth | None) -> CandidateRow:
    if kind.grows_with != RANGE:
        return CandidateRow(cause=kind.id, note=f"not testable: only noise that grows with {RANGE} is looked for")
    if grown is None:
        return CandidateRow(cause=kind.id, note=f"tested on the size of what is left: it does not grow with {RANGE}")
    return CandidateRow(cause=kind.id, p_family=grown.p, estimate=grown.slope, sd=grown.sd, unit="m/m")


def noncentrality(
    threshold: float | np.ndarray, degrees_of_freedom: int | np.ndarray, left: float | np.ndarray
) -> np.ndarray:
    """Return the noncentrality (…) at which F tests pass 95 times in 100; nan where too few degrees of freedom are left."""
    from scipy.optimize.elementwise import find_root

    roots = find_root(_missing_power, (LEAST_SHOWN, MOST_SHOWN), args=(threshold, degrees_of_freedom, left))
    return np.asarray(roots.x)


def _missing_power(
    shown: np.ndarray, threshold: float | np.ndarray, spent: float | np.ndarray, left: float | np.ndarray
) -> np.ndarray:
    return np.asarray(POWER - scipy.stats.ncf.sf(threshold, spent, left, shown))


def detection_limits(
    scores: Sequence[Score[Cause]], screened: Screened[Cause], false_alarm: float, rng: np.random.Generator
) -> np.ndarray:
    """Return the size of each cause at which it is detected 95 times in 100, in the unit of its first parameter, (n_scores,).

    Size is what findings state (`Effect.size`, of a curve the root mean square over its travel). One size of several parameters
    can show well or hardly, as a wave does by its phase: of causes of this size, with parameters in proportions drawn from their
    priors, 95 in 100 are significant and explain a material share of chi². nan where no size would be detected.
    """
    family, total = screened.family, screened.degrees_of_freedom
    tests, spent, left = np.array([(family.tests(score), score.shown, score.left) for score in scores]).reshape(-1, 3).T
    material = family.material / (1 - family.material) * (total - spent) / spent
    threshold = np.maximum(f_threshold(false_alarm, tests, spent, left), material)
    shown = [_shown_by_unit_size(score, rng) for score in scores]
    return np.array(list(map(_limit, shown, noncentrality(threshold, spent, left), threshold, spent, left)))


def _limit(shown: np.ndarray, needed: float, threshold: float, spent: float, left: float) -> float:
    """Return the size at which causes of noncentralities shown (n,) at size 1 pass 95 times in 100 on average."""
    if np.isnan(needed):
        return NAN
    low, high = (float(np.log(needed / end) / 2) for end in (shown.max(), shown.min()))
    if high - low < CLOSE:
        return float(np.exp(low))

    def missing(log_size: float) -> float:
        reached = np.minimum(np.exp(2 * log_size) * shown, MOST_SHOWN)
        return float(_missing_power(reached, threshold, spent, left).mean())

    return float(np.exp(scipy.optimize.brentq(missing, low, high, xtol=CLOSE)))


def _shown_by_unit_size(score: Score[Cause], rng: np.random.Generator) -> np.ndarray:
    """Return the noncentrality of causes of size 1 in the directions that the data show, their parameters drawn in proportion."""
    cause = score.cause
    sd = np.array([parameter.prior_sd for parameter in cause.declared])
    lower, upper = cause.bounds
    drawn = rng.standard_normal((DRAWN if len(sd) > 1 else 1, len(sd)))
    drawn = np.where(lower == 0, np.abs(drawn), np.where(upper == 0, -np.abs(drawn), drawn))
    values, vectors = np.linalg.eigh(score.information * np.outer(sd, sd))
    shown = (drawn @ vectors[:, -score.shown :]) ** 2 @ values[-score.shown :]
    return np.asarray(np.clip(shown / np.maximum(_sizes(cause, drawn * sd) ** 2, NOTHING), NOTHING, None))


def _sizes(cause: Cause, values: np.ndarray) -> np.ndarray:
    """Return the size of a cause for values of its parameters (n, n_parameters), as findings state it, (n,)."""
    travel = cause.effect.travel(cause.joint) if cause.joint else None
    if travel:
        return np.asarray(np.sqrt(np.einsum("ni,ij,nj->n", values, travel.products, values)))
    return np.abs(sizes(cause, values)[0])


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """A measured row's error along the direction in which a cause acts, with the variable that explains it."""

    finding: int = column("number of the cause among those in the extended model, from 1")
    cause: str = column("its id")
    joint: int | None = column("number of its joint or link; empty: none")
    variable: str = column("the variable that explains it, in words")
    variable_unit: str = column("of the variable; empty: none")
    x: float = column("the variable", "as `variable_unit` says")
    before: float = column("measured minus predicted, without this cause's contribution", "as `error_unit` says")
    after: float = column("the same with the whole extended model", "as `error_unit` says")
    fitted: float = column("the cause's contribution", "as `error_unit` says")
    pose: str = column("as in the measurements")
    split: str = column("train, holdout; empty: left out as faulty")
    error_unit: str = column("the unit by which the model is judged: mm, or where no lengths were measured mrad, px, …")


def curves(final: Fitted, causes: Sequence[Cause], data: Measurements) -> pd.DataFrame:
    """Return one row per measured row and finding: the error along the direction in which the cause moves the tool."""
    model, estimate = final.model, final.fit.estimate
    left = -np.nan_to_num(errors(model, estimate, data))
    model, estimate = completed(model, estimate, data)
    turned = replace(model, effects=(*model.effects, JointField(model.robot, orders=0)))
    whole = error_jacobian(turned, np.append(estimate, np.zeros(model.robot.n_joints)), data)
    jacobian, levers = np.split(whole, [len(estimate)], axis=2)
    unit = judged_unit(leading_units(data))
    blocks = []
    for cause in final.causes:
        columns = model.columns(cause)
        moved = jacobian[:, :, columns] @ estimate[columns]
        lever = levers[:, :, cause.joint - 1] if cause.joint else None
        along = _acting_along(jacobian[:, :, columns], estimate[columns], lever)
        variable = cause.effect.variable(cause.joint)
        x = variable.factor * variable_values(model, variable, data)
        after, fitted = (np.einsum("ra,ra->r", part, along) for part in (left, moved))
        block = {
            "finding": causes.index(cause) + 1, "cause": cause.id, "joint": cause.joint or None,
            "variable": variable.label, "variable_unit": variable.unit, "x": x,
            "before": unit.shown(after + fitted), "after": unit.shown(after), "fitted": unit.shown(fitted),
            "error_unit": unit.label,
            "pose": data.table["pose"], "split": data.table["split"],
        }  # fmt: skip
        blocks.append(typed(pd.DataFrame(block), CurvePoint))
    return pd.concat(blocks, ignore_index=True) if blocks else to_frame((), CurvePoint)


def _acting_along(jacobian: np.ndarray, value: np.ndarray, lever: np.ndarray | None) -> np.ndarray:
    """Return the unit vectors (n_rows, 3) along which a cause acts: the principal axes of its rows, with one common side.

    If all its parameters move the tool as its joint does, they are along the joint's lever (n_rows, 3), whose sign does not follow
    the effect, as else every error would look positive.
    """
    moved = jacobian * np.abs(value)
    if lever is not None:
        along = lever / np.maximum(np.linalg.norm(lever, axis=1), 1e-12)[:, None]
        apart = moved - along[:, :, None] * np.einsum("ra,rap->rp", along, moved)[:, None, :]
        if np.linalg.norm(apart) < PARALLEL * np.linalg.norm(moved):
            return along
    _, _, axes = np.linalg.svd(moved.transpose(0, 2, 1), full_matrices=False)
    along = axes[:, 0, :]
    mean = np.einsum("rap,rbp,rb->a", moved, moved, along)
    return along * np.where(along @ mean < 0, -1.0, 1.0)[:, None]


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """A model that may be right, by its causes, the likeliest first; no row where nothing was found."""

    model: int = column("its number; 1: the model found")
    change: Change = column(
        "its change of the model found: none, without a cause, with one instead of another, with one besides, or several of these"
    )
    causes: tuple[str, ...] = column("ids of its causes; empty: none")
    joints: tuple[int, ...] = column("the joint or link of each; 0: none")
    parts: tuple[str, ...] = column("the part of the robot that each is a cause of")
    details: tuple[str, ...] = column(
        "the form of each, in words, or that it was not tested; -: it has only one", separator="; "
    )
    log_evidence: float = column("log marginal likelihood, relative to the model that diagnose found")
    log_prior: float = column("log prior probability, relative to a model without causes")
    probability: float = column("posterior probability, if one of these models is right")


@dataclass(frozen=True, kw_only=True)
class CauseProbability:
    """A cause of any of these models, the likeliest first."""

    cause: str = column("id of the effect")
    joint: int | None = column("number of its joint or link; empty: none")
    part: str = column("the part of the robot")
    probability: float = column(
        "posterior probability that it acts, in any form and beside any others, if one of these models is right"
    )
    found: bool = column("whether diagnose put it into the model")


def models_table(models: Sequence[ModelInReach]) -> pd.DataFrame:
    """Return the table of `ModelRow`s of the models in reach, of which the first is the one found."""
    rows = [
        ModelRow(
            model=number, change=model.change, causes=tuple(cause.id for cause in model.causes),
            joints=tuple(cause.joint for cause in model.causes), parts=tuple(cause.part for cause in model.causes),
            details=tuple(cause.detail or ONLY for cause in model.causes),
            log_evidence=model.log_weight - model.log_prior + models[0].log_prior, log_prior=model.log_prior,
            probability=float(probability),
        )
        for number, (model, probability) in enumerate(zip(models, probabilities(models), strict=True), start=1)
    ]  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), ModelRow)


def cause_table(models: Sequence[ModelInReach]) -> pd.DataFrame:
    """Return the table of `CauseProbability`s of the models in reach, of which the first is the one found."""
    acting = {cause.place: cause for model in reversed(models) for cause in reversed(model.causes)}
    rows = []
    for place, cause in reversed(acting.items()):
        having = np.array([any(other.place == place for other in model.causes) for model in models])
        rows.append(
            CauseProbability(
                cause=cause.id, joint=cause.joint or None, part=cause.part,
                probability=float(probabilities(models)[having].sum()), found=bool(having[0]),
            )
        )  # fmt: skip
    return to_frame(sorted(rows, key=lambda row: -row.probability), CauseProbability)
