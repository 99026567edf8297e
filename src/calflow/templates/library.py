"""The library: robot files of arms that people have, each with the source of its figures in its notes."""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable

from calflow.files.problems import nearest, refuse


def names() -> list[str]:
    """Return the names of the robots in the library."""
    return sorted(file.name.removesuffix(".toml") for file in _folder().iterdir() if file.name.endswith(".toml"))


def text(name: str) -> str:
    """Return a robot's file.

    Raises:
        InputError: there is no robot of this name.
    """
    if name not in names():
        raise refuse(
            f"there is no robot '{name}' in the library{nearest(name, names())}; there are {', '.join(names())}"
        )
    return _folder().joinpath(f"{name}.toml").read_text(encoding="utf-8")


def listing() -> list[tuple[str, str]]:
    """Return each robot's name in the library and what it is."""
    import tomllib

    files = ((name, tomllib.loads(text(name))) for name in names())
    return [(name, _said(file)) for name, file in files]


def _said(file: dict[str, object]) -> str:
    joints = file["joints"]
    assert isinstance(joints, list)
    weighed = all("mass_kg" in joint for joint in joints)
    return f"{file['name']}: {len(joints)} joints, {'with' if weighed else 'no'} masses"


def _folder() -> Traversable:
    return resources.files(__package__).joinpath("robots")
