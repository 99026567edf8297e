"""A history of one robot: what its calibrations in order say of each parameter, and which of them moved between which.

Changes over time: which of many parameters moved between independent calibrations, and between which ones.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.difference import Difference, LikelihoodEstimate, comparable
from calflow.files.deferred import pd
from calflow.files.tables import StoredResults, column
from calflow.robot.parts import Parameter

NULL_DRAWS = 20_000  # of calibrations in which nothing moves
FALSE_ALARM = 0.01
UNIT = "as `unit` says"


@dataclass(frozen=True)
class Change:
    """A parameter (its index) that is not the same in calibrations first to last, and changed most likely after one of them.

    All three count calibrations from 0. p is the chance that any parameter looks so anywhere where none moved; shift is the mean
    after less the mean before, in these calibrations, and sd its standard deviation.
    """

    parameter: int
    first: int
    after: int
    last: int
    p: float
    shift: float
    sd: float


def changes(runs: Sequence[LikelihoodEstimate], false_alarm: float, rng: np.random.Generator) -> list[Change]:
    """Return the parameters that moved and when, by how the mean of some calibrations in a row differs from that of the next ones.

    A parameter is tested by what each calibration says of it whatever all others are, so that those which moved do not make
    another one look so, and along a direction that the measurements do not determine nothing is told. Of every pair of
    neighbouring groups of calibrations and every parameter that all of them tell of the largest |z| is compared with the
    largest among draws in which nothing moved, with the covariances in full (Westfall & Young 1993): the chance that anything
    is told wrongly is at most false_alarm. The narrowest group that shows a change says when (Baranowski, Chen & Fryzlewicz 2019);
    before and after it there may be others.
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
    """Return a parameter's mean over calibrations in which it did not move, weighted by what each knows, and its sd."""
    weight = np.array([1 / run.sd[parameter] ** 2 for run in runs])
    return float(weight @ [run.value[parameter] for run in runs] / weight.sum()), float(weight.sum() ** -0.5)


def _spans(n: int) -> Iterator[tuple[int, int, int]]:
    """Every group of calibrations in a row with every place to part it: first, last before the change, last."""
    return ((a, k, b) for a in range(n) for b in range(a + 1, n) for k in range(a, b))


def _shift(value: np.ndarray, weight: np.ndarray, span: tuple[int, int, int]) -> tuple[Any, Any]:
    """Mean after less mean before, and its standard deviation, of values (runs, …) with weights that spread over them."""
    a, k, b = span
    before, after = slice(a, k + 1), slice(k + 1, b + 1)
    means = [(value[side] * weight[side]).sum(axis=0) / weight[side].sum(axis=0) for side in (before, after)]
    return means[1] - means[0], np.sqrt(sum(1 / weight[side].sum(axis=0) for side in (before, after)))


def _drawn(run: LikelihoodEstimate, rng: np.random.Generator) -> np.ndarray:
    """What a calibration would say by chance (NULL_DRAWS, n) where all parameters are zero."""
    scale = np.sqrt(np.diag(run.covariance))
    variance, vectors = np.linalg.eigh(run.covariance / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(variance, 0))
    return np.asarray(scale * (rng.standard_normal((NULL_DRAWS, len(scale))) @ root.T))


def _narrowest(shown: dict[tuple[int, int, int], float], first: int, last: int) -> list[tuple[int, int, int]]:
    """The narrowest groups that show a change, the clearest of equally narrow ones, in order; none overlaps another's change."""
    within = {span: z for span, z in shown.items() if first <= span[0] and span[2] <= last}
    if not within:
        return []
    best = min(within, key=lambda span: (span[2] - span[0], -within[span]))
    return [*_narrowest(shown, first, best[1]), best, *_narrowest(shown, best[1] + 1, last)]


Verdict = Literal["in place", "moved", "cannot be told"]


@dataclass(frozen=True, kw_only=True)
class RunInOrder:
    """A run of the history, and whether its robot differs from that of the run before."""

    run: str = column("the run")
    date: str = column("when it was measured, as its study says; empty: it does not say")
    chi2: float | None = column("of all differences from the run before, covariances counted; empty: it is the first")
    freedom: int | None = column("directions in which the measurements of both tell of them; empty: as before")
    p: float | None = column("chance of so much where nothing moved; empty: as before")
    moved: bool = column("whether anything moved since the run before, all runs counted")


@dataclass(frozen=True, kw_only=True)
class ParameterInRun:
    """What the measurements of a run say of a parameter by themselves, without its prior."""

    run: str = column("the run")
    parameter: str = column("its name")
    unit: str = column("of the figures in this row (SI)")
    value: float = column("figure and error together, whatever the other parameters are", UNIT, sd="sd")
    sd: float = column("its standard deviation", UNIT)
    told: bool = column(
        "whether the measurements of every run know it better than the prior; else no change of it is told"
    )


@dataclass(frozen=True, kw_only=True)
class MovedParameter:
    """A parameter that moved between runs by more than chance, all parameters and runs counted."""

    parameter: str = column("its name")
    effect: str = column("id of its effect")
    joint: int | None = column("number of its joint or link; empty: none")
    unit: str = column("of the figures in this row (SI)")
    after: str = column("the last run before it moved, most likely")
    before: str = column("the first run after")
    surely_after: str = column("a run before it moved, surely")
    surely_before: str = column("a run after, surely; between the two it may have moved little by little")
    shift: float = column("mean of before to surely_before less that of surely_after to after", UNIT, sd="sd")
    sd: float = column("its standard deviation", UNIT)
    in_sd: float = column("the shift in standard deviations")
    p: float = column("chance that any parameter looks so between any runs where nothing moved")
    meaning: str = column("what it is, in words")


@dataclass(frozen=True, kw_only=True)
class PresentFigure:
    """What a parameter is now, by all runs since it last moved."""

    parameter: str = column("its name")
    unit: str = column("of the figures in this row (SI)")
    value: float = column("figure and error together", UNIT, sd="sd")
    sd: float = column("its standard deviation", UNIT)
    since: str = column("the first run that counts")
    runs: int = column("how many count")
    recalibrate: bool = column("whether it moved: what was calibrated before does not hold any more")
    told: bool = column("whether the measurements of every run know it better than the prior")


@dataclass(frozen=True)
class History(StoredResults):
    """Calibrations of one robot in order; notes say what was left out."""

    runs: tuple[RunInOrder, ...]
    parameters: tuple[ParameterInRun, ...]
    moved: tuple[MovedParameter, ...]
    present: tuple[PresentFigure, ...]
    false_alarm: float
    notes: tuple[str, ...]

    @property
    def status(self) -> Verdict:
        """Whether anything moved, and whether it can be told what."""
        if self.moved:
            return "moved"
        return "cannot be told" if self.nameless else "in place"

    @property
    def nameless(self) -> tuple[RunInOrder, ...]:
        """Runs before which something moved, while no parameter can be told to have done so there."""
        names = [run.run for run in self.runs]
        spans = [(names.index(movement.surely_after), names.index(movement.surely_before)) for movement in self.moved]
        return tuple(run for k, run in enumerate(self.runs) if run.moved and not any(a < k <= b for a, b in spans))

    @property
    def table(self) -> pd.DataFrame:
        """What moved as a DataFrame."""
        return self.results.tables["moved.csv"]


def history(
    names: Sequence[str], dates: Sequence[datetime.date | None], runs: Sequence[CalibratedModel], false_alarm: float,
    rng: np.random.Generator,
) -> History:  # fmt: skip
    """Tell which parameters of a robot moved between independent calibrations of it, in order.

    Half of false_alarm is for single parameters (see `changes`), half for whether anything moved from one run to the next
    (chi² of all differences, Bonferroni over runs), which also sees what no single parameter can be held for.
    """
    rows = _shared(runs)
    parameters = [runs[0].model.parameters[k] for k in rows[0]]
    alone = [_likelihood_estimate(run, columns) for run, columns in zip(runs, rows, strict=True)]
    steps = changes(alone, false_alarm / 2, rng)
    begins = {
        j: max((1 + step.after for step in steps if step.parameter == j), default=0) for j in range(len(parameters))
    }
    told = np.all([run.told for run in alone], axis=0)
    return History(
        _in_order(names, dates, runs, false_alarm / 2),
        tuple(
            ParameterInRun(run=name, parameter=parameter.name, unit=parameter.unit, told=bool(told[j]),
                           value=parameter.figure + float(run.value[j]), sd=float(run.sd[j]))
            for name, run in zip(names, alone, strict=True) for j, parameter in enumerate(parameters)
        ),
        tuple(_moved(step, parameters[step.parameter], names) for step in steps),
        tuple(
            PresentFigure(parameter=parameter.name, unit=parameter.unit, value=parameter.figure + value, sd=sd,
                          since=names[begins[j]], runs=len(runs) - begins[j], recalibrate=begins[j] > 0, told=bool(told[j]))
            for j, parameter in enumerate(parameters) for value, sd in [mean_of_runs(alone[begins[j] :], j)]
        ),
        false_alarm,
        tuple(_notes(names, runs, parameters)),
    )  # fmt: skip


def _shared(runs: Sequence[CalibratedModel]) -> list[np.ndarray]:
    """The indices in each run of the robot's parameters that all runs have alike."""
    first = runs[0]
    device = {int(k) for observation in first.model.observations for k in first.model.columns(observation)}
    pairs = [dict(comparable(first, run)) for run in runs]
    shared = [k for k in pairs[0] if k not in device and all(k in places for places in pairs)]
    return [np.array([places[k] for k in shared], dtype=int) for places in pairs]


def _likelihood_estimate(run: CalibratedModel, rows: np.ndarray) -> LikelihoodEstimate:
    """What a run's measurements say of some parameters, once the prior is taken out of it."""
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


def _moved(step: Change, parameter: Parameter, names: Sequence[str]) -> MovedParameter:
    return MovedParameter(
        parameter=parameter.name, effect=parameter.effect, joint=parameter.joint or None, unit=parameter.unit,
        after=names[step.after], before=names[step.after + 1], surely_after=names[step.first], surely_before=names[step.last],
        shift=step.shift, sd=step.sd, in_sd=step.shift / step.sd, p=step.p, meaning=parameter.meaning,
    )  # fmt: skip


def _notes(names: Sequence[str], runs: Sequence[CalibratedModel], parameters: Sequence[Parameter]) -> Iterator[str]:
    """Say which parameters are of some runs alone, or cannot be compared, and which are held at several values."""
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
            f"not compared: {', '.join(left[:12])}{f' and {len(left) - 12} more' if len(left) > 12 else ''}; they are not of all "
            "runs, of the measuring device, at a bound, or count from where each run placed base or tool"
        )
