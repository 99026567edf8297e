"""A rival of a spring must act where that does not give way."""

from __future__ import annotations

import numpy as np

from calflow.diagnosis.extension import FittedTrial
from calflow.diagnosis.screening import Catalogue
from calflow.diagnosis.stepwise import REACH
from calflow.diagnosis.trial import Linearisation
from diagnosis.found import cause, hidden, start


def test_a_spring_at_its_bound_of_zero_is_weighed():
    """Fails if a cause that is set to zero, which is its bound, is looked for among the free parameters."""
    bending = cause("link-bending", "link2")
    known = start(hidden([(bending, (4e-9,))])).with_causes([bending])
    every = Catalogue.of(known.data, ("geometry",))
    first = Linearisation.at(known, every).screened(np.random.default_rng(1))
    trial = FittedTrial(first, known, every)
    (finding,) = trial.findings
    assert any(score.cause.place != bending.place and score.cost < finding.cost + 2 * REACH for score in finding.scores)
    weighed = trial.with_acting_rivals(finding)
    assert weighed.own == finding.own
    assert {score.cause for score in weighed.scores} <= {score.cause for score in finding.scores}
