"""The robot file, read and written: robot.toml, which states the joints itself or names a URDF beside it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import tomli_w
from pydantic import Field as Rule
from pydantic import ValidationInfo, field_validator, model_validator

from calflow.files.problems import nearest, refuse
from calflow.files.toml import (
    Angle,
    Angles3,
    FileModel,
    Lengths3,
    LinkLength,
    Origin,
    Record,
    parse_toml,
    refuse_all,
    validate_table,
)
from calflow.files.units import split_unit
from calflow.files.written_toml import table_of
from calflow.robot.formats import urdf
from calflow.robot.formats.urdf import Drive, read_document
from calflow.robot.frames import CONVENTIONS, Frame, Motion, Place, Step, at_origin, convention_of, vector
from calflow.robot.parts import (
    STANDARD_GRAVITY,
    Base,
    FourBar,
    Joint,
    JointProperties,
    LinkName,
    RobotParts,
    StatedBase,
    Surroundings,
    link_names,
    parent_links,
    tree_messages,
)

OWN_FRAMES = "frames"  # the convention of a robot whose frames follow none
FRAME_PARTS = ("origin", "reach", "mount", "turn", "body")  # of a frame, in order
CONVENTIONAL = ("alpha", "a", "d", "theta", "beta")
UPRIGHT = 0.5  # cosine of a slide's angle to gravity from which it is no rail
PROPERTIES = tuple(field.name for field in fields(JointProperties))
PLACED = ("kind", "link", "parent")
AROUND = ("notes", "tool_rotation", "payloads", "markers", "expected")


@dataclass(frozen=True, kw_only=True)
class StepTable(Record):
    """An elementary transform of a frame that follows no convention: a shift along an axis or a turn about it."""

    part: Literal["origin", "reach", "mount", "turn", "body"]
    motion: Motion
    symbol: str
    shift: LinkLength | None = None
    turn: Angle | None = None
    free: tuple[Place, ...] = ()

    @model_validator(mode="after")
    def _of_its_motion(self) -> Self:
        shifts = self.motion[0] == "t"
        if (self.turn if shifts else self.shift) is not None:
            raise ValueError(f"a motion {self.motion} has {'shift_mm' if shifts else 'turn_deg'}, nothing else")
        return self

    @property
    def step(self) -> Step:
        """The step."""
        return Step(self.motion, self.symbol, self.shift or self.turn or 0.0, self.free)


@dataclass(frozen=True, kw_only=True)
class JointFrame(Record):
    """A joint's frame: five figures of a convention, or all its steps; origin and rotation where it stands beside other joints."""

    name: str = ""
    kind: Literal["revolute", "prismatic"] = "revolute"
    link: str = ""
    parent: LinkName = ""
    origin: Lengths3 | None = None
    rotation: Angles3 | None = None
    alpha: Angle = 0.0
    a: LinkLength = 0.0
    d: LinkLength = 0.0
    theta: Angle = 0.0
    beta: Angle = 0.0
    steps: tuple[StepTable, ...] = ()
    listed: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _stated_once(self) -> Self:
        if not self.steps:
            return self
        if figures := sorted(name for name in (*CONVENTIONAL, "origin", "rotation") if getattr(self, name)):
            raise ValueError(f"'{figures[0]}' is of a convention: a joint stated by its steps has none")
        parts = [step.part for step in self.steps]
        if parts != sorted(parts, key=FRAME_PARTS.index) or parts.count("turn") != 1:
            raise ValueError("steps: expected those of reach, then of mount, one of turn, then those of body")
        return self

    def frame(self, convention: str, beside: bool = False) -> Frame:
        """Return the frame; beside says whether it is of a joint that stands beside the first one on its link."""
        if convention != OWN_FRAMES:
            frame = CONVENTIONS[convention](**{name: getattr(self, name) for name in CONVENTIONAL})
            return (
                at_origin(frame, self.origin or (0.0, 0.0, 0.0), self.rotation or (0.0, 0.0, 0.0)) if beside else frame
            )
        steps = {part: tuple(table.step for table in self.steps if table.part == part) for part in FRAME_PARTS}
        (turn,) = steps["turn"]
        return Frame(turn, steps["reach"], steps["mount"], steps["body"], self.listed, steps["origin"])


@dataclass(frozen=True, kw_only=True)
class JointTable(JointProperties, JointFrame):
    """One joint and the link it moves."""

    @classmethod
    def of(cls, joint: Joint, convention: str) -> Self:
        """Return the table that states a joint."""
        properties: dict[str, Any] = {name: getattr(joint, name) for name in (*PLACED, *PROPERTIES)}
        if convention != OWN_FRAMES:
            stands = [step.value for step in joint.frame.origin]
            places = {"origin": vector(stands[:3]), "rotation": vector(stands[3:])} if stands else {}
            return cls(**properties | places | replace(joint.frame, origin=()).figures)
        steps = [
            StepTable(
                part=part,  # type: ignore[arg-type]
                motion=step.motion,
                symbol=step.symbol,
                free=step.free,
                **{"shift" if step.is_length else "turn": step.value},
            )
            for part in FRAME_PARTS
            for step in ((joint.frame.turn,) if part == "turn" else getattr(joint.frame, part))
        ]
        return cls(**properties, steps=tuple(steps), listed=joint.frame.listed)

    def joint(self, convention: str, beside: bool = False) -> Joint:
        """Return the joint; beside as in `frame`."""
        return Joint(self.frame(convention, beside), **{name: getattr(self, name) for name in (*PLACED, *PROPERTIES)})

    @property
    def text(self) -> str:
        """The table as a file has it, a step a line."""
        dimension = "angle" if self.kind == "revolute" else "length"
        table = table_of(self, limits=dimension)
        steps = table.pop("steps", ())
        lines = [f"  {{{', '.join(_dumped(step).splitlines())}}},\n" for step in steps]
        return f"\n[[joints]]\n{_dumped(table)}{''.join(('steps = [', chr(10), *lines, ']', chr(10))) if lines else ''}"


@dataclass(frozen=True, kw_only=True)
class RobotFile(Surroundings):
    """A robot file as written."""

    name: str
    convention: Literal["dh", "modified-dh", "frames"]
    ground: Annotated[int, Rule(ge=0)] = 0
    joints: Annotated[tuple[JointTable, ...], Rule(min_length=1)]
    loop: FourBar | None = None

    @field_validator("joints")
    @classmethod
    def _stated_alike(cls, joints: tuple[JointTable, ...], info: ValidationInfo) -> tuple[JointTable, ...]:
        by_steps, expected = info.data.get("convention") == OWN_FRAMES, f'with convention = "{OWN_FRAMES}"'
        for i, joint in enumerate(joints, start=1):
            if by_steps and not joint.steps:
                raise ValueError(f"joint {i}: missing: expected steps, {expected}")
            if joint.steps and not by_steps:
                raise ValueError(f"joint {i}: steps go {expected}")
        return joints

    @model_validator(mode="after")
    def _is_a_tree(self) -> Self:
        """What others go on from takes no origin: its own figures say where they stand."""
        refuse_all(tree_messages(self.joints, self.loop))
        refuse_all(
            (
                ("joints", i, "origin" if joint.origin else "rotation"),
                "goes on from the joint before: expected it only of a joint that stands on a link beside another",
            )
            for i, (joint, beside) in enumerate(zip(self.joints, self.beside, strict=True))
            if (joint.origin or joint.rotation) and not beside
        )
        return self

    @property
    def beside(self) -> list[bool]:
        """Which joints are not the first on their links."""
        on = parent_links(self.joints)
        return [link in on[:i] for i, link in enumerate(on)]

    @model_validator(mode="after")
    def _up_is_known(self) -> Self:
        """A first joint that slides along the base's z is a lift, or a rail that takes what is said of no gravity along itself."""
        if self.ground > len(self.joints):
            raise ValueError(f"ground: there is no link {self.ground}: this robot has links 0 to {len(self.joints)}")
        if self.gravity is not None:
            return self
        if self.ground:
            raise ValueError(f"missing: expected gravity, in the axes of link {self.ground}, which stands on the floor")
        first = self.joints[0]
        if first.steps:
            raise ValueError("missing: expected gravity, in the base's axes, of a robot stated by its frames' steps")
        upright = self.convention == "dh" or abs(np.cos(first.alpha) * np.cos(first.beta)) > UPRIGHT
        if first.kind == "prismatic" and upright:
            raise ValueError(
                "missing: expected gravity, in the base's axes: the first joint slides along the base's z, along which gravity "
                "acts where nothing is said; of a lift state [0, 0, -9.80665], of a rail e.g. [0, -9.80665, 0]"
            )
        return self

    @classmethod
    def of(cls, robot: RobotParts) -> Self:
        """Return the file that states a robot; frames that are not all of one convention are stated by their steps."""
        convention = convention_of([joint.frame for joint in robot.joints]) or OWN_FRAMES
        level = robot.gravity == STANDARD_GRAVITY and robot.joints[0].kind == "revolute"
        usual = level and convention != OWN_FRAMES and not robot.ground
        same = {name: getattr(robot, name) for name in (*AROUND, "name", "couplings", "ground", "loop")}
        return cls(
            **same,
            base=StatedBase(robot.base.origin, robot.base.rotation, robot.base.known),
            gravity=None if usual else robot.gravity,
            convention=convention,  # type: ignore[arg-type]
            joints=tuple(JointTable.of(joint, convention) for joint in robot.joints),
        )

    @property
    def parts(self) -> dict[str, Any]:
        """The fields of the robot that the file states."""
        return {name: getattr(self, name) for name in ("name", "couplings", "ground", "loop")} | {
            **_around(self),
            "gravity": self.gravity or STANDARD_GRAVITY,
            "joints": tuple(
                joint.joint(self.convention, beside) for joint, beside in zip(self.joints, self.beside, strict=True)
            ),
        }

    @property
    def text(self) -> str:
        """The file's text."""
        table = table_of(self)
        after: dict[str, Any] = {name: table.pop(name) for name in ("loop", "payloads", "markers") if name in table}
        del table["joints"]
        for expected in table.get("expected", ()):
            expected.setdefault("unit", "")
        return "".join((_dumped(table), *(joint.text for joint in self.joints), "\n", _dumped(after)))


def _around(table: Surroundings) -> dict[str, Any]:
    """The fields of the robot that stand beside its joints in either kind of file."""
    base = Base(table.base.origin, table.base.rotation, table.base.known)
    return {name: getattr(table, name) for name in AROUND} | {"base": base}


def _dumped(table: Mapping[str, Any]) -> str:
    """A table as TOML, a list of numbers or names on one line."""
    lists = re.compile(r"\[\n((?: +[^\[\]{}\n]+,\n)+) *\]")
    return lists.sub(lambda match: f"[{' '.join(match[1].split())[:-1]}]", tomli_w.dumps(table))


class UrdfTable(FileModel):
    """The URDF file, which lies beside the robot file, and the links between which the robot is: one tip, or several."""

    file: str
    base: str | None = None
    tip: str | tuple[str, ...] | None = None

    @field_validator("file")
    @classmethod
    def _beside(cls, file: str) -> str:
        if Path(file).name != file or not file.lower().endswith(urdf.SUFFIX):
            raise ValueError(f"expected the name of a {urdf.SUFFIX} file that lies beside this one, found {file!r}")
        return file


@dataclass(frozen=True, kw_only=True)
class NamedJointTable(JointProperties):
    """What is to be said of a joint of the URDF besides."""

    name: str

    @field_validator("name")
    @classmethod
    def _there(cls, name: str, info: ValidationInfo) -> str:
        kinds = (info.context or {}).get("kinds")
        if kinds is not None and name not in kinds:
            missing = f"there is no joint '{name}' that moves between base and tip{nearest(name, kinds)}"
            raise ValueError(f"{missing}; there are {', '.join(kinds)}")
        return name


@dataclass(frozen=True, kw_only=True)
class UrdfRobotFile(Surroundings):
    """A robot file that names a URDF, as written; joints are those of which more, or something else, is to be said."""

    urdf: UrdfTable
    joints: tuple[NamedJointTable, ...] = ()

    @field_validator("joints")
    @classmethod
    def _once(cls, joints: tuple[NamedJointTable, ...]) -> tuple[NamedJointTable, ...]:
        names = [joint.name for joint in joints]
        refuse_all(((k, "name"), f"joint '{name}' is there twice") for k, name in enumerate(names) if name in names[:k])
        return joints


def _with_urdf(raw: dict[str, Any], origin: Origin) -> dict[str, Any]:
    """The fields of the robot that a robot file and the URDF that it names state, the file's where both do."""
    names = validate_table(raw, UrdfRobotFile, origin).urdf
    parts = urdf.read_urdf(origin.path.parent / names.file, names.tip, names.base)
    joints = {joint.name: joint for joint in parts["joints"]}
    links = link_names(joint.link for joint in joints.values())
    context = {"n_joints": len(joints), "links": links, "kinds": {name: joint.kind for name, joint in joints.items()}}
    table = validate_table(raw, UrdfRobotFile, origin, context=context)
    for stating, keys in zip(table.joints, raw.get("joints", ()), strict=True):
        names_of = {split_unit(key)[0] for key in keys}
        more = {name: getattr(stating, name) for name in PROPERTIES if name in names_of}
        joints[stating.name] = replace(joints[stating.name], **more)
    return parts | {
        **_around(table),
        "name": table.name or parts["name"],
        "gravity": table.gravity or parts["gravity"],
        "joints": tuple(joints.values()),
        "couplings": (*parts["couplings"], *table.couplings),
    }


def read_robot(path: Path) -> dict[str, Any]:
    """Read a robot file into the fields of a robot.

    Raises:
        InputError: with all that is wrong in it, and in the URDF that it names.
    """
    if path.suffix.lower() == urdf.SUFFIX:
        raise refuse(
            f"a URDF says nothing of markers and of where the robot stands: expected a robot file with [urdf] file = "
            f"\"{path.name}\"; 'calflow new FOLDER --robot {path.name}' writes one",
            path,
        )
    return parts_of(*parse_toml(path))


def parts_of(raw: dict[str, Any], origin: Origin) -> dict[str, Any]:
    """Return the fields of a robot that a parsed robot file states.

    Raises:
        InputError: with all that is wrong in it, and in the URDF that it names.
    """
    if "urdf" in raw:
        return _with_urdf(raw, origin)
    joints = raw.get("joints")
    context = {"n_joints": len(joints), "links": _links(joints)} if isinstance(joints, list) else None
    return validate_table(raw, RobotFile, origin, context=context).parts


def _links(joints: list[Any]) -> tuple[str, ...]:
    """The names of the links of joints as parsed, what is wrong with one left to be told where it stands."""
    names = (joint.get("link") if isinstance(joint, dict) else "" for joint in joints)
    return link_names(name if isinstance(name, str) else "" for name in names)


def files(path: Path) -> tuple[Path, ...]:
    """Return the files of which a robot file that can be read consists: itself, and the URDF that it names.

    Raises:
        InputError: with all that is wrong in it.
    """
    raw, origin = parse_toml(path)
    if "urdf" not in raw:
        return (path,)
    return path, path.parent / validate_table(raw, UrdfRobotFile, origin).urdf.file


def drives(path: Path) -> Mapping[str, Drive]:
    """Return what the URDF that a robot file names says of each joint's drive, by the joint's name; nothing without a URDF.

    Raises:
        InputError: with all that is wrong in the files.
    """
    _, *stated = files(path)
    return {name: joint.drive for document in stated for name, joint in read_document(document).joints.items()}
