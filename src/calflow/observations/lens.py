"""Lens: projection of points to an image with Brown's distortion model or a fisheye's, and its inverse.

Brown: D. C. Brown, Close-range camera calibration, Photogrammetric Engineering 37 (1971); fisheye: J. Kannala and S. Brandt, IEEE
Trans. PAMI 28 (2006). Both in the form and order of OpenCV's coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

Model = Literal["brown", "fisheye"]
DISTORTION: dict[Model, tuple[str, ...]] = {
    "brown": ("k1", "k2", "p1", "p2", "k3"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
ON_AXIS = 1e-16  # added to a squared tangent: a fisheye's angle over its tangent has no derivative at zero
NEWTON_ROUNDS = 20  # Newton iterations of the inverse
INVISIBLE = 1e-9  # determinant below which the distortion model folds back


@dataclass(frozen=True)
class Lens:
    """Camera intrinsics: focal lengths and principal point [px], and distortion coefficients (see `DISTORTION`)."""

    model: Model = "brown"
    focal: tuple[float, float] = (1.0, 1.0)
    centre: tuple[float, float] = (0.0, 0.0)
    distortion: tuple[float, ...] = ()

    @property
    def figures(self) -> np.ndarray:
        """All intrinsics as a vector (4 + n,): fx, fy, cx, cy, then the coefficients."""
        missing = len(DISTORTION[self.model]) - len(self.distortion)
        return np.array([*self.focal, *self.centre, *self.distortion, *[0.0] * missing])

    @property
    def symbols(self) -> tuple[str, ...]:
        """Names of the intrinsics, in the order of `figures`."""
        return ("fx", "fy", "cx", "cy", *DISTORTION[self.model])

    def image(self, points: np.ndarray) -> np.ndarray:
        """Return the images (n, 2) [px] of points (n, 3) [m] in the camera's frame."""
        point, figures = ca.SX.sym("x", 3), ca.SX.sym("f", len(self.figures))
        function = ca.Function("image", [point, figures], [projected(self.model, point, figures)])
        return np.array(function(np.asarray(points, float).T, ca.DM(self.figures))).T

    def rays(self, image: np.ndarray) -> np.ndarray:
        """Return the directions (x / z, y / z), (n, 2), of the rays through image points (n, 2) [px], by Newton's method."""
        tangent, figures = ca.SX.sym("x", 2), ca.SX.sym("f", len(self.figures))
        seen = projected(self.model, ca.vertcat(tangent, 1), figures)
        function = ca.Function("back", [tangent, figures], [seen, ca.jacobian(seen, tangent)])
        image = np.asarray(image, float)
        ray = (image - self.centre) / self.focal
        for _ in range(NEWTON_ROUNDS):
            there, by_tangent = function(ray.T, ca.DM(self.figures))
            slope = np.array(by_tangent).reshape(2, -1, 2).transpose(1, 0, 2)
            singular = np.abs(np.linalg.det(slope)) < INVISIBLE
            slope[singular] = np.diag(self.focal)
            step = np.linalg.solve(slope, (image - np.array(there).T)[:, :, None])[:, :, 0]
            ray = ray + np.clip(step, -0.5, 0.5)
            if np.abs(step).max(initial=0.0) < 1e-13:
                break
        return ray


def slopes(model: Model, points: np.ndarray, figures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the Jacobians of the images of points (n, 3) by the points, (n, 2, 3) [px/m], and by the lens' figures, (n, 2, m)."""
    point, lens = ca.SX.sym("x", 3), ca.SX.sym("f", figures.shape[1])
    image = projected(model, point, lens)
    function = ca.Function(
        "slopes", [point, lens], [ca.vec(ca.densify(ca.jacobian(image, by))) for by in (point, lens)]
    )
    by_point, by_lens = (np.array(slope).T for slope in function(points.T, figures.T))
    return by_point.reshape(-1, 3, 2).transpose(0, 2, 1), by_lens.reshape(len(points), -1, 2).transpose(0, 2, 1)


def projected(model: Model, point: ca.SX, figures: ca.SX) -> ca.SX:
    """Return the image (2,) [px] of a point (3,) [m] in the camera's frame; figures as in `Lens.figures`."""
    x, y = point[0] / point[2], point[1] / point[2]
    squared = x * x + y * y
    if model == "fisheye":
        tangent = ca.sqrt(squared + ON_AXIS)
        angle = ca.atan(tangent)
        series = sum(figures[4 + k] * angle ** (2 * k + 2) for k in range(4))
        stretched = angle / tangent * (1 + series)
        bent_x, bent_y = stretched * x, stretched * y
    else:
        k1, k2, p1, p2, k3 = ca.vertsplit(figures[4:])
        radial = 1 + squared * (k1 + squared * (k2 + squared * k3))
        bent_x = radial * x + 2 * p1 * x * y + p2 * (squared + 2 * x * x)
        bent_y = radial * y + p1 * (squared + 2 * y * y) + 2 * p2 * x * y
    return figures[2:4] + figures[:2] * ca.vertcat(bent_x, bent_y)
