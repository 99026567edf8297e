"""What the pages of the catalogue are made on: the robot that `calflow new` writes, and rows in which nothing is missing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path

import casadi as ca
import numpy as np

from calflow import Measurements, Robot
from calflow.effects import Effect
from calflow.model import Model, build, over_rows
from calflow.robot.frames import modified_dh
from calflow.robot.mechanism import Row
from calflow.robot.parts import Base, Joint, Marker

ROWS = 120
SCAN = 20  # forms from which on they are a scan through the data
FITTED = ("geometry", "joint-compliance")  # what a study begins with
STANDS = Base((2.8, -0.6, -0.7))  # the measuring device is off to the side
TRAVEL = 3.0  # m of rail
HH800 = Path(__file__).parents[2] / "studies" / "hh800" / "robot.toml"
EASY = np.radians(10)  # kept from the limits


@dataclass(frozen=True, eq=False)
class Bench:
    """A robot at random poses all over its working range, empty and full, in four sessions of an hour in which it warms up."""

    robot: Robot
    data: Measurements

    @cached_property
    def fitted(self) -> tuple[Effect, ...]:
        """What a study of this robot begins with."""
        return build(self.robot, FITTED if self.robot.has_masses else FITTED[:1]).effects

    def model(self, *effects: Effect) -> Model:
        """The robot with these effects besides what a study begins with."""
        more = tuple(effect for effect in effects if effect not in self.fitted)
        return Model(self.robot, self.fitted, self.data.given, probes=more)

    def values(self, model: Model) -> np.ndarray:
        """Parameters at which all effects are absent, but for springs in the joints: some causes show by these alone."""
        springs = [p.prior_sd if p.effect == "joint-compliance" else 0.0 for p in model.parameters]
        return model.nominal + np.array(springs)

    def forms(self, effect: type[Effect]) -> tuple[Effect, ...]:
        """The forms in which an effect is looked for here; of a scan through very many the one in its middle."""
        if effect.lacking(self.robot, self.data) or effect.superseded(self.robot, self.data):
            return ()
        forms = effect.variants(self.robot, self.data)
        return forms if len(forms) <= SCAN else (forms[len(forms) // 2],)

    def response(self, effect: Effect) -> np.ndarray:
        """How the reported position, or a target's point, moves by each of an effect's parameters, (rows, 3, parameters)."""
        model = self.model(effect)
        moved = model.position_jacobian(self.values(model), self.data.conditions)[:, :, model.columns(effect)]
        return moved + self._on_target(effect)

    def _on_target(self, effect: Effect) -> np.ndarray:
        """The same of the target's points alone."""
        p, point, c = (
            ca.SX.sym(name, n) for name, n in (("p", len(effect.declared)), ("x", 3), ("c", len(self.data.conditions)))
        )
        there = effect.target(p, point, Row.unpack(self.robot, c, self.data.given))
        graph = ca.Function("target", [p, point, c], [ca.densify(ca.jacobian(there, p))])
        points = self.data.table.reindex(columns=["px_x", "px_y", "px_z"], fill_value=0.0).to_numpy().T
        slope = over_rows(graph, np.zeros(p.numel()), points, self.data.conditions)[0]
        return slope.T.reshape(len(self.data), -1, 3).transpose(0, 2, 1)


@lru_cache
def benches() -> tuple[Bench, ...]:
    """The robot of the template, on a rail, with its masses unknown, with rows that are images, and one with rods."""
    with resources.as_file(resources.files("calflow.templates") / "robot.toml") as path:
        plain = Robot.from_toml(Path(path))
    joints = tuple(replace(joint, gear_ratio=120.0) for joint in plain.joints)
    second = Marker((-0.15, 0.1, 0.2), relative_sd=2e-5)
    arm = replace(plain, joints=joints, base=STANDS, markers={**plain.markers, "second": second})
    rail = Joint(modified_dh(alpha=-np.pi / 2), kind="prismatic", limits=(0.0, TRAVEL), mass=800.0)
    railed = replace(arm, joints=(rail, replace(joints[0], frame=modified_dh(alpha=np.pi / 2, d=0.67)), *joints[1:]))
    light = replace(arm, joints=tuple(replace(joint, mass=None) for joint in joints))
    every = [_measured(robot) for robot in (arm, railed, light)]
    plate = np.random.default_rng(1).uniform(-0.12, 0.12, (ROWS, 2))
    points = {"px_x": plate[:, 0], "px_y": plate[:, 1], "px_z": 0.0}
    images = replace(every[0], table=every[0].table.assign(u=0.0, v=0.0, **points))
    heavy = Robot.from_toml(HH800)
    counterweight = replace(heavy.joints[2], mass=2000.0, com=(0.25, 0.8, 0.0))  # else the rod's force keeps its sign
    rods = replace(heavy, joints=(*heavy.joints[:2], counterweight, *heavy.joints[3:]))
    return tuple(Bench(data.robot, data) for data in (*every, images, _measured(rods)))


def _measured(robot: Robot) -> Measurements:
    """Rows as a device would report them of a robot that is what its file says."""
    rng = np.random.default_rng(1)
    low, high = np.array([joint.range for joint in robot.joints]).T
    easy = np.where([joint.kind == "revolute" for joint in robot.joints], EASY, 0.0)
    q = rng.uniform(low + easy, high - easy, (ROWS, robot.n_joints))
    hours = np.linspace(0, 4, ROWS)
    conditions = {
        "marker": np.array(list(robot.markers))[np.arange(ROWS) // 3 % len(robot.markers)],
        "payload": np.array(list(robot.payloads))[np.arange(ROWS) % len(robot.payloads)],
        "session": np.array(["mon", "tue", "wed", "thu"])[np.arange(ROWS) * 4 // ROWS],
        "approach": rng.choice([-1.0, 1.0], q.shape),
        "travel": rng.exponential(np.radians(5), q.shape),
        "time": 3600 * hours,
        "temperature": 273.15 + 20 + 12 * (1 - np.exp(-hours)),
        "speed": rng.normal(0, 0.3, q.shape),
    }
    planned = Measurements.from_arrays(robot, q, None, **conditions)
    nominal = build(robot, (), planned.given)
    return Measurements.from_arrays(robot, q, nominal.point(nominal.nominal, planned.conditions), **conditions)
