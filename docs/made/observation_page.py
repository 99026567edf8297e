"""A page of the documentation for a kind of observation: its equation, its columns, and a picture of what it tells."""

from __future__ import annotations

import textwrap
from dataclasses import replace

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from calflow.design.candidates import candidates
from calflow.design.planned import Planned
from calflow.estimation.noise import PerUnit
from calflow.files.units import METRE, NEWTON, PIXEL, RADIAN
from calflow.files.words import first_up
from calflow.measurements.series import Series, Setting
from calflow.model import build
from calflow.observations import Observation
from calflow.observations.position import Position
from calflow.robot.parts import Base, Parameter
from made.bench import benches
from made.effect_page import COLUMNS, paragraphs, table
from made.pictures import COLOURS, STYLE, svg

POSES = 60
SIGMA, TURNED, SHOWN = 5e-5, 1e-4, 0.2  # m, rad and px: of every kind, so that they can be compared
STATED: dict[str, dict[str, Setting]] = {  # what a kind must be told of before anything is measured
    "artefact": {"origin": (1.2, 0.3, 0.5), "size": (0.5, 0.4)},
    "camera": {
        "size": (1280.0, 960.0),
        "focal": (1100.0, 1100.0),
        "focal_sd": 50.0,
        "centre": (640.0, 480.0),
        "centre_sd": 20.0,
        "camera_origin": (5.5, 0.0, 1.2),
        "camera_origin_sd": 0.5,
        "camera_rotation": (-1.571, -1.571, 0.0),
        "camera_rotation_sd": 0.5,
        "target_origin": (0.0, 0.0, 0.1),
        "target_origin_sd": 0.5,
        "target_rotation": (0.0, 0.0, 0.0),
        "target_rotation_sd": 0.5,
        "target_size": (0.9, 0.6),
    },
    "datum-cube": {"origin": (1.3, 0.3, 0.6)},
    "distance": {"anchor": (1.2, 1.0, -0.5), "anchor_known": False},
    "plane": {"point": (1.4, 0.4, 0.3)},
    "same-point": {"place": (1.4, 0.4, 0.6), "distance": 0.4},
    "sphere": {"centre": (1.3, 0.3, 0.6), "radius": 0.05},
}
TOLD = 1 / 3  # of what was known before: see `identifiability`


def observation_page(kind: type[Observation]) -> tuple[str, bytes]:
    """Return the page's text, in Markdown, and its picture, as SVG."""
    first, *rest = paragraphs(kind)
    known, reference = told(kind), told(Position)
    names = [name for name in reference if name in known]
    pieces = [
        f"# {first_up(kind.title)}",
        f'`{kind.id}`: a study says `kind = "{kind.id}"` in `[[measurements]]`.',
        "## Equation",
        f"```text\n{textwrap.fill(first, COLUMNS)}\n```",
        *rest,
        "A row gives " + " and ".join(_counted(kind)) + ", predicted minus reported, in standard deviations.",
        "## Columns and settings",
        _columns(kind),
        "## What it tells",
        f"![what {kind.id} tells of the geometry]({kind.id}.svg)",
        f"How surely {POSES} rows tell each figure of the geometry, over what was known of it before (1: nothing new), by rows "
        f"with a standard deviation of {1e3 * SIGMA:g} mm, {1e3 * TURNED:g} mrad and {SHOWN:g} px, of the robot that "
        "`calflow new` writes; in grey what as many rows of `position` tell. "
        f"{sum(known[name] < TOLD for name in names)} of {len(names)} figures are told at least three times more surely than before"
        f"{'' if kind is Position else f' ({sum(reference[name] < TOLD for name in names)} by `position`)'}.",
        *_remarks(kind),
        "All kinds, and how to add one: [observations](../observations.md); files: [files](../files.md).",
    ]
    return "\n\n".join(pieces) + "\n", _picture(kind, names, known, reference)


def told(kind: type[Observation]) -> dict[str, float]:
    """By how much rows of a kind narrow each figure of the geometry: its standard deviation over the prior's, by name."""
    robot = benches()[0].robot
    robot = replace(robot, tool_rotation=(0.0, 0.0, 0.0), markers={"tool": robot.markers["tool"]},
                    base=robot.base if kind.from_outside else Base(fixed=True))  # fmt: skip
    observation = kind.planned(Series.of("", kind.id, STATED.get(kind.id)))
    model = build(robot, ("geometry",), (), (observation,))
    payload, marker = "empty", "tool"
    _, conditions = candidates(model, POSES, payload, marker, None, np.random.default_rng(3), observation)
    jacobian = (
        Planned(observation, SHOWN if kind.units[0] == PIXEL else SIGMA, PerUnit(((RADIAN, TURNED),)))
        .whitened(model, model.nominal, conditions)
        .reshape(-1, len(model.parameters))
    )
    covariance = np.linalg.inv(jacobian.T @ jacobian + np.diag(model.prior_sd**-2.0))
    narrowed = np.sqrt(np.diag(covariance)) / model.prior_sd
    own = {id(parameter) for parameter in observation.declared}
    return {
        p.name: float(x) for p, x in zip(model.parameters, narrowed, strict=True) if id(p) not in own and _inside(p)
    }


def _inside(parameter: Parameter) -> bool:
    """Whether it is of the robot itself, not of where it stands."""
    return parameter.part != "base"


def _picture(kind: type[Observation], names: list[str], known: dict[str, float], reference: dict[str, float]) -> bytes:
    with mpl.rc_context(STYLE):
        figure = Figure((7.2, 2.9), layout="constrained")
        axes = figure.subplots()
        at = np.arange(len(names))
        if kind is not Position:
            axes.plot(at, [reference[name] for name in names], "o", color="#bbb", markersize=4, label="position")
        axes.plot(at, [known[name] for name in names], "o", color=COLOURS[0], markersize=4, label=kind.id)
        axes.axhline(1, color="#999", linewidth=0.6)
        axes.set_xticks(at, names, rotation=90)
        axes.set(yscale="log", ylabel="sd, over that before")
        axes.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0, 1))
        return svg(figure)


def _counted(kind: type[Observation]) -> list[str]:
    words = {METRE: "length", RADIAN: "angle", PIXEL: "pixel", NEWTON: "force"}
    counts = {unit: kind.units.count(unit) for unit in dict.fromkeys(kind.units)}
    return [f"{n} {words[unit]}{'s' if n > 1 else ''}" for unit, n in counts.items()]


def _columns(kind: type[Observation]) -> str:
    rows = [(f"`{name}`", "needed", dimension or "a name") for name, dimension in kind.columns.needed.items()]
    rows += [
        (f"`{name}`", "may be there", dimension or "a number") for name, dimension in kind.columns.optional.items()
    ]
    rows += [(f"`{name}`", "needed", dimension) for name, dimension in kind.columns.within.items()]
    rows += [(f"`{name}`", "label", "a name") for name in kind.columns.labels if name not in kind.columns.needed]
    rows += [(f"`{name}`", "may be there", "what nothing asks for") for name in kind.columns.notes]
    rows += [(f"`{name}`", "setting", "may be stated") for name in kind.settings.model_fields]
    return table(("name, without its unit", "", "holds"), rows)


def _remarks(kind: type[Observation]) -> list[str]:
    said = []
    if kind.touches:
        said.append("Not every pose can be observed: `select` proposes such as touch, or show, what is observed.")
    if not kind.from_outside:
        said.append(
            "It does not tell where the robot stands: alone it leaves the base out, and the robot's base is the frame of measuring."
        )
    return [" ".join(said)] if said else []
