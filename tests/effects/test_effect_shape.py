"""The places where an effect may act, each tried with an effect made up here."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from calflow.effects import Effect, catalogue
from calflow.effects.cause import Carried, Cause
from calflow.effects.joint_compliance import JointCompliance
from calflow.model import Model, build
from calflow.robot.mechanism import Deflection, Dimensions, Loads, Row, State
from calflow.robot.parts import Parameter
from calflow.robot.robot import Robot

SPRINGS = np.array([1.0, 2.0, 3.0, 8.0, 8.0, 8.0]) * 1e-5
TWIST = np.array([2e-3, -1e-3, 3e-3, 0.01, -0.02, 0.015])


class Toy(Effect):
    """An effect with `size` parameters that does nothing yet."""

    id: ClassVar[str] = "toy"
    title: ClassVar[str] = "toy"
    size: ClassVar[int] = 1

    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(self.id, "toy", f"p{i}", "m", 1.0, -10.0, 10.0) for i in range(self.size))


class LongerArm(Toy):
    """Link 2 is p longer."""

    def dimensions(self, p: ca.SX, dims: Dimensions, row: Row) -> Dimensions:
        steps = ca.SX(dims.steps)
        steps[self.robot.step_index(1, "a")] += p
        return replace(dims, steps=steps)


class HeavierLoad(Toy):
    """The payload is p heavier."""

    def loads(self, p: ca.SX, loads: Loads, row: Row) -> Loads:
        return replace(loads, payload_mass=loads.payload_mass + p)


class BalancingSpring(Toy):
    """A spring pulls joint 2 by p per radian."""

    def torque(self, p: ca.SX, state: State, row: Row) -> ca.SX:
        return ca.vertcat(0, p * state.q[1], 0, 0, 0, 0)


class Backlash(Toy):
    """Each joint stands p from its reading, on the side it came from."""

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        return replace(still, joint=p * row.approach)


class LooseBearing(Toy):
    """Joint 3's bearing gives way by a twist."""

    size: ClassVar[int] = 6
    joint: ClassVar[int] = 2

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        bearing = ca.SX(still.bearing)
        bearing[:, self.joint] = p
        return replace(still, bearing=bearing)


class LooseArm(LooseBearing):
    """Joint 2's bearing gives way."""

    joint: ClassVar[int] = 1


class BentLink(Toy):
    """One link's far end gives way by a twist."""

    size: ClassVar[int] = 6
    column: ClassVar[int] = 2

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        link = ca.SX(still.link)
        link[:, self.column] = p
        return replace(still, link=link)


class BentBase(BentLink):
    """The base below joint 1 gives way."""

    column: ClassVar[int] = 0


class BentFlange(BentLink):
    """The flange gives way."""

    column: ClassVar[int] = 6


class SoftBase(Toy):
    """The base tilts by p per Nm of what it carries."""

    part: ClassVar[str] = "link"
    column: ClassVar[int] = 0

    def deflection(self, p: ca.SX, state: State, row: Row, still: Deflection) -> Deflection:
        twist = ca.SX(getattr(still, self.part))
        twist[3:, self.column] = p * getattr(state, self.part)[3:, self.column]
        return replace(still, **{self.part: twist})


class SoftBearing(SoftBase):
    """Joint 2's bearing tilts by p per Nm of what it carries."""

    part: ClassVar[str] = "bearing"
    column: ClassVar[int] = 1


class SoftArm(SoftBase):
    """Link 2's far end tilts by p per Nm of what it carries."""

    column: ClassVar[int] = 2


class StretchedScale(Toy):
    """The measuring device reports all lengths too long."""

    def device(self, p: ca.SX, point: ca.SX, row: Row) -> ca.SX:
        return point * (1 + p)


def positions(robot: Robot, effects: list[type[Effect]], p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Positions that a model with these effects predicts, under the load where the robot has one."""
    model = Model(robot, tuple(effect(robot) for effect in effects))
    return model.position(p, robots.rows(model, q, next(iter(robot.payloads), "")))


@pytest.fixture
def robot() -> Robot:
    """A serial robot that stands askew."""
    return robots.ur10()


@pytest.fixture
def q(robot: Robot) -> np.ndarray:
    """Some of its poses."""
    return robots.poses(robot, 8)


def test_dimensions_change_the_chain(robot: Robot, q: np.ndarray) -> None:
    """Breaks if changed lengths do not reach the kinematics."""
    figs = robots.figures(robot)
    figs["a"][1] += 0.02
    assert_allclose(
        positions(robot, [LongerArm], np.array([0.02]), q), robots.marker_position(robot, q, figs), atol=1e-12
    )


def test_loads_change_what_the_springs_carry(robot: Robot, q: np.ndarray) -> None:
    """Breaks if changed masses do not reach the statics; without springs they must move nothing."""
    heavier = robots.ur10(payloads={"load": {"mass_kg": 14.0, "com_m": robot.payloads["load"].com}})
    found = positions(robot, [JointCompliance, HeavierLoad], np.append(SPRINGS, 4.0), q)
    assert_allclose(found, positions(heavier, [JointCompliance], SPRINGS, q), atol=1e-12)
    assert np.abs(found - positions(robot, [JointCompliance], SPRINGS, q)).max() > 1e-4
    stiff = positions(robot, [HeavierLoad], np.array([4.0]), q)
    assert_allclose(stiff, robots.marker_position(robot, q), atol=1e-12)


@pytest.mark.parametrize("order", [[JointCompliance, BalancingSpring], [BalancingSpring, JointCompliance]])
def test_torque_winds_the_springs_up(robot: Robot, q: np.ndarray, order: list[type[Effect]]) -> None:
    """Breaks if an added torque is dropped, acts on another joint, or misses effects named before it."""
    rated = tuple(replace(joint, rated_torque=100.0) for joint in robot.joints)
    floating = replace(robot, gravity=(0.0, 0.0, 0.0), joints=rated)
    turned = q.copy()
    turned[:, 1] += SPRINGS[1] * 70.0 * q[:, 1]
    p = np.append(SPRINGS, 70.0) if order[0] is JointCompliance else np.append(70.0, SPRINGS)
    assert_allclose(positions(floating, order, p, q), robots.marker_position(robot, turned), atol=1e-12)


def test_joint_deflection_turns_joints(robot: Robot, q: np.ndarray) -> None:
    """Breaks if a joint's deflection is lost, or the row's approach does not reach the effect."""
    model = Model(robot, (Backlash(robot),), given=("approach",))
    approach = np.random.default_rng(8).choice([-1.0, 0.0, 1.0], q.shape)
    conditions = robots.rows(model, q)
    conditions[-6:] = approach.T
    wanted = robots.marker_position(robot, q + 0.01 * approach)
    assert_allclose(model.position(np.array([0.01]), conditions), wanted, atol=1e-12)


@pytest.mark.parametrize("make", [robots.ur10, robots.industrial, robots.hh800])
@pytest.mark.parametrize("effect", [LooseBearing, LooseArm, BentLink, BentBase, BentFlange])
def test_bearing_and_link_deflections_act_at_their_frames(make: type, effect: type[Toy]) -> None:
    """Breaks if a twist acts on the wrong side of a joint or link, at another joint, in another frame, or beside a loop."""
    robot = make()
    q = robots.poses(robot, 8)
    at = {"bearing": np.zeros((6, 6)), "link": np.zeros((6, 7))}
    if issubclass(effect, LooseBearing):
        at["bearing"][:, effect.joint] = TWIST
    else:
        at["link"][:, effect.column] = TWIST
    flange = robots.frames(robot, q, **at).ends[-1]
    found = positions(robot, [effect], TWIST, q)
    assert_allclose(found, robots.moved(flange, robot.markers["E"].point), atol=1e-12)
    assert np.abs(found - robots.marker_position(robot, q)).min(axis=0).max() > 1e-5


@pytest.mark.parametrize("effect", [LooseBearing, BentLink])
def test_deflections_of_several_effects_add_up(robot: Robot, q: np.ndarray, effect: type[Toy]) -> None:
    """Breaks if one effect's deflection replaces another's at the same place."""
    twice = positions(robot, [effect, effect], np.concatenate([TWIST, 2 * TWIST]), q)
    assert_allclose(twice, positions(robot, [effect], 3 * TWIST, q), atol=1e-12)


@pytest.mark.parametrize(("make", "softness"), [(robots.ur10, 3e-6), (robots.hh800, 3e-8)])
@pytest.mark.parametrize("effect", [SoftBase, SoftBearing, SoftArm])
def test_structure_balances_what_it_carries(make: type, softness: float, effect: type[SoftBase]) -> None:
    """Breaks if the moments on a bearing, a link or the base are wrong, or not taken at the deflected pose."""
    robot, rotation = make(), np.arange(3, 6)
    q, payload = robots.poses(robot, 8), next(iter(robot.payloads))
    for pose, found in zip(q, positions(robot, [effect], np.array([softness]), q), strict=True):

        def motion(tilt: np.ndarray) -> dict[str, np.ndarray]:
            twists = np.zeros((6, 7 if effect.part == "link" else 6))
            twists[rotation, effect.column] = tilt
            return {effect.part: twists}

        def energy(tilt: np.ndarray, pose: np.ndarray = pose) -> float:
            return robots.energy(robot, pose, payload, **motion(tilt))

        tilt = np.zeros(3)
        for _ in range(8):
            tilt = np.array([softness * (energy(tilt - h) - energy(tilt + h)) / 2e-5 for h in 1e-5 * np.eye(3)])
        flange = robots.frames(robot, pose, **motion(tilt)).ends[-1]
        assert_allclose(found, robots.moved(flange, robot.markers["E"].point), atol=1e-8)
        assert np.abs(found - robots.marker_position(robot, pose)).max() > 1e-6


def test_device_changes_only_what_is_reported(robot: Robot, q: np.ndarray) -> None:
    """Breaks if a device's error is applied before the base is, or turns the tool."""
    model = Model(replace(robot, base=robots.ASKEW), (StretchedScale(robot),))
    conditions, p = robots.rows(model, q), np.array([0.001])
    assert_allclose(model.position(p, conditions), 1.001 * robots.marker_position(model.robot, q), atol=1e-12)
    assert_allclose(model.rotation(p, conditions), robots.tool_rotation(model.robot, q), atol=1e-12)


def test_toys_stay_out_of_the_catalogue() -> None:
    """Breaks if the catalogue lists classes that are not files of its folder, or misses one that is."""
    catalogue.cache_clear()
    assert "toy" not in catalogue()
    assert {"geometry", "joint-compliance"} <= set(catalogue())


@pytest.mark.parametrize("name", catalogue())
@pytest.mark.parametrize("make", [robots.hh800, robots.ur10, robots.industrial])
def test_nominal_parameters_mean_no_effect(name: str, make: type) -> None:
    """Breaks if an effect moves anything at its nominal parameters, whatever a row's conditions."""
    robot = make()
    given = ("approach", "wrench", "time", "temperature")
    model, without = build(robot, [name], given), Model(robot, (), given)
    q = robots.poses(robot, 20)
    rows = robots.rows(model, q, next(iter(robot.payloads)))
    conditions = model.n_conditions - 6 - len(robot.payloads) - len(robot.markers)
    rows[-conditions:] = np.random.default_rng(9).normal(size=(conditions, len(q)))
    assert_allclose(model.position(model.nominal, rows), without.position(without.nominal, rows), atol=1e-14, rtol=0)
    assert_allclose(model.rotation(model.nominal, rows), without.rotation(without.nominal, rows), atol=1e-14, rtol=0)
    assert np.isfinite(model.position_jacobian(model.nominal, rows)).all()


@pytest.mark.parametrize("name", catalogue())
def test_parameters_are_well_formed(name: str) -> None:
    """Breaks if parameters share a name, a bound excludes the nominal, or an id is not the effect's own."""
    effect = catalogue()[name](robots.hh800())
    parameters = effect.declared
    assert effect.id == name
    assert effect.title
    assert {parameter.variant for parameter in parameters} <= {effect.variant}
    assert {parameter.effect for parameter in parameters} <= {name}
    assert len({parameter.name for parameter in parameters}) == len(parameters)
    for parameter in parameters:
        assert parameter.lower <= parameter.nominal <= parameter.upper
        assert parameter.lower < parameter.upper
        assert 0 < parameter.prior_sd < np.inf


@pytest.mark.parametrize("name", catalogue())
def test_a_cause_is_the_devices_where_its_effect_is(name: str) -> None:
    """Fails if what the robot does itself counts as the device's, or as noise, once it is a cause of its own."""
    effect = catalogue()[name](robots.hh800())
    for part in {parameter.part for parameter in effect.declared}:
        cause = Cause(effect.robot, effect, part)
        carried = Carried(effect.robot, cause, (0.0,) * cause.n_parameters)
        assert {one.of_measuring() for one in (effect, cause, carried)} == {type(effect).of_measuring()}
        assert {one.is_noise() for one in (effect, cause, carried)} == {type(effect).is_noise()}
