"""What one more thing is worth, and what a drift would pull, against least squares set up by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import qmc

from calflow.design.candidates import packed_conditions
from calflow.design.measuring_order import drift_pulls, orders
from calflow.design.optimality import information
from calflow.design.planned import Planned, SelectionRequest, Task
from calflow.design.worth import ASIDE, PlanInformation
from calflow.measurements.series import Series
from calflow.model import build
from calflow.observations.position import Position
from calflow.robot.parts import Marker, Named
from robots import industrial

SIGMA = 5e-5
POSES = 24
PLANNED = Planned(Position.planned(Series()), SIGMA)


def plan_of(robot):
    """A plan of poses of a robot, everywhere within its limits."""
    model = build(robot, ("geometry",), (), (PLANNED.observation,))
    drawn = qmc.scale(qmc.Sobol(robot.n_joints, rng=np.random.default_rng(1)).random(64), *robot.limits.T)
    marker = next(iter(robot.markers))
    task = Task.of(drawn[POSES + 10 :], [""], marker).criterion(model)
    further = (
        PLANNED.whitened(model, model.nominal, packed_conditions(model, drawn[POSES : POSES + 10], "", marker))
        * model.prior_sd
    )
    asked = SelectionRequest(number=POSES, marker=marker, planned=PLANNED, order="random", drift=1e-4)
    own = asked.whitened(model, drawn[:POSES])
    return PlanInformation(model, asked, drawn[:POSES], own, np.eye(len(model.parameters)), task, further)


@pytest.fixture(scope="module")
def plan():
    """A plan of a robot with one marker."""
    return plan_of(industrial())


def of(plan, words):
    """What is said of an addition."""
    (row,) = (row for row in plan.worth if words in row.addition)
    return row


def test_measuring_twice_and_ten_more_are_what_their_rows_tell(plan):
    """Fails if a repeat, or further poses, count otherwise than as rows that are there besides."""
    own = plan.own.reshape(-1, len(plan.prior))
    more = plan.further.reshape(-1, len(plan.prior))
    for words, rows in (("twice", np.vstack([own, own])), ("10 further", np.vstack([own, more]))):
        known = rows.T @ rows + plan.prior
        assert of(plan, words).expected_sd_mm == pytest.approx(1e3 * plan.tool.loss(np.linalg.inv(known)), rel=1e-6)
    assert plan.worth[0].addition == ""
    assert [row.expected_sd_mm for row in plan.worth[1:]] == sorted(row.expected_sd_mm for row in plan.worth[1:])


def test_a_second_station_has_its_own_place_to_tell(plan):
    """Fails if where a second device stands counts as known, or its readings do not count."""
    points = plan.model.point(plan.model.nominal, packed_conditions(plan.model, plan.readings, "", plan.request.marker))
    own = plan.own.reshape(-1, len(plan.prior))
    motion = np.concatenate([np.concatenate([-np.eye(3), np.cross(np.eye(3), point).T], axis=1) for point in points])
    motion *= 0.5 / SIGMA  # m and rad: nobody knows where it stands
    both = np.vstack([np.hstack([own, 0 * motion]), np.hstack([own, motion])])
    known = both.T @ both + np.eye(both.shape[1])
    covariance = np.linalg.inv(known)[: own.shape[1], : own.shape[1]]
    said = of(plan, "second station").expected_sd_mm
    assert said == pytest.approx(1e3 * plan.tool.loss(covariance), rel=1e-3)
    assert of(plan, "twice").expected_sd_mm < said < plan.worth[0].expected_sd_mm


def test_a_marker_is_worth_the_same_whether_the_file_has_it_or_not(plan):
    """Fails if a marker that is only thought of counts otherwise than one of the robot file, or its place as known."""
    robot = plan.model.robot
    (first,) = robot.markers.values()
    aside = np.where(np.arange(3) == np.argmin(np.abs(first.point[:2])), ASIDE, 0.0)
    markers = Named({**robot.markers, "F": Marker(tuple(np.array(first.point) + aside))})
    thought, there = of(plan, "second marker"), of(plan_of(replace(robot, markers=markers)), "marker 'F'")
    assert thought.expected_sd_mm == pytest.approx(there.expected_sd_mm, rel=1e-6)
    assert thought.n_points == 2 * POSES


def test_what_gains_most_is_named(plan):
    """Fails if the parameters named are not those whose standard deviations fall most, or by how much is wrong."""
    before, after = plan.covariance, np.linalg.inv(information(plan.own, information(plan.own, plan.prior)))
    falls = 100 * (1 - np.sqrt(np.diag(after) / np.diag(before)))
    row = of(plan, "twice")
    names = [parameter.name for parameter in plan.model.parameters]
    assert row.falls_percent == pytest.approx([round(falls[names.index(name)], 1) for name in row.parameters])
    assert row.falls_percent[0] == pytest.approx(round(falls.max(), 1))


def test_a_drift_pulls_as_far_as_a_fit_to_drifting_points_goes(plan):
    """Fails if the pull told is not that of a fit to points that drift, of the worst direction."""
    every = orders(plan, np.random.default_rng(2))
    pulls = {(row.order, row.drifting): row for row in drift_pulls(plan, every)}
    own = plan.own.reshape(-1, len(plan.prior))
    for name, order in every.items():
        assert sorted(order) == list(range(POSES))
        wanders = np.empty(POSES)
        wanders[order] = np.linspace(-0.5, 0.5, POSES)
        tool = []
        for direction in qmc.MultivariateNormalQMC(np.zeros(3), rng=np.random.default_rng(3)).random(512):
            way = direction / np.linalg.norm(direction)
            y = np.append((1e-4 / SIGMA * wanders[:, None] * way).ravel(), np.zeros(len(plan.prior)))
            found = np.linalg.lstsq(np.vstack([own, np.eye(len(plan.prior))]), y, rcond=None)[0]
            tool.append(1e3 * np.sqrt(((plan.tool.slopes @ found) ** 2).sum(axis=1).mean()))
        assert max(tool) == pytest.approx(pulls[name, "device"].tool_pull_mm, rel=0.02)
        assert max(tool) <= pulls[name, "device"].tool_pull_mm * (1 + 1e-9)


def test_the_random_order_is_pulled_less_on_ways_that_stay_bounded(plan):
    """Fails if the order that is to resist drift is pulled more than the short one, or sends the robot about without end."""
    rows = drift_pulls(plan, orders(plan, np.random.default_rng(2)))
    worst = {name: max(row.tool_pull_mm for row in rows if row.order == name) for name in ("short", "random")}
    assert worst["random"] < worst["short"]
    assert all(row.travel == 1.0 for row in rows if row.order == "short")
    assert all(1.0 <= row.travel < 2.5 for row in rows if row.order == "random")
    assert {row.taken for row in rows if row.order == "random"} == {True}
