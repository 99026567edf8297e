"""The conditions of one measured row: all that the graph is given besides the parameters, and the columns that show readings."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256

import casadi as ca
import numpy as np

from calflow.robot.robot import Robot

OPTIONAL = ("approach", "travel", "wrench", "torque", "time", "temperature", "order", "range", "session")


def session_number(name: str) -> float:
    """Return a whole number that stands for a session's name in whatever rows; 0, which no name has, is no session.

    It is 52 bits of the name's SHA-256, so that no two names ever meet.
    """
    return 1.0 + int(sha256(name.encode()).hexdigest()[:13], 16)


@dataclass(frozen=True)
class Row:
    """Symbols of one row's conditions, in SI units; an optional one that the data lack is structurally zero.

    reading are the joint readings and q the joint angles they mean (signs and couplings resolved); payload and marker are
    one-hot over the robot's names; approach is the direction each joint came from (-1, 0, +1) and travel how far since it
    last turned back; wrench (force, moment) acts at the marker, in the base frame; torque are measured motor torques, which
    replace the computed ones; time counts from the first row, order is the row's place in measuring order, range the
    distance from the measuring device; session is a number that stands for the session's name (see `session_number`).
    """

    reading: ca.SX
    payload: ca.SX
    marker: ca.SX
    approach: ca.SX
    travel: ca.SX
    wrench: ca.SX
    torque: ca.SX
    time: ca.SX
    temperature: ca.SX
    order: ca.SX
    range: ca.SX
    session: ca.SX
    q: ca.SX

    @staticmethod
    def sizes(robot: Robot, given: tuple[str, ...] = ()) -> dict[str, int]:
        """Length of each condition in a packed row, in order; given names the optional ones that the data have."""
        n = robot.n_joints
        fixed = {"reading": n, "payload": len(robot.payloads), "marker": len(robot.markers)}
        optional = {"approach": n, "travel": n, "wrench": 6, "torque": n} | dict.fromkeys(OPTIONAL[4:], 1)
        return fixed | {name: size for name, size in optional.items() if name in given}

    @staticmethod
    def symbols(robot: Robot, given: tuple[str, ...] = OPTIONAL) -> Row:
        """Return a row of symbols."""
        return Row.unpack(robot, ca.SX.sym("c", sum(Row.sizes(robot, given).values())), given)

    @staticmethod
    def unpack(robot: Robot, packed: ca.SX, given: tuple[str, ...] = ()) -> Row:
        """Split a packed row."""
        parts = {name: ca.SX(size, 1) for name, size in Row.sizes(robot, OPTIONAL).items()}
        start = 0
        for name, size in Row.sizes(robot, given).items():
            parts[name] = packed[start : start + size]
            start += size
        return Row(**parts, q=ca.sparsify(ca.DM(robot.reading_matrix)) @ parts["reading"])


READINGS = "q{joint}_{deg|mm}"  # the columns of joint readings
VIAS = "via{joint}_{deg|mm}"  # the same of a pose on the way


def reading_columns(robot: Robot) -> list[str]:
    """Return the columns of joint readings by their names, e.g. q1_deg; joints that follow others have none."""
    return [f"q{i + 1}_{robot.joints[i].shown[0]}" for i in robot.driven]


def reading_labels(robot: Robot) -> list[str]:
    """Return the same for people, e.g. q1 [deg]."""
    return [f"q{i + 1} [{robot.joints[i].shown[0]}]" for i in robot.driven]


def shown_readings(robot: Robot, readings: np.ndarray) -> np.ndarray:
    """Return readings (n, n_joints) [rad, or m] as these columns have them, shape (n, number of columns)."""
    return np.asarray(readings[:, robot.driven] * [robot.joints[i].shown[1] for i in robot.driven])
