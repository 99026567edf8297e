"""What a notebook hands over, checked as a study's files are."""

from __future__ import annotations

from collections.abc import Sequence

from calflow.effects import catalogue
from calflow.effects.base import unmet
from calflow.estimation.parameters import mistaken
from calflow.files.problems import InputError, Problem, refuse
from calflow.measurements.measurements import Measurements
from calflow.robot.robot import Robot
from calflow.study_file import known_effects


def effects_of(effects: Sequence[str], robot: Robot, data: Measurements) -> tuple[str, ...]:
    """Return the effects' ids.

    Raises:
        InputError: one is unknown or there twice, is a model of the noise, or needs what robot and data lack, or the robot
            expects something of a parameter that is not there.
    """
    try:
        named = known_effects(tuple(effects))
    except ValueError as error:
        raise refuse(str(error), key="effects") from None
    problems = [
        Problem(f"effect '{effect}' is a model of the noise, which no fit can have; diagnose looks for it")
        for effect in named if catalogue()[effect].is_noise()
    ]  # fmt: skip
    problems += [
        Problem(f"effect '{effect}' needs {lacking}")
        for effect in named for lacking in unmet(catalogue()[effect].needs, robot, data.given)
    ]  # fmt: skip
    problems += [Problem(message, key=f"expected[{k + 1}]") for k, message in mistaken(robot, named)]
    if problems:
        raise InputError(problems)
    return named


def split_rows(data: Measurements) -> Measurements:
    """Return measurements that say which rows may be fitted.

    Raises:
        InputError: they do not.
    """
    if "split" not in data.table:
        raise refuse("say first which poses to hold out: data = data.split(holdout=0.3, seed=1)", key="data")
    return data


def check_same(data: Measurements, measured: Measurements) -> None:
    """Check that measurements are those that a model was identified from.

    Raises:
        InputError: they are others.
    """
    if not data.table.equals(measured.table):
        raise refuse("these are not the measurements that the fit is from: identify them first", key="data")
