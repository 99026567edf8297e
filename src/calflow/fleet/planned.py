"""The plan of a fleet: of each robot whether its run goes on, begins or is reused, and why."""

from __future__ import annotations

from collections.abc import Iterator

from calflow.files.problems import InputError
from calflow.fleet.fleet import Fleet, FleetRobot
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.reason import reason
from calflow.fleet.robot_study import write_study
from calflow.runs.planning import PlannedStage, plan
from calflow.study import load_study


def planned(fleet: Fleet, folder: FleetFolder) -> Iterator[str]:
    """Return a line a robot; each one's study is written on the way, for `calflow check` and the like."""
    width = max(len(robot.name) for robot in fleet.robots)
    wide = max(len(one.name) for one in fleet.types)
    for robot in fleet.robots:
        yield f"{robot.name:{width}}  {robot.type.name:{wide}}  {_said(robot, folder)}"


def steps(robot: FleetRobot, folder: FleetFolder) -> list[PlannedStage]:
    """Return what a run of a robot would do; its study is written on the way.

    Raises:
        InputError: its files are at fault.
    """
    write_study(robot, folder.study(robot.name))
    return plan(load_study(folder.study(robot.name)), folder.run(robot.name))


def _said(robot: FleetRobot, folder: FleetFolder) -> str:
    try:
        planned_steps = steps(robot, folder)
        again = [step for step in planned_steps if not step.reuse]
        if again:
            load_study(folder.study(robot.name)).measurements()  # what is wrong in their rows is told before the night
    except InputError as error:
        return f"would fail: {reason(error)}"
    if not again:
        return f"reuse  {planned_steps[0].reason}"
    return f"run    {', '.join(step.stage.name for step in again)}: {again[0].reason}"
