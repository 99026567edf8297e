"""Pictures: the error of position that an effect causes all over the working range, and what an observation tells."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass

import casadi as ca
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from calflow.effects import Effect
from calflow.effects.base import Variable, joint_variable
from calflow.model import over_rows
from calflow.robot.mechanism import Row
from made.bench import Bench
from made.rivals import places

MOVED = 0.2e-3  # m rms: the size at which every effect is drawn
PURE = 0.01  # of an error's length: what of it a joint's turn may leave where it is the joint's alone
COLOURS = ("#1f6f8b", "#e07a1f", "#6a4c93")
STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "calflow",
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


@dataclass(frozen=True, eq=False)
class Shown:
    """An effect at one place, of a size that moves the tool by `MOVED`: its figures, and the errors (rows, 3) [m]."""

    part: str
    figures: dict[str, tuple[float, str]]
    error: np.ndarray


def shown(bench: Bench, effect: Effect) -> Shown:
    """The effect where most of it is left once geometry is fitted, its parameters drawn from their prior and scaled together."""
    rng = np.random.default_rng(2)
    response = bench.response(effect)
    sd = np.array([parameter.prior_sd for parameter in effect.declared])
    if effect.is_noise():
        response = _scatter(bench, effect)[:, None, None] * rng.normal(size=(len(bench.data), 3, 1))
    size = {part: float(((response[:, :, at] * sd[at]) ** 2).sum()) for part, at in effect.parts.items()}
    if effect not in bench.fitted and not effect.is_noise():
        size = {place.part: float((place.left**2).sum()) for place in places(bench, effect)}
    numbered = [parameter.part for parameter in effect.declared if parameter.joint]
    part = max(numbered or size, key=lambda name: size[name])
    at = effect.parts[part]
    low = np.array([effect.declared[k].lower for k in at])
    p = sd[at] * (rng.normal(size=len(at)) if len(at) > 1 else 1.0)
    p = np.where(low >= 0, abs(p), p)
    error = response[:, :, at] @ p
    scale = MOVED / float(np.sqrt((error**2).sum(axis=1).mean()))
    names = [effect.declared[k] for k in at]
    return Shown(part, {one.name: (scale * x, one.unit) for one, x in zip(names, p, strict=True)}, scale * error)


def of_effect(bench: Bench, effect: Effect, what: Shown) -> bytes:
    """Draw an effect as SVG: its error against what explains it, and as arrows in the plane where most of it lies."""
    with mpl.rc_context(STYLE):
        figure = Figure((7.2, 2.9), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1))
        _against(left, bench, effect, what)
        _arrows(right, bench, what)
        return svg(figure)


def svg(figure: Figure) -> bytes:
    """The figure's SVG, the same whenever it is drawn, to a hundredth of a point."""
    into = io.BytesIO()
    figure.savefig(into, format="svg", metadata={"Date": None})
    return re.sub(rb"(\d\.\d\d)\d+", rb"\1", into.getvalue())


def _against(axes: mpl.axes.Axes, bench: Bench, effect: Effect, what: Shown) -> None:
    joint = next(parameter.joint for parameter in effect.declared if parameter.part == what.part)
    variable = _variable(bench, effect, joint)
    model = bench.model(effect)
    p, c, predicted = model.symbols
    value = variable.value(predicted.state, Row.unpack(bench.robot, c, model.given))
    readings = ca.jacobian(predicted.position, c[: bench.robot.n_joints])
    graph = ca.Function("drawn", [p, c], [ca.densify(value), ca.densify(readings)])
    at, turns = over_rows(graph, bench.values(model), bench.data.conditions)
    error, said = 1e3 * np.linalg.norm(what.error, axis=1), "error of position [mm]"
    if joint:
        turn = turns.T.reshape(len(bench.data), -1, 3)[:, joint - 1]
        angle = (turn * what.error).sum(axis=1) / (turn**2).sum(axis=1)
        if np.linalg.norm(what.error - angle[:, None] * turn) < PURE * np.linalg.norm(what.error):
            of = bench.robot.joints[joint - 1]
            error, said = 1e3 * angle, f"error of joint {joint} [m{of.unit}]"
    for colour, (payload, here) in zip(COLOURS, _payloads(bench).items(), strict=False):
        axes.plot(variable.factor * at.ravel()[here], error[here], ".", color=colour, markersize=5, label=payload)
    axes.axhline(0, color="#999", linewidth=0.6)
    axes.set(xlabel=f"{variable.label}{f' [{variable.unit}]' if variable.unit else ''}", ylabel=said)
    axes.legend(title="payload", frameon=False, fontsize=7, title_fontsize=7)


def _variable(bench: Bench, effect: Effect, joint: int) -> Variable:
    if effect.grows_with:
        return Variable(effect.grows_with, "m", lambda state, row: getattr(row, effect.grows_with))
    if joint and type(effect).variable is Effect.variable:
        return joint_variable(effect, joint)
    return effect.variable(joint)


def _arrows(axes: mpl.axes.Axes, bench: Bench, what: Shown) -> None:
    model = bench.model()
    place = model.point(bench.values(model), bench.data.conditions) - np.array(bench.robot.base.origin)
    outward = place[:, :2] / np.linalg.norm(place[:, :2], axis=1)[:, None]
    side = np.column_stack([(outward * what.error[:, :2]).sum(axis=1), what.error[:, 2]])
    if (side**2).sum() >= (what.error[:, :2] ** 2).sum():
        name, at, to = "side", np.column_stack([np.linalg.norm(place[:, :2], axis=1), place[:, 2]]), side
        labels = ("distance from axis 1 [m]", "height [m]")
    else:
        name, at, to = "top", place[:, :2], what.error[:, :2]
        labels = ("x of the base [m]", "y of the base [m]")
    length = 0.3 / max(float(np.sqrt((to**2).sum(axis=1).mean())), 1e-12)
    axes.plot(*at.T, ".", color="#bbb", markersize=2)
    axes.quiver(*at.T, *(length * to).T, angles="xy", scale_units="xy", scale=1, width=0.005, color=COLOURS[0])
    axes.plot(0, 0, "s", color="#444", markersize=4)
    axes.set(
        xlabel=labels[0],
        ylabel=labels[1],
        aspect="equal",
        title=f"seen from the {name}, {_large(length)} times as large",
    )
    axes.title.set_fontsize(8)


def _large(factor: float) -> str:
    return f"{float(f'{factor:.1g}'):,.0f}"


def _payloads(bench: Bench) -> dict[str, np.ndarray]:
    named = bench.data.table["payload"].to_numpy()
    return {name: np.flatnonzero(named == name) for name in bench.robot.payloads}


def _scatter(bench: Bench, effect: Effect) -> np.ndarray:
    """What a noise adds to each row's standard deviation, a unit of its parameter."""
    p, c = ca.SX.sym("p", len(effect.declared)), ca.SX.sym("c", bench.model().n_conditions)
    added = effect.scatter(p, Row.unpack(bench.robot, c, bench.data.given))
    return over_rows(
        ca.Function("scatter", [p, c], [ca.densify(added)]), np.ones(len(effect.declared)), bench.data.conditions
    )[0].ravel()
