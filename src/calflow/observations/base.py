"""What every observation is: what a device reports of a row, with nuisance parameters of its own; and which kinds there are."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import ClassVar, Self

import casadi as ca
import numpy as np

from calflow.files import plugins
from calflow.files.deferred import pd
from calflow.files.toml import FileModel
from calflow.files.units import MeasurementUnit
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import Reported
from calflow.measurements.series import Series
from calflow.robot.frames import vector
from calflow.robot.parts import Parameter

Name = tuple[str, ...]
Six = tuple[float, float, float, float, float, float]
NOWHERE: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PLACE = {"x": "m", "y": "m", "z": "m", "rx": "rad", "ry": "rad", "rz": "rad"}

UNKNOWN_SD, UNKNOWN_BOUND = 0.5, 3.0  # m and rad: of what nobody wrote down, about its registered place


@dataclass(frozen=True)
class Seen:
    """What the graph says of one row, in the measuring frame [m].

    point (3,) is where the marker is; device maps a point in a device's frame to what the device reports of it, its own errors
    included, and target a point of a target to where it really is on it. rotation gives how the tool is turned (3, 3), link the
    frame (4, 4) of the link of a name (see `Robot.links`; of the last one without a name), in which what is on it is stated, and
    down where gravity points (3,): these take longer, and few ask for them.
    """

    point: ca.SX
    rotation: Callable[[], ca.SX]
    device: Callable[[ca.SX], ca.SX]
    link: Callable[[str], ca.SX]
    down: Callable[[], ca.SX]
    target: Callable[[ca.SX], ca.SX] = lambda point: point


class NoSettings(FileModel):
    """Settings of a kind that has none."""


@dataclass(frozen=True)
class Placement:
    """Where something that is not the robot is thought to be: origin (3,) [m] and rotation (3,) [rad] about x, y, z in turn."""

    what: str
    origin: tuple[float, float, float]
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Observation(ABC):
    """What one kind of device reports, for the rows of one series.

    p is the column of its own (nuisance) parameters in the order declared. Everything after it sees residuals: units says
    of each of them what it is in, those of one unit side by side.
    """

    series: Series

    id: ClassVar[str]
    title: ClassVar[str]
    columns: ClassVar[Reported]
    settings: ClassVar[type[FileModel]] = NoSettings  # what a study's [measurements.settings] may say
    # Of each residual of a row; the first is the one its noise is stated in.
    units: ClassVar[tuple[MeasurementUnit, ...]]
    touches: ClassVar[bool] = False  # whether the robot must be brought to something for a row to be measured
    in_station: ClassVar[bool] = False  # whether it is reported in the frame of its series' station
    from_outside: ClassVar[bool] = False  # whether it tells where the robot stands in the measuring frame

    @classmethod
    @abstractmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of a series for the rows of a table (see `measurements`), nothing placed yet."""

    @classmethod
    def beside(cls, series: Series, table: pd.DataFrame, first: bool) -> Self:
        """Return the observation among others; first says whether its station is the measuring frame."""
        return cls.of(series, table)

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return the observation for rows that are still to be measured, what is not the robot where the settings say.

        Raises:
            ValueError: nothing is said of where it is; the message says what to state.
        """
        return cls.of(series, pd.DataFrame({label: [] for label in cls.columns.labels}, dtype=str))

    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the nuisance parameters."""

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """The parameters, worked out once."""
        return self.parameters()

    @property
    @abstractmethod
    def reports(self) -> int:
        """How many values of a row `reported` packs."""

    @abstractmethod
    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return what was reported of each row, and which of several things it was of, shape (reports, n_rows)."""

    @abstractmethod
    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return predicted minus reported, one residual a unit; y is one row of `reported`."""

    def axes(self, p: np.ndarray, table: pd.DataFrame) -> np.ndarray | None:
        """Return the axes of the measuring frame (n_rows, 3, 3) in which rows tell three lengths; None where in its own."""
        return None

    def registered(self, points: np.ndarray, rotations: np.ndarray, table: pd.DataFrame) -> Self:
        """Return the observation with what is not the robot placed by the nominal robot's points (n_rows, 3) [m]."""
        return self

    def registered_on(
        self, links: Callable[[str], np.ndarray], points: np.ndarray, rotations: np.ndarray, table: pd.DataFrame
    ) -> Self:
        """Return what `registered` does; links gives the frames (n_rows, 4, 4) of a link, as `Seen.link` has them."""
        return self.registered(points, rotations, table)

    @property
    def placements(self) -> tuple[Placement, ...]:
        """Where the things are that the parameters are errors of."""
        return ()

    def placed(self, placements: dict[str, Placement]) -> Self:
        """Return the observation with the things where `placements` of an earlier one had them."""
        return self

    @abstractmethod
    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return what would be reported of points (n, 3) and rotations (n, 3, 3), shape (reports, n).

        It is that of the first of several things, in the measuring frame.
        """

    def touched(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return what would be reported where the robot touches, near these points, shape (reports, n)."""
        return self.expected(points, rotations)

    def in_space(
        self, values: np.ndarray, links: Callable[[str], np.ndarray], table: pd.DataFrame, error: np.ndarray
    ) -> np.ndarray | None:
        """Return how far each image is from what the robot says of it, (n_images, 3) [m]; None where no images are observed.

        values are all parameters as declared, links as of `registered_on`, error (n_rows, n_units) predicted minus reported.
        """
        return None

    def closed_forms(
        self, values: np.ndarray, links: Callable[[str], np.ndarray], table: pd.DataFrame
    ) -> Mapping[str, Self | str]:
        """Return it with what is not the robot placed by other methods, by their names; of one that fails why.

        values and links as of `in_space`. None where there are none to compare with.
        """
        return {}

    def sees(self, links: Callable[[str], np.ndarray]) -> np.ndarray | None:
        """Return at which poses a row can be observed, (n_rows,), links as of `registered_on`; None: at all."""
        return None

    def lacks(self, table: pd.DataFrame) -> bool:
        """Whether rows are of something (a socket, a session) that has no parameters here yet."""
        return False

    def extended(self, table: pd.DataFrame) -> Self:
        """Return the observation with what it lacks, not placed yet."""
        return self

    @property
    def part(self) -> str:
        """What its parameters' part is called."""
        return self.series.name or self.id


@dataclass(frozen=True)
class OfThings(Observation):
    """Rows of things that have names and places of their own: nominal are origins [m] and angles about x, y, z in turn [rad].

    A name holds what each of the columns labelled_by says, nothing where there is none.
    """

    names: tuple[Name, ...] = ()
    nominal: tuple[Six, ...] = ()

    labelled_by: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of the things that the rows name."""
        return cls(series).extended(table)

    @classmethod
    def at(cls, series: Series, place: Sequence[float]) -> Self:
        """Return it of one thing without a name, at a place (3,) or (6,)."""
        return cls(series, (("",) * len(cls.labelled_by),), (six(place),))

    @property
    def begun(self) -> Six:
        """Where a thing is before it is placed."""
        return NOWHERE

    def labels(self, table: pd.DataFrame) -> list[Name]:
        """Return the name of each row's thing."""
        columns = [table[label].astype(str) if label in table else [""] * len(table) for label in self.labelled_by]
        return list(zip(*columns, strict=True)) if columns else [()] * len(table)

    def part_of(self, name: Name) -> str:
        """Return what the parameters' part of a thing is called."""
        return "-".join(filter(None, (self.part, *name)))

    def which(self, table: pd.DataFrame) -> list[np.ndarray]:
        """Return the things that rows are of, one-hot, (n_rows,) each."""
        number = {name: k for k, name in enumerate(self.names)}
        thing = np.array([number.get(name, -1) for name in self.labels(table)], dtype=int)
        return [thing == k for k in range(len(self.names))]

    def laid(self, table: pd.DataFrame, found: Callable[[np.ndarray], Iterable[float] | None], fewest: int = 1) -> Self:
        """Return it with each thing where its rows (a mask) have it; as it is where they are too few, or do not tell."""
        places = [found(rows) if rows.sum() >= fewest else None for rows in self.which(table)]
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

    def new(self, table: pd.DataFrame) -> list[Name]:
        """Return the names of things that it does not have yet."""
        return [name for name in dict.fromkeys(self.labels(table)) if name not in self.names]

    def lacks(self, table: pd.DataFrame) -> bool:
        """Whether a thing is new."""
        return bool(self.new(table))

    def extended(self, table: pd.DataFrame) -> Self:
        """Return it with the new things."""
        new = tuple(self.new(table))
        return replace(self, names=self.names + new, nominal=self.nominal + (self.begun,) * len(new))


def six(place: Iterable[float]) -> Six:
    """Return a place of three or six figures as six."""
    x, y, z, rx, ry, rz = (*map(float, place), *NOWHERE)[:6]
    return x, y, z, rx, ry, rz


@lru_cache
def observation_kinds() -> dict[str, type[Observation]]:
    """Return every kind of observation by its id: a new file in this folder is enough, or another package's entry point.

    Raises:
        InputError: another package brings what cannot be used.
    """
    return plugins.catalogue_of(__package__, plugins.OBSERVATIONS, Observation, _flaw)  # type: ignore[type-abstract]


def _flaw(kind: type[Observation]) -> str:
    """What is wrong with the units of a kind that another package brings; empty where nothing is."""
    units = getattr(kind, "units", ())
    if units and all(isinstance(unit, MeasurementUnit) for unit in units):
        return ""
    return "its units say nothing of how a residual is told: expected a calflow.files.units.MeasurementUnit each, such as METRE"


def observations(data: Measurements) -> tuple[Observation, ...]:
    """Return what was observed in each of the data's series, nothing placed yet.

    The first station is the measuring frame; another of the same name stands where it does.
    """
    tables = [data.table[data.of_series(k)] for k in range(len(data.series))]
    kinds = [_kind(series, table) for series, table in zip(data.series, tables, strict=True)]
    stations = (series.station.name for series, kind in zip(data.series, kinds, strict=True) if kind.in_station)
    first = next(stations, None)
    return tuple(
        kind.beside(series, table, series.station.name == first)
        for series, kind, table in zip(data.series, kinds, tables, strict=True)
    )


def leading_units(data: Measurements) -> tuple[MeasurementUnit, ...]:
    """Return for each of the data's series the unit that its noise is stated in: that of its first residual."""
    return tuple(_kind(series, data.table).units[0] for series in data.series)


def _kind(series: Series, table: pd.DataFrame) -> type[Observation]:
    """What kind of observation the rows of a series are."""
    return observation_kinds()[series.kind or ("pose" if {"rx", "qw"} & set(table) else "position")]
