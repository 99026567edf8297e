"""Figures for the controller: as the maker counts them, in mm and degrees, beside their differences from the robot file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calflow.deployment.export import ControllerFigure, controller_figures, robot_of
from calflow.deployment.figures_alone import NOT_COMPUTED, Levels
from calflow.effects.geometry import Geometry
from calflow.files.words import effect_words, first_up, listed, number
from calflow.reporting.blocks import Block, Paragraph, Table, headed
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.robot.formats.controller_files import added_to_readings
from calflow.robot.robot import Robot

BY_PRIOR = 0.5  # prior share from which a figure is left to the prior
BASE_FIGURES = ("x", "y", "z", "rx", "ry", "rz")
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


@dataclass(frozen=True)
class Figure(ControllerFigure):
    """A figure with what the data tell of it: it was looked for, and it is measured, not prior knowledge alone."""

    looked_for: bool
    measured: bool

    @property
    def is_shown(self) -> bool:
        """Whether it is anything, or was looked for."""
        return bool(self.nominal) or self.looked_for

    def shown(self, value: float, sign: str = "") -> str:
        """Return a value as a table shows it."""
        return number(value, f"{sign}{'.3f' if self.unit == 'mm' else '.4f'}")


def reported_figures(material: Material) -> dict[str, dict[str, Figure]]:
    """Return the robot's figures by part (`joint 1`, `loop`, `base`, `marker NAME`) and symbol, beside those of the robot file."""
    robot, rows = material.robot, [row for row in material.figures.parameters if row.effect == Geometry.id]
    parts_of = {f"joint{i}": f"joint {i}" for i in range(1, robot.n_joints + 1)}
    parts_of |= {name: f"marker {name}" for name in robot.markers}
    fitted = {(parts_of.get(row.part, row.part), row.symbol): row for row in rows}
    parts: dict[str, dict[str, Figure]] = {}
    for figure in controller_figures(robot, robot_of(material.figures)):
        row = fitted.get((figure.part, figure.figure))
        looked_for, measured = row is not None or figure.difference != 0, row is None or row.prior_share <= BY_PRIOR
        parts.setdefault(figure.part, {})[figure.figure] = Figure(
            **vars(figure), looked_for=looked_for, measured=measured
        )
    return parts


def _controller_figures(material: Material) -> list[Block]:
    """Tabulate links, zeros, base and tool, and say what these figures alone are worth."""
    robot, parts = material.robot, reported_figures(material)
    joints = {
        str(i): [parts[f"joint {i}"][step.symbol] for step in frame.steps]
        for i, frame in enumerate(robot.frames, start=1)
    }
    curved = any(figure.figure == "beta" and figure.calibrated for row in joints.values() for figure in row)
    order = ORDER.get(robot.kinematics, "") + NO_BETA * curved
    header = [f"joint {i} [{joint.shown[0]}]" for i, joint in enumerate(robot.joints, start=1)]
    added = [number(value, "+.4f") for value in zeros(robot, material.levels)] if material.levels else []
    markers = {name: list(parts[f"marker {name}"].values()) for name in robot.markers}
    bars = parts.get("loop", {})
    return [
        *_worth(material),
        Paragraph(f"{INTRODUCTION} {order}", keep=True),
        _matrix("joint", joints),
        *headed("Bars of the loop", _matrix("bar", {"length": list(bars.values())}), where=bars),
        *headed(
            "Zeros of the joints",
            Paragraph(ZEROS + LOOPED * (robot.loop is not None), keep=True),
            Table(header, [added], "r" * len(header), size=8),
            where=added,
        ),
        *headed("Tool", Paragraph(TOOL, keep=True), _matrix("marker", markers)),
        *headed("Base", *_base(parts["base"], robot.base.known)),
    ]


def zeros(robot: Robot, levels: Levels) -> np.ndarray:
    """Return what has to be added to each joint's reading so that the maker's zero is true (n_joints,) [deg, or mm of a slide]."""
    return added_to_readings(robot, robot_of(levels.alone["zeros and tool"]))


def _worth(material: Material) -> list[Block]:
    """Say what the figures are fitted without, and where they do harm; page one says what they are worth."""
    levels = material.levels
    if levels is None:
        return [Paragraph(f"{first_up(NOT_COMPUTED)}: run the study again.")]
    others = list(dict.fromkeys(effect_words(effect.id) for effect in levels.left_out))
    anew = [ANEW.format(others=listed(others, 6))] if others else []
    harm = [first_up(f"{levels.harm}.")] if levels.harm else []
    return [Paragraph(" ".join((WORTH, *anew, *harm)), keep=True)]


def _matrix(what: str, rows: Mapping[str, Sequence[Figure]]) -> Table:
    """Return a table with a row for each joint or marker: every figure that any of them has, with its difference."""
    columns = dict.fromkeys((figure.figure, figure.unit) for row in rows.values() for figure in row if figure.is_shown)
    header = [what, *(name for symbol, unit in columns for name in (f"{symbol} [{unit}]", "Δ"))]
    cells = []
    for name, row in rows.items():
        by_symbol = {(figure.figure, figure.unit): figure for figure in row}
        cells.append([name, *(cell for column in columns for cell in _cells(by_symbol.get(column)))])
    return Table(header, cells, "l" + "rr" * len(columns), size=8)


def _cells(figure: Figure | None) -> tuple[str, str]:
    if figure is None:
        return "–", ""
    difference = figure.shown(figure.difference, "+") if figure.looked_for else ""
    return figure.shown(figure.calibrated), difference if figure.measured else f"({difference})"


def _base(base: Mapping[str, Figure], known: bool) -> list[Block]:
    def numbers(names: Sequence[str], form: str) -> str:
        return ", ".join(number(base[name].calibrated, form) for name in names)

    ways = (
        f"W, P, R (FANUC) {numbers('WPR', '.4f')}; A, B, C (KUKA) {numbers('ABC', '.4f')}; q1 to q4 (ABB) "
        f"{numbers(('q1', 'q2', 'q3', 'q4'), '.7f')}; rotation vector in rad (Universal Robots) "
        f"{numbers(('vx', 'vy', 'vz'), '.6f')}"
    )
    stands = [base[name] for name in BASE_FIGURES]
    rows = [("calibrated", *(figure.shown(figure.calibrated) for figure in stands))]
    rows += [("robot file", *(figure.shown(figure.nominal) for figure in stands))] if known else []
    header = ("base", *(f"{figure.figure} [{figure.unit}]" for figure in stands))
    return [Paragraph(BASE.format(ways=ways), keep=True), Table(header, rows, "lrrrrrr", size=8)]


CONTROLLER_SECTION = Section(
    20, "Figures for the controller", "identify/parameters.csv", _controller_figures,
    lambda outcome: any(row.effect == Geometry.id for row in outcome.fitted_parameters),
)  # fmt: skip
