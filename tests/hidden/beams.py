"""Links as beams: straight as textbooks have them, and crooked, under what they carry and their own weight. SI units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hidden.simulator import WEIGHT, Array, Motion, Robot, Rows, State

if TYPE_CHECKING:
    from hidden.causes import Hidden

SHEAR = 1.3  # EI over GJ of a round tube


def link_bending(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """A cantilever from this joint's axis to the next, bent by force and moment at its tip and by its own weight; size is 1/EI.

    "to the wrist" it ends at the far end of the next joint's offset, where it is bent by force and moment there.
    """
    i = h.joint - 1
    beyond = np.zeros(3)
    length, along = beam(robot, i)
    if h.extra == "to the wrist":
        line, beyond = _to_the_wrist(robot, i)
        length, along = np.linalg.norm(line), line / np.linalg.norm(line)
    tip = (length, state.tip_force[:, i], state.tip_moment[:, i] - np.cross(beyond, state.tip_force[:, i]))
    shift, turn = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
    for place, force, moment in (tip, *own_weight(robot, state, i, length, along)):
        force, moment = force - (force @ along)[:, None] * along, moment - (moment @ along)[:, None] * along
        sag = place**3 / 3 * force + place**2 / 2 * np.cross(moment, along)
        slope = place**2 / 2 * np.cross(along, force) + place * moment
        shift, turn = shift + sag + np.cross(slope, (length - place) * along - beyond), turn + slope
    motion = Motion.none(len(rows), robot.n)
    motion.tip[:, i] = h.size * np.concatenate([shift, turn], axis=1)
    return motion


def link_torsion(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """Twist about the line to the next joint under the moment carried at the tip, and under its own weight; the size is 1/GJ.

    Of a link "to the wrist" about the line to the far end of the next joint's offset, at its own joint.
    """
    i = h.joint - 1
    length, along = beam(robot, i)
    force, moment = state.tip_force[:, i], state.tip_moment[:, i]
    if h.extra == "to the wrist":
        line, beyond = _to_the_wrist(robot, i)
        length, along, moment = np.linalg.norm(line), line / np.linalg.norm(line), moment - np.cross(beyond, force)
    carried_there = ((length, force, moment), *own_weight(robot, state, i, length, along))
    twist = h.size * sum(place * (about @ along)[:, None] * along for place, _, about in carried_there)
    motion = Motion.none(len(rows), robot.n)
    if h.extra == "to the wrist":
        motion.bearing[:, i] = twist
    else:
        motion.tip[:, i, 3:] = twist
    return motion


def oblique_beam(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """A crooked link of two straight parts, softer about one skew axis than about the other, that bend and twist under its loads.

    Its own weight counts. The size is 1/EI about the stiffer axis; the crook is drawn, up to a third of its length aside.
    """
    rng, i = h.rng, h.joint - 1
    end = np.array([robot.a[..., i + 1].mean() if i + 1 < robot.n else 0.0, 0.0, robot.d[..., i].mean()])
    aside = np.cross(end, rng.normal(size=3))
    aside *= rng.uniform(0.1, 0.33) * np.linalg.norm(end) / np.linalg.norm(aside)
    path = np.array([np.zeros(3), rng.uniform(0.3, 0.7) * end + aside, end])
    return _chain(robot, rows, state, i, path, [h.size * skew_section(rng, part) for part in np.diff(path, axis=0)])


def tapered_beam(h: Hidden, robot: Robot, rows: Rows, state: State) -> Motion:
    """A straight link that bends alike in all directions; size is 1/EI at its joint, and extra times that more at its end."""
    length, along = beam(robot, h.joint - 1)
    places = np.linspace(0, 1, 13)
    thin = 1 + float(h.extra) * (places[1:] + places[:-1]) / 2
    across = np.eye(3) - np.outer(along, along)
    return _chain(
        robot, rows, state, h.joint - 1, length * np.outer(places, along), list(h.size * thin[:, None, None] * across)
    )


def _chain(robot: Robot, rows: Rows, state: State, i: int, path: Array, soft: list[Array]) -> Motion:
    """The motion of a link's end that is a chain of beams (see bent), under what it carries and its own weight."""
    shift, turn = bent(path, soft, state.tip_force[:, i], state.tip_moment[:, i])
    length, along = beam(robot, i)
    ends = path @ along
    for place, force, moment in own_weight(robot, state, i, length, along):
        k = int(np.clip(np.searchsorted(ends, place), 1, len(soft)))
        point = path[k - 1] + (place - ends[k - 1]) / (ends[k] - ends[k - 1]) * (path[k] - path[k - 1])
        sag, slope = bent(np.array([*path[:k], point]), soft, force, moment)
        shift, turn = shift + sag + np.cross(slope, path[-1] - point), turn + slope
    motion = Motion.none(len(rows), robot.n)
    motion.tip[:, i] = np.concatenate([shift, turn], axis=1)
    return motion


def own_weight(robot: Robot, state: State, i: int, length: float, along: Array) -> list[tuple[float, Array, Array]]:
    """A link's weight in pieces: place along its line [m], force, and moment about the line there (rows, 3), in its frame.

    It is spread evenly about its centre as far as the nearer end of the line; what lies beyond the far end acts there, and a
    centre behind the joint bends nothing.
    """
    weight = robot.mass[i] * WEIGHT @ state.frames.links[i][:, :3, :3]
    centre = robot.com[i] + np.array([0.0, 0.0, robot.d[..., i].mean()])
    middle = float(np.clip(centre @ along, 0.0, length))
    half = min(middle, length - middle)
    pieces = 50
    aside = np.cross(centre - middle * along, weight)
    places = middle + half * (2 * (np.arange(pieces) + 0.5) / pieces - 1)
    return [(place, weight / pieces, aside / pieces) for place in places]


def _to_the_wrist(robot: Robot, i: int) -> tuple[Array, Array]:
    """From a link's joint to the far end of the next joint's offset, and the last part of it, along that joint's axis."""
    beyond = robot.d[i + 1] * np.array([0.0, -np.sin(robot.alpha[i + 1]), np.cos(robot.alpha[i + 1])])
    return np.array([robot.a[i + 1], 0.0, robot.d[i]]) + beyond, beyond


def beam(robot: Robot, i: int) -> tuple[float, Array]:
    """Length and direction of a link in its own frame, from its joint's origin to the next joint's."""
    line = np.array([robot.a[..., i + 1].mean() if i + 1 < robot.n else 0.0, 0.0, robot.d[..., i].mean()])
    length = float(np.linalg.norm(line))
    return length, line / length


def bent(path: Array, soft: list[Array], force: Array, moment: Array) -> tuple[Array, Array]:
    """Shift and turn (rows, 3) of the end of a chain of straight beams under force and moment (rows, 3) at its end.

    path has the beams' ends, the first of them held; soft is each one's curvature per moment, symmetric (3, 3). At every point
    the moment carried is that of the end and of the force on its lever, and the curvature there turns what lies beyond.
    """
    shift, turn = np.zeros(force.shape), np.zeros(force.shape)
    places, weights = np.polynomial.legendre.leggauss(4)
    for start, end, section in zip(path[:-1], path[1:], soft, strict=False):
        for place, weight in zip((places + 1) / 2, weights / 2, strict=True):
            lever = path[-1] - (start + place * (end - start))
            curved = weight * np.linalg.norm(end - start) * (moment + np.cross(lever, force)) @ section
            turn += curved
            shift += np.cross(curved, lever)
    return shift, turn


def round_tube(along: Array) -> Array:
    """Curvature per moment (3, 3) of a round tube with EI = 1."""
    unit = along / np.linalg.norm(along)
    return np.eye(3) + (SHEAR - 1) * np.outer(unit, unit)


def skew_section(rng: np.random.Generator, along: Array) -> Array:
    """The same of a section two to five times softer about a drawn axis across than about the other."""
    unit = along / np.linalg.norm(along)
    across = np.cross(unit, rng.normal(size=3))
    across /= np.linalg.norm(across)
    return round_tube(along) + rng.uniform(1, 4) * np.outer(across, across)


ON_MOTION = {
    "link-bending": link_bending,
    "link-torsion": link_torsion,
    "oblique-beam": oblique_beam,
    "tapered-beam": tapered_beam,
}
