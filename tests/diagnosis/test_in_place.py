"""Rivals are weighed in a cause's place: as they would act without it."""

from __future__ import annotations

import numpy as np
import pytest

from calflow.diagnosis.extension import FittedTrial
from calflow.diagnosis.screening import Catalogue
from calflow.diagnosis.stepwise import REACH
from calflow.diagnosis.trial import Linearisation
from diagnosis.found import cause, hidden, start


def bent(*values):
    """A robot whose second link bends, with other springs, as found; and the bending with its rivals scored where it acts."""
    springs = [cause("link-bending", "link2"), cause("joint-compliance", "joint3")][: len(values)]
    known = start(hidden([(spring, (value,)) for spring, value in zip(springs, values, strict=True)])).with_causes(
        springs
    )
    every = Catalogue.of(known.data, ("geometry",))
    first = Linearisation.at(known, every.effects).screened(np.random.default_rng(1))
    trial = FittedTrial(first, known, every)
    return trial, trial.findings[0], trial.linearisation.finding(trial.causes[0], first.family)


def test_a_mass_that_moves_the_tool_through_the_spring_is_no_rival_of_it():
    """Breaks if a rival is scored where the cause acts, and so for what it does through that alone."""
    trial, finding, linear = bent(4.5e-9, 6e-8)
    mass = ("link-mass", "link3")
    refitted = trial.with_causes([linear.places[mass][1].cause, trial.causes[1]]).cost - trial.cost
    assert linear.places[mass][0] - linear.cost < 0.8 * refitted
    assert finding.places[mass][0] - finding.cost == pytest.approx(refitted, rel=0.1)


def test_a_spring_at_its_bound_of_zero_is_weighed():
    """Fails if a cause that is set to zero, which is its bound, is looked for among the free parameters."""
    _, finding, linear = bent(4e-9)
    assert any(
        score.cause.place != linear.cause.place and score.cost < linear.cost + 2 * REACH for score in linear.scores
    )
    assert finding.own == linear.own
    assert {score.cause for score in finding.scores} <= {score.cause for score in linear.scores}
