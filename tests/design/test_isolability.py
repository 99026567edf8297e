"""What a plan of poses would show and tell apart, before anything is measured."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import f as f_distribution

from calflow.design.isolability import (
    TYPICAL_ERROR,
    MeasuringPlan,
    chances,
    isolability,
    isolability_gaps,
    isolability_summary,
)
from calflow.design.planned import Planned
from calflow.diagnosis.regressors import Candidate, Regressors, TallMatrix
from calflow.diagnosis.screening import Family, Screening
from calflow.linear import Block
from calflow.measurements.series import Series
from calflow.observations.position import Position
from calflow.robot.robot import Robot
from conftest import SMALL

EFFECTS = ("geometry", "joint-compliance")
POSES = 40
RECORDED = "each joint's direction of approach recorded"


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """What random poses of the small robot tell, with nothing but readings recorded, and with the approach beside."""
    path = tmp_path_factory.mktemp("small") / "robot.toml"
    path.write_text(SMALL["robot.toml"], encoding="utf-8")
    robot = Robot.from_toml(path)
    readings = np.random.default_rng(1).uniform(*robot.limits.T, (POSES, robot.n_joints))
    plan = MeasuringPlan(robot, readings, ("light",) * POSES, ("tool",))
    device = Planned(Position.planned(Series()), 5e-5)
    more = dict(plan.additions(readings[:0]))
    return [
        isolability(EFFECTS, device, one.measurements().split(0.0, 1), np.random.default_rng(2), draws=60)
        for one in (plan, more[RECORDED])
    ]


def test_causes_known_to_be_alike_are_not_told_apart(planned):
    """Fails if a compensator's spring, which turns with joint 2 as its eccentricity does, counts as told from it."""
    plain, _ = planned
    assert plain.told[("joint-eccentricity", "joint2"), None] > 0.9
    assert plain.told[("joint-eccentricity", "joint2"), ("gravity-compensator", "joint2")] < 0.9


def test_a_large_cause_is_seen_and_told(planned):
    """Fails if what is many times the noise, and alike nothing else, is not told from everything."""
    plain, _ = planned
    own = ("gear-ratio-error", "joint1")
    assert plain.told[own, None] > 0.95
    assert all(chance > 0.95 for (true, _), chance in plain.told.items() if true == own)


def test_backlash_takes_the_side_that_joints_come_from(planned):
    """Fails if backlash is said to be seen without approach, or the addition that shows it is not found or not said."""
    plain, approached = planned
    assert "approach1" in plain.lacking["joint-backlash"]
    table = plain.table(1.0, {"nothing": plain, RECORDED: approached})
    (row,) = table[(table["cause"] == "joint-backlash") & table["worst"]].to_dict("records")
    assert (row["chance"], row["addition"]) == (0.0, RECORDED)
    assert row["chance_then"] > 0.9
    assert "is not detected: it takes columns approach1" in row["words"]
    assert f"with {RECORDED} in 100 of 100 (joint1, joint2, joint3)" in row["words"]
    assert (table[table["worst"]]["words"] != "").all()
    sure = (table["cause"] == "gear-ratio-error") & (table["joint"] == 1)
    assert table.loc[sure, "enough"].all()
    assert not table.loc[sure, "worst"].any()
    assert row["words"] in isolability_gaps(table)
    assert isolability_summary(table).startswith(f"of {len(plain.causes)} causes ")


def test_chances_are_those_of_fits_to_simulated_measurements():
    """Fails if a chance is more than four of its standard errors off the share of fits, by code of its own, that come out so."""
    n, number, alarm = 60, 1500, 0.02
    rng = np.random.default_rng(3)
    fitted, base = rng.standard_normal((n, 4)), rng.standard_normal((n, 2))
    matrices = {
        "one": base[:, :1],
        "near": base[:, :1] + 0.5 * rng.standard_normal((n, 1)),
        "two": base + 0.3 * fitted[:, :2],
    }
    sd = {"one": 0.45, "near": 0.6, "two": 0.4}
    prior = np.array([1.0, 2.0, 0.1, 5.0])
    blocks = [Block(name, matrix, sd[name]) for name, matrix in matrices.items()]
    candidates, start = [], 0
    for block in blocks:
        candidates.append(Candidate(block, start + np.arange(block.n_parameters)))
        start += block.n_parameters
    matrix, noise = np.hstack([block.matrix for block in blocks]), rng.standard_normal(n)
    information = fitted.T @ fitted
    taken = float(np.trace(np.linalg.solve(information + np.diag(prior**-2.0), information)))
    regressors = Regressors(
        noise, fitted, prior**-2.0, np.zeros(4), 0.0, TallMatrix.held(matrix), np.concatenate([block.sd for block in blocks]),
        tuple(candidates),
    )  # fmt: skip
    family = Family({}, 5.0)
    told = chances(Screening.of(regressors), family, alarm, rng, draws=number)
    found = _simulated(matrices, sd, fitted, prior, n - taken, 1 - (1 - alarm) ** (1 / 5), number)
    stated = {(true, rival[0] if rival else ""): chance for ((true, _), rival), chance in told.items()}
    assert sum(0.1 < chance < 0.9 for chance in stated.values()) >= 5
    for pair, chance in stated.items():
        error = np.sqrt(2 * max(chance * (1 - chance), 1 / number) / number)
        assert abs(chance - found[pair]) < 4 * error, (pair, chance, found[pair])


SIZES = [2.0**k for k in range(3, -6, -1)]  # over the usual one, the larger the rarer
TIMES = {size: min(1, 1 / size) / sum(min(1, 1 / other) for other in SIZES) for size in SIZES}


def _simulated(matrices, sd, fitted, prior, left, single, number):
    """The share of simulated measurements that leave each cause open (rival ""), and not a rival besides."""
    rng = np.random.default_rng(4)
    shares = {}
    for true, matrix in matrices.items():
        y = np.empty((len(fitted), number))
        for k in range(number):
            theta = rng.standard_normal(matrix.shape[1])
            theta *= sd[true] * np.sqrt(len(theta)) / np.linalg.norm(theta)
            built = TYPICAL_ERROR * prior * rng.standard_normal(fitted.shape[1])
            y[:, k] = fitted @ built + matrix @ theta + rng.standard_normal(len(fitted))
        without = _left(y, fitted, prior)
        cost, passes = {}, {}
        for name, other in matrices.items():
            size = np.full(other.shape[1], sd[name])
            both = np.hstack([fitted, other])
            drop = without - _left(y, both, np.append(prior, size))
            hat = other - fitted @ np.linalg.solve(fitted.T @ fitted + np.diag(prior**-2.0), fitted.T @ other)
            known = np.linalg.eigvalsh(sd[name] ** 2 * other.T @ hat)
            likelihood = np.zeros(number)
            for times, weight in TIMES.items():
                left_then = _left(y, both, np.append(prior, times * size))
                likelihood += weight * (left_then / without) ** (-left / 2) / np.sqrt(np.prod(1 + times**2 * known))
            cost[name] = -2 * np.log(likelihood)
            free = without - _left(y, both, np.append(prior, np.full(len(size), 1e6)))
            d = len(size)
            p = f_distribution.sf(free / d / ((without - free) / (left - d)), d, left - d)
            passes[name] = (p < single) & (cost[name] < 0) & (drop / without > 0.01)
        best = np.min([np.where(passes[name], cost[name], np.inf) for name in matrices], axis=0)
        best = np.where(np.isfinite(best), best, -np.inf)  # where nothing passes, nothing may be
        may_be = {name: cost[name] - best < 10 for name in matrices}
        shares[true, ""] = may_be[true].mean()
        shares |= {(true, rival): (may_be[true] & ~may_be[rival]).mean() for rival in matrices.keys() - {true}}
    return shares


def _left(y, matrix, prior):
    """Chi² (number,) of the best fits to columns of y (n, number) with priors about zero."""
    span = np.linalg.qr(np.vstack([matrix, np.diag(1 / prior)]))[0][: len(y)]
    return (y**2).sum(axis=0) - ((span.T @ y) ** 2).sum(axis=0)
