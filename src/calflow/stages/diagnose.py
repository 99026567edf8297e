"""The stage diagnose: physical causes of remaining errors are found, added to the model and tested on held-out rows."""

from __future__ import annotations

from calflow.calibration import Calibration
from calflow.deployment.run_outcome import TABLES
from calflow.diagnosis.background import MODES
from calflow.diagnosis.diagnosis import DiagnosisSummary
from calflow.diagnosis.regressors import HELD
from calflow.diagnosis.screening import Catalogue
from calflow.estimation.certainty import Certainty
from calflow.files.tables import Results
from calflow.measurements.measurements import Measurements
from calflow.model import stated
from calflow.observations import observations
from calflow.stage_settings import DiagnoseSettings
from calflow.stages.demand import Demand
from calflow.stages.stage import Context, Stage
from calflow.study import Study

# Measured: simultaneous arrays of the regressors' size where these are stored, else of the size of the background's
# modes; and seconds for each number of the regressors, for no to two causes found.
COPIES, COPIES_OF_MODES, SECONDS = 1.4, 8.4, 5e-7
ANY_MACHINE = 10_000  # number of residuals up to which any machine suffices


def _run(context: Context) -> Results:
    """Find missing causes, extend the model, and report the gain on held-out rows."""
    study = context.study
    calibration = Calibration.of(study.robot, study.file, context.results, study.measurements)
    diagnosed = calibration.diagnose(
        **context.settings.model_dump(), confirm=study.confirming, say=context.say, advance=context.advance
    )
    return diagnosed.results.of({"diagnose"})


def _demand(study: Study, settings: DiagnoseSettings, data: Measurements) -> Demand:
    """Estimate the demand of the tests: a column of residuals for each parameter of the model and all candidates."""
    train = data.only(data.train)
    places = train.table.drop_duplicates(["pose", "marker"]).index  # repeats are averaged
    rows = sum(len(seen.units) * int(train.of_series(k)[places].sum()) for k, seen in enumerate(observations(train)))
    if rows < ANY_MACHINE:
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
    _run,
    demand=_demand,
    needs=("identify",),
    tables={name: row_type for name, row_type in TABLES.items() if name.startswith("diagnose/")},
    documents={"diagnose/summary.json": DiagnosisSummary, "diagnose/certainty.json": Certainty},
)
