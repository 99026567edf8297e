"""The robot as its maker describes it, in SI, with a short description in mm and degrees for people."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any, Self

import numpy as np

from calflow.files.problems import nearest, refuse
from calflow.files.toml import checked
from calflow.files.words import plural
from calflow.files.writing import write_text
from calflow.robot.formats import robot_file, urdf
from calflow.robot.frames import Frame, Place, Step, convention_of
from calflow.robot.parts import Expected, Joint, RobotParts, link_names, parent_links


@dataclass(frozen=True, repr=False)
class Robot(RobotParts):
    """A robot of joints on links: a chain, or a tree with several arms, possibly with one four-bar loop.

    Joint i, from 1, moves link i and is carried by link i - 1 unless it names its parent; link 0 is the base, the last
    one the flange. gravity [m/s²]: in the frame of link `ground`, which stands on the floor; if the chain begins at a
    work piece, the joints up to that link carry the piece (a turntable), and later ones are the arm's. Payloads and
    markers are in the flange's frame, or that of the link they name; tool_rotation [rad, about x, y and z in turn]:
    from the flange to the frame whose orientation is measured; expected: stated priors of its parameters. Robots are
    equal if all their fields are, including the order of payloads and markers.

    Raises:
        InputError: with all invalid values.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        n_joints = len(self.joints) if isinstance(self.joints, tuple) else 0
        links = link_names(getattr(joint, "link", "") for joint in self.joints) if n_joints else ()
        parts = checked(self, RobotParts, f"robot '{self.name}'", {"n_joints": n_joints, "links": links})
        for name, value in vars(parts).items():
            object.__setattr__(self, name, value)

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        """The hash, computed once since caches are keyed by the robot."""
        return hash(tuple(getattr(self, field.name) for field in dataclasses.fields(self)))

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields alone for pickling: cached values such as the hash are valid in one process only."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a robot file.

        Raises:
            InputError: with all its problems.
        """
        return cls(**robot_file.read_robot(Path(path)))

    @classmethod
    def from_urdf(cls, path: str | Path, tip: urdf.Tips = None, base_link: str | None = None, **stated: Any) -> Self:
        """Read the chain from a base link to a tip link of a URDF; stated: fields of the robot to replace or add.

        base_link is by default the root, tip the only leaf of the tree; with several tips the robot is a tree. The tip
        is the flange, with a marker of its name unless others are stated. Masses and centres of links are the file's.

        Raises:
            InputError: with all problems of the file.
        """
        return cls(**(urdf.read_urdf(Path(path), tip, base_link) | stated))

    def to_toml(self, path: str | Path) -> None:
        """Write a robot file that reads back equal; frames without a convention are stated by their steps."""
        write_text(Path(path), self.toml_text())

    def toml_text(self) -> str:
        """Return what `to_toml` writes."""
        return robot_file.RobotFile.of(self).text

    @cached_property
    def expectations(self) -> Mapping[str | tuple[str, str, str, str], Expected]:
        """The stated priors of its parameters, by name or identity; a later statement replaces an earlier one."""
        return {expected.key: expected for expected in self.expected}

    def canonical(self) -> str:
        """Return all fields as canonical JSON, identical for equal robots."""
        return json.dumps(_canonical(self))

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @cached_property
    def links(self) -> tuple[str, ...]:
        """The links' names, the base first; joint i, from 1, moves link i."""
        return link_names(joint.link for joint in self.joints)

    def link(self, name: str) -> int:
        """Return the number of a link by name; without a name the last one, the flange.

        Raises:
            InputError: there is no such link.
        """
        if not name:
            return self.n_joints
        if name not in self.links:
            raise refuse(f"there is no link '{name}'{nearest(name, self.links)}; there are {', '.join(self.links)}")
        return self.links.index(name)

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """The number of each joint's parent link."""
        return parent_links(self.joints)

    def on(self, link: int) -> list[int]:
        """Return the joints (from 0) that a link carries."""
        return [i for i, parent in enumerate(self.parents) if parent == link]

    def next_joint(self, link: int) -> int | None:
        """Return the only joint (from 0) on a link, where the link ends; None for the base, and for none or several."""
        on = self.on(link) if link else []
        return on[0] if len(on) == 1 else None

    def chain(self, link: int) -> list[int]:
        """Return the joints (from 0) from the base to a link, in order."""
        return [*self.chain(self.parents[link - 1]), link - 1] if link else []

    @cached_property
    def carried(self) -> tuple[tuple[int, ...], ...]:
        """The joints (from 0) that each joint moves: itself and those beyond it."""
        chains = [self.chain(link) for link in range(1, self.n_joints + 1)]
        return tuple(tuple(k for k, chain in enumerate(chains) if i in chain) for i in range(self.n_joints))

    @property
    def tips(self) -> list[int]:
        """The numbers of links that carry no joint."""
        return [link for link in range(1, self.n_joints + 1) if not self.on(link)]

    @cached_property
    def marker_links(self) -> tuple[int, ...]:
        """The number of each marker's link."""
        return tuple(self.link(marker.on) for marker in self.markers.values())

    @cached_property
    def payload_links(self) -> tuple[int, ...]:
        """The number of each payload's link."""
        return tuple(self.link(payload.on) for payload in self.payloads.values())

    @cached_property
    def unweighed(self) -> dict[str, int]:
        """The payloads of unknown mass by name, with their indices among all payloads."""
        return {name: k for k, (name, load) in enumerate(self.payloads.items()) if load.mass is None}

    @cached_property
    def tools(self) -> tuple[int, ...]:
        """The numbers of tips that carry markers or payloads."""
        return tuple(link for link in self.tips if link in (*self.marker_links, *self.payload_links))

    @cached_property
    def places(self) -> tuple[Place, ...]:
        """Each joint's place in its chain.

        The first is on the base, or on a link that carries another joint already; the last has no joint on its link.
        """
        places = list[Place]()
        for i, parent in enumerate(self.parents):
            first, last = not parent or self.on(parent)[0] != i, not self.on(i + 1)
            places.append("alone" if first and last else "first" if first else "last" if last else "middle")
        return tuple(places)

    @property
    def frames(self) -> tuple[Frame, ...]:
        """Each joint's frame."""
        return tuple(joint.frame for joint in self.joints)

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps of all frames, joint by joint."""
        return tuple(step for frame in self.frames for step in frame.steps)

    def step_index(self, joint: int, symbol: str) -> int:
        """Return the index among all steps of a joint's step (from 0) by its symbol."""
        return self._step_indices[joint, symbol]

    @cached_property
    def _step_indices(self) -> dict[tuple[int, str], int]:
        keys = ((i, step.symbol) for i, frame in enumerate(self.frames) for step in frame.steps)
        return {key: k for k, key in enumerate(keys)}

    @cached_property
    def kinematics(self) -> str:
        """The convention of its frames, or `frames of its own`."""
        return convention_of(self.frames) or "frames of its own"

    @property
    def has_masses(self) -> bool:
        """Whether the masses of links and payloads are known, so that gravity torques can be computed."""
        masses = [*(joint.mass for joint in self.joints), *(load.mass for load in self.payloads.values())]
        return None not in masses

    @property
    def down(self) -> np.ndarray:
        """Unit vector of gravity in the frame of link `ground`, shape (3,); zero without gravity."""
        size = np.linalg.norm(self.gravity)
        return np.array(self.gravity) / size if size else np.zeros(3)

    @property
    def limits(self) -> np.ndarray:
        """Joint limits, shape (n_joints, 2) [rad, or m]; if not stated, the full turn within which poses are drawn."""
        return np.array([joint.range for joint in self.joints])

    @property
    def stops(self) -> np.ndarray:
        """Joint stops, shape (n_joints, 2) [rad, or m]: infinite for a revolute joint without stated limits."""
        endless = [joint.limits is None and joint.kind == "revolute" for joint in self.joints]
        return np.where(np.array(endless)[:, None], [-np.inf, np.inf], self.limits)

    @property
    def reading_matrix(self) -> np.ndarray:
        """Matrix C with q = C · reading: signs and linear couplings, shape (n_joints, n_joints)."""
        matrix = np.diag([float(joint.sign) for joint in self.joints])
        for coupling in self.couplings:
            matrix[coupling.joint - 1, coupling.source - 1] += coupling.factor
        return matrix

    @property
    def driven(self) -> list[int]:
        """The joints (from 0) with a reading."""
        return [i for i, joint in enumerate(self.joints) if joint.driven]

    @property
    def followers(self) -> list[int]:
        """The joints (from 0) without a reading, which only others move."""
        return [i for i, joint in enumerate(self.joints) if not joint.driven]

    @property
    def external(self) -> list[int]:
        """The external axes (joints from 0), which no correction moves."""
        return [i for i, joint in enumerate(self.joints) if joint.external is not None]

    @property
    def arm(self) -> list[int]:
        """The driven joints (from 0) except external axes."""
        return [i for i in self.driven if self.joints[i].external is None]

    @property
    def is_one_arm(self) -> bool:
        """Whether the joints of the arm lie on one chain."""
        return any(set(self.arm) <= set(self.chain(tip)) for tip in self.tips)

    @cached_property
    def angle_matrix(self) -> np.ndarray:
        """Matrix with reading = matrix · q, shape (n_joints, n_joints); for a follower row and column are zero."""
        driven = np.ix_(self.driven, self.driven)
        matrix = np.zeros((self.n_joints, self.n_joints))
        matrix[driven] = np.linalg.inv(self.reading_matrix[driven])
        return matrix

    @cached_property
    def carried_on(self) -> np.ndarray:
        """Matrix by which errors of joints move all of them, (n_joints, n_joints): a follower goes where its drives really are."""
        matrix = np.eye(self.n_joints)
        matrix[self.followers] += self.reading_matrix[self.followers] @ self.angle_matrix
        return matrix

    def past_limits(self, q: np.ndarray, by: float = 0.0) -> np.ndarray:
        """Return which joint angles (n, n_joints) [rad, or m] are past the joint's limits by more than a tolerance, or nan."""
        low, high = self.stops.T
        return np.asarray(~((q >= low - by) & (q <= high + by)))

    def within_limits(self, q: np.ndarray, by: float = 0.0) -> np.ndarray:
        """Return at which joint angles (n, n_joints) [rad, or m] no joint is past its limits, shape (n,)."""
        return np.asarray(~self.past_limits(q, by).any(axis=1))

    def __repr__(self) -> str:
        return _text(self)

    def _repr_html_(self) -> str:
        return _html(self)


def _canonical(value: Any) -> Any:
    """Return a value for canonical JSON, with numbers as floats, so that 1 and 1.0 are the same."""
    if dataclasses.is_dataclass(value):
        return {member.name: _canonical(getattr(value, member.name)) for member in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return [[name, _canonical(thing)] for name, thing in value.items()]
    if isinstance(value, tuple):
        return [_canonical(member) for member in value]
    return value + 0.0 if isinstance(value, int | float) and not isinstance(value, bool) else value


Rows = list[tuple[str, ...]]


def _text(robot: Robot) -> str:
    """Return a robot as plain text."""
    table = _table(robot.joints)
    widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in table]
    return "\n".join((_title(robot), *(f"  {line}" for line in lines), *_tool(robot)))


def _html(robot: Robot) -> str:
    """Return a robot as a small HTML table."""
    head, *body = _table(robot.joints)
    rows = [_row("th", head), *(_row("td", row) for row in body)]
    below = "".join(f"<br>{escape(line)}" for line in _tool(robot))
    return f"<b>{escape(_title(robot))}</b><table>{''.join(rows)}</table>{below.removeprefix('<br>')}"


def _title(robot: Robot) -> str:
    return f"Robot '{robot.name}': {plural(robot.n_joints, 'joint')}, {robot.kinematics}"


def _tool(robot: Robot) -> list[str]:
    masses = ("of unknown mass" if load.mass is None else f"{load.mass:g} kg" for load in robot.payloads.values())
    loads = ", ".join(f"{name} {mass}" for name, mass in zip(robot.payloads, masses, strict=True)) or "none"
    places = (
        f"{name} ({', '.join(_figure(1e3 * v) for v in marker.point)}) mm{f' on {marker.on}' if marker.on else ''}"
        for name, marker in robot.markers.items()
    )
    return [f"payloads: {loads}", f"markers: {', '.join(places)}"]


def _table(joints: Sequence[Joint]) -> Rows:
    """Return a header and a row per joint; the frames' values have columns if all joints have the same symbols."""
    frames = [joint.frame for joint in joints]
    if convention_of(frames):
        listed = frames[0].listed
        columns = [f"{step.symbol} [{step.shown[0]}]" for symbol in listed for step in [frames[0].step(symbol)]]
        figures = [tuple(_figure(frame.step(symbol).shown[1]) for symbol in listed) for frame in frames]
    else:
        columns = ["frame"]
        figures = [
            (", ".join(f"{s.symbol} {_figure(s.shown[1])} {s.shown[0]}" for s in frame.steps if s.value) or "–",)
            for frame in frames
        ]
    rows: Rows = [("joint", *columns, "limits")]
    for i, (joint, cells) in enumerate(zip(joints, figures, strict=True)):
        unit, factor = joint.shown
        limits = " … ".join(_figure(factor * limit) for limit in joint.limits) if joint.limits else "–"
        words = (str(i + 1), joint.name, f"on {joint.parent}" if joint.parent else "")
        rows.append((" ".join(filter(None, words)), *cells, f"{limits} {unit}" if joint.limits else limits))
    return rows


def _row(tag: str, cells: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"


def _figure(value: float) -> str:
    return f"{round(value, 4) + 0.0:.10g}"
