"""Base classes of observations (measurement models with nuisance parameters of their own) and the catalogue of their kinds."""

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
from calflow.robot.frames import placement
from calflow.robot.parts import Parameter

Name = tuple[str, ...]
Six = tuple[float, float, float, float, float, float]
Links = Callable[[str], np.ndarray]  # frames (n_rows, 4, 4) of a link by name, as in `Seen.link`
NOWHERE: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PLACE = {"x": "m", "y": "m", "z": "m", "rx": "rad", "ry": "rad", "rz": "rad"}

UNKNOWN_SIZE_SD = 0.03  # share: of the size of a board or plate that nobody states
USUAL_SIZE_SD = 5e-4  # and of one that counts as exact
FURTHEST = 20.0  # standard deviations of what is stated at which it is a mistake


@dataclass(frozen=True)
class Seen:
    """The robot model's prediction for one row, in the measuring frame [m].

    point (3,) is the marker's position; device maps a point in a device's frame to the reported one, with the device's errors,
    and target maps a nominal point of a target to its true position. rotation returns the tool's orientation (3, 3), link the
    frame (4, 4) of a link by name (see `Robot.links`; by default the last one), and down the direction of gravity (3,); they are
    functions since they cost more and few observations need them.
    """

    point: ca.SX
    rotation: Callable[[], ca.SX]
    device: Callable[[ca.SX], ca.SX]
    link: Callable[[str], ca.SX]
    down: Callable[[], ca.SX]
    target: Callable[[ca.SX], ca.SX] = lambda point: point


class NoSettings(FileModel):
    """Settings of an observation kind without settings."""


@dataclass(frozen=True)
class Observation(ABC):
    """The measurement model of one kind of device, for the rows of one series.

    p is the column vector of its own (nuisance) parameters in the order declared. Everything downstream sees residuals alone;
    units states the unit of each, those of one unit side by side.
    """

    series: Series

    id: ClassVar[str]
    title: ClassVar[str]
    columns: ClassVar[Reported]
    settings: ClassVar[type[FileModel]] = NoSettings  # schema of a study's [measurements.settings]
    # The unit of each residual of a row; the noise is stated in the first.
    units: ClassVar[tuple[MeasurementUnit, ...]]
    touches: ClassVar[bool] = False  # whether the robot must touch an object for a row to be measured
    asked: ClassVar[str] = (
        "is what it touches, as [measurements.settings] places it, within reach?"  # where hardly any pose can
    )
    in_station: ClassVar[bool] = False  # whether values are reported in the frame of the series' station
    from_outside: ClassVar[bool] = False  # whether it determines the robot's base in the measuring frame
    of_marker: ClassVar[bool] = True  # whether its values depend on where markers are on their links
    size_setting: ClassVar[str] = ""  # the setting, if any, of how well the size of what is measured is known

    @classmethod
    @abstractmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of a series for the rows of a table (see `measurements`), not yet registered."""

    @classmethod
    def beside(cls, series: Series, table: pd.DataFrame, first: bool) -> Self:
        """Return the observation as one of several; first: whether its station is the measuring frame."""
        return cls.of(series, table)

    @classmethod
    def planned(cls, series: Series) -> Self:
        """Return the observation for rows still to be measured, with objects at the poses stated in the settings.

        Raises:
            ValueError: no pose is stated; the message names the settings that are missing.
        """
        return cls.of(series, pd.DataFrame({label: [] for label in cls.columns.labels}, dtype=str))

    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the nuisance parameters."""

    def of_unknown_size(self) -> Self:
        """Return the observation as if nobody had said how large what it measures is."""
        if not self.size_setting or (self.series.number(self.size_setting) or 0.0) >= UNKNOWN_SIZE_SD:
            return self
        settings = {**dict(self.series.settings), self.size_setting: UNKNOWN_SIZE_SD}
        return replace(self, series=replace(self.series, settings=tuple(settings.items())))

    def beside_base(self) -> Self:
        """Return the observation where the base is the measuring frame: what is known there is known of the base roughly."""
        return self

    @cached_property
    def declared(self) -> tuple[Parameter, ...]:
        """The parameters, computed once."""
        return self.parameters()

    @property
    def n_seen(self) -> int:
        """Number of points of what is observed that a pose to be planned shows, each a row (`expected`)."""
        return 1

    @property
    @abstractmethod
    def reports(self) -> int:
        """Number of values per row in `reported`."""

    @abstractmethod
    def reported(self, table: pd.DataFrame) -> np.ndarray:
        """Return the reported values of each row and, one-hot, the object they are of, shape (reports, n_rows)."""

    @abstractmethod
    def error(self, p: ca.SX, seen: Seen, y: ca.SX) -> ca.SX:
        """Return the residuals of a row, predicted minus reported, one per unit; y is its column of `reported`."""

    def axes(self, p: np.ndarray, table: pd.DataFrame) -> np.ndarray | None:
        """Return the axes (n_rows, 3, 3), in the measuring frame, of three length residuals; None for the frame's own axes."""
        return None

    def registered(self, points: np.ndarray, links: Links, table: pd.DataFrame) -> Self:
        """Return the observation with its objects registered to the nominal robot's points (n_rows, 3) [m]."""
        return self

    @property
    def placements(self) -> dict[str, Six]:
        """Nominal poses of the objects by name: origin [m] and angles about x, y, z in turn [rad], which the parameters correct."""
        return {}

    def placed(self, placements: Mapping[str, Six]) -> Self:
        """Return the observation with its objects at the `placements` of an earlier one."""
        return self

    @abstractmethod
    def expected(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the values expected at points (n, 3) and rotations (n, 3, 3), shape (reports, n).

        They are those of the first of several objects, in the measuring frame.
        """

    def touched(self, points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Return the values expected where the robot touches the object near these points, shape (reports, n)."""
        return self.expected(points, rotations)

    def in_space(self, values: np.ndarray, links: Links, table: pd.DataFrame, error: np.ndarray) -> np.ndarray | None:
        """Return the error of each image as a displacement in space, (n_images, 3) [m]; None for other observations.

        values are all parameters as declared, links as for `registered`, error (n_rows, n_units) predicted minus reported.
        """
        return None

    def closed_forms(self, values: np.ndarray, links: Links, table: pd.DataFrame) -> Mapping[str, Self | str]:
        """Return the observation with its objects placed by closed-form methods, by name; for a method that fails, the reason.

        values and links as for `in_space`. Empty where no such method exists.
        """
        return {}

    def sees(self, links: Links) -> np.ndarray | None:
        """Return whether a row can be observed at each pose, (n_rows,), links as for `registered`; None: at all poses."""
        return None

    def lacks(self, table: pd.DataFrame) -> bool:
        """Whether rows are of an object or session (a socket, say) without parameters in this observation."""
        return self.extended(table) != self

    def extended(self, table: pd.DataFrame) -> Self:
        """Return the observation with those objects and sessions added, not yet registered."""
        return self

    @property
    def part(self) -> str:
        """Name of its parameters' part."""
        return self.series.name or self.id


@dataclass(frozen=True)
class OfThings(Observation):
    """Rows of named objects, each with a pose of its own: nominal holds origins [m] and angles about x, y, z in turn [rad].

    A name consists of the values in the columns labelled_by, empty for a column that is missing.
    """

    names: tuple[Name, ...] = ()
    nominal: tuple[Six, ...] = ()

    labelled_by: ClassVar[tuple[str, ...]] = ()
    of_row: ClassVar[int] = 0  # number of values in a row's `reported` before the one-hot object

    @classmethod
    def of(cls, series: Series, table: pd.DataFrame) -> Self:
        """Return the observation of the objects that the rows name."""
        return cls(series).extended(table)

    @classmethod
    def at(cls, series: Series, place: Sequence[float]) -> Self:
        """Return the observation of one unnamed object at a position (3,) or pose (6,)."""
        return cls(series, (("",) * len(cls.labelled_by),), (six(place),))

    @property
    def reports(self) -> int:
        """Number of values: those of the row, and its one-hot object."""
        return self.of_row + len(self.names)

    @property
    def begun(self) -> Six:
        """Pose of an object before registration."""
        return NOWHERE

    def labels(self, table: pd.DataFrame) -> list[Name]:
        """Return the name of each row's object."""
        columns = [table[label].astype(str) if label in table else [""] * len(table) for label in self.labelled_by]
        return list(zip(*columns, strict=True)) if columns else [()] * len(table)

    def part_of(self, name: Name) -> str:
        """Return the name of the parameters' part of an object."""
        return "-".join(filter(None, (self.part, *name)))

    def frame(self, errors: ca.SX, which: ca.SX) -> ca.SX:
        """Return the frame (4, 4) of a row's object; errors are those of all poses, (6 · n_objects,), or none of known ones."""
        stands = placement(ca.DM(np.array(self.nominal)).T @ which)
        return stands @ placement(ca.reshape(errors, 6, len(self.names)) @ which) if errors.numel() else stands

    def which(self, table: pd.DataFrame) -> list[np.ndarray]:
        """Return, for each object, which rows are of it, (n_rows,)."""
        number = {name: k for k, name in enumerate(self.names)}
        thing = np.array([number.get(name, -1) for name in self.labels(table)], dtype=int)
        return [thing == k for k in range(len(self.names))]

    def laid(self, table: pd.DataFrame, found: Callable[[np.ndarray], Iterable[float] | None], fewest: int = 1) -> Self:
        """Return the observation with each object at the pose found from its rows (a mask); unchanged if found gives None."""
        places = [found(rows) if rows.sum() >= fewest else None for rows in self.which(table)]
        return replace(self, nominal=tuple(
            before if place is None else six(place) for place, before in zip(places, self.nominal, strict=True)
        ))  # fmt: skip

    @property
    def placements(self) -> dict[str, Six]:
        """The objects' nominal poses."""
        return dict(zip(map(self.part_of, self.names), self.nominal, strict=True))

    def placed(self, placements: Mapping[str, Six]) -> Self:
        """Return the observation with the objects' poses of an earlier one."""
        return replace(self, nominal=tuple(placements[self.part_of(name)] for name in self.names))

    def new(self, table: pd.DataFrame) -> list[Name]:
        """Return the names of objects that the observation does not have yet."""
        return [name for name in dict.fromkeys(self.labels(table)) if name not in self.names]

    def extended(self, table: pd.DataFrame) -> Self:
        """Return the observation with the new objects added."""
        new = tuple(self.new(table))
        return replace(self, names=self.names + new, nominal=self.nominal + (self.begun,) * len(new))


def six(place: Iterable[float]) -> Six:
    """Return a position (3,) or pose (6,) as a pose."""
    x, y, z, rx, ry, rz = (*map(float, place), *NOWHERE)[:6]
    return x, y, z, rx, ry, rz


@lru_cache
def observation_kinds() -> dict[str, type[Observation]]:
    """Return every kind of observation by its id, from the files of this folder and other packages' entry points.

    Raises:
        InputError: an observation of another package cannot be used.
    """
    return plugins.catalogue_of(__package__, plugins.OBSERVATIONS, Observation, _flaw)  # type: ignore[type-abstract]


def _flaw(kind: type[Observation]) -> str:
    """Return what is wrong with the units of a kind from another package; empty where nothing is."""
    units = getattr(kind, "units", ())
    if units and all(isinstance(unit, MeasurementUnit) for unit in units):
        return ""
    return "its units say nothing of how a residual is told: expected a calflow.files.units.MeasurementUnit each, such as METRE"


def observations(data: Measurements) -> tuple[Observation, ...]:
    """Return the observation of each of the data's series, not yet registered.

    The first station is the measuring frame; other series with a station of the same name share it.
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
    """Return, for each of the data's series, the unit in which its noise is stated: that of its first residual."""
    return tuple(_kind(series, data.table).units[0] for series in data.series)


def _kind(series: Series, table: pd.DataFrame) -> type[Observation]:
    """Return the kind of observation of a series' rows."""
    return observation_kinds()[series.kind_in(table)]
