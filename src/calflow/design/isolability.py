"""Isolability: which causes a planned measurement would detect, and from which others it would distinguish each.

For every cause at a stated size, measurements are simulated by the linearised model and the noise, and all causes are tested and
compared as in diagnose. The share of draws in which the cause is in the finding's set is its probability of detection; the share
in which, besides, a rival is not in it is the probability of distinguishing them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calflow.design.discrimination import ANY_MEANS, ENOUGH
from calflow.design.measuring_order import reached
from calflow.design.planned import Planned, RecordedCondition
from calflow.diagnosis import FALSE_ALARM
from calflow.diagnosis.regressors import Candidate, H, Place, Regressors, TallMatrix, candidates_of
from calflow.diagnosis.screening import Catalogue, Family, Screening
from calflow.diagnosis.stepwise import SHARES, WITHIN
from calflow.effects import effect_class
from calflow.effects.cause import Cause
from calflow.effects.wording import cause_name
from calflow.estimation.probing import probed
from calflow.files.deferred import pd
from calflow.files.tables import column, to_frame
from calflow.measurements.measurements import Measurements
from calflow.model import stated
from calflow.robot.robot import Robot

RECORDS: dict[RecordedCondition, str] = {
    "approach": "each joint's direction of approach recorded",
    "travel": "each joint's travel since its last reversal recorded",
    "time": "the time of each row recorded",
    "temperature": "a thermometer",
}
MINUTE = 60.0  # s, from pose to pose
WARM_UP, TIME_CONSTANT = 12.0, 3600.0  # K and s, of a robot that warms up during the measurement
ROOM_TEMPERATURE = 293.15  # K
DRAWS_PER_CAUSE = 400  # simulated measurements per cause: standard error 0.015 of a probability of 0.9
FORMS = 20  # largest number of a cause's variants, drawn at random
TYPICAL_ERROR = 0.4  # in prior standard deviations, of fitted parameters (UR10 0.2, FANUC 0.4, UR5 1.1)
# Probabilities of pairs: a true cause's place, and a rival's or nothing.
Told = Mapping[tuple[Place, Place | None], float]


@dataclass(frozen=True, eq=False)
class MeasuringPlan:
    """Poses in measuring order: readings (n, n_joints), the payload of each, the markers measured at each, the records.

    vias (n, n_joints): readings before each pose; None if each follows the previous one.
    """

    robot: Robot
    readings: np.ndarray
    payloads: tuple[str, ...]
    markers: tuple[str, ...]
    records: frozenset[RecordedCondition] = frozenset()
    vias: np.ndarray | None = None

    def measurements(self) -> Measurements:
        """Return the rows of the robot, which warms up, at one pose a minute; their positions, which no test needs, are zero."""
        n, each = len(self.readings), len(self.markers)
        came, far = reached(self.readings, self.vias)
        time = MINUTE * np.arange(n)
        temperature = ROOM_TEMPERATURE - WARM_UP * np.expm1(-time / TIME_CONSTANT)
        every = {"approach": came, "travel": far, "time": time, "temperature": temperature}
        rows: dict[str, np.ndarray] = {"pose": np.arange(1, n + 1), "payload": np.array(self.payloads)}
        rows |= {name: values for name, values in every.items() if name in self.records}
        conditions: dict[str, Any] = {name: np.repeat(values, each, axis=0) for name, values in rows.items()}
        q, markers = np.repeat(self.readings, each, axis=0), np.tile(np.array(self.markers), n)
        return Measurements.from_arrays(self.robot, q, np.zeros((len(q), 3)), marker=markers, **conditions)

    def additions(self, more: np.ndarray) -> Iterator[tuple[str, MeasuringPlan]]:
        """Yield each possible addition in words, the cheapest first, and the plan with it; more: readings of further poses."""
        for record, words in RECORDS.items():
            if record not in self.records:
                yield words, replace(self, records=self.records | {record})
        for name in self.robot.payloads:
            if name not in self.payloads:
                half = tuple(name if k % 2 else payload for k, payload in enumerate(self.payloads))
                yield f"payload '{name}' at every other pose", replace(self, payloads=half)
        for name in self.robot.markers:
            if name not in self.markers:
                yield f"marker '{name}' measured at every pose too", replace(self, markers=(*self.markers, name))
        if len(more):
            payloads = (*self.payloads, *np.resize(np.array(self.payloads), len(more)).tolist())
            longer = replace(self, readings=np.vstack([self.readings, more]), payloads=payloads)
            vias = None if self.vias is None else np.vstack([self.vias, more])
            yield f"{len(more)} further poses", replace(longer, vias=vias)


@dataclass(frozen=True, kw_only=True)
class IsolabilityCell:
    """A cause at a stated size: its probability of detection (no rival), or of being distinguished from a rival."""

    cause: str = column("id of the cause")
    joint: int | None = column("its joint or link; empty: none, or all")
    part: str = column("its part of the robot; empty: the poses cannot test it")
    size: float | None = column("root mean square of its parameters that have the first one's unit", "as unit says")
    unit: str = column("unit of size")
    rival: str = column("id of the rival; empty: none, for the detection of the cause")
    rival_joint: int | None = column("its joint or link; empty: none")
    rival_part: str = column("its part of the robot; empty: the poses cannot test it")
    chance: float = column("probability of detecting the cause, and of distinguishing it from the rival")
    enough: bool = column("whether it is 0.9 or more")
    needs: str = column("unmet needs of a test of the cause, or of the rival; empty: none")
    worst: bool = column("whether it is the cause's worst gap")
    addition: str = column("the cheapest addition that closes the worst gap; empty: none of those tried")
    chance_then: float | None = column("the probability with it; empty: none")
    words: str = column("the worst gap in words; empty elsewhere")


@dataclass(frozen=True, eq=False)
class Isolability:
    """The probability of telling each cause's place from each rival's, or from nothing (None): that of detecting it.

    causes: a form for each place; told: these probabilities of pairs (true, rival); lacking: unmet needs of tests;
    indistinguishable: by place, the ids that data of this kind cannot distinguish from it, and what would (empty: another
    sensor or load). A cause that the poses cannot test has its id alone as place, without a part.
    """

    causes: Mapping[Place, Cause]
    told: Told
    lacking: Mapping[str, str]
    indistinguishable: Mapping[Place, Mapping[str, str]]

    def table(self, size: float, tried: Mapping[str, Isolability]) -> pd.DataFrame:
        """Return select/isolability.csv for causes of a size over their usual, and the isolability with each addition."""
        rows: list[IsolabilityCell] = []
        for cause in (*self.causes, *((name, "") for name in self.lacking)):
            own, alike = self.causes.get(cause), self.indistinguishable.get(cause, {})
            others = [place for place in self.causes if own and place != cause]
            rivals = [None, *others, *((name, "") for name in alike)]
            chances = [self.chance_of(cause, rival) for rival in rivals]
            # A cause that is not detected has no worse gap.
            worst = 0 if chances[0] < ENOUGH or len(chances) == 1 else 1 + int(np.argmin(chances[1:]))
            usual, unit = _usual(own, size) if own else (None, "")
            for k, (rival, chance) in enumerate(zip(rivals, chances, strict=True)):
                other = self.causes.get(rival, own) if rival else None  # one that is not testable is at the same joint
                gap = k == worst and chance < ENOUGH
                closing = (words for words, one in tried.items() if one.chance_of(cause, rival) >= ENOUGH)
                addition = next(closing, "") if gap else ""
                rows.append(
                    IsolabilityCell(
                        cause=cause[0], joint=own.joint or None if own else None, part=cause[1], size=usual, unit=unit,
                        rival=rival[0] if rival else "", rival_joint=other.joint or None if other else None,
                        rival_part=rival[1] if rival else "", chance=chance, enough=chance >= ENOUGH,
                        needs=self._needs(cause, rival), worst=gap, addition=addition,
                        chance_then=tried[addition].chance_of(cause, rival) if addition else None,
                        words=self._words(cause, rival, addition, tried) if gap else "",
                    )
                )  # fmt: skip
        return to_frame(rows, IsolabilityCell)

    def chance_of(self, cause: Place, rival: Place | None) -> float:
        """Return the probability of detecting a cause (rival None), or of distinguishing it; 0 if not testable.

        A cause without a part is represented by its best detected place, in a pair by the worst distinguished ones.
        """
        true, others = ([place for place in self.causes if of in (place, (place[0], ""))] for of in (cause, rival))
        if rival is None:
            return max((self.told[place, None] for place in true), default=0.0)
        return min((self.told.get((place, other), 0.0) for place in true for other in others), default=0.0)

    def _needs(self, cause: Place, rival: Place | None) -> str:
        if cause not in self.causes:
            return self.lacking[cause[0]]
        return self.indistinguishable[cause][rival[0]] if rival and rival not in self.causes else ""

    def _name(self, place: Place) -> str:
        """Return a cause's name in words with its joint, or with its part if it has several."""
        several = sum(place[0] == cause for cause, _ in self.causes) > 1
        return cause_name(
            place[0], self.causes[place].joint if place in self.causes else 0, place[1] if several else ""
        )

    def _words(self, cause: Place, rival: Place | None, addition: str, tried: Mapping[str, Isolability]) -> str:
        what = "detected" if rival is None else f"distinguished from {self._name(rival)}"
        needs = self._needs(cause, rival)
        how = f"not {what}: it takes {needs}" if needs else f"{what} in {_percent(self.chance_of(cause, rival))}"
        if addition:
            then = tried[addition]
            # The parts of a cause that was not testable before.
            parts = [place for place in then.causes if place[0] == cause[0] and not (cause[1] or rival)]
            shown = ", ".join(place[1] for place in parts if then.told[place, None] >= ENOUGH)
            closed = f"with {addition} in {_percent(then.chance_of(cause, rival))}{f' ({shown})' if shown else ''}"
            return f"{self._name(cause)} is {how}; {closed}"
        if needs:
            return f"{self._name(cause)} is {how}"
        means = ["at this size it takes a more precise device or more poses"]
        if rival is not None:
            effects = [effect_class(of[0]) for of in (cause, rival)]
            means = [effect.told_by for effect in effects if effect and effect.told_by] or [ANY_MEANS]
        return f"{self._name(cause)} is {how}, and nothing tried changes that: {', or '.join(dict.fromkeys(means))}"


def isolability(
    effects: Sequence[str],
    planned: Planned,
    data: Measurements,
    rng: np.random.Generator,
    *,
    size: float = 1.0,
    false_alarm: float = FALSE_ALARM,
    draws: int = DRAWS_PER_CAUSE,
) -> Isolability:
    """Return the isolability of causes by a plan, besides effects that are fitted.

    Args:
        effects: ids of the effects fitted anyway.
        planned: how each pose will be measured.
        data: the plan's rows, of which some are held out.
        rng: random numbers for causes and noise.
        size: root mean square of each cause's parameters, in prior standard deviations.
        false_alarm: probability that diagnose finds anything without a hidden cause.
        draws: number of simulated measurements per cause.
    """
    screening, catalogue = screened(effects, planned, data, rng)
    told = chances(screening, screening.family(rng), SHARES["causes"] * false_alarm, rng, size=size, draws=draws)
    causes = {candidate.cause.place: candidate.cause for candidate in screening.whole.regressors.candidates}
    tested = {(cause.id, cause.joint) for cause in causes.values()}
    indistinguishable = {
        place: {name: "" for name in cause.alike if (name, cause.joint) not in tested} | catalogue.untestable(cause.id)
        for place, cause in causes.items()
    }
    return Isolability(causes, told, catalogue.lacking, indistinguishable)


def screened(
    effects: Sequence[str], planned: Planned, data: Measurements, rng: np.random.Generator
) -> tuple[Screening[Cause], Catalogue]:
    """Return the tests of all causes that a plan's measurements allow, and their catalogue.

    Residuals are drawn noise; joints have the usual compliance, on which some causes depend.
    """
    train = data.only(data.train)
    catalogue = Catalogue.of(train, effects)
    model = stated(data.robot, effects, train, (planned.observation,))
    n, sd, point = len(model.parameters), model.prior_sd, model.nominal.copy()
    for effect in model.effects:
        if effect.inevitable:
            point[model.columns(effect)] += sd[model.columns(effect)]
    _, matrix = probed(planned.problem(model, point, train.conditions), point, catalogue.effects)
    residual, held = rng.standard_normal(len(matrix)), TallMatrix.held(matrix[:, n:])
    of_causes = np.array([parameter.prior_sd for effect in catalogue.effects for parameter in effect.declared])
    regressors = Regressors(
        residual, matrix[:, :n], sd**-2.0, np.zeros(n), 0.0, held, of_causes, candidates_of(catalogue.effects)
    )
    return Screening.of(regressors), catalogue


def chances(
    screening: Screening[H],
    family: Family,
    false_alarm: float,
    rng: np.random.Generator,
    *,
    size: float = 1.0,
    draws: int = DRAWS_PER_CAUSE,
    places: Collection[Place] | None = None,
) -> Told:
    """Return the probability of telling each place from each rival, or from nothing, by common noise draws.

    false_alarm is the family-wise rate of the tests; places are those that may be true, by default all.
    """
    regressors, whole = screening.whole.regressors, screening.whole
    noise = rng.standard_normal((len(regressors.residual), draws))
    pull = (
        TYPICAL_ERROR * np.sqrt(regressors.precision)[:, None] * rng.standard_normal((len(regressors.precision), draws))
    )
    still, left = whole.settled(noise, pull)
    forms: dict[Place, list[Candidate[H]]] = {}
    for candidate in regressors.candidates:
        forms.setdefault(candidate.cause.place, []).append(candidate)
    true = {place: form for place, form in forms.items() if places is None or place in places}
    told = {(place, rival): 0 for place in true for rival in (None, *forms) if rival != place}
    for place, form in true.items():
        tried = [form[k] for k in rng.permutation(len(form))[:FORMS]]
        for candidate, which in zip(tried, np.array_split(np.arange(draws), len(tried)), strict=True):
            truth, columns = amplitudes(candidate, regressors.prior_sd, size, len(which), rng), candidate.columns
            score = still[:, which] - whole.response(columns) @ truth
            chi2 = left[which] - (truth * (still[columns][:, which] + score[columns])).sum(axis=0)
            by_place = screening.trials(score, chi2, family, false_alarm)
            if place not in by_place:  # no form is testable
                break
            # A finding's set holds the best cause that passes, and those near it.
            cost, passed = (np.array(values) for values in zip(*by_place.values(), strict=True))
            best = np.where(passed, cost, np.inf).min(axis=0)
            in_set: dict[Place | None, np.ndarray] = dict(
                zip(by_place, (cost - best < WITHIN) & np.isfinite(best), strict=True)
            )
            for rival in {None, *forms} - {place}:  # an untestable place is never confused
                told[place, rival] += int((in_set[place] & ~in_set.get(rival, np.False_)).sum())
    return {pair: count / draws for pair, count in told.items()}


def amplitudes(
    candidate: Candidate[H], prior_sd: np.ndarray, size: float, number: int, rng: np.random.Generator
) -> np.ndarray:
    """Draw a cause's parameters (n_parameters, number) of given size and random direction, within their bounds."""
    direction = rng.standard_normal((len(candidate.columns), number))
    direction *= np.sqrt(len(direction) / (direction**2).sum(axis=0))
    drawn = size * prior_sd[candidate.columns, None] * direction
    low, high = candidate.cause.bounds[:, :, None]
    return np.asarray(np.clip(np.where((drawn < low) | (drawn > high), -drawn, drawn), low, high))


def isolability_summary(table: pd.DataFrame) -> str:
    """Return how many causes are detected, and how many of these are distinguished from all others."""
    tested = table[table["part"].fillna("") != ""]
    seen = int(tested.loc[tested["rival"].fillna("") == "", "enough"].sum())
    separable = tested.groupby(["cause", "part"])["enough"].all()
    return f"of {len(separable)} causes {seen} would be detected, and {int(separable.sum())} of these distinguished from all others"


def isolability_gaps(table: pd.DataFrame) -> list[str]:
    """Return in words the causes' worst gaps that an addition closes, the widest first."""
    gaps = table[table["worst"] & (table["addition"].fillna("") != "")]
    return list(gaps.sort_values("chance", kind="stable")["words"])


def _usual(cause: Cause, size: float) -> tuple[float, str]:
    unit = cause.declared[0].unit
    same = [parameter.prior_sd for parameter in cause.declared if parameter.unit == unit]
    return size * float(np.sqrt(np.mean(np.square(same)))), unit


def _percent(chance: float) -> str:
    return f"{100 * chance:.0f} of 100"
