"""Templates: the commented files of a new study, with an example robot that runs as it is, or one of the library.

The library has robot files of common arms, each with the source of its figures in its notes.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Mapping
from importlib import import_module, resources
from importlib.resources.abc import Traversable
from pathlib import Path
from pkgutil import iter_modules

from calflow.files.problems import Problem, nearest, refuse, refuse_any
from calflow.files.writing import write_text
from calflow.robot.formats import mjcf, urdf
from calflow.robot.formats.ur_calibration import with_factory_calibration
from calflow.robot.formats.urdf import UrdfJoint, read_document
from calflow.robot.robot import Robot

FILES = ("robot.toml", "study.toml", "truth.toml")
DESCRIPTION = "_description"  # ending of the names of robot_descriptions
SCHEMAS = ".schemas"  # folder beside a study's files in which `calflow new` writes their JSON Schemas
ERRORS_MRAD = (1.2, -0.9)  # simulated zero errors of two joints


def write_study(
    folder: Path, robot: str = "", tip: urdf.Tips = None, base: str | None = None, factory: Path | None = None
) -> list[Path]:
    """Write a new study's files into a folder and return their paths.

    robot is a name of the library (see `library_names`) or of the package `robot_descriptions`, or the path of a URDF,
    which is copied, or of an MJCF file, which is converted to one; empty: an example to be replaced. tip (or several)
    and base are the links of `Robot.from_urdf`. factory is the factory calibration of a robot by Universal Robots.

    Raises:
        InputError: one of the files exists already, there is no such robot, or the URDF has errors.
    """
    if folder.exists() and not folder.is_dir():
        raise refuse("is a file; expected a folder, which may not exist yet", folder)
    with tempfile.TemporaryDirectory() as scratch:
        texts = _texts(_study_name(folder), _as_urdf(robot, Path(scratch)), tip, base, factory)
    kinds = schema_kinds(robot)
    # The first line names the schema with which editors complete and check a file.
    texts |= {name: f"#:schema {schema_path(kinds[name])}\n{text}" for name, text in texts.items() if name in kinds}
    there = [folder / name for name in texts if (folder / name).exists()]
    refuse_any(Problem("is there already; nothing was written", path) for path in there)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        for name, text in texts.items():
            write_text(folder / name, text)
    except OSError:
        for name in texts:
            (folder / name).unlink(missing_ok=True)
        raise
    return [folder / name for name in texts]


def schema_kinds(robot: str = "") -> dict[str, str]:
    """Return the kind, which determines the schema, of each file of a new study; robot is that of `write_study`."""
    stated = "urdf-robot" if robot.lower().endswith((urdf.SUFFIX, mjcf.SUFFIX, DESCRIPTION)) else "robot"
    return dict(zip(FILES, (stated, "study", "truth"), strict=True))


def _as_urdf(robot: str, scratch: Path) -> str:
    """Return the URDF, converted into a scratch folder from MJCF if need be, of a description; other robots unchanged.

    Raises:
        InputError: there is no such description, or it is neither URDF nor MJCF.
    """
    if robot.endswith(DESCRIPTION):
        robot = str(_described(robot))
    if not robot.lower().endswith(mjcf.SUFFIX):
        return robot
    path = scratch / f"{Path(robot).stem}{urdf.SUFFIX}"
    write_text(path, mjcf.urdf_of_mjcf(Path(robot)))
    return str(path)


def _described(name: str) -> Path:
    """Return the file of a robot of the package `robot_descriptions`, which downloads it if need be."""
    try:
        import robot_descriptions
    except ImportError:
        raise refuse(
            f"'{name}' is of the package robot_descriptions: pip install calflow[descriptions]", key="--robot"
        ) from None
    there = [module.name for module in iter_modules(robot_descriptions.__path__) if module.name.endswith(DESCRIPTION)]
    if name not in there:
        raise refuse(f"robot_descriptions has no '{name}'{nearest(name, there)}", key="--robot")
    try:
        description = import_module(f"robot_descriptions.{name}")
    except Exception as error:  # from git, the network, or a missing dependency
        raise refuse(f"robot_descriptions cannot get '{name}': {error}", key="--robot") from None
    for kind in ("URDF_PATH", "MJCF_PATH"):
        if hasattr(description, kind):
            return Path(getattr(description, kind))
    raise refuse(
        f"'{name}' is a xacro: expand it (xacro FILE > robot.urdf), and give --robot robot.urdf", key="--robot"
    )


def schema_path(kind: str) -> str:
    """Return the path of the schema of a kind of file, relative to a new study's folder."""
    return f"{SCHEMAS}/{kind}.schema.json"


def _texts(study: str, robot: str, tip: urdf.Tips, base: str | None, factory: Path | None) -> dict[str, str]:
    """Return the texts of a new study's files, by name."""
    if factory and (not robot or robot.lower().endswith(urdf.SUFFIX)):
        raise refuse("is of a robot of the library: expected --robot ur10e or another of Universal Robots", factory)
    if robot.lower().endswith(urdf.SUFFIX):
        described = _of_urdf(Path(robot), tip, base)
    elif tip or base is not None:
        raise refuse(f"tip and base are links of a URDF: expected --robot FILE{urdf.SUFFIX}")
    elif robot:
        described = {"robot.toml": library_file(robot)}
        if factory:
            described = {"robot.toml": with_factory_calibration(_robot_of(described), factory).toml_text()}
    else:
        return {name: _filled(_template(name), {"STUDY_NAME": study}) for name in FILES}
    words = _words(study, _robot_of(described))
    return described | {name: _filled(_template(f"given/{name}"), words) for name in ("study.toml", "truth.toml")}


def _robot_of(texts: Mapping[str, str]) -> Robot:
    """Return the robot that files describe, given their texts by name."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in texts.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        return Robot.from_toml(Path(folder) / "robot.toml")


def _of_urdf(path: Path, tip: urdf.Tips, base: str | None) -> dict[str, str]:
    """Return the texts of the robot file for a URDF, and of that URDF, by file name."""
    tree = urdf.find_tree(read_document(path), tip, base)
    names = [joint.name for joint in tree.moving]
    tips = [way.tip for way in tree.ways]
    words = {
        "ROBOT_NAME": json.dumps(tree.document.name),
        "URDF_FILE": json.dumps(path.name),
        "URDF_BASE": json.dumps(tree.base),
        "URDF_TIP": json.dumps(tips if len(tips) > 1 else tips[0]),
        "MARKERS": "\n".join(_marker(_key(tip), f"on = {json.dumps(tip)}\n") for tip in tips)
        if len(tips) > 1
        else _marker("tool", ""),
        "JOINTS": "\n".join(
            f"#   {i}  {joint.name}{_beside(joint, i <= tree.ground)}" for i, joint in enumerate(tree.moving, start=1)
        ),
        "FIRST_JOINT": json.dumps(names[0]),
    }
    text = path.read_text(encoding="utf-8-sig")
    return {"robot.toml": _filled(_template("given/urdf.toml"), words), path.name: text}


def _marker(key: str, on: str) -> str:
    """Return the table of a marker with unknown position."""
    return (
        f"{f'[markers.{key}]':32}# measured points, in the flange's frame\n{on}point_mm = [0, 0, 100]\n"
        "known = false                   # false: estimated from the measurements; of images state it, with true: they do not "
        "show it\n"
    )


def _key(name: str) -> str:
    """Return a name as a TOML key, quoted if need be."""
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else json.dumps(name)


def _beside(joint: UrdfJoint, carries: bool) -> str:
    """Return remarks on a joint in parentheses, or an empty text."""
    notes = [
        *([f"follows {joint.mimic.joint}: no column"] if joint.mimic else []),
        *(["carries what the base link is of; the robot stands beside it"] if carries else []),
    ]
    return f"  ({'; '.join(notes)})" if notes else ""


def study_text(folder: Path, robot: Robot, robot_file: str) -> str:
    """Return the text of the study file of a folder, for a robot whose file has this path relative to the folder."""
    text = _filled(_template("given/study.toml"), _words(_study_name(folder), robot))
    return text.replace('robot = "robot.toml"', f"robot = {json.dumps(robot_file, ensure_ascii=False)}")


def _study_name(folder: Path) -> str:
    return re.sub(r"^\W+|[^\w.-]+", "-", folder.resolve().name).strip("-") or "study"


def _words(study: str, robot: Robot) -> dict[str, str]:
    """Return the texts that replace the placeholders of the templates for a given robot."""
    frames = enumerate(zip(robot.frames, robot.places, strict=True), start=1)
    turning = [i for i, (frame, place) in frames if place in frame.turn.free]
    values = [
        f"[values.joint{i}]\n{robot.frames[i - 1].turn.symbol}_mrad = {error}"
        for i, error in zip(turning, ERRORS_MRAD, strict=False)
    ]
    effects = '["geometry", "joint-compliance"]      # leave the second out where the masses are not to be trusted'
    return {
        "STUDY_NAME": study,
        "EFFECTS": effects if robot.has_masses else '["geometry"]',
        "VALUES": "\n\n".join(values),
        "MARKER": _key(next(iter(robot.markers))),
    }


def _template(name: str) -> str:
    return resources.files(__name__).joinpath(name).read_text(encoding="utf-8")


def _filled(text: str, words: Mapping[str, str]) -> str:
    """Return a text with each placeholder replaced."""
    return re.sub("|".join(words), lambda match: words[match[0]], text)


def library_names() -> list[str]:
    """Return the names of the robots in the library."""
    return sorted(file.name.removesuffix(".toml") for file in _folder().iterdir() if file.name.endswith(".toml"))


def library_file(name: str) -> str:
    """Return the text of a library robot's file.

    Raises:
        InputError: there is no robot of this name.
    """
    if name not in library_names():
        raise refuse(
            f"there is no robot '{name}' in the library{nearest(name, library_names())}; there are {', '.join(library_names())}"
        )
    return _folder().joinpath(f"{name}.toml").read_text(encoding="utf-8")


def library_listing() -> list[tuple[str, str]]:
    """Return the name and a description of each robot in the library."""
    import tomllib

    files = ((name, tomllib.loads(library_file(name))) for name in library_names())
    return [(name, _summary(file)) for name, file in files]


def _summary(file: dict[str, object]) -> str:
    joints = file["joints"]
    assert isinstance(joints, list)
    weighed = all("mass_kg" in joint for joint in joints)
    return f"{file['name']}: {len(joints)} joints, {'with' if weighed else 'no'} masses"


def _folder() -> Traversable:
    return resources.files(__package__).joinpath("robots")
