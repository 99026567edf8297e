"""Export: a calibrated robot in the formats of other programs, with the cost of what these cannot hold.

The calibrated robot has the maker's figures with the identified errors added; where the model has further effects,
figures are fitted alone (see `figures_alone`). Controller figures are in mm and degrees, as typed into a controller.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

import casadi as ca
import numpy as np

from calflow.deployment.conventions import nearest_vector
from calflow.deployment.figures_alone import GIVEN, Effort, FiguresAlone, Levels, beyond_figures, is_of_figures
from calflow.design.candidates import candidates
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.registration import with_placement_errors
from calflow.estimation.residual_field import NOT_PHYSICAL
from calflow.files.deferred import Rotation
from calflow.files.problems import refuse
from calflow.files.tables import column, csv_text, to_frame
from calflow.files.toml import checked_arguments
from calflow.files.words import effect_words, listed, part_words
from calflow.model import Model
from calflow.robot.formats.controller_files import CONTROLLER_FILES, Maker, pasted
from calflow.robot.formats.mjcf import mjcf_text
from calflow.robot.formats.rigid_chain import (
    json_text,
    properties_text,
    rigid_chain,
    said_of_drives,
    said_of_variables,
    urdf_text,
)
from calflow.robot.formats.ur_calibration import driver_yaml
from calflow.robot.formats.urdf import Drive
from calflow.robot.frames import angles
from calflow.robot.mechanism import Row, nominal_dimensions
from calflow.robot.robot import Robot

ANEW = "the figures are fitted anew to the measurements, since whoever reads them knows nothing else of the model"
FIELD = f"residual field ({NOT_PHYSICAL})"
HOLDS: dict[Maker, str] = {
    "abb-moc": "MOC.cfg holds calibration offsets and the base frame",
    "kuka-dat": "$machine.dat and $config.dat hold mastering offsets, the base and tools of a marker's name",
    "fanuc-mastering": "system variables hold master counts",
}
NO_BASE = "the base is left as it is: the robot file does not know where the robot stands (base known = false)"
HASH = "the driver compares 'hash' with the robot's, and says that they differ: put there that of ur_calibration's file"
DRAWN_POSES = 500  # random poses within the joint limits, used without measurements


@dataclass(frozen=True, kw_only=True)
class NotExported:
    """A part of the model that a robot's figures cannot hold, and the error without it."""

    effect: str = column("id of the effect, or name of another part of the model")
    parts: tuple[str, ...] = column("the parts of the robot that it acts on")
    mean_mm: float = column("mean position error of the tool without it, over the measured rows", "mm")
    max_mm: float = column("largest position error without it", "mm")


def robot_of(alone: FiguresAlone | CalibratedModel) -> Robot:
    """Return the robot with its fitted figures: those changed by the effects on lengths and angles."""
    robot, dimensions = alone.model.robot, nominal_dimensions(alone.model.robot)
    for effect in filter(is_of_figures, alone.model.effects):
        values = ca.SX(alone.model.values(effect, alone.estimate))
        dimensions = effect.dimensions(values, dimensions, Row.symbols(robot))
    dims = {name: np.array(ca.DM(ca.evalf(ca.densify(ca.SX(value))))) for name, value in vars(dimensions).items()}
    steps = iter(dims["steps"].ravel())
    frames = [
        joint.frame.restated({step.symbol: float(next(steps)) for step in joint.frame.steps}) for joint in robot.joints
    ]
    joints = tuple(replace(joint, frame=frame) for joint, frame in zip(robot.joints, frames, strict=True))
    placed = with_placement_errors(robot, *(dims[name] for name in ("base", "tool_rotation", "markers")))
    base = replace(robot.base, origin=placed.base.origin, rotation=placed.base.rotation, known=True)
    markers = {name: replace(marker, known=True) for name, marker in placed.markers.items()}
    loop = robot.loop
    if loop is not None:
        crank, rod, rocker = map(float, dims["bars"].ravel())
        loop = replace(loop, crank=replace(loop.crank, length=crank), rod=replace(loop.rod, length=rod), rocker=rocker)
    return replace(placed, joints=joints, base=base, markers=markers, loop=loop)


def cost_of_figures(calibrated: CalibratedModel, robot: Robot, conditions: np.ndarray) -> NotExported:
    """Return the cost of leaving out all that a robot's figures cannot hold, at packed rows (n_conditions, n)."""
    others = beyond_figures(calibrated.model)
    names = list(dict.fromkeys(effect.id for effect in others)) + [FIELD] * bool(calibrated.field)
    parts = dict.fromkeys(parameter.part for effect in others for parameter in effect.declared)
    alone = Model(robot, (), calibrated.model.given).point(np.zeros(0), conditions)
    off = 1e3 * np.linalg.norm(calibrated.expected_point(conditions) - alone, axis=1)
    return NotExported(
        effect=" and ".join(names), parts=tuple(parts), mean_mm=float(off.mean()), max_mm=float(off.max())
    )


@dataclass(frozen=True, kw_only=True)
class ControllerFigure:
    """A figure of a controller: nominal, calibrated, and their difference."""

    part: str = column("joint 1 …, loop, base (in the measuring frame), tool, or a marker (in the flange's frame)")
    figure: str = column(
        "symbol; of a base and tool besides A B C (KUKA: about z, y, x in turn), W P R (FANUC: about fixed x, y, z), q1 … q4 "
        "(ABB: w, x, y, z) and vx vy vz (Universal Robots: axis times angle)"
    )
    unit: str = column("mm, deg, rad, or 1")
    nominal: float = column("value in the robot file")
    calibrated: float = column("calibrated value")
    difference: float = column("calibrated minus nominal; for angles modulo a full turn")


def controller_figures(nominal: Robot, calibrated: Robot) -> list[ControllerFigure]:
    """Return the figures of a calibrated robot with those of the maker's.

    Of equivalent quaternions and rotation vectors, the calibrated robot has the one nearest to the maker's.
    """
    return [
        ControllerFigure(
            part=part, figure=name, unit=unit, nominal=before, calibrated=after, difference=_apart(unit, before, after)
        )
        for (part, name, unit, before), (_, _, _, after) in zip(
            _every(nominal, nominal), _every(calibrated, nominal), strict=True
        )
    ]


def _apart(unit: str, before: float, after: float) -> float:
    """Return a figure's difference, for an angle between -180 and 180 degrees."""
    return (after - before + 180.0) % 360.0 - 180.0 if unit == "deg" and abs(after - before) > 180.0 else after - before


def _every(robot: Robot, beside: Robot) -> Iterator[tuple[str, str, str, float]]:
    for i, joint in enumerate(robot.joints):
        for step in joint.frame.every:
            yield (f"joint {i + 1}", step.symbol, *step.shown)
    if robot.loop:
        bars = {"crank": robot.loop.crank.length, "rod": robot.loop.rod.length, "rocker": robot.loop.rocker}
        yield from (("loop", name, "mm", 1e3 * length) for name, length in bars.items())
    yield from (("base", axis, "mm", 1e3 * value) for axis, value in zip("xyz", robot.base.origin, strict=True))
    yield from _turn("base", robot.base.rotation, beside.base.rotation)
    if robot.tool_rotation is not None:
        yield from _turn("tool", robot.tool_rotation, beside.tool_rotation or (0.0, 0.0, 0.0))
    for name, marker in robot.markers.items():
        yield from (
            (f"marker {name}", axis, "mm", 1e3 * value) for axis, value in zip("xyz", marker.point, strict=True)
        )


def _turn(part: str, rotation: Sequence[float], beside: Sequence[float]) -> Iterator[tuple[str, str, str, float]]:
    """Yield a rotation (about x, y, z in turn) in makers' conventions, in equivalent figures nearest to another's."""
    turn, other = (Rotation.from_euler("XYZ", angles) for angles in (rotation, beside))
    ways = {("rx", "ry", "rz"): "XYZ", ("A", "B", "C"): "ZYX", ("W", "P", "R"): "xyz"}
    for names, order in ways.items():
        yield from (
            (part, name, "deg", float(np.rad2deg(angle)))
            for name, angle in zip(names, angles(turn, order), strict=True)
        )
    near = other.as_quat(canonical=True, scalar_first=True)
    quaternion = turn.as_quat(scalar_first=True)
    quaternion = quaternion if quaternion @ near >= 0 else -quaternion
    yield from ((part, f"q{k + 1}", "1", float(value)) for k, value in enumerate(quaternion))
    yield from (
        (part, f"v{axis}", "rad", float(v))
        for axis, v in zip("xyz", nearest_vector(turn.as_rotvec(), other.as_rotvec()), strict=True)
    )


Format = Literal["urdf", "xacro-properties", "dh", "json", "controller", "mjcf", "ur-calibration", Maker]


@dataclass(frozen=True)
class Export:
    """A calibrated robot as a file's text; notes: what it cannot hold, and at what cost."""

    text: str
    notes: tuple[str, ...]
    left_out: tuple[NotExported, ...]


@checked_arguments
def export(
    calibrated: CalibratedModel, to: Format, levels: Levels, *, conditions: np.ndarray | None = None, maker: Robot | None = None,
    drives: Mapping[str, Drive] | None = None, beside: Mapping[Path, str] | None = None,
) -> Export:  # fmt: skip
    """Return a calibrated model in a format; notes state what the format cannot hold, and the cost in mm.

    Where the model has more than figures, those fitted alone are exported: truncated ones may be worse.

    Args:
        calibrated: the calibrated model.
        to: the format; dh is a robot file with the calibrated figures in place of the maker's.
        levels: its figures fitted alone.
        conditions: packed conditions (n_conditions, n) of the measured rows, over which costs are computed; None:
            those of random poses within the joint limits.
        maker: the robot as in its file, where the calibration placed base, tool or markers elsewhere before it began.
        drives: for a URDF, the drive of each joint, by its name in the robot.
        beside: for a controller's own files, their present texts.

    Raises:
        InputError: the robot's frames cannot be expressed in the format, or these figures are worse than the maker's.
    """
    if conditions is None:
        calibrated = replace(calibrated, model=replace(calibrated.model, given=()))
        conditions = _anywhere(calibrated.model)
    if levels.harm:
        raise refuse(levels.harm)
    if to in CONTROLLER_FILES:
        return _controller_file(cast("Maker", to), levels, maker or calibrated.model.robot, beside or {})
    if beside:
        raise refuse(f"expected no file: '{to}' states the whole robot", key="beside")
    figures: FiguresAlone | CalibratedModel = calibrated
    notes = levels.words
    alone = bool(levels.left_out or calibrated.field)
    if alone:
        figures, notes = levels.figures, (ANEW, *levels.words)
    robot = replace(robot_of(figures), expected=calibrated.model.robot.expected)
    lost = (cost_of_figures(calibrated, robot, conditions),) if alone else ()
    notes += _said(lost)
    if to == "dh":
        return Export(robot.toml_text(), notes, lost)
    if to == "controller":
        if not robot.is_one_arm:
            raise refuse(
                "a controller's figures are of one arm, this robot has several: expected urdf, xacro-properties, json or dh"
            )
        table = to_frame(controller_figures(maker or calibrated.model.robot, robot), ControllerFigure)
        return Export(csv_text(table), notes, lost)
    chain, drives_of = rigid_chain(robot), [(drives or {}).get(joint.name, Drive()) for joint in robot.joints]
    more = {"ur-calibration": (HASH,), "urdf": said_of_drives(chain, drives_of)}.get(to, ())
    notes += (*said_of_variables(robot), *more)
    said = ("calibrated figures, SI units", *notes)
    heading = "; ".join(said)
    writers: dict[str, Callable[[], str]] = {
        "json": lambda: json_text(chain, {**_figures(calibrated, robot, lost), "notes": notes}),
        "mjcf": lambda: mjcf_text(chain, heading),
        "ur-calibration": lambda: driver_yaml(chain, [j.frame.figures.get("d", 0.0) for j in robot.joints], said),
        "urdf": lambda: urdf_text(chain, heading, drives_of),
        "xacro-properties": lambda: properties_text(chain, heading),
    }
    return Export(writers[to](), notes, lost)


def _controller_file(maker: Maker, levels: Levels, nominal: Robot, beside: Mapping[Path, str]) -> Export:
    """Return the lines to paste into a maker's files, from figures fitted alone for what these hold.

    Markers with unknown positions are fitted too, whether or not the files hold a tool.
    """
    if not nominal.is_one_arm:
        raise refuse("a controller's files are of one arm, this robot has several")
    known = all(marker.known for marker in nominal.markers.values())
    level: Effort = "zeros" if known else "zeros and tool"
    made = pasted(maker, beside, nominal, robot_of(levels.alone[level]))
    if made.holds_tool and known:
        level, made = "zeros and tool", pasted(maker, beside, nominal, robot_of(levels.alone["zeros and tool"]))
    if levels.by(level).mean > levels.by("nothing").mean:
        raise refuse(
            f"{GIVEN[level]} miss by {levels.by(level)}, the maker's figures by {levels.by('nothing')}: nothing to paste"
        )
    base = () if nominal.base.known else (NO_BASE,)
    return Export(made.text, (f"{HOLDS[maker]}: {GIVEN[level]}, fitted anew for that", *levels.words, *base), ())


def _anywhere(model: Model) -> np.ndarray:
    """Return packed rows (n_conditions, n) at random poses under the heaviest payload."""
    payloads = model.robot.payloads
    heaviest = max(payloads, key=lambda name: payloads[name].mass or 0.0, default="")
    _, conditions = candidates(
        model, DRAWN_POSES, heaviest, next(iter(model.robot.markers)), None, np.random.default_rng(1)
    )
    return conditions


def _figures(calibrated: CalibratedModel, robot: Robot, lost: Sequence[NotExported]) -> dict[str, Any]:
    """Return the content of JSON besides the chain."""
    sds = np.sqrt(np.diag(calibrated.covariance))
    parameters = [
        {"parameter": of.name, "effect": of.effect, "unit": of.unit, "estimate": float(value), "sd": float(sd)}
        for of, value, sd in zip(calibrated.model.parameters, calibrated.estimate, sds, strict=True)
    ]
    left_out = [asdict(loss) for loss in lost]
    return {"figures": json.loads(robot.canonical()), "parameters": parameters, "left_out": left_out}


def _said(lost: Sequence[NotExported]) -> tuple[str, ...]:
    """Return notes on what is left out."""
    where = [f" ({listed(list(map(part_words, loss.parts)), 8)})" if loss.parts else "" for loss in lost]
    return tuple(
        f"left out: {effect_words(loss.effect)}{there}: the tool is then off by "
        f"{loss.mean_mm:.3f} mm on average over the measured rows, {loss.max_mm:.3f} mm at most"
        for loss, there in zip(lost, where, strict=True)
    )
