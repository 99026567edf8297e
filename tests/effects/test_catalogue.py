"""What effects say of themselves: their variants, names, needs and sizes."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields, replace
from math import pi
from typing import Any

import casadi as ca
import numpy as np
import pytest

from calflow.effects import Effect, catalogue
from calflow.effects.cause import Cause
from calflow.effects.joint_error_map import LENGTHS
from calflow.files.problems import InputError
from calflow.measurements.measurements import Measurements
from calflow.measurements.rows import condition_columns, numbered
from calflow.measurements.series import Series, Station
from effects.bench import ROBOTS, UNSHOWN, Bench, made, waves
from effects.twins import SHARED, STEPS

VARIANTS = {  # how many forms there are to try, where not one
    "base-compliance": 2,
    "base-play": 24,
    "link-torsion": 2,
    "nonlinear-joint-stiffness": 7,
    "loaded-transmission-error": 6,
    "torque-backlash": 2,
    "joint-eccentricity": 3,
    "gear-transmission-error": 2,
    "gravity-compensator": 5,
    "gravity-deflection": 2,
    "link-bending": 8,
    "bearing-compliance": 2,
    "axis-wobble": 2,
    "joint-hysteresis": 5,
    "joint-error-map": 3,
    "tool-deflection": 4,
    "tool-sag": 4,
    "base-tilt": 3,
    "thermal-growth": 18,
    "housing-growth": 18,
    "frame-drift": 6,
    "stand-growth": 18,
    "scale-growth": 9,
    "session-frame": 8,
}


def figures(effect: Effect) -> tuple[Any, ...]:
    """What makes the variant."""
    return tuple(getattr(effect, field.name) for field in fields(effect) if field.name != "robot")


@pytest.mark.parametrize("name", [name for name in catalogue() if name not in UNSHOWN])
def test_variants_are_distinct_and_told_apart(full: Measurements, name: str) -> None:
    """Breaks if one form is tried twice, two forms are called alike, or one of several has no words of its own."""
    variants = catalogue()[name].variants(full.robot, full)
    assert all(type(effect) is catalogue()[name] and effect.robot == full.robot for effect in variants)
    if name in SHARED - {"periodic-joint-error"} - STEPS:
        assert len(variants) == VARIANTS.get(name, 1)
    assert len({figures(effect) for effect in variants}) == len(variants)
    details = {effect.detail for effect in variants}
    assert len(details) == len(variants)
    assert ("" in details) == (len(variants) == 1)
    for effect in variants[:8]:
        names = [parameter.name for parameter in effect.declared]
        assert names
        assert len(set(names)) == len(names)
    if name not in (
        *STEPS,
        "periodic-joint-error",
        "torque-backlash",
        "base-play",
        "bearing-play",
        "loaded-transmission-error",
        "gravity-compensator",
    ):
        assert variants[0].finer(full) == ()


@pytest.mark.parametrize("robot", ROBOTS)
def test_no_two_parameters_share_an_identity_or_a_name(benches: dict[str, Bench], robot: str) -> None:
    """Fails if two variants of an effect, or two effects at one place, have a parameter that goes by the same name."""
    stated, table = benches[robot].robot, benches[robot].data.table.copy()
    limits = np.where(np.isfinite(stated.limits), stated.limits, np.sign(stated.limits) * pi)
    table[numbered("q", 6)] = np.random.default_rng(8).uniform(*limits.T, (len(table), 6))
    data = Measurements(stated, table)
    forms: dict[tuple[Any, ...], Effect] = {}
    for name, kind in catalogue().items():
        variants = kind.variants(stated, data)
        assert variants or kind.lacking(stated, data)
        near = [finer for variant in variants[:2] for finer in variant.finer(data)]
        forms |= {
            (name, *(f"{figure:.12g}" if isinstance(figure, float) else figure for figure in figures(effect))): effect
            for effect in (*variants, *near)
        }  # 1800 and exp(log(1800)) are one
    parameters = [parameter for effect in forms.values() for parameter in effect.declared]
    assert len(parameters) > 3000
    assert len({parameter.identity for parameter in parameters}) == len(parameters)
    assert len({parameter.name for parameter in parameters}) == len(parameters)
    for parameter in parameters:
        plain = parameter.effect in ("geometry", "joint-compliance")
        assert (parameter.name == f"{parameter.part}.{parameter.symbol}") == plain
        assert plain or parameter.effect in parameter.name
        assert len(parameter.variant) < 40
        assert not set(parameter.variant) & set(",;[]")  # which lists of names, and names, are made with


def test_names_tell_the_variant_and_stay_the_same_at_one_place(benches: dict[str, Bench]) -> None:
    """Fails if a cause's parameters are called otherwise than its effect's, or a name hides which form it is of."""
    robot = benches["serial"].robot
    eccentric = made(benches["serial"], "joint-eccentricity", order=2)
    own = Cause(robot, eccentric, "joint3").declared
    assert [parameter.name for parameter in own] == [
        "joint3.joint-eccentricity[order 2].cos",
        "joint3.joint-eccentricity[order 2].sin",
    ]
    assert own == tuple(parameter for parameter in eccentric.declared if parameter.joint == 3)
    assert made(benches["serial"], "joint-backlash").declared[1].name == "joint2.joint-backlash.b"
    drift = made(benches["serial"], "frame-drift", turning=True).declared[0]
    assert drift.identity == ("frame-drift", "turning", "device", "vx")


def test_a_knee_between_two_that_are_tried_is_reached(full: Measurements) -> None:
    """Breaks if refinement leaves gaps between the knees, or does not become denser towards the best one."""
    variants = [effect for effect in catalogue()["nonlinear-joint-stiffness"].variants(full.robot, full) if effect.knee]
    knees = [effect.knee for effect in variants]
    for variant in variants:
        finer = np.array([effect.knee for effect in variant.finer(full)])
        assert finer.min() > 0
        assert np.diff(finer).max() < 0.05
        assert np.sort(np.abs(finer - variant.knee))[1] < 0.005
        assert all(np.abs(finer - other).min() < 0.05 for other in knees if abs(other - variant.knee) < 0.16)


def test_figures_of_earlier_runs_are_read(full: Measurements) -> None:
    """Fails if a run cannot be loaded for a figure that an effect has no longer, or for a knee that was stated without a law."""
    every = catalogue()
    spring, lens, robot = every["nonlinear-joint-stiffness"], every["lens-growth"], full.robot
    for law in spring.variants(robot, full):
        assert spring.of_figures(robot, law.figures_text) == law
    assert spring.of_figures(robot, '{"knee": 0.2}') == spring(robot, "knee", 0.2)
    assert spring.of_figures(robot, '{"knee": 0.0}') == spring(robot)
    assert lens.of_figures(robot, '{"constant": 600.0, "turning": false}') == lens(robot, constant=600.0)
    with pytest.raises(
        InputError, match=r"'lens-growth' of another version of calflow \(turning\); run the study again"
    ):
        lens.of_figures(robot, '{"turning": true}')


def test_a_load_is_what_the_data_tell(full: Measurements) -> None:
    """Breaks if a wave is tried against a torque or a temperature that nobody knows, or a warm one keeps a loaded one out."""
    kind = catalogue()["loaded-transmission-error"]
    assert [effect.warm for effect in kind.variants(full.robot, full)] == [False] * 3 + [True] * 3
    cold, weightless = without(full, "temperature"), bare(full)
    assert not any(effect.warm for effect in kind.variants(cold.robot, cold))
    assert all(effect.warm for effect in kind.variants(weightless.robot, weightless))
    loaded = kind(full.robot, 1)
    assert loaded.same_as(kind(full.robot, 1))
    assert not any(loaded.same_as(other) for other in (kind(full.robot, 1, warm=True), kind(full.robot, 2)))
    assert [effect.order for effect in loaded.finer(full)] == [2]
    assert [effect.order for effect in kind(full.robot, 2, geared=True).finer(full)] == [1]


def test_backlash_does_not_become_a_stiffness(full: Measurements) -> None:
    """Breaks if a change of sides is refined until it is a smooth function of the torque, or not refined at all."""
    crossings = {effect.crossing for effect in catalogue()["torque-backlash"].variants(full.robot, full)}
    for _ in range(6):
        finer = {e.crossing for c in crossings for e in made_torque(full, c).finer(full)}
        assert finer
        crossings = {min(finer), max(finer)}
    assert min(crossings) < 0.001
    assert 0.025 < max(crossings) <= 0.05


def made_torque(data: Measurements, crossing: float) -> Effect:
    """Backlash by torque with one width of its change of sides."""
    return catalogue()["torque-backlash"](data.robot, crossing)


def test_orders_are_scanned_without_gaps(full: Measurements) -> None:
    """Breaks if an order between two that are tried could be missed, or refinement leaves the neighbourhood."""
    variants = catalogue()["periodic-joint-error"].variants(full.robot, full)
    orders = np.array([effect.order for effect in variants])
    half = np.ptp(full.joints, axis=0).max() / 2
    assert (np.diff(orders) > 0).all()
    assert np.diff(orders).max() * half < 1  # rad of phase at the ends of the longest travel
    assert orders[0] <= 2.5
    assert orders[-1] > 29.5
    finer = np.array([effect.order for effect in variants[20].finer(full)])
    assert orders[19] - 1e-9 <= finer.min() < orders[20] < finer.max() <= orders[21] + 1e-9
    assert np.diff(finer).max() < 0.3 * np.diff(orders).min()
    assert min(effect.order for effect in variants[0].finer(full)) > 2  # below is eccentricity


@pytest.mark.parametrize("name", sorted(STEPS))
def test_every_moment_of_a_step_is_within_reach(full: Measurements, name: str) -> None:
    """Breaks if moments that a long scan leaves out are not tried about the best one, or lie at a row."""
    order, kind = full.table["order"].to_numpy(), catalogue()[name]
    variants = kind.variants(full.robot, full)
    turning = {getattr(effect, "turning", False) for effect in variants}
    assert turning == ({False, True} if name == "frame-step" else {False})  # one marker does not show a tool's rotation
    for turned in turning:
        scan = [effect for effect in variants if getattr(effect, "turning", False) == turned]
        moments = np.array([effect.moment for effect in scan])
        assert 0 < len(moments) <= 43 < len(order)
        assert not np.isin(moments, order).any()
        assert min((order < moments.min()).sum(), (order > moments.max()).sum()) >= 3
        reached = {effect.moment for variant in scan for effect in variant.finer(full)}
        change = np.flatnonzero(full.table["session"].iloc[1:].to_numpy() != full.table["session"].iloc[:-1].to_numpy())
        assert len(change) == 3
        borders = {*(order[change] + 0.5)}
        of_device = borders if name == "frame-step" else set()  # such a change between sessions is a session's frame
        assert reached == {*np.arange(order.min() + 2.5, order.max() - 2)} - of_device
        assert of_device or {*moments} >= borders
        undated = {replace(effect, moment=0.0, between=()) for variant in scan for effect in variant.finer(full)}
        assert undated == {replace(scan[0], moment=0.0, between=())}
    short = full.only(np.arange(len(full)) < 20)
    every = kind.variants(short.robot, short)
    assert len(every) == len(turning) * (20 - 2 * 3 + 1)
    assert kind.variants(short.robot, full.only(np.arange(len(full)) < 5)) == ()


def test_thermal_growth_goes_with_what_was_measured(full: Measurements) -> None:
    """Breaks if a thermometer that stood still is believed, or time is not taken where no temperature is."""
    kind = catalogue()["thermal-growth"]
    assert [effect.constant > 0 for effect in kind.variants(full.robot, full)] == ([False] * 5 + [True] * 4) * 2
    timeless = without(full, "time")
    assert [effect.constant for effect in kind.variants(full.robot, timeless)] == [0.0, 0.0]
    still = Measurements(full.robot, full.table.assign(temperature=293.0))
    assert all(effect.constant > 0 for effect in kind.variants(full.robot, still))
    assert kind.lacking(full.robot, without(still, "time"))


def test_what_grows_on_its_own_is_as_little_as_can_be_told(benches: dict[str, Bench]) -> None:
    """Fails if a stub, or an offset that is a link's length or its neighbour's, is a place of its own."""
    parts = lambda name, **variant: [p.part for p in made(benches["serial"], name, **variant).declared]  # noqa: E731
    assert parts("thermal-growth") == ["links"]
    assert parts("thermal-growth", apart=True) == ["link1", "link2", "link3", "link4", "link6"]
    assert parts("housing-growth") == ["joint2", "joint5"]
    assert parts("housing-growth", turning=True) == [f"joint{k}" for k in range(1, 7)]


def without(data: Measurements, *conditions: str) -> Measurements:
    """The rows without some optional conditions."""
    columns = [column for name in conditions for column in condition_columns(name, data.robot)]
    return Measurements(data.robot, data.table.drop(columns=columns))


def changed(data: Measurements, **fields: Any) -> Measurements:
    """The rows of a robot whose file says something else."""
    return Measurements(replace(data.robot, **fields), data.table)


def bare(data: Measurements) -> Measurements:
    """The rows of a robot whose file tells no masses."""
    return changed(data, joints=tuple(replace(joint, mass=None) for joint in data.robot.joints))


def gearless(data: Measurements) -> Measurements:
    """The rows of a robot whose file tells no gear ratio."""
    return changed(data, joints=tuple(replace(joint, gear_ratio=None) for joint in data.robot.joints))


OF_MASSES = (
    "joint-compliance", "nonlinear-joint-stiffness", "torque-backlash", "bearing-compliance", "bearing-play", "link-bending",
    "link-torsion", "base-compliance", "base-play", "gravity-compensator", "payload-mass", "payload-com", "link-mass",
    "friction-wind-up", "base-off-level", "payload-step", "dress-pack",
)  # fmt: skip
LACKING: list[tuple[str, Callable[[Measurements], Measurements], str]] = [
    *((name, bare, "mass_kg and com_mm") for name in OF_MASSES),
    *((name, lambda data: changed(data, payloads={}), "payload")
      for name in ("payload-mass", "payload-com", "payload-step", "tool-deflection")),
    ("gear-transmission-error", gearless, "gear_ratio"),
    ("joint-backlash", lambda data: without(data, "approach"), "approach1"),
    ("joint-hysteresis", lambda data: without(data, "approach"), "approach1"),
    ("friction-wind-up", lambda data: without(data, "approach"), "approach1"),
    ("loaded-transmission-error", lambda data: bare(without(data, "temperature")), "torques tau1_Nm .* temperature_degC"),
    ("joint-hysteresis", lambda data: without(data, "travel"), "travel1_deg"),
    *((name, lambda data: without(data, "time", "temperature"), "temperature_degC .* time_s")
      for name in ("thermal-growth", "housing-growth", "stand-growth", "scale-growth")),
    ("frame-drift", lambda data: without(data, "time", "order"), "time_s"),
    ("session-frame", lambda data: without(data, "session"), "column session"),
    ("session-frame", lambda data: data.only((data.table["session"] == "tue").to_numpy()), "two sessions"),
    ("session-frame", lambda data: replace(data, series=(Series(station=Station(by_session=True)),)), "by_session"),
    *((name, lambda data: without(data, "order"), "measuring order") for name in sorted(STEPS)),
    ("range-noise", lambda data: without(data, "range"), "tracker_mm"),
    ("joint-error-map", lambda data: data.only(np.arange(len(data)) < 30), "4 per 0.5 rad"),
    ("axis-straightness", lambda data: data, "prismatic joint"),
    ("rod-play", lambda data: data, "no rods"),
    ("gravity-deflection", lambda data: data, "joint-compliance"),
    ("base-tilt", lambda data: data, "base-compliance"),
    *((name, lambda data: data, "relative_sd_mm") for name in ("tracker-scale", "marker-place")),
]  # fmt: skip


@pytest.mark.parametrize(("name", "taken", "words"), LACKING, ids=[f"{row[0]}-{row[2]}" for row in LACKING])
def test_what_is_lacking_is_told_in_words(
    full: Measurements, name: str, taken: Callable[[Measurements], Measurements], words: str
) -> None:
    """Breaks if an effect is looked for in data that cannot show it, or the column that would help is not named."""
    data = taken(full)
    kind = catalogue()[name]
    assert re.search(words, kind.superseded(data.robot, data) or kind.lacking(data.robot, data))
    if name not in (
        "gravity-deflection",
        "base-tilt",
        "tracker-scale",
        "marker-place",
        "axis-straightness",
        "rod-play",
    ):
        assert catalogue()[name].lacking(full.robot, full) == ""


@pytest.mark.parametrize("name", sorted(SHARED - {row[0] for row in LACKING}))
def test_the_others_need_nothing(full: Measurements, name: str) -> None:
    """Breaks if an effect asks for a column that its equation does not have."""
    poor = gearless(changed(bare(without(full, *full.given)), payloads={}))
    poor = poor.only(np.arange(len(poor)) < 50)
    assert catalogue()[name].lacking(poor.robot, poor) == ""
    assert catalogue()[name].variants(poor.robot, poor)


def test_a_curve_is_looked_for_at_lengths_that_the_poses_resolve(full: Measurements) -> None:
    """Fails if few poses are asked for a rough curve, or for none although they show a smooth one."""
    few = full.only(np.arange(len(full)) < 60)
    travels = np.ptp(few.joint_angles, axis=0)
    assert [effect.length for effect in catalogue()["joint-error-map"].variants(full.robot, full)] == list(LENGTHS)
    found = catalogue()["joint-error-map"].variants(few.robot, few)
    assert 0 < len(found) < len(LENGTHS)
    for effect in found:
        looked_for = np.array(effect.high) > np.array(effect.low)
        assert (travels[looked_for] <= len(few) * effect.length / 4).all()


def test_a_size_is_of_one_unit(benches: dict[str, Bench]) -> None:
    """Breaks if metres and radians are added, or a map's size is not the curve's root mean square."""
    drift = made(benches["serial"], "frame-drift", turning=True)
    assert float(ca.DM(drift.size(ca.DM([3.0, 4.0, 0.0, 9.0, 9.0, 9.0]), drift.declared))) == 5.0
    of_map = made(benches["serial"], "joint-error-map", low=(-1.0,) * 6, high=(1.0,) * 6)
    values = np.zeros(sum(parameter.joint == 1 for parameter in of_map.declared))
    values[[1, 4]] = 3e-4, 4e-4
    curve = waves(of_map, 1, np.linspace(-1.1, 1.1, 2001)) @ values
    assert float(ca.DM(of_map.size(ca.DM(values), [p for p in of_map.declared if p.joint == 1]))) == pytest.approx(
        np.sqrt(np.mean(curve**2)), rel=1e-3
    )
