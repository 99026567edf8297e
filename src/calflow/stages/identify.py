"""The stage identify: one fit of geometry and the study's other effects, with their parameters as bounded variables."""

from __future__ import annotations

from calflow.calibration import identify
from calflow.deployment.run_outcome import TABLES
from calflow.estimation.certainty import Certainty
from calflow.estimation.identifiability import wrong_counts
from calflow.estimation.identification import too_few_equations
from calflow.estimation.model_tables import IdentifySummary
from calflow.estimation.noise import REPRESENTATIVE, measured_noise, stated_noise
from calflow.files.problems import InputError, Problem, refuse_any
from calflow.files.tables import Results
from calflow.measurements.measurements import Measurements
from calflow.model import build, stated
from calflow.observations import observations
from calflow.stage_settings import IdentifySettings
from calflow.stages.demand import Demand
from calflow.stages.stage import Context, Stage
from calflow.study import Study

# Measured: memory as a multiple of the table's; seconds to start, per row to read, check and write it, per number of
# the last model's Jacobian, and per number of each model's Jacobian at the rows that are fitted first.
COPIES, STARTING, READING, FITTING, SETTLING = 9.0, 1.0, 4.4e-5, 2.2e-7, 2e-6
REMEDY = "keep fewer poses in the file: certainty grows only with the square root of their number"


def _run(context: Context) -> Results:
    """Fit the nominal robot's errors, effect by effect, and report which parameters the data determine."""
    study, settings = context.study, context.settings
    refuse_any(_wrong_count(study, settings))
    data = study.measurements()
    for note in data.notes:
        context.say(note)
    return identify(
        study.robot, data, study.file.effects, **settings.model_dump(), seed=study.file.seed, say=context.say,
        advance=context.advance, paths=study.measurement_paths,
    ).results  # fmt: skip


def _problems(study: Study, settings: IdentifySettings, data: Measurements | None) -> list[Problem]:
    """Return problems of invalid counts, too few measurements, or measurements that do not determine the noise."""
    problems = _wrong_count(study, settings)
    if data is None:
        return problems
    observed = observations(data)
    model = stated(study.robot, study.file.effects, data.only(data.train), observed)
    try:
        # Whether the noise can be determined does not depend on the nominal robot's errors, so none is predicted.
        if settings.noise == "auto":
            stated_noise(data)
        else:
            measured_noise(data, settings.noise, build(study.robot, (), data.given, observed))
    except InputError as error:
        problems += [study.setting_problem("identify", problem.message, "noise") for problem in error.problems]
    too_few = too_few_equations(model, data.only(data.train))
    return [*problems, Problem(too_few, study.measurement_path)] if too_few else problems


def _wrong_count(study: Study, settings: IdentifySettings) -> list[Problem]:
    wrong = wrong_counts(study.robot, study.file.effects, settings.count)
    return [study.setting_problem("identify", message, "count", effect) for effect, message in wrong]


def _demand(study: Study, settings: IdentifySettings, data: Measurements) -> Demand:
    """Estimate the demand of the fits: they process rows in blocks, so that reading the table needs the most memory."""
    train, effects = data.only(data.train), study.file.effects
    residuals = sum(len(seen.units) * int(train.of_series(k).sum()) for k, seen in enumerate(observations(train)))
    parameters = [len(stated(study.robot, effects[:k], train).parameters) for k in range(1, len(effects) + 1)]
    settling = SETTLING * sum(parameters) * min(1.0, REPRESENTATIVE / max(len(train), 1))
    seconds = STARTING + READING * len(data) + (FITTING * max(parameters, default=0) + settling) * residuals
    return Demand(len(data), data.table.shape[1], COPIES, seconds, REMEDY, "rows")


STAGE = Stage(
    "identify",
    "identify geometry and compliance",
    IdentifySettings,
    _run,
    demand=_demand,
    tables={name: row_type for name, row_type in TABLES.items() if name.startswith("identify/")},
    documents={"identify/summary.json": IdentifySummary, "identify/certainty.json": Certainty},
    problems=_problems,
)
