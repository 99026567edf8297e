"""The robot file: robot.toml, which states the joints itself or names a URDF beside it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calflow.files.problems import refuse
from calflow.files.toml import parse_toml, validate
from calflow.robot.formats import urdf
from calflow.robot.formats.robot_toml import RobotFile
from calflow.robot.formats.urdf_document import Drive, read_document
from calflow.robot.formats.urdf_toml import UrdfRobotFile


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
