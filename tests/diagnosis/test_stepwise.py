"""The search ends, also where every set of causes is a new one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from calflow.diagnosis.regressors import Candidate
from calflow.diagnosis.screening import Family, Score
from calflow.diagnosis.stepwise import FEW_COLUMNS, MOST_TRIALS, PATIENCE, CauseAcceptance, Stepwise, second_thoughts
from calflow.diagnosis.trial import Detection, Screened, Trial
from calflow.linear import Block

FAMILY = Family({}, 1.0)
LEFT = 100.0  # degrees of freedom, of no importance
Path = Callable[[int], tuple[tuple[str, ...], float]]


@dataclass(frozen=True)
class Wandering(Trial[Block]):
    """A model that always has something clearly better to try: a path leads from each step to names and a cost.

    tried are the numbers of the steps taken.
    """

    path: Path
    step: int = 0
    tried: list[int] = field(default_factory=lambda: [0])

    @property
    def causes(self) -> tuple[Block, ...]:
        """Causes in a form that no step before had."""
        return tuple(form(name, self.step) for name in self.path(self.step)[0])

    @property
    def cost(self) -> float:
        """What the path says."""
        return self.path(self.step)[1]

    @property
    def linearisation(self):
        """No cause has another form."""
        return SimpleNamespace(finding=lambda cause, family, where: Detection(cause, (), family))

    @property
    def findings(self):
        """None: nothing is doubted."""
        return ()

    def with_causes(self, causes, added=None) -> Wandering:
        """Go one step on."""
        self.tried.append(self.step + 1)
        return replace(self, step=self.step + 1)

    def refined(self) -> Sequence[Block]:
        """Return the causes of the next step."""
        return replace(self, step=self.step + 1).causes


def form(name: str, step: int) -> Block:
    """A cause of too many parameters for an exchange."""
    return Block(name, np.zeros((1, FEW_COLUMNS + 1)), 1.0, f"order {7.31 + 0.01 * step:.2f}")


def search(path: Path) -> tuple[Wandering, int, list[str]]:
    """Return the best model of a search along a path, how many were tried, and what was said."""
    said: list[str] = []
    nothing = Screened((), FAMILY, LEFT)
    stepwise = Stepwise(CauseAcceptance(0.01, 0), np.random.default_rng(1), said.append, lambda _: None)
    best = stepwise.best(Wandering(nothing, path))
    return best, len(best.tried), said


@pytest.mark.parametrize("names", [("a",), ("a", "b")])
def test_a_cause_is_not_taken_and_left_for_ever(names):
    """Fails if ever finer variants of causes that come and go in turns keep the search from ending, or if it ends with them."""
    best, tried, said = search(lambda k: ((names[k % len(names)],) if k else (), 10.0 if k == 2 else 20.0))
    assert best.step == 2
    assert tried <= 1 + len(names) * (PATIENCE + 1) + 1
    assert not any("ends" in line for line in said)


def test_a_cause_is_refined_as_long_as_that_helps():
    """Fails if a search that gets better at the same places is taken for one that goes round in circles."""
    best, tried, _ = search(lambda k: (("a",) if k else (), -3.0 * min(k, 20)))
    assert best.step == 20
    assert tried <= 21 + PATIENCE


def test_a_search_that_gets_better_for_ever_ends_and_says_so():
    """Fails if nothing bounds the number of models, or if nobody is told that there may be a better one."""
    best, tried, said = search(lambda k: (("a",) if k else (), -3.0 * k))
    assert tried == MOST_TRIALS
    assert best.step == MOST_TRIALS - 1
    assert f"ends after {MOST_TRIALS} models" in said[-1]


def test_no_step_is_taken_from_a_model_that_proved_worse():
    """Fails if the search builds on a step that was expected to help and does not."""
    asked = set()
    best, *_ = search(lambda k: asked.add(k) or ((f"step {k}",) if k else (), 10.0 * k))
    assert best.step == 0
    assert asked == {0, 1}


@dataclass(frozen=True)
class Doubted(Wandering):
    """A model with one finding."""

    finding: Detection[Block] | None = None

    @property
    def causes(self):
        """Its cause."""
        return (self.finding.cause,)

    @property
    def findings(self):
        """The finding."""
        return (self.finding,)


@pytest.mark.parametrize(("other", "better"), [(-43.5, True), (-30.5, False), (-10.0, False)])
def test_another_form_of_a_cause_that_explains_more_takes_its_place(other, better):
    """Fails if a cause keeps the form in which it was found where another of its own is clearly better beside the last model.

    Beside the first model both explained the same, as an off-centre and an oval gear do where a joint turned half way.
    """
    first, second = form("a", 0), form("a", 1)

    def score(cause: Block, cost: float) -> Score[Block]:
        one = np.ones(1)
        return Score(Candidate(cause, np.arange(1)), 40.0, 0.5, 1e-12, cost, 1.0, one, np.eye(1), np.eye(1), 1, LEFT)

    scores = sorted([score(first, -30.0), score(second, other)], key=lambda each: each.cost)
    trial = Doubted(
        Screened((), FAMILY, LEFT), lambda _: (("a",), 0.0), finding=Detection(first, tuple(scores), FAMILY)
    )
    assert second_thoughts(trial, CauseAcceptance(0.01, 5)) == [second if better else first]
