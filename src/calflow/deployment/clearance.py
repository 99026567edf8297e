"""Clearance: how far commands stay from the joints' limits, and from poses at which the tool cannot be moved in some direction."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from calflow.deployment.nominal_inverse import room
from calflow.model import Model, over_rows
from calflow.robot.transforms import turning


@dataclass(frozen=True)
class Clearance:
    """How far poses are from what a robot cannot do.

    joint (n,) is the joint (from 0) nearest to a limit, by share of its travel, and limit (n,) [rad, or m] how far it is from it;
    singular (n,) [rad, a slide's metre counted as a radian] is how far all joints together are from the nearest singularity.
    """

    joint: np.ndarray
    limit: np.ndarray
    singular: np.ndarray


def clearance(model: Model, rows: np.ndarray, oriented: bool) -> Clearance:
    """Return the clearance of packed rows (n_conditions, n) by the nominal robot.

    The distance to a singularity is that to first order: the least singular value of the tool's Jacobian over its steepest
    slope. It is right near a singularity, and elsewhere says that there is none near. Where no orientation is asked for,
    only the Jacobian of the tool's point counts.
    """
    robot = model.robot
    q = rows[: robot.n_joints].T @ robot.reading_matrix.T
    share = room(robot, q)
    joint = share.argmin(axis=1)
    low, high = robot.stops.T
    limit = np.take_along_axis(np.minimum(q - low, high - q), joint[:, None], axis=1)[:, 0]
    return Clearance(joint, limit, _to_singularity(Model(robot, (), model.given), rows, oriented))


def _to_singularity(rigid: Model, rows: np.ndarray, oriented: bool) -> np.ndarray:
    p, c, predicted = rigid.symbols
    readings = c[: rigid.robot.n_joints]
    moved = np.where(np.isin(np.arange(rigid.robot.n_joints), rigid.robot.external), 0.0, 1.0)
    mixed = ca.sparsify(ca.DM(rigid.robot.angle_matrix * moved))
    slope = ca.jacobian(predicted.point, readings) @ mixed
    if oriented:
        slope = ca.vertcat(slope, turning(predicted.rotation, readings) @ mixed)
    u, v = ca.SX.sym("u", slope.shape[0]), ca.SX.sym("v", slope.shape[1])
    steepest = ca.gradient(ca.dot(u, slope @ v), readings).T @ mixed
    jacobian = ca.Function("jacobian", [p, c], [ca.densify(slope.T)])
    change = ca.Function("change", [p, c, ca.vertcat(u, v)], [ca.densify(steepest.T)])
    none = np.zeros(0)
    found = over_rows(jacobian, none, rows)[0].T.reshape(rows.shape[1], *slope.shape)
    left, sizes, right = np.linalg.svd(found, full_matrices=False)
    directions = np.hstack([left[:, :, -1], right[:, -1]])
    slopes = np.linalg.norm(over_rows(change, none, rows, directions.T)[0], axis=0)
    return np.asarray(np.divide(sizes[:, -1], slopes, out=np.full(len(slopes), np.inf), where=slopes > 0))
