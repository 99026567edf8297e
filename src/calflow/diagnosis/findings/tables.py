"""The tables of a diagnosis: findings, best first, and every candidate that was tested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calflow.diagnosis.findings.amplitude import amplitude, found_amplitude
from calflow.diagnosis.findings.gain import gain
from calflow.diagnosis.findings.gaussian_process import predicted
from calflow.diagnosis.findings.remainder import Remainder
from calflow.diagnosis.findings.verdict import Verdict, label
from calflow.diagnosis.screening.detection_limit import detection_limit
from calflow.diagnosis.screening.screening import Score, by_place
from calflow.diagnosis.search.extension import Extended
from calflow.diagnosis.search.fitted import Fitted
from calflow.diagnosis.search.noise_growth import RANGE, Growth
from calflow.effects import Effect, catalogue
from calflow.effects.cause import Cause
from calflow.estimation.accuracy import distances, errors
from calflow.measurements.measurements import Measurements

FINDINGS = [
    "status", "cause", "joint", "estimate", "sd", "unit", "p_family", "probability", "cannot_tell_from", "gain_mean_mm",
    "gain_low_mm", "gain_high_mm", "heldout_mean_mm", "detail", "rivals", "rows", "statement",
]  # fmt: skip
CANDIDATES = [
    "cause", "joint", "statistic", "p_family", "delta_bic", "probability", "visible_share", "estimate", "sd", "unit",
    "limit", "tests", "part", "detail", "note",
]  # fmt: skip

UNEXPLAINED = "unexplained"  # what a cause is not told from where something without a name depends on the same input
IN_TIME = {"time", "order"}  # the inputs that causes of the measuring device depend on


@dataclass(frozen=True)
class Diagnosis:
    """All that was found: the model to start from, its extension, a verdict a finding, and what is left.

    growth is the noise's with range where there is one; lacking says by id why an effect was not tested; false_alarm is what
    causes were allowed.
    """

    start: Fitted
    extended: Extended
    verdicts: tuple[Verdict, ...]
    left: tuple[Remainder, ...]
    growth: Growth | None
    lacking: Mapping[str, str]
    false_alarm: float

    @property
    def causes(self) -> list[Cause]:
        """The causes found, in the order of the findings."""
        return [verdict.finding.cause for verdict in self.verdicts]


def findings_table(
    found: Diagnosis, data: Measurements, faults: pd.DataFrame, rng: np.random.Generator
) -> pd.DataFrame:
    """Return diagnose/findings.csv: data faults, causes, the noise's growth and what nobody can name."""
    heldout, final = data.only(data.held_out), found.extended.fitted
    rows = [_fault(cause, joint, group) for (cause, joint), group in faults.groupby(["cause", "joint"], sort=False)]
    before = errors(found.start.model, found.start.fit.estimate, heldout)
    for verdict, fitted in zip(found.verdicts, found.extended.path, strict=True):
        after = errors(fitted.model, fitted.fit.estimate, heldout)
        rows.append(_cause(verdict, final, _overlapping(verdict, found.left)) | _gained(before, after, heldout, rng))
        before = after
    if found.growth:
        rows.append(_growth(found.growth))
    for remainder in found.left:
        after = before + predicted(final, remainder.score.cause, heldout)
        rows.append(_left(remainder) | _gained(before, after, heldout, rng))
    return pd.DataFrame(rows, columns=FINDINGS)


def _gained(
    before: np.ndarray, after: np.ndarray, heldout: Measurements, rng: np.random.Generator
) -> dict[str, object]:
    gained = gain(before, after, heldout, rng)
    mean = float(distances(after).mean()) if len(after) else np.nan
    return {"gain_mean_mm": 1e3 * gained.mean, "gain_low_mm": 1e3 * gained.low, "gain_high_mm": 1e3 * gained.high,
            "heldout_mean_mm": 1e3 * mean}  # fmt: skip


def candidates_table(found: Diagnosis) -> pd.DataFrame:
    """Return diagnose/candidates.csv: every place in its best variant, as first tested, and what could not be tested."""
    first = found.extended.first
    places = by_place(first.scores)
    least = min((bic for bic, _ in places.values()), default=0.0)
    weights = {place: np.exp(-(bic - least) / 2) for place, (bic, _) in places.items()}
    total = sum(weights.values()) + np.exp(least / 2)  # nothing at all is a candidate too
    rows = []
    for place, (bic, score) in sorted(places.items(), key=lambda item: item[1][0]):
        rows.append(
            _score(score)
            | {
                "p_family": first.family.p(score),
                "delta_bic": bic,
                "probability": weights[place] / total,
                "limit": detection_limit(score, first.family, found.false_alarm),
                "tests": first.family.tests(score),
            }
        )
    for cause in first.hidden:
        rows.append({"cause": cause.id, "joint": cause.joint or None, "part": cause.part,
                     "note": "not testable: these data cannot show it, the model's own parameters imitate it"})  # fmt: skip
    rows += [
        _noise(kind, found.growth)
        for name, kind in catalogue().items()
        if kind.is_noise() and name not in found.lacking
    ]
    rows += [{"cause": name, "note": f"not testable: needs {what}"} for name, what in found.lacking.items()]
    return pd.DataFrame(rows, columns=CANDIDATES).astype({"joint": "Int64"})


def _noise(kind: type[Effect], grown: Growth | None) -> dict[str, object]:
    """One model of the noise: growth with range is what is tested."""
    if kind.grows_with != RANGE:
        return {"cause": kind.id, "note": f"not testable: only noise that grows with {RANGE} is looked for"}
    if grown is None:
        return {"cause": kind.id, "note": f"tested on the size of what is left: it does not grow with {RANGE}"}
    return {"cause": kind.id, "p_family": grown.p, "estimate": grown.slope, "sd": grown.sd, "unit": "m/m"}


def _score(score: Score) -> dict[str, object]:
    estimate, sd = amplitude(score.cause, score.estimate, score.covariance)
    return {
        "cause": score.cause.id, "joint": score.cause.joint or None, "statistic": score.drop,
        "visible_share": score.visible_share, "estimate": estimate, "sd": sd, "unit": score.cause.declared[0].unit,
        "part": score.cause.part, "detail": score.cause.detail, "note": "",
    }  # fmt: skip


def _cause(verdict: Verdict, fitted: Fitted, left: Remainder | None) -> dict[str, object]:
    """One finding's row; left is what nobody can name along the same input, which makes a certain name uncertain."""
    cause = verdict.finding.cause
    estimate, sd = found_amplitude(verdict.finding, fitted)
    others = list(
        dict.fromkeys(rival.id for rival in verdict.rivals if rival.id != cause.id or rival.joint != cause.joint)
    )
    if left:
        others += [name for name in _relatives(cause) or [UNEXPLAINED] if name not in others]
    status = "one_of" if others else verdict.status
    return {
        "status": status, "cause": cause.id, "joint": cause.joint or None, "estimate": estimate,
        "sd": sd if sd > 0 else np.nan, "unit": cause.declared[0].unit, "p_family": verdict.finding.p,
        "probability": verdict.probability, "cannot_tell_from": ";".join(others), "detail": cause.detail,
        "rivals": "; ".join(label(rival.id, rival.joint) for rival in verdict.rivals), "rows": "",
        "statement": _statement(verdict, left),
    }  # fmt: skip


def _statement(verdict: Verdict, left: Remainder | None) -> str:
    cause = verdict.finding.cause
    where = f", {_place(cause)}" if cause.joint else ""
    detail = f" ({cause.detail})" if cause.detail else ""
    if left and cause.effect.family:
        return (
            f"{cause.effect.family}{where}: order not resolved, more of it is left than {cause.title}{detail} explains"
        )
    if left:
        return f"{cause.title}{where}{detail}, or what stays unexplained ({' and '.join(left.inputs)})"
    if verdict.family:
        return f"{verdict.family}{where}: order not resolved, best {cause.title}{detail}"
    if verdict.rivals:
        return (
            f"{cause.title}{where}{detail}, or {', or '.join(label(rival.id, rival.joint) for rival in verdict.rivals)}"
        )
    return f"{cause.title}{where}{detail}"


def _place(cause: Cause) -> str:
    return f"{cause.effect.place_word} {cause.joint}" if cause.joint else ""


def _overlapping(verdict: Verdict, left: tuple[Remainder, ...]) -> Remainder | None:
    """What is left along the input that a cause depends on: its joint, or the course of the measurement."""
    cause = verdict.finding.cause
    own = {f"q{cause.joint}"} if cause.joint else IN_TIME if cause.effect.of_device() else set()
    return next((remainder for remainder in left if own & set(remainder.inputs)), None)


def _relatives(cause: Cause) -> list[str]:
    """The other members of a cause's family, if it has one."""
    family = cause.effect.family
    return [name for name, kind in catalogue().items() if family and kind.family == family and name != cause.id]


def _growth(grown: Growth) -> dict[str, object]:
    kind = next(kind for kind in catalogue().values() if kind.grows_with == RANGE)
    return {
        "status": "named", "cause": kind.id, "estimate": grown.slope, "sd": grown.sd, "unit": "m/m",
        "p_family": grown.p, "probability": 1 - grown.p, "cannot_tell_from": "", "rivals": "", "rows": "",
        "statement": f"{kind.title}: {1e6 * grown.floor:.3g} um and {1e6 * grown.slope:.3g} um/m",
    }  # fmt: skip


def _left(remainder: Remainder) -> dict[str, object]:
    inputs = " and ".join(remainder.inputs)
    detail = remainder.score.cause.detail
    return {
        "status": "unexplained", "cause": "", "p_family": remainder.p, "cannot_tell_from": "", "detail": detail,
        "rivals": "", "rows": "",
        "statement": f"depends on {inputs}{f' ({detail})' if detail else ''}; no cause of the catalogue explains it",
    }  # fmt: skip


def _fault(cause: object, joint: object, group: pd.DataFrame) -> dict[str, object]:
    lines = group["line"].dropna().astype(int)
    return {
        "status": "data_fault", "cause": cause, "joint": joint or None, "cannot_tell_from": "", "rivals": "", "detail": "",
        "rows": ";".join(map(str, lines)), "statement": group["statement"].iloc[0],
    }  # fmt: skip
