"""Refinement: continuous optimisation of chosen poses by IPOPT on the model's graph, within limits and region.

Differentiable constraints of a cell (range, elevation, acceptance angle) are bounds of expressions in the problem.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from calflow.design.cell import lines_of_sight
from calflow.design.optimality import Criterion, information
from calflow.design.planned import SelectionRequest
from calflow.design.skeleton import reflector
from calflow.model import Model
from calflow.robot.mechanism import DEAD_POINT

ITERATIONS = 60
STEP_SHARES = (1.0, 0.5, 0.25, 0.1)  # shares of a step tried, since constraints unknown to IPOPT may forbid it
NEARBY = 0.3  # rad or m: trust region of a joint in a cell, whose collisions IPOPT ignores
MARGIN = 1e-6  # rad, m or cosine: above IPOPT's tolerance of bounds
OPTIONS: dict[str, Any] = {
    "ipopt.hessian_approximation": "limited-memory",
    "ipopt.max_iter": ITERATIONS,
    "ipopt.tol": 1e-5,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "print_time": False,
}


def refined_poses(
    model: Model, request: SelectionRequest, readings: np.ndarray, prior: np.ndarray, criterion: Criterion
) -> np.ndarray:
    """Return joint readings (n_poses, n_joints) near those given with a smaller loss; the same if none are found.

    A pose that ends at a forbidden place (beyond a loop's dead point, or rejected by the cell) is reset, and so are all if that
    costs more than was gained. If one was reset, each takes the largest admissible share of its step that lowers the loss.
    """
    slope = _slope(model, request)
    if slope is None:
        return readings
    solver, bounds = _program(model, request, slope, prior, criterion, len(readings))
    far = np.inf if request.cell is None else NEARBY
    start = readings.ravel()
    solution = np.array(solver(x0=start, lbx=start - far, ubx=start + far, **bounds)["x"]).reshape(readings.shape)

    def loss(poses: np.ndarray) -> float:
        return criterion.loss(np.linalg.inv(information(request.whitened(model, poses), prior)))

    whole = request.allowed(model, solution)
    best = min(readings, np.where(whole[:, None], solution, readings), key=loss)
    for share in STEP_SHARES if not whole.all() else ():
        part = readings + share * (solution - readings)
        for k in np.flatnonzero(request.allowed(model, part)):
            moved = best.copy()
            moved[k] = part[k]
            best = min(best, moved, key=loss)
    return best


def _slope(model: Model, request: SelectionRequest) -> ca.Function | None:
    """Return the function readings -> a pose's whitened, scaled Jacobian, transposed; None if reports matter."""
    p, _, _ = model.symbols
    y, error = model.error(request.planned.observation)
    jacobian = ca.jacobian(error, p) * (model.prior_sd[None] / request.planned.sd[:, None])
    if ca.depends_on(jacobian, y):
        return None
    whole = ca.Function("whole", [*model.symbols[:2], y], [ca.densify(jacobian.T)])
    q = ca.SX.sym("q", model.robot.n_joints)
    return ca.Function("slope", [q], [whole(model.nominal, _packed(model, request, q), 0)])


def _packed(model: Model, request: SelectionRequest, q: ca.SX) -> ca.SX:
    fixed = request.rows(model, np.zeros((1, model.robot.n_joints)))[model.robot.n_joints :]
    return ca.vertcat(q, ca.DM(fixed))


def _program(
    model: Model, request: SelectionRequest, slope: ca.Function, prior: np.ndarray, criterion: Criterion, n: int
) -> tuple[ca.Function, dict[str, np.ndarray]]:
    """Return IPOPT's problem of all poses, and its bounds: joint limits, region, dead points, lines of sight."""
    robot = model.robot
    q = ca.SX.sym("q", robot.n_joints)
    predicted = ca.Function("predicted", list(model.symbols[:2]), [model.symbols[2].point, model.symbols[2].closure])
    point, cosine = predicted(model.nominal, _packed(model, request, q))
    held, limits = [ca.DM(robot.reading_matrix) @ q], [robot.limits]
    if request.region is not None:
        held, limits = [*held, point], [*limits, request.region.T]
    if robot.loop is not None:
        held, limits = [*held, cosine], [*limits, np.array([[-DEAD_POINT, DEAD_POINT]])]
    if request.cell is not None:
        seen, flange = reflector(robot, request.marker, ca.DM(robot.reading_matrix) @ q)
        for _, value, within in lines_of_sight(request.cell, robot, seen, flange):
            held, limits = [*held, value], [*limits, np.array([within])]
    constraints = ca.Function("constraints", [q], [ca.vertcat(*held)])

    matrix = ca.SX.sym("matrix", *prior.shape)
    upper = ca.chol(matrix)
    if criterion.root.shape[1]:
        value = ca.log(ca.sumsqr(ca.solve(upper.T, ca.DM(criterion.root)))) / 2
    else:
        value = -ca.sum1(ca.log(ca.diag(upper))) / len(prior)
    loss = ca.Function("loss", [matrix], [value])

    poses = ca.MX.sym("poses", robot.n_joints, n)
    slopes = slope.map(n)(poses)
    problem: dict[str, Any] = {
        "x": ca.vec(poses),
        "f": loss(ca.DM(prior) + slopes @ slopes.T),
        "g": ca.vec(constraints.map(n)(poses)),
    }
    inside = np.vstack(limits) + np.array([MARGIN, -MARGIN])
    lower, most = np.tile(inside, (n, 1)).T
    return ca.nlpsol("refinement", "ipopt", problem, OPTIONS), {"lbg": lower, "ubg": most}
