"""The figures that a controller takes, from a calibrated model: as the maker counts them, in mm and degrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from calflow.effects.geometry import Geometry
from calflow.estimation.accuracy import errors
from calflow.reporting.material import Material, latest
from calflow.robot.angles import angles
from calflow.robot.parts import Base

BY_PRIOR = 0.5  # prior share from which a figure is left to the prior
SHOWN = {"m": 1e3, "rad": float(np.rad2deg(1.0))}  # mm and degrees
ANGLES = ("rx", "ry", "rz")


@dataclass(frozen=True)
class Figure:
    """One figure [mm or deg]: the maker's, and what it turned out to differ by; difference None: it is not one that was looked for.

    measured says whether the data tell it, and not prior knowledge alone.
    """

    symbol: str
    unit: str
    nominal: float
    difference: float | None = None
    measured: bool = True

    @property
    def calibrated(self) -> float:
        """What is to be typed in."""
        return self.nominal + (self.difference or 0.0)


def links(material: Material) -> list[list[Figure]]:
    """Return every joint's figures, in the robot file's convention."""
    found = _geometry(material)
    return [
        [_figure(found, (found["joint"] == i) & (found["symbol"] == step.symbol), step.symbol, step.unit, step.value)
         for step in frame.steps]
        for i, frame in enumerate(material.known.model.robot.frames, start=1)
    ]  # fmt: skip


def markers(material: Material) -> dict[str, list[Figure]]:
    """Return where each marker, the tool's point, sits in the flange's frame."""
    found, robot = _geometry(material), material.known.model.robot
    return {
        name: [_figure(found, (found["part"] == name) & (found["symbol"] == axis), axis, "m", marker.point[k])
               for k, axis in enumerate("xyz")]
        for name, marker in robot.markers.items()
    }  # fmt: skip


def bars(material: Material) -> list[Figure]:
    """Return the lengths of the loop's bars; none where there is no loop."""
    found, loop = _geometry(material), material.known.model.robot.loop
    if loop is None:
        return []
    lengths = {"crank": loop.crank.length, "rod": loop.rod.length, "rocker": loop.rocker}
    return [_figure(found, (found["part"] == "loop") & (found["symbol"] == name), name, "m", length)
            for name, length in lengths.items()]  # fmt: skip


def base(material: Material) -> Base:
    """Return where the calibrated robot stands in the measuring frame."""
    found, nominal = _geometry(material), material.known.model.robot.base
    own = found[found["part"] == "base"].set_index("symbol")["estimate"]
    shift = np.array([own.get(axis, 0.0) for axis in "xyz"])
    turn = Rotation.from_euler("XYZ", [own.get(angle, 0.0) for angle in ANGLES])
    stands = Rotation.from_euler("XYZ", nominal.rotation)
    x, y, z = np.array(nominal.origin) + stands.apply(shift)
    rx, ry, rz = angles(stands * turn)
    return Base(origin=(x, y, z), rotation=(rx, ry, rz), known=nominal.known)


def zeros(material: Material) -> list[float]:
    """Return what has to be added to each joint's reading so that the maker's zero is true [deg, or mm of a slide].

    A reading counts with its sign and its couplings: reading = C⁻¹ · angle.
    """
    robot = material.known.model.robot
    symbols = [joint.frame.slide.symbol if joint.frame.slide and joint.kind == "prismatic" else joint.frame.turn.symbol
               for joint in robot.joints]  # fmt: skip
    found = _geometry(material)
    off = [found.loc[(found["joint"] == i) & (found["symbol"] == symbol), "estimate"].sum()
           for i, symbol in enumerate(symbols, start=1)]  # fmt: skip
    readings = robot.angle_matrix @ np.array(off)
    return [float(value * joint.shown[1]) for value, joint in zip(readings, robot.joints, strict=True)]


def geometry_alone(material: Material) -> tuple[float, float]:
    """Return the mean and the largest error of the judged rows with these figures and nothing else of the model [mm]."""
    known = material.known
    own = np.array([parameter.effect == Geometry.id for parameter in known.model.parameters])
    left = errors(known.model, np.where(own, known.estimate, known.model.nominal), material.data)[material.judged]
    distance = 1e3 * np.sqrt(np.nansum(left**2, axis=1))
    return float(distance.mean()), float(distance.max())


def _geometry(material: Material) -> pd.DataFrame:
    parameters = latest(material.results, "parameters")
    return parameters[parameters["effect"] == Geometry.id]


def _figure(found: pd.DataFrame, which: pd.Series, symbol: str, unit: str, nominal: float) -> Figure:
    """Return a figure with its difference, if it is one of the parameters."""
    factor, shown = SHOWN[unit], "mm" if unit == "m" else "deg"
    own = found[which]
    if own.empty:
        return Figure(symbol, shown, factor * nominal)
    difference = factor * float((own["estimate"] - own["nominal"]).iloc[0])
    return Figure(symbol, shown, factor * nominal, difference, bool(own["prior_share"].iloc[0] <= BY_PRIOR))
