"""Photographed: a mistake of robot file or readings that images show, by the place of what each of them saw.

Images alone tell where a target is before a camera, to a few millimetres. That is little of their worth, but enough for a
gross mistake, which is sought as if these places had been measured.
"""

from __future__ import annotations

from dataclasses import replace

from calflow.faults.base import Fault
from calflow.faults.reference import Reference
from calflow.faults.setup import Setup
from calflow.faults.setup_search import PossibleMistake, likeliest_mistakes, told
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import POSITION, numbered
from calflow.measurements.series import Series
from calflow.observations import observations
from calflow.observations.camera import TOOL, WORLD, Camera
from calflow.robot.parts import Base, Marker

LABELS = ("image", "pose", "repeat", "payload", "split", "line", "order", "session", "time", "temperature")
MOVED = (
    "camera or target was moved; from there on name another target (column 'target'), or camera ('camera'), than before"
)


def mistake_of_images(data: Measurements) -> tuple[Fault, ...]:
    """Return the mistake that images show, if any: corrected if it concerns all readings of a column, else unsettled."""
    seen = places_seen(data)
    if seen is None or not seen.train.any() or (reference := Reference.of(seen, Setup.of(seen))) is None:
        return ()
    candidates = [_of_images(candidate) for candidate in likeliest_mistakes(seen, reference)]
    readings = numbered("q", data.robot.n_joints)
    return told(reference, candidates, lambda made: not made.row and made.quantity in readings)


def _of_images(candidate: PossibleMistake) -> PossibleMistake:
    """Return a mistake of places in the terms of images."""
    mistake = candidate.mistake
    return replace(candidate, mistake=replace(mistake, remedy=MOVED)) if mistake.id == "device-moved" else candidate


def places_seen(data: Measurements) -> Measurements | None:
    """Return a row per image of one camera and one target, with the place of what was seen as the position of an unknown marker.

    None without images, and of an arm that moves while they are taken.
    """
    k = next((k for k, seen in enumerate(observations(data)) if isinstance(seen, Camera)), None)
    if k is None or "speed" in data.given:
        return None
    series, own = data.series[k], data.table[data.of_series(k)].reset_index(drop=True)
    rows, places = Camera.of(series, own).places_seen(own)
    moving = [str(series.setting(name, other)) for name, other in (("camera_on", WORLD), ("target_on", TOOL))]
    on = next((link for link in moving if link not in (WORLD, TOOL)), "")
    table = own.iloc[rows].reset_index(drop=True)
    table = table[[name for name in (*LABELS, *numbered("q", data.robot.n_joints)) if name in table]]
    table = table.assign(marker="seen", **dict(zip(POSITION, places.T, strict=True)))
    marker = Marker((0.0, 0.0, 0.0), known=False, on=on)
    robot = replace(data.robot, base=Base(known=False), markers={"seen": marker}, expected=())
    return Measurements(robot, table, series=(Series(),))
