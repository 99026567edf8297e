"""calflow: an optimisation workflow framework for calibrating robots.

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
    from calflow.calibration import Calibration, diagnose, identify, report
    from calflow.deployment.comparison import Comparison
    from calflow.deployment.compensation import Compensation
    from calflow.deployment.drift import Drift
    from calflow.deployment.history import History
    from calflow.deployment.prediction import Prediction
    from calflow.deployment.validation import Validation
    from calflow.estimation.parameters import Parameters
    from calflow.files.problems import InputError
    from calflow.measurements.measurements import Measurements
    from calflow.robot.frames import Frame, dh, modified_dh
    from calflow.robot.parts import Base, Coupling, Expected, FourBar, Joint, Marker, Payload
    from calflow.robot.robot import Robot
    from calflow.runs.check_poses import choose_check_poses
    from calflow.runs.compare import compare
    from calflow.runs.compensate import compensate
    from calflow.runs.drift import drift
    from calflow.runs.export import export_run
    from calflow.runs.filter import filter_program
    from calflow.runs.history import history
    from calflow.runs.next_poses import NextStep, next_poses
    from calflow.runs.pack import pack
    from calflow.runs.predict import predict
    from calflow.runs.reproduce import Reproduction, reproduce
    from calflow.runs.run import Run, run
    from calflow.runs.validate import validate
    from calflow.sampling.posterior import Posterior
    from calflow.simulation import simulate
    from calflow.study import Study, load_study

__all__ = [
    "Base", "Calibration", "Comparison", "Compensation", "Coupling", "Drift", "Expected", "FourBar", "Frame",
    "History", "InputError", "Joint", "Marker", "Measurements", "NextStep", "Parameters", "Payload", "Posterior", "Prediction",
    "Reproduction", "Robot", "Run", "Study", "Validation", "choose_check_poses", "compare", "compensate", "dh",
    "diagnose", "drift", "export_run", "filter_program", "history", "identify", "load_study", "modified_dh", "next_poses", "pack",
    "predict", "report", "reproduce", "run", "simulate", "validate",
]  # fmt: skip

_HOMES = {
    "calibration": ("Calibration", "diagnose", "identify", "report"),
    "deployment.compensation": ("Compensation",),
    "deployment.comparison": ("Comparison",),
    "deployment.drift": ("Drift",),
    "deployment.history": ("History",),
    "deployment.prediction": ("Prediction",),
    "deployment.validation": ("Validation",),
    "estimation.parameters": ("Parameters",),
    "files.problems": ("InputError",),
    "measurements.measurements": ("Measurements",),
    "robot.frames": ("Frame", "dh", "modified_dh"),
    "robot.parts": ("Base", "Coupling", "Expected", "FourBar", "Joint", "Marker", "Payload"),
    "robot.robot": ("Robot",),
    "runs.check_poses": ("choose_check_poses",),
    "runs.compensate": ("compensate",),
    "runs.export": ("export_run",),
    "runs.filter": ("filter_program",),
    "runs.compare": ("compare",),
    "runs.drift": ("drift",),
    "runs.history": ("history",),
    "runs.next_poses": ("NextStep", "next_poses"),
    "runs.pack": ("pack",),
    "runs.predict": ("predict",),
    "runs.reproduce": ("Reproduction", "reproduce"),
    "runs.run": ("Run", "run"),
    "runs.validate": ("validate",),
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
