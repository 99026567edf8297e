"""What the findings of a blind case say, against what was hidden in it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
from blind_cases import begun

from calflow.diagnosis.extension import FittedTrial
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.screening import Family, Screening
from calflow.diagnosis.trial import Screened
from calflow.estimation.accuracy import errors
from calflow.estimation.model_tables import calibrated
from calflow.files.tables import Results
from calflow.measurements.measurements import Measurements
from calflow.model import Model
from calflow.study import Study
from hidden.causes import Hidden

FAMILY = {"joint-eccentricity", "periodic-joint-error", "gear-transmission-error", "joint-error-map"}
CLASSES = (  # names that count as right up to their class
    FAMILY,
    {"base-compliance", "bearing-compliance"},
    {"joint-backlash", "joint-hysteresis"},
    {"link-torsion", "bearing-compliance"},
    {"gear-ratio-error", "joint-eccentricity"},
    {"payload-mass", "link-mass"},
    {"gravity-compensator", "joint-eccentricity"},
    {"link-bending", "joint-compliance", "nonlinear-joint-stiffness"},
)
# What another form of physics may be called (hidden/forms.py): names, and their joints from the hidden one's; no joint: any.
FORM_CLASSES: dict[str, dict[str, tuple[int, ...]]] = {
    # A bracket beyond the flange: a tool that gives way under the payload, or with one payload alone under its own weight; the
    # last bearing and the last link, as a beam, turn the flange under the same moment.
    "cantilever-bracket": {"tool-deflection": (), "tool-sag": (), "bearing-compliance": (0,), "link-bending": (0,)},
    # The torque is a function of joint 2's angle alone, and so is, by the joint's linear spring, its error: a compensator in
    # another form, or the family of errors of an angle. Its gear ratio is none: the torque is no straight line.
    "spring-compensator": {"gravity-compensator": (0,), "joint-eccentricity": (0,), "periodic-joint-error": (0,),
                           "joint-error-map": (0,)},
    # A crooked beam twists as it bends; its end turns the next joint under that joint's own moment, as a bearing does there,
    # and its foot, where most of the bending is, turns as the bearing that it begins at.
    "oblique-beam": {"link-bending": (0,), "link-torsion": (0,), "bearing-compliance": (0, 1)},
    # A bearing whose tilt also shifts: the twist of the link that it carries is declared its like (CLASSES), and the beam
    # before it, which turns the bearing under the same moment about a place that lies beside the joint; so does a beam after.
    "offset-bearing": {"bearing-compliance": (0,), "link-torsion": (0, -1), "link-bending": (0, -1)},
    # One link's growth is what thermal growth is, of all links, of one, or of the housings at its ends; the growth of the upright
    # first link (and of no other) lifts all that the device sees, as a device that wanders.
    "warm-link": {"thermal-growth": (), "housing-growth": (0, 1), "frame-drift": (-1,)},
}  # fmt: skip
SAME_FIGURE = {"joint-backlash", "torque-backlash", "joint-eccentricity", "gear-transmission-error", "gear-ratio-error",
               "wrist-coupling", "link-bending", "link-torsion", "base-compliance", "payload-mass", "link-mass",
               "payload-com", "thermal-growth", "frame-step"}  # fmt: skip


def told(results: Results) -> dict[str, object]:
    """Count what was found."""
    found = results.tables["diagnose/findings.csv"]
    causes = named_causes(results)
    noise = found["cause"] == "range-noise"
    return {
        "found": len(causes),
        "names": " + ".join(f"{c}:{int(j)}" for c, j in zip(causes["cause"], causes["joint"], strict=True)),
        "status": causes["status"].iloc[0] if len(causes) else "",
        "unexplained": int((found["status"] == "unexplained").sum()),
        "faults": int((found["status"] == "data_fault").sum()),
        "range_noise": int(noise.sum()),
    }


def one(h: Hidden, results: Results) -> dict[str, object]:
    """Compare the first finding with the one cause that is hidden."""
    causes = named_causes(results)
    if not len(causes):
        return {"detected": False}
    first = causes.iloc[0]
    return {
        "detected": True, "right": is_exactly(h, first), "up_to_class": is_alike(h, first),
        "in_set": any(holds(h, row) for _, row in causes.iterrows()),
        "set_size": 1 + len([x for x in first["cannot_tell_from"].split(";") if x]),
        "probability": first["probability"],
    } | off_by(h, first)  # fmt: skip


def several(hidden: tuple[Hidden, ...], results: Results) -> dict[str, object]:
    """Say whether every hidden cause is among the findings."""
    rows = [row for _, row in named_causes(results).iterrows()]
    return {
        "right": all(any(is_exactly(h, row) for row in rows) for h in hidden),
        "up_to_class": all(any(is_alike(h, row) for row in rows) for h in hidden),
        "more": len(rows) - len(hidden),
    }


def gains(study: Study, h: Hidden, results: Results) -> dict[str, float]:
    """Return the held-out mean error [mm] before, with what was found, and with the true cause fitted to the same rows."""
    data = study.measurements()
    truth = true_structure(study, h, results)
    return held_out(study, results) | {"truth_mm": _mean(truth.model, truth.fit.estimate, data.only(data.held_out))}


def true_structure(study: Study, h: Hidden, results: Results) -> Fitted:
    """Fit the identified model with the hidden cause, in the form of it that suits the training rows best."""
    start, catalogue = begun(study, results)
    effects = [effect for effect in catalogue.effects if effect.id == h.cause]
    first = Screening.of(start.regressors(effects))
    screened = Screened(tuple(first.scores), Family({}, 1.0), first.degrees_of_freedom)
    trial = FittedTrial(screened, start, catalogue)
    listed = next(score for score in first.scores if score.cause.joint == h.joint)
    best = trial.finest(listed)
    point = np.concatenate([start.fit.estimate, best.estimate])
    return start.with_causes([best.cause], point, best.share)


def held_out(study: Study, results: Results) -> dict[str, float]:
    """Return the held-out mean error [mm] of the identified and of the extended model."""
    data = study.measurements()
    held = data.only(data.held_out)
    base, best = (
        calibrated(study.robot, results.of({"identify"}), data.given),
        calibrated(study.robot, results, data.given),
    )
    return {"before_mm": _mean(base.model, base.estimate, held), "after_mm": _mean(best.model, best.estimate, held)}


def effect_rms(folder: Path) -> float:
    """How far what is hidden moves the points, rms over rows of the largest cause [mm]."""
    answer = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
    return max((cause.get("rms_mm", 0.0) for cause in answer["causes"]), default=0.0)


def _mean(model: Model, estimate: np.ndarray, held: Measurements) -> float:
    return float(1e3 * np.linalg.norm(errors(model, estimate, held), axis=1).mean())


def named_causes(results: Results) -> pd.DataFrame:
    """Return the findings that name a cause or several, noise that grows apart."""
    found = results.tables["diagnose/findings.csv"].fillna(
        {"cannot_tell_from": "", "rivals": "", "joint": 0, "cause": ""}
    )
    return found[found["status"].isin(["named", "one_of"]) & (found["cause"] != "range-noise")]


def is_exactly(h: Hidden, row: pd.Series) -> bool:
    """Whether a finding names the cause and its joint."""
    return bool(row["cause"] == h.cause and (row["joint"] == h.joint or not h.joint))


def holds(h: Hidden, row: pd.Series) -> bool:
    """Whether a finding is the cause, or names it among those that it cannot be told from."""
    if is_exactly(h, row):
        return True
    name = f"{h.cause} {h.joint}" if h.joint else h.cause
    listed = h.cause in row["cannot_tell_from"].split(";")
    return bool(listed and (row["joint"] in (h.joint, 0) or not h.joint or name in row["rivals"].split("; ")))


def is_alike(h: Hidden, row: pd.Series) -> bool:
    """Whether a finding is the cause up to its class, or names it among others."""
    same_class = any({row["cause"], h.cause} <= group for group in CLASSES)
    near = row["joint"] == h.joint or not row["joint"] or not h.joint
    return bool(holds(h, row) or (same_class and near))


def in_form_class(h: Hidden, row: pd.Series) -> tuple[bool, bool]:
    """Whether a finding's own name is of the class of the form that is hidden, and whether it or any that it leaves open is."""
    names = [(row["cause"], int(row["joint"])), *rivals(row)]
    alike = [_is_of_form(h, cause, joint) for cause, joint in names]
    return alike[0], any(alike)


def _is_of_form(h: Hidden, cause: str, joint: int) -> bool:
    near = FORM_CLASSES[h.cause].get(cause)
    return near is not None and (not near or joint - h.joint in near)


def rivals(row: pd.Series) -> list[tuple[str, int]]:
    """Return the causes that a finding leaves open, with their joints (0: none)."""
    causes, joints = _texts(row["rival_causes"]), _texts(row["rival_joints"])
    return [(cause, int(joint)) for cause, joint in zip(causes, joints, strict=True)]


def _texts(cell: object) -> list[str]:
    text = "" if pd.isna(cell) else str(cell).removesuffix(".0")
    return [part for part in text.split(";") if part]


def off_by(h: Hidden, row: pd.Series) -> dict[str, object]:
    """How many standard deviations an amplitude is off, where both are the same figure."""
    if h.cause not in SAME_FIGURE or h.extra == "turning" or not is_exactly(h, row):
        return {}
    return {"z": (float(row["estimate"]) - h.size) / float(row["sd"])}
