"""What gravity turns where masses are unknown: payloads that nobody weighed, rails, and bases that lean."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from calflow.effects import catalogue
from calflow.effects.cause import Cause
from calflow.effects.gravity_deflection import GravityDeflection, Shape
from calflow.effects.joint_compliance import JointCompliance
from calflow.model import Model
from calflow.robot.frames import modified_dh
from calflow.robot.mechanism import rated_torques
from calflow.robot.parts import Joint, Payload
from calflow.robot.robot import Robot
from robots import industrial, poses, rows

SPRINGS = np.array([0.6, 0.8, 1.2, 3.0, 4.0, 5.0]) * 1e-6
LOADS = {"light": 60.0, "load": 210.0}


def weighed(robot: Robot, **masses: float | None) -> Robot:
    """The robot with payloads of these masses, None for unknown ones."""
    com = next(iter(robot.payloads.values())).com
    return replace(robot, payloads={name: Payload(mass, com) for name, mass in masses.items()})


def bare(robot: Robot) -> Robot:
    """The robot whose links' masses nobody knows."""
    return replace(robot, joints=tuple(replace(joint, mass=None) for joint in robot.joints))


def left(robot: Robot, unknown: Robot, springs: np.ndarray, payloads: tuple[str, ...], shape: Shape = "") -> float:
    """Largest part of what springs do, at poses that were not fitted, that gravity deflection cannot follow."""
    q = poses(robot, 160)
    real, model = Model(robot, (JointCompliance(robot),)), Model(unknown, (GravityDeflection(unknown, shape),))
    load = [payloads[k % len(payloads)] for k in range(len(q))]
    packed, own = (
        np.concatenate([rows(of, q[[k]], name, "E") for k, name in enumerate(load)], axis=1) for of in (real, model)
    )
    point, still, p = (
        real.position(springs, packed),
        real.position(0 * springs, packed),
        np.zeros(len(model.parameters)),
    )
    seen = np.arange(len(q)) % 4 > 0
    for _ in range(6):
        slope = model.position_jacobian(p, own[:, seen]).reshape(-1, len(p)) * model.prior_sd
        rest = (point[seen] - model.position(p, own[:, seen])).ravel()
        p = p + model.prior_sd * np.linalg.lstsq(slope, rest, rcond=1e-9)[0]
    rest, effect = (
        np.linalg.norm(shift[~seen], axis=1).max() for shift in (point - model.position(p, own), point - still)
    )
    assert effect > 1e-3
    return float(rest / effect)


def test_a_payload_of_unknown_mass_has_a_figure_of_its_own():
    """Breaks if what an unknown payload does to joints is not followed, or one of known mass answers for it."""
    robot = weighed(industrial(), **LOADS)
    unknown = weighed(bare(industrial()), light=60.0, load=None)
    assert left(robot, unknown, SPRINGS, ("", "light", "load")) < 0.02
    symbols = {parameter.symbol for parameter in GravityDeflection(unknown).declared}
    assert {"s", "s_load"} < symbols
    assert "s_light" not in symbols


def test_a_size_counts_what_the_payload_turns():
    """Breaks if a joint that sags under payloads alone has no size: the links' own moments say nothing of it."""
    robot = weighed(bare(industrial()), **LOADS)
    sag = Cause(robot, GravityDeflection(robot), "joint3")
    symbols, rated = [parameter.symbol for parameter in sag.declared], rated_torques(robot)[2]
    p = np.zeros(len(symbols))
    p[symbols.index("s")] = 3e-4 / rated
    assert float(ca.evalf(sag.size_of(ca.SX(p)))) == pytest.approx(3e-4)
    p[symbols.index("phi3x")] = 4e-4
    assert float(ca.evalf(sag.size_of(ca.SX(p)))) == pytest.approx(5e-4)


def test_the_centre_of_an_unweighed_payload_is_located():
    """Breaks if an unweighed payload sits on the flange: what its moment does to the wrist was certain to be the tool's give."""
    robot = weighed(industrial(), **LOADS)
    unknown = replace(bare(robot), payloads=dict.fromkeys(LOADS, Payload(None)))
    assert left(robot, unknown, SPRINGS, ("", "light", "load")) < 0.01


def test_a_rule_of_masses_stands_for_most_of_a_real_arms_first_moments():
    """Fails if the rule's torques go otherwise than a real arm's, so that one parameter could not stand for a dozen."""
    robot = weighed(industrial(), **LOADS)
    assert left(robot, weighed(bare(industrial()), light=None, load=None), SPRINGS, ("", "light", "load"), "rule") < 0.1


def test_unknown_payloads_make_statics_lacking():
    """Breaks if statics count with a payload that weighs nothing, or do not say whose mass they need."""
    robot = weighed(industrial(), light=60.0, load=None)
    assert not robot.has_masses
    assert GravityDeflection.superseded(robot, _Nothing(robot)) == ""
    for name in ("joint-compliance", "link-bending", "payload-mass"):
        assert "every link and payload" in ", ".join(catalogue()[name].lacking(robot, _Nothing(robot)).split("\n"))
    assert "s_load" in {parameter.symbol for parameter in GravityDeflection(robot).declared}


class _Nothing:
    """Data without any column that may be missing."""

    given = ()
    in_images = False

    def __init__(self, robot: Robot) -> None:
        self.robot = robot


def on_rail(gravity: tuple[float, float, float]) -> Robot:
    """The industrial robot on a slide along its base's z, behind which its own first axis stands across."""
    arm = industrial()
    mass = {"mass": 500.0, "com": (0.0, 0.0, 0.0)}
    rail = Joint(modified_dh(), kind="prismatic", limits=(0.0, 3.0), **mass)
    first = replace(arm.joints[0], frame=modified_dh(alpha=-np.pi / 2, d=0.67))
    return replace(arm, joints=(rail, first, *arm.joints[1:]), gravity=gravity)


def test_on_a_rail_gravity_is_the_worlds():
    """Breaks if gravity follows the rail, or a joint whose axis is upright behind a rail is said to sag."""
    robot = on_rail((0.0, -9.80665, 0.0))
    q = np.zeros((1, 7))
    up = Model(robot, ()).position(np.zeros(0), rows(Model(robot, ()), q, "load"))[0]
    assert up[1] > 1.0  # the arm stands up from the rail along y
    assert left(robot, bare(robot), np.array([0.0, *SPRINGS]), ("load",)) < 0.02
    assert 2 not in {parameter.joint for parameter in GravityDeflection(bare(robot)).declared}
    wrong = bare(on_rail((0.0, 0.0, -9.80665)))
    assert left(robot, wrong, np.array([0.0, *SPRINGS]), ("load",)) > 0.2


@pytest.mark.parametrize("lean", [0.0, 0.4])
def test_a_base_that_leans_loads_its_first_joint(lean):
    """Breaks if a leaning robot's gravity is taken along its first axis."""
    robot = replace(industrial(), gravity=(9.80665 * np.sin(lean), 0.0, -9.80665 * np.cos(lean)))
    unknown = bare(weighed(robot, load=None))
    assert left(robot, unknown, SPRINGS, ("load",)) < 0.02
    assert (1 in {parameter.joint for parameter in GravityDeflection(unknown).declared}) == (lean > 0)
