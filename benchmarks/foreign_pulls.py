"""Pulls of hoses, cables and balancers on the arms of foreign_physics: where they are held, and how hard they pull.

Each is a force at a point of a link, in equilibrium with one at the base or at a link before; joints between the two give way.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from foreign_physics import Arm, Array, Frame, Rows, State, Yielding


class Drawn(Protocol):
    """A form in its place: the joint's index, the force's size [N], and figures that are always drawn the same."""

    @property
    def i(self) -> int:
        """The index of the link that is pulled, or of the joint that is turned."""

    @property
    def size(self) -> float:
        """Its size."""

    @property
    def rng(self) -> np.random.Generator:
        """A generator that always draws the same figures."""


def balancer_aside(h: Drawn, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A balancer on a trolley beside the arm's axis, that pulls as hard wherever the link is."""
    way = _hung(h, arm, h.rng.uniform([0.1, -0.5, 0.8], [0.6, 0.5, 1.6])) - now.tips[h.i].place
    return _pulled(arm, now, h.i, now.tips[h.i].place, h.size * _unit(way))


def hanging_hose(h: Drawn, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A hose that sags between a post and the link's end: half its weight hangs there, and it pulls more where it sags less."""
    rng, end = h.rng, now.tips[h.i].place
    way = _hung(h, arm, rng.uniform([-0.3, -0.4, 0.4], [0.1, 0.4, 1.0])) - end
    chord = np.linalg.norm(way, axis=1)
    spare = rng.uniform(1.05, 1.3) * chord.max() - chord
    tension = chord / 8 / np.sqrt(3 / 8 * chord * spare)  # of a flat parabola, in weights
    return _pulled(arm, now, h.i, end, h.size * (tension[:, None] * _unit(way) - [0, 0, 0.5]))


def taut_hose(h: Drawn, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A hose from behind that is slack, but where the link is far: there it pulls as a spring does."""
    rng, end = h.rng, now.tips[h.i].place
    way = _hung(h, arm, rng.uniform([-0.4, -0.4, 0.0], [0.0, 0.4, 0.6])) - end
    length = np.linalg.norm(way, axis=1)
    beyond = np.maximum(length - np.quantile(length, rng.uniform(0.2, 0.5)), 0) / _reach(arm)
    return _pulled(arm, now, h.i, end, h.size * beyond[:, None] * _unit(way))


def hose_from_below(h: Drawn, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A hose from a reel on the floor beside the robot, that pulls harder as it is drawn out."""
    rng, end = h.rng, now.tips[h.i].place
    way = rng.uniform([-0.3, -0.6, 0.0], [0.5, 0.6, 0.1]) * _reach(arm) - end
    out = 1 + rng.uniform(0.2, 0.6) * np.linalg.norm(way, axis=1, keepdims=True) / _reach(arm)
    return _pulled(arm, now, h.i, end, h.size * out * _unit(way))


def hose_at_elbow(h: Drawn, arm: Arm, rows: Rows, now: State) -> Yielding:
    """A hose from beside the elbow to the flange, beside its axis: a spring that no joint before the elbow feels."""
    rng, elbow = h.rng, arm.n // 2 - 1 + arm.n % 2
    held = now.links[elbow].at(_reach(arm) * rng.uniform(-0.1, 0.1, 3))
    end = now.tips[-1].at(_reach(arm) * np.append(rng.uniform(-0.06, 0.06, 2), 0))
    return _pulled(arm, now, arm.n - 1, end, h.size / _reach(arm) * (held - end), elbow + 1)


def hose_at_flange(h: Drawn, arm: Arm, rows: Rows, now: State) -> Yielding:
    """Hoses from above to the side of the flange, that pull as hard wherever it is."""
    rng = h.rng
    end = now.tips[-1].at(_reach(arm) * np.append(rng.uniform(-0.06, 0.06, 2), 0))
    way = _hung(h, arm, rng.uniform([0.0, -0.3, 0.5], [0.4, 0.3, 1.2])) - end
    return _pulled(arm, now, arm.n - 1, end, h.size * _unit(way))


def wound_hose(h: Drawn, arm: Arm, rows: Rows, now: State) -> Yielding:
    """Hoses wound about a wrist's joint, that turn it back the harder, the farther they are wound up; size is their torque [Nm]."""
    rng = h.rng
    wound = (rows.q[:, h.i] - rng.uniform(-0.5, 0.5)) / np.pi
    torque = -h.size * (wound + rng.uniform(0.3, 1.0) * wound**3)
    given = Yielding.none(len(rows), arm.n)
    given.joint[:, h.i] = arm.compliance[h.i] * torque
    return given


def _reach(arm: Arm) -> float:
    """About how far the flange gets from joint 2 [m]."""
    return float(np.abs(arm.a[2:]).sum() + np.abs(arm.d[1:]).sum())


def _hung(h: Drawn, arm: Arm, place: Array) -> Array:
    """A place in the base frame (3,) by its distance from the shoulder in arm's reaches."""
    return np.array([0, 0, arm.d[0]]) + place * _reach(arm)


def _unit(way: Array) -> Array:
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def _pulled(arm: Arm, now: State, link: int, at: Array, force: Array, first: int = 0) -> Yielding:
    """The joints from the first one to a link (from 0) give way to a force (rows, 3) at points (rows, 3) of that link."""
    given = Yielding.none(len(at), arm.n)
    for i in range(first, link + 1):
        given.joint[:, i] = arm.compliance[i] * _about(now.joints[i], at, force)
    return given


def _about(joint: Frame, at: Array, force: Array) -> Array:
    """The torque (rows,) of a force about a joint's axis."""
    return (np.cross(at - joint.place, force) * joint.turn[:, :, 2]).sum(axis=1)
