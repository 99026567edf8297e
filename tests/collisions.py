"""Collisions and lines of sight by pinocchio's kinematics and coal's distances, and cells to check."""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from calflow.design.cell import Box, Cell, CellStation, Cylinder, checked_pairs, standing_lines
from calflow.design.skeleton import skeleton_lines
from robots import ASKEW, industrial, pinocchio_model, ur10

STATION = CellStation(
    (4.0, 1.0, 1.2), range_min=1.0, range_max=6.0, elevation_min=np.deg2rad(-30), elevation_max=np.deg2rad(25)
)
BIG = Cell(
    stations=(STATION, CellStation((3.0, -4.5, 2.0))),
    reflector_axis=(0.3, 0.0, 1.0),
    acceptance=np.deg2rad(100),
    link_radii=(0.25, 0.2, 0.16, 0.16, 0.12, 0.1),
    tool_radius=0.05,
    clearance=0.02,
    floor=0.1,
    boxes=(Box((0.9, -0.4, 0.0), (2.0, 0.3, 0.8)), Box((-1.5, 1.0, 0.0), (0.0, 1.8, 2.0))),
    cylinders=(Cylinder((0.6, -1.5, 0.0), (0.9, -1.5, 2.5), 0.2),),
)
SMALL = replace(
    BIG,
    link_radii=None,
    boxes=(Box((0.4, -0.4, 0.0), (0.9, 0.3, 0.3)), Box((-0.9, 0.4, 0.0), (0.0, 0.9, 1.0))),
    cylinders=(Cylinder((0.3, -0.7, 0.0), (0.4, -0.7, 1.2), 0.1),),
    floor=-0.05,
)


def capsule(start, end, radius):
    """A capsule of coal between two points."""
    way = end - start
    length = np.linalg.norm(way)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), way).matrix() if length > 1e-9 else np.eye(3)
    return coal.Capsule(radius, length), coal.Transform3s(turn, (start + end) / 2)


def box(one):
    """A box of coal."""
    low, high = np.array(one.min), np.array(one.max)
    return coal.Box(*(high - low)), coal.Transform3s(np.eye(3), (low + high) / 2)


def cylinder(one):
    """A cylinder of coal, its ends rounded."""
    return capsule(np.array(one.start), np.array(one.end), one.radius)


def apart(one, other):
    """The distance of two of coal's shapes [m], negative where they meet."""
    return coal.distance(*one, *other, coal.DistanceRequest(), coal.DistanceResult())


class Outside:
    """A robot's joints by pinocchio, and what of a cell coal and plain trigonometry say."""

    def __init__(self, robot, cell):
        self.robot, self.cell = robot, cell
        self.model = pinocchio_model(robot, next(iter(robot.payloads)))
        self.data = self.model.createData()
        turn = Rotation.from_euler("XYZ", robot.base.rotation).as_matrix()
        self.stands = pin.SE3(turn, np.array(robot.base.origin))
        self.drawn = [box(one) for one in cell.boxes] + [cylinder(one) for one in cell.cylinders]

    def room(self, q):
        """The least of how far each of range, elevation, acceptance, links, surroundings and sight are from refusing [m or rad]."""
        cell, robot = self.cell, self.robot
        pin.framesForwardKinematics(self.model, self.data, q)
        origins = [
            self.data.oMi[k + 1].act(np.array([0, 0, -joint.frame.figures["d"]]))
            for k, joint in enumerate(robot.joints)
        ]
        flange, tool = (self.data.oMf[self.model.getFrameId(name)] for name in ("flange", "E"))
        chain = [np.zeros(3), *origins, flange.translation, tool.translation]
        radii = [*cell.radii(robot), cell.tool_radius]
        capsules = [capsule(a, b, r) for a, b, r in zip(chain[:-1], chain[1:], radii, strict=True)]
        lines = skeleton_lines(robot, robot.n_joints)
        pairs = checked_pairs(cell, robot, lines)
        found = {"links": min(apart(capsules[i], capsules[j]) - cell.clearance for i, j in pairs)}
        frame = pin.SE3.Identity() if cell.frame == "base" else self.stands
        free = [k for k in range(len(capsules)) if k not in standing_lines(robot, lines)]
        placed = [capsule(frame.act(chain[k]), frame.act(chain[k + 1]), radii[k]) for k in free]
        lowest = min(min(frame.act(chain[k])[2], frame.act(chain[k + 1])[2]) - radii[k] for k in free)
        near = min(apart(one, thing) for one in placed for thing in self.drawn)
        found["around"] = min(near, lowest - cell.floor) - cell.clearance
        for station in cell.stations:
            eye, reflector = np.array(station.origin), self.stands.act(tool.translation)
            away = np.linalg.norm(reflector - eye)
            height = np.arctan2(reflector[2] - eye[2], np.hypot(*(reflector - eye)[:2]))
            axis = self.stands.rotation @ flange.rotation @ np.array(cell.reflector_axis)
            aside = np.arctan2(np.linalg.norm(np.cross(axis, eye - reflector)), axis @ (eye - reflector))
            light = capsule(reflector, eye, 1e-9)
            drawn = capsule(*(frame.act(self.stands.actInv(point)) for point in (reflector, eye)), 1e-9)
            links = [capsule(self.stands.act(a), self.stands.act(b), r)
                     for a, b, r in zip(chain[:-2], chain[1:-1], radii[:-1], strict=True)]  # fmt: skip
            sight = [apart(light, one) for one in links] + [apart(drawn, thing) for thing in self.drawn]
            rooms = (
                away - station.range_min,
                station.far - away,
                height - station.elevation_min,
                station.elevation_max - height,
            )
            for name, room in zip(("range", "range", "elevation", "elevation", "acceptance", "sight"),
                                  (*rooms, cell.acceptance - aside, min(sight)), strict=True):  # fmt: skip
                found[name] = min(found.get(name, np.inf), room)
        return found


CASES = {
    "industrial": (industrial, BIG),
    "ur10": (ur10, SMALL),
    "askew": (lambda: replace(industrial(), base=ASKEW), replace(BIG, frame="measuring", floor=0.3)),
}
