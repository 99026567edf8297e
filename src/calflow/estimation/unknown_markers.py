"""Markers anywhere on the tool: where those are whose places nobody knows, from the flange's nominal poses alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from calflow.measurements.measurements import Measurements
from calflow.model import build
from calflow.robot.parts import Base, vector
from calflow.robot.robot import Robot

ROUNDS = 8  # of weights with which rows that are far off hardly count
NEAR = 1e-3  # m: below it rows count alike


def with_markers(robot: Robot, train: Measurements) -> Robot:
    """Return the robot with its unknown markers where positions in the measuring frame put them.

    A marker m on the flange (p, R) is seen at y = B (p + R m) + b. With the base known that is a mean; else Bᵀ y - R m - Bᵀ b = p
    is linear in Bᵀ, m and Bᵀ b, and B is left free here. Markers known beside the first go with it. Where rows are too few, or
    the flange turns too little, markers stay where the robot file has them.
    """
    places = _places(robot)
    if not any(place >= 0 for place in places):
        return robot
    bare = replace(robot, base=Base(), tool_rotation=None,
                   markers={name: replace(marker, point=(0.0, 0.0, 0.0)) for name, marker in robot.markers.items()})  # fmt: skip
    model = build(bare, (), train.given)
    rows = train.on(bare).rows
    flange, turned = model.point(model.nominal, rows), model.rotation(model.nominal, rows)
    names = list(robot.markers)
    which = np.array([names.index(name) for name in train.table["marker"]])
    stated = np.array([marker.point for marker in robot.markers.values()])
    found = _solved(
        robot, places, which, train.position, flange + np.einsum("nij,nj->ni", turned, stated[which]), turned
    )
    moved = {
        name: replace(marker, point=vector(stated[k] + found[places[k]])) if places[k] >= 0 else marker
        for k, (name, marker) in enumerate(robot.markers.items())
    }
    return replace(robot, markers=moved)


def _places(robot: Robot) -> list[int]:
    """The number of the unknown shift of each marker, -1 where there is none."""
    found: list[int] = []
    for marker in robot.markers.values():
        own = max(found, default=-1) + 1
        found.append(found[0] if marker.relative_sd else -1 if marker.known else own)
    return found


def _solved(
    robot: Robot, places: list[int], which: np.ndarray, position: np.ndarray, nominal: np.ndarray, turned: np.ndarray
) -> np.ndarray:
    """The markers' shifts from their stated places (n_places, 3), zero where the rows do not tell them."""
    n_places = max(places) + 1
    of_row = np.array(places)[which]
    shifts = np.zeros((len(which), 3, 3 * n_places))
    for k in range(n_places):
        shifts[of_row == k, :, 3 * k : 3 * k + 3] = turned[of_row == k]
    if robot.base.known:
        stands = Rotation.from_euler("XYZ", robot.base.rotation)
        matrix, wanted = shifts, stands.inv().apply(position - np.array(robot.base.origin)) - nominal
    else:
        base = np.einsum("ij,nk->nijk", np.eye(3), position).reshape(-1, 3, 9)
        there = np.broadcast_to(np.eye(3), (len(which), 3, 3))
        matrix, wanted = np.concatenate([-shifts, base, -there], axis=2), nominal
    weight = np.ones(len(which))
    solution = np.zeros(matrix.shape[2])
    for _ in range(ROUNDS):
        weighted = (weight[:, None, None] * matrix).reshape(-1, matrix.shape[2])
        if np.linalg.matrix_rank(weighted, tol=1e-6 * np.linalg.norm(weighted, 2)) < weighted.shape[1]:
            return np.zeros((n_places, 3))
        solution = np.linalg.lstsq(weighted, (weight[:, None] * wanted).ravel(), rcond=None)[0]
        weight = 1 / np.sqrt(np.maximum(np.linalg.norm(matrix @ solution - wanted, axis=1), NEAR))
    return solution[: 3 * n_places].reshape(n_places, 3)
