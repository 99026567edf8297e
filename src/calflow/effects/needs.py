"""Needs: what an effect cannot do without, of the robot file or of the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from calflow.robot.robot import Robot


@dataclass(frozen=True)
class Need:
    """What is needed, in words for whoever lacks it; met says whether a robot, or the conditions that are given, have it."""

    words: str
    met: Callable[[Robot, tuple[str, ...]], bool]


def _given(condition: str) -> Callable[[Robot, tuple[str, ...]], bool]:
    return lambda robot, given: condition in given


NEEDS = {
    "masses": Need(
        "mass_kg and com_mm of every link and payload in the robot file", lambda robot, given: robot.has_masses
    ),
    "torques": Need(
        "mass_kg and com_mm of every link and payload in the robot file, or measured torques tau1_Nm …",
        lambda robot, given: robot.has_masses or "torque" in given,
    ),
    "floor": Need(
        "a chain that begins at what stands on the floor (ground = 0 in the robot file)",
        lambda robot, given: robot.ground == 0,
    ),
    "payload": Need(
        "a payload with a mass in the robot file",
        lambda robot, given: any(load.mass != 0 for load in robot.payloads.values()),
    ),
    "gear_ratio": Need(
        "gear_ratio of a joint in the robot file",
        lambda robot, given: any(joint.gear_ratio for joint in robot.joints),
    ),
    "distances": Need(
        "relative_sd_mm of a marker in the robot file (its place beside the first, measured apart)",
        lambda robot, given: any(marker.relative_sd for marker in robot.markers.values()),
    ),
    "approach": Need("columns approach1 … (or in_order = true in the study's [measurements])", _given("approach")),
    "travel": Need(
        "columns travel1_deg (or _rad) … (or in_order = true in the study's [measurements])", _given("travel")
    ),
    "wrench": Need("columns fx_N … mz_Nm", _given("wrench")),
    "torque": Need("columns tau1_Nm …", _given("torque")),
    "time": Need("a column time_s", _given("time")),
    "temperature": Need("a column temperature_degC", _given("temperature")),
    "order": Need("rows in measuring order", _given("order")),
    "session": Need("a column session", _given("session")),
    "slide": Need(
        "a prismatic joint in the robot file",
        lambda robot, given: any(joint.kind == "prismatic" for joint in robot.joints),
    ),
    "range": Need("the device's place, tracker_mm in the study's [measurements]", _given("range")),
}


def unmet(needs: tuple[str, ...], robot: Robot, given: tuple[str, ...]) -> list[str]:
    """Return in words which needs robot file and data leave unmet."""
    return [NEEDS[need].words for need in needs if not NEEDS[need].met(robot, given)]
