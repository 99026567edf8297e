"""Every cause of the catalogue in a second and a third form, for the arms of foreign_physics, and what each may be called.

A form is one of four kinds: what a joint's reading leaves out (of the rows alone), what gives way (of the loads), what weighs or is
as long otherwise than stated, and what the device adds. Its size multiplies all of it; its other figures are drawn once.

What a form may be called is its own cause and what acts by the same motion of the same place under the same input; joints are
counted from the hidden one's, none means any. Without another form here are a tracker's scale (alike to all lengths), noise that
grows with range (no shift), gravity other than plumb, a loop's rod, an arm that moves, and what cameras alone see (cameras.py).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from foreign_physics import GRAVITY, Arm, Array, Rows, State, Yielding, flange, of_row, points
from foreign_pulls import (
    balancer_aside,
    hanging_hose,
    hose_at_elbow,
    hose_at_flange,
    hose_from_below,
    taut_hose,
    wound_hose,
)
from scipy.spatial.transform import Rotation

TURNED = 3.0  # m from the device, where a turn of its frame moves points as far as a shift does
SUBSTEPS = 24  # of a way, in which a hysteresis loop is integrated


@dataclass(frozen=True)
class Hidden:
    """A form in an arm: the joint or link it belongs to (from 1; 0: none), its size, and its drawn figures' seed."""

    form: Form
    joint: int
    size: float
    seed: int

    @property
    def rng(self) -> np.random.Generator:
        """A generator that always draws the same figures."""
        return np.random.default_rng(self.seed)

    @property
    def i(self) -> int:
        """The joint's index."""
        return self.joint - 1


@dataclass(frozen=True)
class Form:
    """A form of a cause: which kind, where, and what it may be called besides; needs are columns and settings of its case."""

    cause: str
    name: str
    kind: str
    act: Callable
    places: Callable[[Arm], tuple[int, ...]]
    alike: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    arms: tuple[str, ...] = ("large-6", "cobot-6", "scara", "arm-7")
    needs: tuple[str, ...] = ()
    names: int = 1  # of the cause itself that are right beside each other
    small: float = 1e-8  # a size at which it acts linearly

    def may_be_called(self, cause: str, joint: int, hidden: int) -> bool:
        """Whether a name at a joint (0: none) is of its class."""
        near = {self.cause: (0,) if hidden else ()} | dict(self.alike)
        return cause in near and (not near[cause] or not joint or joint - hidden in near[cause])


def measured(arm: Arm, rows: Rows, hidden: tuple[Hidden, ...] = ()) -> Array:
    """Where the device sees each row's marker (rows, 3) [m], with hidden forms, without noise."""
    for h in hidden:
        arm = h.form.act(h, arm, rows) if h.form.kind == "load" else arm
    left_out = [_left_out(h.form.act(h, arm, rows), arm) for h in hidden if h.form.kind == "reading"]
    giving = [_bound(h) for h in hidden if h.form.kind == "yielding"]
    place = points(arm, rows, (*left_out, *giving))
    for h in hidden:
        place = h.form.act(h, rows, place) if h.form.kind == "device" else place
    return place


def _left_out(error: Array, arm: Arm) -> Callable:
    given = replace(Yielding.none(len(error), arm.n), joint=error)
    return lambda arm, rows, now: given


def _bound(h: Hidden) -> Callable:
    return lambda arm, rows, now: h.form.act(h, arm, rows, now)


def _at_joint(h: Hidden, arm: Arm, error: Array) -> Array:
    return error[:, None] * np.eye(arm.n)[h.i]


def _angle(h: Hidden, arm: Arm, rows: Rows) -> Array:
    return rows.q[:, h.i] / arm.span[h.i]


def rated(arm: Arm, i: int) -> float:
    """About the largest torque that gravity has on joint i (from 0) [Nm]."""
    beyond = np.abs(arm.a)[i + 1 :].sum() + np.abs(arm.d)[i + 1 :].sum()
    return float(0.5 * 9.8 * (arm.mass[i:].sum() + np.max(arm.payload_mass)) * max(beyond, 0.2))


# --- Readings ----------------------------------------------------------------------------------------


def landing_softly(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """Play whose flanks give way: taken up by degrees over the travel since the joint last turned back."""
    over = h.rng.uniform(0.02, 0.08) * arm.span[h.i]
    return _at_joint(h, arm, h.size * rows.side[:, h.i] * np.tanh(rows.travel[:, h.i] / over))


def worn_play(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """Play that is wider where the gear is worn."""
    wear = 1 + 0.5 * np.cos(_angle(h, arm, rows) - h.rng.uniform(0, 6.28))
    return _at_joint(h, arm, h.size * wear * rows.side[:, h.i])


def bouc_wen(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A loop of Bouc and Wen over all ways that the joint went."""
    rng = h.rng
    length, beta = rng.uniform(0.05, 0.2) * arm.span[h.i], rng.uniform(0.3, 0.7)

    def go(z: float, way: float) -> float:
        step = way / length / SUBSTEPS
        for _ in range(SUBSTEPS):
            z = np.clip(z + step * (1 - (beta + (1 - beta) * np.sign(step * z)) * z**2), -1, 1)
        return float(z)

    return _at_joint(h, arm, h.size * _along_ways(h, rows, 0.0, go, float))


def prandtl(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """Many small plays beside each other, of different widths: the loop of Prandtl and Ishlinskii, a kind of Preisach's."""
    rng = h.rng
    width = np.geomspace(0.01, 0.3, 6) * arm.span[h.i]
    share = rng.dirichlet(np.ones(6))

    def go(stop: Array, way: float) -> Array:
        return np.clip(stop + way, -width, width)

    return _at_joint(h, arm, h.size * _along_ways(h, rows, 0 * width, go, lambda stop: float(share @ (stop / width))))


def _along_ways(h: Hidden, rows: Rows, begin, go: Callable, seen: Callable) -> Array:
    """What a loop's state shows at each row, after all ways before it."""
    poses, first = np.unique(rows.pose, return_index=True)
    shown, loop, at = {}, begin, rows.way[first[0], 0, h.i]
    for pose, k in zip(poses, first, strict=True):
        for goal in rows.way[k, :, h.i]:
            loop, at = go(loop, goal - at), goal
        shown[pose] = seen(loop)
    return np.array([shown[pose] for pose in rows.pose])


def eccentric_coupling(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A coupling off its axis and bent: the first order with the second that belongs to it."""
    rng = h.rng
    angle, share = _angle(h, arm, rows) - rng.uniform(0, 6.28), rng.uniform(0.3, 0.5)
    return _at_joint(h, arm, h.size * (np.sin(angle) + share * np.sin(2 * angle + rng.uniform(0, 6.28))))


def tilted_disc(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A disc so far off its axis that the sine leans over."""
    rng = h.rng
    angle, far = _angle(h, arm, rows) - rng.uniform(0, 6.28), rng.uniform(0.4, 0.6)
    return _at_joint(h, arm, h.size / far * np.arctan2(far * np.sin(angle), 1 + far * np.cos(angle)))


def beating_wave(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A wave of the joint's angle whose amplitude swells and falls along the turn."""
    rng, angle = h.rng, _angle(h, arm, rows)
    order = rng.uniform(4, 14)
    swell = 1 + 0.4 * np.cos(angle - rng.uniform(0, 6.28))
    return _at_joint(h, arm, h.size * swell * np.cos(order * angle - rng.uniform(0, 6.28)))


def triangular_wave(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A wave with corners."""
    rng = h.rng
    turn = rng.integers(3, 12) * _angle(h, arm, rows) - rng.uniform(0, 6.28)
    return _at_joint(h, arm, h.size * 2 / np.pi * np.arcsin(np.cos(turn)))


def gear_with_sidebands(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A gear's wave, stronger on one side of an eccentric wheel."""
    rng, angle = h.rng, _angle(h, arm, rows)
    swell = 1 + 0.5 * np.cos(angle - rng.uniform(0, 6.28))
    return _at_joint(h, arm, h.size * swell * np.cos(rng.choice([1, 2]) * arm.gear[h.i] * angle - rng.uniform(0, 6.28)))


def two_meshes(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A gear's wave with its own second and half order."""
    rng, turn = h.rng, arm.gear[h.i] * _angle(h, arm, rows)
    orders = ((1.0, 1.0), (2.0, 0.4), (0.5, 0.3))
    return _at_joint(h, arm, h.size * sum(share * np.cos(k * turn - rng.uniform(0, 6.28)) for k, share in orders))


def worn_spots(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """Places along the joint where the gear is worn."""
    rng, angle = h.rng, _angle(h, arm, rows)
    low, high = arm.limits[h.i] / arm.span[h.i]
    bumps = [
        rng.normal() * np.exp(-0.5 * ((angle - at) / rng.uniform(0.08, 0.25)) ** 2) for at in rng.uniform(low, high, 8)
    ]
    return _at_joint(h, arm, h.size * np.sum(bumps, axis=0))


def rough_scale(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A scale whose divisions wander: straight between ticks of 0.15 to 0.3 rad."""
    rng, angle = h.rng, _angle(h, arm, rows)
    low, high = arm.limits[h.i] / arm.span[h.i]
    ticks = np.arange(low, high + 0.3, rng.uniform(0.15, 0.3))
    return _at_joint(h, arm, h.size * np.interp(angle, ticks, rng.standard_normal(len(ticks))))


def stretching_belt(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A belt's ratio that changes as it is wound."""
    angle = _angle(h, arm, rows)
    return _at_joint(h, arm, h.size * (angle + h.rng.uniform(0.1, 0.25) * angle * np.abs(angle)))


def counted_steps(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A wrong ratio of which the controller puts right whole steps of 0.05 rad of the motor's side at once."""
    angle, step = _angle(h, arm, rows), h.rng.uniform(0.15, 0.3)
    return _at_joint(h, arm, h.size * (0.8 * angle + 0.2 * step * np.floor(angle / step)))


def coupled_with_play(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A wrist's joint that follows the one before, with play."""
    before = h.i - 1
    return _at_joint(h, arm, h.size * (rows.q[:, before] + h.rng.uniform(0.05, 0.15) * rows.side[:, before]))


def coupled_by_bevels(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A wrist's joint that follows the one before by a bevel gear off its axis."""
    before, rng = rows.q[:, h.i - 1], h.rng
    return _at_joint(h, arm, h.size * (before + rng.uniform(0.1, 0.25) * np.sin(before - rng.uniform(0, 6.28))))


def creeping_zero(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A zero that slips in a while rather than at once."""
    begun, ended = np.quantile(rows.time, np.sort(h.rng.uniform(0.2, 0.8, 2)))
    return _at_joint(h, arm, h.size * np.clip((rows.time - begun) / (ended - begun + 1.0), 0, 1))


def slipping_twice(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A zero that slips twice, back by a part the second time."""
    rng = h.rng
    first, second = (rows.time > np.quantile(rows.time, rng.uniform(*when)) for when in ((0.2, 0.4), (0.6, 0.8)))
    return _at_joint(h, arm, h.size * (first - rng.uniform(0.3, 0.7) * second))


def lagging_zero(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A zero that follows the air's temperature, later than it."""
    return _at_joint(h, arm, h.size * _behind(h, rows))


def zero_of_two_parts(h: Hidden, arm: Arm, rows: Rows) -> Array:
    """A zero between two parts that warm up, one fast and one slowly, the other way."""
    fast, slow = h.rng.uniform(300, 900), h.rng.uniform(4000, 9000)
    return _at_joint(h, arm, h.size * (np.exp(-rows.time / fast) - 1.5 * np.exp(-rows.time / slow)))


def _behind(h: Hidden, rows: Rows) -> Array:
    """How warm (1: by 5 K) what follows the air by a time constant of 10 to 40 minutes is beyond the air's first temperature."""
    constant = h.rng.uniform(600, 2400)
    warm, passed = np.zeros(len(rows)), np.diff(rows.time)
    for k, step in enumerate(passed, 1):
        share = -np.expm1(-step / constant)
        warm[k] = warm[k - 1] + share * (rows.temperature[k] - rows.temperature[0] - warm[k - 1])
    return warm / 5


# --- What gives way ----------------------------------------------------------------------------------


def _joint(h: Hidden, arm: Arm, rows: Rows, error: Array) -> Yielding:
    return replace(Yielding.none(len(rows), arm.n), joint=_at_joint(h, arm, error))


def _turning(h: Hidden, arm: Arm, rows: Rows, part: str, i: int, turn: Array, shift: Array | float = 0.0) -> Yielding:
    given = Yielding.none(len(rows), arm.n)
    getattr(given, part)[:, i] = np.concatenate([shift + 0 * turn, turn], axis=1)
    return given


def saturating_spring(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A gear that is soft at first, and then no more."""
    knee = h.rng.uniform(0.1, 0.3) * rated(arm, h.i)
    return _joint(h, arm, rows, h.size * np.arctan(now.torque(h.i) / knee))


def two_slopes(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A gear of two stiffnesses, other ones to either side, that go over into each other."""
    rng, load = h.rng, now.torque(h.i) / rated(arm, h.i)
    knee, width, other = rng.uniform(0.1, 0.3), 0.05, rng.uniform(0.5, 1.0)
    up, down = (width * np.logaddexp(0, (sign * load - knee) / width) for sign in (1, -1))
    return _joint(h, arm, rows, h.size * (up - other * down))


def wide_torque_play(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """Play that the torque closes by degrees."""
    return _joint(h, arm, rows, h.size * np.tanh(now.torque(h.i) / (h.rng.uniform(0.05, 0.15) * rated(arm, h.i))))


def held_torque_play(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """Play that lies where the torque has it, but where friction is larger where the joint came from has it."""
    friction = h.rng.uniform(0.03, 0.12) * rated(arm, h.i)
    push = now.torque(h.i) + friction * rows.side[:, h.i]
    return _joint(h, arm, rows, h.size * np.tanh(push / (0.01 * rated(arm, h.i))))


def rooted_friction(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """Wind-up by friction that grows with the root of the torque."""
    load = np.sqrt(np.abs(now.torque(h.i)) / rated(arm, h.i))
    return _joint(h, arm, rows, h.size * rows.side[:, h.i] * (0.3 + load))


def creeping_friction(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """Wind-up by friction and torque that needs some travel to be whole."""
    load, over = np.abs(now.torque(h.i)) / rated(arm, h.i), h.rng.uniform(0.02, 0.1)
    built = rows.side[:, h.i] * (1 - np.exp(-rows.travel[:, h.i] / over))
    return _joint(h, arm, rows, h.size * built * (0.4 + load))


def loaded_mesh(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A gear's wave that the torque's size presses out, whichever its sign."""
    rng, load = h.rng, np.abs(now.torque(h.i)) / rated(arm, h.i)
    wave = np.cos(rng.choice([1, 2]) * arm.gear[h.i] * rows.q[:, h.i] - rng.uniform(0, 6.28))
    return _joint(h, arm, rows, h.size * wave * (0.5 + load))


def loaded_flexspline(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A wave of a few turns that grows with torque and then no more."""
    rng, load = h.rng, now.torque(h.i) / rated(arm, h.i)
    wave = np.cos(rng.integers(2, 7) * rows.q[:, h.i] - rng.uniform(0, 6.28))
    return _joint(h, arm, rows, h.size * wave * (1 + 0.8 * np.tanh(3 * load)))


def soft_both_ways(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A bearing that tilts about both axes, unlike and skew, and so shifts along its axis a little."""
    rng, joint = h.rng, now.joints[h.i]
    moment = joint.into(now.moment(h.i, joint.place))
    skew = Rotation.from_rotvec([0, 0, rng.uniform(0, 6.28)]).as_matrix()
    soft = skew @ np.diag([1.0, rng.uniform(0.3, 0.7), 0.0]) @ skew.T
    return _turning(h, arm, rows, "bearing", h.i, h.size * moment @ soft)


def pivot_aside(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A bearing that tilts about a point along its axis, under the moment about that."""
    joint = now.joints[h.i]
    pivot = (
        h.rng.choice([-1, 1]) * h.rng.uniform(0.1, 0.25) * 0.4 * np.linalg.norm(arm.region[1]) * np.array([0, 0, 1.0])
    )
    turn = h.size * joint.into(now.moment(h.i, joint.at(pivot))) * np.array([1, 1, 0])
    return _turning(h, arm, rows, "bearing", h.i, turn, -np.cross(turn, pivot))


def rollers_with_play(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A bearing whose rollers take the load one after another, as the moment across grows."""
    joint = now.joints[h.i]
    moment = joint.into(now.moment(h.i, joint.place)) * np.array([1, 1, 0])
    length = np.linalg.norm(moment, axis=1, keepdims=True)
    taken = np.tanh(length / (h.rng.uniform(0.05, 0.2) * rated(arm, h.i)))
    return _turning(h, arm, rows, "bearing", h.i, h.size * taken * moment / length)


def oval_race(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A bearing that is worn more to two sides, and tilts as far as it is worn where the moment presses it."""
    joint = now.joints[h.i]
    moment = joint.into(now.moment(h.i, joint.place)) * np.array([1, 1, 0])
    side = moment / np.linalg.norm(moment, axis=1, keepdims=True)
    worn = 1 + 0.4 * np.cos(2 * (np.arctan2(side[:, 1], side[:, 0]) - h.rng.uniform(0, 6.28)))
    return _turning(h, arm, rows, "bearing", h.i, h.size * worn[:, None] * side)


def _beam(h: Hidden, arm: Arm, rows: Rows, now: State, soft: Callable[[float], Array]) -> Yielding:
    """Bend and twist link h along its line: soft(place) is curvature per moment (3, 3) where place goes from 0 to 1.

    The line goes from its joint to its end (the next joint). Each place carries what hangs at the end and the link beyond it.
    """
    i, tip = h.i, now.tips[h.i]
    line = tip.into(tip.place - now.joints[i].place)
    mass, first = now.mass[:, i] - now.mass[:, i + 1], now.first[:, i] - now.first[:, i + 1]
    centre = tip.into(first / mass[:, None] - now.joints[i].place)
    shift, turn = np.zeros(line.shape), np.zeros(line.shape)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    for place, weight in zip((nodes + 1) / 2, weights / 2, strict=True):
        lever = (1 - place) * line
        carried = now.moment(i + 1, tip.place - np.einsum("nij,nj->ni", tip.turn, lever))
        own = np.cross(_beyond(line, centre, mass, place), tip.into(np.broadcast_to(GRAVITY, line.shape)))
        curved = h.size * weight * np.linalg.norm(line, axis=1, keepdims=True) * (tip.into(carried) + own) @ soft(place)
        turn += curved
        shift += np.cross(curved, lever)
    return _turning(h, arm, rows, "tip", i, turn, shift)


def _beyond(line: Array, centre: Array, mass: Array, place: float) -> Array:
    """First moment (rows, 3) about a place of a line of what lies beyond it of a link [kg m].

    Its mass lies beside the line at its centre, spread evenly about that as far as the line's nearer end.
    """
    share = np.clip((centre * line).sum(axis=1) / (line**2).sum(axis=1), 0.0, 1.0)
    half = np.maximum(np.minimum(share, 1 - share), 1e-9)
    start = np.clip(place, share - half, share + half)
    left = mass * (share + half - start) / (2 * half)
    middle = (start + share + half) / 2
    return left[:, None] * (centre + (middle - share - place)[:, None] * line)


def _direction(arm: Arm, i: int) -> Array:
    """A link's direction in the frame at its far end, of the arm as drawn."""
    line = np.array([arm.a[i + 1] if i + 1 < arm.n else 0.0, 0.0, arm.d[i]])
    return line / np.linalg.norm(line)


def tapered_beam(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A link that is thinner towards its end, bending alike in all directions."""
    across = np.eye(3) - np.outer(_direction(arm, h.i), _direction(arm, h.i))
    thin = h.rng.uniform(2, 5)
    return _beam(h, arm, rows, now, lambda place: across * (1 + thin * place))


def skew_beam(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A link that is softer about one skew axis across than about the other, and twists as it bends."""
    along = _direction(arm, h.i)
    across = np.cross(along, h.rng.normal(size=3))
    across = across / np.linalg.norm(across)
    soft = np.outer(across, across) + 0.3 * (np.eye(3) - np.outer(along, along)) + 0.4 * np.outer(along, along)
    return _beam(h, arm, rows, now, lambda place: soft)


def twisted_beam(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A link that twists along all its length, under the moment that each place carries, about its own slanting line."""
    along = _direction(arm, h.i)
    return _beam(h, arm, rows, now, lambda place: np.outer(along, along) * (1 + place))


def twist_of_the_next(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A twist that belongs to the length after the joint: about the next joint's side of the link, at the link's root."""
    i, joint = h.i, now.joints[h.i]
    line = now.tips[i].place - joint.place
    line = line / np.linalg.norm(line, axis=1, keepdims=True)
    moment = (now.moment(i, joint.place) * line).sum(axis=1, keepdims=True)
    return _turning(h, arm, rows, "bearing", i, h.size * joint.into(moment * line))


def tilting_corner(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A base plate that tilts about a point aside, under the moment about that."""
    away = h.rng.uniform(0, 6.28)
    pivot = 0.25 * np.array([np.cos(away), np.sin(away), -0.4])
    turn = h.size * now.moment(0, np.broadcast_to(pivot, (len(rows), 3))) * np.array([1, 1, 0])
    return replace(Yielding.none(len(rows), arm.n), base=np.concatenate([-np.cross(turn, pivot), turn], axis=1))


def one_bolt_loose(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A base plate that gives way to one side more than to the other."""
    away = h.rng.uniform(0, 6.28)
    loose = np.array([np.cos(away), np.sin(away), 0.0])
    moment = now.moment(0, np.zeros((len(rows), 3))) * np.array([1, 1, 0])
    more = np.maximum(moment @ loose, 0)[:, None] * loose
    return replace(
        Yielding.none(len(rows), arm.n), base=np.concatenate([0 * moment, h.size * (0.5 * moment + more)], axis=1)
    )


def rocking_plate(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A base plate that rocks by degrees, about a line beside the robot."""
    away, over = h.rng.uniform(0, 6.28), h.rng.uniform(0.03, 0.1) * rated(arm, 0)
    line, aside = np.array([np.cos(away), np.sin(away), 0.0]), 0.2 * np.array([-np.sin(away), np.cos(away), 0.0])
    side = np.tanh(now.moment(0, np.broadcast_to(aside, (len(rows), 3))) @ line / over)
    turn = h.size * side[:, None] * line
    return replace(Yielding.none(len(rows), arm.n), base=np.concatenate([-np.cross(turn, aside), turn], axis=1))


def lifting_corner(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A base plate that lifts off, as far as a bolt lets it, where the moment is enough, and lies flat elsewhere."""
    away, over = h.rng.uniform(0, 6.28), 0.05 * rated(arm, 0)
    line = np.array([np.cos(away), np.sin(away), 0.0])
    lifted = (1 + np.tanh((now.moment(0, np.zeros((len(rows), 3))) @ line - 2 * over) / over)) / 2
    turn = h.size * lifted[:, None] * line
    return replace(Yielding.none(len(rows), arm.n), base=np.concatenate([0 * turn, turn], axis=1))


def spring_behind(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A tension spring from the column behind the arm to a lug beside it; size is its pull at 0.7 m [N]."""
    rng = h.rng
    return _compensated(h, arm, rows, now, rng.uniform([-0.6, -0.3], [-0.3, 0.2]), rng.uniform(0.12, 0.25), rng.uniform(-1, 1),
                        lambda length: -(1 + rng.uniform(1, 3) * (length - 0.7)))  # fmt: skip


def gas_spring(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A cylinder that pushes from below the joint, whose gas is pressed together; size is its push at 0.7 m [N]."""
    rng = h.rng
    return _compensated(h, arm, rows, now, rng.uniform([0.2, -0.6], [0.5, -0.3]), rng.uniform(0.12, 0.25), rng.uniform(-1, 1),
                        lambda length: ((0.7 + 0.4) / (length + 0.4)) ** 1.3)  # fmt: skip


def _compensated(
    h: Hidden, arm: Arm, rows: Rows, now: State, foot: Array, lug: float, turned: float, force: Callable
) -> Yielding:
    """A force along the line from a foot (forwards and upwards of the joint) on the link before to a lug on the link."""
    joint, before = now.joints[h.i], now.tips[h.i - 1]
    axis, up = joint.turn[:, :, 2], np.broadcast_to([0.0, 0.0, 1.0], joint.place.shape)
    forward = before.turn[:, :, 0]
    fixed = foot[0] * forward + foot[1] * up
    arm_of = lug * (np.cos(turned) * joint.turn[:, :, 0] + np.sin(turned) * joint.turn[:, :, 1])
    line = arm_of - fixed
    length = np.linalg.norm(line, axis=1)
    push = (force(length) / length)[:, None] * line
    torque = h.size * (np.cross(arm_of, push) * axis).sum(axis=1)
    return _joint(h, arm, rows, arm.compliance[h.i] * torque)


def rubber_mount(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A tool on rubber: it shifts and turns, other ways by other measures, and the rubber hardens."""
    rng, tip = h.rng, now.tips[-1]
    force = tip.into(of_row(arm.payload_mass, rows, 1)[:, None] * GRAVITY)
    top = 9.8 * np.max(arm.payload_mass)
    force = force / np.sqrt(1 + (np.linalg.norm(force, axis=1, keepdims=True) / top) ** 2)
    shift = h.size * force * rng.uniform(0.4, 1.6, 3)
    turn = h.size * np.cross([0, 0, rng.uniform(2, 6)], force)
    return replace(Yielding.none(len(rows), arm.n), tool=np.concatenate([shift, turn], axis=1))


def slanting_bracket(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A bracket that slants from the flange, and bends under the load at its end."""
    rng, tip = h.rng, now.tips[-1]
    line = rng.uniform(0.1, 0.3) * np.array([np.sin(0.6), 0, np.cos(0.6)])
    force = tip.into(of_row(arm.payload_mass, rows, 1)[:, None] * GRAVITY)
    across = force - np.outer(force @ line, line) / (line @ line)
    turn = h.size * 1.5 / (line @ line) * np.cross(line, across)
    return replace(Yielding.none(len(rows), arm.n), tool=np.concatenate([h.size * across, turn], axis=1))


def sagging_magnet(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A marker's nest that hangs by its own weight, softer to one side."""
    pull = now.tips[-1].into(np.broadcast_to(GRAVITY, (len(rows), 3))) / 9.8
    turned = Rotation.random(random_state=int(h.rng.integers(2**31))).as_matrix()
    shift = h.size * pull @ (turned @ np.diag([1.0, 0.5, 0.1]) @ turned.T)
    return replace(Yielding.none(len(rows), arm.n), tool=np.concatenate([shift, 0 * shift], axis=1))


def sagging_arm(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A tool's own arm that turns about its root under its own weight, and hardens."""
    pull = now.tips[-1].into(np.broadcast_to(GRAVITY, (len(rows), 3))) / 9.8
    turn = np.cross(h.rng.normal(size=3) * np.array([0.4, 0.4, 1.0]), pull)
    turn = h.size * turn / np.sqrt(1 + (turn**2).sum(axis=1, keepdims=True))
    return replace(Yielding.none(len(rows), arm.n), tool=np.concatenate([0 * turn, turn], axis=1))


def hardening_joints(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """Joints that give way by springs that harden, where nobody knows the masses."""
    given = Yielding.none(len(rows), arm.n)
    load = np.stack([now.torque(i) / rated(arm, i) for i in range(arm.n)], axis=1)
    heavy = np.isin(np.arange(1, arm.n + 1), arm.loaded)
    return replace(given, joint=h.size * heavy * load / np.sqrt(1 + load**2))


def joints_and_links(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """Joints that give way, and links that bend where they end at these, where nobody knows the masses."""
    load = np.stack([now.torque(i) for i in range(arm.n)], axis=1)
    heavy = np.isin(np.arange(1, arm.n + 1), arm.loaded) / np.array([rated(arm, i) for i in range(arm.n)])
    bent = [_beam(replace(h, joint=link, size=0.2 * h.size / rated(arm, link - 1)), arm, rows, now, lambda place: np.eye(3))
            for link in arm.long]  # fmt: skip
    return sum(bent, replace(Yielding.none(len(rows), arm.n), joint=h.size * load * heavy))


def bowed_rail(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A bowed rail: aside by a parabola, and turned as that slopes."""
    rng = h.rng
    place = (rows.q[:, h.i] - arm.limits[h.i].mean()) / arm.span[h.i]
    away = rng.uniform(0, 6.28)
    across, about = (np.array([np.cos(away + turn), np.sin(away + turn), 0.0]) for turn in (0, np.pi / 2))
    slope = (2 * h.size / arm.span[h.i]) * place[:, None] * about * rng.uniform(0.5, 1.5)
    return _turning(h, arm, rows, "bearing", h.i, slope, h.size * (place**2)[:, None] * across)


def wavy_rail(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A rail that waves as its bolts press it, along and across, not alike."""
    rng, place = h.rng, rows.q[:, h.i] / arm.span[h.i]
    order, phase, share = rng.uniform(3, 6), rng.uniform(0, 6.28, 3), rng.uniform(0.3, 1, 3)
    wave = np.cos(order * place[:, None] - phase) * share
    return _turning(h, arm, rows, "bearing", h.i, 0 * wave, h.size * wave)


def lobed_races(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A bearing whose races have lobes: its axis tilts by several orders of the angle, in their own directions."""
    rng, angle = h.rng, _angle(h, arm, rows)
    tilt = sum(
        share * np.cos(order * angle[:, None] - rng.uniform(0, 6.28, 2)) * rng.uniform(0.3, 1, 2)
        for order, share in ((1, 1.0), (2, 0.5), (3, 0.3))
    )
    return _turning(h, arm, rows, "bearing", h.i, np.column_stack([h.size * tilt, 0 * angle]))


def bent_shaft(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A shaft that binds in its housing: its axis tilts to one side of it, over less than half a turn."""
    rng, angle = h.rng, _angle(h, arm, rows)
    away = rng.uniform(0, 6.28)
    pressed = np.exp(2 * (np.cos(angle - rng.uniform(0, 6.28)) - 1))
    turned = away - angle  # as the housing's side lies in the frame that turns
    tilt = pressed[:, None] * np.column_stack([np.cos(turned), np.sin(turned), 0 * angle])
    return _turning(h, arm, rows, "bearing", h.i, h.size * tilt)


def hardening_belt(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A slide's belt that hardens, of the length that carries."""
    load = now.force(h.i) / (0.5 * np.abs(now.force(h.i)).max())
    return _joint(h, arm, rows, h.size * _angle(h, arm, rows) * load / np.sqrt(1 + load**2))


def screw_held_twice(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A slide's screw that is held at both ends, one better than the other."""
    low, high = arm.limits[h.i]
    place = (rows.q[:, h.i] - low) / (high - low)
    load = now.force(h.i) / np.abs(now.force(h.i)).max()
    return _joint(h, arm, rows, h.size * load * place * (1 - h.rng.uniform(0.3, 0.6) * place))


def tool_creeping_on(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A tool that is bumped, and creeps on the same way."""
    rng = h.rng
    moment = np.quantile(rows.time, rng.uniform(0.25, 0.75))
    gone = (rows.time > moment) * (1 - 0.3 * np.exp(-np.maximum(rows.time - moment, 0) / 400))
    return _tool_moved(h, arm, rows, gone, rng)


def tool_bumped_twice(h: Hidden, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A tool that is bumped twice, another way each time."""
    rng = h.rng
    when = (rng.uniform(0.2, 0.4), rng.uniform(0.6, 0.8))
    moved = (
        _tool_moved(h, arm, rows, (rows.time > np.quantile(rows.time, share)).astype(float), rng) for share in when
    )
    return sum(moved, Yielding.none(len(rows), arm.n))


def _tool_moved(h: Hidden, arm: Arm, rows: Rows, gone: Array, rng: np.random.Generator) -> Yielding:
    """The tool shifted, and turned as far as that at half a metre, along a course (rows,)."""
    twist = rng.normal(size=6) * np.repeat([1.0, 2.0], 3)
    return replace(Yielding.none(len(rows), arm.n), tool=h.size * gone[:, None] * twist)


# --- What weighs, or is as long, otherwise -----------------------------------------------------------


def offset_scale(h: Hidden, arm: Arm, rows: Rows) -> Arm:
    """Loads weighed on a scale that was not at zero, each with a share of its own besides."""
    share = np.where(arm.payload_mass > 0, h.rng.uniform(0.5, 1.5, len(arm.payload_mass)), 0)
    return replace(arm, payload_mass=arm.payload_mass + h.size * share)


def hose_at_the_tool(h: Hidden, arm: Arm, rows: Rows) -> Arm:
    """A hose that hangs at loaded tools, beside their centre."""
    carried, mass = arm.payload_mass > 0, arm.payload_mass
    at = arm.payload_com + h.rng.normal(size=3) * 0.05
    more = h.size * carried
    com = (mass[:, None] * arm.payload_com + more[:, None] * at) / np.maximum(mass + more, 1e-9)[:, None]
    return replace(arm, payload_mass=mass + more, payload_com=com)


def heavy_side(h: Hidden, arm: Arm, rows: Rows) -> Arm:
    """A load whose centre is off, more so when there is more of it."""
    away = h.rng.normal(size=3) * np.array([1, 1, 0.6])
    share = arm.payload_mass / np.max(arm.payload_mass)
    return replace(arm, payload_com=arm.payload_com + h.size * share[:, None] * (0.6 + 0.4 * share[:, None]) * away)


def sliding_load(h: Hidden, arm: Arm, rows: Rows) -> Arm:
    """A load that lies off its centre, and slides a little to where it is low."""
    away = h.rng.normal(size=3) * np.array([1, 1, 0.6])
    down = flange(arm, rows).into(np.broadcast_to(GRAVITY, (len(rows), 3))) / 9.8
    com = arm.payload_com[rows.payload] + h.size * (away + 0.3 * down)
    return replace(arm, payload_mass=arm.payload_mass[rows.payload], payload_com=com)


def dress_pack(h: Hidden, arm: Arm, rows: Rows) -> Arm:
    """A dress pack that rides on a link, beside its centre."""
    at = arm.com[h.i] + h.rng.normal(size=3) * 0.15
    mass = arm.mass + h.size * np.eye(arm.n)[h.i]
    com = arm.com + np.eye(arm.n)[h.i][:, None] * (h.size / mass[h.i]) * (at - arm.com[h.i])
    return replace(arm, mass=mass, com=com)


def two_cast_links(h: Hidden, arm: Arm, rows: Rows) -> Arm:
    """A link whose casting weighs more, and its neighbour a third of that."""
    share = np.eye(arm.n)[h.i] + 0.33 * np.eye(arm.n)[min(h.i + 1, arm.n - 1)]
    return replace(arm, mass=arm.mass + h.size * share)


def two_warmings(h: Hidden, arm: Arm, rows: Rows) -> Arm:
    """All links grow, motors' ends fast and castings slowly."""
    fast, slow = h.rng.uniform(300, 900), h.rng.uniform(4000, 9000)
    grown = 0.4 * (1 - np.exp(-rows.time / fast)) + 0.6 * (1 - np.exp(-rows.time / slow))
    return _grown(h, arm, grown[:, None] * np.ones(arm.n))


def uneven_growth(h: Hidden, arm: Arm, rows: Rows) -> Arm:
    """Links grow with the air, later than it and the farther from the base the less."""
    later = 0.6 * rows.temperature + 0.4 * np.interp(rows.time - 900, rows.time, rows.temperature)
    return _grown(h, arm, (later - later[0])[:, None] / 5 * np.linspace(1.3, 0.7, arm.n))


def _grown(h: Hidden, arm: Arm, by: Array) -> Arm:
    return replace(arm, a=arm.a * (1 + h.size * by), d=arm.d * (1 + h.size * by))


def lost_on_the_way(h: Hidden, arm: Arm, rows: Rows) -> Arm:
    """Loads that become lighter at a moment, on one side, so that their centre shifts."""
    rng = h.rng
    lost = (rows.time > np.quantile(rows.time, rng.uniform(0.25, 0.75))) * h.size * arm.payload_mass[rows.payload]
    return _lightened(arm, rows, lost, rng)


def emptying(h: Hidden, arm: Arm, rows: Rows) -> Arm:
    """Loads that are emptied in two steps."""
    rng = h.rng
    when = (rng.uniform(0.2, 0.4), rng.uniform(0.6, 0.8))
    steps = sum(
        (rows.time > np.quantile(rows.time, share)) * part for share, part in zip(when, (0.6, 0.4), strict=True)
    )
    return _lightened(arm, rows, steps * h.size * arm.payload_mass[rows.payload], rng)


def _lightened(arm: Arm, rows: Rows, lost: Array, rng: np.random.Generator) -> Arm:
    mass, com = arm.payload_mass[rows.payload], arm.payload_com[rows.payload]
    at = com + 0.03 * rng.normal(size=3)
    left = mass - lost
    com = (mass[:, None] * com - lost[:, None] * at) / np.maximum(left, 1e-9)[:, None]
    return replace(arm, payload_mass=left, payload_com=com)


# --- The device --------------------------------------------------------------------------------------


def _moved(h: Hidden, place: Array, course: Array, rng: np.random.Generator) -> Array:
    """Points moved by a frame's shift and turn along a course (rows,)."""
    shift, turn = rng.normal(size=3), 0.5 * rng.normal(size=3) / TURNED
    return place + h.size * course[:, None] * (shift + np.cross(turn, place))


def random_walk(h: Hidden, rows: Rows, place: Array) -> Array:
    """A frame that goes nowhere in particular: a walk of each of its six figures."""
    rng = h.rng
    poses, first, own = np.unique(rows.pose, return_index=True, return_inverse=True)
    gone = np.sqrt(np.diff(rows.time[first], prepend=rows.time[0]) / np.ptp(rows.time))
    walk = np.cumsum(gone[:, None] * rng.standard_normal((len(poses), 6)), axis=0)[own]
    return place + h.size * (walk[:, :3] + np.cross(0.5 * walk[:, 3:] / TURNED, place))


def warming_device(h: Hidden, rows: Rows, place: Array) -> Array:
    """A device that warms up, by two times."""
    rng = h.rng
    fast, slow = rng.uniform(200, 700), rng.uniform(2000, 8000)
    return _moved(h, place, 0.6 * (1 - np.exp(-rows.time / fast)) + 0.8 * (1 - np.exp(-rows.time / slow)), rng)


def settling_stand(h: Hidden, rows: Rows, place: Array) -> Array:
    """A stand that is bumped and creeps on."""
    rng = h.rng
    moment = np.quantile(rows.time, rng.uniform(0.25, 0.75))
    since = np.maximum(rows.time - moment, 0)
    return _moved(h, place, (rows.time > moment) * (1 + 0.4 * (1 - np.exp(-since / 400))), rng)


def two_bumps(h: Hidden, rows: Rows, place: Array) -> Array:
    """A stand that is bumped twice, another way each time."""
    rng = h.rng
    for share in (rng.uniform(0.2, 0.4), rng.uniform(0.6, 0.8)):
        place = _moved(h, place, (rows.time > np.quantile(rows.time, share)).astype(float), rng)
    return place


def anew_and_settling(h: Hidden, rows: Rows, place: Array) -> Array:
    """A device that is set up anew for each session, and settles in each."""
    rng = h.rng
    for session in np.unique(rows.session):
        here = rows.session == session
        since = rows.time - rows.time[here].min()
        place = _moved(h, place, here * (1 + 0.3 * np.exp(-since / 300)), rng)
    return place


def other_air(h: Hidden, rows: Rows, place: Array) -> Array:
    """A device that is set up anew for each session, in other air: lengths are a little otherwise too."""
    rng = h.rng
    for session in np.unique(rows.session):
        here = (rows.session == session).astype(float)
        place = _moved(h, place, here, rng) + h.size * 0.1 * rng.normal() * here[:, None] * place
    return place


def lagging_stand(h: Hidden, rows: Rows, place: Array) -> Array:
    """A stand that follows the air's temperature, later than it."""
    return _moved(h, place, _behind(h, rows), h.rng)


def stand_of_two_legs(h: Hidden, rows: Rows, place: Array) -> Array:
    """A stand whose legs warm up by times of their own, and lean another way each."""
    rng = h.rng
    for constant in (rng.uniform(400, 1200), rng.uniform(3000, 8000)):
        place = _moved(h, place, 1 - np.exp(-rows.time / constant), rng)
    return place


def bent_scale(h: Hidden, rows: Rows, place: Array) -> Array:
    """A scale that grows with the temperature and with its square."""
    warm = (rows.temperature - rows.temperature[0]) / 5
    return place * (1 + h.size * (0.5 * warm + 0.5 * warm**2))[:, None]


def lagging_scale(h: Hidden, rows: Rows, place: Array) -> Array:
    """A floor that follows the air's temperature, later than it: all that stands on it spreads."""
    return place * (1 + h.size * _behind(h, rows))[:, None]


# --- The table ---------------------------------------------------------------------------------------

ANGULAR = {"joint-eccentricity": (0,), "periodic-joint-error": (0,), "gear-transmission-error": (0,), "joint-error-map": (0,),
           "loaded-transmission-error": (0,)}  # fmt: skip
DIRECTIONAL = {"joint-backlash": (0,), "joint-hysteresis": (0,), "friction-wind-up": (0,)}
TORQUE = {"nonlinear-joint-stiffness": (0,), "torque-backlash": (0,)}
BEARING = {"bearing-play": (0,), "link-torsion": (0, -1), "link-bending": (0, -1)}
WEIGHTS = {"payload-mass": (), "payload-com": (), "link-mass": ()}
DEVICE = {"frame-drift": (), "frame-step": (), "session-frame": (), "stand-growth": (), "scale-growth": ()}
GRAVITY_ARMS = ("large-6", "cobot-6", "arm-7")


def driven(arm: Arm) -> tuple[int, ...]:
    """Joints whose errors the poses show: not the last, about which the marker is near."""
    return tuple(i + 1 for i in range(arm.n - 1) if not arm.slide[i])


def beyond_first(arm: Arm) -> tuple[int, ...]:
    """Of these, joints beyond the first."""
    return driven(arm)[1:]


def loaded(arm: Arm) -> tuple[int, ...]:
    """Joints that gravity turns."""
    return arm.loaded


def long(arm: Arm) -> tuple[int, ...]:
    """Long links."""
    return arm.long


def upper(arm: Arm) -> tuple[int, ...]:
    """Long links beyond the one that joint 2 moves."""
    return tuple(link for link in arm.long if link > 2)


def nowhere(arm: Arm) -> tuple[int, ...]:
    """No joint."""
    return (0,)


def _forms() -> tuple[Form, ...]:
    found: list[Form] = []

    def both(
        cause: str, kind: str, acts: tuple[Callable, ...], places: Callable, alike: Mapping, **more: object
    ) -> None:
        found.extend(Form(cause, act.__name__.replace("_", "-"), kind, act, places, alike, **more) for act in acts)

    # The same joint errs with its angle alone: the family of angular transmission errors, which the evidence may name as finely as
    # it can. So does a gear ratio that is bent; but what is no straight line is no gear ratio.
    both("joint-eccentricity", "reading", (eccentric_coupling, tilted_disc), driven, ANGULAR)
    both("periodic-joint-error", "reading", (beating_wave, triangular_wave), driven, ANGULAR)
    both("gear-transmission-error", "reading", (gear_with_sidebands, two_meshes), driven, ANGULAR)
    both("joint-error-map", "reading", (worn_spots, rough_scale), driven, ANGULAR)
    both("gear-ratio-error", "reading", (stretching_belt, counted_steps), driven, ANGULAR)
    both("loaded-transmission-error", "yielding", (loaded_mesh, loaded_flexspline), loaded, ANGULAR, arms=GRAVITY_ARMS)
    # The side from which the joint came decides, more or less with travel and load.
    both("joint-backlash", "reading", (landing_softly, worn_play), driven, DIRECTIONAL, needs=("travel",))
    both("joint-hysteresis", "reading", (bouc_wen, prandtl), driven, DIRECTIONAL, needs=("travel",))
    both(
        "friction-wind-up",
        "yielding",
        (rooted_friction, creeping_friction),
        loaded,
        DIRECTIONAL,
        arms=GRAVITY_ARMS,
        needs=("travel",),
    )
    # An odd function of the joint's torque; held by friction, of the side too.
    both("nonlinear-joint-stiffness", "yielding", (saturating_spring, two_slopes), loaded, TORQUE, arms=GRAVITY_ARMS)
    both("torque-backlash", "yielding", (wide_torque_play,), loaded, TORQUE, arms=GRAVITY_ARMS)
    both("torque-backlash", "yielding", (held_torque_play,), loaded, TORQUE | DIRECTIONAL, arms=GRAVITY_ARMS)
    both("wrist-coupling", "reading", (coupled_with_play, coupled_by_bevels), lambda arm: (5, 6), {}, arms=("large-6",))
    # A turn between link i - 1 and link i under the moment there: a bearing, or the ends of the links at it.
    both("bearing-compliance", "yielding", (soft_both_ways, pivot_aside), lambda arm: arm.tilting, BEARING)
    both(
        "bearing-play",
        "yielding",
        (rollers_with_play, oval_race),
        lambda arm: arm.tilting,
        {"bearing-compliance": (0,)},
    )
    # A link that bends alike all round gives way as its foot's bearing and the next one's do; it does not twist.
    both("link-bending", "yielding", (tapered_beam,), long, {"bearing-compliance": (0, 1)})
    both("link-bending", "yielding", (skew_beam,), long, {"link-torsion": (0,), "bearing-compliance": (0, 1)})
    # A twist about the link's line is a turn of the next bearing, or of its own; or a neighbour's, where it ends there.
    both("link-torsion", "yielding", (twisted_beam, twist_of_the_next), long,
         {"link-torsion": (-1, 0, 1), "bearing-compliance": (0, 1)}, arms=GRAVITY_ARMS)  # fmt: skip
    # The base lies under the bearing of joint 1, and the upright first link on it.
    both(
        "base-compliance",
        "yielding",
        (tilting_corner, one_bolt_loose),
        nowhere,
        {"bearing-compliance": (1,), "link-bending": (1,)},
    )
    both("base-play", "yielding", (rocking_plate, lifting_corner), nowhere,
         {"base-compliance": (), "bearing-play": (1,), "bearing-compliance": (1,)}, arms=GRAVITY_ARMS)  # fmt: skip
    both("base-tilt", "yielding", (tilting_corner, one_bolt_loose), nowhere,
         {"base-compliance": (), "bearing-compliance": (1,)}, arms=GRAVITY_ARMS, needs=("no masses",))  # fmt: skip
    both("gravity-deflection", "yielding", (hardening_joints, joints_and_links), nowhere,
         {"joint-compliance": (), "nonlinear-joint-stiffness": ()}, arms=GRAVITY_ARMS, needs=("no masses",), names=4)  # fmt: skip
    # The torque is a function of joint 2's angle alone, so its error is: of that family, but no straight line.
    both("gravity-compensator", "yielding", (spring_behind, gas_spring), lambda arm: (2,),
         {"gravity-compensator": (), "joint-eccentricity": (0,), "periodic-joint-error": (0,), "joint-error-map": (0,)},
         arms=("large-6",), small=10.0)  # fmt: skip
    # Held at a link, at its neighbour or at the flange a hose acts alike; one that sags adds its weight. Between elbow and flange,
    # and wound about a joint, its pull is a function of a wrist's angles: of that family, and wound of nothing else.
    pulls = {"dress-pack": ()}
    both(
        "dress-pack",
        "yielding",
        (balancer_aside, taut_hose, hose_from_below),
        upper,
        pulls,
        arms=GRAVITY_ARMS,
        small=1.0,
    )
    both("dress-pack", "yielding", (hose_at_flange,), lambda arm: (arm.n,), pulls, arms=GRAVITY_ARMS, small=1.0)
    both("dress-pack", "yielding", (hanging_hose,), upper, pulls | WEIGHTS, arms=GRAVITY_ARMS, small=1.0)
    both("dress-pack", "yielding", (hose_at_elbow,), lambda arm: (arm.n,),
         pulls | dict.fromkeys(ANGULAR, (-1, -2)), arms=GRAVITY_ARMS, small=1.0)  # fmt: skip
    both("dress-pack", "yielding", (wound_hose,), lambda arm: (arm.n - 2,),
         pulls | ANGULAR | {"gear-ratio-error": (0,)}, arms=GRAVITY_ARMS, small=1.0)  # fmt: skip
    # Weight that is not stated acts wherever it is carried: heavier there, or farther out. Both loads are off in these forms.
    both(
        "payload-mass",
        "load",
        (offset_scale, hose_at_the_tool),
        nowhere,
        WEIGHTS,
        arms=GRAVITY_ARMS,
        names=2,
        small=0.01,
    )
    both("payload-com", "load", (heavy_side, sliding_load), nowhere, WEIGHTS, arms=GRAVITY_ARMS, names=2, small=1e-4)
    both("link-mass", "load", (dress_pack, two_cast_links), lambda arm: (3, 4), WEIGHTS, arms=GRAVITY_ARMS, small=0.01)
    # A mount beyond the flange turns and shifts under the load; so does what turns the flange under the same moment.
    both("tool-deflection", "yielding", (rubber_mount, slanting_bracket), lambda arm: (arm.n,),
         {"tool-deflection": (), "tool-sag": (), "bearing-compliance": (0,), "link-bending": (0,)}, arms=GRAVITY_ARMS)  # fmt: skip
    both("tool-sag", "yielding", (sagging_magnet, sagging_arm), nowhere, {"tool-deflection": ()}, arms=GRAVITY_ARMS)
    both(
        "axis-straightness",
        "yielding",
        (bowed_rail, wavy_rail),
        lambda arm: (3,),
        {"joint-error-map": (0,)},
        arms=("scara",),
    )
    both("thermal-growth", "load", (two_warmings, uneven_growth), nowhere, {"housing-growth": ()},
         needs=("time", "temperature"))  # fmt: skip
    # A device that moves in time, by degrees or at once: which of these is the same question put to fewer or more rows.
    both("frame-drift", "device", (random_walk, warming_device), nowhere, DEVICE, needs=("time",))
    both("frame-step", "device", (settling_stand, two_bumps), nowhere, DEVICE, needs=("time",))
    both("session-frame", "device", (anew_and_settling, other_air), nowhere, DEVICE, needs=("time", "session"), names=2)
    both(
        "stand-growth",
        "device",
        (lagging_stand, stand_of_two_legs),
        nowhere,
        DEVICE,
        needs=("time", "temperature"),
        names=2,
    )
    both("scale-growth", "device", (bent_scale, lagging_scale), nowhere, DEVICE, needs=("time", "temperature"), names=2)
    # Joint 1's zero is the device's frame turned; a zero that goes by degrees is one that grows, and the other way round.
    zeros = {"joint-step": (0,), "housing-growth": (0,)}
    both("joint-step", "reading", (creeping_zero, slipping_twice), beyond_first, zeros, needs=("time",), names=2)
    both(
        "housing-growth",
        "reading",
        (lagging_zero, zero_of_two_parts),
        beyond_first,
        zeros,
        needs=("time", "temperature"),
    )
    both("tool-slip", "yielding", (tool_creeping_on, tool_bumped_twice), nowhere, {}, needs=("time",), names=3)
    both("payload-step", "load", (lost_on_the_way, emptying), nowhere, WEIGHTS, arms=GRAVITY_ARMS, needs=("time",), names=2,
         small=1e-3)  # fmt: skip
    both("axis-wobble", "yielding", (lobed_races, bent_shaft), driven, {}, names=2)
    # A belt that hardens is a slide's stiffness that is not linear, too.
    hardening = {"nonlinear-joint-stiffness": (0,)}
    both("drive-stretch", "yielding", (hardening_belt,), lambda arm: (3,), hardening, arms=("scara",), names=2)
    both("drive-stretch", "yielding", (screw_held_twice,), lambda arm: (3,), {}, arms=("scara",))
    return tuple(found)


FORMS = _forms()
