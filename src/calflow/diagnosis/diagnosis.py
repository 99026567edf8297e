"""The diagnosis: the identified model extended by what it lacks, each cause weighed against its rivals."""

from __future__ import annotations

from dataclasses import replace

from calflow.diagnosis.findings.misfit import misfit, remainder
from calflow.diagnosis.findings.rivals import fitted_alternatives, models_in_reach
from calflow.diagnosis.findings.tables import Diagnosis
from calflow.diagnosis.findings.verdict import verdict
from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.search.extension import extend, weighed_against
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.noise_growth import growth_of_repeats, growth_of_residuals
from calflow.diagnosis.search.trial import FALSE_ALARM, SHARES, CauseAcceptance
from calflow.diagnosis.search.weighing import weighed
from calflow.estimation.accuracy import leading_errors
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.noise import averaged, repeats_scatter
from calflow.estimation.progress import SAME, Advance, Draws, Say, nobody
from calflow.measurements.measurements import Measurements

BEGUN, SEARCHED = 0.1, 0.7  # share of the work before and after the search


def search_causes(
    calibrated: CalibratedModel,
    data: Measurements,
    *,
    false_alarm: float = FALSE_ALARM,
    causes: int = 10,
    catalogue: tuple[str, ...] = (),
    leave_out: tuple[str, ...] = (),
    rng: Draws = SAME,
    say: Say = nobody,
    advance: Advance = nobody,
) -> Diagnosis:
    """Extend the identified model on the training rows, and weigh what was found.

    Args:
        calibrated: the model as it was identified.
        data: the rows it was identified from, on the robot that its errors refer to.
        false_alarm: chance that anything is found where nothing is.
        causes: the most to add.
        catalogue: ids of the effects to look for; all where there are none.
        leave_out: ids not to look for.
        rng: draws the bootstrap and the decoys.
        say: is told what is tried.
        advance: is told the share of work done.
    """
    train = data.only(data.train)
    scattered = repeats_scatter(train, leading_errors(calibrated.model, calibrated.estimate, train))
    train, noise = averaged(train, replace(calibrated.noise(train), scatter=scattered))
    start = Fitted.of(calibrated, train, noise)
    alarm = SHARES["noise"] * false_alarm
    if grown := growth_of_repeats(start, alarm):
        start = start.weighed(grown.sigma(train, start.device))
    have = [effect.id for effect in calibrated.model.effects]
    wanted = Catalogue.of(train, have, catalogue, leave_out)
    advance(BEGUN)
    acceptance = CauseAcceptance(SHARES["causes"] * false_alarm, causes)
    extended = extend(
        start, wanted, acceptance, rng("bootstrap"), say, lambda share: advance(BEGUN + share * (SEARCHED - BEGUN))
    )
    extended = weighed(start, extended, wanted, acceptance, rng("background"), say)
    advance(SEARCHED)
    significance = SHARES["remainder"] * false_alarm
    left = remainder(extended.fitted, significance, rng("decoys"), say)
    every = Catalogue.of(train, have)
    if catalogue or leave_out:
        extended = weighed_against(extended, every)
    advance(0.8)
    if not grown and (grown := growth_of_residuals(extended.fitted, alarm)):
        extended = extended.weighed(grown.sigma(train, start.device))
        grown = grown.levelled(extended.fitted)
    if grown:
        say(f"the noise grows with range: {1e6 * grown.slope:.3g} um/m, p = {grown.p:.2g}")
    verdicts = tuple(verdict(finding, every.untestable(finding.cause.id)) for finding in extended.findings)
    return Diagnosis(start, extended, verdicts, tuple(left), grown, wanted.lacking, wanted.superseded,
                     acceptance.false_alarm, misfit(extended.fitted, rng("misfit")), capped=len(verdicts) >= causes,
                     alternatives=fitted_alternatives(verdicts, extended.fitted),
                     in_reach=models_in_reach(extended.fitted, extended.findings, every))  # fmt: skip
