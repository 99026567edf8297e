"""A robot in a few lines, as people state it: mm and degrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from calflow.robot.frames import Step, convention_of, kinematics
from calflow.robot.parts import Joint, Marker, Payload

Rows = list[tuple[str, ...]]


def text(name: str, joints: Sequence[Joint], payloads: Mapping[str, Payload], markers: Mapping[str, Marker]) -> str:
    """Return a robot as plain text."""
    table = _table(joints)
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in table]
    return "\n".join((_title(name, joints), *(f"  {line}" for line in lines), *_tool(payloads, markers)))


def html(name: str, joints: Sequence[Joint], payloads: Mapping[str, Payload], markers: Mapping[str, Marker]) -> str:
    """Return a robot as a small HTML table."""
    head, *body = _table(joints)
    rows = [_row("th", head), *(_row("td", row) for row in body)]
    below = "".join(f"<br>{escape(line)}" for line in _tool(payloads, markers))
    return f"<b>{escape(_title(name, joints))}</b><table>{''.join(rows)}</table>{below.removeprefix('<br>')}"


def _title(name: str, joints: Sequence[Joint]) -> str:
    return f"Robot '{name}': {len(joints)} joint{'s' * (len(joints) != 1)}, {kinematics([joint.frame for joint in joints])}"


def _tool(payloads: Mapping[str, Payload], markers: Mapping[str, Marker]) -> list[str]:
    masses = ("of unknown mass" if load.mass is None else f"{load.mass:g} kg" for load in payloads.values())
    loads = ", ".join(f"{name} {mass}" for name, mass in zip(payloads, masses, strict=True)) or "none"
    places = (f"{name} ({', '.join(_figure(1e3 * v) for v in marker.point)}) mm" for name, marker in markers.items())
    return [f"payloads: {loads}", f"markers: {', '.join(places)}"]


def _table(joints: Sequence[Joint]) -> Rows:
    """A header and a row a joint; the frames' figures have columns of their own where all joints have the same."""
    frames = [joint.frame for joint in joints]
    if convention_of(frames):
        listed = frames[0].listed
        columns = [f"{step.symbol} [{_unit(step)}]" for symbol in listed for step in [frames[0].step(symbol)]]
        figures = [tuple(_figure(_shown(frame.step(symbol))) for symbol in listed) for frame in frames]
    else:
        columns = ["frame"]
        figures = [
            (", ".join(f"{s.symbol} {_figure(_shown(s))} {_unit(s)}" for s in frame.steps if s.value) or "–",)
            for frame in frames
        ]
    rows: Rows = [("joint", *columns, "limits")]
    for i, (joint, cells) in enumerate(zip(joints, figures, strict=True)):
        unit, factor = joint.shown
        limits = " … ".join(_figure(factor * limit) for limit in joint.limits) if joint.limits else "–"
        rows.append((f"{i + 1} {joint.name}".rstrip(), *cells, f"{limits} {unit}" if joint.limits else limits))
    return rows


def _row(tag: str, cells: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"


def _shown(step: Step) -> float:
    return 1e3 * step.value if step.is_length else float(np.rad2deg(step.value))


def _unit(step: Step) -> str:
    return "mm" if step.is_length else "deg"


def _figure(value: float) -> str:
    return f"{round(value, 4) + 0.0:.10g}"
