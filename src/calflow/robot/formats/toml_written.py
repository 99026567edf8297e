"""robot.toml, written: a robot's fields as a robot file that reads back equal."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from calflow.files.units import SUFFIXES, in_si, to_si
from calflow.robot.formats.robot_toml import OWN_FRAMES, PARTS, UNKNOWN
from calflow.robot.frames import Frame, convention_of
from calflow.robot.parts import STANDARD_GRAVITY, Bar, Base, FourBar, Joint, Payload


def text(fields: Mapping[str, Any]) -> str:
    """Return the fields of a robot as the text of a robot file that reads back equal.

    Frames that are not all of one convention are stated by their steps.
    """
    return "\n".join(_lines(fields)) + "\n"


def _lines(fields: Mapping[str, Any]) -> Iterator[str]:
    """The file's lines; what is as it is where the file says nothing is left out."""
    joints: Sequence[Joint] = fields["joints"]
    yield from _entries({"name": fields["name"], "notes": fields["notes"] or None})
    convention = convention_of([joint.frame for joint in joints]) or OWN_FRAMES
    yield f"convention = {json.dumps(convention)}"
    level = fields["gravity"] == STANDARD_GRAVITY and joints[0].kind == "revolute"
    usual = level and convention != OWN_FRAMES and not fields["ground"]
    yield from _entries({"gravity": None if usual else fields["gravity"], "ground": fields["ground"] or None})
    yield from _quantity("tool_rotation", fields["tool_rotation"], "angle")
    base: Base = fields["base"]
    if base != Base():
        yield from ("", "[base]")
        yield from _quantity("origin", base.origin, "length")
        yield from _quantity("rotation", base.rotation, "angle")
        yield from _entries({"known": None if base.known else False})
    for joint in joints:
        yield from ("", "[[joints]]", *_joint(joint, convention))
    for coupling in fields["couplings"]:
        yield from ("", "[[couplings]]", *_entries(vars(coupling)))
    loop: FourBar | None = fields["loop"]
    if loop:
        yield from ("", "[loop]", *_entries({"joint": loop.joint, "assembly": loop.assembly}))
        yield from _quantity("rocker", loop.rocker, "length")
        yield from _quantity("offset", loop.offset or None, "angle")
        for name, bar in (("crank", loop.crank), ("rod", loop.rod)):
            yield from ("", f"[loop.{name}]", *_quantity("length", bar.length, "length"), *_mass(bar))
    for name, payload in fields["payloads"].items():
        yield from ("", f"[payloads.{_key(name)}]")
        yield from _entries({"mass_kg": UNKNOWN if payload.mass is None else None})
        yield from _mass(payload)
    for name, marker in fields["markers"].items():
        yield from ("", f"[markers.{_key(name)}]", *_quantity("point", marker.point, "length"))
        yield from _quantity("relative_sd", marker.relative_sd, "length")
        yield from _entries({"known": None if marker.known else False})
    for one in fields["expected"]:
        stated = {name: value or None if isinstance(value, str | bool) else value for name, value in vars(one).items()}
        yield from ("", "[[expected]]", *_entries({**stated, "unit": one.unit}))


def _joint(joint: Joint, convention: str) -> Iterator[str]:
    yield from _entries({"name": joint.name or None, "kind": None if joint.kind == "revolute" else joint.kind})
    if convention == OWN_FRAMES:
        yield from _steps(joint.frame)
    else:
        for step in joint.frame.steps:
            yield from _quantity(step.symbol, step.value or None, "length" if step.is_length else "angle")
    yield from _quantity("limits", joint.limits, "angle" if joint.kind == "revolute" else "length")
    yield from _entries({"sign": None if joint.sign == 1 else joint.sign, "gear_ratio": joint.gear_ratio})
    yield from _entries({"driven": None if joint.driven else False, "external": joint.external})
    yield from _quantity("rated_torque", joint.rated_torque, "moment")
    yield from _mass(joint)


def _steps(frame: Frame) -> Iterator[str]:
    """A frame by all its steps, a line each."""
    yield "steps = ["
    for part in PARTS:
        for step in (frame.turn,) if part == "turn" else getattr(frame, part):
            said = [*_entries({"part": part, "motion": step.motion, "symbol": step.symbol})]
            said += (
                _quantity("shift", step.value, "length") if step.is_length else _quantity("turn", step.value, "angle")
            )
            said += _entries({"free": step.free or None})
            yield f"  {{{', '.join(said)}}},"
    yield "]"
    yield from _entries({"listed": frame.listed or None})


def _mass(part: Joint | Bar | Payload) -> Iterator[str]:
    yield from _quantity("mass", part.mass, "mass")
    yield from _quantity("com", part.com if any(part.com) else None, "length")


def _entries(values: Mapping[str, Any]) -> Iterator[str]:
    return (f"{name} = {_value(value)}" for name, value in values.items() if value is not None)


def _quantity(name: str, value: Any, dimension: str) -> Iterator[str]:
    """A key with the unit that people use, where the figure in it reads back the same; else with the SI unit."""
    if value is None:
        return
    values = value if isinstance(value, tuple) else (value,)
    unit, figures = SUFFIXES[dimension][0], values
    everyday = {"length": "mm", "angle": "deg"}.get(dimension)
    if everyday:
        short = tuple(_short(v, everyday) for v in values)
        if all(in_si(everyday, figure) == v for figure, v in zip(short, values, strict=True)):
            unit, figures = everyday, short
    yield f"{name}_{unit} = {_value(figures if isinstance(value, tuple) else figures[0])}"


def _short(value: float, unit: str) -> float:
    """The figure of fewest decimals that means an SI value in a unit, as near as one gets."""
    exact = value / to_si(unit)[0]
    shorter = (round(exact, digits) for digits in range(16))
    return next((figure for figure in shorter if in_si(unit, figure) == value), exact)


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value) if isinstance(value, bool | int) else repr(float(np.float64(value)))


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _value(name)
