"""The calibrated model: where the robot will be, and which joint readings land it where it is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from calflow.deployment.compensation import landing, nominal_readings
from calflow.deployment.needed_conditions import NeededCondition, check_stated
from calflow.deployment.prediction import Missing, Prediction, predict_positions
from calflow.estimation.calibrated import Identified
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements

if TYPE_CHECKING:
    from calflow.robot.robot import Robot


@dataclass(frozen=True)
class Compensation:
    """Joint readings (n, n_joints) [rad, or m] that land on targets, as the calibrated model has it.

    remaining (n,) [m] is how far from its target each lands by the model, reached (n,) whether that is on it, sd (n, 3) [m] how
    surely it is known where. A target that is not reached has the readings that come nearest. notes say which these are.
    """

    readings: np.ndarray
    remaining: np.ndarray
    reached: np.ndarray
    sd: np.ndarray
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """A calibrated robot: its effects with their estimates, and the conditions that a prediction needs.

    measured are the measurements it is from, as they were given, and data the rows that were used, gross mistakes put right.
    """

    known: Identified
    needed: Sequence[NeededCondition]
    measured: Measurements
    data: Measurements

    @property
    def robot(self) -> Robot:
        """The robot that the effects are errors of, placed where the measurements say."""
        return self.known.model.robot

    @property
    def effects(self) -> tuple[str, ...]:
        """The ids of its effects, in their order, a cause with its part."""
        named = (f"{effect.id} {getattr(effect, 'part', '')}".rstrip() for effect in self.known.model.effects)
        return tuple(named)

    def predict(
        self, q: ArrayLike, *, payload: str | Sequence[str] | None = None, marker: str | Sequence[str] | None = None,
        missing: Missing = "refuse", **conditions: ArrayLike,
    ) -> Prediction:  # fmt: skip
        """Return where the marker will be in the measuring frame, and how surely.

        Args:
            q: joint readings, shape (n_rows, n_joints), or (n_joints,) of one row [rad, or m].
            payload: what is carried; nothing where it is None.
            marker: which marker; the first where it is None.
            missing: "widen" to go on without conditions that are needed, with a wider standard deviation.
            conditions: approach, travel, wrench, torque, time, temperature, as in `Measurements.from_arrays`.

        Raises:
            InputError: a condition is missing that an effect needs, or an array is at fault.
        """
        return predict_positions(self.known, self.needed, self._rows(q, payload, marker, conditions), missing)

    def compensate(
        self, targets: ArrayLike, *, start: ArrayLike | None = None, payload: str | None = None, marker: str | None = None,
        missing: Missing = "refuse", seed: int = 1, **conditions: ArrayLike,
    ) -> Compensation:  # fmt: skip
        """Return joint readings with which the marker lands on the targets.

        They are those nearest to start: give the readings that the nominal robot would be sent to, and the tool keeps its
        orientation as nearly as they do. Without start any nominal solution within the joint limits is taken as such; the
        tool's orientation is then left open.

        Args:
            targets: positions (n, 3), or (3,), in the measuring frame [m].
            start: readings (n, n_joints), or (n_joints,) for all [rad, or m].
            payload: what is carried.
            marker: which marker.
            missing: as in `predict`.
            seed: of the poses from which nominal solutions are looked for.
            conditions: as in `predict`; approach is the side that each joint will come from.

        Raises:
            InputError: a condition is missing that an effect needs, or an array is at fault.
        """
        aim = np.atleast_2d(np.asarray(targets, dtype=float))
        if aim.ndim != 2 or aim.shape[1] != 3 or not np.isfinite(aim).all():
            raise refuse(f"expected finite positions of shape (n, 3), found shape {aim.shape}", key="targets")
        n = self.robot.n_joints
        given = np.zeros(n) if start is None else np.asarray(start, dtype=float)
        if given.shape not in ((n,), (len(aim), n)):
            raise refuse(f"expected shape ({n},) or ({len(aim)}, {n}), found {given.shape}", key="start")
        begun = np.broadcast_to(given, (len(aim), n))
        rows = self._rows(begun, payload, marker, conditions)
        if missing == "refuse":
            check_stated(self.needed, rows.given)
        stated = rows.stating([one.condition for one in self.needed])
        model = replace(self.known.model, given=stated.given)
        if start is None:
            begun = nominal_readings(model, stated.rows, aim, np.random.default_rng(seed))
        found = landing(model, self.known.estimate, stated.rows, aim, begun)
        there = self._rows(found.readings, payload, marker, conditions)
        predicted = predict_positions(self.known, self.needed, there, missing)
        return Compensation(
            found.readings,
            found.remaining,
            found.reached,
            predicted.sd,
            (*_out_of_reach(found.reached), *predicted.notes),
        )

    def __repr__(self) -> str:
        needs = "; ".join(one.columns for one in self.needed) or "nothing beyond joints, payload and marker"
        return f"Model of {self.robot.name}: {', '.join(self.effects)}\n  a prediction needs: {needs}"

    def _rows(
        self, q: ArrayLike, payload: str | Sequence[str] | None, marker: str | Sequence[str] | None,
        conditions: dict[str, ArrayLike],
    ) -> Measurements:  # fmt: skip
        q = np.atleast_2d(np.asarray(q, dtype=float))
        labels = {name: given for name, given in (("payload", payload), ("marker", marker)) if given is not None}
        origin = {"time_origin": self.data.time_origin} if "time" in conditions else {}
        return Measurements.from_arrays(self.robot, q, None, pose=np.arange(len(q)), **labels, **origin, **conditions)  # type: ignore[arg-type]


def _out_of_reach(reached: np.ndarray) -> list[str]:
    if reached.all():
        return []
    which = ", ".join(str(k) for k in np.flatnonzero(~reached)[:10])
    return [
        f"{(~reached).sum()} of {len(reached)} targets are out of reach within the joint limits: number {which} (from 0)"
    ]
