"""Arms in numpy that calflow had no part in: modified DH, weights, and whatever gives way until it carries them. SI units.

A row is a pose as one marker shows it. Loads are kept as the mass and the first moment of all that lies beyond a place, so that
a form of a cause may take moments about any point that it likes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial.transform import Rotation

Array = np.ndarray
GRAVITY = np.array([0.0, 0.0, -9.80665])
PAYLOADS = ("empty", "half", "full")
STILL = 1e-13  # m: nothing moves farther in a round of the equilibrium
ROUNDS = 60
LEAST_TRAVEL, MOST_TRAVEL, OVERSHOOT = (
    0.01,
    0.6,
    0.4,
)  # rad (a slide's in units of its range), since a joint last turned back


@dataclass(frozen=True)
class Arm:
    """An arm: Rx(alpha) Tx(a) Ry(beta) Rz(theta + q) Tz(d), a slide's q in Tz; lengths may be (rows, n) instead of (n,).

    loaded are joints (from 1) that gravity turns, long the links that bend, tilting the joints whose bearings are loaded across.
    region is a box of the base frame that the tool is measured in. Of payloads each has a mass and a centre; (rows,) and
    (rows, 3) where they differ from row to row.
    """

    name: str
    alpha: Array
    a: Array
    d: Array
    theta: Array
    beta: Array
    slide: Array
    limits: Array
    gear: Array
    mass: Array
    com: Array
    compliance: Array
    payload_mass: Array
    payload_com: Array
    markers: Array
    base: Rotation
    origin: Array
    region: Array
    loaded: tuple[int, ...]
    long: tuple[int, ...]
    tilting: tuple[int, ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.slide)

    @property
    def span(self) -> Array:
        """What is 1 rad of a joint, or half a slide's range (n,)."""
        return np.where(self.slide, 0.5 * np.ptp(self.limits, axis=1), 1.0)


@dataclass(frozen=True)
class Rows:
    """What was done: q, side, travel (rows, n), way (rows, 3, n): where a joint began, turned back and ended; the rest (rows,)."""

    q: Array
    payload: Array
    marker: Array
    pose: Array
    side: Array
    travel: Array
    way: Array
    time: Array
    temperature: Array
    session: Array

    def __len__(self) -> int:
        return len(self.q)

    def only(self, which: Array) -> Rows:
        """Some rows."""
        return Rows(*(getattr(self, field.name)[which] for field in fields(self)))


@dataclass(frozen=True)
class Yielding:
    """What gives way: joints (rows, n); shift and turn of bearings and links' ends (rows, n, 6), base and tool (rows, 6)."""

    joint: Array
    bearing: Array
    tip: Array
    base: Array
    tool: Array

    @staticmethod
    def none(rows: int, n: int) -> Yielding:
        """Nothing gives way."""
        return Yielding(*(np.zeros((rows, *shape)) for shape in ((n,), (n, 6), (n, 6), (6,), (6,))))

    def __add__(self, other: Yielding) -> Yielding:
        return Yielding(*(mine + its for mine, its in zip(vars(self).values(), vars(other).values(), strict=True)))


@dataclass(frozen=True)
class Frame:
    """Frames of all rows in the base frame: turn (rows, 3, 3) and place (rows, 3)."""

    turn: Array
    place: Array

    def then(self, turn: Array, place: Array) -> Frame:
        """A frame that is at a place of this one, and turned."""
        return Frame(self.turn @ turn, self.place + np.einsum("nij,nj->ni", self.turn, place))

    def given(self, twist: Array) -> Frame:
        """The frame shifted and turned in its own axes, twist (rows, 6)."""
        return self.then(Rotation.from_rotvec(twist[:, 3:]).as_matrix(), twist[:, :3])

    def at(self, point: Array) -> Array:
        """Points (3,) or (rows, 3) of this frame."""
        return self.place + np.einsum("nij,nj->ni", self.turn, np.broadcast_to(point, self.place.shape))

    def into(self, vector: Array) -> Array:
        """Vectors (rows, 3) of the base frame in this one's axes."""
        return np.einsum("nji,nj->ni", self.turn, vector)


@dataclass(frozen=True)
class State:
    """An arm that carries its weights: frames at joints (before their bearings give way), of links and at links' ends.

    mass (rows, n + 1) and first (rows, n + 1, 3) are those of all beyond joint i, link i included; the last one the payload's.
    """

    joints: tuple[Frame, ...]
    links: tuple[Frame, ...]
    tips: tuple[Frame, ...]
    mass: Array
    first: Array

    def moment(self, i: int, point: Array) -> Array:
        """Moment (rows, 3) in the base frame about points of what lies beyond joint i (from 0) [Nm]."""
        return np.cross(self.first[:, i] - self.mass[:, i, None] * point, GRAVITY)

    def torque(self, i: int) -> Array:
        """Torque about joint i (rows,) [Nm]."""
        joint = self.joints[i]
        return (self.moment(i, joint.place) * joint.turn[:, :, 2]).sum(axis=1)

    def force(self, i: int) -> Array:
        """Force along a slide i (rows,) [N]."""
        return self.mass[:, i] * (self.joints[i].turn[:, :, 2] @ GRAVITY)


Response = Callable[[Arm, Rows, State], Yielding]


def turned(axis: int, angle: Array) -> Array:
    """Rotations (rows, 3, 3) about x, y or z."""
    return Rotation.from_rotvec(np.asarray(angle)[:, None] * np.eye(3)[axis]).as_matrix()


def state(arm: Arm, rows: Rows, yielding: Yielding) -> State:
    """The arm where it has given way."""
    count, zero = len(rows), np.zeros((len(rows), 3))
    figures = (arm.alpha, arm.a, arm.d, arm.theta, arm.beta)
    alpha, a, d, theta, beta = (np.broadcast_to(figure, (count, arm.n)) for figure in figures)
    joints, links, tips = [], [], []
    at = (
        Frame(np.broadcast_to(np.eye(3), (count, 3, 3)), zero)
        .given(yielding.base)
        .then(np.eye(3)[None], _along(0, a[:, 0]))
    )
    moved = rows.q + yielding.joint
    for i in range(arm.n):
        angle, slid = (0.0 * moved[:, i], moved[:, i]) if arm.slide[i] else (moved[:, i], 0.0)
        joint = (
            at.then(turned(0, alpha[:, i]), zero)
            .then(turned(1, beta[:, i]), zero)
            .then(turned(2, theta[:, i] + angle), zero)
        )
        link = joint.given(yielding.bearing[:, i]).then(np.eye(3)[None], _along(2, d[:, i] + slid))
        far = a[:, i + 1] if i + 1 < arm.n else np.zeros(count)
        at = link.then(np.eye(3)[None], _along(0, far)).given(yielding.tip[:, i])
        for kept, frame in ((joints, joint), (links, link), (tips, at)):
            kept.append(frame)
    mass = np.stack([*np.broadcast_to(arm.mass[:, None], (arm.n, count)), of_row(arm.payload_mass, rows, 1)], axis=1)
    centres = [link.at(com) for link, com in zip(links, arm.com, strict=True)] + [
        at.at(of_row(arm.payload_com, rows, 2))
    ]
    first = mass[..., None] * np.stack(centres, axis=1)
    mass, first = (np.cumsum(part[:, ::-1], axis=1)[:, ::-1] for part in (mass, first))
    return State(tuple(joints), tuple(links), tuple(tips), mass, first)


def of_row(figure: Array, rows: Rows, dimensions: int) -> Array:
    """A payload's figure of each row, whether there is one a payload or one a row."""
    return figure if len(figure) == len(rows) and len(rows) != len(PAYLOADS) else figure[rows.payload]


def _along(axis: int, length: Array) -> Array:
    return np.asarray(length)[:, None] * np.eye(3)[axis]


def springs(arm: Arm, rows: Rows, now: State) -> Yielding:
    """Every joint's linear spring."""
    given = Yielding.none(len(rows), arm.n)
    loads = [now.force(i) if arm.slide[i] else now.torque(i) for i in range(arm.n)]
    return replace(given, joint=arm.compliance * np.stack(loads, axis=1))


def points(arm: Arm, rows: Rows, responses: Sequence[Response] = ()) -> Array:
    """Where each row's marker is in the measuring frame (rows, 3), in equilibrium with springs and all other responses."""
    yielding, before = Yielding.none(len(rows), arm.n), np.zeros((len(rows), 3))
    for _ in range(ROUNDS):
        now = state(arm, rows, yielding)
        place = now.tips[-1].given(yielding.tool).at(arm.markers[rows.marker])
        if np.abs(place - before).max() < STILL:
            return arm.base.apply(place) + arm.origin
        before, yielding = place, sum((act(arm, rows, now) for act in responses), springs(arm, rows, now))
    raise RuntimeError(f"{arm.name}: no equilibrium")


def flange(arm: Arm, rows: Rows) -> Frame:
    """The flange of the arm where nothing gives way."""
    return state(arm, rows, Yielding.none(len(rows), arm.n)).tips[-1]


# --- Four arms ---------------------------------------------------------------------------------------


def _arm(
    name: str, joints: Sequence[tuple[float, ...]], load: tuple[float, Sequence[float]], marker: Sequence[float], region: Array,
    loaded: tuple[int, ...], long: tuple[int, ...], tilting: tuple[int, ...], slides: tuple[int, ...] = (),
) -> Arm:  # fmt: skip
    """An arm of joints (alpha [deg], a, d [m], theta [deg], low, high [deg, or m], mass [kg], com x, y, z [m], compliance)."""
    table = np.array(joints, dtype=float)
    slide = np.zeros(len(table), dtype=bool)
    slide[list(slides)] = True
    limits = np.where(slide[:, None], table[:, 4:6], np.deg2rad(table[:, 4:6]))
    return Arm(
        name, np.deg2rad(table[:, 0]), table[:, 1], table[:, 2], np.deg2rad(table[:, 3]), np.zeros(len(table)), slide, limits,
        np.linspace(211.0, 97.0, len(table)).round(1), table[:, 6], table[:, 7:10], table[:, 10], load[0] * np.array([0, 0.5, 1]),
        np.tile(load[1], (3, 1)), np.array(marker) + np.array([[0, 0, 0], [-0.06, -0.22, 0.03], [0.14, -0.16, -0.08]]),
        Rotation.from_euler("xyz", [0.01, -0.004, 2.6]), np.array([2.9, 0.6, -0.9]), region, loaded, long, tilting,
    )  # fmt: skip


LARGE = _arm(
    "large-6",
    [(0, 0, 0.78, 0, -160, 160, 390, 0.08, 0.03, -0.25, 7e-7), (-90, 0.35, 0, -90, -60, 70, 240, 0.52, 0.02, 0.08, 7e-7),
     (0, 1.15, 0, 0, -95, 70, 215, 0.09, -0.06, 0.02, 1.1e-6), (-90, 0.2, 1.17, 0, -180, 180, 80, 0.01, 0.02, -0.38, 3e-6),
     (90, 0, 0, 0, -115, 115, 42, 0, -0.03, 0.01, 4e-6), (-90, 0, 0.21, 180, -180, 180, 11, 0, 0, -0.03, 5e-6)],
    (170.0, (0.08, -0.06, 0.22)), (0.14, 0.1, 0.2), region=np.array([[0.8, -1.7, -0.3], [2.9, 1.7, 2.5]]),
    loaded=(2, 3, 5), long=(2, 4), tilting=(2, 3, 4),
)  # fmt: skip
COBOT = _arm(
    "cobot-6",
    [(0, 0, 0.1807, 0, -170, 170, 7.8, 0, -0.02, -0.03, 2e-5), (90, 0, 0, 0, -175, -5, 12.2, -0.3, 0, 0.16, 2e-5),
     (0, -0.6127, 0, 0, -150, 150, 11.9, -0.28, 0, 0.06, 2.5e-5), (0, -0.5716, 0.1742, 0, -170, 170, 4.3, 0, -0.02, 0.01, 5e-5),
     (90, 0, 0.1199, 0, -150, 150, 4.3, 0, 0.02, 0.01, 5e-5), (-90, 0, 0.1166, 0, -170, 170, 0.4, 0, 0, -0.02, 5e-5)],
    (10.0, (0.02, 0.01, 0.09)), (0.05, 0.04, 0.08), region=np.array([[-1.2, -1.2, -0.1], [1.2, 1.2, 1.3]]),
    loaded=(2, 3, 4), long=(2, 3), tilting=(2, 3, 4),
)  # fmt: skip
SCARA = _arm(
    "scara",
    [(0, 0, 0.42, 0, -140, 140, 19, 0.16, 0.01, -0.03, 0), (0, 0.45, 0, 0, -140, 140, 14, 0.18, -0.01, 0.06, 0),
     (0, 0.4, 0, 0, -0.35, 0.0, 2.2, 0, 0, 0.15, 2e-6), (0, 0, 0.05, 0, -180, 180, 0.8, 0, 0, -0.02, 0)],
    (12.0, (0.04, 0.02, -0.06)), (0.12, 0.08, -0.05), slides=(2,), region=np.array([[-1.0, -1.0, -0.4], [1.0, 1.0, 1.0]]),
    loaded=(), long=(1, 2), tilting=(2,),
)  # fmt: skip
SEVEN = _arm(
    "arm-7",
    [(0, 0, 0.36, 0, -165, 165, 5.3, 0, -0.03, -0.1, 1.5e-5), (-90, 0, 0, 0, -110, 110, 5.1, 0, -0.1, 0.04, 1.5e-5),
     (90, 0, 0.42, 0, -165, 165, 4.2, 0, 0.03, -0.16, 2e-5), (90, 0, 0, 0, -112, 112, 3.6, 0, 0.1, 0.03, 2e-5),
     (-90, 0, 0.4, 0, -165, 165, 2.6, 0, -0.02, -0.17, 3e-5), (-90, 0, 0, 0, -115, 115, 2.1, 0, 0.01, 0.05, 3e-5),
     (90, 0, 0.13, 0, -170, 170, 0.7, 0, 0, -0.02, 4e-5)],
    (13.0, (0.02, 0.01, 0.08)), (0.06, 0.03, 0.12), region=np.array([[-0.9, -0.9, -0.1], [0.9, 0.9, 1.3]]),
    loaded=(2, 4, 6), long=(3, 5), tilting=(2, 3, 4),
)  # fmt: skip
ARMS = {arm.name: arm for arm in (LARGE, COBOT, SCARA, SEVEN)}


def worn(arm: Arm, rng: np.random.Generator) -> Arm:
    """The arm as built: tenths of a millimetre and of a millirad off, its springs by a tenth, base and markers by more."""
    off = {name: getattr(arm, name) + rng.normal(0, 3e-4, arm.n) for name in ("alpha", "a", "d", "theta")}
    parallel = (np.abs(np.sin(arm.alpha)) < 0.1) & (np.arange(arm.n) > 0)
    return replace(
        arm, **off, beta=parallel * rng.normal(0, 3e-4, arm.n), compliance=arm.compliance * rng.normal(1, 0.1, arm.n),
        base=arm.base * Rotation.from_rotvec(rng.normal(0, 2e-3, 3)), origin=arm.origin + rng.normal(0, 2e-3, 3),
        markers=arm.markers + rng.normal(0, 1e-3, (len(arm.markers), 3)),
    )  # fmt: skip


# --- What it does ------------------------------------------------------------------------------------


def measured_rows(
    arm: Arm, poses: int, rng: np.random.Generator, payloads: Sequence[int] = (0, 1, 2), markers: int = 1, box: Array | None = None
) -> Rows:  # fmt: skip
    """Rows at random poses with the tool in the arm's region; box (n, 2) are narrower joint limits to draw within."""
    q = _drawn(arm, poses, rng, arm.limits if box is None else box)
    low, high = arm.limits.T
    side = rng.choice([-1.0, 1.0], q.shape)
    side = np.where(np.where(side > 0, q - low, high - q) < LEAST_TRAVEL * arm.span, -side, side)
    room = np.where(side > 0, q - low, high - q)
    travel = np.minimum(rng.uniform(LEAST_TRAVEL, MOST_TRAVEL, q.shape) * arm.span, room)
    back = q - side * travel
    begun = np.clip(back + side * rng.uniform(0.05, OVERSHOOT, q.shape) * arm.span, low, high)
    time = np.cumsum(rng.uniform(15, 40, poses))
    temperature = (
        21
        + 5 * (1 - np.exp(-time / rng.uniform(1500, 5000)))
        + rng.uniform(0.3, 1) * np.sin(time / 700 + rng.uniform(0, 6))
    )
    each = np.repeat(np.arange(poses), markers)
    rows = Rows(
        q, np.array(payloads)[np.arange(poses) % len(payloads)], np.zeros(poses, int), np.arange(poses), side, travel,
        np.stack([begun, back, q], axis=1), time, np.round(temperature, 2), np.arange(poses) * 3 // poses,
    )  # fmt: skip
    return replace(
        rows.only(each),
        marker=np.tile(np.arange(markers), poses),
        time=time[each] + 3.0 * np.tile(np.arange(markers), poses),
    )


def _drawn(arm: Arm, poses: int, rng: np.random.Generator, box: Array) -> Array:
    found, zeros = np.empty((0, arm.n)), np.zeros(2000, dtype=int)
    low, high = arm.region
    while len(found) < poses:
        q = np.round(rng.uniform(*box.T, (2000, arm.n)), 7)
        none = np.zeros((2000, arm.n))
        tool = flange(arm, Rows(q, zeros, zeros, zeros, none, none, none, none, none, zeros)).place
        found = np.concatenate([found, q[((tool > low) & (tool < high)).all(axis=1)]])
    return found[:poses]


# --- What a model of geometry and springs can imitate --------------------------------------------------


def slopes(arm: Arm, rows: Rows, spring: bool = True) -> Array:
    """Derivatives (3 · rows, parameters) of the points by all geometry, base, markers and springs, where nothing gives way."""
    now = state(arm, rows, Yielding.none(len(rows), arm.n))
    flange_turn, point = now.tips[-1].turn, now.tips[-1].at(arm.markers[rows.marker])
    columns = [np.broadcast_to(axis, point.shape) for axis in np.eye(3)] + [np.cross(axis, point) for axis in np.eye(3)]
    before = Frame(np.broadcast_to(np.eye(3), flange_turn.shape), np.zeros_like(point))
    for i, (joint, tip) in enumerate(zip(now.joints, now.tips, strict=True)):
        x, z = before.turn[:, :, 0], joint.turn[:, :, 2]
        y = np.cos(arm.alpha[i]) * before.turn[:, :, 1] + np.sin(arm.alpha[i]) * before.turn[:, :, 2]
        columns += [
            x,
            z,
            *(np.cross(axis, point - frame.place) for axis, frame in ((x, before), (y, before), (z, joint))),
        ]
        if spring:
            columns.append(z * now.force(i)[:, None] if arm.slide[i] else columns[-1] * now.torque(i)[:, None])
        before = tip
    columns += [flange_turn[:, :, k] * (rows.marker == m)[:, None] for m in np.unique(rows.marker) for k in range(3)]
    return np.stack([(column @ arm.base.as_matrix().T).ravel() for column in columns], axis=1)


def visible(shift: Array, slope: Array, root: Array) -> float:
    """How many sd a displacement (rows, 3) stands out in all beside slopes; errors' covariance over the rows is root root'."""

    def whitened(columns: Array) -> Array:
        return np.linalg.solve(root, columns.reshape(len(root), -1)).reshape(columns.shape)

    x, design = whitened(shift).ravel(), whitened(slope.reshape(len(root), 3, -1)).reshape(shift.size, -1)
    design = design / np.maximum(np.linalg.norm(design, axis=0), 1e-12)
    return float(np.linalg.norm(x - design @ np.linalg.lstsq(design, x, rcond=1e-8)[0]))


def likeness(arm: Arm, rows: Rows, joints: Array, length: float = 1.0) -> Array:
    """Correlation (rows, rows) of a smooth function of some joints' angles: squared exponential over a length [rad]."""
    at = rows.q[:, joints] / arm.span[joints]
    return np.exp(-0.5 * ((at[:, None] - at[None]) ** 2).sum(axis=2) / length**2)


def background(kernel: Array, size: float, rng: np.random.Generator) -> Array:
    """A smooth displacement (rows, 3) [m] of a correlation, whose root mean square per axis over the rows is size."""
    drawn = np.linalg.cholesky(kernel + 1e-8 * np.eye(len(kernel))) @ rng.standard_normal((len(kernel), 3))
    drawn = drawn - drawn.mean(axis=0)
    return size * drawn / np.sqrt(np.mean(drawn**2))
