"""The robot file: robot.toml, which states the joints itself or names a URDF beside it.

robot.toml that names a URDF: joints by that file, and beside it what a URDF does not say.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import Field, field_validator

from calflow.files.problems import InputError, Problem, nearest, refuse
from calflow.files.toml import FileModel, Origin, parse_toml, validate
from calflow.robot.formats import urdf
from calflow.robot.formats.robot_toml import CouplingTable, DriveTable, RobotFile, Surroundings
from calflow.robot.formats.urdf_document import Drive, read_document
from calflow.robot.parts import Coupling, Joint


class UrdfTable(FileModel):
    """The URDF file, which lies beside the robot file, and the links between which the robot is."""

    file: str
    base: str | None = None
    tip: str | None = None

    @field_validator("file")
    @classmethod
    def _beside(cls, file: str) -> str:
        if Path(file).name != file or not file.lower().endswith(urdf.SUFFIX):
            raise ValueError(f"expected the name of a {urdf.SUFFIX} file that lies beside this one, found {file!r}")
        return file


class NamedJointTable(DriveTable):
    """What is to be said of a joint of the URDF besides."""

    name: str


class UrdfRobotFile(Surroundings):
    """A robot file that names a URDF, as written; joints are those of which more, or something else, is to be said."""

    urdf: UrdfTable
    joints: tuple[NamedJointTable, ...] = Field(default=())
    couplings: tuple[CouplingTable, ...] = ()

    def fields(self, origin: Origin) -> dict[str, Any]:
        """Return the fields of the robot that the two files state.

        Raises:
            InputError: with all that is wrong in the URDF, else with what does not fit it.
        """
        stated = urdf.read(origin.path.parent / self.urdf.file, self.urdf.tip, self.urdf.base)
        joints = {joint.name: joint for joint in stated["joints"]}
        problems = [*_joint_problems(self.joints, joints, origin), *_coupling_problems(self.couplings, joints, origin)]
        if problems:
            raise InputError(problems)
        more = {table.name: table for table in self.joints}
        own = tuple(Coupling(**vars(coupling)) for coupling in self.couplings)
        return stated | {
            **self.around(),
            "name": self.name or stated["name"],
            "gravity": self.gravity or stated["gravity"],
            "joints": tuple(_completed(joint, more.get(name)) for name, joint in joints.items()),
            "couplings": (*stated["couplings"], *own),
        }


def _joint_problems(tables: tuple[NamedJointTable, ...], joints: dict[str, Joint], origin: Origin) -> list[Problem]:
    """Tell tables of joints that do not fit the URDF."""
    problems = []
    names = [table.name for table in tables]
    for k, table in enumerate(tables):
        joint = joints.get(table.name)
        if joint is None:
            said = f"there is no joint '{table.name}' that moves between base and tip{nearest(table.name, joints)}"
            problems.append(origin.problem(f"{said}; there are {', '.join(joints)}", "joints", k, "name"))
        elif table.name in names[:k]:
            problems.append(origin.problem(f"joint '{table.name}' is there twice", "joints", k, "name"))
        elif joint.kind == "revolute" and table.slides:
            problems.append(origin.problem("a revolute joint has limits_deg, not limits_mm", "joints", k))
        elif joint.kind == "prismatic" and table.turns:
            problems.append(origin.problem("a prismatic joint has limits_mm, not limits_deg", "joints", k))
    return problems


def _coupling_problems(tables: tuple[CouplingTable, ...], joints: dict[str, Joint], origin: Origin) -> list[Problem]:
    """Tell couplings of joints that are not there."""
    last = len(joints)
    return [
        origin.problem(f"there is no joint {number}: this robot has joints 1 to {last}", "couplings", k, key)
        for k, table in enumerate(tables)
        for key, number in (("joint", table.joint), ("source", table.source))
        if number > last
    ]


def _completed(joint: Joint, table: NamedJointTable | None) -> Joint:
    """A joint with what a table says of it."""
    if table is None:
        return joint
    given = {
        name: getattr(table, name)
        for name in ("sign", "gear_ratio", "rated_torque", "mass", "com", "driven", "external")
    }
    said = {name: value for name, value in given.items() if name in table.model_fields_set}
    return replace(joint, limits=table.limits or joint.limits, **said)


def read(path: Path) -> dict[str, Any]:
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
    raw, origin = parse_toml(path)
    if "urdf" in raw:
        return validate(raw, UrdfRobotFile, origin).fields(origin)
    return validate(raw, RobotFile, origin).fields()


def files(path: Path) -> tuple[Path, ...]:
    """Return the files of which a robot file that can be read consists: itself, and the URDF that it names.

    Raises:
        InputError: with all that is wrong in it.
    """
    raw, origin = parse_toml(path)
    if "urdf" not in raw:
        return (path,)
    return path, path.parent / validate(raw, UrdfRobotFile, origin).urdf.file


def drives(path: Path) -> Mapping[str, Drive]:
    """Return what the URDF that a robot file names says of each joint's drive, by the joint's name; nothing without a URDF.

    Raises:
        InputError: with all that is wrong in the files.
    """
    _, *stated = files(path)
    return {name: joint.drive for one in stated for name, joint in read_document(one).joints.items()}
