"""The check of a study: it finds all errors for which a run would refuse the study, without running anything."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

from calflow.deployment.usability import far_off_words
from calflow.estimation.accuracy import accuracy, leading_errors, spread_mm
from calflow.estimation.lack_of_fit import NoiseDoubt, doubts_of_repeats
from calflow.estimation.registration import registered_model
from calflow.faults import Fault, examined
from calflow.files.deferred import pd
from calflow.files.problems import Problem, refuse_any, run_checks
from calflow.measurements.measurements import Measurements
from calflow.model import stated
from calflow.runs.planning import foreseen, stages_of
from calflow.stages.catalogue import STAGES
from calflow.stages.demand import Demand, memory_available, warned
from calflow.study import Study


@dataclass(frozen=True)
class Checked:
    """The result of checking a valid study: its measurements, their faults, and the number of parameters.

    nominal: errors of the manufacturer's robot, with registered base and tool and corrected faults, as accuracy.csv has
    them; doubts: stated noises that the repeats contradict; demands: memory and time of each stage; warnings: demands
    that are large for this machine; far_off: in words, that the nominal errors are larger than any robot's.
    """

    data: Measurements
    faults: tuple[Fault, ...]
    n_parameters: int
    nominal: pd.DataFrame
    doubts: tuple[NoiseDoubt, ...] = ()
    far_off: str = ""
    demands: Mapping[str, Demand] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def check(study: Study) -> Checked | None:
    """Return the result of checking a study and its confirming study; None while their measurements are not available.

    Raises:
        InputError: with all errors for which a run would refuse the study.
    """
    measured = study.file.measurements is not None and not study.to_fetch
    stages, data, _ = run_checks(
        partial(stages_of, study), lambda: study.measurements() if measured else None, partial(_confirming, study)
    )
    _, checked = run_checks(partial(_settings, study, data), lambda: _checked(study, data) if data else None)
    if checked is None:
        return None
    demands, available = foreseen(study, stages), memory_available()
    warnings = run_checks(*(partial(warned, name, demand, available) for name, demand in demands.items()))
    return replace(checked, demands=demands, warnings=tuple(filter(None, warnings)))


def _confirming(study: Study) -> None:
    other = study.confirming
    if other and not other.to_fetch:
        other.measurements()


def _settings(study: Study, data: Measurements | None) -> None:
    """Check the settings of every stage, and what stages of the workflow need of the measurements."""
    names = dict.fromkeys((*study.stages, *study.workflow.settings, *study.file.stages))
    problems: list[Problem] = []
    for name in names:
        stage = STAGES[name]
        settings = study.validated_settings(name, stage.settings)
        problems += stage.problems(study, settings, data if name in study.stages else None)
    refuse_any(problems)


def _checked(study: Study, data: Measurements) -> Checked:
    mended, faults = examined(data, study.measurement_paths)
    nominal, placed = registered_model(mended)
    error = leading_errors(nominal, nominal.nominal, placed)
    doubts = doubts_of_repeats(placed, error, tuple(False for _ in data.series))
    n_parameters = len(stated(study.robot, study.file.effects, mended.only(mended.train)).parameters)
    errors = pd.DataFrame(accuracy("nominal", error, mended))
    points = nominal.point(nominal.nominal, placed.only(placed.train | placed.held_out).conditions)
    far_off = far_off_words(errors["mean_mm"].iloc[0], spread_mm(points))
    return Checked(data, faults, n_parameters, errors, doubts, far_off)
