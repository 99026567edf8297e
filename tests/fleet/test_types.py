"""What the robots of a type tell together: tables, words, and a robot file that needs fewer poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calflow as cf
from calflow.files.tables import to_frame
from calflow.fleet.fleet_report import type_blocks
from calflow.fleet.types import (
    Collected,
    TypeFindings,
    TypeParameter,
    by_type,
    moved_at_tool,
    type_lines,
    unlike_parameters,
)
from calflow.model import build
from calflow.population.common_causes import CommonCause, Shown
from calflow.population.likelihood import ParameterEstimates
from calflow.population.unlike import Unlike
from calflow.study import load_study
from estimation.data import measured
from robots import hh800

EFFECTS = ("geometry", "joint-compliance")
ROBOTS, ODD = 5, "r3"
WAVE = Shown("gear-transmission-error", 3, "order 101", 1e-4, 1e-5, "rad")


@pytest.fixture(scope="module")
def fleet() -> list[Collected]:
    """Five robots of a type a tenth of the prior apart, one of which has its fourth joint's zero elsewhere."""
    robot, rng = hh800(), np.random.default_rng(1)
    model = build(robot, EFFECTS)
    mean = np.clip(0.2 * model.prior_sd * rng.standard_normal(len(model.parameters)), *model.bounds.T)
    zero = next(k for k, one in enumerate(model.parameters) if one.name == "joint4.theta")
    found = []
    for k in range(ROBOTS):
        truth = mean + 0.02 * model.prior_sd * rng.standard_normal(len(mean))
        truth[zero] += 1.5 * model.prior_sd[zero] * (f"r{k}" == ODD)
        data = measured(model, np.clip(truth, *model.bounds.T), 50, rng)
        data = replace(data, table=data.table.assign(sigma=3e-5))
        known = cf.identify(robot, data, EFFECTS, starts=1)
        found.append(Collected(f"r{k}", "hh800", ParameterEstimates.of(known), (WAVE,)))
    return found


@pytest.fixture(scope="module")
def findings(fleet) -> TypeFindings:
    (one,) = by_type(fleet)
    return one


def test_the_odd_robot_is_named_with_what_is_unlike(findings):
    """Fails if a robot of a fleet stands out in one parameter and nobody is told, or another robot is."""
    (row,) = findings.unlike
    assert row.robot == ODD
    assert "joint4.theta" in (row.parameter, *row.instead)
    assert row.p < 0.05
    ((said, *_),) = unlike_parameters([findings], {row: 1.234}).values()
    assert row.meaning in said
    assert said.endswith("1.23 mm at the tool")
    assert type_lines([findings], 5)[0].startswith(f"Unlike the other 4 of type hh800: {ODD} (")


def test_a_deviation_is_told_by_how_far_it_moves_the_tool():
    """Fails if a marker that sits 2 mm off does not move the tool by 2 mm, or an angle does by anything but its arms."""
    study = load_study(Path(__file__).parents[2] / "studies/hh800/study.toml")
    off = [
        Unlike(robot="r", parameter=name, unit=unit, shift=size, sd=1e-4, spreads=9.0, p=1e-6)
        for name, size, unit in (("E.x", 2e-3, "m"), ("joint2.theta", 1e-3, "rad"))
    ]
    marker, shoulder = moved_at_tool(study, off).values()
    assert marker == pytest.approx(2.0, rel=1e-3)
    assert 1.0 < shoulder < 4.0  # a milliradian at one to four metres


def test_a_cause_that_all_show_is_told_as_the_types(findings):
    """Fails if what every robot of a type shows is not said to be the type's."""
    (row,) = findings.causes
    assert (row.whose, row.joint, row.of, len(row.robots)) == ("type", 3, ROBOTS, ROBOTS)
    assert any("5 of 5 robots of type hh800 show" in line and "type's" in line for line in type_lines([findings], 5))


def test_the_types_robot_file_needs_fewer_poses(findings, tmp_path):
    """Fails if what a fleet knows is lost on its way into a robot file, or helps no further robot."""
    expecting = findings.expecting(hh800())
    expecting.to_toml(tmp_path / "type.toml")
    assert cf.Robot.from_toml(tmp_path / "type.toml") == expecting
    model = build(hh800(), EFFECTS)
    where = {(one.effect, "", one.part, one.symbol): k for k, one in enumerate(model.parameters)}
    truth, rng = np.zeros(len(model.parameters)), np.random.default_rng(5)
    for one in expecting.expected:
        truth[where[one.key]] = np.clip(one.mean, *model.bounds[where[one.key]])
    few, further = measured(model, truth, 14, rng), measured(model, truth, 60, rng)
    few = replace(few, table=few.table.assign(sigma=3e-5))
    where_it_is = model.position(truth, further.conditions)
    errors = []
    for robot in (hh800(), expecting):
        known = cf.identify(robot, few, EFFECTS, starts=1)
        left = known.model.position(known.estimate, further.on(known.model.robot).conditions) - where_it_is
        errors.append(np.linalg.norm(left, axis=1).mean())
    assert errors[1] < 0.8 * errors[0]


def test_tables_and_words_are_whole(findings):
    """Fails if a row of a table cannot be made, or the report's part is empty."""
    for rows, kind in (
        (findings.parameters(), TypeParameter),
        (findings.unlike, Unlike),
        (findings.causes, CommonCause),
    ):
        assert len(to_frame(list(rows), kind))
    assert len(list(type_blocks([findings]))) >= 5


def test_two_robots_make_no_type(fleet):
    """Fails if a spread of two robots is stated, or the report of a small plant cannot be written."""
    (one,) = by_type(fleet[:2])
    assert one.prior is None
    assert not list(one.parameters())
    assert one.expecting(hh800()) is None
    assert list(type_blocks([one]))
