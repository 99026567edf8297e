"""What of a cell has a slope: range, elevation and acceptance, as bounds of expressions that IPOPT can keep to."""

from __future__ import annotations

import casadi as ca
import numpy as np

from calflow.design.cell.cell import Cell
from calflow.design.cell.skeleton import reflector
from calflow.robot.robot import Robot
from calflow.robot.transforms import placement


def bounded(cell: Cell, robot: Robot, marker: str, q: ca.SX) -> tuple[list[ca.SX], list[np.ndarray]]:
    """Return expressions of driven joint angles q (n_joints,), each (n,), and the bounds of each, (n, 2) [m, or of a cosine]."""
    point, flange = reflector(robot, marker, q)
    stands = placement(ca.DM([*robot.base.origin, *robot.base.rotation]))
    place, axis = stands[:3, :3] @ point + stands[:3, 3], stands[:3, :3] @ flange @ ca.DM(cell.reflector_axis)
    held: list[ca.SX] = []
    bounds: list[np.ndarray] = []
    for station in cell.stations:
        way = place - ca.DM(station.origin)
        distance = ca.norm_2(way)
        held.append(ca.vertcat(distance, way[2] / distance))
        bounds.append(np.array([[station.near, station.far], np.sin([station.lowest, station.highest])]))
        if cell.acceptance is not None:
            held.append(-ca.dot(way, axis) / distance / np.linalg.norm(cell.reflector_axis))
            bounds.append(np.array([[np.cos(cell.acceptance), np.inf]]))
    return held, bounds
