"""Step change: base class of what changes once while the rows are measured, and stays: a collision, a bump, a slip."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from calflow.effects.base import OF_THE_FRAME, Effect
from calflow.effects.displacement import Displacement
from calflow.measurements.measurements import Measurements, borders, pauses
from calflow.robot.mechanism import Row
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

MOMENTS = 40  # most moments of one form that are searched at first
BOUND = 300.0  # standard deviations
FEWEST = 3  # fitted poses required before the first moment and after the last: one or two that are off are outliers


@dataclass(frozen=True)
class StepChange(Effect):
    """A change of constant size between two rows in measuring order, without a column of its own.

    The model's other parameters are of the time after it, and it acts, reversed, on the rows before: the robot as it was left,
    commands and later measurements know nothing of it, unless they state a time before it. Of images, after says after which it
    was; of rows, between which fitted ones, where some between them were held out. between [s] are the times of the last fitted
    row before it and of the first after it, empty where they are not known.
    """

    moment: float = 0.5
    after: str = ""
    between: tuple[float, ...] = ()

    needs: ClassVar[tuple[str, ...]] = ("order",)
    dated: ClassVar[bool] = True
    unnamed: ClassVar[tuple[str, ...]] = ("after", "between")  # the moment says as much

    @classmethod
    def kinds(cls, robot: Robot) -> tuple[Self, ...]:
        """Return its forms, at any moment."""
        return (cls(robot),)

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return each form at moments between rows, or images; none for unsuitable data."""
        if cls.lacking(robot, data):
            return ()
        moments = _spread(cls._moments(data), data)
        return tuple(kind.at(float(moment), data) for kind in cls.kinds(robot) for moment in moments)

    def at(self, moment: float, data: Measurements) -> Self:
        """Return the same at another moment of the data."""
        after = _image_before(data, moment) or _between_fitted_rows(data, moment)
        return replace(self, moment=moment, after=after, between=_times_about(data, moment))

    @classmethod
    def unstatable(cls) -> str:
        """Return that its moment is not known."""
        return "happens at a row that nobody knows yet"

    @classmethod
    def of_measuring(cls) -> bool:
        """Whether it belongs to the measuring, not to the robot as it was left: it does."""
        return True

    def undecided(self, data: Measurements) -> np.ndarray:
        """Return the rows between the last fitted one before the moment and the first after it."""
        order = data.table["order"].to_numpy(float)
        fitted = order[data.train]
        last = fitted[fitted < self.moment].max(initial=-np.inf)
        return np.asarray((order > last) & (order < fitted[fitted > self.moment].min(initial=np.inf)))

    def later(self, series: Measurements | None) -> Self:
        """Return the same at a moment before any row, but for rows on the same clock that state an earlier time."""
        return replace(self, moment=-abs(self.moment), between=self.between if series is None else ())

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return the moments about this one that the coarse search left out."""
        between = self._moments(data)
        reach = float(np.diff(_spread(between, data)).max(initial=1.0))
        return tuple(self.at(float(m), data) for m in between[np.abs(between - self.moment) <= reach])

    def same_as(self, other: Self) -> bool:
        """Whether the moments are too close for two separate steps."""
        return abs(other.moment - self.moment) < FEWEST

    @classmethod
    def _moments(cls, data: Measurements) -> np.ndarray:
        """Return all moments between rows, or images, with at least FEWEST fitted poses before and after.

        Between sessions a device's frame is a `session_frame` instead.
        """
        first, last = _spans(data).T
        fitted = data.only(data.train) if "split" in data.table else data
        poses = fitted.table.groupby("pose")["order"].agg(["min", "max"])
        if len(poses) < FEWEST:
            return np.empty(0)
        begun, ended = np.sort(poses, axis=0).T
        between = (first[1:] + last[:-1]) / 2
        between = between[(between > begun[FEWEST - 1]) & (between < ended[-FEWEST])]
        return between[~np.isin(between, borders(data))] if cls.family == OF_THE_FRAME else between

    @property
    def detail(self) -> str:
        """The image, or row, after which it happened."""
        return f"after {self.after or f'row {int(np.floor(self.moment))} in measuring order'}"

    def before(self, row: Row) -> ca.SX:
        """Return 1 for a row before the step, else 0, structurally where none is or its place in the order is not known.

        Of later rows the time tells, and between the fitted ones about the step it is the probability that it is to come.
        """
        if self.moment < 0:
            return self.to_come(row)
        return (row.order > 0) * (row.order < self.moment) if row.order.nnz() else ca.SX(1, 1)

    def to_come(self, row: Row) -> ca.SX:
        """Return the probability that the step comes after a row's time, structurally zero where either is not known."""
        if not (self.between and row.time.nnz()):
            return ca.SX(1, 1)
        last, first = self.between
        return ca.fmin(1, ca.fmax(0, (first - row.time) / (first - last)))


@dataclass(frozen=True)
class PointStep(StepChange):
    """A step that displaces points."""

    sds: ClassVar[Mapping[str, float]] = {"m": 3e-4, "rad": 1e-4}  # usual sizes by unit

    @property
    @abstractmethod
    def displacement(self) -> Displacement:
        """What happens to points."""

    def of_part(self, part: str) -> tuple[Parameter, ...]:
        """Return the figures of the displacement of a part."""
        return tuple(
            self.displacement.parameters(self, part, self.sds, BOUND, {"m": "step", "rad": "turn", "1": "step"})
        )

    def undone(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        """Return a point without its displacement where a row is before the step."""
        before = self.before(row)
        return point - self.displacement.moved(p, point) * before if before.nnz() else point


def _spans(data: Measurements) -> np.ndarray:
    """Return the first and last position in measuring order of each unit that no step divides, (n, 2): a row, or an image."""
    if not data.in_images:
        return np.repeat(np.unique(data.table["order"].to_numpy(float))[:, None], 2, axis=1)
    images = data.table.groupby(["pose", "repeat"])["order"].agg(["min", "max"])
    return images.sort_values("min").to_numpy(float)


def _image_before(data: Measurements, moment: float) -> str:
    """Return in words the last image before a moment, by its name if it has one, else by its pose; empty for rows of their own."""
    if not data.in_images:
        return ""
    order = data.table["order"].to_numpy(float)
    last = data.table.iloc[int(np.where(order < moment, order, -np.inf).argmax())]
    if last.get("image"):
        return f"image {last['image']}"
    return f"the image of pose {last['pose']}" + f", repeat {last['repeat']}" * (data.table["repeat"].nunique() > 1)


def _between_fitted_rows(data: Measurements, moment: float) -> str:
    """Return in words the fitted rows between which it was; empty where no other lies between them."""
    if "split" not in data.table:
        return ""
    fitted = data.table["order"].to_numpy(float)[data.train]
    first, end = fitted[fitted < moment].max(initial=0.0), fitted[fitted > moment].min(initial=np.inf)
    return f"row {first:.0f} and before row {end:.0f} in measuring order" if first and 1 < end - first < np.inf else ""


def _times_about(data: Measurements, moment: float) -> tuple[float, ...]:
    """Return the times of the last fitted row before a moment and of the first after it; empty where they do not tell."""
    if "time" not in data.given:
        return ()
    fitted = data.train if "split" in data.table else slice(None)
    order, time = (data.table[name].to_numpy(float)[fitted] for name in ("order", "time"))
    last, first = time[order < moment].max(initial=-np.inf), time[order > moment].min(initial=np.inf)
    return (float(last), float(first)) if -np.inf < last < first < np.inf else ()


def _spread(moments: np.ndarray, data: Measurements) -> np.ndarray:
    """Return an evenly spaced subset of the moments, at most MOMENTS, and those in pauses and between sessions."""
    if not len(moments):
        return moments
    order = data.table["order"].to_numpy(float)
    paused = [order[data.table["time"] <= end].max() + 0.5 for end, _ in pauses(data)]
    idle = np.abs(moments[:, None] - [*borders(data), *paused]).argmin(axis=0)
    return moments[np.unique([*np.linspace(0, len(moments) - 1, MOMENTS).astype(int), *idle])]
