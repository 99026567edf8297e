"""Figures for the controller: as the maker counts them, in mm and degrees, beside their differences from the robot file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calflow.deployment.figures_alone import NOT_COMPUTED, Levels
from calflow.effects.geometry import Geometry
from calflow.estimation.parameters import FittedParameter
from calflow.files.words import effect_words, first_up, listed, number
from calflow.reporting.blocks import Block, Paragraph, Table, headed
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.robot.frames import angles
from calflow.robot.parts import Base
from calflow.robot.robot import Robot

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

    def beside(self, stated: float) -> Figure:
        """Return it with its difference from what the robot file states, where that is another figure."""
        if stated == self.nominal:
            return self
        return replace(self, nominal=stated, difference=self.calibrated - stated)


def links(material: Material) -> list[list[Figure]]:
    """Return every joint's figures, in the robot file's convention."""
    rows = _geometry(material)
    return [
        [_figure([row for row in rows if row.joint == i and row.symbol == step.symbol], step.symbol, step.unit, step.value)
         for step in frame.steps]
        for i, frame in enumerate(material.calibrated.model.robot.frames, start=1)
    ]  # fmt: skip


def markers(material: Material) -> dict[str, list[Figure]]:
    """Return where each marker, the tool's point, sits in the flange's frame; the training poses may have placed it anew."""
    rows, robot, stated = _geometry(material), material.calibrated.model.robot, material.robot.markers
    return {
        name: [
            _figure(
                [row for row in rows if row.part == name and row.symbol == axis], axis, "m", marker.point[k]
            ).beside(SHOWN["m"] * stated[name].point[k])
            for k, axis in enumerate("xyz")
        ]
        for name, marker in robot.markers.items()
    }


def bars(material: Material) -> list[Figure]:
    """Return the lengths of the loop's bars; none where there is no loop."""
    rows, loop = _geometry(material), material.calibrated.model.robot.loop
    if loop is None:
        return []
    lengths = {"crank": loop.crank.length, "rod": loop.rod.length, "rocker": loop.rocker}
    return [_figure([row for row in rows if row.part == "loop" and row.symbol == name], name, "m", length)
            for name, length in lengths.items()]  # fmt: skip


def base(material: Material) -> Base:
    """Return where the calibrated robot stands in the measuring frame."""
    rows, nominal = _geometry(material), material.calibrated.model.robot.base
    base = {row.symbol: row.estimate for row in rows if row.part == "base"}
    shift = np.array([base.get(axis, 0.0) for axis in "xyz"])
    turn = Rotation.from_euler("XYZ", [base.get(angle, 0.0) for angle in ANGLES])
    stands = Rotation.from_euler("XYZ", nominal.rotation)
    x, y, z = np.array(nominal.origin) + stands.apply(shift)
    rx, ry, rz = angles(stands * turn)
    return Base(origin=(x, y, z), rotation=(rx, ry, rz), known=nominal.known)


def zeros(robot: Robot, levels: Levels) -> list[float]:
    """Return what has to be added to each joint's reading so that the maker's zero is true [deg, or mm of a slide].

    A reading counts with its sign and its couplings: reading = C⁻¹ · angle.
    """
    rows = [row for row in levels.alone["zeros and tool"].parameters if row.effect == Geometry.id]
    off = [
        sum(row.estimate for row in rows if row.joint == i and row.symbol == joint.moving.symbol)
        for i, joint in enumerate(robot.joints, start=1)
    ]
    readings = robot.angle_matrix @ np.array(off)
    return [float(value * joint.shown[1]) for value, joint in zip(readings, robot.joints, strict=True)]


def _geometry(material: Material) -> list[FittedParameter]:
    return [row for row in material.figures if row.effect == Geometry.id]


def _figure(rows: Sequence[FittedParameter], symbol: str, unit: str, nominal: float) -> Figure:
    """Return a figure with its difference, if it is one of the parameters."""
    factor, shown = SHOWN[unit], "mm" if unit == "m" else "deg"
    if not rows:
        return Figure(symbol, shown, factor * nominal)
    difference = factor * (rows[0].estimate - rows[0].nominal)
    return Figure(symbol, shown, factor * nominal, difference, rows[0].prior_share <= BY_PRIOR)


INTRODUCTION = (
    "The calibrated robot in its maker's terms; Δ beside a figure is its difference from the robot file. A Δ in brackets rests on "
    "prior knowledge: the data do not determine it. Figures without Δ are those of the robot file; others absorb their "
    "errors."
)
ORDER = {
    "modified-dh": "Each link is Rx(alpha) Tx(a) Ry(beta) Rz(theta + joint) Tz(d).",
    "dh": "Each link is Rz(theta + joint) Tz(d) Tx(a) Rx(alpha) Ry(beta).",
}
NO_BETA = " beta turns about y where two axes are nearly parallel; for a controller that has no beta, leave it out."
WORTH = "Page one says how accurate the robot becomes with these figures, and with less or more than these."
ANEW = (
    "No such figure can hold {others}, so the figures below were fitted without it: they absorb what they can of it, and differ "
    "from the model's own."
)
ZEROS = (
    "For a controller that takes joint zeros alone: add these to its readings. They were fitted with the maker's lengths and "
    "twists, and count as the readings do, signs and couplings included."
)
LOOPED = " The driven joint's zero is that of the joint itself, behind the loop, not the motor's."
BASE = (
    "Where the robot stands in the measuring frame, in mm and degrees. The same rotation as controllers state it: {ways}. It holds "
    "for this measurement: on another day, or with the instrument elsewhere, it differs."
)
TOOL = "Where each marker sits in the flange's frame, in which tools are stated."


def _controller_figures(material: Material) -> list[Block]:
    """Tabulate links, zeros, base and tool, and say what these figures alone are worth."""
    robot = material.calibrated.model.robot
    joints = links(material)
    curved = any(figure.symbol == "beta" and figure.calibrated for figures in joints for figure in figures)
    order = ORDER.get(robot.kinematics, "") + NO_BETA * curved
    lengths, header = bars(material), [f"joint {i} [{joint.shown[0]}]" for i, joint in enumerate(robot.joints, start=1)]
    added = [number(value, "+.4f") for value in zeros(robot, material.levels)] if material.levels else []
    return [
        *_worth(material),
        Paragraph(f"{INTRODUCTION} {order}", keep=True),
        _matrix("joint", [(str(i), figures) for i, figures in enumerate(joints, start=1)]),
        *headed("Bars of the loop", _matrix("bar", [("length", lengths)]), where=lengths),
        *headed(
            "Zeros of the joints",
            Paragraph(ZEROS + LOOPED * (robot.loop is not None), keep=True),
            Table(header, [added], "r" * len(header), size=8),
            where=added,
        ),
        *headed("Tool", Paragraph(TOOL, keep=True), _matrix("marker", list(markers(material).items()))),
        *headed("Base", *_base(material)),
    ]


def _worth(material: Material) -> list[Block]:
    """Say what the figures are fitted without, and where they do harm; page one says what they are worth."""
    levels = material.levels
    if levels is None:
        return [Paragraph(f"{first_up(NOT_COMPUTED)}: run the study again.")]
    others = list(dict.fromkeys(effect_words(effect.id) for effect in levels.left_out))
    anew = [ANEW.format(others=listed(others, 6))] if others else []
    harm = [first_up(f"{levels.harm}.")] if levels.harm else []
    return [Paragraph(" ".join((WORTH, *anew, *harm)), keep=True)]


def _matrix(what: str, rows: Sequence[tuple[str, Sequence[Figure]]]) -> Table:
    """Return a table with a row for each joint or marker: every figure that any of them has, with its difference."""
    every = [figure for _, figures in rows for figure in figures]
    there = [figure for figure in every if figure.nominal or figure.difference is not None]
    columns = dict.fromkeys((figure.symbol, figure.unit) for figure in there)
    header = [what, *(name for symbol, unit in columns for name in (f"{symbol} [{unit}]", "Δ"))]
    cells = []
    for name, figures in rows:
        by_symbol = {(figure.symbol, figure.unit): figure for figure in figures}
        cells.append([name, *(cell for column in columns for cell in _cells(by_symbol.get(column)))])
    return Table(header, cells, "l" + "rr" * len(columns), size=8)


def _cells(figure: Figure | None) -> tuple[str, str]:
    if figure is None:
        return "–", ""
    digits = ".3f" if figure.unit == "mm" else ".4f"
    if figure.difference is None:
        return number(figure.calibrated, digits), ""
    difference = number(figure.difference, f"+{digits}")
    return number(figure.calibrated, digits), difference if figure.measured else f"({difference})"


def _base(material: Material) -> list[Block]:
    stands = base(material)
    turn = Rotation.from_euler("XYZ", stands.rotation)
    w, p, r = np.rad2deg(angles(turn, "xyz"))
    a, b, c = np.rad2deg(angles(turn, "ZYX"))
    x, y, z, scalar = turn.as_quat(canonical=True)
    ways = (
        f"W, P, R (FANUC) {_numbers((w, p, r), '.4f')}; A, B, C (KUKA) {_numbers((a, b, c), '.4f')}; q1 to q4 (ABB) "
        f"{_numbers((scalar, x, y, z), '.7f')}; rotation vector in rad (Universal Robots) {_numbers(turn.as_rotvec(), '.6f')}"
    )
    header = ("base", "x [mm]", "y [mm]", "z [mm]", "rx [deg]", "ry [deg]", "rz [deg]")
    rows = [("calibrated", *_placed(stands.origin, stands.rotation))]
    nominal = material.robot.base
    if nominal.known:
        rows.append(("robot file", *_placed(nominal.origin, nominal.rotation)))
    return [Paragraph(BASE.format(ways=ways), keep=True), Table(header, rows, "lrrrrrr", size=8)]


def _placed(origin: Sequence[float], rotation: Sequence[float]) -> list[str]:
    return [*(number(1e3 * v, ".3f") for v in origin), *(number(float(np.rad2deg(v)), ".4f") for v in rotation)]


def _numbers(values: Sequence[float] | np.ndarray, form: str) -> str:
    return ", ".join(number(float(value), form) for value in values)


CONTROLLER_SECTION = Section(
    20, "Figures for the controller", "identify/parameters.csv", _controller_figures,
    lambda outcome: any(row.effect == Geometry.id for row in outcome.fitted_parameters),
)  # fmt: skip
