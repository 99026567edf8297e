"""The tables of a diagnosis: findings, best first, and every candidate that was tested.

The amplitude: one figure for what a cause does, and how sure it is, over all forms that explain the data as well.
The gain: what an extension is worth on rows that no fit has seen, with an interval.
A Gaussian process for what no cause explains: it predicts, without a physical meaning, and is never part of the model.

A decoy's waves with independent normal amplitudes of one size are a Gaussian process over its inputs that acts where the decoy
does (the weight-space view: Rasmussen and Williams 2006, 2.1). The size is that of the greatest marginal likelihood, the
noise's level integrated out.
The detection limit: how large a cause must be for these very data to show it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pandas as pd
from scipy.optimize import brentq
from scipy.stats import f as f_distribution
from scipy.stats import ncf

from calflow.diagnosis.findings.finding import NAN, Finding
from calflow.diagnosis.findings.misfit import POSE, Misfit, Remainder
from calflow.diagnosis.findings.rivals import FittedAlternative
from calflow.diagnosis.findings.verdict import Rival, Verdict, label
from calflow.diagnosis.screening.score import Score
from calflow.diagnosis.screening.screening import Family, Screening, by_place
from calflow.diagnosis.search.extension import Extended
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.linearisation import Detection
from calflow.diagnosis.search.noise_growth import RANGE, Growth
from calflow.diagnosis.search.trial import kindred
from calflow.effects import Effect, catalogue
from calflow.effects.cause import Cause
from calflow.effects.words import UNEXPLAINED, NamedCause
from calflow.estimation.accuracy import distances, error_jacobian, errors, judged_unit
from calflow.estimation.calibrated_model import ModelInReach
from calflow.estimation.parameters import UNIT
from calflow.files.tables import column, to_frame
from calflow.files.units import METRE
from calflow.measurements.columns import blocks_of
from calflow.measurements.measurements import Measurements
from calflow.observations import leading_units


def amplitude(cause: Cause, values: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Return one figure for a cause's parameters, and its standard deviation; a single parameter keeps its sign."""
    if len(values) == 1:
        return float(values[0]), float(np.sqrt(covariance[0, 0]))
    p = ca.SX.sym("p", len(values))
    size = cause.effect.size(p)
    figure, slope = (
        np.array(output).ravel() for output in ca.Function("size", [p], [size, ca.gradient(size, p)])(values)
    )
    return float(figure[0]), float(np.sqrt(slope @ covariance @ slope))


def found_amplitude(finding: Detection, fitted: Fitted) -> tuple[float, float]:
    """Return a found cause's amplitude in the final model, and its standard deviation whatever its form may be.

    Another form in its place (another order, say) can explain the data as well with another amplitude. Each form counts by its
    evidence (Bayesian model averaging: Hoeting et al. 1999), about the estimate of the best one.
    """
    cause = finding.cause
    columns = fitted.model.columns(cause)
    estimate, sd = amplitude(cause, fitted.fit.estimate[columns], fitted.covariance[np.ix_(columns, columns)])
    if sd == 0:
        return estimate, sd  # at a bound
    forms = [score for score in finding.scores if score.cause.place == cause.place]
    others = [s for s in forms if s.cause != cause and same_quantities(s.cause, cause)]
    least = min(score.delta_bic for score in forms)
    variances, weights = [sd**2], [np.exp((least - finding.own.delta_bic) / 2)]
    for score in others:
        other, other_sd = amplitude(score.cause, score.estimate, score.covariance)
        variances.append(other_sd**2 + (other - estimate) ** 2)
        weights.append(np.exp((least - score.delta_bic) / 2))
    return estimate, float(np.sqrt(np.average(variances, weights=weights)))


def same_quantities(cause: Cause, other: Cause) -> bool:
    """Whether the parameters of two forms of a cause mean the same."""
    first, second = ([(p.symbol, p.unit) for p in form.declared] for form in (cause, other))
    return first == second


RESAMPLES = 2000
INTERVAL = (0.025, 0.975)


@dataclass(frozen=True)
class Gain:
    """By how much the mean position error falls [m], and its 95 % interval; nan where nothing is held out."""

    mean: float
    low: float
    high: float


def gain(before: np.ndarray, after: np.ndarray, heldout: Measurements, rng: np.random.Generator) -> Gain:
    """Compare two models' `errors` (n_rows, n_axes) on held-out rows, resampling whole poses (within payload and session)."""
    fallen = distances(before) - distances(after)
    there = np.isfinite(fallen)
    if not there.any():
        return Gain(np.nan, np.nan, np.nan)
    blocks, fallen = blocks_of(heldout.table), fallen[there]
    table = heldout.table.loc[there, ["pose", *blocks]].assign(fallen=fallen)
    poses = table.groupby("pose", sort=True).agg(
        total=("fallen", "sum"), n=("fallen", "size"), **{name: (name, "first") for name in blocks}
    )
    total, count = np.zeros(RESAMPLES), np.zeros(RESAMPLES)
    for _, group in poses.groupby(blocks, sort=True):
        drawn = rng.integers(len(group), size=(RESAMPLES, len(group)))
        total += group["total"].to_numpy()[drawn].sum(axis=1)
        count += group["n"].to_numpy()[drawn].sum(axis=1)
    low, high = np.quantile(total / count, INTERVAL)
    return Gain(float(fallen.mean()), float(low), float(high))


SIZES = np.concatenate([[0.0], np.geomspace(0.01, 10.0, 61)])  # over the prior's, that are tried


def predicted(fitted: Fitted, decoys: Sequence[Effect], data: Measurements) -> np.ndarray:
    """Return by how much the process moves what is predicted of rows, shape (n_rows, 3) [m]: see `errors`.

    The model's own parameters settle beside it, as far as their priors let them.
    """
    regressors = replace(fitted, background=None).regressors(decoys)
    amplitudes = _amplitudes(Screening(regressors)) * regressors.prior_sd
    jacobian = regressors.jacobian
    imitated = jacobian.T @ regressors.matrix.times(amplitudes)
    settled = -np.linalg.solve(jacobian.T @ jacobian + np.diag(regressors.precision), imitated)
    model, fit = fitted.model, fitted.fit
    both = replace(model, probes=tuple(decoys))
    change = np.zeros(len(both.parameters))
    change[np.flatnonzero(~fit.at_bound)] = settled
    change[len(fit.estimate) :] = amplitudes
    at = np.append(fit.estimate, both.nominal[len(fit.estimate) :])
    return error_jacobian(both, at, data) @ change


def _amplitudes(screening: Screening) -> np.ndarray:
    """The most probable amplitudes of all columns, over their priors."""
    sd = screening.regressors.prior_sd
    shown = screening.information(np.arange(len(sd))) * sd[:, None] * sd
    values, vectors = np.linalg.eigh(shown)
    values = np.maximum(values, 0.0)
    score = vectors.T @ (screening.score * sd)
    square = SIZES[:, None] ** 2
    kept = square / (1 + square * values)  # (n_sizes, n_columns)
    drop = kept @ score**2
    evidence = -0.5 * (
        screening.degrees_of_freedom * np.log1p(-np.minimum(drop / screening.chi2, 1 - 1e-12))
        + np.log1p(square * values).sum(axis=1)
    )
    return np.asarray(-vectors @ (kept[int(np.argmax(evidence))] * score))


POWER = 0.95
MOST = 1e5  # squared sigmas


def noncentrality(false_alarm: float, tests: float, degrees_of_freedom: int, left: float) -> float:
    """Return the squared sigmas that an effect must show for its F test to pass 95 times in 100.

    tests is how many it pays for at the family's false_alarm, freedom and left the degrees of freedom. nan where so few are
    left that no effect would.
    """
    single = -np.expm1(np.log1p(-false_alarm) / tests)
    threshold = f_distribution.isf(single, degrees_of_freedom, left)
    if not ncf.sf(threshold, degrees_of_freedom, left, MOST) > POWER:
        return float("nan")
    return float(brentq(lambda shown: ncf.sf(threshold, degrees_of_freedom, left, shown) - POWER, 1e-3, MOST))


def detection_limit(score: Score[Cause], family: Family, false_alarm: float) -> float:
    """Return the least size of a cause, in the unit of its first parameter, that is found 95 times in 100.

    Several parameters are taken in proportion to their priors, in directions that the data show on average.
    """
    declared = score.cause.declared
    sd = np.array([parameter.prior_sd for parameter in declared])
    same = np.array([parameter.unit == declared[0].unit for parameter in declared])
    shown = float(np.diag(score.information) @ sd**2 / (sd[same] @ sd[same]))
    needed = noncentrality(false_alarm, family.tests(score), score.shown, score.left)
    return float(np.sqrt(needed / shown))


IN_TIME = {"time", "order"}  # the inputs that causes of the measuring device depend on


@dataclass(frozen=True, kw_only=True)
class CandidateRow:
    """A place of an effect in its best variant, as first tested, or why it was not tested."""

    cause: str = column("id of the effect")
    joint: int | None = column("number of its joint or link; empty: none", default=None)
    statistic: float = column("fall of chi²", default=NAN)
    p_family: float = column("chance that noise alone makes any of all tests look like this", default=NAN)
    delta_bic: float = column("change of BIC: below 0 it explains more than its parameters cost", default=NAN)
    probability: float = column("that it is this place rather than another, or nothing", default=NAN)
    visible_share: float = column("what the model's own parameters cannot imitate", default=NAN)
    estimate: float = column("its size", UNIT, sd="sd", default=NAN)
    sd: float = column("standard deviation of the size", UNIT, default=NAN)
    unit: str = column("of the size (SI)", default="")
    limit: float = column(
        "the least size that these data show 95 times in 100; empty where no size would", UNIT, default=NAN
    )
    tests: float = column("tests that it pays for", default=NAN)
    part: str = column("the part of the robot", default="")
    detail: str = column("the variant, in words", default="")
    note: str = column("why it was not tested, or how, in words", default="")
    lacking: str = column("what a test would need; empty: nothing", default="")
    imitated: bool = column("not testable: the model's own parameters imitate it", default=False)


@dataclass(frozen=True)
class Diagnosis:
    """All that was found: the model to start from, its extension, a verdict a finding, and what is left.

    growth is the noise's with range where there is one; lacking and superseded say by id why an effect was not tested;
    false_alarm is what causes were allowed; misfit is the extended model's lack of fit where that is significant; capped
    says that as many causes were found as were allowed; alternatives are the rivals' models that are about as probable, in_reach
    the models one step from what was found that may be right as well.
    """

    start: Fitted
    extended: Extended
    verdicts: tuple[Verdict, ...]
    left: tuple[Remainder, ...]
    growth: Growth | None
    lacking: Mapping[str, str]
    superseded: Mapping[str, str]
    false_alarm: float
    misfit: Misfit | None = None
    capped: bool = False
    alternatives: tuple[FittedAlternative, ...] = ()
    in_reach: tuple[ModelInReach, ...] = ()

    @property
    def causes(self) -> list[Cause]:
        """The causes found, in the order of the findings."""
        return [verdict.finding.cause for verdict in self.verdicts]


def findings(
    found: Diagnosis, data: Measurements, faults: pd.DataFrame, rng: np.random.Generator
) -> tuple[Finding, ...]:
    """Return what was found, best first: data faults, causes, the noise's growth and what nobody can name."""
    heldout, final = data.only(data.held_out), found.extended.fitted
    rows = [_fault(group) for _, group in faults.groupby(["cause", "joint", "action", "statement"], sort=False)]
    steps = [errors(one.model, one.estimate, heldout) for one in (found.start.fit, *found.extended.path)]
    for members in _kept_together(found.causes):
        own = [_cause(found.verdicts[k], final, _overlapping(found.verdicts[k], found.left), k + 1) for k in members]
        row = own[0] if len(own) == 1 else _together(own, [found.verdicts[k] for k in members])
        before = steps[members[0]]
        after = before + sum(steps[k + 1] - steps[k] for k in members)
        rows.append(_gained(row, before, after, heldout, rng))
    if found.capped and found.verdicts:
        more = f"; with it as many causes were found as were allowed ({len(found.verdicts)}): there may be more"
        rows[-1] = replace(rows[-1], statement=rows[-1].statement + more)
    if found.growth:
        rows.append(_growth(found.growth))
    if found.misfit:
        rows.append(_misfit(found.misfit, found.left))
    for remainder in found.left:
        after = steps[-1] + predicted(final, remainder.functions, heldout)
        rows.append(_gained(_left(remainder), steps[-1], after, heldout, rng))
    return tuple(rows)


def _gained(
    row: Finding, before: np.ndarray, after: np.ndarray, heldout: Measurements, rng: np.random.Generator
) -> Finding:
    gained = gain(before, after, heldout, rng)
    mean = float(np.nanmean(distances(after))) if len(after) else NAN
    unit = judged_unit(leading_units(heldout))
    figures = {"gain_mean": gained.mean, "gain_low": gained.low, "gain_high": gained.high, "heldout_mean": mean}
    suffix = "_mm" if unit == METRE else ""
    shown = {f"{name}{suffix}": unit.shown(figure) for name, figure in figures.items()}
    return replace(row, error_unit=unit.label, **shown)


def candidates_table(diagnosis: Diagnosis) -> pd.DataFrame:
    """Return diagnose/candidates.csv: every place in its best variant, as first tested, and what could not be tested."""
    first = diagnosis.extended.first
    places = by_place(first.scores)
    least = min((bic for bic, _ in places.values()), default=0.0)
    weights = {place: np.exp(-(bic - least) / 2) for place, (bic, _) in places.items()}
    total = sum(weights.values()) + np.exp(least / 2)  # nothing at all is a candidate too
    rows = []
    for place, (bic, score) in sorted(places.items(), key=lambda item: item[1][0]):
        tested = _score(score)
        rows.append(
            replace(
                tested,
                p_family=first.family.p(score),
                delta_bic=bic,
                probability=weights[place] / total,
                limit=detection_limit(score, first.family, diagnosis.false_alarm),
                tests=first.family.tests(score),
            )
        )
    imitated = "not testable: these data cannot show it, the model's own parameters imitate it"
    for cause in first.hidden:
        rows.append(
            CandidateRow(cause=cause.id, joint=cause.joint or None, part=cause.part, note=imitated, imitated=True)
        )
    untested = {**diagnosis.lacking, **diagnosis.superseded}
    rows += [
        _noise(kind, diagnosis.growth) for name, kind in catalogue().items() if kind.is_noise() and name not in untested
    ]
    for name in (name for name in catalogue() if name in untested):
        lacking, why = diagnosis.lacking.get(name, ""), diagnosis.superseded.get(name)
        note = f"not tested: {why}" if why else f"not testable: needs {lacking}"
        rows.append(CandidateRow(cause=name, note=note, lacking=lacking))
    return to_frame(rows, CandidateRow)


def _noise(kind: type[Effect], grown: Growth | None) -> CandidateRow:
    """One model of the noise: growth with range is what is tested."""
    if kind.grows_with != RANGE:
        return CandidateRow(cause=kind.id, note=f"not testable: only noise that grows with {RANGE} is looked for")
    if grown is None:
        return CandidateRow(cause=kind.id, note=f"tested on the size of what is left: it does not grow with {RANGE}")
    return CandidateRow(cause=kind.id, p_family=grown.p, estimate=grown.slope, sd=grown.sd, unit="m/m")


def _score(score: Score) -> CandidateRow:
    estimate, sd = amplitude(score.cause, score.estimate, score.covariance)
    return CandidateRow(
        cause=score.cause.id, joint=score.cause.joint or None, statistic=score.drop, visible_share=score.visible_share,
        estimate=estimate, sd=sd, unit=score.cause.declared[0].unit, part=score.cause.part, detail=score.cause.detail,
    )  # fmt: skip


def _kept_together(causes: Sequence[Cause]) -> list[list[int]]:
    """Number the causes (from 0) in the order found, those of one family at one place together."""
    kin = {id(cause): members for members in kindred(causes).values() for cause in members}
    told = [[causes.index(one) for one in kin.get(id(cause), [cause])] for cause in causes]
    return [members for k, members in enumerate(told) if members[0] == k]


def _together(rows: Sequence[Finding], verdicts: Sequence[Verdict]) -> Finding:
    """One row of several causes of a family at one place: named by the family, best described as the one that explains most."""
    order = sorted(range(len(rows)), key=lambda k: verdicts[k].finding.own.delta_bic)
    lead, causes = rows[order[0]], [verdicts[k].finding.cause for k in order]
    family, where = causes[0].effect.family, f", {_place(causes[0])}" if causes[0].joint else ""
    kin = {(name, causes[0].joint) for name in (causes[0].id, *_relatives(causes[0]))}
    rivals = {(rival.id, rival.joint): rival for verdict in verdicts for rival in verdict.rivals}
    others = [rival for place, rival in rivals.items() if place not in kin]
    alike = dict.fromkeys([*(name for row in rows for name in row.cannot_tell_from), *_relatives(causes[0])])
    same = [row for row in rows if row.unit == lead.unit]
    size = float(np.sqrt(sum(row.estimate**2 for row in same)))
    sd = float(np.sqrt(sum((row.estimate * row.sd) ** 2 for row in same))) / size
    names = [f"{cause.title} ({cause.detail})" if cause.detail else cause.title for cause in causes]
    carried = [row.carries_over for row in rows]
    return replace(
        lead, status="one_of", estimate=size, sd=sd, p_family=min(row.p_family for row in rows),
        probability=min(row.probability for row in rows), cannot_tell_from=tuple(name for name in alike if name != lead.cause),
        detail=", with ".join([lead.detail or causes[0].title, *names[1:]]),
        rivals=tuple(NamedCause(rival.id, rival.joint) for rival in others), statement=f"{family}{where}: {', and '.join(names)}",
        not_tested=tuple(dict.fromkeys(name for row in rows for name in row.not_tested)),
        carries_over=False if False in carried else None if None in carried else True,
        numbers=tuple(number for row in rows for number in row.numbers),
    )  # fmt: skip


def _cause(verdict: Verdict, fitted: Fitted, left: Remainder | None, number: int) -> Finding:
    """One finding's row; left is what nobody can name along the same input, which makes a certain name uncertain."""
    cause = verdict.finding.cause
    estimate, sd = found_amplitude(verdict.finding, fitted)
    others = list(
        dict.fromkeys(rival.id for rival in verdict.rivals if rival.id != cause.id or rival.joint != cause.joint)
    )
    if left:
        others += [name for name in _relatives(cause) or [UNEXPLAINED] if name not in others]
    return Finding(
        status="one_of" if others else verdict.status, cause=cause.id, joint=cause.joint or None, estimate=estimate,
        sd=sd if sd > 0 else NAN, unit=cause.declared[0].unit, p_family=verdict.finding.p, probability=verdict.probability,
        cannot_tell_from=tuple(others), detail=cause.detail,
        rivals=tuple(NamedCause(rival.id, rival.joint) for rival in verdict.rivals),
        statement=_statement(verdict, left) + _carried(verdict),
        not_tested=tuple(dict.fromkeys(rival.id for rival in verdict.rivals if rival.score is None)),
        carries_over=verdict.carries_over, numbers=(number,),
    )  # fmt: skip


def _statement(verdict: Verdict, left: Remainder | None) -> str:
    cause = verdict.finding.cause
    where = f", {_place(cause)}" if cause.joint else ""
    detail = f" ({cause.detail})" if cause.detail else ""
    form = "order" if cause.joint else "course"
    if left and cause.effect.family:
        more = f"more of it is left than {cause.title}{detail} explains"
        return f"{cause.effect.family}{where}: {form} not resolved, {more}"
    if left:
        return f"{cause.title}{where}{detail}, or what stays unexplained ({' and '.join(left.inputs)})"
    if verdict.family:
        return f"{verdict.family}{where}: {form} not resolved, best {cause.title}{detail}"
    if verdict.rivals:
        return f"{cause.title}{where}{detail}, or {', or '.join(map(_told, verdict.rivals))}"
    return f"{cause.title}{where}{detail}"


def _carried(verdict: Verdict) -> str:
    return "; it does not carry over to poses that were left out" if verdict.carries_over is False else ""


def _told(rival: Rival) -> str:
    """Name a rival; one that the data could not test with what that would take."""
    said = label(rival.id, rival.joint)
    return f"{said} (not tested: needs {rival.needs})" if rival.needs else said


def _place(cause: Cause) -> str:
    return f"{cause.effect.place_word} {cause.joint}" if cause.joint else ""


def _overlapping(verdict: Verdict, left: tuple[Remainder, ...]) -> Remainder | None:
    """What is left along the input that a cause depends on: its joint, the course of the measurement, or the payload."""
    cause = verdict.finding.cause
    inputs = {f"q{cause.joint}"} if cause.joint else IN_TIME if cause.effect.of_device() else set()
    inputs = inputs | {"payload"} if "payload" in cause.effect.needs else inputs
    return next((remainder for remainder in left if inputs & set(remainder.inputs)), None)


def _relatives(cause: Cause) -> list[str]:
    """The other members of a cause's family, if it has one."""
    family = cause.effect.family
    return [name for name, kind in catalogue().items() if family and kind.family == family and name != cause.id]


def _growth(grown: Growth) -> Finding:
    kind = next(kind for kind in catalogue().values() if kind.grows_with == RANGE)
    return Finding(
        status="named", cause=kind.id, estimate=grown.slope, sd=grown.sd, unit="m/m", p_family=grown.p,
        probability=1 - grown.p, statement=f"{kind.title}: {1e6 * grown.floor:.3g} um and {1e6 * grown.slope:.3g} um/m",
    )  # fmt: skip


def _misfit(misfit: Misfit, left: tuple[Remainder, ...]) -> Finding:
    why = (
        "only a part of it depends on an input" if left else "no cause of the catalogue and no single input explains it"
    )
    where = misfit.region.words if misfit.region else "about alike everywhere"
    said = f"the model leaves {misfit.times:.2f} times the noise (chance of so much: {misfit.p:.2g}); {why}; {where}"
    return Finding(
        status="unexplained", p_family=misfit.p, detail=misfit.region.where if misfit.region else "", statement=said
    )


def _left(remainder: Remainder) -> Finding:
    inputs, detail = " and ".join(remainder.inputs), remainder.detail
    said = f"depends on {inputs}{f' ({detail})' if detail else ''}; no cause of the catalogue explains it"
    if remainder.inputs == (POSE,):
        said = "the rows of a pose share an error that changes from pose to pose, more than their own scatter explains"
    return Finding(status="unexplained", p_family=remainder.p, detail=detail, statement=said, inputs=remainder.inputs)


def _fault(group: pd.DataFrame) -> Finding:
    first, lines = group.iloc[0], tuple(group["line"].dropna().astype(int))
    return Finding(
        status="data_fault",
        cause=first["cause"],
        joint=first["joint"] or None,
        rows=lines,
        statement=first["statement"],
    )
