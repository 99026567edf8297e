"""History of a robot: the estimates of its calibrations in order, and the test which parameters moved between which.

Change points of many parameters across independent calibrations, with family-wise control of false alarms.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import scipy

from calflow.effects import Effect
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.difference import Difference, LikelihoodEstimate, comparable
from calflow.estimation.error_model import root_of
from calflow.files.deferred import pd
from calflow.files.tables import StoredResults, column
from calflow.observations import Observation
from calflow.robot.parts import Parameter

NULL_DRAWS = 20_000  # simulated calibrations in which nothing moves
FALSE_ALARM = 0.01
SURE = 0.95  # probability among the changes of one parameter, from which that is said to have moved
UNIT = "as `unit` says"


@dataclass(frozen=True)
class Change:
    """A change of a parameter (its index) between calibrations first and last, most likely right after `after`.

    All three count from 0. p: family-wise p-value over all parameters and groups where none moved; shift: mean after
    the change minus mean before it, within these calibrations, and sd its standard deviation.
    """

    parameter: int
    first: int
    after: int
    last: int
    p: float
    shift: float
    sd: float


def changes(runs: Sequence[LikelihoodEstimate], false_alarm: float, rng: np.random.Generator) -> list[Change]:
    """Return the parameters that moved and when, by comparing means over neighbouring groups of calibrations.

    Each parameter is tested by its marginal estimates, without priors, so that those which moved do not affect the
    others; directions that the measurements do not determine are not tested. The |z| of every pair of neighbouring
    groups and every parameter determined in all of them is compared with the largest among draws in which nothing
    moved, with full covariances (Westfall & Young 1993): the family-wise error rate is at most false_alarm. The
    narrowest group that shows a change locates it (Baranowski, Chen & Fryzlewicz 2019); there may be others.
    """
    told = np.all([run.told for run in runs], axis=0)
    if not told.any():
        return []
    weight = np.array([1 / np.diag(run.covariance)[told] for run in runs])
    value = np.array([run.value[told] for run in runs])
    drawn = np.stack([_drawn(run, rng)[:, told] for run in runs])
    largest = np.zeros(NULL_DRAWS)
    shown: dict[tuple[int, int, int], np.ndarray] = {}
    for span in _spans(len(runs)):
        shift, sd = _shift(value, weight, span)
        shown[span] = np.abs(shift / sd)
        shift, sd = _shift(drawn, weight[:, None], span)
        largest = np.maximum(largest, np.abs(shift / sd).max(axis=1))
    largest.sort()
    chance = {
        span: (1 + NULL_DRAWS - np.searchsorted(largest, z, side="left")) / (1 + NULL_DRAWS)
        for span, z in shown.items()
    }
    names = np.flatnonzero(told)
    return [
        Change(int(names[j]), *span, float(chance[span][j]), *_shift(value[:, j], weight[:, j], span))
        for j in range(len(names))
        for span in _narrowest({s: z[j] for s, z in shown.items() if chance[s][j] <= false_alarm}, 0, len(runs) - 1)
    ]


def mean_of_runs(runs: Sequence[LikelihoodEstimate], parameter: int) -> tuple[float, float]:
    """Return a parameter's inverse-variance weighted mean over calibrations in which it did not move, and its sd."""
    weight = np.array([1 / run.sd[parameter] ** 2 for run in runs])
    return float(weight @ [run.value[parameter] for run in runs] / weight.sum()), float(weight.sum() ** -0.5)


def _spans(n: int) -> Iterator[tuple[int, int, int]]:
    """Return every group of consecutive calibrations with every split: first, last before the change, last."""
    return ((a, k, b) for a in range(n) for b in range(a + 1, n) for k in range(a, b))


def _shift(value: np.ndarray, weight: np.ndarray, span: tuple[int, int, int]) -> tuple[Any, Any]:
    """Return the mean after minus the mean before of weighted values (runs, …), and its standard deviation."""
    a, k, b = span
    before, after = slice(a, k + 1), slice(k + 1, b + 1)
    means = [(value[side] * weight[side]).sum(axis=0) / weight[side].sum(axis=0) for side in (before, after)]
    return means[1] - means[0], np.sqrt(sum(1 / weight[side].sum(axis=0) for side in (before, after)))


def _drawn(run: LikelihoodEstimate, rng: np.random.Generator) -> np.ndarray:
    """Return estimates of a calibration drawn under its covariance around zero (NULL_DRAWS, n)."""
    scale = np.sqrt(np.diag(run.covariance))
    root = root_of(run.covariance / np.outer(scale, scale))
    return np.asarray(scale * (rng.standard_normal((NULL_DRAWS, len(scale))) @ root.T))


def _narrowest(shown: dict[tuple[int, int, int], float], first: int, last: int) -> list[tuple[int, int, int]]:
    """Return the narrowest groups that show a change, of equal ones the most significant, in order, without overlap."""
    within = {span: z for span, z in shown.items() if first <= span[0] and span[2] <= last}
    if not within:
        return []
    best = min(within, key=lambda span: (span[2] - span[0], -within[span]))
    return [*_narrowest(shown, first, best[1]), best, *_narrowest(shown, best[1] + 1, last)]


Verdict = Literal["in place", "moved", "cannot be told", "cannot be seen"]


@dataclass(frozen=True, kw_only=True)
class RunInOrder:
    """A run of the history, tested against the run before."""

    run: str = column("the run")
    date: str = column("date of measurement, as its study states; empty: not stated")
    chi2: float | None = column(
        "chi-squared of all differences from the run before, with covariances; empty: first run"
    )
    freedom: int | None = column("its degrees of freedom: directions determined by both measurements; empty: as before")
    p: float | None = column("its p-value where nothing moved; empty: as before")
    moved: bool = column("whether anything moved since the run before, corrected for the number of runs")


@dataclass(frozen=True, kw_only=True)
class ParameterInRun:
    """Estimate of a parameter from the measurements of a run alone, without its prior."""

    run: str = column("the run")
    parameter: str = column("its name")
    unit: str = column("of the figures in this row (SI)")
    value: float = column("estimate of figure and error together, marginal over other parameters", UNIT, sd="sd")
    sd: float = column("its standard deviation", UNIT)
    told: bool = column(
        "whether the measurements of every run determine it better than the prior; else its changes are not tested"
    )
    meaning: str = column("what it is, in words")


@dataclass(frozen=True, kw_only=True)
class MovedParameter:
    """A parameter that moved between runs significantly, among all parameters and runs."""

    parameter: str = column("its name")
    effect: str = column("id of its effect")
    joint: int | None = column("number of its joint or link; empty: none")
    unit: str = column("of the figures in this row (SI)")
    after: str = column("the last run before it moved, most likely")
    before: str = column("the first run after")
    surely_after: str = column("the last run that is certainly before it moved")
    surely_before: str = column("the first run that is certainly after; in between it may have moved gradually")
    shift: float = column("mean of before to surely_before less that of surely_after to after", UNIT, sd="sd")
    sd: float = column("its standard deviation", UNIT)
    in_sd: float = column("the shift in standard deviations")
    p: float = column("family-wise p-value over all parameters and runs, where nothing moved")
    meaning: str = column("what it is, in words")


@dataclass(frozen=True, kw_only=True)
class LoneChange:
    """The change of a parameter that, all others being as they were, best explains what moved from one run to the next."""

    parameter: str = column("its name")
    effect: str = column("id of its effect")
    joint: int | None = column("number of its joint or link; empty: none")
    unit: str = column("of the figures in this row (SI)")
    after: str = column("the run before it moved")
    before: str = column("the run after")
    shift: float = column("its change, if nothing else moved", UNIT, sd="sd")
    sd: float = column("its standard deviation", UNIT)
    probability: float = column("posterior probability among the changes of one parameter")
    left_p: float = column("p-value of what it leaves, where nothing else moved")
    meaning: str = column("what it is, in words")


@dataclass(frozen=True, kw_only=True)
class PresentFigure:
    """Present estimate of a parameter, by all runs since it last moved."""

    parameter: str = column("its name")
    unit: str = column("of the figures in this row (SI)")
    value: float = column("figure and error together", UNIT, sd="sd")
    sd: float = column("its standard deviation", UNIT)
    since: str = column("the first run included")
    runs: int = column("number of runs included")
    recalibrate: bool = column("whether it moved: earlier calibrations of it do not hold any more")
    told: bool = column("whether the measurements of every run determine it better than the prior")


@dataclass(frozen=True)
class History(StoredResults):
    """Calibrations of one robot in order, with changes and present estimates; notes: what was left out.

    lone: for each run before which something moved, the change of one parameter that explains it best.
    """

    runs: tuple[RunInOrder, ...]
    parameters: tuple[ParameterInRun, ...]
    moved: tuple[MovedParameter, ...]
    lone: tuple[LoneChange, ...]
    present: tuple[PresentFigure, ...]
    false_alarm: float
    notes: tuple[str, ...]

    @property
    def status(self) -> Verdict:
        """Whether anything moved, and whether it can be attributed to parameters, or could be seen at all."""
        if self.moved or self.named:
            return "moved"
        if self.nameless:
            return "cannot be told"
        return "in place" if any(parameter.told for parameter in self.parameters) else "cannot be seen"

    @property
    def named(self) -> tuple[LoneChange, ...]:
        """The changes of one parameter that explain all that moved before a run, and that no other one explains as well."""
        known = self._not_among_moved
        return tuple(
            lone
            for lone in self.lone
            if lone.before in known and lone.probability >= SURE and lone.left_p > self.false_alarm
        )

    @property
    def nameless(self) -> tuple[RunInOrder, ...]:
        """Runs before which something moved that no single parameter accounts for."""
        named = {lone.before for lone in self.named}
        return tuple(run for run in self.runs if run.run in self._not_among_moved - named)

    @property
    def _not_among_moved(self) -> set[str]:
        """The names of the runs before which something moved that is not among the parameters that moved for certain."""
        names = [run.run for run in self.runs]
        spans = [(names.index(movement.surely_after), names.index(movement.surely_before)) for movement in self.moved]
        return {run.run for k, run in enumerate(self.runs) if run.moved and not any(a < k <= b for a, b in spans)}

    @property
    def table(self) -> pd.DataFrame:
        """The moved parameters as a DataFrame."""
        return self.results.tables["moved.csv"]


def history(
    names: Sequence[str], dates: Sequence[datetime.date | None], runs: Sequence[CalibratedModel], false_alarm: float,
    rng: np.random.Generator,
) -> History:  # fmt: skip
    """Test which parameters of a robot moved between independent calibrations in order.

    Half of false_alarm is for single parameters (see `changes`), half for any change from one run to the next
    (chi-squared of all differences, Bonferroni over runs), which also detects changes of no single parameter.
    """
    rows = _shared(runs)
    parameters = [runs[0].model.parameters[k] for k in rows[0]]
    alone = [_likelihood_estimate(run, columns) for run, columns in zip(runs, rows, strict=True)]
    steps = changes(alone, false_alarm / 2, rng)
    begins = {
        j: max((1 + step.after for step in steps if step.parameter == j), default=0) for j in range(len(parameters))
    }
    told = np.all([run.told for run in alone], axis=0)
    in_order = _in_order(names, dates, runs, false_alarm / 2)
    return History(
        in_order,
        tuple(
            ParameterInRun(run=name, parameter=parameter.name, unit=parameter.unit, told=bool(told[j]),
                           value=parameter.figure + float(run.value[j]), sd=float(run.sd[j]), meaning=parameter.meaning)
            for name, run in zip(names, alone, strict=True) for j, parameter in enumerate(parameters)
        ),
        tuple(_moved(step, parameters[step.parameter], names) for step in steps),
        tuple(
            _lone_change(*pair, (before.run, after.run))
            for pair, (before, after) in zip(pairwise(runs), pairwise(in_order), strict=True) if after.moved
        ),
        tuple(
            PresentFigure(parameter=parameter.name, unit=parameter.unit, value=parameter.figure + value, sd=sd,
                          since=names[begins[j]], runs=len(runs) - begins[j], recalibrate=begins[j] > 0, told=bool(told[j]))
            for j, parameter in enumerate(parameters) for value, sd in [mean_of_runs(alone[begins[j] :], j)]
        ),
        false_alarm,
        tuple(_notes(names, runs, parameters)),
    )  # fmt: skip


def _shared(runs: Sequence[CalibratedModel]) -> list[np.ndarray]:
    """Return for each run the indices of the robot's parameters that are comparable in all runs.

    Those of a curve are not among them: alone they mean nothing, and without their priors nothing beside them is determined.
    """
    first = runs[0]
    curves = [effect for effect in first.model.effects if effect.is_curve]
    parts: tuple[Observation | Effect, ...] = (*first.model.observations, *curves)
    others = {int(k) for part in parts for k in first.model.columns(part)}
    pairs = [dict(comparable(first, run)) for run in runs]
    shared = [k for k in pairs[0] if k not in others and all(k in places for places in pairs)]
    return [np.array([places[k] for k in shared], dtype=int) for places in pairs]


def _likelihood_estimate(run: CalibratedModel, rows: np.ndarray) -> LikelihoodEstimate:
    """Return a run's estimates of some parameters with the prior removed."""
    parameters = [run.model.parameters[k] for k in rows]
    mean, sd = (np.array([getattr(parameter, name) for parameter in parameters]) for name in ("prior_mean", "prior_sd"))
    return LikelihoodEstimate.of(run.estimate[rows], run.covariance[np.ix_(rows, rows)], mean, sd)


def _in_order(
    names: Sequence[str], dates: Sequence[datetime.date | None], runs: Sequence[CalibratedModel], false_alarm: float
) -> tuple[RunInOrder, ...]:
    tests: list[tuple[float, int, float] | None] = [None]
    tests += [Difference.of(*pair).joint for pair in pairwise(runs)]
    limit = false_alarm / (len(runs) - 1)
    return tuple(
        RunInOrder(
            run=name, date="" if date is None else date.isoformat(), chi2=test and test[0], freedom=test and test[1],
            p=test and test[2], moved=test is not None and test[2] <= limit,
        )
        for name, date, test in zip(names, dates, tests, strict=True)
    )  # fmt: skip


def _lone_change(first: CalibratedModel, second: CalibratedModel, names: tuple[str, str]) -> LoneChange:
    """Return the change of one parameter that best explains how two calibrations differ, all others being as they were.

    A change shows in the second estimate as far as its measurements, and not the prior, determine it. Each is as large a priori as
    the parameter's own error.
    """
    difference = Difference.of(first, second)
    whitening, whitened = difference.whitening, difference.whitening @ difference.value
    own, sd = second.covariance[np.ix_(difference.second, difference.second)], first.model.prior_sd[difference.first]
    shown = whitening @ (np.eye(len(sd)) - own / sd**2)
    information = np.maximum((shown**2).sum(axis=0), np.finfo(float).tiny)  # what shows nowhere gains nothing
    shift = shown.T @ whitened / information
    gained = shift**2 * information
    evidence = (gained - np.log1p(information * sd**2)) / 2
    best = int(evidence.argmax())
    parameter, (chi2, freedom, _) = first.model.parameters[difference.first[best]], difference.joint
    return LoneChange(
        parameter=parameter.name, effect=parameter.effect, joint=parameter.joint or None, unit=parameter.unit,
        after=names[0], before=names[1], shift=float(shift[best]), sd=float(information[best] ** -0.5),
        probability=float(1 / np.exp(evidence - evidence[best]).sum()),
        left_p=float(scipy.stats.chi2.sf(chi2 - gained[best], max(1, freedom - 1))), meaning=parameter.meaning,
    )  # fmt: skip


def _moved(step: Change, parameter: Parameter, names: Sequence[str]) -> MovedParameter:
    return MovedParameter(
        parameter=parameter.name, effect=parameter.effect, joint=parameter.joint or None, unit=parameter.unit,
        after=names[step.after], before=names[step.after + 1], surely_after=names[step.first], surely_before=names[step.last],
        shift=step.shift, sd=step.sd, in_sd=step.shift / step.sd, p=step.p, meaning=parameter.meaning,
    )  # fmt: skip


def _notes(names: Sequence[str], runs: Sequence[CalibratedModel], parameters: Sequence[Parameter]) -> Iterator[str]:
    """Yield notes on parameters that cannot be compared, and on those fixed at different values."""
    held: dict[str, dict[str, Parameter]] = {}
    for name, run in zip(names, runs, strict=True):
        for parameter in run.model.declared:
            if parameter.held is not None:
                held.setdefault(parameter.name, {})[name] = parameter
    for parameter_name, held_values in held.items():
        if len({parameter.held for parameter in held_values.values()}) > 1:
            values = (f"{parameter.held:g} {parameter.unit} in {name}" for name, parameter in held_values.items())
            yield f"{parameter_name} is held at {' and '.join(values)}: what makes up for that passes for a movement"
    shared = {parameter.name for parameter in parameters}
    names_known = dict.fromkeys(parameter.name for run in runs for parameter in run.model.parameters)
    left = [name for name in names_known if name not in shared]
    if left:
        yield (
            f"not compared: {', '.join(left[:12])}{f' and {len(left) - 12} more' if len(left) > 12 else ''}. Each is missing in a "
            "run, at a bound, a figure of a curve or of the measuring device, counted from where each run placed base or tool, or "
            "of a joint with other causes in another run (state the same in the effects of every study)"
        )
