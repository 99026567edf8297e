"""Touched things: planes, balls, cubes and artefacts, each with a place that nobody knows, told apart by a name in a row."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from calflow.files.deferred import pd
from calflow.measurements.series import Series
from calflow.observations.base import UNKNOWN_BOUND, UNKNOWN_SD, Observation, Placement
from calflow.robot.frames import placement, vector
from calflow.robot.parts import Parameter

Six = tuple[float, float, float, float, float, float]
NOWHERE: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PLACE = {"x": "m", "y": "m", "z": "m", "rx": "rad", "ry": "rad", "rz": "rad"}


@dataclass(frozen=True)
class Touched(Observation):
    """Rows of things with places of their own, by their name in the column `label`; nominal are origins and angles."""

    names: tuple[str, ...] = ("",)
    nominal: tuple[Six, ...] = (NOWHERE,)

    label: ClassVar[str]
    touches = True

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of the things that the rows name."""
        return cls(series, (), ()).extended(table)

    @classmethod
    def at(cls, series: Series, place: Sequence[float]) -> Self:
        """Return it of one thing without a name, at a place (3,) or (6,)."""
        return cls(series, ("",), (six(place),))

    def part_of(self, name: str) -> str:
        """Return what the parameters' part of a thing is called."""
        return f"{self.part}-{name}" if name else self.part

    def place_errors(self, symbols: Sequence[str] = tuple(PLACE)) -> list[Parameter]:
        """Return the errors of each thing's place, in its own axes."""
        return [
            Parameter(self.id, self.part_of(name), symbol, PLACE[symbol], UNKNOWN_SD, -UNKNOWN_BOUND, UNKNOWN_BOUND,
                      meaning=f"{symbol} of {self.part_of(name)}")
            for name in self.names for symbol in symbols
        ]  # fmt: skip

    def which(self, table: pd.DataFrame) -> list[np.ndarray]:
        """Return the things that rows are of, one-hot, (n_rows,) each."""
        names = np.array(self._labels(table), dtype=object)
        return [names == name for name in self.names]

    def first(self, n: int) -> np.ndarray:
        """Return the same of n rows of the first thing, (n_things, n)."""
        places = np.zeros((len(self.names), n))
        places[0] = 1.0
        return places

    def frame(self, errors: ca.SX, which: ca.SX) -> ca.SX:
        """Return the frame (4, 4) of a row's thing; errors are those of all places, (6 · n_things,)."""
        nominal = ca.DM(np.array(self.nominal)).T @ which
        return placement(nominal) @ placement(ca.reshape(errors, 6, len(self.names)) @ which)

    def laid(self, table: pd.DataFrame, found: Callable[[np.ndarray], Iterable[float] | None]) -> Self:
        """Return it with each thing where its rows (a mask) have it; as it is where they are too few."""
        places = [found(rows) for rows in self.which(table)]
        return replace(self, nominal=tuple(
            before if place is None else six(place) for place, before in zip(places, self.nominal, strict=True)
        ))  # fmt: skip

    @property
    def placements(self) -> tuple[Placement, ...]:
        """The things' places."""
        return tuple(
            Placement(self.part_of(name), vector(at[:3]), vector(at[3:]))
            for name, at in zip(self.names, self.nominal, strict=True)
        )

    def placed(self, placements: dict[str, Placement]) -> Self:
        """Return it with the things of an earlier one."""
        placed = [placements[self.part_of(name)] for name in self.names]
        return replace(self, nominal=tuple((*placement.origin, *placement.rotation) for placement in placed))

    def lacks(self, table: pd.DataFrame) -> bool:
        """Whether a thing is new."""
        return not set(self._labels(table)) <= set(self.names)

    def extended(self, table: pd.DataFrame) -> Self:
        """Return it with the new things."""
        new = tuple(name for name in dict.fromkeys(self._labels(table)) if name not in self.names)
        return replace(self, names=self.names + new, nominal=self.nominal + (NOWHERE,) * len(new))

    def _labels(self, table: pd.DataFrame) -> list[str]:
        return [str(name) for name in table[self.label]] if self.label in table else [""] * len(table)


@dataclass(frozen=True)
class Surface(Touched):
    """Heights of the marker over surfaces, or readings of them: 0 where none is reported, for the marker is on the surface then.

    The reading is the first that `reported` packs of a row.
    """

    @property
    def reports(self) -> int:
        """A reading, and which surface it is of."""
        return 1 + len(self.names)

    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the readings and the surfaces."""
        return np.vstack([self.readings(table), *self.which(table)]).astype(float)

    def readings(self, table: pd.DataFrame) -> np.ndarray:
        """Return the readings (n_rows,) [m]."""
        return table["reading"].to_numpy(float) if "reading" in table else np.zeros(len(table))

    def touched(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return readings of nothing: on the surface itself."""
        expected = self.expected(points, rotations)
        expected[0] = 0.0
        return expected


def six(place: Iterable[float]) -> Six:
    """Return a place of three or six figures as six."""
    x, y, z, rx, ry, rz = (*map(float, place), *NOWHERE)[:6]
    return x, y, z, rx, ry, rz
