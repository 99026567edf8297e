"""What cannot be a robot: every impossible value of its parts, each told with its place."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from calflow.files.problems import Problem
from calflow.robot.frames import Frame
from calflow.robot.parts import Bar, Base, Coupling, FourBar, Joint, Marker, Named, Payload

Told = Iterator[Problem]
MOST_EXTERNAL = 6  # external axes that a controller counts


def joint_problems(joints: Any) -> Told:
    """Tell what is wrong with the joints."""
    if not isinstance(joints, tuple) or not joints:
        yield Problem(f"expected at least one Joint, found {joints!r}", key="joints")
        return
    for i, joint in enumerate(joints):
        where = f"joints[{i + 1}]"
        yield from _kind(where, joint, Joint)
        if not isinstance(joint, Joint):
            continue
        yield from _choice(f"{where}.kind", joint.kind, ("revolute", "prismatic"))
        yield from _kind(f"{where}.driven", joint.driven, bool)
        if joint.external is not None:
            yield from _joint(f"{where}.external", joint.external, 1, MOST_EXTERNAL)
        yield from _choice(f"{where}.sign", joint.sign, (1, -1))
        yield from _frame(where, joint)
        yield from _limits(where, joint)
        for name, value in (("gear_ratio", joint.gear_ratio), ("rated_torque", joint.rated_torque)):
            yield from _number(f"{where}.{name}", value, above=0, optional=True)
        yield from _mass(where, joint)


def follower_problems(joints: Any, couplings: Any, loop: Any) -> Told:
    """Tell what is wrong with joints that follow others, of joints and couplings that are right in themselves."""
    if not all(isinstance(one, Joint) for one in joints) or not all(isinstance(one, Coupling) for one in couplings):
        return
    external = [joint.external for joint in joints if joint.external is not None]
    for number in sorted({one for one in external if external.count(one) > 1}):
        yield Problem(f"several joints are external axis {number}", key="joints")
    if len(external) == len(joints):
        yield Problem("all joints are external axes: expected an arm", key="joints")
    followers = {i for i, joint in enumerate(joints, start=1) if not joint.driven}
    led = {coupling.joint for coupling in couplings}
    for joint in sorted(followers - led):
        yield Problem("is not driven, and no coupling moves it: expected one", key=f"joints[{joint}]")
    for i, coupling in enumerate(couplings, start=1):
        if coupling.source in followers:
            said = f"joint {coupling.source} follows another itself: expected a driven joint"
            yield Problem(said, key=f"couplings[{i}].source")
    if isinstance(loop, FourBar) and followers & {loop.joint, loop.joint - 1}:
        yield Problem("a joint of the loop is not driven: expected one with a motor", key="loop.joint")


def other_problems(
    n_joints: int,
    gravity: Any,
    ground: Any,
    base: Any,
    couplings: Any,
    loop: Any,
    tool_rotation: Any,
    payloads: Any,
    markers: Any,
) -> Told:
    """Tell what is wrong with all that is no joint."""
    yield from _vector("gravity", gravity)
    if ground != 0:
        yield from _joint("ground", ground, 0, n_joints)
    yield from _kind("base", base, Base)
    if isinstance(base, Base):
        yield from _vector("base.origin", base.origin)
        yield from _vector("base.rotation", base.rotation)
    for i, coupling in enumerate(couplings if isinstance(couplings, tuple) else (couplings,)):
        where = f"couplings[{i + 1}]"
        yield from _kind(where, coupling, Coupling)
        if isinstance(coupling, Coupling):
            yield from _joint(f"{where}.joint", coupling.joint, 1, n_joints)
            yield from _joint(f"{where}.source", coupling.source, 1, n_joints)
            yield from _number(f"{where}.factor", coupling.factor)
    if loop is not None:
        yield from _loop(loop, n_joints)
    if tool_rotation is not None:
        yield from _vector("tool_rotation", tool_rotation)
    yield from _payloads(payloads)
    yield from _markers(markers)


def _frame(where: str, joint: Joint) -> Told:
    yield from _kind(f"{where}.frame", joint.frame, Frame)
    if not isinstance(joint.frame, Frame):
        return
    for step in joint.frame.steps:
        yield from _number(f"{where}.frame.{step.symbol}", step.value)
    symbols = [step.symbol for step in joint.frame.steps]
    for symbol in {symbol for symbol in symbols if symbols.count(symbol) > 1}:
        yield Problem(f"expected each symbol once in a frame, found '{symbol}' again", key=f"{where}.frame")
    if joint.frame.turn.motion != "rz":
        yield Problem(f"expected a turn about z, found {joint.frame.turn.motion}", key=f"{where}.frame.turn")
    if joint.kind == "prismatic" and joint.frame.slide is None:
        yield Problem("expected a shift along z in its body, along which a prismatic joint moves", key=f"{where}.frame")


def _limits(where: str, joint: Joint) -> Told:
    if joint.limits is None:
        if joint.kind == "prismatic":
            yield Problem("a prismatic joint needs limits [m]", key=where)
        return
    wrong = list(_vector(f"{where}.limits", joint.limits, 2))
    yield from wrong
    if not wrong and not joint.limits[0] < joint.limits[1]:
        low, high = joint.limits
        yield Problem(f"expected lower < upper, found {low:g} and {high:g}", key=f"{where}.limits")


def _loop(loop: Any, n_joints: int) -> Told:
    yield from _kind("loop", loop, FourBar)
    if not isinstance(loop, FourBar):
        return
    yield from _joint("loop.joint", loop.joint, 2, n_joints)
    for name, bar in (("crank", loop.crank), ("rod", loop.rod)):
        yield from _kind(f"loop.{name}", bar, Bar)
        if isinstance(bar, Bar):
            yield from _number(f"loop.{name}.length", bar.length, above=0)
            yield from _mass(f"loop.{name}", bar)
    yield from _number("loop.rocker", loop.rocker, above=0)
    yield from _number("loop.offset", loop.offset)
    yield from _choice("loop.assembly", loop.assembly, ("open", "crossed"))


def _payloads(payloads: Named[Any]) -> Told:
    for name, payload in payloads.items():
        yield from _kind(f"payloads.{name}", payload, Payload)
        if isinstance(payload, Payload):
            yield from _number(f"payloads.{name}.mass", payload.mass, least=0, optional=True)
            yield from _vector(f"payloads.{name}.com", payload.com)


def _markers(markers: Named[Any]) -> Told:
    if not markers:
        yield Problem('expected at least one marker, e.g. {"tool": Marker((0, 0, 0.1))}', key="markers")
    if "base" in markers:
        yield Problem("a marker cannot be called 'base': parameters are named by their part", key="markers")
    for k, (name, marker) in enumerate(markers.items()):
        yield from _kind(f"markers.{name}", marker, Marker)
        if not isinstance(marker, Marker):
            continue
        yield from _vector(f"markers.{name}.point", marker.point)
        yield from _number(f"markers.{name}.relative_sd", marker.relative_sd, above=0, optional=True)
        if marker.relative_sd and not marker.known:
            yield Problem(
                "a marker with relative_sd is known beside the first: expected known = true", key=f"markers.{name}"
            )
        if k == 0 and marker.relative_sd:
            yield Problem("the first marker has no relative_sd: the others' places are relative to it", key="markers")


def _mass(where: str, part: Joint | Bar) -> Told:
    yield from _number(f"{where}.mass", part.mass, least=0, optional=True)
    yield from _vector(f"{where}.com", part.com)


def _joint(where: str, joint: Any, first: int, last: int) -> Told:
    if not isinstance(joint, int) or isinstance(joint, bool) or joint < first:
        yield Problem(f"expected a whole number from {first}, found {joint!r}", key=where)
    elif joint > last:
        what = (
            f"external axis {joint}: there are"
            if where.endswith("external")
            else f"joint {joint}: this robot has joints"
        )
        yield Problem(f"there is no {what} 1 to {last}", key=where)


def _kind(where: str, value: Any, kind: type) -> Told:
    if not isinstance(value, kind):
        yield Problem(f"expected a {kind.__name__}, found {value!r}", key=where)


def _choice(where: str, value: Any, choice: Sequence[Any]) -> Told:
    if not any(value == one and type(value) is type(one) for one in choice):
        yield Problem(f"expected {' or '.join(map(repr, choice))}, found {value!r}", key=where)


def _number(
    where: str, value: Any, above: float | None = None, least: float | None = None, optional: bool = False
) -> Told:
    if optional and value is None:
        return
    if not _is_number(value):
        yield Problem(f"expected a finite number, found {value!r}", key=where)
    elif above is not None and not value > above:
        yield Problem(f"expected a number greater than {above:g}, found {value:g}", key=where)
    elif least is not None and not value >= least:
        yield Problem(f"expected a number greater than or equal to {least:g}, found {value:g}", key=where)


def _vector(where: str, value: Any, length: int = 3) -> Told:
    if not isinstance(value, tuple) or len(value) != length or not all(map(_is_number, value)):
        yield Problem(f"expected {length} finite numbers, found {value!r}", key=where)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
