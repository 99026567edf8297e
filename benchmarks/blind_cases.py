"""Blind cases: robots and poses drawn at random, and causes hidden in them at a size in detection limits."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # a process a core
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
from scipy.stats import chi2, norm

from calflow.diagnosis.cause_tables import noncentrality
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.screening import Catalogue, Score, Screening, f_threshold
from calflow.diagnosis.stepwise import SHARES
from calflow.diagnosis.trial import Detection, Linearisation, Screened
from calflow.diagnosis.verdict import verdict
from calflow.estimation.model_tables import calibrated
from calflow.estimation.noise import averaged
from calflow.estimation.variance_components import directions, explained, mixed
from calflow.faults import corrected
from calflow.files.tables import Results
from calflow.runs.run import run
from calflow.study import Study, load_study
from hidden.case import Case, World, draw, write_case
from hidden.causes import Hidden, measured_points

FALSE_ALARM = 0.01
QUANTILES = (np.arange(200) + 0.5) / 200  # of a distribution that is averaged over
TRIES = 30
SIZES = (1.0, 1.5, 2.0, 3.0, 5.0)
NULLS = ("gauss", "heavy", "range", "outliers")
ONLY_SWEEPS = {"payload-mass", "tool-deflection", "link-mass"}  # causes that one payload alone does not show


@dataclass(frozen=True)
class Unit:
    """A cause to hide: where, the catalogue's largest size, its forms, and the columns without which it is not tested."""

    cause: str
    joints: tuple[int, ...]
    largest: float
    extras: tuple[float | str, ...] = ("",)
    columns: tuple[str, ...] = ()


UNITS = (
    Unit("joint-backlash", (1, 2, 3, 4, 5), 300e-6, columns=("approach",)),
    Unit("joint-hysteresis", (1, 2, 3, 4, 5), 200e-6, columns=("approach", "travel")),
    Unit("torque-backlash", (2, 3, 5), 300e-6),
    Unit("joint-eccentricity", (1, 2, 3, 4, 5), 300e-6, (1, 2)),
    Unit("periodic-joint-error", (1, 2, 3, 4, 5), 400e-6, (5, 7.3, 12)),
    Unit("gear-transmission-error", (1, 2, 3, 5), 150e-6, (1, 2)),
    Unit("gear-ratio-error", (1, 2, 3, 4, 5), 10e-3),  # a mistake in a file knows no usual size
    Unit("wrist-coupling", (5, 6), 10e-3, ("54", "64", "65")),
    Unit("nonlinear-joint-stiffness", (2, 3), 1e-3, ("", "break")),
    Unit("bearing-compliance", (2, 3, 4), 3e-7),
    Unit("link-bending", (2, 4), 3e-7),
    Unit("link-torsion", (2, 4), 3e-7),
    Unit("base-compliance", (0,), 5e-8),
    Unit("gravity-compensator", (2,), 30e3),
    Unit("dress-pack", (4,), 500.0, ("", "below", "taut")),
    Unit("payload-mass", (0,), 0.3),
    Unit("payload-com", (0,), 0.1),
    Unit("link-mass", (3,), 0.3),
    Unit("tool-deflection", (0,), 3e-7),
    Unit("thermal-growth", (0,), 23e-6, columns=("time", "temperature")),
    Unit("frame-drift", (0,), 3e-4, ("", "turning"), columns=("time",)),
    Unit("frame-step", (0,), 1e-3, ("", "turning")),
)
NEAR = {"gear-ratio-error", "joint-eccentricity", "link-torsion", "bearing-compliance", "link-bending", "link-mass",
        "payload-mass", "gravity-compensator"}  # fmt: skip
UNKNOWN = (  # what the catalogue lacks, and how it is cut down
    (Hidden("third-order", 2, 2e-4), 'leave_out = ["periodic-joint-error", "joint-error-map"]'),
    (Hidden("third-order", 1, 1.5e-4), 'leave_out = ["periodic-joint-error", "joint-error-map"]'),
    (Hidden("cable-drag", 0, 3e-4), ""),
    (Hidden("random-field", 0, 1e-4), ""),
    (Hidden("floor-vibration", 0, 1.5e-4), ""),
)


@dataclass(frozen=True)
class Job:
    """One case to simulate and diagnose; several causes are drawn among some, each its size times its detection limit.

    Where set_size is asked for, a cause is drawn anew (TRIES times at most) until by calculation as many explain the data.
    """

    case: Case
    seed: int
    kind: str
    size: float = 0.0
    several: int = 0
    among: frozenset[str] = frozenset()
    set_size: int = 1


def nulls(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """Nothing hidden, under every kind of noise."""
    for k in range(number):
        yield Job(replace(design(rng), noise=NULLS[k % len(NULLS)]), new_seed(rng), NULLS[k % len(NULLS)])


def effects(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """One cause, anywhere, at any size."""
    for k in range(number):
        yield Job(design(rng), new_seed(rng), "effect", SIZES[k % len(SIZES)], 1)


def pairs(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """Two causes of different kinds."""
    for _ in range(number):
        yield Job(design(rng), new_seed(rng), "pair", 3.0, 2)


def alike(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """Causes with near rivals."""
    for _ in range(number):
        case = replace(design(rng), payloads=("none", "half", "full"), markers=1)
        yield Job(case, new_seed(rng), "alike", 2.0, 1, frozenset(NEAR), 2)


def unknown(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """Causes outside the catalogue."""
    for k in range(number):
        hidden, cut = UNKNOWN[k % len(UNKNOWN)]
        settings = f"[stages.diagnose]\n{cut}\n" if cut else ""
        case = replace(design(rng), hidden=(hidden,), poses=160, columns=("approach", "time"), settings=settings)
        yield Job(case, new_seed(rng), hidden.cause)


def springs(number: int, rng: np.random.Generator) -> Iterator[Job]:
    """Compliant joints, where the study knows neither them nor the masses."""
    for _ in range(number):
        case = replace(design(rng), hidden=(Hidden("gravity-deflection", 0, 1.0),), masses=False, effects=("geometry",))
        yield Job(case, new_seed(rng), "gravity-deflection")


def design(rng: np.random.Generator) -> Case:
    """Draw a robot, 60 or 120 poses to fit and a third as many to hold out, payloads, markers and columns."""
    return Case(
        robot=str(rng.choice(["serial", "hh800"])),
        poses=int(rng.choice([80, 160])),
        payloads=[("none", "half", "full"), ("full",)][int(rng.random() < 0.3)],
        markers=int(rng.choice([1, 3])),
        columns=("approach", "travel", "time", "temperature")[: int(rng.choice([1, 2, 4]))],
    )


def new_seed(rng: np.random.Generator) -> int:
    """Draw the seed of a case."""
    return int(rng.integers(2**31))


# --- Sizes -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bare:
    """The same robot, poses and noise with nothing hidden, fitted and screened."""

    fitted: Fitted
    linearisation: Linearisation
    screened: Screened


def begun(study: Study, results: Results) -> tuple[Fitted, Catalogue]:
    """Return the fit that diagnose begins with, and its catalogue."""
    data = study.measurements()
    known = calibrated(study.robot, results.of({"identify"}), data.given)
    data = corrected(data.on(known.model.robot), results.tables["identify/faults.csv"])
    train, level = averaged(data.only(data.train), known.noise(data).only(data.train))
    return Fitted.of(known, train, level), Catalogue.of(train, [effect.id for effect in known.model.effects])


@dataclass(frozen=True)
class Sized:
    """A case with its causes in it, and what to expect of it, by calculation.

    beside has each cause's size in limits where the other causes are known to act too; set_size is how many causes these
    data could not tell from the first one if they were without noise; first is how often at most its cost is the least.
    """

    case: Case
    beside: tuple[float, ...]
    set_size: int
    first: float


def sized(job: Job, folder: Path) -> Sized:
    """Draw a case's causes, each job.size times its detection limit without a background.

    Causes that these poses do not show at the catalogue's largest size are drawn anew.
    """
    rng = np.random.default_rng([job.seed, 1])
    nothing = tuple(Hidden("joint-backlash", 1, 0.0) for _ in range(job.several))
    once = "[stages.identify]\nstarts = 1\n"
    alone = replace(job.case, hidden=nothing, settings=once, background=None)
    write_case(folder, alone, np.random.default_rng(job.seed))
    study = load_study(folder)
    fitted, catalogue = begun(study, run(study, folder / "run", stage="identify").results)
    linearisation = Linearisation.at(fitted, catalogue.effects)
    bare = Bare(fitted, linearisation, linearisation.screened(rng))
    units = [unit for unit in UNITS if set(unit.columns) <= set(job.case.columns)]
    units = [unit for unit in units if not job.among or unit.cause in job.among]
    if len(job.case.payloads) == 1:
        units = [unit for unit in units if unit.cause not in ONLY_SWEEPS]
    tries = 0
    while True:
        drawn = [units[k] for k in rng.choice(len(units), job.several, replace=False)]
        hidden = tuple(_placed(unit, rng) for unit in drawn)
        world = draw(replace(job.case, hidden=hidden), np.random.default_rng(job.seed))
        shifts = [_shift(bare, world, k) for k in range(len(hidden))]
        limits = [_limit(bare, h, shift) for h, shift in zip(hidden, shifts, strict=True)]
        sizes = [job.size * limit for limit in limits]
        if max(limits) > 1:
            continue
        tries, expected = tries + 1, _expected(bare, hidden[0], sizes[0] * shifts[0])
        if expected[0] >= job.set_size or tries == TRIES:
            break
    chosen = tuple(replace(h, size=h.size * size) for h, size in zip(hidden, sizes, strict=True))
    beside = tuple(
        size / _limit(bare, h, shift, [other for other in shifts if other is not shift])
        for h, shift, size in zip(hidden, shifts, sizes, strict=True)
    )
    return Sized(replace(job.case, hidden=chosen), beside, *expected)


def _placed(unit: Unit, rng: np.random.Generator) -> Hidden:
    joint, extra = int(rng.choice(unit.joints)), unit.extras[int(rng.integers(len(unit.extras)))]
    if unit.cause == "wrist-coupling":
        joint = int(str(extra)[0])
    return Hidden(unit.cause, joint, unit.largest, extra)


def _shift(bare: Bare, world: World, which: int) -> np.ndarray:
    """What a cause does to the training rows at its largest size, in standard deviations; linear, from a tenth of it."""
    small = replace(world.hidden[which], size=0.1 * world.hidden[which].size)
    moved = measured_points(world.real, world.rows, (small,)) - measured_points(world.real, world.rows, ())
    rows = bare.fitted.data.table["line"].to_numpy(int) - 2
    return (10 * moved[rows] / bare.fitted.noise.total[:, None]).ravel()


def _limit(bare: Bare, h: Hidden, shift: np.ndarray, others: Sequence[np.ndarray] = ()) -> float:
    """The size found 95 times in 100, over the largest one; infinite where the cause's own form does not show at all."""
    seen = _screened(bare, shift, others)
    own = [score for score in seen.scores if (score.cause.id, score.cause.joint) == (h.cause, h.joint)]
    if not own:
        return np.inf
    best = max(own, key=lambda score: score.drop)
    alarm, tests = SHARES["causes"] * FALSE_ALARM, bare.screened.family.tests(best)
    needed = noncentrality(f_threshold(alarm, tests, best.shown, best.left), best.shown, best.left)
    return float(np.sqrt(needed / seen.chi2))


def _expected(bare: Bare, h: Hidden, shift: np.ndarray) -> tuple[int, float]:
    """How many causes are as near to this one as the verdict allows, itself included, and the chance that it is named first.

    Scores are those without noise. Noise of one sigma lets the difference of two causes' chi², d² without it, spread by 2 d, and
    fits each parameter that one of them has more than the other by a chi² of its own; the chance is that against the rival most
    likely to win, an upper bound.
    """
    seen, n = _screened(bare, shift), len(shift)
    scores = [replace(score, cost=_cost(seen, score, n)) for score in seen.scores]
    own = [score for score in scores if (score.cause.id, score.cause.joint) == (h.cause, h.joint)]
    best = min(own, key=lambda score: score.cost)
    rivals = verdict(Detection(best.cause, tuple(scores), bare.screened.family)).rivals
    chances = [
        _leads(rival.cost, best.drop - rival.score.drop, rival.score.shown - best.shown)
        for rival in rivals
        if rival.score is not None
    ]
    return 1 + len({rival.id for rival in rivals}), min(chances, default=1.0)


def _cost(seen: Screening, score: Score, n: int) -> float:
    """What a cause costs beside noise of one sigma in n residuals, of which the screened ones have none."""
    own = score.candidate.columns
    sd = seen.whole.regressors.prior_sd[own]
    fallen, narrowed = explained(*directions(score.information * np.outer(sd, sd), sd * seen.whole.score[own]))
    logs = -(n * np.log1p(-fallen / (n + seen.chi2)) + narrowed) / 2
    return float(-2 * mixed(logs) + 2 * np.log(seen.variants[score.cause.place]))


def _leads(cost: float, apart: float, more: int) -> float:
    """The chance that a cause's cost stays below a rival's, cost and apart in chi² above it without noise, with more parameters."""
    fitted = np.sign(more) * chi2.ppf(QUANTILES, abs(more)) if more else np.zeros(1)
    return float(norm.cdf((cost - fitted) / (2 * np.sqrt(max(apart, 1e-6)))).mean())


def _screened(bare: Bare, residual: np.ndarray, others: Sequence[np.ndarray] = ()) -> Screening:
    """Screen a residual, with further columns that the model can imitate."""
    plain = bare.linearisation.regressors
    jacobian = np.column_stack([plain.jacobian, *others])
    return Screening.of(replace(
        plain, residual=-residual, pull=np.zeros(jacobian.shape[1]), prior_rss=0.0, jacobian=jacobian,
        precision=np.append(plain.precision, np.zeros(len(others))),
    ))  # fmt: skip
