"""Payload step: a payload that was exchanged, filled or emptied at a row, which the table does not say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import casadi as ca

from calflow.effects.base import Words
from calflow.effects.step_change import StepChange
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Loads, Row
from calflow.robot.parts import Parameter


@dataclass(frozen=True)
class PayloadStep(StepChange):
    """Masses of the payloads (1 + e) from a row on; before it, and in later measurements, they are as stated."""

    id = "payload-step"
    title = "unstated change of payload mass"
    words = Words(
        "unstated change of payload mass",
        "another payload than the table says hung on the robot from there on",
        "change",
    )
    whole = "payloads"
    needs = (*StepChange.needs, "masses", "payload")
    told_by = "weigh the payload, or measure some of the first poses again"

    def later(self, series: Measurements | None) -> Self:
        """Return the same for later rows, of any time, whose payloads are as stated."""
        return replace(super().later(series), between=())

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the relative change of mass."""
        return (Parameter(self.id, "payloads", "e", "1", 0.2, -1.0, 3.0, meaning="change of the mass of payloads"),)

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        """Return the loads with the payloads' masses scaled after the moment."""
        before = self.before(row)
        return replace(loads, payload_mass=loads.payload_mass * (1 + p[0] * (1 - before))) if before.nnz() else loads
