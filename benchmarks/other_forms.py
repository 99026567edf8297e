"""Every cause in a second and a third form, beside a background of no form: what the diagnosis calls it, and how surely.

    python benchmarks/other_forms.py --cases 300 --seed 1 --out other_forms.csv

Arms and forms are of foreign_physics.py and foreign_forms.py, where the table says what each form may be called. Every eighth case
hides nothing. A background is a smooth random displacement over three joints, rms per axis 0, 0.3, 1 or 5 times the noise. The
size of a form is 2, 3 or 5 limits: what neither geometry and springs nor this background (its law known) can imitate has so many
times the norm over the errors at which a cause of two parameters is found 95 times in 100 among a hundred. Where a form would have
to move the tool by more than LARGEST times noise and background another place is tried, and at last it is as large as that.
--keep FOLDER keeps each case as a study, with its truth.json.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import kept_cases
import numpy as np
import pandas as pd
from foreign_forms import FORMS, Form, Hidden, measured
from foreign_physics import ARMS, Arm, Array, Rows, background, likeness, measured_rows, slopes, visible, worn
from foreign_study import identified, joint_of, names_of, rivals_of, write_study
from kept_cases import Place, Row, calibration_table

from calflow.effects import catalogue
from calflow.effects.wording import cause_family

LIMIT = 6.0  # (sqrt of chi², 2 degrees of freedom, at 1 % over 100 tests: 4.3) + 1.645
LIMITS = (2.0, 3.0, 5.0)
BACKGROUNDS = (0.0, 0.3, 1.0, 5.0)  # over the noise
NULLS = 8  # one case of so many hides nothing
LARGEST = 10.0
STRIDE = 23  # from one case's form to the next one's in the table: prime to their number
TINY = 1e-6  # m: what a form moves the tool by while its size is looked for
BINS = [0, 0.5, 0.8, 0.95, 0.99, 1]


@dataclass(frozen=True)
class World:
    """An arm as stated and as built, what it did, and what is not of it: the background, and all errors' root a row."""

    arm: Arm
    real: Arm
    rows: Rows
    background: Array
    root: Array


@dataclass(frozen=True)
class Placed:
    """A form in its place, how far it moves the tool, rms per axis [m], and at how many limits that is."""

    hidden: Hidden | None
    rms: float
    limits: float


def drawn(arm: Arm, sigma: float, size: float, rng: np.random.Generator) -> World:
    """Draw poses, loads and markers, the arm as built, and a background of size times the noise."""
    payloads = (0, 1, 2) if rng.random() < 0.7 else (2,)
    rows = measured_rows(arm, int(rng.choice([75, 150])), rng, payloads, int(rng.choice([1, 3])))
    kernel = likeness(arm, rows, rng.choice(arm.n, 3, replace=False), rng.uniform(0.7, 1.5))
    errors = sigma**2 * (np.eye(len(rows)) + size**2 * kernel)
    return World(arm, worn(arm, rng), rows, background(kernel, size * sigma, rng), np.linalg.cholesky(errors))


def placed(form: Form, world: World, limits: float, spring: bool, rng: np.random.Generator) -> Placed:
    """Put a form where it shows, as large as limits say or as LARGEST allows."""
    slope, without = slopes(world.arm, world.rows, spring), measured(world.real, world.rows)
    allowed = LARGEST * np.sqrt(np.mean((world.root**2).sum(axis=1)))
    tried: list[Placed] = []
    for joint in rng.permutation(form.places(world.arm)):
        h = Hidden(form, int(joint), form.small, int(rng.integers(2**31)))
        h = resized(h, TINY / _rms(measured(world.real, world.rows, (h,)) - without))
        moved = measured(world.real, world.rows, (h,)) - without
        factor = limits * LIMIT / visible(moved, slope, world.root)
        tried.append(Placed(resized(h, factor), factor * _rms(moved), limits))
        if tried[-1].rms < allowed:
            return tried[-1]
    least = min(tried, key=lambda one: one.rms)
    share = allowed / least.rms
    return Placed(resized(least.hidden, share), allowed, share * limits)


def resized(h: Hidden, factor: float) -> Hidden:
    """The same form, so many times as large."""
    return Hidden(h.form, h.joint, h.size * factor, h.seed)


def _rms(moved: Array) -> float:
    return float(np.sqrt(np.mean((moved - moved.mean(axis=0)) ** 2)))


def work(place: Place) -> list[Row]:
    """Draw a case, write its study, and compare what is found with what is hidden."""
    rng, nothing = place.rng, place.number % NULLS == NULLS - 1
    form = None if nothing else FORMS[(place.number * STRIDE + 7 * place.seed) % len(FORMS)]
    needs = form.needs if form else ()
    arm = ARMS[str(rng.choice(form.arms if form else list(ARMS)))]
    sigma = float(rng.uniform(3e-5, 5e-5) if arm.name == "large-6" else rng.uniform(1.5e-5, 3e-5))
    size, limits = float(rng.choice(BACKGROUNDS)), float(rng.choice(LIMITS))
    world, masses = drawn(arm, sigma, size, rng), "no masses" not in needs
    if not masses:
        world = World(world.arm, _stiff(world.real), world.rows, world.background, world.root)
    found = placed(form, world, limits, masses, rng) if form else Placed(None, 0.0, 0.0)
    h = found.hidden
    seen = measured(world.real, world.rows, (h,) if h else ()) + world.background
    seen = seen + sigma * rng.standard_normal(seen.shape)
    columns = {"approach", *needs}
    for more in (("travel",), ("time", "temperature")):
        columns |= {*more} if rng.random() < 0.5 else set()
    truth: Row = {
        "arm": arm.name,
        "background": size,
        "rms_over_noise": found.rms / sigma,
        "at_limits": found.limits,
        "rows": len(seen),
    }
    truth |= (
        {"cause": form.cause, "form": form.name, "limits": limits}
        if form
        else {"cause": "", "form": "nothing", "limits": 0.0}
    )
    truth |= {"joint": h.joint, "size": h.size} if h else {"joint": 0, "size": 0.0}
    with tempfile.TemporaryDirectory() as apart:
        folder = place.folder or Path(apart) / "case"
        write_study(folder, arm, world.rows, seen, sigma=sigma if rng.random() < 0.5 else None, columns=columns, masses=masses,
                    effects=("geometry", "joint-compliance") if masses else ("geometry",))  # fmt: skip
        pd.Series(truth).to_json(folder / "truth.json", indent=1)
        calibration = identified(folder).diagnose()
    return [truth | judged(h, calibration.findings.table, names_of(calibration))]


def _stiff(arm: Arm) -> Arm:
    """The arm without springs: where nobody knows masses they are what is hidden, or are not there."""
    return Arm(**(vars(arm) | {"compliance": 0 * arm.compliance}))


def judged(h: Hidden | None, findings: pd.DataFrame, names: pd.DataFrame) -> Row:
    """Which names are of the hidden form's class, which is wrong and yet certain, and which are a second name of the same."""
    called = [_of_class(h, row["cause"], joint_of(row)) for _, row in names.iterrows()]
    rivals = [any(_of_class(h, *rival) for rival in rivals_of(row)) for _, row in names.iterrows()]
    suspects = {
        rival for _, row in findings[findings["status"] == "unexplained"].iterrows() for rival in rivals_of(row)
    }
    certain = [row["status"] == "named" for _, row in names.iterrows()]
    itself = sum(h is not None and row["cause"] == h.form.cause for _, row in names.iterrows())
    told = {
        "name": [f"{row['cause']}:{joint_of(row)}" for _, row in names.iterrows()], "probability": names["probability"],
        "of_family": names["family_probability"].fillna(names["probability"]), "status": names["status"], "in_class": called,
        "itself": [_itself(h, row["cause"], joint_of(row)) for _, row in names.iterrows()],
        "in_family": [_in_family(h, row["cause"], joint_of(row)) for _, row in names.iterrows()],
    }  # fmt: skip
    return {
        "in_set": any(called) or any(rivals),
        "in_set_or_suspects": any(called) or any(rivals) or any(_of_class(h, *rival) for rival in suspects),
        "suspects": len(suspects), "in_class": any(called),
        "certain_and_wrong": any(sure and not right for sure, right in zip(certain, called, strict=True)),
        "second_names": max(sum(called) - max(min(itself, h.form.names if h else 1), 1), 0),
        "other_names": len(called) - sum(called), "unexplained": int((findings["status"] == "unexplained").sum()),
        "faults": int((findings["status"] == "data_fault").sum()),
    } | {f"each_{name}": ";".join(map(str, values)) for name, values in told.items()}  # fmt: skip


def _of_class(h: Hidden | None, cause: str, joint: int) -> bool:
    return h is not None and h.form.may_be_called(cause, joint, h.joint)


def _itself(h: Hidden | None, cause: str, joint: int) -> bool:
    return h is not None and h.form.cause == cause and joint in (0, h.joint)


def _in_family(h: Hidden | None, cause: str, joint: int) -> bool:
    """Whether a cause's family at its joint has what is hidden: by another member's name where the form may be called that, too."""
    kin = [name for name, kind in catalogue().items() if kind.family and kind.family == cause_family(cause)]
    return h is not None and any(_of_class(h, name, joint) for name in {cause, *kin})


def tell(cases: pd.DataFrame) -> str:
    """What forms are called, by background, size, cause and arm; stated probabilities against shares right; and nulls."""
    named, unexplained = cases["each_name"].fillna("") != "", cases["unexplained"] > 0
    cases = cases.assign(
        all="all", named=named, unexplained=unexplained, silent=~named & ~unexplained, second=cases["second_names"] > 0
    )
    hidden, nulls = cases[cases["form"] != "nothing"], cases[cases["form"] == "nothing"]
    figures = [
        "in_set",
        "in_set_or_suspects",
        "suspects",
        "in_class",
        "certain_and_wrong",
        "second",
        "other_names",
        "unexplained",
        "silent",
    ]
    parts = [_by(hidden, key, figures) for key in ("all", "background", "limits", "arm", "cause")]
    parts += ["nothing hidden\n" + _by(nulls, "background", ["named", "unexplained"])] if len(nulls) else []
    found = cases[cases["named"]]
    each = {
        name: found[f"each_{name}"].astype(str).str.split(";").explode()
        for name in ("probability", "of_family", "in_class")
    }
    for name, whose in (("probability", "causes'"), ("of_family", "families'")):
        table = calibration_table(each[name], each["in_class"] == "True", BINS)
        parts.append(f"names by their {whose} stated probability (right: of the class)\n{table}")
    return "\n\n".join(parts)


def _by(cases: pd.DataFrame, key: str, figures: list[str]) -> str:
    numbers = cases[figures].astype(float)
    return numbers.groupby(cases[key]).mean().round(3).assign(n=cases.groupby(key).size()).to_string()


if __name__ == "__main__":
    kept_cases.run_cases(__doc__, {"forms": (work, tell)})
