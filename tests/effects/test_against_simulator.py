"""Every effect of the catalogue moves the tool as the independent simulator does."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from calflow.design.candidates import packed_conditions
from calflow.effects import catalogue
from calflow.effects.joint_error_map import AMPLITUDE, LENGTHS
from calflow.faults import CHECKS, PLAIN_CHECKS
from calflow.files.toml import Origin
from calflow.measurements.measurements import Measurements
from calflow.model import Model, over_rows
from calflow.robot.formats.robot_file import parts_of
from calflow.robot.frames import elementary, modified_dh
from calflow.robot.mechanism import Row, State
from calflow.robot.robot import Robot
from effects.bench import BASE, EVERYTHING, ROBOTS, Bench, made, waves
from effects.twins import SHARED, TWINS, Twin
from hidden.case import Case, robot_file, stated_tables
from hidden.causes import Hidden, joint_error_map

DOCUMENT = Path(__file__).parents[2] / "docs" / "effects.md"


@pytest.fixture(scope="module")
def compared(benches: dict[str, Bench]) -> Callable[[str], tuple[dict[str, Twin], Callable[..., np.ndarray]]]:
    """All twins of a robot in one graph, and its points with springs and one twin's values."""

    @lru_cache
    def of(name: str) -> tuple[dict[str, Twin], Callable[..., np.ndarray]]:
        bench = benches[name]
        twins = {key: make(bench) for key, make in TWINS.items()}
        springs = made(bench, "joint-compliance")
        effects = (springs, *(twin.effect for twin in twins.values()))
        model = Model(bench.robot, effects, bench.data.given)
        p, c = ca.SX.sym("p", len(model.parameters)), ca.SX.sym("c", model.n_conditions)
        position = ca.Function("position", [p, c], [ca.densify(model.expression(p, c).position)])
        sizes = [len(effect.declared) for effect in effects]

        def points(key: str, soft: bool = True) -> np.ndarray:
            values = np.zeros(len(model.parameters))
            values[: sizes[0]] = soft * bench.real.compliance
            if key:
                k = list(twins).index(key) + 1
                names = [f"{parameter.part}.{parameter.symbol}" for parameter in effects[k].declared]
                for parameter, value in twins[key].values.items():
                    values[sum(sizes[:k]) + names.index(parameter)] = value
            return over_rows(position, values, bench.table.conditions)[0].T

        return twins, points

    return of


FAULTS_OF = {  # the ids of what a check finds, where it is not its name
    "measured-torque": ("torque-sign", "torque-scale"), "exchanged": ("marker-swap", "rows-exchanged"),
    "outlier": ("outlier", "name-mistyped", "flipped-image"),
    "lost-rows": (), "setup-faults": (),  # those of row-misalignment, and those of a table of their own
}  # fmt: skip


def test_every_effect_is_compared() -> None:
    """Breaks if an effect was added without a comparison, here or in a file of its own, or without its row in the document."""
    assert set(catalogue()) >= SHARED
    here = Path(__file__).parent
    own = {name: here / f"test_{name.replace('-', '_')}.py" for name in catalogue() if name not in SHARED}
    assert [
        name for name, path in own.items() if not path.is_file() or name not in path.read_text(encoding="utf-8")
    ] == []
    rows = re.findall(r"^\| `([\w-]+)` \|", DOCUMENT.read_text(encoding="utf-8"), re.MULTILINE)
    checks = [check.__name__.replace("_", "-") for check in (*PLAIN_CHECKS, *CHECKS)]
    faults = [cause for check in checks for cause in FAULTS_OF.get(check, (check,))]
    assert sorted(rows) == sorted([*catalogue(), *faults])


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("soft", [True, False])
def test_effects_at_zero_are_absent(benches: dict[str, Bench], compared: Any, name: str, soft: bool) -> None:
    """Breaks if an effect acts though its parameters are zero, or leaves something that is no number."""
    assert_allclose(compared(name)[1]("", soft), benches[name].points(soft=soft), rtol=0, atol=2e-8)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("key", TWINS)
def test_an_effect_moves_the_tool_as_the_simulator_does(
    benches: dict[str, Bench], compared: Any, name: str, key: str
) -> None:
    """Breaks if sign, factor, frame, place or reference of an effect differ: neither program knows the other."""
    bench = benches[name]
    twins, points = compared(name)
    twin = twins[key]
    plain = bench.points(soft=twin.soft)
    real = bench.points(twin.cause, soft=twin.soft) if isinstance(twin.cause, Hidden) else twin.cause(plain, bench.rows)
    where = slice(None) if twin.where is None else twin.where
    effect = np.linalg.norm(real - plain, axis=1)[where]
    assert len(effect) > 20
    assert 5e-6 < np.sqrt(np.mean(effect**2)) < 3e-3
    apart = np.linalg.norm(points(key, twin.soft) - real, axis=1)[where]
    assert apart.max() < twin.close * effect.max()


def modified(of: Robot) -> Robot:
    """The same robot in modified DH: a link's frame is where its axis is, not where the next one is."""
    joints, aside, twist = [], 0.0, 0.0
    for joint in of.joints:
        figures = joint.frame.figures
        rotation = np.array(ca.DM(elementary("rx", figures["alpha"])))[:3, :3]
        com = rotation @ np.array(joint.com) + [figures["a"], 0.0, 0.0]
        joints.append(replace(joint, frame=modified_dh(**figures | {"a": aside, "alpha": twist}), com=com))
        aside, twist = figures["a"], figures["alpha"]
    assert aside == twist == 0  # the flange's frame is the last link's
    return replace(of, joints=joints)


OF_ONE_CONVENTION = {
    "geometry",
    "gravity-deflection",
    "joint-error-map",
    "range-noise",
    "session-frame",
    "axis-straightness",
    "drive-stretch",
    "board-bent",
    "print-scale",
    "target-slip",
    "time-offset",
    "rod-play",
}  # their parameters are frames' own, sessions', rails', targets', loops', or times


@pytest.fixture(scope="module")
def conventions() -> Callable[[str], list[np.ndarray]]:
    """Points of a UR10 stated in both conventions, with springs and one effect as large as its prior, or none."""
    dh = replace(robots.ur10(), base=robots.ASKEW)
    geared = tuple(replace(joint, gear_ratio=100.0) for joint in dh.joints)
    dh = replace(dh, joints=geared)
    q, rng = robots.poses(dh, 20), np.random.default_rng(9)
    given = (*EVERYTHING, "order")
    names = [name for name in catalogue() if name not in OF_ONE_CONVENTION]
    found = []
    for robot in (dh, modified(dh)):
        model = Model(robot, tuple(catalogue()[name](robot) for name in names), given)
        p, c = ca.SX.sym("p", len(model.parameters)), ca.SX.sym("c", model.n_conditions)
        position = ca.Function("position", [p, c], [ca.densify(model.expression(p, c).position)])
        found.append((model, position))
    conditions = packed_conditions(found[0][0], q, "load", "E")
    rest = [rng.choice([-1.0, 1.0], (6, 20)), rng.uniform(0, 1, (6, 20)), rng.uniform(0, 7e3, (1, 20)),
            rng.uniform(290, 310, (1, 20)), np.arange(1.0, 21.0)[None] / 20]  # fmt: skip
    conditions[-15:] = np.vstack(rest)

    def points(name: str) -> list[np.ndarray]:
        share = {"joint-compliance": 0.1} | {name: 1.0}
        return [
            over_rows(position, model.prior_sd * [share.get(p.effect, 0.0) for p in model.parameters], conditions)[0].T
            for model, position in found
        ]

    return points


@pytest.mark.parametrize("name", [name for name in catalogue() if name not in OF_ONE_CONVENTION])
def test_effects_are_the_same_in_both_conventions(conventions: Callable[[str], list[np.ndarray]], name: str) -> None:
    """Breaks if an effect takes a link's far end, axis or frame for what it is in the other convention."""
    (plain, other_plain), (dh, other) = conventions(""), conventions(name)
    assert_allclose(plain, other_plain, rtol=0, atol=1e-12)
    effect = np.abs(dh - plain).max()
    assert effect > 1e-6
    assert_allclose(dh, other, rtol=0, atol=2e-3 * effect)


@pytest.mark.parametrize("name", ROBOTS)
def test_gravity_deflection_stands_for_springs(benches: dict[str, Bench], name: str) -> None:
    """Breaks if first moments and compliance, of a robot without masses, leave a part of what springs do under any load."""
    bench = benches[name]
    bare = without_masses(name)
    model = Model(bare, (catalogue()["gravity-deflection"](bare),), bench.data.given)
    real, plain = bench.points(), bench.points(soft=False)
    seen = np.arange(len(real)) % 4 != 1
    assert {0, 1, 2} == set(bench.rows.payload[seen]) == set(bench.rows.payload[~seen])
    conditions, p = bench.table.conditions, np.zeros(len(model.parameters))
    for _ in range(2):
        slope = model.position_jacobian(p, conditions[:, seen]).reshape(-1, len(p)) * model.prior_sd
        left = (real[seen] - model.position(p, conditions[:, seen])).ravel()
        p = p + model.prior_sd * np.linalg.lstsq(slope, left, rcond=1e-9)[0]
    apart, effect = (
        np.linalg.norm(shift[~seen], axis=1) for shift in (model.position(p, conditions) - real, real - plain)
    )
    assert effect.max() > 2e-3
    assert apart.max() < 0.01 * effect.max()


def without_masses(name: str) -> Robot:
    """The robot whose links' masses nobody knows."""
    file = robot_file(stated_tables(Case(robot=name, base=BASE)), masses=False)
    return Robot(**parts_of(file, Origin(Path(), (), {})))


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("joint", [2, 6])
def test_a_joint_error_map_follows_a_smooth_curve(
    benches: dict[str, Bench], dense: Measurements, joint: int, length: float
) -> None:
    """Breaks if the waves do not reach the travel's ends, are too few, or their priors are those of other waves."""
    effect = next(e for e in catalogue()["joint-error-map"].variants(dense.robot, dense) if e.length == length)
    sd = np.array([parameter.prior_sd for parameter in effect.declared if parameter.joint == joint])
    angle = dense.joints[:, joint - 1]
    real = benches["serial"].real
    rows = replace(benches["serial"].rows, q=dense.joints)
    curve = joint_error_map(
        Hidden("joint-error-map", joint, AMPLITUDE, seed=7), real, rows, np.zeros_like(dense.joints)
    )
    seen, noise = np.arange(len(angle)) % 4 != 0, 0.01 * AMPLITUDE
    scaled = waves(effect, joint, angle) * sd
    found = np.linalg.solve(scaled[seen].T @ scaled[seen] + noise**2 * np.eye(len(sd)), scaled[seen].T @ curve[seen])
    left = (scaled @ found - curve)[~seen]
    assert np.sqrt(np.mean(left**2)) < 0.01 * curve.std()

    middle = np.array([(effect.low[joint - 1] + effect.high[joint - 1]) / 2])
    variance = ((waves(effect, joint, middle) * sd) ** 2).sum()
    assert variance == pytest.approx(AMPLITUDE**2, rel=0.03)


def test_far_travel_makes_hysteresis_backlash(benches: dict[str, Bench]) -> None:
    """Breaks if friction develops to another size than h, or does not begin on the side where the joint was before."""
    robot = benches["serial"].robot
    loads, row = State.symbols(robot), Row.symbols(robot)
    length = np.deg2rad(4.0)
    hysteresis, backlash = (
        made(benches["serial"], "joint-hysteresis", length=length),
        made(benches["serial"], "joint-backlash"),
    )
    terms = [effect.terms(2, loads, row)[0].value for effect in (hysteresis, backlash)]
    values = ca.Function("terms", [row.approach, row.travel], terms)
    for side in (-1.0, 1.0):
        approach, travel = np.full(6, side), np.full(6, 100 * length)
        h, b = (float(value) for value in values(approach, travel))
        assert h == pytest.approx(2 * b) == side  # as large for h = b / 2
        assert float(values(approach, 0 * travel)[0]) == -side
        assert float(values(approach, np.full(6, np.log(2) * length))[0]) == pytest.approx(0)


@pytest.mark.parametrize("name", ROBOTS)
def test_range_noise_grows_with_distance(benches: dict[str, Bench], name: str) -> None:
    """Breaks if the scatter is not that of noise in proportion to the distance from the device, or a point is moved."""
    bench = benches[name]
    model = Model(bench.robot, (made(bench, "range-noise"),), bench.data.given)
    p, c = ca.SX.sym("p"), ca.SX.sym("c", model.n_conditions)
    row = Row.unpack(bench.robot, c, bench.data.given)
    scatter = ca.Function("scatter", [p, c], [ca.densify(ca.SX(model.effects[0].scatter(p, row)))])
    found = over_rows(scatter, np.array([2.5e-5]), bench.table.conditions)[0].ravel()
    assert_allclose(found, 2.5e-5 * np.linalg.norm(bench.table.position, axis=1), rtol=1e-12)
    assert model.effects[0].scatter(p, Row.unpack(bench.robot, c)) == 0  # of rows whose distance nobody knows
    assert not ca.jacobian(model.expression(p, c).position, p).nnz()
