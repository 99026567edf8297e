"""The stage diagnose: what the model still gets wrong, named by its physical cause, added to it and judged on unseen rows."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd
from pydantic import Field, field_validator

from calflow.design.discrimination import NextPose, Question, SeparationRow, poses_table, questions, separations_table
from calflow.diagnosis.diagnosis import diagnose
from calflow.diagnosis.findings.curves import CurvePoint, curves
from calflow.diagnosis.findings.extended_model import (
    DiagnosisSummary,
    accuracy_table,
    diagnosis_summary,
    extended_model,
    extended_noise,
)
from calflow.diagnosis.findings.finding import Finding
from calflow.diagnosis.findings.replication import CarriedAccuracy, ConfirmedCause, ConfirmedPoint, confirm
from calflow.diagnosis.findings.rivals import alternatives_table
from calflow.diagnosis.findings.tables import CandidateRow, Diagnosis, candidates_table, findings
from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.screening.regressors import HELD
from calflow.diagnosis.search.background import MODES
from calflow.diagnosis.search.fitted import FAR, Fitted
from calflow.diagnosis.search.trial import FALSE_ALARM
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.calibrated_model import CalibratedModel, DeviceNoise, ModelEffect, effect_table, identified
from calflow.estimation.judgement import JudgedResidual, Studentised, judged_table
from calflow.estimation.needed_conditions import NeededCondition
from calflow.estimation.parameters import Covariances, FittedParameter, Parameters, covariance_table
from calflow.estimation.progress import Draws, Say
from calflow.estimation.rival_models import AlternativeParameter, CauseInReach, in_reach_table
from calflow.faults import FaultyRow, as_table, corrected, examined
from calflow.faults.outlier import odd_rows
from calflow.files.results import Results, to_document
from calflow.files.tables import to_frame
from calflow.files.toml import FileModel
from calflow.measurements.measurements import Measurements
from calflow.model import stated
from calflow.observations import observations
from calflow.stages.demand import Demand
from calflow.stages.stage import Context, Stage
from calflow.study import Study
from calflow.study_file import known_effects

# Measured: arrays of the regressors' size at once where these are held, else of the background's modes; and seconds for each of
# the regressors' numbers, between nothing found and two causes.
COPIES, COPIES_OF_MODES, SECONDS = 1.4, 8.4, 5e-7
MANY = 10_000  # residuals, up to which any machine will do


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
    settings = context.settings.model_dump()
    found = diagnose(known, data, **settings, rng=context.rng, say=context.say, advance=context.advance)
    other = study.confirming
    confirmed = _confirmed(found.extended.fitted, other, context.say) if other and found.causes else {}
    asked = questions(found, data, context.rng)
    return results(found, known, data, asked, context.results, context.rng) | Results(confirmed)


def results(
    found: Diagnosis, known: CalibratedModel, data: Measurements, asked: Sequence[Question], before: Results, rng: Draws
) -> Results:
    """Return what was found as the run folder keeps it; before are the results of identify, known what these say."""
    final = found.extended.fitted
    extended = extended_model(found, known, data)
    studentised = Studentised.of(final.fit, data, extended.noise(data), FAR)
    odd, told = odd_rows(final.fit, data, studentised)
    own = as_table(told, data)
    faults = pd.concat([table for table in (before.tables["identify/faults.csv"], own) if len(table)] or [own])
    steps = before.rows("identify/accuracy.csv", Accuracy)
    tables = {
        "diagnose/findings.csv": to_frame(findings(found, data, faults, rng("resamples")), Finding),
        "diagnose/candidates.csv": candidates_table(found),
        "diagnose/accuracy.csv": accuracy_table(found, data, steps),
        "diagnose/next_poses.csv": poses_table(asked, final),
        "diagnose/separations.csv": separations_table(asked),
        "diagnose/parameters.csv": Parameters.fitted(final.fit, final.covariance).table,
        "diagnose/covariance.csv": covariance_table(final.model.parameters, final.fit.covariance),
        "diagnose/effects.csv": effect_table(final.model.effects),
        "diagnose/alternatives.csv": alternatives_table(found.alternatives, found.causes, final),
        "diagnose/models_in_reach.csv": in_reach_table(found.in_reach),
        "diagnose/noise.csv": extended_noise(found, known, data),
        "diagnose/faults.csv": own,
        "diagnose/residuals.csv": judged_table(final.fit, data, studentised, odd),
        "diagnose/curves.csv": curves(final, found.causes, data),
        "diagnose/needed_conditions.csv": to_frame(extended.needed, NeededCondition),
    }
    return Results(tables, {"diagnose/summary.json": to_document(diagnosis_summary(found, known))})


def _confirmed(found: Fitted, other: Study, say: Say) -> dict[str, pd.DataFrame]:
    """What an independent series says of the joint errors found, once its own faults are seen to."""
    data, faults = examined(other.measurements(), other.measurement_paths)
    for fault in faults:
        say(f"{other.name}: {fault.said}")
    told = confirm(found, data)
    say(f"{other.name}: " + "; ".join(told.table["words"].unique()))
    return {
        "diagnose/confirmation.csv": told.table,
        "diagnose/confirmation_curves.csv": told.curves,
        "diagnose/confirmation_accuracy.csv": told.accuracy,
        "diagnose/confirmation_faults.csv": as_table(faults, data),
    }


def demand(study: Study, settings: DiagnoseSettings, data: Measurements) -> Demand:
    """Foresee what the tests take: a column of residuals for each parameter of the model and of every candidate."""
    train = data.only(data.train)
    places = train.table.drop_duplicates(["pose", "marker"]).index  # repeats are averaged
    rows = sum(len(seen.units) * int(train.of_series(k)[places].sum()) for k, seen in enumerate(observations(train)))
    if rows < MANY:
        return Demand()
    wanted = Catalogue.of(train, study.file.effects, settings.catalogue, settings.leave_out)
    columns = sum(len(effect.declared) for effect in wanted.effects) + len(
        stated(study.robot, study.file.effects, train).parameters
    )
    remedy = "name the causes to look for (stages.diagnose.catalogue), or hold more of the poses out (split.holdout)"
    seconds = SECONDS * rows * columns
    if rows * columns <= HELD:
        return Demand(rows, columns, COPIES, seconds, remedy)
    return Demand(rows, MODES, COPIES_OF_MODES, seconds, remedy)


STAGE = Stage(
    "diagnose",
    "name what the model lacks",
    DiagnoseSettings,
    run,
    demand=demand,
    needs=("identify",),
    tables={
        "diagnose/findings.csv": Finding,
        "diagnose/candidates.csv": CandidateRow,
        "diagnose/accuracy.csv": Accuracy,
        "diagnose/next_poses.csv": NextPose,
        "diagnose/separations.csv": SeparationRow,
        "diagnose/parameters.csv": FittedParameter,
        "diagnose/covariance.csv": Covariances,
        "diagnose/effects.csv": ModelEffect,
        "diagnose/alternatives.csv": AlternativeParameter,
        "diagnose/models_in_reach.csv": CauseInReach,
        "diagnose/noise.csv": DeviceNoise,
        "diagnose/faults.csv": FaultyRow,
        "diagnose/residuals.csv": JudgedResidual,
        "diagnose/curves.csv": CurvePoint,
        "diagnose/needed_conditions.csv": NeededCondition,
        "diagnose/confirmation.csv": ConfirmedCause,
        "diagnose/confirmation_curves.csv": ConfirmedPoint,
        "diagnose/confirmation_accuracy.csv": CarriedAccuracy,
        "diagnose/confirmation_faults.csv": FaultyRow,
    },
    documents={"diagnose/summary.json": DiagnosisSummary},
)
