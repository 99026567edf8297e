"""Of images: base class of effects of a camera or of its target, of each by itself where there are several."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np

from calflow.effects.base import Effect
from calflow.measurements.measurements import Measurements
from calflow.robot.mechanism import Row, name_number
from calflow.robot.robot import Robot


@dataclass(frozen=True)
class OfImages(Effect):
    """An effect of a camera, or of a target where that is its whole: of one of them by its name, where there are several."""

    of: str = ""

    imaged = True

    @classmethod
    def what(cls) -> str:
        """Return what it is of: target or camera, the label that names which."""
        return cls.whole if cls.whole == "target" else "camera"

    @classmethod
    def unfit(cls, robot: Robot, data: Measurements) -> str:
        """Return what is missing where images are not of stated points."""
        return "" if "px_z" in data.table else "images of points stated as px_x, px_y and px_z"

    @classmethod
    def variants(cls, robot: Robot, data: Measurements) -> tuple[Self, ...]:
        """Return its forms, of each of several cameras (or targets) those that its own rows may show."""
        if cls.lacking(robot, data):
            return ()
        names, found = data.imaged(cls.what()), list[Self]()
        every = dict.fromkeys(names)
        for name in every if len(every) > 1 else ():
            own = data.only(names == name)
            found += [replace(form, of=name) for form in super().variants(robot, own) if not cls.lacking(robot, own)]
        return tuple(found) if len(every) > 1 else super().variants(robot, data)

    def finer(self, data: Measurements) -> tuple[Self, ...]:
        """Return those between this one and its neighbours by its own rows."""
        return super().finer(data.only(self._shown(data)))

    def undecided(self, data: Measurements) -> np.ndarray:
        """Return the rows of its camera (or target) in which the fitted ones do not tell whether it acts."""
        about = self._shown(data)
        about[about] = super().undecided(data.only(about))
        return about

    def same_as(self, other: Self) -> bool:
        """Whether both are forms of the same of one camera (or target)."""
        return self.of == other.of and super().same_as(other)

    @property
    def detail(self) -> str:
        """The form, and which of several it is of."""
        return ", ".join(filter(None, (super().detail, self.of and f"{self.what()} {self.of}")))

    def mine(self, row: Row) -> ca.SX | float:
        """Return 1 for a row of its camera (or target), else 0."""
        return getattr(row, f"{self.what()}_number") == name_number(self.of) if self.of else 1.0

    def _shown(self, data: Measurements) -> np.ndarray:
        """Return the mask of the rows of its camera (or target), (n_rows,)."""
        return data.imaged(self.what()) == self.of if self.of else np.ones(len(data), dtype=bool)
