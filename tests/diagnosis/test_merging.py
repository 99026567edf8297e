"""Several of one family give way to one that holds them all, where evidence says so."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.screening import Family
from calflow.diagnosis.stepwise import CauseAcceptance, Stepwise, kindred, merged
from calflow.diagnosis.trial import Screened
from calflow.linear import Block, LinearProblem, LinearTrial

N = 150
TIME = np.linspace(0.0, 1.0, N)


class Kin(Block):
    """A block that belongs to a family."""

    family = "oscillation"


def wave(frequency):
    """A wave of so many turns."""
    angle = 2 * np.pi * frequency * TIME
    return Kin(f"wave {frequency}", np.column_stack([np.cos(angle), np.sin(angle)]), 1.0)


WAVES = [wave(frequency) for frequency in (1, 2, 3, 5)]
NUMBER = np.arange(1, 25)
CURVE = Kin("curve", np.sin(np.pi * NUMBER * TIME[:, None]), np.asarray(3.0 / NUMBER))
OTHER = Block("other", (TIME > 0.3).astype(float)[:, None], 1.0)
EVERY = (*WAVES, CURVE, OTHER)


def trial(effect, blocks):
    """A model with some blocks, fitted to an effect (n,) and noise of one tenth."""
    noise = 0.1 * np.random.default_rng(3).standard_normal(N)
    matrix = np.hstack([block.matrix for block in EVERY]) / 0.1
    problem = LinearProblem((effect + noise) / 0.1, np.ones((N, 1)) / 0.1, np.array([10.0]), EVERY, matrix, True, None)
    return LinearTrial(Screened((), Family({}, len(EVERY)), N - 1), problem, np.random.default_rng(0), tuple(blocks))


def smooth():
    """A curve of no single frequency."""
    return CURVE.matrix @ (0.3 * CURVE.sd * np.random.default_rng(5).standard_normal(len(NUMBER)))


def test_only_several_of_one_family_are_kindred():
    """Fails if a lone member, or what belongs to no family, is to give way."""
    assert kindred([WAVES[0], OTHER]) == {}
    assert kindred([OTHER, OTHER]) == {}
    assert kindred([WAVES[0], OTHER, WAVES[2]]) == {("oscillation", 0): [WAVES[0], WAVES[2]]}


def test_waves_give_way_to_the_curve_that_they_imitate():
    """Fails if the search cannot leave several orders, each of which explains its part, for the curve that they are."""
    several = trial(smooth(), [*WAVES, OTHER])
    first = next(merged(several))
    assert first == [OTHER, CURVE]
    assert several.with_causes(first).cost < several.cost
    better = search().improved(several, [several])
    assert better is not None
    assert CURVE in better.causes
    assert not set(better.causes) & set(WAVES)


def test_true_waves_stay():
    """Fails if a family takes the place of its members whatever the evidence."""
    two = trial(WAVES[1].matrix @ [1.0, 0.5] + WAVES[3].matrix @ [0.3, -0.6], [WAVES[1], WAVES[3]])
    assert all(two.with_causes(causes).cost > two.cost for causes in merged(two))


def search():
    """A search for causes."""
    return Stepwise(CauseAcceptance(0.01, 10), np.random.default_rng(1), lambda _: None, lambda _: None)


def test_what_the_linearised_model_excludes_is_not_fitted():
    """Fails if mergers of waves that are two, or models without one of them, are fitted although they lose by far."""
    two = trial(WAVES[1].matrix @ [1.0, 0.5] + WAVES[3].matrix @ [0.3, -0.6], [WAVES[1], WAVES[3]])
    tried = [two]
    assert list(merged(two))
    assert search().improved(two, tried) is None
    assert tried == [two]


def test_one_linearisation_says_what_other_causes_cost_and_show():
    """Fails if taking causes out and others in, on one linearisation, is not what a solution with them says."""
    several = trial(smooth(), [*WAVES, OTHER])
    for causes in ([*WAVES[1:], OTHER], [OTHER, CURVE], [WAVES[0], OTHER]):
        attained = several.with_causes(causes)
        assert several.linearisation.expected(causes) == pytest.approx(attained.cost - several.cost, rel=0.05, abs=1.0)
    alone = trial(smooth(), [CURVE, OTHER]).linearisation.tested_with([CURVE, WAVES[1]])
    both = trial(smooth(), [CURVE, WAVES[1]]).linearisation.beside
    for one, other in zip(alone.scores, both.scores, strict=True):
        assert one.cause == other.cause
        assert (one.drop, one.cost) == pytest.approx((other.drop, other.cost), rel=1e-6)
