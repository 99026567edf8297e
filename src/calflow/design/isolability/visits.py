"""Visits: what a plan will measure where, and what could be added to it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from calflow.design.vias import reached
from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.robot.robot import Robot

Record = Literal["approach", "travel", "time", "temperature"]
RECORDS: dict[Record, str] = {
    "approach": "the side that each joint comes from recorded",
    "travel": "each joint's travel since it turned back recorded",
    "time": "the time of each row recorded",
    "temperature": "a thermometer",
}
MINUTE = 60.0  # s, from pose to pose
WARMS, HOUR = 12.0, 3600.0  # K and s: a robot that warms up while it is measured
ROOM = 293.15  # K


@dataclass(frozen=True, eq=False)
class Visits:
    """Poses in measuring order: readings (n, n_joints), the payload of each, the markers measured at each, what is recorded.

    vias (n, n_joints) are what the poses are reached from, None where they follow each other.
    """

    robot: Robot
    readings: np.ndarray
    payloads: tuple[str, ...]
    markers: tuple[str, ...]
    records: frozenset[Record] = frozenset()
    vias: np.ndarray | None = None

    def measurements(self) -> Measurements:
        """Return the rows as a perfect device would report them of the nominal robot, which warms up, a pose a minute."""
        n, each = len(self.readings), len(self.markers)
        came, far = reached(self.readings, self.vias)
        time = MINUTE * np.arange(n)
        every = {"approach": came, "travel": far, "time": time, "temperature": ROOM - WARMS * np.expm1(-time / HOUR)}
        q = np.repeat(self.readings, each, axis=0)
        conditions: dict[str, Any] = {
            name: np.repeat(every[name], each, axis=0) for name in RECORDS if name in self.records
        }
        conditions |= {
            "pose": np.repeat(np.arange(1, n + 1), each),
            "payload": np.repeat(np.array(self.payloads), each),
            "marker": np.tile(np.array(self.markers), n),
        }
        planned = Measurements.from_arrays(self.robot, q, None, **conditions)
        nominal = build(self.robot, (), planned.given)
        return Measurements.from_arrays(self.robot, q, nominal.point(nominal.nominal, planned.rows), **conditions)

    def additions(self, more: np.ndarray) -> Iterator[tuple[str, Visits]]:
        """Yield in words what could be added, the cheapest first, and the visits with it; more are further poses' readings."""
        for record, words in RECORDS.items():
            if record not in self.records:
                yield words, replace(self, records=self.records | {record})
        for name in self.robot.payloads:
            if name not in self.payloads:
                half = tuple(name if k % 2 else own for k, own in enumerate(self.payloads))
                yield f"payload '{name}' at every other pose", replace(self, payloads=half)
        for name in self.robot.markers:
            if name not in self.markers:
                yield f"marker '{name}' measured at every pose too", replace(self, markers=(*self.markers, name))
        if len(more):
            payloads = (*self.payloads, *np.resize(np.array(self.payloads), len(more)).tolist())
            longer = replace(self, readings=np.vstack([self.readings, more]), payloads=payloads)
            vias = None if self.vias is None else np.vstack([self.vias, more])
            yield f"{len(more)} further poses", replace(longer, vias=vias)
