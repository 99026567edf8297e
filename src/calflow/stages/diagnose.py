"""The stage diagnose: what the model still gets wrong, named by its physical cause, added to it and judged on unseen rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
from pydantic import Field, field_validator

from calflow.design.discrimination import NextPose, SeparationRow, poses_table, question, separations_table
from calflow.diagnosis.findings.curves import CurvePoint, curves
from calflow.diagnosis.findings.diagnosis_summary import DiagnosisSummary
from calflow.diagnosis.findings.remainder import remainder
from calflow.diagnosis.findings.replication import CarriedAccuracy, ConfirmedCause, ConfirmedPoint, confirm
from calflow.diagnosis.findings.tables import CandidateRow, Diagnosis, FindingRow, candidates_table, findings_table
from calflow.diagnosis.findings.verdict import verdict
from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.search.acceptance import FALSE_ALARM, SHARES, Acceptance
from calflow.diagnosis.search.extension import extend, weighed_against
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.narrowing import narrowed
from calflow.diagnosis.search.noise_growth import growth
from calflow.estimation.accuracy import Accuracy, Residual, accuracy, errors, residuals
from calflow.estimation.calibrated import DeviceNoise, Identified, ModelEffect, effect_table, identified, noise_table
from calflow.estimation.fit_summary import Solver
from calflow.estimation.parameters import Covariances, FittedParameter, covariance_table, parameter_table
from calflow.estimation.repeats import averaged
from calflow.faults import FaultyRow, as_table, corrected, search
from calflow.files.documents import to_document
from calflow.files.results import Results
from calflow.files.tables import to_frame
from calflow.files.toml import FileModel
from calflow.measurements.measurements import Measurements
from calflow.stages.stage import Context, Stage
from calflow.study import Study, known_effects

BEGUN, SEARCHED = 0.1, 0.7  # share of the work before and after the search


class DiagnoseSettings(FileModel):
    """Settings of diagnose: the chance of a false alarm, the most causes to add, and which effects to look for (all)."""

    false_alarm: float = Field(default=FALSE_ALARM, gt=0, lt=0.5)
    causes: int = Field(default=10, ge=1)
    catalogue: tuple[str, ...] = ()
    leave_out: tuple[str, ...] = ()

    @field_validator("catalogue", "leave_out")
    @classmethod
    def _known(cls, effects: tuple[str, ...]) -> tuple[str, ...]:
        return known_effects(effects) if effects else effects


def run(context: Context) -> Results:
    """Find what the model lacks, extend it, and tell the gain on held-out rows."""
    study = context.study
    data = study.measurements()
    known = identified(study.robot, context.results, data.given)
    data = corrected(data.on(known.model.robot), context.tables["identify/faults.csv"])
    found = diagnose(known, data, context)
    final = found.extended.fitted
    faults = context.tables["identify/faults.csv"]
    other = study.confirming
    confirmed = _confirmed(final, other, context.say) if other and found.causes else {}
    share = data.train.sum() / (data.train | data.held_out).sum()
    questions = [question(v, final, share, context.rng(f"poses{k}")) for k, v in enumerate(found.verdicts)]
    tables = {
        "diagnose/findings.csv": findings_table(found, data, faults, context.rng("resamples")),
        "diagnose/candidates.csv": candidates_table(found),
        "diagnose/accuracy.csv": _accuracy(found, data, context.results.rows("identify/accuracy.csv", Accuracy)),
        "diagnose/next_poses.csv": poses_table(questions, final),
        "diagnose/separations.csv": separations_table(questions),
        "diagnose/parameters.csv": parameter_table(final.fit),
        "diagnose/covariance.csv": covariance_table(final.fit),
        "diagnose/effects.csv": effect_table(final.model.effects),
        "diagnose/noise.csv": _noise_table(found, known, data),
        "diagnose/residuals.csv": residuals(errors(final.model, final.fit.estimate, data), data),
        "diagnose/curves.csv": curves(final, found.causes, data),
    }
    return Results(tables | confirmed, {"diagnose/summary.json": to_document(_summary(found, known))})


def diagnose(known: Identified, data: Measurements, context: Context) -> Diagnosis:
    """Extend the identified model on the training rows, and weigh what was found."""
    settings = context.settings
    train, noise = averaged(data.only(data.train), known.noise(data).only(data.train))
    start = Fitted.of(known, train, noise)
    alarm = SHARES["noise"] * settings.false_alarm
    plain = start.device.sigma
    if grown := growth(start, alarm):
        start = start.weighed(grown.sigma(train, start.device))
    have = [effect.id for effect in known.model.effects]
    catalogue = Catalogue.of(train, have, settings.catalogue, settings.leave_out)
    context.advance(BEGUN)
    acceptance = Acceptance(SHARES["causes"] * settings.false_alarm, settings.causes)
    extended = extend(
        start, catalogue, acceptance, context.rng("bootstrap"), context.say,
        lambda share: context.advance(BEGUN + share * (SEARCHED - BEGUN)),
    )  # fmt: skip
    context.advance(SEARCHED)
    significance = SHARES["remainder"] * settings.false_alarm
    left = remainder(extended.fitted, significance, context.rng("decoys"), context.say)
    if left and extended.findings:
        named = extended
        extended = narrowed(start, named, [one.score.cause for one in left], catalogue, acceptance)
        if extended is not named:
            context.say("what is left over explains some of what was found: dropped")
            left = remainder(extended.fitted, significance, context.rng("decoys"), context.say)
    if settings.catalogue or settings.leave_out:
        extended = weighed_against(extended, Catalogue.of(train, have))
    context.advance(0.8)
    last = extended.fitted
    if again := growth(last.weighed(plain) if grown else last, alarm):
        context.say(f"the noise grows with range: {1e6 * again.slope:.3g} um/m, p = {again.p:.2g}")
    verdicts = tuple(verdict(finding) for finding in extended.findings)
    return Diagnosis(start, extended, verdicts, tuple(left), again, catalogue.lacking, catalogue.superseded,
                     acceptance.false_alarm)  # fmt: skip


def _confirmed(found: Fitted, other: Study, say: Callable[[str], None]) -> dict[str, pd.DataFrame]:
    """What an independent series says of the joint errors found, once its own faults are seen to."""
    data, faults = search(other.measurements())
    for fault in faults:
        say(f"{other.name}: {fault.cause.replace('-', ' ')}: {fault.statement}")
    told = confirm(found, data)
    say(f"{other.name}: " + "; ".join(told.table["words"].unique()))
    return {
        "diagnose/confirmation.csv": told.table,
        "diagnose/confirmation_curves.csv": told.curves,
        "diagnose/confirmation_accuracy.csv": told.accuracy,
        "diagnose/confirmation_faults.csv": as_table(faults, data),
    }


def _accuracy(found: Diagnosis, data: Measurements, before: list[Accuracy]) -> pd.DataFrame:
    """The rows of identify/accuracy.csv, and one step for each cause."""
    name, step, rows = before[-1].model, before[-1].step, list(before)
    for k, (cause, fitted) in enumerate(zip(found.causes, found.extended.path, strict=True), start=step + 1):
        name += f" + {cause.id} {cause.part}"
        rows += accuracy(name, errors(fitted.model, fitted.fit.estimate, data), data, k, cause)
    return to_frame(rows, Accuracy)


def _noise_table(found: Diagnosis, known: Identified, data: Measurements) -> pd.DataFrame:
    """Each series' noise as the extended model leaves it."""
    final = found.extended.fitted
    noise = known.noise(data)
    sigma = noise.sigma.copy()
    for k, source in enumerate(noise.sources):
        if source == "estimated":
            sigma[noise.of_series(k)] = np.median(final.noise.sigma[final.noise.of_series(k)])
    growth = (found.growth.floor, found.growth.slope) if found.growth else None
    return noise_table(replace(noise, sigma=sigma), final.model.observations, growth)


def _summary(found: Diagnosis, known: Identified) -> DiagnosisSummary:
    final, first = found.extended.fitted, found.start
    sigma = found.growth.floor if found.growth else known.sigma
    if final.noise.sources[0] == "estimated" and not found.growth:
        sigma = float(np.median(final.noise.sigma[final.noise.of_series(0)]))
    return DiagnosisSummary(
        noise_sources=final.noise.sources,
        sigma_mm=1e3 * sigma,
        noise_growth_mm_per_m=1e3 * found.growth.slope if found.growth else 0.0,
        discrepancy_mm=1e3 * final.noise.discrepancy,
        rotation_discrepancy_mrad=None if final.noise.rotation is None else 1e3 * final.noise.rotation_discrepancy,
        loss=final.loss,
        reduced_chi2=final.lack.reduced_chi2 if final.noise.known else None,
        lack_of_fit_p=final.lack.p if final.noise.known else None,
        solver=Solver(status=final.fit.status, iterations=final.fit.iterations),
        converged=final.fit.converged,
        reduced_chi2_before=first.lack.reduced_chi2 if first.noise.known else None,
        causes_tested=len({score.cause.place for score in found.extended.first.scores}),
        tests=found.extended.first.family.places,
    )


STAGE = Stage(
    "diagnose",
    "name what the model lacks",
    DiagnoseSettings,
    run,
    needs=("identify",),
    tables={
        "diagnose/findings.csv": FindingRow,
        "diagnose/candidates.csv": CandidateRow,
        "diagnose/accuracy.csv": Accuracy,
        "diagnose/next_poses.csv": NextPose,
        "diagnose/separations.csv": SeparationRow,
        "diagnose/parameters.csv": FittedParameter,
        "diagnose/covariance.csv": Covariances,
        "diagnose/effects.csv": ModelEffect,
        "diagnose/noise.csv": DeviceNoise,
        "diagnose/residuals.csv": Residual,
        "diagnose/curves.csv": CurvePoint,
        "diagnose/confirmation.csv": ConfirmedCause,
        "diagnose/confirmation_curves.csv": ConfirmedPoint,
        "diagnose/confirmation_accuracy.csv": CarriedAccuracy,
        "diagnose/confirmation_faults.csv": FaultyRow,
    },
    documents={"diagnose/summary.json": DiagnosisSummary},
)
