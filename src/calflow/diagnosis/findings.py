"""The findings: data faults, causes with their rivals, and unexplained structure, with their words, sizes and held-out gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from calflow.diagnosis.amplitude import CERTAIN, SIZE, Amplitude, found_amplitude
from calflow.diagnosis.diagnosis import Diagnosis
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.misfit import MisfitRegion
from calflow.diagnosis.noise_model import RANGE, Growth
from calflow.diagnosis.unexplained import POSE, UnexplainedStructure, is_of_its_curve, left_along, predicted
from calflow.diagnosis.verdict import Rival, Verdict, named
from calflow.effects import catalogue
from calflow.effects.base import FORMS_OF_ONE, ITS_ANGLE, ITS_TORQUE, SMOOTH_IN, effect_class
from calflow.effects.cause import Cause
from calflow.effects.wording import (
    UNEXPLAINED,
    NamedCause,
    amount,
    amount_between,
    cause_family,
    cause_name,
    cause_words,
)
from calflow.estimation.accuracy import distances, errors, gain, judged_unit
from calflow.estimation.calibrated_model import CalibratedModel
from calflow.estimation.extrapolation import Curve
from calflow.estimation.lack_of_fit import LackOfFit
from calflow.estimation.parameters import UNIT
from calflow.files.deferred import pd
from calflow.files.tables import column
from calflow.files.units import METRE
from calflow.files.words import chance, listed, rounded
from calflow.measurements.measurements import Measurements
from calflow.observations import leading_units

NAN = float("nan")
SURE = 0.95  # probability from which a family of causes counts as certain
PLACE = {"x", "y", "z"}  # inputs that are the tool's place
INPUTS_IN_WORDS = {
    "pose": "the pose (all its markers are off alike)",
    "joints": "the angles of several joints together",
    "image": "where in the image a point is shown (as of another lens than was stated or fitted)",
    "target": "where on the target a point is",
}
RESTS = "comes to rest elsewhere each time, or errs in waves too short for these poses"
NOT_CARRIED = "; it does not carry over to poses that were left out"
NOT_DEPLOYED = "; suspected, and left out of the model: it does not help at poses left out in turn"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A data fault, a cause, or unexplained structure. No row: nothing was found that the model lacks."""

    status: Literal["named", "one_of", "unexplained", "data_fault"] = column(
        "a cause; one of several; structure without a cause (its gain is that of a Gaussian process of its inputs, which is not "
        "physical and in no model); a mistake in the file"
    )
    cause: str = column("id of the effect, or of the fault; empty: unexplained", default="")
    joint: int | None = column("number of its joint or link; empty: none", default=None)
    estimate: float = column(SIZE, UNIT, sd="sd", default=NAN)
    sd: float = column("standard deviation of the size, whichever form of the cause is true", UNIT, default=NAN)
    unit: str = column("of the size (SI)", default="")
    p_family: float = column("family-wise p-value over all tests, by noise alone", default=NAN)
    probability: float = column(
        "posterior probability of this cause, at any part, against rivals and none", default=NAN
    )
    cannot_tell_from: tuple[str, ...] = column(
        "ids of causes that it may be instead, also of those that these data could not test; `unexplained` where an unexplained "
        "error depends on the same input",
        default=(),
    )
    gain_mean_mm: float = column("reduction of the mean error at held-out poses", "mm", default=NAN)
    gain_low_mm: float = column("lower end of the gain's 95 % interval", "mm", default=NAN)
    gain_high_mm: float = column("upper end of it", "mm", default=NAN)
    heldout_mean_mm: float = column("mean error at held-out poses with it", "mm", default=NAN)
    detail: str = column("the variant, in words, and other parts at which it may act instead", default="")
    rival_labels: tuple[str, ...] = column(
        "causes that could explain the data instead, or that unexplained structure may be: id and joint",
        name="rivals", separator="; ", default=(),
    )  # fmt: skip
    rival_causes: tuple[str, ...] = column("ids of the rivals, in their order", default=())
    rival_joints: tuple[int, ...] = column("their joints; 0: none", default=())
    rows: tuple[int, ...] = column("lines of the file, of a data fault", default=())
    statement: str = column("the verdict in words")
    inputs: tuple[str, ...] = column(
        "inputs of unexplained structure: q1 … (joints), tau1 … (their torques), x, y, z, order, time, payload, image, target; "
        "pose: an independent error of each pose, with joints: of where these come to rest; empty: a lack of fit, reported "
        "whether an input explains it or not, with its largest region in `detail`",
        default=(),
    )
    not_tested: tuple[str, ...] = column(
        "ids of `cannot_tell_from` that these data could not test; `statement` says what a test would take", default=()
    )
    carries_over: bool | None = column(
        "whether it gains in left-out blocks of the training poses; empty: not tested", default=None
    )
    numbers: tuple[int, ...] = column(
        "its numbers among the causes of the extended model, as in `curves.csv`: several where several of one family at one place "
        "(orders of a joint, kinds of the tool's compliance, moves of the device) are one finding, whose gain is that of all of "
        "them and whose size the root of "
        "their sum of squares",
        default=(),
    )
    deployed: bool | None = column(
        "whether a cause is in the model to be used: one of the robot that is not certain, and does not lower the leave-one-pose-"
        "out error, is not; one of the measuring device always is, and changes no command; of several, whether any is, whose gain "
        "is then stated; empty: no cause",
        default=None,
    )  # fmt: skip
    error_unit: str = column(
        "the unit by which the model is judged: mm, or where no lengths were measured mrad, px, …", default="mm"
    )
    gain_mean: float = column("as gain_mean_mm, in `error_unit` where that is another", default=NAN)
    gain_low: float = column("as gain_low_mm, likewise", default=NAN)
    gain_high: float = column("as gain_high_mm, likewise", default=NAN)
    heldout_mean: float = column("as heldout_mean_mm, likewise", default=NAN)
    family_probability: float = column(
        "posterior probability of this cause or another of its family at its joint (any kind of lost motion); empty: no family",
        default=NAN,
    )
    low: float = column("lower end of the size's 95 % interval, whichever form of the cause is true", UNIT, default=NAN)
    high: float = column("upper end of it", UNIT, default=NAN)

    def __post_init__(self) -> None:
        """Check that each rival has a cause and a joint."""
        if len(self.rival_causes) != len(self.rival_joints):
            raise ValueError("rival_causes and rival_joints are not equally long")

    @staticmethod
    def of_rivals(rivals: Sequence[NamedCause]) -> dict[str, Any]:
        labels, causes = tuple(rival.label for rival in rivals), tuple(rival.cause for rival in rivals)
        return {"rival_labels": labels, "rival_causes": causes, "rival_joints": tuple(rival.joint for rival in rivals)}

    @property
    def rivals(self) -> tuple[NamedCause, ...]:
        """Causes that could explain the data instead, or that unexplained structure may be."""
        return tuple(map(NamedCause, self.rival_causes, self.rival_joints))

    @property
    def is_cause(self) -> bool:
        """Whether it is a cause, or one of several, not a data fault or unexplained structure."""
        return self.status in ("named", "one_of")

    @property
    def is_suspicion(self) -> bool:
        """Whether it is a cause that is not in the model to be used."""
        return self.deployed is False

    @property
    def is_misfit(self) -> bool:
        """Whether it is a lack of fit as such, reported whether an input explains it or not."""
        return self.status == "unexplained" and not self.inputs

    @property
    def is_structure(self) -> bool:
        """Whether it is unexplained structure, which depends on an input."""
        return self.status == "unexplained" and bool(self.inputs)

    @property
    def gain(self) -> tuple[float, float, float]:
        """Reduction of the mean error at held-out poses, and the ends of its 95 % interval [error_unit]; nan: not known."""
        if self.error_unit == METRE.label:
            return self.gain_mean_mm, self.gain_low_mm, self.gain_high_mm
        return self.gain_mean, self.gain_low, self.gain_high

    @property
    def of_family(self) -> bool:
        """Whether its family is certain but not the member: an error of one joint's angle, say, whose order is not resolved."""
        return self._is_form and self.status == "one_of" and (bool(self.kin) or not self.rivals)

    @property
    def _is_form(self) -> bool:
        """Whether the members of its family are forms of it: all curves of an input, or several that were found."""
        return cause_family(self.cause) in SMOOTH_IN or len(self.numbers) > 1

    @property
    def kin(self) -> tuple[str, ...]:
        """Ids of its family, at its joint, that the data do not distinguish from it."""
        family = cause_family(self.cause)
        near = [rival.cause for rival in self.rivals if self._is_kin(rival)]
        elsewhere = {rival.cause for rival in self.rivals}
        more = [name for name in self.cannot_tell_from if name not in elsewhere and cause_family(name) == family]
        return tuple(dict.fromkeys([*near, *more])) if self._is_form else ()

    @property
    def others(self) -> tuple[NamedCause, ...]:
        """The rivals outside its family, an unnamed error last."""
        rivals = [rival for rival in self.rivals if not self._is_kin(rival)]
        return tuple(sorted(rivals, key=lambda rival: rival.cause == UNEXPLAINED))

    def _is_kin(self, rival: NamedCause) -> bool:
        return self._is_form and NamedCause(self.cause, self.joint or 0).covers(rival)

    @property
    def name(self) -> str:
        """Its name with its place, as far as it is certain."""
        if self.of_family:
            return _family_name(NamedCause(self.cause, self.joint or 0))
        return cause_name(self.cause, self.joint)

    @property
    def name_probability(self) -> float:
        """The probability of its name."""
        return self.family_probability if self.of_family else self.probability

    @property
    def is_in_part(self) -> bool:
        """Whether its family is certain, and others are rivals of a part of it alone: of some of the causes that it holds."""
        return self.of_family and len(self.numbers) > 1 and self.family_probability > SURE and bool(self.others)

    @property
    def names(self) -> str:
        """Its name with its detail, and the names of the rivals that the data do not exclude."""
        if self.is_in_part:
            return f"{self.name} (a part of it may be {_one_of([rival.name for rival in self.others], 2)})"
        name = f"{self.name} ({self.form})" if self.form else self.name
        more = [cause_name(UNEXPLAINED)] if self.may_be_unexplained else []
        return _one_of([name, *(rival.name for rival in self.others), *more])

    @property
    def form(self) -> str:
        """Its variant in words; of a family whose member is not certain when it happened, if the best one says that."""
        if not self.of_family:
            return self.detail
        kind = effect_class(self.cause)
        dated = kind and kind.dated and self.detail
        return f"best described as {cause_words(self.cause).name} {self.detail}" if dated else ""

    @property
    def may_be_unexplained(self) -> bool:
        """Whether an error that no cause explains depends on the same input, and may be all of it, which has no probability."""
        return UNEXPLAINED in self.cannot_tell_from and UNEXPLAINED not in self.rival_causes

    @property
    def amount(self) -> str:
        """Its size with its standard deviation, or its interval where that would include zero, in a unit that is easy to read."""
        if abs(self.estimate) < CERTAIN * self.sd and self.low * self.high > 0:
            return amount_between(self.cause, self.low, self.high, self.unit)
        return amount(self.cause, self.estimate, self.sd, self.unit)

    @property
    def in_short(self) -> str:
        """The finding in a line: a cause with its size, unexplained structure with its inputs, else the statement."""
        if self.is_cause:
            return f"{self.names}, {self.amount}"
        if self.is_structure:
            suspected = f" (suspected: {self.suspects})" if self.suspects else ""
            return f"something unexplained that depends on {self.inputs_in_words}{suspected}"
        return self.statement

    @property
    def unrepeated(self) -> str:
        """The joint that does not repeat, or those of which one does not; empty for other findings."""
        joints = " or ".join(name[1:] for name in self.inputs[1:])
        return f"joint {joints}" if joints and self.inputs[0] == POSE else ""

    @property
    def suspects(self) -> str:
        """The causes that unexplained structure may be, in words, by families; empty where none is suspected."""
        names = list(dict.fromkeys(_family_name(rival) or rival.name for rival in self.rivals))
        return _one_of(names, 2) if self.is_structure else ""

    @property
    def of_angles(self) -> bool:
        return len(self._joints(ITS_ANGLE)) == len(self.inputs)

    def may_be_curve(self, cause: str) -> bool:
        """Whether structure depends on an input of which a cause's family has all curves."""
        curves = SMOOTH_IN.get(cause_family(cause), ())
        return any(name in curves or name.rstrip("0123456789") in curves for name in self.inputs)

    def _joints(self, of: str) -> list[str]:
        return [number for name in self.inputs if (number := name.removeprefix(of)).isdigit() and number != name]

    @property
    def inputs_in_words(self) -> str:
        if self.of_angles:
            joints = self._joints(ITS_ANGLE)
            return f"the {'angle of joint' if len(joints) == 1 else 'angles of joints'} {listed(joints)}"
        if loaded := self._joints(ITS_TORQUE):
            return f"the load of joint {listed(loaded)}"
        if self.unrepeated:
            return f"where {self.unrepeated} comes to rest each time"
        if self.inputs[0] in INPUTS_IN_WORDS:
            return INPUTS_IN_WORDS[self.inputs[0]]
        if set(self.inputs) >= PLACE:
            return "the tool's place (x, y and z)"
        detail = f" ({self.detail})" if self.detail else ""
        if "payload" in self.inputs:
            return f"the payload{detail}"
        return f"the time of measurement{detail}" if "order" in self.inputs else f"the time{detail}"


def _one_of(names: Sequence[str], most: int = 3) -> str:
    return " or ".join(names[:most]) + (" or another cause" if len(names) > most else "")


def _family_name(cause: NamedCause) -> str:
    family = cause_family(cause.cause)
    return f"{family} of joint {cause.joint}" if family and cause.joint else family


def findings(
    diagnosis: Diagnosis,
    calibrated: CalibratedModel,
    data: Measurements,
    faults: pd.DataFrame,
    rng: np.random.Generator,
) -> tuple[Finding, ...]:
    """Return the findings: data faults, causes, growth of the noise, lack of fit and unexplained structure.

    Gains count against the identified model, calibrated. While a mistake of the user is unsettled, residuals reveal no more than
    that, and the faults are the only findings.
    """
    heldout, final = data.only(data.held_out), diagnosis.extended
    rows = [_fault(group) for _, group in faults.groupby(["cause", "joint", "action", "statement"], sort=False)]
    if (faults["action"] == "unsettled").any():
        return tuple(rows)
    fits = [(calibrated.model, calibrated.estimate), *((fit.model, fit.estimate) for fit in diagnosis.path)]
    steps = [errors(model, estimate, heldout) for model, estimate in fits]
    for (model, _), error in zip(fits, steps, strict=True):
        error[model.undecided(data)[data.held_out]] = np.nan
    n = diagnosis.n_deployed
    for members in _kept_together(diagnosis.causes):
        causes = [
            _cause(verdict, final, left_along(verdict.cause, final.model, diagnosis.left), k + 1, k < n)
            for k, verdict in ((k, diagnosis.verdicts[k]) for k in members)
        ]
        row = causes[0] if len(causes) == 1 else _together(causes, [diagnosis.verdicts[k] for k in members])
        before = steps[members[0]]
        used = [k for k in members if k < n] or members  # members of one family may be deployed and suspected
        after = before + sum(steps[k + 1] - steps[k] for k in used)
        rows.append(_gained(row, before, after, heldout, rng))
    if diagnosis.capped and diagnosis.verdicts:
        more = f"; with it as many causes were found as were allowed ({len(diagnosis.verdicts)}): there may be more"
        rows[-1] = replace(rows[-1], statement=rows[-1].statement + more)
    if diagnosis.growth:
        rows.append(_growth(diagnosis.growth))
    if final.lacks_fit:
        rows.append(_misfit(final.lack, diagnosis.worst, diagnosis.left))
    for structure in diagnosis.left:
        after = steps[-1] + predicted(final, structure.functions, heldout)
        rows.append(_gained(_left(structure), steps[-1], after, heldout, rng))
    return tuple(rows)


def _gained(
    row: Finding, before: np.ndarray, after: np.ndarray, heldout: Measurements, rng: np.random.Generator
) -> Finding:
    left = float(np.nanmean(distances(after))) if len(after) else NAN
    unit = judged_unit(leading_units(heldout))
    mean, low, high = gain(before, after, heldout, rng)
    figures = {"gain_mean": mean, "gain_low": low, "gain_high": high, "heldout_mean": left}
    suffix = "_mm" if unit == METRE else ""
    shown = {f"{name}{suffix}": unit.shown(figure) for name, figure in figures.items()}
    return replace(row, error_unit=unit.label, **shown)


def _kept_together(causes: Sequence[Cause]) -> list[list[int]]:
    """Return the causes' indices in the order found, those of one family at one place grouped."""
    groups: dict[object, list[int]] = {}
    for k, cause in enumerate(causes):
        groups.setdefault((cause.family, cause.joint) if cause.family in FORMS_OF_ONE else k, []).append(k)
    return list(groups.values())


def _together(rows: Sequence[Finding], verdicts: Sequence[Verdict]) -> Finding:
    """Return one finding for several causes of a family at one place, described by the one in use that explains most."""
    order = sorted(range(len(rows)), key=lambda k: (not rows[k].deployed, verdicts[k].own.cost))
    lead, causes = rows[order[0]], [verdicts[k].cause for k in order]
    own, *kin = map(named, causes)
    others = [named(rival) for verdict in verdicts for rival in verdict.others]
    rivals = [*(other for other in kin if other != own), *(rival for rival in others if not own.covers(rival))]
    kin_ids = (cause.id for cause in causes)
    alike = dict.fromkeys([*(name for row in rows for name in row.cannot_tell_from), *_relatives(causes[0]), *kin_ids])
    # A curve's root mean square and an amplitude at the rated torque are different quantities.
    measured = cause_words(lead.cause).size
    same = [row for row in rows if (row.unit, cause_words(row.cause).size) == (lead.unit, measured)]
    size = float(np.sqrt(sum(row.estimate**2 for row in same)))
    sd = float(np.sqrt(sum((row.estimate * row.sd) ** 2 for row in same))) / size
    whole = Amplitude.of_squares(size, sd)
    names = [f"{cause.title} ({cause.detail})" if cause.detail else cause.title for cause in causes]
    left_out = [name for k, name in zip(order, names, strict=True) if lead.deployed and not rows[k].deployed]
    doubts = f"; suspected, and left out of the model: {' and '.join(left_out)}" if left_out else ""
    carried = [row.carries_over for row in rows]
    return replace(
        lead, status="one_of", estimate=size, sd=sd, low=whole.low, high=whole.high, p_family=min(row.p_family for row in rows),
        probability=min(row.probability for row in rows),
        family_probability=max(row.family_probability for row in rows),
        cannot_tell_from=tuple(name for name in alike if name != lead.cause),
        detail=f"{lead.detail or causes[0].title}, with {names[1] if len(names) == 2 else f'{len(names) - 1} more'}",
        statement=f"{causes[0].effect.family}{_where(causes[0])}: {', and '.join(names)}{doubts}",
        **Finding.of_rivals([*dict.fromkeys(rivals)]),
        not_tested=tuple(dict.fromkeys(name for row in rows for name in row.not_tested)),
        carries_over=False if False in carried else None if None in carried else True,
        numbers=tuple(number for row in rows for number in row.numbers),
    )  # fmt: skip


def _cause(verdict: Verdict, fitted: Fitted, left: UnexplainedStructure | None, number: int, deployed: bool) -> Finding:
    """Return the finding of one cause; left is unexplained structure along the same input, which makes its name uncertain."""
    cause, carries_over = verdict.cause, verdict.carries_over
    own = fitted.model.columns(cause)
    curve = Curve.of(cause, fitted.fit.estimate[own], fitted.fit.covariance[np.ix_(own, own)])
    size = Amplitude.of_squares(*curve.rms_over_travel) if curve else found_amplitude(verdict, fitted)
    others = list(dict.fromkeys(rival.id for rival in verdict.others))
    if left:
        same = _relatives(cause) if is_of_its_curve(left, cause) else [UNEXPLAINED]
        others += [name for name in same if name not in others]
    doubts = (NOT_CARRIED if carries_over is False else "") + ("" if deployed else NOT_DEPLOYED)
    return Finding(
        status="one_of" if others else verdict.status, cause=cause.id, joint=cause.joint or None, estimate=size.estimate,
        sd=size.sd if size.sd > 0 else NAN, low=size.low, high=size.high, unit=cause.declared[0].unit,
        p_family=verdict.p, probability=verdict.of_effect,
        family_probability=verdict.of_family if cause.family else NAN,
        cannot_tell_from=tuple(others), detail=_detail(verdict),
        **Finding.of_rivals([named(rival) for rival in verdict.others]),
        statement=_statement(verdict, left) + doubts, deployed=deployed,
        not_tested=tuple(dict.fromkeys(rival.id for rival in verdict.others if rival.score is None)),
        carries_over=carries_over, numbers=(number,),
    )  # fmt: skip


def _detail(verdict: Verdict) -> str:
    """Return the variant in words, with other parts at the same joint where the effect explains the data as well."""
    cause = verdict.cause
    elsewhere = [rival.cause.part for rival in verdict.rivals if rival not in verdict.others and rival.cause]
    return " or ".join([cause.detail or cause.part, *dict.fromkeys(elsewhere)]) if elsewhere else cause.detail


def _statement(verdict: Verdict, left: UnexplainedStructure | None) -> str:
    cause, where = verdict.cause, _where(verdict.cause)
    detail = f" ({_detail(verdict)})" if _detail(verdict) else ""
    if left and is_of_its_curve(left, cause):
        return f"{cause.effect.family}{where}: form not resolved, more is left than {cause.title}{detail} explains"
    if left:
        return f"{cause.title}{where}{detail}, or what stays unexplained ({' and '.join(left.inputs)})"
    if verdict.among_kin and cause.effect.named_in():
        return f"{cause.family}{where}: form not resolved, best {cause.title}{detail}"
    if verdict.others:
        return f"{cause.title}{where}{detail}, or {', or '.join(map(_told, verdict.others))}"
    return f"{cause.title}{where}{detail}"


def _told(rival: Rival) -> str:
    """Return the name of a rival, with what a test would take if it could not be tested."""
    return f"{named(rival).name} (not tested: needs {rival.needs})" if rival.needs else named(rival).name


def _where(cause: Cause) -> str:
    return f" of {cause.effect.place_word} {cause.joint}" if cause.joint else ""


def _relatives(cause: Cause) -> list[str]:
    """Return the other members of a cause's family, if that is one of general curves of an input."""
    kinds = catalogue().items() if cause.effect.named_in() else ()
    return [name for name, kind in kinds if kind.family == cause.family and name != cause.id]


def _growth(grown: Growth) -> Finding:
    kind = next(kind for kind in catalogue().values() if kind.grows_with == RANGE)
    return Finding(
        status="named", cause=kind.id, estimate=grown.slope, sd=grown.sd, unit="m/m", p_family=grown.p,
        probability=1 - grown.p, statement=f"{kind.title}: {rounded(1e6 * grown.floor)} µm and {rounded(1e6 * grown.slope)} µm/m",
    )  # fmt: skip


def _misfit(lack: LackOfFit, worst: MisfitRegion | None, left: tuple[UnexplainedStructure, ...]) -> Finding:
    why = (
        "an input explains only a part of it"
        if left
        else "no cause that could be tested and no single input explains it"
    )
    where = f"; {worst.words}" if worst else "" if left else "; about the same everywhere"
    times = f"{np.sqrt(lack.reduced_chi2):.2f} times the noise (chance of so much: {chance(lack.p)})"
    statement = f"the model leaves {times}; {why}{where}"
    return Finding(status="unexplained", p_family=lack.p, detail=worst.where if worst else "", statement=statement)


def _left(structure: UnexplainedStructure) -> Finding:
    inputs, detail = " and ".join(structure.inputs), structure.detail
    rivals = list(dict.fromkeys(map(named, structure.suspects)))
    likely = f" (suspected: {', or '.join(rival.name for rival in rivals)})" if rivals else ""
    along = f"{inputs} ({detail})" if detail else inputs
    statement = f"depends on {along}; no cause that could be tested explains it for certain{likely}"
    if structure.inputs == (POSE,):
        statement = (
            "the rows of a pose share an error that changes from pose to pose, more than their own scatter explains"
        )
    left = Finding(status="unexplained", p_family=structure.p, detail=detail, statement=statement, inputs=structure.inputs,
                   **Finding.of_rivals(rivals))  # fmt: skip
    told = f"{left.unrepeated} {RESTS}: by {detail}; no input explains it"
    return replace(left, statement=told) if left.unrepeated else left


def _fault(group: pd.DataFrame) -> Finding:
    first, lines = group.iloc[0], tuple(group["line"].dropna().astype(int))
    return Finding(
        status="data_fault",
        cause=first["cause"],
        joint=first["joint"] or None,
        rows=lines,
        statement=first["statement"],
    )
