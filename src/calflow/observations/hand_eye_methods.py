"""The usual closed-form solutions of hand-eye calibration, A X = X B over all pairs of poses, for comparison.

R. Tsai and R. Lenz, IEEE Trans. Robotics and Automation 5 (1989); F. Park and B. Martin, ibid. 10 (1994); R. Horaud and
F. Dornaika, Int. J. Robotics Research 14 (1995); N. Andreff, R. Horaud and B. Espiau, 3DIM (1999); K. Daniilidis, Int. J. Robotics
Research 18 (1999). They are the five of OpenCV 4, under its names; pairs with a relative rotation of nearly zero, or of nearly
half a turn, whose axis is ambiguous, are left out.
"""

from __future__ import annotations

import numpy as np

from calflow.files.deferred import Rotation
from calflow.robot.frames import crossing

NO_TURN, HALF_TURN = np.deg2rad(0.1), np.deg2rad(170)  # outside this range a rotation's axis is ill-determined
METHODS = ("Tsai", "Park", "Horaud", "Andreff", "Daniilidis")


def camera_by(method: str, motion: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the camera's pose X (4, 4) on its link by one of METHODS.

    Args:
        method: name of the method, one of METHODS.
        motion: the camera's link in the frame of the target's, (n, 4, 4) [m].
        seen: the target in the camera's frame, (n, 4, 4) [m]: motion X seen is the same in all images.

    Raises:
        ValueError: the method fails.
    """
    first, other = np.triu_indices(len(motion), 1)
    a = np.linalg.inv(motion[other]) @ motion[first]
    b = seen[other] @ np.linalg.inv(seen[first])
    turned = np.array([np.linalg.norm(_rotvecs(frames), axis=1) for frames in (a, b)])
    kept = (turned > NO_TURN).all(axis=0) & (turned < HALF_TURN).all(axis=0)
    if kept.sum() < 2:
        raise ValueError("no two pairs of images that are turned against each other")
    a, b = a[kept], b[kept]
    camera = np.eye(4)
    if method == "Daniilidis":
        camera[:3, :3], camera[:3, 3] = _dual_quaternions(a, b)
    elif method == "Andreff":
        camera[:3, :3], camera[:3, 3] = _kronecker(a, b)
    else:
        camera[:3, :3] = _turn(method, _rotvecs(a), _rotvecs(b))
        left, right = a[:, :3, :3] - np.eye(3), b[:, :3, 3] @ camera[:3, :3].T - a[:, :3, 3]
        camera[:3, 3] = np.linalg.lstsq(left.reshape(-1, 3), right.ravel(), rcond=None)[0]
    return camera


def _rotvecs(frames: np.ndarray) -> np.ndarray:
    return np.asarray(Rotation.from_matrix(frames[:, :3, :3]).as_rotvec())


def _turn(method: str, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) that maps rotation vectors b (n, 3) to a, each method with its own parametrisation."""
    if method == "Park":
        return np.asarray(Rotation.align_vectors(a, b)[0].as_matrix())
    a, b = (np.sinc(np.linalg.norm(v, axis=1, keepdims=True) / (2 * np.pi)) * v for v in (a, b))  # 2 sin(angle / 2)
    if method == "Horaud":
        return np.asarray(Rotation.align_vectors(a, b)[0].as_matrix())
    gibbs = np.linalg.lstsq(crossing(a + b).reshape(-1, 3), (b - a).ravel(), rcond=None)[0]
    size = np.linalg.norm(gibbs) or 1.0
    return np.asarray(Rotation.from_rotvec(2 * np.arctan(size) * gibbs / size).as_matrix())


def _kronecker(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    n, eye = len(a), np.eye(3)
    turns = np.einsum("nij,kl->nikjl", a[:, :3, :3], eye) - np.einsum("ij,nlk->nikjl", eye, b[:, :3, :3])
    rows = np.zeros((n, 12, 12))
    rows[:, :9, :9] = turns.reshape(n, 9, 9)
    rows[:, 9:, :9] = np.einsum("ij,nk->nijk", eye, b[:, :3, 3]).reshape(n, 3, 9)
    rows[:, 9:, 9:] = eye - a[:, :3, :3]
    wanted = np.concatenate([np.zeros((n, 9)), a[:, :3, 3]], axis=1)
    solution = np.linalg.lstsq(rows.reshape(-1, 12), wanted.ravel(), rcond=None)[0]
    u, size, v = np.linalg.svd(solution[:9].reshape(3, 3))
    if size[2] < 0.1 or np.linalg.det(u @ v) < 0:
        raise ValueError("the linear system's solution is no rotation")
    return u @ v, solution[9:]


def _dual_quaternions(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    (real_a, dual_a), (real_b, dual_b) = _dual(a), _dual(b)
    rows = np.zeros((len(a), 6, 8))
    rows[:, :3, 0] = rows[:, 3:, 4] = real_a - real_b
    rows[:, :3, 1:4] = rows[:, 3:, 5:] = crossing(real_a + real_b)
    rows[:, 3:, 0], rows[:, 3:, 1:4] = dual_a - dual_b, crossing(dual_a + dual_b)
    (u1, v1), (u2, v2) = np.linalg.svd(rows.reshape(-1, 8), full_matrices=False)[2][-2:].reshape(2, 2, 4)
    ratios = np.roots([u1 @ v1, u1 @ v2 + u2 @ v1, u2 @ v2])
    if not len(ratios) or np.iscomplex(ratios).any():
        raise ValueError("no dual quaternion of length one solves the equations")
    real, dual = max(((s * u1 + u2, s * v1 + v2) for s in ratios), key=lambda pair: float(pair[0] @ pair[0]))
    turn = Rotation.from_quat(real[[1, 2, 3, 0]])
    size = float(real @ real)
    place = 2 * (real[0] * dual[1:] - dual[0] * real[1:] + np.cross(real[1:], dual[1:])) / size
    return turn.as_matrix(), place


def _dual(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the vector parts (n, 3) of the real and the dual quaternion of transforms (n, 4, 4), with positive real scalar."""
    quaternion = Rotation.from_matrix(frames[:, :3, :3]).as_quat(canonical=True)
    vector, scalar, place = quaternion[:, :3], quaternion[:, 3:], frames[:, :3, 3]
    return vector, (scalar * place + np.cross(place, vector)) / 2
