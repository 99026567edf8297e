"""The calibrated model: where the robot will be, and which joint readings land it where it is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from calflow.deployment.compensation import Compensation, compensated
from calflow.deployment.inverse_kinematics import Targets
from calflow.deployment.prediction import Missing, Prediction, predict_positions
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.field_gain import gainful_field
from calflow.estimation.needed_conditions import NeededCondition
from calflow.estimation.progress import Say, draws, nobody
from calflow.estimation.residual_field import NOT_PHYSICAL
from calflow.files.problems import refuse
from calflow.measurements.measurements import Measurements

if TYPE_CHECKING:
    from calflow.robot.robot import Robot


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """A calibrated robot: its effects with their estimates, and the conditions that a prediction needs.

    measured are the measurements it is from, as they were given, and data the rows that were used, gross mistakes put right.
    """

    known: CalibratedModel
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
        self, targets: ArrayLike, *, start: ArrayLike | None = None, payload: str | Sequence[str] | None = None,
        marker: str | Sequence[str] | None = None, in_order: bool = False, missing: Missing = "refuse", seed: int = 1,
        **conditions: ArrayLike,
    ) -> Compensation:  # fmt: skip
        """Return joint readings with which the marker lands on the targets.

        They are those nearest to start: give the readings that the nominal robot would be sent to. Without start any nominal
        solution within the joint limits is taken as such. Where the targets are positions, the tool keeps its orientation as
        nearly as the start has it; without a start it is left open.

        Args:
            targets: positions (n, 3), or (3,), or poses (n, 4, 4), or (4, 4), in the measuring frame [m]. A pose is where the
                marker is, and how the frame of the last link is turned, with the robot's tool_rotation where it has one.
            start: readings (n, n_joints), or (n_joints,) for all [rad, or m]; of a robot with external axes theirs must be there,
                and the arm's may be nan.
            payload: what is carried, for all or one a target.
            marker: which marker, likewise.
            in_order: the robot goes from target to target, so that the side from which each joint comes follows from the commands.
            missing: as in `predict`.
            seed: of the poses from which nominal solutions are looked for.
            conditions: as in `predict`; approach is the side that each joint will come from.

        Raises:
            InputError: a condition is missing that an effect needs, or an array is at fault.
        """
        asked, n = Targets.of(targets), self.robot.n_joints
        given = np.full(n, np.nan) if start is None else np.asarray(start, dtype=float)
        if given.shape not in ((n,), (len(asked), n)):
            raise refuse(f"expected shape ({n},) or ({len(asked)}, {n}), found {given.shape}", key="start")
        begun = np.broadcast_to(given, (len(asked), n))
        if np.isnan(begun[:, self.robot.external]).any():
            named = ", ".join(str(i + 1) for i in self.robot.external)
            raise refuse(
                f"expected readings of the external axes (joints {named}): they stay where they are", key="start"
            )
        data = self._rows(np.nan_to_num(begun), payload, marker, conditions)
        known = not np.isnan(begun).any()
        return compensated(
            self.known, self.needed, data, asked, start=begun if known else None, in_order=in_order,
            missing=missing, seed=seed,
        )  # fmt: skip

    def with_residual_field(self, *, seed: int = 1, say: Say = nobody) -> Model:
        """Return the model with a smooth correction of what it leaves of the training rows, which is not physical.

        It is the model without one where that gains nothing at training poses left out of it.

        Args:
            seed: of all draws.
            say: is told whether it is applied, and what it gains.
        """
        field, gain = gainful_field(self.known, self.data, draws(seed))
        say(gain.statement)
        return replace(self, known=replace(self.known, field=field))

    def __repr__(self) -> str:
        needs = "; ".join(one.columns for one in self.needed) or "nothing beyond joints, payload and marker"
        field = f", residual field ({NOT_PHYSICAL})" if self.known.field else ""
        return f"Model of {self.robot.name}: {', '.join(self.effects)}{field}\n  a prediction needs: {needs}"

    def _rows(
        self, q: ArrayLike, payload: str | Sequence[str] | None, marker: str | Sequence[str] | None,
        conditions: dict[str, ArrayLike],
    ) -> Measurements:  # fmt: skip
        q = np.atleast_2d(np.asarray(q, dtype=float))
        labels = {name: given for name, given in (("payload", payload), ("marker", marker)) if given is not None}
        origin = {"time_origin": self.data.time_origin} if "time" in conditions else {}
        return Measurements.from_arrays(self.robot, q, None, pose=np.arange(len(q)), **labels, **origin, **conditions)  # type: ignore[arg-type]
