"""Eight to twenty poses: whether the error promised at new poses holds, and what is named.

    python benchmarks/few_poses.py --cases 200

Arms of foreign_physics.py with one or three markers; in half of the cases a form of foreign_forms.py acts at 3 limits (of as many
poses, see other_forms.py), or at less where it would move the tool by more than ten times the noise. None, or three in ten poses
are held out. New poses are taken between the measured ones, within the time that these take. What is promised is the distribution
of the root mean square error at 300 new poses, without the device's noise: by draws of the parameters from their covariance, and
what the standard deviations of predictions hold besides, alike everywhere. The true one is to lie in its middle 95 % (within;
below: not above it). Page one states a limit besides, which the true one is to be within in 95 of 100 cases (within_limit), and
is the better the lower it is (limit over found, the median). It is the robot's error: where a hidden form is the device's, points
are where the arm without it has them. Refused are cases that identify says no to.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import kept_cases
import numpy as np
import pandas as pd
from foreign_forms import FORMS, Hidden, measured
from foreign_physics import ARMS, Array, Rows, background, likeness, measured_rows, points, worn
from foreign_study import identified, joint_of, names_of, predicted, rows_there, write_study
from kept_cases import Place, Row
from other_forms import World, judged, placed

import calflow as cf

NUMBERS = (8, 12, 15, 20)
NEW, DRAWS, LIMITS = 300, 400, 3.0
MIDDLE = (0.025, 0.975)
FIGURES = (
    "within",
    "below",
    "within_limit",
    "covered",
    "other_names",
    "promised_mm",
    "found_mm",
    "limit_mm",
    "nominal_mm",
)
FULL = {"no masses", "session"}  # what these cases do not have


def work(place: Place) -> list[Row]:
    """Draw a case of few poses: half of them hide something."""
    hiding = place.number % 2 == (place.number // 4) % 2
    return case(place, NUMBERS[place.number % len(NUMBERS)], LIMITS if hiding else 0.0)


def case(place: Place, number: int, limits: float, *, alike: bool = False, smooth: float = 0.0) -> list[Row]:
    """Draw a robot, calibrate it by so many poses, and hold what is promised of new ones against the truth.

    What is hidden is of so many times its detection limit; 0: nothing. alike: so is one of the causes that it may be called. smooth
    is a background's size over the noise.
    """
    rng, arm = place.rng, ARMS[list(ARMS)[place.number // 4 % len(ARMS)]]
    sigma = float(rng.uniform(3e-5, 5e-5) if arm.name == "large-6" else rng.uniform(1.5e-5, 3e-5))
    rows = measured_rows(arm, number + NEW, rng, markers=int(rng.choice([1, 3])))
    # The new ones in between: what moves once the last pose is measured, none tells (see elsewhere.py later).
    here = np.isin(rows.pose, np.round(np.linspace(0, number + NEW - 1, number)))
    rows = replace(rows, time=rows.time * number / (number + NEW))
    real, hidden = worn(arm, rng), tuple[Hidden, ...]()
    if limits:
        forms = [form for form in FORMS if arm.name in form.arms and not FULL & set(form.needs)]
        world = World(arm, real, rows.only(here), np.zeros(0), sigma * np.eye(here.sum()))
        first = forms[int(rng.integers(len(forms)))]
        others = [form for form in forms if form.cause in first.alike] if alike else []
        chosen = (first, *(others[int(k)] for k in rng.choice(len(others), min(len(others), 1), replace=False)))
        hidden = tuple(placed(form, world, limits, True, rng).hidden for form in chosen)
    left = background(likeness(arm, rows, rng.choice(arm.n, 3, replace=False)), smooth * sigma, rng) if smooth else 0.0
    h = hidden[0] if hidden else None
    seen = measured(real, rows, hidden) + left
    holdout = float(rng.choice([0.0, 0.3]))
    known: Row = {"arm": arm.name, "poses": number, "holdout": holdout,
                  "hidden": ";".join(f"{one.form.cause}:{one.joint}" for one in hidden), "smooth": smooth,
                  "form": h.form.name if h else "nothing", "limits": limits, "markers": int(rows.marker.max()) + 1}  # fmt: skip
    with tempfile.TemporaryDirectory() as apart:
        folder = place.folder or Path(apart) / "case"
        write_study(folder, arm, rows.only(here), seen[here] + sigma * rng.standard_normal((here.sum(), 3)), sigma=sigma,
                    columns={"approach", "travel", "time", "temperature"}, holdout=holdout)  # fmt: skip
        try:
            first = identified(folder)
            last = first.diagnose()
        except cf.InputError as error:
            return [known | {"stage": stage, "refused": str(error)} for stage in ("identify", "diagnose")]
    there = rows.only(~here)
    true = (measured(real, rows, tuple(one for one in hidden if one.form.kind != "device")) + left)[~here]
    nominal = np.sqrt(np.mean(((points(arm, there) - true) ** 2).sum(axis=1)))
    return [known | {"stage": stage, "refused": None, "nominal_mm": 1e3 * nominal} | _promise(calibration, there, true, rng)
            | _names(h, calibration, stage) for stage, calibration in (("identify", first), ("diagnose", last))]  # fmt: skip


def _promise(calibration: cf.Calibration, rows: Rows, true: Array, rng: np.random.Generator) -> Row:
    """The true root mean square error at new poses, and where it lies in the distribution that is promised."""
    at, data = predicted(calibration, rows, timed=True), rows_there(calibration, rows, timed=True)
    model = replace(calibration.model, given=data.given)
    slope = model.point_jacobian(calibration.estimate, data.conditions)
    told = np.einsum("nai,ij,naj->na", slope, calibration.covariance, slope)
    rest = np.maximum(at.sd**2 - told, 0).sum(axis=1).mean()
    deviations, directions = np.linalg.eigh(calibration.covariance)
    drawn = (
        slope
        @ directions
        @ (np.sqrt(np.maximum(deviations, 0))[:, None] * rng.standard_normal((len(deviations), DRAWS)))
    )
    promised = np.sqrt((drawn**2).sum(axis=1).mean(axis=0) + rest)
    found = np.sqrt(np.mean(((at.position - true) ** 2).sum(axis=1)))
    limit = calibration.fit_summary.new_poses_limit_mm
    low, high = np.quantile(promised, MIDDLE)
    return {
        "promised_mm": 1e3 * np.sqrt((at.sd**2).sum(axis=1).mean()), "found_mm": 1e3 * found,
        "limit_mm": limit, "within_limit": 1e3 * found <= limit, "within": low <= found <= high,
        "below": found <= high, "covered": float(np.mean(np.abs(at.position - true) < 1.959964 * at.sd)),
    }  # fmt: skip


def _names(h: Hidden | None, calibration: cf.Calibration, stage: str) -> Row:
    if stage == "identify":
        return {}
    names = names_of(calibration)
    told = judged(h, calibration.findings.table, names)
    suspected = sum(finding.is_suspicion for finding in calibration.findings)
    return {name: told[name] for name in ("in_set", "other_names", "certain_and_wrong", "unexplained")} | {
        "suspected": suspected,
        "names": ";".join(f"{row['cause']}:{joint_of(row)}" for _, row in names.iterrows()),
    }


def tell(rows: pd.DataFrame) -> str:
    """Coverage of the true error, false names and refusals, by poses, and with and without something hidden."""
    hidden = np.where(rows["form"] == "nothing", "nothing", "a form")
    rows = rows.reindex(columns=[*dict.fromkeys([*rows, *FIGURES])])
    rows = rows.assign(
        hidden_is=hidden, false_name=rows["other_names"].astype(float) > 0, said_no=rows["refused"].notna()
    )
    tables = [_table(rows, keys) for keys in (["stage"], ["stage", "hidden_is"], ["stage", "poses"], ["stage", "arm"])]
    said = rows.loc[rows["stage"] == "identify", "refused"].dropna().value_counts()
    return "\n\n".join([*tables, *([said.to_string()] if len(said) else [])])


def _table(rows: pd.DataFrame, keys: list[str]) -> str:
    def of(group: pd.DataFrame) -> pd.Series:
        done = group[~group["said_no"]]
        names = ("within", "below", "within_limit", "covered", "false_name")
        promise = np.sqrt((done["promised_mm"] ** 2).mean() / (done["found_mm"] ** 2).mean())
        shares = {name: done[name].astype(float).mean() for name in names}
        limit = (done["limit_mm"] / done["found_mm"]).median()
        sizes = {
            "promise": promise,
            "limit": limit,
            "found_mm": done["found_mm"].median(),
            "nominal_mm": done["nominal_mm"].median(),
        }
        return pd.Series({"n": len(group), "refused": group["said_no"].mean()} | shares | sizes)

    return rows.groupby(keys).apply(of, include_groups=False).round(3).to_string()


if __name__ == "__main__":
    kept_cases.run_cases(__doc__, {"few": (work, tell)})
