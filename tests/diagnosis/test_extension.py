"""The extension adds the causes that are there, drops needless ones, and says where the evidence comes from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calflow.diagnosis import extension as extension_module
from calflow.diagnosis import fitted as fitted_module
from calflow.diagnosis import screening as screening_module
from calflow.diagnosis.background import BackgroundBasis
from calflow.diagnosis.diagnosis import Diagnosis
from calflow.diagnosis.extension import FittedTrial, extend, weighed, weighed_against
from calflow.diagnosis.screening import Catalogue
from calflow.diagnosis.stepwise import CauseAcceptance, Stepwise, second_thoughts
from calflow.diagnosis.trial import Linearisation
from calflow.diagnosis.verdict import verdict
from calflow.estimation.fit import fit
from calflow.estimation.noise import Noise
from calflow.estimation.progress import nobody
from calflow.model import Model
from diagnosis.found import cause, hidden, start
from diagnosis.test_unexplained import fitted
from estimation.data import SIGMA

TESTED = ("joint-eccentricity", "gear-ratio-error", "joint-compliance", "base-compliance", "periodic-joint-error")
GATE = CauseAcceptance(0.01, 4)


def search(gate=GATE):
    """A search that says nothing."""
    return Stepwise(gate, np.random.default_rng(1), nobody, nobody)


@pytest.fixture(scope="module")
def data():
    """Poses of a robot with a soft joint 2, and a joint 1 that runs out of true."""
    soft, eccentric = cause("joint-compliance", "joint2"), cause("joint-eccentricity", "joint1", order=2)
    return hidden([(soft, (1.5e-6,)), (eccentric, (1.5e-4, -1e-4))])


def test_both_causes_are_added_and_nothing_else(data):
    """Breaks if the extension stops early, goes on with noise, or its models on the way are not those of its findings."""
    shares = []
    extended = extend(start(data), Catalogue.of(data, ("geometry",), TESTED), replace(search(), advance=shares.append))
    assert len(shares) >= 2  # a step a cause
    assert shares == sorted(set(shares))
    assert 0 < shares[0] < shares[-1] < 1
    assert [finding.cause.place for finding in extended.findings] == [
        ("joint-compliance", "joint2"), ("joint-eccentricity", "joint1"),
    ]  # fmt: skip
    path = diagnosed(extended, None).path
    assert [len(fit.model.effects) for fit in path] == [2, 3]
    assert path[-1] is extended.fitted.fit
    alone = extended.fitted.with_causes(extended.causes[:1])
    assert [fit is alone.fit for fit in diagnosed(extended, alone).path] == [True, False]
    assert all(finding.p < 1e-6 for finding in extended.findings)
    assert extended.fitted.lack.reduced_chi2 == pytest.approx(1.0, abs=0.25)


def diagnosed(trial, final):
    """The diagnosis that ends with a trial, and with a model to be used."""
    verdicts, fitted = tuple(map(verdict, trial.findings)), trial.fitted
    return Diagnosis(fitted, trial.first, fitted, final, verdicts, (), None, trial.catalogue, 0.01)


def test_series_of_two_devices_make_a_cause_no_dearer():
    """Breaks if a series that scatters more than another, of which nobody states how much, is taken for rows far off."""
    soft = cause("joint-compliance", "joint2")
    data = hidden([(soft, (1e-8,))])
    series, rng = np.arange(len(data)) % 2, np.random.default_rng(1)
    more = 5 * SIGMA * series[:, None] * rng.standard_normal((len(data), 3))
    data = replace(data, table=data.table.assign(**dict(zip("xyz", (data.position + more).T, strict=True))))
    identified = Noise(np.array([1.3, 6.0])[series] * SIGMA, ("estimated", "estimated"), series=series)
    begun = replace(start(data), noise=identified, device=identified).with_causes([])
    scatter = [np.median(begun.noise.sigma[series == k]) for k in (0, 1)]
    assert scatter[1] > 3 * scatter[0]
    linear = Linearisation.at(begun, (soft,))
    screened = linear.screened(rng)
    trial = FittedTrial(screened, begun, Catalogue((soft,), {}))
    assert screened.scores[0].cost < -20
    assert trial.with_causes([soft]).cost - trial.cost == pytest.approx(screened.scores[0].cost, rel=0.15)


def test_noise_alone_extends_nothing():
    """Breaks if something is added where nothing is hidden."""
    data = hidden([])
    extended = extend(start(data), Catalogue.of(data, ("geometry",), TESTED), search())
    assert extended.findings == ()


def test_a_wrong_cause_gives_way_and_a_needless_one_goes(data):
    """Breaks if what was added too early stays: a rival explains it better, or the others have made it superfluous."""
    catalogue_ = Catalogue.of(data, ("geometry",), TESTED)
    begun = start(data)
    wrong, right = cause("base-compliance", "base"), cause("joint-compliance", "joint2")
    eccentric, needless = cause("joint-eccentricity", "joint1", order=2), cause("gear-ratio-error", "joint5")

    def thoughts(*causes):
        model = begun.with_causes(causes)
        screened = Linearisation.at(model, catalogue_.effects).screened(np.random.default_rng(2))
        return second_thoughts(FittedTrial(screened, model, catalogue_), GATE)

    assert thoughts(right, eccentric, needless) == [right, eccentric]
    assert [c.place for c in thoughts(wrong)] == [right.place]
    assert thoughts(right, eccentric) == [right, eccentric]


def test_a_knee_is_refined_until_one_cause_explains_all():
    """Breaks if a large cause stays in the form that was tried first, and another one has to make up for what that leaves."""
    knee = cause("nonlinear-joint-stiffness", "joint2", law="knee", knee=0.29)
    soft = cause("joint-compliance", "joint2")
    data = hidden([(soft, (1.5e-6,)), (knee, (6e-3,))], poses=120)
    listed = Catalogue.of(data, ("geometry",), ("joint-compliance", "nonlinear-joint-stiffness"))
    extended = extend(start(data), listed, search())
    assert {finding.cause.place for finding in extended.findings} == {soft.place, knee.place}
    found = next(finding.cause for finding in extended.findings if finding.cause.place == knee.place)
    assert found.effect.knee == pytest.approx(0.29, abs=0.01)
    assert extended.fitted.lack.reduced_chi2 == pytest.approx(1.0, abs=0.25)


def test_a_gross_mistake_is_found_and_split_between_no_two_forms():
    """Breaks if what is left hides a cause far beyond usual sizes, or two forms of it share it to please the priors."""
    wrong = cause("gear-ratio-error", "joint2")
    data = hidden([(wrong, (0.03,))])
    extended = extend(start(data), Catalogue.of(data, ("geometry",), TESTED), search())
    assert [finding.cause.place for finding in extended.findings] == [wrong.place]
    assert extended.fitted.fit.estimate[-1] == pytest.approx(0.03, rel=1e-3)


def test_orders_of_one_joint_may_act_together():
    """Breaks if a joint can have one periodic error only, or an order counts as another one than its neighbour."""
    first, second = (cause("periodic-joint-error", "joint1", order=order) for order in (4.0, 9.0))
    near = cause("periodic-joint-error", "joint1", order=4.3)
    assert not first.effect.same_as(second.effect)
    assert first.effect.same_as(near.effect)
    data = hidden([(first, (2e-4, 1e-4)), (second, (-2e-4, 1e-4))])
    extended = extend(start(data), Catalogue.of(data, ("geometry",), TESTED), search())
    assert [finding.cause.place for finding in extended.findings] == [first.place] * 2
    orders = sorted(finding.cause.effect.order for finding in extended.findings)
    assert orders == pytest.approx([4.0, 9.0], abs=0.1)


def test_two_forms_of_a_cause_start_from_their_own_estimates():
    """Fails if one form's estimate is taken for another's, or a form that is new starts from that of another."""
    first, second, other = (cause("joint-eccentricity", "joint1", order=order) for order in (1, 2, 3))
    data = hidden([(first, (2e-4, 1e-4)), (second, (-3e-4, 5e-5))])
    both = start(data).with_causes([first, second])
    swapped = Model(both.model.robot, (*both.plain, second, other, first), both.model.given)
    estimate = both.fit.estimate
    np.testing.assert_array_equal(
        both.model.handed_on(estimate, swapped)[-6:], [*estimate[-2:], 0, 0, *estimate[-4:-2]]
    )


def test_a_model_that_was_fitted_is_not_fitted_again(monkeypatch):
    """Fails if a search that comes back to the same causes, in another order or beside a background, pays for the fit again."""
    first, second = cause("gear-ratio-error", "joint2"), cause("joint-compliance", "joint3")
    begun, fits = start(hidden([(first, (2e-3,))], poses=40)), []
    monkeypatch.setattr(fitted_module, "fit", lambda *given: fits.append(1) or fit(*given))
    once = begun.with_causes([first, second])
    fewer, number = once.with_causes([first]), len(fits)
    again = fewer.with_causes([second, first])
    assert again.fit is once.fit
    assert len(fits) == number


@pytest.mark.parametrize("found", [1, 2])
def test_a_search_begins_once_from_each_set_of_causes(monkeypatch, data, found):
    """Fails if causes that give way to a background, and are found again beside it, come and go in turns at the cost of a search.

    Every cause gives way here; the search finds one of them again, or both. What has given way is not named.
    """
    extended = extend(start(data), Catalogue.of(data, ("geometry",), TESTED), search())
    causes, searches = extended.causes[:found], []
    again = extended.with_causes(causes)
    monkeypatch.setattr(extension_module, "_weakest", lambda fitted, *more: next(iter(fitted.causes), None))
    monkeypatch.setattr(extension_module, "_searched", lambda _, beside, *more: searches.append(beside.causes) or again)
    catalogue_ = Catalogue.of(data, ("geometry",), TESTED)
    basis = BackgroundBasis.of(start(data))
    last, findings = weighed(start(data), extended, basis, catalogue_, search())
    assert searches == [()]
    assert last.causes == findings == ()


def test_a_search_that_finds_nothing_that_stays_is_not_repeated(monkeypatch, data):
    """Fails if a cause that a search drops makes it begin again, though all that it found gives way to a background."""
    found = extend(start(data), Catalogue.of(data, ("geometry",), TESTED), search())
    first, second = found.fitted.causes
    smooth, searches = cause("gear-ratio-error", "joint4"), []
    again = found.with_causes([first, smooth])
    monkeypatch.setattr(extension_module, "_weakest", lambda fitted, *_: smooth if smooth in fitted.causes else None)
    monkeypatch.setattr(extension_module, "_named_instead", lambda *_: None)
    monkeypatch.setattr(extension_module, "_searched", lambda _, beside, *more: searches.append(beside.causes) or again)
    catalogue_ = Catalogue.of(data, ("geometry",), TESTED)
    basis = BackgroundBasis.of(start(data))
    last, _ = weighed(start(data), found, basis, catalogue_, search())
    assert searches == [(first, second)]
    assert last.causes == (first,)


def test_a_cause_that_hardly_shows_at_last_is_left_out(monkeypatch, data):
    """Fails if what the data no longer tell from the rest, once all else is in the model, stays in it or ends the diagnosis."""
    catalogue_ = Catalogue.of(data, ("geometry",), TESTED)
    found = extend(start(data), catalogue_, search())
    monkeypatch.setattr(extension_module, "_weakest", lambda *_: None)
    monkeypatch.setattr(extension_module, "_named_instead", lambda *_: None)

    def hiding(_, beside, *more):
        monkeypatch.setattr(screening_module, "INVISIBLE", np.inf)
        return beside

    monkeypatch.setattr(extension_module, "_searched", hiding)
    said = list[str]()
    told = replace(search(), say=said.append)
    last, findings = weighed(start(data), found, BackgroundBasis.of(start(data)), catalogue_, told)
    assert found.causes
    assert last.causes == findings == ()
    assert sum("hardly shows" in line for line in said) == len(found.causes)


def set_up_anew(table):
    """A device that stands elsewhere in each of three sessions, beside what no cause does: a smooth error of three joints."""
    table["session"] = np.array(["mon", "tue", "wed"])[np.arange(len(table)) * 3 // len(table)]
    rng, angles = np.random.default_rng(3), table[["q1", "q2", "q3"]].to_numpy()
    waves = np.cos(angles @ rng.normal(0, 0.9, (3, 40)) + rng.uniform(0, 6.28, 40)) @ rng.normal(size=(40, 3))
    places = rng.normal(size=(3, 3))[np.unique(table["session"], return_inverse=True)[1]]
    return 5 * SIGMA * waves / waves.std() + 1.2 * SIGMA * places


def test_a_device_that_was_set_up_anew_does_not_give_way_to_an_error_in_time():
    """Fails if what nobody can name in time, which is an error of the device itself, takes the place of its name."""
    begun = fitted(set_up_anew, poses=150)
    tested = Catalogue.of(begun.data, ("geometry",), ("gear-ratio-error", "session-frame"))
    extended = extend(begun, tested, search())
    basis = BackgroundBasis.of(begun)
    last, _ = weighed(begun, extended, basis, tested, search())
    assert extended.causes == ()
    assert [found.id for found in last.causes] == ["session-frame"]


def test_a_device_that_was_set_up_anew_is_no_cause_too_many():
    """Fails if it is named in the place of an error in time where no further cause may be: a mistake is to be settled first."""
    begun = fitted(set_up_anew, poses=150)
    tested, none = (
        Catalogue.of(begun.data, ("geometry",), ("gear-ratio-error", "session-frame")),
        CauseAcceptance(0.01, 0),
    )
    extended = extend(begun, tested, search(none))
    basis = BackgroundBasis.of(begun)
    last, findings = weighed(begun, extended, basis, tested, search(none))
    assert last.causes == findings == ()


def test_a_wider_catalogue_keeps_what_was_weighed(data):
    """Fails if candidates that were left out of the search come at the price of what a background and poses left out told."""
    narrow, wide = (Catalogue.of(data, ("geometry",), TESTED[:more]) for more in (3, 5))
    extended = extend(start(data), narrow, search())
    told = tuple(replace(finding, unnamed=9.0, carries_over=True) for finding in extended.weighed_findings)
    wider = weighed_against(told, replace(extended, catalogue=wide))
    assert [(finding.cause, finding.unnamed, finding.carries_over) for finding in wider] == [
        (finding.cause, 9.0, True) for finding in told
    ]
    assert {score.cause.id for score in wider[0].scores} > {score.cause.id for score in told[0].scores}
