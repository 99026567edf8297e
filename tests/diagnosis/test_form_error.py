"""A cause may act in another form than the catalogue's, and so may its rivals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis.background import BackgroundBasis, uneven_or_other_forms
from calflow.diagnosis.extension import extend, unnamed
from calflow.diagnosis.form_error import variations
from calflow.diagnosis.screening import Catalogue
from calflow.diagnosis.stepwise import CauseAcceptance, Stepwise
from calflow.diagnosis.verdict import verdict
from calflow.estimation.progress import nobody
from diagnosis.found import cause, hidden, start

HALF = 0.6  # rad: half of joint 2's travel


@pytest.fixture(scope="module")
def poses():
    """Poses in which joint 2 turns little, so that a ratio and an eccentricity are much alike."""
    data = hidden([], 400)
    q = data.table["q2"]
    return replace(data, table=data.table[np.abs(q - q.median()) < HALF].reset_index(drop=True))


def found(data, size, cubic):
    """What is found where joint 2 errs in proportion to its angle and, by a share, to its cube; and without form errors."""
    q = data.table["q2"].to_numpy()
    u = (q - (q.min() + q.max()) / 2) / HALF
    data = replace(data, table=data.table.assign(q2=q - size * u * (1 + cubic * u**2)))
    catalogue = Catalogue(
        (cause("gear-ratio-error", "joint2").effect, cause("joint-eccentricity", "joint2", order=1).effect), {}
    )
    ended = extend(start(data), catalogue, Stepwise(CauseAcceptance(0.01, 1), np.random.default_rng(1), nobody, nobody))
    return ended.weighed_findings[0], ended.findings[0]


def test_a_small_misfit_of_a_large_cause_does_not_settle_its_name(poses):
    """Breaks if a form that differs by less than forms usually do from the catalogue's is excluded for certain."""
    weighed, exact = found(poses, 6e-4, 0.15)
    assert verdict(exact).status == "named"
    assert verdict(weighed).status == "one_of"
    assert {rival.id for rival in verdict(weighed).rivals} == {"joint-eccentricity", "gear-ratio-error"} - {
        weighed.cause.id
    }
    # Whether there is a cause at all is as certain as before, and the odds of its name are nearer to even.
    assert weighed.own.cost == exact.own.cost
    for place, (before, _) in exact.places.items():
        assert min(before, exact.cost) - 1e-9 < weighed.places[place][0] < max(before, exact.cost) + 1e-9


def test_a_large_cause_in_the_catalogue_s_form_keeps_its_name(poses):
    """Breaks if form errors make up for more than they usually are, so that nothing can be told any more."""
    weighed, _ = found(poses, 2e-3, 0.0)
    assert (weighed.cause.id, verdict(weighed).status) == ("gear-ratio-error", "named")


def test_a_form_error_is_smooth_in_what_its_cause_acts_through(poses):
    """Breaks if it goes with something else than the cause's own variable, or is of another size than said."""
    fitted = start(poses)
    order = np.argsort(poses.table["q2"].to_numpy())
    functions = variations(cause("gear-ratio-error", "joint2"), fitted)[order]
    assert np.abs(np.diff(functions[:, 0], n=1)).sum() == pytest.approx(np.ptp(functions[:, 0]))
    assert (functions**2).sum(axis=1).mean() == pytest.approx(1.0)


@pytest.mark.parametrize(("left", "order", "stands"), [("cube", 4.0, False), ("wave", 15.0, True)])
def test_what_a_large_cause_leaves_by_its_form_is_no_second_cause(poses, left, order, stands):
    """Fails if a cause is certain that only makes up for another one's form, or a true one is not beside such errors."""
    ratio, second = cause("gear-ratio-error", "joint2"), cause("periodic-joint-error", "joint2", order=order)
    q = poses.table["q2"].to_numpy()
    u = (q - (q.min() + q.max()) / 2) / HALF
    off = 2e-3 * u + (6e-4 * u**3 if left == "cube" else 1.5e-4 * np.cos(order * q))
    known = start(replace(poses, table=poses.table.assign(q2=q - off)))
    both, variants = known.with_causes([ratio, second]), {ratio.place: 1, second.place: 1}
    against = unnamed(both, BackgroundBasis.of(known), variants, varying=uneven_or_other_forms)
    assert against[ratio] > 0
    assert against[second] > 100 if stands else against[second] < 0
