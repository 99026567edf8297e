"""The diagnosis without a robot finds hidden blocks of a linear problem, and promises no more than it keeps.

A probe's temperature is read over ten hours; a cubic course is fitted anyway. What may be hidden: a heater that switches, a fan
beside it that hardly differs, a wave of unknown frequency, a step at an unknown moment, a decay.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from calflow.diagnosis.extension import extend
from calflow.diagnosis.screening import Catalogue
from calflow.diagnosis.stepwise import CauseAcceptance, Stepwise
from calflow.diagnosis.trial import Linearisation
from calflow.estimation.progress import nobody
from calflow.files.problems import InputError
from calflow.linear import Block, LinearProblem, diagnose_linear
from diagnosis.found import cause, hidden, start

N, SIGMA = 90, 0.1  # readings, K
TIME = np.linspace(0.0, 10.0, N)
COURSE = np.vander(TIME / 10, 4)
FREQUENCIES = np.round(np.arange(0.6, 3.0, 0.2), 1)
HEATER = np.where(TIME % 2.5 < 1.0, 1.0, 0.0)


def wave(frequency):
    """A wave of this frequency, in Hz an hour's worth."""
    angle = 2 * np.pi * frequency * TIME
    return Block("wave", np.column_stack([np.cos(angle), np.sin(angle)]), 0.3, f"frequency {frequency:.1f}")


def switching(name="heater", width=1.0, **limits):
    """What switches as the heater does, a little longer or shorter."""
    return Block(name, np.where(width > TIME % 2.5, 1.0, 0.0)[:, None], 0.3, **limits)


def steps():
    """Steps at nine moments."""
    return [Block("step", (moment < TIME).astype(float)[:, None], 0.3, f"at {moment} h") for moment in range(1, 10)]


DECAY = Block("decay", np.exp(-TIME)[:, None], 0.3)
EVERY = (switching(), DECAY, *map(wave, FREQUENCIES), *steps())


def found(effect, candidates=EVERY, seed=1, noise=SIGMA, **settings):
    """Diagnose readings of an effect (n,) and noise, about a course that is not zero."""
    rng = np.random.default_rng(seed)
    residual = COURSE @ np.array([1.0, -2.0, 0.5, 20.0]) - effect - SIGMA * rng.standard_normal(N)
    return diagnose_linear(residual, COURSE, candidates, rng=rng, noise=noise, **settings)


@pytest.mark.parametrize("noise", [SIGMA, None])
def test_a_hidden_block_is_found_and_named(noise):
    """Fails if what is hidden is not found, is another size, passes for another variant, or the noise must be known for it."""
    block = wave(1.4)
    told = found(block.matrix @ [0.1, -0.2], noise=noise)
    (one,) = told.findings
    assert (one.name, one.variant) == ("wave", "frequency 1.4")
    assert np.abs((one.estimate - [0.1, -0.2]) / one.sd).max() < 3
    assert one.sd == pytest.approx(SIGMA * np.sqrt(2 / N), rel=0.25)
    assert (one.p < 1e-6, one.probability > 0.999, one.rivals) == (True, True, ())
    assert told.untestable == ()


def test_look_alikes_are_rivals():
    """Fails if one of two that the data do not tell apart is named for certain, or a clear one is vague."""
    fan = switching("fan", 1.05)
    (one,) = found(0.15 * HEATER, (*EVERY, fan)).findings
    assert {one.name, *(rival.name for rival in one.rivals)} == {"heater", "fan"}
    assert abs(one.rivals[0].cost) < 10
    assert one.probability < 0.999
    (alone,) = found(0.3 * HEATER, (*EVERY, switching("fan", 2.0))).findings
    assert (alone.name, alone.rivals) == ("heater", ())


def test_two_at_once_are_found():
    """Fails if the search stops after the first, or gives one cause the part of another."""
    told = found(0.3 * HEATER + wave(2.2).matrix @ [0.2, 0.1])
    by_name = {one.name: one for one in told.findings}
    assert set(by_name) == {"heater", "wave"}
    assert abs(by_name["heater"].estimate[0] - 0.3) < 3 * by_name["heater"].sd[0]
    assert by_name["wave"].variant == "frequency 2.2"


def test_one_that_imitates_two_gives_way_to_them():
    """Fails if there is no exchange: what looks like two others together is found first and stays in their place."""
    rng = np.random.default_rng(8)
    first, second, apart = rng.standard_normal((3, N))
    both = [Block(name, matrix[:, None], 1.0) for name, matrix in (("first", first), ("second", second))]
    mixed = Block("mixed", (first + second + 0.8 * apart)[:, None], 1.0)
    told = found(0.1 * (first + second), (*both, mixed))
    assert {one.name for one in told.findings} == {"first", "second"}


@pytest.mark.parametrize("hidden_blocks", [1, 2])
def test_a_second_block_is_judged_beside_the_first(hidden_blocks):
    """Breaks if a found block's share of the readings counts as uneven noise in the correction for the number of tests."""
    found_blocks = []
    for seed in range(8):
        rng = np.random.default_rng([7, seed])
        common = rng.standard_normal((100, 1))
        drives = np.sqrt(0.1) * rng.standard_normal((100, 12)) + np.sqrt(0.9) * common
        blocks = [Block(f"drive {k}", drives[:, [k]], 5.0) for k in range(12)]
        residual = -drives[:, :hidden_blocks].sum(axis=1) - rng.standard_normal(100)
        told = diagnose_linear(residual, np.ones((100, 1)), blocks, rng=rng)
        found_blocks.append(len(told.findings))
    assert max(found_blocks) <= hidden_blocks
    assert np.mean(found_blocks) > 0.65 * hidden_blocks


def test_nothing_hidden_raises_no_more_alarms_than_are_allowed():
    """Fails if the number of causes is not paid for, a bound of 1 in 1000: each is as large as noise makes one of twenty, for which
    the evidence asks nothing more, so that every second draw has one by itself beyond 5 %. Variants are the next test's.
    """
    rng, alarms, draws, allowed = np.random.default_rng(5), 0, 25, 0.05
    few = [Block(f"{k}", one[:, None], 3.0 / np.sqrt(N)) for k, one in enumerate(rng.standard_normal((20, N)))]
    for _ in range(draws):
        residual = rng.standard_normal(N)
        alarms += bool(diagnose_linear(residual, COURSE, few, rng=rng, noise=1.0, false_alarm=allowed).findings)
    assert alarms <= binom.isf(1e-3, draws, allowed)


def test_variants_are_paid_for():
    """Fails if a scan over many forms costs no more than one form: the same wave is less certain then."""
    effect = wave(1.4).matrix @ [0.1, 0.0]
    (one,) = found(effect, (wave(1.4),)).findings
    (among,) = found(effect, tuple(map(wave, FREQUENCIES))).findings
    assert 3 * one.p < among.p < 40 * one.p


def test_readings_that_share_an_error_count_once():
    """Fails if the number of readings at one moment makes their common error a finding."""
    rng, size = np.random.default_rng(4), 6
    groups = np.repeat(np.arange(N // size), size)
    candidates = [
        Block(f"{k}", one[groups][:, None], 1.0) for k, one in enumerate(rng.standard_normal((20, N // size)))
    ]
    alarms = 0
    for draw in range(4):
        residual = rng.standard_normal(N // size)[groups] + 0.3 * rng.standard_normal(N)
        told = diagnose_linear(residual, COURSE, candidates, rng=rng, groups=groups, false_alarm=0.05)
        alarms += bool(told.findings)
        if draw == 0:  # as if each counted
            assert diagnose_linear(residual, COURSE, candidates, rng=rng, false_alarm=0.05).findings
    assert alarms <= binom.isf(1e-3, 4, 0.05)


def test_priors_say_what_can_be_tested():
    """Fails if what is too small to be seen at its usual size is tested, or what the fit imitates is not told."""
    tiny, imitated = replace(DECAY, prior_sd=1e-3), Block("drift", COURSE[:, :1], 1.0)
    told = found(0.3 * HEATER, (switching(), tiny, imitated, *steps()))
    assert [one.name for one in told.findings] == ["heater"]
    assert told.untestable == ("decay", "drift")
    kept = found(0.3 * HEATER, (switching(), imitated), prior_sd=np.array([1e-3, 3.0, 3.0, 100.0]))
    assert kept.untestable == ()


def test_a_prior_of_what_is_fitted_counts():
    """Fails if a course that is known beforehand is fitted as if it were not: a slow decay is seen beside a known one only."""
    slow = Block("decay", np.exp(-TIME / 8)[:, None], 0.5)
    rng = np.random.default_rng(3)
    residual = -0.4 * slow.matrix[:, 0] - SIGMA * rng.standard_normal(N)
    known, free = (
        diagnose_linear(residual, COURSE, (slow,), rng=rng, noise=SIGMA, prior_sd=sd) for sd in (np.full(4, 1e-3), None)
    )
    assert [one.name for one in known.findings] == ["decay"]
    assert free.findings == ()


def test_what_a_bound_excludes_is_not_found():
    """Fails if a block is found with a sign that it cannot have."""
    against = switching(upper=0.0)
    assert found(0.3 * HEATER, (against,)).findings == ()
    (one,) = found(-0.3 * HEATER, (against,)).findings
    assert one.estimate[0] == pytest.approx(-0.3, abs=0.1)


def test_a_bound_is_kept_in_the_model():
    """Fails if the fit of all together ignores bounds, or what a bound holds still moves."""
    limited = Block("limited", np.column_stack([HEATER, np.exp(-TIME)]), 1.0, lower=[-0.1, -5.0], upper=[0.1, 5.0])
    rng = np.random.default_rng(2)
    residual = (-0.3 * HEATER + SIGMA * rng.standard_normal(N)) / SIGMA
    problem = LinearProblem(residual, COURSE / SIGMA, np.full(4, 1e3), (limited,), limited.matrix / SIGMA, True, None)
    solution = problem.solved((limited,))
    assert solution.estimate[4] == pytest.approx(0.1)
    assert list(solution.at_bound) == [False] * 4 + [True, False]
    other = np.hstack([COURSE, np.exp(-TIME)[:, None]]) / SIGMA
    left = residual + 0.1 * HEATER / SIGMA
    expected = -np.linalg.solve(other.T @ other + solution.level**2 * np.diag([1e-6] * 4 + [1.0]), other.T @ left)
    assert solution.estimate[[0, 1, 2, 3, 5]] == pytest.approx(expected, rel=1e-6)


def test_figures_of_no_use_are_refused_together():
    """Fails if a shape that does not fit is stretched, or only the first problem is told."""
    with pytest.raises(InputError) as told:
        diagnose_linear(np.ones(N), COURSE, (replace(DECAY, matrix=DECAY.matrix[1:]), replace(switching(), prior_sd=0.0)),
                        rng=np.random.default_rng(1), noise=-1.0, groups=np.zeros(3))  # fmt: skip
    assert len(told.value.problems) == 4
    assert f"candidate decay: expected a matrix of shape ({N}, n_parameters)" in str(told.value)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"residual": ["1", "x"] * (N // 2)}, "residual: expected an array of real numbers"),
        ({"jacobian": COURSE + 1j}, "jacobian: expected an array of real numbers"),
        ({"noise": "small"}, "noise: expected an array of real numbers"),
        ({"candidates": DECAY}, "candidates: expected a list of blocks"),
        ({"candidates": [DECAY.matrix]}, "candidates: expected a list of blocks"),
        ({"candidates": [DECAY, DECAY]}, "candidate decay: is given 2 times"),
        ({"groups": [None] * N}, "groups: has figures that are not finite"),
        ({"rng": 1}, "rng: expected a Generator, found 1"),
    ],
)
def test_what_is_no_figure_is_refused_by_name(wrong, message):
    """Fails if an argument of the wrong kind ends in an error of the linear algebra, or is taken for something else."""
    right = {"residual": TIME, "jacobian": COURSE, "candidates": [DECAY], "rng": np.random.default_rng(1)}
    with pytest.raises(InputError, match=re.escape(message)):
        diagnose_linear(**(right | wrong))


def test_a_block_of_words_is_refused_by_name():
    """Fails if a block takes what is no matrix of numbers."""
    with pytest.raises(InputError, match="candidate decay: matrix: expected an array of real numbers"):
        Block("decay", [["fast"]] * N, 1.0)


def test_lists_tables_and_names_of_groups_serve_as_arrays():
    """Fails if only arrays are understood, or groups only by number."""
    effect, groups = 0.3 * HEATER, np.repeat(np.arange(N // 3), 3)
    table = Block("heater", pd.DataFrame(switching().matrix), [0.3])
    by_name = found(effect, (block for block in [table]), groups=[f"hour {g}" for g in groups])
    by_number = found(effect, [switching()], groups=groups)
    assert by_name.findings[0].estimate == by_number.findings[0].estimate


def test_a_robot_is_told_the_same_at_its_first_step():
    """Fails if this is another method than the robot's: its linearisation gives another cause, size or certainty."""
    soft = cause("joint-compliance", "joint2")
    data = hidden([(soft, (2e-7,))])
    begun = start(data)
    catalogue = Catalogue.of(data, ("geometry",), ("joint-eccentricity", "gear-ratio-error", "joint-compliance"))
    looked = Linearisation.at(begun, catalogue.effects)
    known = extend(begun, catalogue, Stepwise(CauseAcceptance(0.01, 1), np.random.default_rng(1), nobody, nobody))
    (score,) = (one for one in known.first.scores if one.cause == soft)
    r = looked.regressors
    blocks = [
        Block(
            f"{c.cause.id} {c.cause.part}",
            r.matrix.times(np.eye(r.matrix.shape[1]))[:, c.columns],
            r.prior_sd[c.columns],
            c.cause.detail,
            *c.cause.bounds,
        )
        for c in r.candidates
    ]
    at_means = r.residual - r.jacobian @ looked.value
    told = diagnose_linear(
        at_means, r.jacobian, blocks, rng=np.random.default_rng(1), prior_sd=r.precision**-0.5, most=1
    )
    assert [one.name for one in told.findings] == ["joint-compliance joint2"]
    assert [finding.cause for finding in known.findings] == [soft]
    (one,) = told.findings
    assert one.estimate == pytest.approx(score.estimate, rel=0.02)
    assert one.p == pytest.approx(known.first.family.p(score), rel=1e-6, abs=1e-12)


def test_errors_that_hang_together_make_no_name():
    """Fails if neighbours that share an error count as independent: 8 courses of AR(1) 0.8 that make names in nearly each then."""
    alarms = 0
    for seed in range(8):
        rng = np.random.default_rng([17, seed])
        errors = np.zeros(N)
        for k, drawn in enumerate(rng.standard_normal(N)):
            errors[k] = 0.8 * errors[k - 1] + 0.6 * drawn if k else drawn
        told = diagnose_linear(errors, COURSE, EVERY, rng=rng, order=TIME)
        alarms += bool(told.findings)
    assert alarms <= binom.isf(1e-3, 8, 0.03)


def test_gross_readings_are_told_and_only_they():
    """Fails if five wrong readings that hide a heater pass unsaid, under other numbers, or if sound readings are called wrong."""
    alarms = 0
    for seed in range(10):
        rng = np.random.default_rng([3, seed])
        wrong, order = rng.choice(N, 5, replace=False), rng.permutation(N)
        reading, sound = HEATER * 0.1 + SIGMA * rng.standard_normal((2, N))
        reading[wrong] += 3.0
        apart = [
            diagnose_linear(-y, COURSE, [switching()], rng=rng, order=order).adequacy.apart for y in (reading, sound)
        ]
        assert set(apart[0]) >= set(wrong.tolist())
        alarms += (len(apart[0]) > len(wrong)) + (len(apart[1]) > 0)
    assert alarms <= binom.isf(0.001, 20, 0.02)


def test_gross_readings_hide_no_cause():
    """Fails if five wrong readings of 20 to 60 standard deviations hide a heater that is found without them, or are one."""
    found, false = 0, 0
    for seed in range(6):
        rng = np.random.default_rng([4, seed])
        wrong, gross = rng.choice(N, 5, replace=False), rng.uniform(20, 60, 5) * rng.choice([-1, 1], 5)
        heated, sound = HEATER * 0.2 + SIGMA * rng.standard_normal(N), SIGMA * rng.standard_normal(N)
        for reading in (heated, sound):
            reading[wrong] += SIGMA * gross
        found += [each.name for each in diagnose_linear(-heated, COURSE, [switching()], rng=rng).findings] == ["heater"]
        false += bool(diagnose_linear(-sound, COURSE, [switching()], rng=rng).findings)
    assert found >= 5
    assert false <= binom.isf(0.001, 6, 0.02)


def test_a_cause_beyond_its_prior_makes_no_correlated_errors():
    """Fails if errors, which are independent, are called correlated to make room for a heater six times its prior."""
    told = [found(0.3 * HEATER, [switching()], seed=seed, noise=None) for seed in range(5)]
    narrow = [found(0.3 * HEATER, [replace(switching(), prior_sd=0.05)], seed=seed, noise=None) for seed in range(5)]
    assert all(each.findings for each in narrow)
    assert np.mean([each.noise.share > 0 for each in narrow]) <= np.mean([each.noise.share > 0 for each in told])


def test_order_is_what_rows_follow_each_other_along():
    """Fails if rows that were shuffled are taken in the order in which they stand, or what hangs together is not told."""
    rng = np.random.default_rng(6)
    walk = np.cumsum(rng.standard_normal(N))
    shuffled = rng.permutation(N)
    blind, told = (
        diagnose_linear(walk[shuffled], np.ones((N, 1)), (switching(),), rng=rng, order=order)
        for order in (None, TIME[shuffled])
    )
    assert told.noise.share > 0.9
    assert told.noise.degrees_of_freedom < N / 4 < blind.noise.degrees_of_freedom


def test_the_examples_come_true():
    """Fails if a block of the page on use without a robot does not run, or what it promises is not so."""
    page = (Path(__file__).parents[1] / "docs" / "linear.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert len(blocks) == 2
    for block in blocks:
        exec(compile(block, "linear.md", "exec"), {})
