"""The roles of columns (joint, point, time, label …) as far as their names, units and values identify them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calflow.importing.foreign_table import TEMPERATURES, TIMES, ForeignColumn, ForeignTable, name_words
from calflow.robot.robot import Robot

PLANNED = {"nom", "nominal", "soll", "target", "cmd", "command", "commanded", "ref", "reference", "desired", "set", "setpoint",
           "theo", "theoretical", "planned", "calc", "sp", "goal", "model", "cad"}  # fmt: skip
DEVIATIONS = {"dev", "deviation", "delta", "dif", "diff", "difference", "error", "err", "abw", "abweichung", "residual", "d", "δ",
              "std", "sigma", "rms", "min", "max", "tol", "tolerance", "velocity", "vel", "speed", "effort",
              "current", "torque", "acc"}  # fmt: skip
ACTUAL = {"act", "actual", "ist", "meas", "measured", "measurement", "gemessen", "mess", "tracker", "laser", "encoder", "enc",
          "real", "obs", "observed"}  # fmt: skip
JOINT = re.compile(r"(?:q|j|a|ax|joint|axis|achse|gelenk|theta|th|θ|jnt|pos|position)(\d+)")
EXTERNAL = re.compile(r"(?:e|eax|extax|ext)(\d+)")
JOINT_WORDS = {"q", "j", "a", "joint", "joints", "axis", "achse", "gelenk", "theta", "th", "θ", "jnt", "position", "positions",
               "angle", "angles"}  # fmt: skip
_QUALIFIER = "|".join(sorted(PLANNED | ACTUAL | DEVIATIONS))
AXIS = re.compile(rf"(?P<before>p|t|pos|{_QUALIFIER})?(?P<axis>[xyz])(?P<after>{_QUALIFIER})?(?P<number>\d*)")
YASKAWA = "sleurbt"  # its axes' names, in order; only arms of seven have an E
LETTERS = ("a", "b", "c", "d", "e", "f", "g")  # letters by which some files name the joints
POSE_WORDS = {"pose", "point", "punkt", "position", "pos", "nr", "no", "number", "nummer", "id", "index", "idx", "messpunkt",
              "target", "p", "pt", "name", "label", "image", "config", "configuration", "sample"}  # fmt: skip
QUATERNION = ("qw", "qx", "qy", "qz")
Group = tuple[str, ...]  # the words that the names of one set of columns share


@dataclass(frozen=True)
class Roles:
    """The columns of a table by their possible roles, each given by its index in the table.

    joints maps the shared words of a group to its columns by joint (from 0); points and turns likewise, by component.
    """

    joints: Mapping[Group, Mapping[int, int]]
    points: Mapping[Group, Mapping[str, int]]
    turns: Mapping[Group, Mapping[str, int]]
    time: int | None
    temperature: int | None
    labels: Mapping[str, int]


def roles(table: ForeignTable, robot: Robot | None) -> Roles:
    """Return the roles that the names of a table's columns identify; without names, only a time that increases."""
    if not table.named:
        return Roles({}, {}, {}, _counting_time(table), None, {})
    joints: dict[Group, dict[int, int]] = {}
    points: dict[Group, dict[str, int]] = {}
    turns: dict[Group, dict[str, int]] = {}
    labels: dict[str, int] = {}
    external: dict[int, int] = {}
    time = temperature = None
    lettered = _lettered(table)
    for k, column in enumerate(table.columns):
        words = name_words(column.name)
        if not column.is_figures:
            if label := _label(words, robot, column):
                labels.setdefault(label, k)
            continue
        if axis := _external(words, robot):
            external[axis] = k
        elif (letter := _beside_joint(words)) in lettered:
            joints.setdefault(("joint",), {}).setdefault(lettered.index(letter) + 1, k)
        elif (joint := _joint(column, words, robot)) and not DEVIATIONS & {*joint[0]}:
            joints.setdefault(joint[0], {}).setdefault(joint[1], k)
        elif turn := _turn(words):
            turns.setdefault(turn[0], {}).setdefault(turn[1], k)
        elif point := _axis(words):
            points.setdefault(point[0], {}).setdefault(point[1], k)
        elif time is None and TIMES & {*words} and column.unit in ("", "s", "ms", "us", "ns", "min") and _runs(column):
            time = k
        elif temperature is None and (TEMPERATURES & {*words} or column.unit == "degC"):
            temperature = k
        elif label := _label(words, robot, column):
            labels.setdefault(label, k)
    return Roles(
        {group: _with_external(_counted_from_0(members), external, robot) for group, members in joints.items()},
        {group: members for group, members in points.items() if len(members) == 3 and not DEVIATIONS & {*group}},
        {group: members for group, members in turns.items() if not DEVIATIONS & {*group}},
        time,
        temperature,
        labels,
    )


def preferred(groups: Sequence[Group]) -> list[Group]:
    """Return groups in decreasing likelihood of holding measurements: named actual, unqualified, named planned."""
    return sorted(groups, key=lambda group: (bool(PLANNED & {*group}), not ACTUAL & {*group}, len(group)))


def _joint(column: ForeignColumn, words: Sequence[str], robot: Robot | None) -> tuple[Group, int] | None:
    """The other words of a joint column's name and the joint's number as the name counts; None if it is no joint."""
    if column.unit not in ("", "deg", "rad", "mrad", "mm", "m", "si"):
        return None
    if robot:
        names = [name_words(joint.name) for joint in robot.joints]
        for i, name in enumerate(names):
            if name and any(list(words[s : s + len(name)]) == name for s in range(len(words))):
                return tuple(word for word in words if word not in name), i + 1
    for k, word in enumerate(words):
        if match := JOINT.fullmatch(word):
            return ("joint", *words[:k], *words[k + 1 :]), int(match[1])
        if word.isdigit() and k and words[k - 1] in JOINT_WORDS and int(word) < 20:
            return ("joint", *words[: k - 1], *words[k + 1 :]), int(word)
        if word in LETTERS and k and words[k - 1] in ("joint", "axis", "achse", "gelenk"):
            return ("joint", *words[: k - 1], *words[k + 1 :]), LETTERS.index(word) + 1
    return None


def _lettered(table: ForeignTable) -> list[str]:
    """The letters that are the joints' names, in order: those of Yaskawa where each has a column."""
    names = {_beside_joint(name_words(column.name)) for column in table.columns}
    return [letter for letter in YASKAWA if letter in names] if names.issuperset(YASKAWA.replace("e", "")) else []


def _beside_joint(words: Sequence[str]) -> str:
    """The only word of a name beside that it is a joint's; empty if there is none, or another."""
    others = [word for word in words if word not in JOINT_WORDS]
    return others[0] if len(others) == 1 else ""


def _counted_from_0(members: Mapping[int, int]) -> dict[int, int]:
    """Columns by joint from 0, whether the names count from 0 or 1."""
    first = 0 if 0 in members else 1
    return {number - first: column for number, column in sorted(members.items())}


def _external(words: Sequence[str], robot: Robot | None) -> int:
    """The number of the external axis that a column holds, or 0."""
    numbers = [robot.joints[i].external for i in robot.external] if robot else []
    matches = (EXTERNAL.fullmatch(word) for word in words)
    return next((int(match[1]) for match in matches if match and int(match[1]) in numbers), 0)


def _with_external(members: dict[int, int], external: Mapping[int, int], robot: Robot | None) -> dict[int, int]:
    """Columns by joint including the external axes, which controllers number separately from the arm's joints."""
    if not robot or not external:
        return members
    arm = {robot.arm[k]: column for k, column in members.items() if k < len(robot.arm)}
    axes = {i: external[n] for i in robot.external if (n := robot.joints[i].external) in external and n is not None}
    return dict(sorted({**arm, **axes}.items()))


def _axis(words: Sequence[str]) -> tuple[Group, str] | None:
    """The other words of a point column's name, including those in one with the axis (`Xist`, `px`, `x2`), and the axis."""
    for k, word in sorted(enumerate(words), key=lambda numbered: len(numbered[1])):
        if match := AXIS.fullmatch(word):
            beside = filter(None, match.group("before", "after", "number"))
            return (*words[:k], *beside, *words[k + 1 :]), match["axis"]
    return None


def _turn(words: Sequence[str]) -> tuple[Group, str] | None:
    """The other words of an orientation column's name, and the component that it holds."""
    for k, word in enumerate(words):
        if word in (*QUATERNION, "rx", "ry", "rz", "roll", "pitch", "yaw"):
            return (*words[:k], *words[k + 1 :]), word
        if word in ("w", "x", "y", "z") and {"orientation", "quaternion", "quat", "rotation"} & {*words}:
            return (*words[:k], *words[k + 1 :]), f"q{word}"
    return None


def _label(words: Sequence[str], robot: Robot | None, column: ForeignColumn) -> str:
    """The label that a column holds: marker or payload if its cells are names in the robot file, else pose by name."""
    cells = {str(cell).lower() for cell in column.cells if cell}
    if robot and cells and cells <= {name.lower() for name in robot.markers} and not column.is_figures:
        return "marker"
    if robot and cells and cells <= {name.lower() for name in robot.payloads}:
        return "payload"
    return "pose" if POSE_WORDS & {*words} or words == ["#"] else ""


def _runs(column: ForeignColumn) -> bool:
    """Whether the values of a clock differ between rows, which those of a clock rounded to few digits do not."""
    return len(np.unique(column.figures)) > 0.9 * len(column.figures)


def _counting_time(table: ForeignTable) -> int | None:
    """The first column of a table whose values strictly increase and are not all integers; None if there is none."""
    for k, column in enumerate(table.columns):
        steps = np.diff(column.figures)
        if column.is_figures and len(steps) > 5 and (steps > 0).all() and (column.figures % 1).any():
            return k
    return None


def seconds(column: ForeignColumn) -> np.ndarray:
    """Return a clock's values [s], by their unit or else, as times since 1970, by their magnitude."""
    scale = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "s": 1.0}.get(column.unit)
    if scale is None:
        size = float(np.nanmax(np.abs(column.figures)))
        scale = next((s for bound, s in ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3)) if size > bound), 1.0)
    return column.figures * scale
