"""The diagnosis: a search for the causes that the identified model lacks, each weighed against its rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from calflow.diagnosis import FALSE_ALARM
from calflow.diagnosis.alternatives import fitted_alternatives
from calflow.diagnosis.background import BackgroundBasis
from calflow.diagnosis.extension import FittedTrial, extend, largest_first, unnamed, weighed, weighed_against
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.misfit import MisfitRegion, largest_misfit
from calflow.diagnosis.models_in_reach import ModelInReach, models_in_reach
from calflow.diagnosis.noise_model import Growth, NoiseLevels, noise_of_repeats, noise_of_residuals
from calflow.diagnosis.screening import Catalogue
from calflow.diagnosis.standstills import Standstills
from calflow.diagnosis.stepwise import SHARES, CauseAcceptance, Stepwise, words
from calflow.diagnosis.trial import Screened
from calflow.diagnosis.unexplained import UnexplainedStructure, share_unnamed, suspected, unexplained
from calflow.diagnosis.verdict import Verdict, deployed_model, no_surer_than_its_size, verdict
from calflow.effects.cause import Cause
from calflow.estimation.accuracy import Accuracy, accuracy, leading_errors
from calflow.estimation.calibrated_model import Alternative, CalibratedModel, series_noise
from calflow.estimation.fit import Fit
from calflow.estimation.leverage import UNSURE
from calflow.estimation.model_tables import FitSummary, fit_figures
from calflow.estimation.needed_conditions import needed_conditions
from calflow.estimation.noise import Noise, averaged, repeats_scatter
from calflow.estimation.progress import SAME, Advance, Draws, Say, nobody
from calflow.files.deferred import pd
from calflow.files.tables import column, to_frame
from calflow.files.units import METRE
from calflow.measurements.measurements import Measurements

BEGUN, SEARCHED = 0.1, 0.7  # share of the work before and after the search


@dataclass(frozen=True)
class Diagnosis:
    """The result of a search: the initial model, its extension, the model to be used with the verdicts, and the remaining misfit.

    first: the screening of the initial model; extended: the model with all causes; final: the model to be used (None: the
    identified one as it is); verdicts: one per finding, those in the model to be used, then those that are only suspected; left:
    errors of the extended model that no cause explains; noise: noise otherwise than stated; catalogue: the effects that were
    tested; false_alarm: false-alarm rate of the causes; worst: where the extended model's lack of fit is largest; capped:
    whether as many causes were found as were allowed; alternatives: models with rivals in the causes' places; in_reach: models one
    step from the extended one, by probability.
    """

    start: Fitted
    first: Screened[Cause]
    extended: Fitted
    final: Fitted | None
    verdicts: tuple[Verdict, ...]
    left: tuple[UnexplainedStructure, ...]
    noise: Growth | NoiseLevels | None
    catalogue: Catalogue
    false_alarm: float
    worst: MisfitRegion | None = None
    capped: bool = False
    alternatives: tuple[Alternative, ...] = ()
    in_reach: tuple[ModelInReach, ...] = ()

    @property
    def growth(self) -> Growth | None:
        return self.noise if isinstance(self.noise, Growth) else None

    @property
    def levels(self) -> NoiseLevels | None:
        return self.noise if isinstance(self.noise, NoiseLevels) else None

    @property
    def upper_limit(self) -> float:
        """Upper 95 % confidence limit of the error at new poses [m]; nan where it is unknown.

        It is no less than that of the model without a cause in whose place, by the evidence, an unnamed error acts with more than
        5 %. Nor does the noise tell how large errors are where another model is as probable.
        """
        final = self.final or self.extended
        unnamed = {verdict.cause: verdict.of_unnamed for verdict in self.verdicts[: self.n_deployed]}
        doubted = [cause for cause, probability in unnamed.items() if probability > UNSURE]
        without = [final.with_causes([cause for cause in final.causes if cause != gone]) for gone in doubted]
        others = sum(other.probability for other in self.alternatives if other.rival) + sum(unnamed.values())
        sure = final.noise.known and others <= UNSURE
        return max(fitted.left_out.upper_limit(sure) for fitted in (final, *without))

    @property
    def n_deployed(self) -> int:
        """Number of the causes in the model to be used, which come first."""
        return len(self.final.causes) if self.final else 0

    @property
    def path(self) -> tuple[Fit, ...]:
        """The fits with the first causes, one per finding; those of the model to be used and of the last are final."""
        final = {len(fitted.causes): fitted.fit for fitted in (self.extended, self.final) if fitted}
        numbers = range(1, len(self.causes) + 1)
        return tuple(final.get(k) or self.extended.with_causes(self.causes[:k]).fit for k in numbers)

    @property
    def causes(self) -> list[Cause]:
        """The causes found, in the order of the findings."""
        return [verdict.cause for verdict in self.verdicts]


@dataclass(frozen=True, kw_only=True)
class DiagnosisSummary(FitSummary):
    """The result of diagnose: noise and lack of fit of the extended model, and the extent of the search."""

    reduced_chi2_before: float | None = column("that of the study's model; null: the noise was estimated from the fit")
    causes_tested: int = column("number of places of effects that were tested")
    tests: float = column("equivalent number of independent tests")
    worst: MisfitRegion | None = column(
        "where the extended model's lack of fit is largest, along the inputs of unexplained structure if there is any; "
        "null: no lack of fit, or about the same everywhere",
        default=None,
    )
    capped: bool = column("whether as many causes were found as were allowed, so that there may be more", default=False)

    @property
    def unseen(self) -> str:
        """The statement that an unknown noise hides a lack of fit; empty where the noise is known."""
        if self.noise_known:
            return ""
        return (
            "the noise was estimated from the fit, so a gap in the model cannot be seen beside it. Only errors that follow joints, "
            "pairs of joints, place or time could be seen"
        )


def extended_model(diagnosis: Diagnosis, calibrated: CalibratedModel, data: Measurements) -> CalibratedModel:
    """Return the model to be used as a calibrated model for later stages; calibrated is the identified one."""
    kept: dict[str, Any] = {field.name: getattr(calibrated, field.name) for field in fields(CalibratedModel)}
    identified = CalibratedModel(**kept | {"alternatives": diagnosis.alternatives, "field": None})
    if (final := diagnosis.final) is None:
        return identified
    devices = series_noise(_noise(diagnosis, final, calibrated, data), data)
    return replace(
        identified,
        model=final.model,
        estimate=final.fit.estimate,
        covariance=final.covariance,
        at_bound=final.fit.at_bound,
        device=diagnosis.noise.devices(devices, data) if diagnosis.noise else devices,
        discrepancy=final.noise.discrepancy,
        loss=final.fit.loss,
        errors=final.errors,
        intraclass=final.intraclass,
        needed=needed_conditions(final.model, final.fit.estimate, data),
    )


def accuracy_table(diagnosis: Diagnosis, data: Measurements, before: Sequence[Accuracy]) -> pd.DataFrame:
    """Return the previous models' accuracy, and a step for each deployed cause, by the rows of which it is decided whether it acts.

    Without a cause the last of the previous models is the one that was fitted again with the noise found.
    """
    name, step, rows = before[-1].model, before[-1].step, list(before)
    if diagnosis.final and not diagnosis.n_deployed:
        model, last = diagnosis.final.model, before[-1].effect
        added = next((effect for effect in model.effects if effect.id == last), None)
        error = leading_errors(model, diagnosis.final.fit.estimate, data)
        rows = [row for row in rows if row.step != step] + accuracy(name, error, data, step, added)
    deployed = zip(diagnosis.causes[: diagnosis.n_deployed], diagnosis.path, strict=False)
    for k, (cause, fit) in enumerate(deployed, start=step + 1):
        name += f" + {cause.id} {cause.part}"
        error = leading_errors(fit.model, fit.estimate, data)
        error[fit.model.undecided(data)] = np.nan
        rows += accuracy(name, error, data, k, cause)
    return to_frame(rows, Accuracy)


def diagnosis_summary(diagnosis: Diagnosis, calibrated: CalibratedModel, extended: CalibratedModel) -> DiagnosisSummary:
    """Return the figures of `diagnose/summary.json`, given the identified model and the extended one (see `extended_model`)."""
    final, first = diagnosis.final or diagnosis.extended, diagnosis.start
    sigma = diagnosis.growth.floor if diagnosis.growth else calibrated.device[0].sigma
    if final.noise.sources[0] == "estimated" and not diagnosis.growth:
        sigma = float(np.median(final.noise.sigma[final.noise.of_series(0)]))
    return DiagnosisSummary(
        sigma_mm=1e3 * sigma if final.noise.leading[0] == METRE else None,
        **fit_figures(final.fit, extended, final.lack, final.left_out.at_new_poses, diagnosis.upper_limit),
        reduced_chi2_before=first.lack.reduced_chi2 if first.noise.known else None,
        causes_tested=len({score.cause.place for score in diagnosis.first.scores}),
        tests=diagnosis.first.family.places,
        worst=diagnosis.worst,
        capped=diagnosis.capped,
        noise_doubts=tuple(diagnosis.levels.doubts(first.data, calibrated.noise(first.data)))
        if diagnosis.levels
        else (),
    )


def _noise(diagnosis: Diagnosis, final: Fitted, calibrated: CalibratedModel, data: Measurements) -> Noise:
    noise = calibrated.noise(data)
    sigma, fitted = noise.sigma.copy(), final.noise.sigma
    alike = fitted / diagnosis.levels.factor(final.data) if diagnosis.levels else fitted
    for k, source in enumerate(noise.sources):
        if source == "estimated":
            sigma[noise.of_series(k)] = np.median(alike[final.noise.of_series(k)])
    return replace(noise, sigma=sigma)


@threadpool_limits.wrap(limits=1, user_api="blas")  # an arm's matrices are too small for threads to pay
def search_causes(
    calibrated: CalibratedModel,
    data: Measurements,
    *,
    false_alarm: float = FALSE_ALARM,
    causes: int = 10,
    catalogue: tuple[str, ...] = (),
    leave_out: tuple[str, ...] = (),
    rng: Draws = SAME,
    say: Say = nobody,
    advance: Advance = nobody,
) -> Diagnosis:
    """Extend the identified model by causes on the training rows, and weigh these against their rivals.

    Args:
        calibrated: the identified model.
        data: the rows it was identified from, with the registered robot to which its errors refer.
        false_alarm: probability of any finding where the model lacks nothing.
        causes: largest number of causes to add.
        catalogue: ids of the effects to test; empty: all.
        leave_out: ids of effects not to test.
        rng: draws the bootstrap and the decoys.
        say: receives a line for each step.
        advance: receives the share of work done.
    """
    train = data.only(data.train)
    scattered = repeats_scatter(train, leading_errors(calibrated.model, calibrated.estimate, train))
    train, noise = averaged(train, replace(calibrated.noise(train), scatter=scattered))
    start = Fitted.of(calibrated, train, noise)
    alarm = SHARES["noise"] * false_alarm
    if (other := noise_of_repeats(start)) and other.p >= alarm:
        other = None
    start = start.weighed(other.sigma(train, start.device)) if other else start
    have = [effect.id for effect in calibrated.model.effects]
    wanted = Catalogue.of(train, have, catalogue, leave_out)
    advance(BEGUN)
    acceptance = CauseAcceptance(SHARES["causes"] * false_alarm, causes)
    search = Stepwise(acceptance, rng("bootstrap"), say, lambda share: advance(BEGUN + share * (SEARCHED - BEGUN)))
    searched = extend(start, wanted, search)
    basis, first = BackgroundBasis.of(start), searched.first
    search = replace(search, rng=rng("background"), advance=nobody)
    ended, findings = weighed(start, searched, basis, wanted, search)
    extended = ended.fitted
    advance(SEARCHED)
    standstills = Standstills.of(extended, basis)
    significance = SHARES["unexplained"] * false_alarm
    shown = None if other else noise_of_residuals(extended)
    # Errors of joints that do not repeat also grow with range: they must be significant beside such noise, and it without them.
    if shown and (shown.p < alarm or len(standstills.joints)):
        noisier = extended.weighed(shown.sigma(train, start.device))
        standstills = Standstills.of(noisier, basis)
        if shown.p < alarm and not (standstills.p < significance).any():
            extended, other = noisier, shown.levelled(noisier)
    if other:
        say(f"{other.words}, p = {other.p:.2g}")
    at_rest = standstills.at_rest(significance)
    if at_rest and standstills.background is not None:
        # Of very many forms, one fits errors that differ from standstill to standstill.
        against = unnamed(standstills.fitted, basis, wanted.variants, varying=standstills.varying)
        findings = tuple(replace(each, unnamed=min(each.unnamed, against[each.cause])) for each in findings)
    left = unexplained(extended, significance, rng("decoys"), say, at_rest, standstills.background)
    every = Catalogue.of(train, have) if catalogue or leave_out else wanted
    if every is not wanted or extended is not ended.fitted:
        ended = FittedTrial(first, extended, every)
    if findings and every is not wanted:
        findings = weighed_against(findings, ended)
    advance(0.8)
    beside = ended.linearisation.beside.scores if left or findings else ()
    sized = [no_surer_than_its_size(finding, extended) for finding in largest_first(findings, extended.fit)]
    judged = [verdict(finding, every.untestable(finding.cause.id)) for finding in sized]
    otherwise = judged or other or (extended.outlier_factor > 1).any()
    final = deployed_model(extended, judged) if otherwise else None
    # The search takes markers of a standstill as independent.
    final = final and final.sharing()
    in_use = final.causes if final else ()
    deployed = [verdict for verdict in judged if verdict.cause in in_use]
    suspects = [verdict for verdict in judged if verdict.cause not in in_use]
    for suspect in suspects:
        say(f"{words(suspect.cause)} remains a suspicion: it does not help at poses left out")
    ordered = (*deployed, *suspects)
    in_reach = models_in_reach(extended, ordered, beside, every, suspects)
    unnamed_by_left = {verdict.cause: share_unnamed(verdict, extended.model, left) for verdict in deployed}
    alternatives = fitted_alternatives(deployed, extended, suspects, in_reach, unnamed_by_left)
    doubted = {
        other.gone: other.probability
        for other in alternatives
        if other.gone and not other.rival and not other.gone.of_measuring()
    }
    along = {name for structure in left for name in structure.inputs}
    return Diagnosis(
        start, first, extended, final and replace(final, doubted=doubted), ordered, suspected(left, beside), other, wanted,
        acceptance.false_alarm,
        largest_misfit(extended, rng("misfit"), along) if extended.lacks_fit else None, capped=len(ordered) >= causes,
        alternatives=alternatives, in_reach=in_reach,
    )  # fmt: skip
