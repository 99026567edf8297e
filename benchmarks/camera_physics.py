"""Robots before cameras in numpy that calflow had no part in: DH trees, pinholes with distortion, boards. SI units, px.

Three are there: a UR5e that holds the camera, a Panda that holds the board before one, and two arms that hold a board each before
a camera on a head that pans and tilts. A cause acts on the joints' readings, or on the camera.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from calflow.templates import library_file
from observations.photographed import (
    BESIDE,
    HALF,
    IN_GRIPPER,
    IN_HAND,
    ON_TABLE,
    PANDA,
    SIZE,
    UR5E,
    Optics,
    board,
    frame,
)

Array = np.ndarray
GRAVITY = np.array([0.0, 0.0, -9.80665])
DH = ("alpha", "a", "theta", "d")
LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
TRIED, STEPS, MET = 400, 60, 1e-6  # poses that are looked for at once; steps of each; m and rad
STEP = 1e-6  # of differences
SHARED = 1e-6  # of the largest singular value: what moves no image


@dataclass(frozen=True)
class Tree:
    """DH figures (n, 4) alpha, a, theta, d, what each joint is on (0: base, i: joint i's link), how it stands there (n, 4, 4)."""

    figures: Array
    modified: bool
    limits: Array
    parent: tuple[int, ...]
    mount: Array
    mass: Array
    com: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.figures)

    def chain(self, link: int) -> list[int]:
        """The joints (from 0) that move a link, the first one first."""
        return [*self.chain(self.parent[link - 1]), link - 1] if link else []

    def links(self, q: Array) -> list[Array]:
        """The frames of the base and of each joint's link, (rows, 4, 4) each."""
        found = [np.tile(np.eye(4), (len(q), 1, 1))]
        for k, ((alpha, a, theta, d), angle) in enumerate(zip(self.figures, q.T, strict=True)):
            fixed = frame(Rotation.from_euler("x", alpha), (a, 0, 0))
            about = np.tile(np.eye(4), (len(q), 1, 1))
            about[:, :3, :3] = Rotation.from_euler("z", (angle + theta)[:, None]).as_matrix()
            about[:, 2, 3] = d
            moved = fixed @ about if self.modified else about @ fixed
            found.append(found[self.parent[k]] @ self.mount[k] @ moved)
        return found

    def torque(self, joint: int, q: Array) -> Array:
        """The torque of the arm's weight about a joint (from 0), (rows,) [Nm]."""
        links = self.links(q)
        axis = links[joint + 1] if self.modified else links[self.parent[joint]] @ self.mount[joint]
        moment = np.zeros((len(q), 3))
        for link in range(1, self.n + 1):
            if joint in self.chain(link):
                centre = links[link][:, :3, :3] @ self.com[link - 1] + links[link][:, :3, 3]
                moment += np.cross(centre - axis[:, :3, 3], self.mass[link - 1] * GRAVITY)
        return np.asarray((moment * axis[:, :3, 2]).sum(axis=1))

    def worn(self, rng: np.random.Generator, turn: float = 1e-3, shift: float = 5e-4) -> Tree:
        """The tree as built, with errors of all its figures, and of how what branches off stands."""
        mount = self.mount.copy()
        for k in self.branching:
            mount[k] = mount[k] @ frame(Rotation.from_rotvec(turn * rng.normal(size=3)), shift * rng.normal(size=3))
        return replace(
            self, figures=self.figures + rng.normal(size=(self.n, 4)) * [turn, shift, turn, shift], mount=mount
        )

    @property
    def branching(self) -> list[int]:
        """Joints (from 0) on a link that another one is on already."""
        return [k for k in range(self.n) if self.parent[k] in self.parent[:k]]


@dataclass(frozen=True)
class View:
    """A camera and a board by the links that they are on (0: the world), where each is there, and how far they are apart [m]."""

    name: str
    camera_on: int
    target_on: int
    camera: Array
    target: Array
    far: tuple[float, float]


@dataclass(frozen=True)
class Cell:
    """A robot before its cameras; hands are the links that carry tools, by name, loaded the joints (from 1) that gravity turns."""

    name: str
    robot: Tree
    views: tuple[View, ...]
    hands: dict[str, int]
    loaded: tuple[int, ...]
    lens: Optics = field(default_factory=Optics)


@dataclass(frozen=True)
class Rows:
    """What was done: readings (poses, n), from which side each joint came (poses, n), and which view each pose is of (poses,)."""

    q: Array
    side: Array
    view: Array

    def __len__(self) -> int:
        return len(self.q)


def images(cell: Cell, rows: Rows, moved: Array | None = None, slip: Array | None = None) -> Array:
    """Where the board's points are shown (poses, points, 2); moved joints (poses, n) beside their readings, slip of the camera."""
    points = board()
    links, found = cell.robot.links(rows.q if moved is None else rows.q + moved), np.zeros((len(rows), len(points), 2))
    slip = np.tile(np.eye(4), (len(rows), 1, 1)) if slip is None else slip
    for k, view in enumerate(cell.views):
        own = rows.view == k
        seen = (
            np.linalg.inv(links[view.camera_on][own] @ view.camera @ slip[own])
            @ links[view.target_on][own]
            @ view.target
        )
        there = np.einsum("nij,kj->nki", seen[:, :3, :3], points) + seen[:, None, :3, 3]
        found[own] = cell.lens.image(there.reshape(-1, 3)).reshape(*there.shape[:2], 2)
    return found


def poses(
    cell: Cell, number: int, rng: np.random.Generator, tilt: float = 40.0, aside: float = 0.12, near: float = np.inf
) -> Rows:
    """Poses at which the whole board is shown, views in turn; joints at most near [rad] from where the first of a view has them."""
    found = [_posed(cell, view, -(-number // len(cell.views)), rng, tilt, aside, near) for view in cell.views]
    q = np.stack(found, axis=1).reshape(-1, cell.robot.n)[:number]
    return Rows(np.round(q, 7), rng.choice([-1.0, 1.0], q.shape), np.arange(number) % len(cell.views))


def _posed(
    cell: Cell, view: View, number: int, rng: np.random.Generator, tilt: float, aside: float, near: float
) -> Array:
    robot, points = cell.robot, board()
    middle, only = points.mean(axis=0), replace(cell, views=(view,))
    hand = view.target_on or view.camera_on
    chain, found, first = robot.chain(hand), np.empty((0, robot.n)), None
    low, high = robot.limits.T
    while len(found) < number:
        if first is not None and np.isfinite(near):
            q = first + rng.uniform(-near, near, (TRIED, robot.n))
        else:
            turn = Rotation.from_euler("z", rng.uniform(-180, 180, (TRIED, 1)), degrees=True)
            turn *= Rotation.from_euler("x", 180 + rng.uniform(-tilt, tilt, (TRIED, 1)), degrees=True)
            turn *= Rotation.from_euler("y", rng.uniform(-tilt, tilt, (TRIED, 1)), degrees=True)
            far = rng.uniform(*view.far, TRIED)
            seen = np.tile(np.eye(4), (TRIED, 1, 1))
            seen[:, :3, :3] = turn.as_matrix()
            across = rng.uniform(-aside, aside, (TRIED, 2)) * far[:, None]
            seen[:, :3, 3] = np.column_stack([across, far]) - turn.apply(middle)
            q = rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low), (TRIED, robot.n))
            wanted = (
                robot.links(q)[view.camera_on] @ view.camera @ seen @ np.linalg.inv(view.target)
                if view.target_on
                else view.target @ np.linalg.inv(seen) @ np.linalg.inv(view.camera)
            )
            q, met = _brought(robot, q, chain, hand, wanted)
            q = q[met]
        q = q[((q > low) & (q < high)).all(axis=1)]
        shown = images(only, Rows(q, q, np.zeros(len(q), int)))
        q = q[((shown > 0) & (shown < SIZE)).all(axis=(1, 2))]
        if first is None and len(q):
            first = q[0]
            q = q[:1] if np.isfinite(near) else q
        found = np.concatenate([found, q])
    return found[:number]


def _brought(robot: Tree, q: Array, chain: list[int], hand: int, wanted: Array) -> tuple[Array, Array]:
    """Readings at which a link's frame is as wanted, by Gauss and Newton along its chain, and where that was met."""

    def off(readings: Array) -> Array:
        there = robot.links(readings)[hand]
        turn = Rotation.from_matrix(wanted[:, :3, :3] @ there[:, :3, :3].transpose(0, 2, 1)).as_rotvec()
        return np.concatenate([wanted[:, :3, 3] - there[:, :3, 3], turn], axis=1)

    for _ in range(STEPS):
        left = off(q)
        slope = np.stack([(left - off(q + STEP * np.eye(robot.n)[k])) / STEP for k in chain], axis=2)
        damped = slope @ slope.transpose(0, 2, 1) + 1e-6 * np.eye(6)
        step = np.einsum("nij,ni->nj", slope, np.linalg.solve(damped, left[:, :, None])[:, :, 0])
        q = q.copy()
        q[:, chain] += np.clip(step, -0.4, 0.4)
    return q, np.abs(off(q)).max(axis=1) < MET


@dataclass(frozen=True)
class Figure:
    """A figure of a cell: its kind (`dh`, `mount`, `lens`, `camera`, `target`, `beta`), of which joint or view, its place in it."""

    kind: str
    of: int
    at: int


def figures(cell: Cell) -> list[Figure]:
    """All figures that a calibration by images might find."""
    parallel = np.flatnonzero(np.abs(np.sin(cell.robot.figures[:, 0])) < 0.1)
    found = [Figure("dh", i, k) for i in range(cell.robot.n) for k in range(4)]
    found += [Figure("beta", int(i), 0) for i in parallel]
    found += [Figure("mount", i, k) for i in cell.robot.branching for k in range(6)]
    found += [Figure(kind, v, k) for v in range(len(cell.views)) for kind in ("camera", "target") for k in range(6)]
    return found + [Figure("lens", 0, k) for k in range(9)]


def off_by(cell: Cell, figure: Figure, by: float) -> Cell:
    """The cell with one figure that much off; places in their own frame, about x, y and z."""
    six = by * np.eye(6)[figure.at] if figure.kind in ("mount", "camera", "target") else np.zeros(6)
    small, robot = frame(Rotation.from_rotvec(six[3:]), six[:3]), cell.robot
    if figure.kind == "dh":
        changed = robot.figures.copy()
        changed[figure.of, figure.at] += by
        return replace(cell, robot=replace(robot, figures=changed))
    if figure.kind in ("mount", "beta"):
        # a turn about y at a joint's end is one at the next joint's mount, or at what the link carries
        mount = robot.mount.copy()
        turned = frame(Rotation.from_rotvec((0, by, 0))) if figure.kind == "beta" else small
        for k in range(robot.n):
            if figure.kind == "mount" and k == figure.of:
                mount[k] = mount[k] @ turned
            if figure.kind == "beta" and robot.parent[k] == figure.of + 1:
                mount[k] = turned @ mount[k]
        return replace(cell, robot=replace(robot, mount=mount))
    if figure.kind == "lens":
        whole = np.array([*cell.lens.focal, *cell.lens.centre, *cell.lens.bend]) + by * np.eye(9)[figure.at]
        return replace(cell, lens=Optics(tuple(whole[:2]), tuple(whole[2:4]), tuple(whole[4:])))
    views = list(cell.views)
    place = getattr(views[figure.of], figure.kind) @ small
    views[figure.of] = replace(views[figure.of], **{figure.kind: place})
    return replace(cell, views=tuple(views))


def slopes(cell: Cell, rows: Rows) -> Array:
    """Derivatives (2 · points, figures) of all images by all figures, by differences."""
    here = images(cell, rows).ravel()
    return np.stack([(images(off_by(cell, one, STEP), rows).ravel() - here) / STEP for one in figures(cell)], axis=1)


def told_alone(slope: Array) -> Array:
    """Which figures no others can stand for, to first order, (figures,)."""
    scaled = slope / np.maximum(np.linalg.norm(slope, axis=0), 1e-12)
    _, singular, ways = np.linalg.svd(scaled, full_matrices=False)
    free = ways[singular < SHARED * singular[0]]
    return np.asarray((np.abs(free) < 1e-3).all(axis=0) & (np.linalg.norm(slope, axis=0) > 0))


def stands_out(shift: Array, slope: Array, sigma: float) -> float:
    """How many sd a shift of all images stands out beside what all figures can imitate."""
    scaled = slope / np.maximum(np.linalg.norm(slope, axis=0), 1e-12)
    left = shift.ravel() - scaled @ np.linalg.lstsq(scaled, shift.ravel(), rcond=1e-8)[0]
    return float(np.linalg.norm(left) / sigma)


def untaught(off: Array, points: Array, turned: Array) -> Array:
    """Errors (n, 3) of tool points without what teaching a base (6) and a tool's point (3) takes off."""
    x, y, z = (points - points.mean(axis=0)).T
    zero = np.zeros(len(x))
    by_turn = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)
    moves = np.concatenate([np.tile(np.eye(3), (len(x), 1, 1)), by_turn, turned], axis=2).reshape(-1, 9)
    return np.asarray((off.ravel() - moves @ np.linalg.lstsq(moves, off.ravel(), rcond=None)[0]).reshape(-1, 3))


def _tree(robot: object, library: str) -> Tree:
    joints = tomllib.loads(library_file(library))["joints"]
    n = len(joints)
    return Tree(robot.figures, robot.modified, robot.limits, tuple(range(n)), np.tile(np.eye(4), (n, 1, 1)),
                np.array([one["mass_kg"] for one in joints]),
                1e-3 * np.array([one["com_mm"] for one in joints], dtype=float))  # fmt: skip


def _beside(arm: Tree) -> Tree:
    """Two arms, and a head that pans and tilts, on one foot."""
    n = arm.n
    mount = np.tile(np.eye(4), (2 * n + 2, 1, 1))
    mount[n] = frame(None, (0, -0.9, 0))
    mount[2 * n] = frame(None, (-0.3, -0.45, 0.6))
    head = np.array([[-HALF, 0, 0, 0.1], [0, 0.05, 0, 0]])
    return Tree(
        np.concatenate([arm.figures, arm.figures, head]), False,
        np.concatenate([arm.limits, arm.limits, [[-0.6, 0.6], [-0.5, 0.5]]]),
        (*range(n), 0, *range(n + 1, 2 * n), 0, 2 * n + 1), mount, np.concatenate([arm.mass, arm.mass, [1.2, 0.8]]),
        np.concatenate([arm.com, arm.com, [[0, 0, 0.02], [0.03, 0, 0]]]),
    )  # fmt: skip


UR, PA = _tree(UR5E, "ur5e"), _tree(PANDA, "franka-panda")
ON_HEAD = frame(
    Rotation.from_matrix([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]) * Rotation.from_rotvec((0.02, -0.03, 0.04)),
    (0.04, 0.02, 0.03),
)
CELLS: dict[str, Cell] = {
    cell.name: cell
    for cell in (
        Cell("ur5e", UR, (View("", 6, 0, IN_HAND, ON_TABLE, (0.3, 0.6)),), {"tool": 6}, (2, 3)),
        Cell("panda", PA, (View("", 0, 7, BESIDE, IN_GRIPPER, (0.6, 1.0)),), {"tool": 7}, (2, 4)),
        Cell("two-arms", _beside(UR), (View("left", 14, 6, ON_HEAD, IN_GRIPPER, (0.5, 0.8)),
             View("right", 14, 12, ON_HEAD, IN_GRIPPER, (0.5, 0.8))), {"left": 6, "right": 12}, (2, 3, 8, 9)),
    )
}  # fmt: skip


def hand_points(
    cell: Cell, q: Array, hand: int, point: Sequence[float], moved: Array | None = None
) -> tuple[Array, Array]:
    """Where a hand's tool point is (n, 3), and how the hand is turned (n, 3, 3)."""
    there = cell.robot.links(q if moved is None else q + moved)[hand]
    return there[:, :3, :3] @ np.asarray(point) + there[:, :3, 3], there[:, :3, :3]
