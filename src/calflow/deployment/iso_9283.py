"""ISO 9283: pose accuracy and pose repeatability, and the five poses of its test cube.

Formulas of ISO 9283:1998, clauses 7.2 (pose accuracy AP) and 7.3 (pose repeatability RP); poses of clause 6.
"""

from __future__ import annotations

import numpy as np

CYCLES = 30  # times that the standard has each pose attained
ALIKE = 0.05  # share by which distances may be off, and poses still count as placed as the standard says
INSET = 0.8  # share of a diagonal that is left between two poses, 10 % from either end
DIAGONAL, LONG, SHORT = np.sqrt([3.0, 2.0, 1.0])  # of a cube with edges of 1: diagonals of cube and of face, edge


def pose_accuracy(attained: np.ndarray, command: np.ndarray) -> float:
    """Return AP: the distance between the command (3,) and the barycentre of the attained positions (n, 3), in their unit.

    Of angles (n, 3) about three axes it is that of their mean; the standard states each axis apart.
    """
    return float(np.linalg.norm(attained.mean(axis=0) - command))


def pose_repeatability(attained: np.ndarray) -> float:
    """Return RP = mean + 3 S of the distances from attained positions (n, 3) to their barycentre, in their unit.

    S is the distances' standard deviation with n - 1 degrees of freedom; nan of a single position.
    """
    if len(attained) < 2:
        return float("nan")
    distance = np.linalg.norm(attained - attained.mean(axis=0), axis=1)
    return float(distance.mean() + 3 * distance.std(ddof=1))


def angle_repeatability(attained: np.ndarray) -> np.ndarray:
    """Return RP of orientations: 3 S of each of the attained angles (n, 3), in their unit; nan of a single one."""
    if len(attained) < 2:
        return np.full(3, np.nan)
    return np.asarray(3 * attained.std(axis=0, ddof=1))


def cube_poses(centre: np.ndarray, edge: float) -> np.ndarray:
    """Return P1 to P5 (5, 3) of a cube with its centre (3,) and edges along the axes, in the plane C1-C2-C7-C8.

    P1 is the centre, the others lie on the plane's diagonals, a tenth of their length from the ends.
    """
    corners = np.array([(1, 1, 1), (1, -1, 1), (-1, -1, -1), (-1, 1, -1)])
    return np.vstack([centre, centre + 0.5 * INSET * edge * corners])


def cube_edge(points: np.ndarray) -> float:
    """Return the edge of the cube in whose inclined plane five points (5, 3) lie as the standard says; nan where they do not."""
    if len(points) != 5:
        return float("nan")
    centre = int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))
    others = np.delete(points, centre, axis=0)
    apart = np.sort(np.linalg.norm(others[:, None] - others[None], axis=2)[np.triu_indices(4, 1)])
    edge = float(apart[4:].mean() / (INSET * DIAGONAL))
    expected = INSET * edge * np.repeat([SHORT, LONG, DIAGONAL], 2)
    out = np.linalg.norm(points[centre] - others.mean(axis=0))
    right = edge > 0 and (np.abs(apart - expected) < ALIKE * expected).all() and out < ALIKE * edge
    return edge if right else float("nan")
