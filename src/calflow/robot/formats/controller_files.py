"""The controllers' own files: where ABB's, KUKA's and FANUC's keep a robot's zeros, base and tool, and how these are written there.

A statement is a piece of such a file with numbers that have names. A joint's zero is one of them: its value is to change by what
has to be added to the joint's reading, times a factor that the file itself states. So a maker is a reader of statements and the
names of these numbers; what is written is every statement that changes, beside what it was.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Literal

import numpy as np

from calflow.files.deferred import Rotation
from calflow.files.problems import Problem, refuse, refuse_any, regular_file
from calflow.robot.robot import Robot

Maker = Literal["abb-moc", "kuka-dat", "fanuc-mastering"]
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.]|,\d)"  # and nothing of a number after it, as in 3,25
MOC_BASE = tuple(f"base_frame_{what}" for what in ("pos_x", "pos_y", "pos_z", *(f"orient_u{k}" for k in range(4))))
FRAME = r"\{\s*(?:FRAME:\s*)?" + r",\s*".join(rf"{axis}\s+({NUMBER})" for axis in "XYZABC") + r"\s*\}"


@dataclass(frozen=True)
class FileStatement:
    """A piece of a file, and of each of its numbers by name where it stands in the text; heading is what has to stand above it."""

    text: str
    places: Mapping[str, tuple[int, int]]
    heading: str = ""

    @property
    def values(self) -> dict[str, float]:
        """Its numbers by name."""
        return {name: float(self.text[start:end]) for name, (start, end) in self.places.items()}

    def changed(self, numbers: Mapping[str, str]) -> str:
        """Return the text with other numbers, all else as it is."""
        text = self.text
        for name, (start, end) in sorted(self.places.items(), key=lambda item: -item[1][0]):
            text = text[:start] + numbers.get(name, text[start:end]) + text[end:]
        return text


@dataclass(frozen=True)
class ControllerFile:
    """How a maker keeps a robot's figures.

    zero and factor name a joint's offset, and what it changes by where 1 degree (or mm) is added to the joint's reading, of the
    numbers that the files state, the joint, and that in rad (or m). base names the numbers of the robot's place, tool those of a
    marker's. digits are written of each offset.
    """

    files: str
    comment: str
    statements: Callable[[str], Iterator[FileStatement]]
    zero: str
    factor: Callable[[Mapping[str, float], int, float], float]
    digits: int
    needs: tuple[str, ...] = ()
    base: Callable[[Robot], Mapping[str, float]] = lambda robot: {}
    tool: Callable[[Robot, str], Mapping[str, float]] = lambda robot, marker: {}


@dataclass(frozen=True)
class Pasted:
    """What is to be pasted into a controller's files; holds_tool says whether a tool is in it."""

    text: str
    holds_tool: bool


def controller_text(path: Path) -> str:
    """Return the text of a controller's file, which is in no certain encoding: only ASCII signs are looked for.

    Raises:
        InputError: there is no such file.
    """
    return regular_file(path).read_bytes().decode("latin-1")


def pasted(maker: Maker, texts: Mapping[Path, str], nominal: Robot, calibrated: Robot) -> Pasted:
    """Return the statements of a controller's own files that a calibrated robot changes, each beside what it was.

    Raises:
        InputError: the files lack a joint's offset, or what it is counted in.
    """
    kept = CONTROLLER_FILES[maker]
    statements = [statement for text in texts.values() for statement in kept.statements(text)]
    values = {name: value for statement in statements for name, value in statement.values.items()}
    arm = [i for i, joint in enumerate(nominal.joints) if joint.external is None and joint.driven]
    asked = (name.format(k + 1) for k in range(len(arm)) for name in (kept.zero, *kept.needs))
    if not texts:
        raise refuse(f"expected the controller's own file as it is today: {kept.files}", key="beside")
    where = ", ".join(path.name for path in texts)
    refuse_any(Problem(f"expected {name}, in {kept.files}: {where}") for name in asked if name not in values)
    added = dict(enumerate(added_to_readings(nominal, calibrated)[arm], start=1))
    one = {k: 1 / nominal.joints[i].shown[1] for k, i in enumerate(arm, start=1)}
    factors = {k: kept.factor(values, k, one[k]) for k in added}
    refuse_any(Problem(f"expected another {kept.needs[0].format(k)} than 0: {where}") for k in added if not factors[k])
    zeros = {kept.zero.format(k): factors[k] * more for k, more in added.items()}
    after = {name: f"{values[name] + more:.{kept.digits}f}" for name, more in zeros.items()}
    placed = dict(kept.base(calibrated)) if nominal.base.known else {}
    tools = {name: value for marker in calibrated.markers for name, value in kept.tool(calibrated, marker).items()}
    after |= {name: f"{value:.6f}" for name, value in (placed | tools).items() if name in values}
    after = {name: number for name, number in after.items() if float(number) != values[name]}
    lines = ["[deg, mm]: see that each does before the robot moves"]
    lines += [f"joint {k} reads {more:+z.4f} more where it stands" for k, more in added.items()]
    text = "\n".join([*(f"{kept.comment} {line}" for line in lines), *_replaced(statements, after, kept.comment), ""])
    return Pasted(text, any(name in values for name in tools))


def _replaced(statements: Sequence[FileStatement], after: Mapping[str, str], comment: str) -> Iterator[str]:
    """Yield the lines of the statements that other numbers change, each beside what it was, under their headings."""
    changed = (pair for pair in ((old, old.changed(after)) for old in statements) if pair[1] != pair[0].text)
    for heading, group in groupby(changed, key=lambda pair: pair[0].heading):
        yield from ("", heading) if heading else ()
        for statement, text in group:
            yield from (f"{comment} before: {line}" for line in statement.text.splitlines())
            yield text


def added_to_readings(nominal: Robot, calibrated: Robot) -> np.ndarray:
    """Return what has to be added to each joint's reading so that the maker's zero is true (n_joints,) [deg, or mm of a slide]."""
    off = [mine.moving.value - its.moving.value for its, mine in zip(nominal.joints, calibrated.joints, strict=True)]
    shown = np.array([joint.shown[1] for joint in nominal.joints])
    return np.asarray(shown * (nominal.angle_matrix @ np.array(off)))


def _moc(text: str) -> Iterator[FileStatement]:
    """The instances of ABB's MOC.cfg: of a section, from one `-name` to the next; a line may go on after a backslash."""
    kinds = {"MOTOR_CALIB": ("cal_offset",), "TRANSMISSION": ("transm_joint",), "ROBOT": MOC_BASE}
    heads = list(re.finditer(r"^([A-Z_0-9]+):[ \t]*\r?$", text, re.MULTILINE))
    for k, head in enumerate(heads):
        if head[1] not in kinds:
            continue
        section = text[head.end() : heads[k + 1].start() if k + 1 < len(heads) else None].replace("\r", "")
        for instance in re.finditer(
            r'^[ \t]*-name "([^"]*)".*?(?=^[ \t]*-name |^#|\Z)', section, re.MULTILINE | re.DOTALL
        ):
            text_of = instance[0].rstrip()
            matches = (re.search(rf"-{name}\s+({NUMBER})", text_of) for name in kinds[head[1]])
            places = {f"{instance[1]} {match[0].split()[0][1:]}": match.span(1) for match in matches if match}
            yield FileStatement(text_of, places, head[0].strip())


def _moc_base(robot: Robot) -> dict[str, float]:
    """Place [m] and quaternion, w first."""
    turn = Rotation.from_euler("XYZ", robot.base.rotation).as_quat(canonical=True, scalar_first=True)
    return {f"ROB_1 {name}": float(v) for name, v in zip(MOC_BASE, (*robot.base.origin, *turn), strict=True)}


def _krl(text: str) -> Iterator[FileStatement]:
    """The lines of KUKA's $machine.dat and $config.dat that state offsets, gears, the robot's base and tools by their names."""
    names = dict(re.findall(r'^\s*TOOL_NAME\[(\d+),?\]\s*=\s*"([^"]*)"', text, re.MULTILINE))
    for line in text.replace("\r", "").splitlines():
        if offset := re.match(rf"\s*(\$MAMES\[\d+\])\s*=\s*({NUMBER})", line):
            yield FileStatement(line, {offset[1]: offset.span(2)})
        elif frame := re.match(rf"\s*(?:(\$ROBROOT)|TOOL_DATA\[(\d+)\])\s*=\s*{FRAME}", line):
            of = frame[1] or f"TOOL_DATA {names.get(frame[2], '')}"
            yield FileStatement(line, {f"{of} {axis}": frame.span(k) for k, axis in enumerate("XYZABC", start=3)})


def _krl_frame(name: str, origin: Sequence[float], rotation: Sequence[float] | None) -> dict[str, float]:
    """Place [mm] and A, B, C [deg]; these stay as they are where nobody knows the turn."""
    turn = [] if rotation is None else Rotation.from_euler("XYZ", rotation).as_euler("ZYX", degrees=True)
    figures = (*(1e3 * np.array(origin)), *turn)
    return {f"{name} {axis}": float(value) for axis, value in zip("XYZABC", figures, strict=False)}


def _listing(text: str) -> Iterator[FileStatement]:
    """The elements of arrays in FANUC's listings of system variables (.VA): a field's name, then `[k] = value` lines."""
    array = ""
    for line in text.splitlines():
        if field := re.search(r"(\$(?:DMR_GRP|PARAM_GROUP)\[1\]\.\$(?:MASTER_COUN|ENCSCALES))(?:\[(\d+)\])?", line):
            array = field[1]
        elif re.search(r"\$\w+", line):
            array = ""
        number = re.search(rf"\[(\d+)\]\s*=\s*({NUMBER})", line)
        if array and number:
            start = f"{array}[{number[1]}]"
            yield FileStatement(f"{start} = {number[2]}", {start: (len(start) + 3, len(start) + 3 + len(number[2]))})


CONTROLLER_FILES: dict[Maker, ControllerFile] = {
    # (motor angle - cal_offset) / transm_joint is the joint's angle [rad], or the place of one that slides [m]
    "abb-moc": ControllerFile(
        files="MOC.cfg", comment="#", statements=_moc, zero="rob1_{} cal_offset", digits=6, needs=("rob1_{} transm_joint",),
        factor=lambda values, k, one: -one * values[f"rob1_{k} transm_joint"], base=_moc_base,
    ),
    # $MAMES is the reading where the axis stands at its mastering mark
    "kuka-dat": ControllerFile(
        files="$machine.dat or $config.dat", comment=";", statements=_krl, zero="$MAMES[{}]", digits=5,
        factor=lambda values, k, one: 1.0,
        base=lambda robot: _krl_frame("$ROBROOT", robot.base.origin, robot.base.rotation),
        tool=lambda robot, marker: _krl_frame(f"TOOL_DATA {marker}", robot.markers[marker].point, robot.tool_rotation),
    ),
    # a reading is the encoder's counts beyond the master count, over counts a degree: gear times resolution over 360
    "fanuc-mastering": ControllerFile(
        files="listings of SYSMAST and SYSTEM (.VA)", comment="--", statements=_listing, zero="$DMR_GRP[1].$MASTER_COUN[{}]",
        digits=0, needs=("$PARAM_GROUP[1].$ENCSCALES[{}]",),
        factor=lambda values, k, one: -values[f"$PARAM_GROUP[1].$ENCSCALES[{k}]"],
    ),
}  # fmt: skip
