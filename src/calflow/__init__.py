"""calflow calibrates robots from measurements, names what the model still gets wrong, and says how certain it is.

    import calflow as cf

    robot = cf.Robot.from_toml("robot.toml")
    data = cf.Measurements.from_csv("points.csv", robot).split(holdout=0.3, seed=1)
    calibration = cf.identify(robot, data, effects=["geometry", "joint-compliance"])
    better = calibration.diagnose()
    better.save("runs/mine")

A study on disk: `study = cf.load_study("studies/hh800/study.toml")`, `result = cf.run(study)`, then
`result.tables["identify/accuracy.csv"]` is a DataFrame. docs/api.md has the rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calflow.calibration import Calibration, diagnose, export, identify, report
    from calflow.deployment.check_poses import choose_check_poses
    from calflow.deployment.comparison import Comparison
    from calflow.deployment.compensation import Compensation, compensate
    from calflow.deployment.drift import Drift, drift
    from calflow.deployment.history import History
    from calflow.deployment.prediction import Prediction, predict
    from calflow.deployment.validation import Validation, validate
    from calflow.design.next_poses import NextStep
    from calflow.estimation.parameters import Parameters
    from calflow.files.problems import InputError
    from calflow.measurements.measurements import Measurements
    from calflow.programs.filtering import filter_program
    from calflow.robot.frames import Frame, at_origin, dh, modified_dh
    from calflow.robot.parts import Base, Coupling, Expected, FourBar, Joint, Marker, Payload
    from calflow.robot.robot import Robot
    from calflow.runs.between_runs import compare_runs, history_of_runs
    from calflow.runs.given_rows import rows_measured
    from calflow.runs.pack import pack
    from calflow.runs.reproduce import Reproduction, reproduce
    from calflow.runs.run import Run, run
    from calflow.sampling.posterior import Posterior
    from calflow.simulation import simulate
    from calflow.stages.measuring_loop import next_poses
    from calflow.study import Study, load_study

__all__ = [
    "Base", "Calibration", "Comparison", "Compensation", "Coupling", "Drift", "Expected", "FourBar", "Frame",
    "History", "InputError", "Joint", "Marker", "Measurements", "NextStep", "Parameters", "Payload", "Posterior",
    "Prediction", "Reproduction", "Robot", "Run", "Study", "Validation", "at_origin", "choose_check_poses", "compare_runs",
    "compensate", "dh", "diagnose", "drift", "export", "filter_program", "history_of_runs", "identify", "load_study",
    "modified_dh", "next_poses", "pack", "predict", "report", "reproduce", "rows_measured", "run", "simulate",
    "validate",
]  # fmt: skip

_HOMES = {
    "calibration": ("Calibration", "diagnose", "export", "identify", "report"),
    "deployment.check_poses": ("choose_check_poses",),
    "deployment.compensation": ("Compensation", "compensate"),
    "deployment.comparison": ("Comparison",),
    "deployment.drift": ("Drift", "drift"),
    "deployment.history": ("History",),
    "deployment.prediction": ("Prediction", "predict"),
    "deployment.validation": ("Validation", "validate"),
    "estimation.parameters": ("Parameters",),
    "files.problems": ("InputError",),
    "measurements.measurements": ("Measurements",),
    "programs.filtering": ("filter_program",),
    "robot.frames": ("Frame", "at_origin", "dh", "modified_dh"),
    "robot.parts": ("Base", "Coupling", "Expected", "FourBar", "Joint", "Marker", "Payload"),
    "robot.robot": ("Robot",),
    "runs.between_runs": ("compare_runs", "history_of_runs"),
    "runs.given_rows": ("rows_measured",),
    "design.next_poses": ("NextStep",),
    "stages.measuring_loop": ("next_poses",),
    "runs.pack": ("pack",),
    "runs.reproduce": ("Reproduction", "reproduce"),
    "runs.run": ("Run", "run"),
    "sampling.posterior": ("Posterior",),
    "simulation": ("simulate",),
    "study": ("Study", "load_study"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for, so that the command line answers at once."""
    if name == "__version__":
        from importlib.metadata import version

        return version("calflow")
    if name not in _HOME:
        raise AttributeError(f"module 'calflow' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(f"calflow.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted((*__all__, "__version__"))
