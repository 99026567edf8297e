"""The four-bar loop PQRS: the driven joint's angle from the two motors', closed exactly for any lengths."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from calflow.robot.description import FourBar


@dataclass(frozen=True)
class Closure:
    """The closed loop at one pose; angles in rad from the ground's x axis in the loop's plane.

    The loop can be closed where |cosine| < 1 (the cosine of the angle at S between the diagonal SQ and the rocker).
    """

    rocker_angle: ca.SX
    rod_angle: ca.SX
    cosine: ca.SX


def close(loop: FourBar, link: ca.SX, bars: ca.SX, link_angle: ca.SX, crank_angle: ca.SX) -> Closure:
    """Solve the loop for given bar lengths and the two driven angles.

    With Q = crank e^{i·crank_angle}, S = link e^{i·link_angle} and D = S - Q, the rocker's direction e^{iφ} follows from
    |D + rocker e^{iφ}| = rod (equation 5 of Model based robot calibration, 2021, solved without its parallelogram
    assumption). Of the two solutions the one of the nominal assembly is taken: an open loop has P and R on different
    sides of the diagonal QS, a crossed one on the same side.
    """
    crank, rod, rocker = bars[0], bars[1], bars[2]
    dx = link * ca.cos(link_angle) - crank * ca.cos(crank_angle)
    dy = link * ca.sin(link_angle) - crank * ca.sin(crank_angle)
    squared = dx**2 + dy**2
    cosine = (rod**2 - squared - rocker**2) / (2 * rocker * ca.sqrt(squared))
    # Past the end of its travel the loop has no solution; the clamp keeps derivatives finite and `cosine` tells.
    reachable = ca.fmin(ca.fmax(cosine, -1 + 1e-9), 1 - 1e-9)
    side = ca.sign(ca.sin(crank_angle - link_angle)) * (1 if loop.assembly == "open" else -1)
    rocker_angle = ca.atan2(dy, dx) + side * ca.acos(reachable)
    rod_angle = ca.atan2(dy + rocker * ca.sin(rocker_angle), dx + rocker * ca.cos(rocker_angle))
    return Closure(rocker_angle, rod_angle, cosine)
