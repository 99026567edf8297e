"""robot.toml that names a URDF: joints by that file, and beside it what a URDF does not say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import Field, field_validator

from calflow.files.problems import InputError, Problem, nearest
from calflow.files.toml import FileModel, Origin
from calflow.robot.formats import urdf
from calflow.robot.formats.robot_toml import CouplingTable, DriveTable, Surroundings
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
