"""The stage sample: how sure every parameter is, by emcee in coordinates that Laplace's approximation makes round."""

from __future__ import annotations

from pydantic import Field

from calflow.estimation.calibrated import calibrated, with_maps_held
from calflow.faults import corrected
from calflow.files.documents import to_document
from calflow.files.problems import Problem, refuse
from calflow.files.results import Results
from calflow.files.toml import FileModel
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.sampling.chain_summary import ChainSummary
from calflow.sampling.model_tables import CauseProbability, ModelRow, cause_table, models_table
from calflow.sampling.posterior_tables import (
    PosteriorRow,
    PredictedError,
    chain_summary,
    posterior_table,
    predictive_table,
)
from calflow.sampling.sample import ChainLength, sample, too_few_walkers
from calflow.stages.stage import Context, Stage
from calflow.study import Study


class SampleSettings(FileModel):
    """Settings of sample: length and mixture of the chain. independent is the share of the independence proposal."""

    ensembles: int = Field(default=4, ge=4)
    walkers: int | None = Field(default=None, ge=4)
    block: int = Field(default=50, ge=10)
    max_steps: int = Field(default=2000, ge=50)
    ess: int = Field(default=4000, ge=100)
    independent: float = Field(default=0.8, ge=0, le=1)


def run(context: Context) -> Results:
    """Sample the posterior with independent ensembles until it is long enough, and say so if it is not."""
    study = context.study
    data = corrected(study.measurements(), context.tables["identify/faults.csv"])
    known = calibrated(study.robot, context.results, data.given)
    length = ChainLength(**context.settings.model_dump())
    if wrong := too_few_walkers(length.walkers, len(with_maps_held(known)[0].model.parameters) + 1):
        raise refuse(wrong, study.path, key="stages.sample.walkers")
    path = context.folder / "sample" / "chain.h5"
    sampled = sample(known, data, path, length, rng=context.rng, say=context.say, advance=context.advance)
    table = posterior_table(sampled)
    predictive = predictive_table(sampled, context.rng("predictive"))
    tables = {
        "sample/posterior.csv": table,
        "sample/predictive.csv": predictive,
        "sample/models.csv": models_table(sampled.models),
        "sample/cause_probabilities.csv": cause_table(sampled.models),
    }
    return Results(tables, {"sample/summary.json": to_document(chain_summary(sampled, table))})


def problems(study: Study, settings: SampleSettings, data: Measurements | None) -> list[Problem]:
    """Find fewer walkers than the study's own effects need; causes that are found may need more."""
    message = too_few_walkers(settings.walkers, len(build(study.robot, study.file.effects).parameters) + 1)
    return [study.setting_problem("sample", message, "walkers")] if message else []


STAGE = Stage(
    "sample",
    "sample the posterior",
    SampleSettings,
    run,
    needs=("identify",),
    uses=("diagnose",),
    resumes=("sample/chain.h5",),
    tables={
        "sample/posterior.csv": PosteriorRow,
        "sample/predictive.csv": PredictedError,
        "sample/models.csv": ModelRow,
        "sample/cause_probabilities.csv": CauseProbability,
    },
    documents={"sample/summary.json": ChainSummary},
    problems=problems,
)
