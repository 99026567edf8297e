"""Payload centre: a load that is misstated by itself says nothing of another."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

import robots
from calflow.effects.misstated_payload import PayloadCom
from calflow.robot.mechanism import Row, nominal_loads
from calflow.robot.parts import Payload


def test_each_payload_may_be_misstated_alone() -> None:
    """Breaks if the centre of a load that was measured moves that of one that was not, or all alike do not move together."""
    loads = {"empty": Payload(0.0), "half": Payload(40.0, (0.0, 0.0, 0.1)), "full": Payload(90.0, (0.1, 0.0, 0.2))}
    robot = replace(robots.industrial(), payloads=loads)
    effect = PayloadCom(robot)
    assert [parameter.part for parameter in effect.parameters()[::3]] == ["payloads", "half", "full"]
    still = nominal_loads(robot)
    p = ca.SX([0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.02, 0.03])
    shift = np.array(ca.DM(effect.loads(p, still, Row.symbols(robot)).payload_com - still.payload_com))
    np.testing.assert_allclose(shift.T, [[0.01, 0, 0], [0.01, 0, 0], [0.01, 0.02, 0.03]], atol=1e-15)
