"""Figures for the controller: in the robot file's convention, in mm and degrees, with their differences from that file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calflow.deployment.export import ControllerFigure, controller_figures, robot_of
from calflow.deployment.figures_alone import NOT_COMPUTED, Levels
from calflow.effects.geometry import Geometry
from calflow.files.words import effect_words, first_up, listed, number
from calflow.reporting.advice import BY_PRIOR
from calflow.reporting.blocks import Block, Paragraph, Table, headed
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.robot.formats.controller_files import added_to_readings
from calflow.robot.frames import LISTED
from calflow.robot.robot import Robot

WIDEST = 5  # figures side by side in a table, each with its difference
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
    "Each link is shifted by x, y, z along its parent's axes, turned as the robot file says and then by the small rx, ry, rz, and "
    "turns by theta + joint about its axis."
)
NO_BETA = " beta turns about y where two axes are nearly parallel; for a controller that has no beta, leave it out."
WORTH = "Page one has the robot's error with these figures, with fewer, and with corrected commands."
ANEW = (
    "Such figures cannot represent {others}. They were fitted without it, absorb a part of it, and so differ from the model's "
    "parameters."
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
    def is_shown(self) -> bool:
        """Whether it is not zero, or was fitted."""
        return bool(self.nominal) or self.fitted

    def shown(self, value: float, sign: str = "") -> str:
        """Return a value as a table shows it."""
        return number(value, f"{sign}{'.3f' if self.unit == 'mm' else '.4f'}")


def reported_figures(material: Material) -> dict[str, dict[str, Figure]]:
    """Return the robot's figures by part (`joint 1`, `loop`, `base`, `marker NAME`) and symbol, beside those of the robot file."""
    robot, rows = material.robot, [row for row in material.figures.parameters if row.effect == Geometry.id]
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


def _controller_figures(material: Material) -> list[Block]:
    """Tabulate links, joint zeros, tool and base."""
    robot, parts = material.robot, reported_figures(material)
    joints = {
        str(i): [parts[f"joint {i}"][step.symbol] for step in frame.every
                 if step.free or not frame.listed or step.symbol in frame.listed]
        for i, frame in enumerate(robot.frames, start=1)
    }  # fmt: skip
    curved = any(figure.figure == "beta" and figure.calibrated for row in joints.values() for figure in row)
    own = OWN_FRAMES if any(frame.listed == LISTED for frame in robot.frames) else ""
    order = ORDER.get(robot.kinematics, own) + NO_BETA * curved
    header = [f"joint {i} [{joint.shown[0]}]" for i, joint in enumerate(robot.joints, start=1)]
    added = [number(value, "+.4f") for value in zeros(robot, material.levels)] if material.levels else []
    markers = {name: list(parts[f"marker {name}"].values()) for name in robot.markers}
    bars, located = parts.get("loop", {}), any(parts["base"][name].fitted for name in BASE_FIGURES)
    return [
        *_worth(material),
        Paragraph(f"{INTRODUCTION} {order}", keep=True),
        *figure_tables("joint", joints),
        *headed("Bars of the loop", *figure_tables("bar", {"length": list(bars.values())}), where=bars),
        *headed(
            "Zeros of the joints",
            Paragraph(ZEROS + LOOPED * (robot.loop is not None), keep=True),
            Table(header, [added], "r" * len(header), size=8),
            where=added,
        ),
        *headed("Tool", Paragraph(TOOL, keep=True), *figure_tables("marker", markers)),
        *headed("Base", *_base(parts["base"], robot.base.known), where=robot.base.known or located),
    ]


def zeros(robot: Robot, levels: Levels) -> np.ndarray:
    """Return the corrections of the joint readings with the maker's other figures, (n_joints,) [deg, or mm of a slide]."""
    return added_to_readings(robot, robot_of(levels.alone["zeros and tool"]))


def _worth(material: Material) -> list[Block]:
    """Return words on what the figures were fitted without, and on any harm that they do."""
    levels = material.levels
    if levels is None:
        return [Paragraph(f"{first_up(NOT_COMPUTED)}: run the study again.")]
    others = list(dict.fromkeys(effect_words(effect.id) for effect in levels.left_out))
    anew = [ANEW.format(others=listed(others, 6))] if others else []
    harm = [first_up(f"{levels.harm}.")] if levels.harm else []
    return [Paragraph(" ".join((WORTH, *anew, *harm)), keep=True)]


def figure_tables(what: str, rows: Mapping[str, Sequence[Figure]]) -> list[Block]:
    """Return a table with a row for each joint or marker, of every figure that any has; if too wide, one for each unit."""
    columns: dict[tuple[str, str], dict[str, Figure]] = {}
    for name, row in rows.items():
        for figure in row:
            columns.setdefault((figure.unit, figure.figure), {})[name] = figure
    shown = {key: column for key, column in columns.items() if any(figure.is_shown for figure in column.values())}
    units = dict.fromkeys(unit for unit, _ in shown) if len(shown) > WIDEST else [""]
    return [_table(what, list(rows), {key: shown[key] for key in shown if unit in ("", key[0])}) for unit in units]


def _table(what: str, names: Sequence[str], columns: Mapping[tuple[str, str], Mapping[str, Figure]]) -> Table:
    """Return a table of figures by unit and symbol, those that were fitted beside their differences."""
    header, cells = [what], [[name] for name in names]
    for (unit, symbol), column in columns.items():
        with_differences = any(figure.fitted for figure in column.values())
        header += [f"{symbol} [{unit}]", *["Δ"] * with_differences]
        for name, row in zip(names, cells, strict=True):
            row += _cells(column.get(name))[: 1 + with_differences]
    return Table(header, cells, "l" + "r" * (len(header) - 1), size=8)


def _cells(figure: Figure | None) -> tuple[str, str]:
    if figure is None:
        return "–", ""
    difference = figure.shown(figure.difference, "+") if figure.fitted else ""
    return figure.shown(figure.calibrated), difference if figure.determined else f"({difference})"


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
