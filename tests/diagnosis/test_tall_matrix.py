"""What is worked out block by block is what the whole matrix tells, in less memory than it takes."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from calflow.diagnosis import regressors as module
from calflow.diagnosis.linear_model import LinearModel
from calflow.diagnosis.regressors import Background, Regressors
from calflow.diagnosis.screening import Catalogue, Screening
from calflow.estimation.fit import fit
from calflow.model import build
from estimation.data import measured, problem
from robots import industrial

POSES, MARKERS = 800, 2
TESTED = ("joint-eccentricity", "gear-ratio-error", "bearing-compliance")


@pytest.fixture(scope="module")
def linearised():
    """A function that linearises a fit with some causes, beside a background or not; rows of a pose lie apart in the file."""
    model = build(industrial(), ("geometry",))
    rng = np.random.default_rng(8)
    data = measured(model, model.nominal, POSES * MARKERS, rng)
    asked = problem(model, data)
    found = fit(asked)[0]
    poses = rng.permutation(np.repeat(np.arange(POSES), MARKERS))
    blocks = (
        replace(block, standstill=poses, intraclass=0.4).at(np.argsort(poses, kind="stable")) for block in asked.blocks
    )
    together = replace(asked, blocks=tuple(blocks))
    modes = np.linalg.qr(rng.standard_normal((asked.size, 4)))[0]
    background = Background((("q1",),), (), 3.0 * modes, asked.weight, 18.0, 8)

    def at(beside: bool, causes: Sequence[str] = TESTED) -> Regressors:
        problem = together if beside else asked
        effects = Catalogue.of(data, ("geometry",), causes).effects
        return Regressors.of(found, problem, effects, poses, background if beside else None)

    return at


@pytest.fixture(params=[False, True], ids=["alone", "beside a background"])
def both(request, linearised, monkeypatch):
    """The regressors held in memory, and those that are not."""
    held = linearised(request.param)
    monkeypatch.setattr(module, "HELD", 0)
    return held, linearised(request.param)


def test_sums_are_those_of_the_whole_matrix(both):
    """Fails if a block's rows are others than its number says, a pose is torn apart, or a background forgotten."""
    held, remade = both
    assert [len(list(one.matrix.blocks())) > 1 for one in both] == [False, True]
    seen = LinearModel(held), LinearModel(remade)
    sums = ([*(stack.information for stack in model.stacks), model.score] for model in seen)
    for one, other in zip(*sums, strict=True):
        assert_allclose(other, one, rtol=1e-8, atol=1e-9 * np.abs(one).max(initial=0.0))
    some, rng = np.arange(0, held.matrix.shape[1], 5), np.random.default_rng(1)
    amplitudes = rng.standard_normal((held.matrix.shape[1], 2))
    for ask in (
        lambda matrix: matrix.products(some),
        lambda matrix: matrix.response(some),
        lambda matrix: matrix.times(amplitudes),
    ):
        whole = ask(held.matrix)
        assert_allclose(ask(remade.matrix), whole, rtol=1e-8, atol=1e-9 * np.abs(whole).max())


def test_tests_cost_the_same(both):
    """Fails if the bootstrap's draws depend on how the rows are looked at."""
    one, other = (Screening.of(regressors).family(np.random.default_rng(3)) for regressors in both)
    assert other.places == pytest.approx(one.places)
    assert other.scans == pytest.approx(one.scans)


def test_a_look_takes_less_memory_than_the_matrix(linearised, monkeypatch):
    """Fails if all rows' regressors are there at once."""
    monkeypatch.setattr(module, "HELD", 0)
    remade = linearised(False, ()).matrix  # of all causes
    tracemalloc.start()
    remade.times(np.ones((remade.shape[1], 1)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * np.prod(remade.shape) / 1.8
