"""Figures for the controller: in the robot file's convention, in mm and degrees, with their differences from that file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calflow.deployment.export import ControllerFigure, controller_figures, robot_of
from calflow.deployment.figures_alone import Levels
from calflow.effects.geometry import Geometry
from calflow.effects.wording import cause_words
from calflow.files.words import first_up, listed, number
from calflow.reporting.advice import BY_PRIOR
from calflow.reporting.blocks import Block, Heading, Paragraph, Table, headed
from calflow.reporting.material import Material
from calflow.reporting.section import section
from calflow.robot.formats.controller_files import added_to_readings
from calflow.robot.robot import Robot

BASE_FIGURES = ("x", "y", "z", "rx", "ry", "rz")
INTRODUCTION = (
    "The calibrated robot in the robot file's convention. Δ is a figure's difference from that file, in brackets where the data do "
    "not determine it and it rests on prior knowledge. Figures without Δ were not fitted: others absorb their errors."
)
ORDER = {
    "modified-dh": "Each link is Rx(alpha) Tx(a) Ry(beta) Rz(theta + joint) Tz(d).",
    "dh": "Each link is Rz(theta + joint) Tz(d) Tx(a) Rx(alpha) Ry(beta).",
}
OWN_FRAMES = (
    "Each link is at x, y, z in its parent's frame, turned as in the robot file, by rx, ry, rz and theta + joint."
)
NO_BETA = " beta turns about y where two axes are nearly parallel; for a controller that has no beta, leave it out."
WORTH = "Page one has the robot's error with these figures, with fewer, and with corrected commands."
ANEW = (
    "Such figures cannot represent {others}. They were fitted without, absorb a part of that error, and so differ from the "
    "model's parameters."
)
ZEROS = (
    "For a controller that takes joint zeros alone: add these to its readings. They were fitted with the maker's lengths and "
    "twists, and have the signs and couplings of the readings."
)
LOOPED = " The driven joint's zero is that of the joint itself, behind the loop, not the motor's."
BASE = (
    "The base's pose in the measuring frame, rotated about its x, y and z axes in turn. The same rotation as controllers state it: "
    "{ways}. It holds until robot or instrument is moved."
)
TOOL = "The position of each marker in the flange's frame, in which tools are stated."


@dataclass(frozen=True)
class Figure(ControllerFigure):
    """A figure, whether it was fitted, and whether the data determine it rather than the prior."""

    fitted: bool
    determined: bool

    @property
    def cells(self) -> tuple[str, str]:
        """The value and, where it was fitted, the difference, in brackets where the prior determines it."""
        difference = self.shown(self.difference, "+") if self.fitted else ""
        return self.shown(self.calibrated), difference if self.determined else f"({difference})"

    def shown(self, value: float, sign: str = "") -> str:
        """Return a value as a table shows it."""
        return number(value, f"{sign}{'.3f' if self.unit == 'mm' else '.4f'}")


def reported_figures(material: Material) -> dict[str, dict[str, Figure]]:
    """Return the robot's figures by part (`joint 1`, `loop`, `base`, `marker NAME`) and symbol, beside those of the robot file."""
    robot = material.robot
    rows = [row for row in material.figures.parameters if row.effect == Geometry.id and not row.fixed]
    parts_of = {f"joint{i}": f"joint {i}" for i in range(1, robot.n_joints + 1)}
    parts_of |= {name: f"marker {name}" for name in robot.markers}
    estimates = {(parts_of.get(row.part, row.part), row.symbol): row for row in rows}
    parts: dict[str, dict[str, Figure]] = {}
    for figure in controller_figures(robot, robot_of(material.figures)):
        row = estimates.get((figure.part, figure.figure))
        parts.setdefault(figure.part, {})[figure.figure] = Figure(
            **vars(figure),
            fitted=row is not None or figure.difference != 0,
            determined=row is None or row.prior_share <= BY_PRIOR,
        )
    return parts


@section(20, "Figures for the controller", "identify/parameters.csv", lambda material: material.has_figures)
def controller_section(material: Material) -> list[Block]:
    """Tabulate links, joint zeros, tool and base."""
    robot, parts = material.robot, reported_figures(material)
    joints = {
        str(i): [parts[f"joint {i}"][step.symbol] for step in frame.every if step.free or step.symbol in frame.listed]
        for i, frame in enumerate(robot.frames, start=1)
    }
    curved = any(figure.figure == "beta" and figure.calibrated for row in joints.values() for figure in row)
    order = ORDER.get(robot.kinematics, OWN_FRAMES) + NO_BETA * curved
    header = [f"joint {i} [{joint.shown[0]}]" for i, joint in enumerate(robot.joints, start=1)]
    added = [number(value, "+.4f") for value in zeros(robot, material.levels)]
    markers = {name: list(parts[f"marker {name}"].values()) for name in robot.markers}
    bars, located = parts.get("loop", {}), any(parts["base"][name].fitted for name in BASE_FIGURES)
    return [
        *_fitted_without(material),
        Paragraph(f"{INTRODUCTION} {order}", keep=True),
        *figure_tables("joint", joints),
        *headed("Bars of the loop", *figure_tables("bar", {"length": list(bars.values())}), where=bars),
        Heading("Zeros of the joints"),
        Paragraph(ZEROS + LOOPED * (robot.loop is not None), keep=True),
        Table(header, [added], "r" * len(header), size=8),
        *headed("Tool", Paragraph(TOOL, keep=True), *figure_tables("marker", markers)),
        *headed("Base", *_base(parts["base"], robot.base.known), where=robot.base.known or located),
    ]


def zeros(robot: Robot, levels: Levels) -> np.ndarray:
    """Return the corrections of the joint readings with the maker's other figures, (n_joints,) [deg, or mm of a slide]."""
    return added_to_readings(robot, robot_of(levels.alone["zeros and tool"]))


def _fitted_without(material: Material) -> list[Block]:
    """Return words on what the figures were fitted without, and on any harm that they do."""
    levels = material.levels
    others = list(dict.fromkeys(cause_words(effect.id).name for effect in levels.left_out))
    anew = [ANEW.format(others=listed(others, 6))] if others else []
    harm = [first_up(f"{levels.harm}.")] if levels.harm else []
    return [Paragraph(" ".join((WORTH, *anew, *harm)), keep=True)]


def figure_tables(what: str, rows: Mapping[str, Sequence[Figure]]) -> list[Table]:
    """Return a table for each unit with a row for each joint or marker, of the figures that are not zero or were fitted."""
    tables = []
    for unit in dict.fromkeys(figure.unit for row in rows.values() for figure in row):
        named = [{figure.figure: figure for figure in row if figure.unit == unit} for row in rows.values()]
        header, cells = [what], [[name] for name in rows]
        for symbol in dict.fromkeys(symbol for row in named for symbol in row):
            column = [row.get(symbol) for row in named]
            if any(figure and (figure.nominal or figure.fitted) for figure in column):
                fitted = any(figure and figure.fitted for figure in column)
                header += [f"{symbol} [{unit}]", *["Δ"] * fitted]
                for row, figure in zip(cells, column, strict=True):
                    row += (figure.cells if figure else ("–", ""))[: 1 + fitted]
        tables.append(Table(header, cells, "l" + "r" * (len(header) - 1), size=8))
    return tables


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
