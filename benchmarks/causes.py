"""How probable causes are that few poses hardly tell apart: the models in reach against all sets of two, and against the truth.

    python benchmarks/causes.py --cases 30

Robots of the 210 kg class (benchmarks/heavy_robot.py), 18 poses, whose hidden cause is the cubic stiffness of a joint or the
torsion of a link: all follow the same loads, and what the fit of 35 parameters leaves of one from so few poses looks much like
another. The cause is 1, 1.25 or 1.5 limits: what the identified model cannot imitate of the displacement has so many times the norm
over the noise at which a cause of one parameter is found 95 times in 100. Cases in which nothing is found, or all models in reach
but one have less than 5 %, are drawn anew: what is left are the ambiguous ones.
Exhaustive is every set of up to two of the places that the data show, each fitted, with all parameters, the causes' sizes and the
noise's level integrated about its own estimate; in reach are the probabilities that diagnose states, from one linearisation.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pandas as pd
from heavy_robot import EFFECTS, NOISE, HeavyRobot
from scipy.special import logsumexp

import calflow as cf
from calflow.diagnosis import FALSE_ALARM
from calflow.diagnosis.extension import FittedTrial, extend
from calflow.diagnosis.fitted import Fitted
from calflow.diagnosis.models_in_reach import ModelInReach, models_in_reach, probabilities, rivals_shown
from calflow.diagnosis.screening import Catalogue
from calflow.diagnosis.stepwise import SHARES, CauseAcceptance, Stepwise
from calflow.diagnosis.trial import Linearisation
from calflow.effects.cause import Cause
from calflow.effects.link_torsion import LinkTorsion
from calflow.effects.nonlinear_joint_stiffness import NonlinearJointStiffness
from calflow.estimation.accuracy import error_jacobian
from calflow.estimation.calibrated_model import CalibratedModel, series_noise
from calflow.estimation.fit import fit
from calflow.estimation.least_squares import LeastSquares
from calflow.estimation.noise import averaged
from calflow.estimation.progress import nobody
from calflow.estimation.variance_components import LOG_PRIOR, SIZES
from calflow.measurements.measurements import Measurements
from calflow.sampling.log_posterior import log_posterior_of
from hidden.causes import PAYLOADS, Hidden, measured_points
from hidden.simulator import Rows

POSES = 18
LIMIT = 5.0  # (sqrt of chi², 1 degree of freedom, at 0.7 % over ten tests: 3.4) + 1.645
LIMITS = (1.0, 1.25, 1.5)
SMALL = {
    "nonlinear-joint-stiffness": 1e-5,
    "link-torsion": 1e-9,
}  # rad at the largest torque, rad/Nm: they act linearly
PLACES = {"nonlinear-joint-stiffness": (2, 3, 4, 5), "link-torsion": (2, 3)}
CERTAIN = 0.95  # probability of a model from which a case is not ambiguous
LEVELS = np.linspace(-1.5, 1.5, 61)  # logarithms of the noise's level
BINS = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)


@dataclass(frozen=True)
class Case:
    """What was measured with a hidden cause, and what calflow identified of it, the cause unknown to it."""

    hidden: Hidden
    known: CalibratedModel
    data: Measurements


def drawn(rng: np.random.Generator) -> Case:
    """Draw a robot, its poses, its cause, and the noise."""
    robot = HeavyRobot.drawn(rng)
    q, payload = robot.poses(POSES, rng), np.arange(POSES) % len(PAYLOADS)
    none = np.zeros_like(q)
    rows = Rows(q, payload, np.zeros(POSES, dtype=int), none, none, none, np.zeros(POSES), np.full(POSES, 20.0))
    noise = NOISE * rng.standard_normal((POSES, 3))
    clean = measured_points(robot.real, rows, ())

    def identified(points: np.ndarray) -> tuple[CalibratedModel, Measurements]:
        data = cf.Measurements.from_arrays(
            robot.stated, q, points, payload=np.array(PAYLOADS)[payload], pose=np.arange(1, POSES + 1), split="train",
            sigma=np.full(POSES, NOISE),
        )  # fmt: skip
        return cf.identify(robot.stated, data, EFFECTS, starts=1), data

    known, data = identified(clean + noise)
    kind = str(rng.choice(list(SMALL)))
    cause = Hidden(kind, int(rng.choice(PLACES[kind])), SMALL[kind])
    moved = measured_points(robot.real, rows, (cause,)) - clean
    factor = rng.choice(LIMITS) * LIMIT / max(_shown(known, data, moved), 1e-9)
    cause = replace(cause, size=factor * cause.size)
    return Case(cause, *identified(measured_points(robot.real, rows, (cause,)) + noise))


def _shown(known: CalibratedModel, data: Measurements, moved: np.ndarray) -> float:
    """What the identified model cannot imitate of a displacement (n_rows, 3) [m], over the noise."""
    jacobian = error_jacobian(known.model, known.estimate, data).reshape(-1, len(known.estimate)) / NOISE
    information = jacobian.T @ jacobian + np.diag(known.model.prior_sd**-2.0)
    shift = moved.ravel() / NOISE
    return float(np.sqrt(shift @ (shift - jacobian @ np.linalg.solve(information, jacobian.T @ shift))))


def diagnosed(
    case: Case, rng: np.random.Generator
) -> tuple[CalibratedModel, FittedTrial, Catalogue, tuple[ModelInReach, ...]]:
    """What the search of diagnose finds among the look-alikes."""
    data = case.data.on(case.known.model.robot)
    catalogue = Catalogue((NonlinearJointStiffness(data.robot), LinkTorsion(data.robot)), {})
    start = Fitted.of(case.known, *averaged(data, case.known.noise(data)))
    found = extend(start, catalogue, Stepwise(CauseAcceptance(SHARES["causes"] * FALSE_ALARM, 10), rng, nobody, nobody))
    final = found.fitted
    beside = Linearisation.at(final, catalogue.effects).beside.scores
    reached = models_in_reach(final, found.findings, beside, catalogue)
    extended = CalibratedModel(
        final.model, final.fit.estimate, final.fit.covariance, final.fit.at_bound, series_noise(case.known.noise(data), data),
        final.noise.discrepancy, final.fit.loss, final.errors,
    )  # fmt: skip
    return extended, found, catalogue, reached


def shown_places(found: FittedTrial, catalogue: Catalogue) -> list[Cause]:
    """A cause of each place that the data show."""
    return list(rivals_shown(found.findings, Linearisation.at(found.fitted, catalogue.effects).beside.scores).values())


def every_set(causes: Sequence[Cause]) -> Iterator[ModelInReach]:
    """All sets of up to two of these causes."""
    for number in range(3):
        for chosen in combinations(causes, number):
            yield ModelInReach(chosen, "found", -number * float(np.log(len(causes))), 0.0)


def integrated(problem: LeastSquares, known: CalibratedModel, causes: Sequence[Cause]) -> float:
    """The logarithm of the data's probability with these causes, all integrated about the model's own fit."""
    plain = [effect for effect in known.model.effects if not isinstance(effect, Cause)]
    there = dict(zip((p.identity for p in known.model.parameters), known.estimate, strict=True))
    own = problem.on(replace(known.model, effects=(*plain, *causes)))
    model = own.model
    found, _ = fit(own, np.array([[there.get(p.identity, p.nominal) for p in model.parameters]]))
    free, sd = ~found.at_bound, model.prior_sd[~found.at_bound]
    parts = [
        [part.decorrelated(of).reshape(part.n_units * len(part.rows), -1) for of in part.linearised(found.estimate)]
        for part in own.parts()
    ]
    residual, jacobian = np.concatenate([e[:, 0] for e, _ in parts]), np.vstack([j for _, j in parts])[:, free] * sd
    residual = residual - jacobian @ ((found.estimate - model.prior_mean)[free] / sd)  # at the priors' means
    information, score = jacobian.T @ jacobian, jacobian.T @ residual
    level, columns = (
        np.exp(2 * LEVELS)[:, None],
        [np.isin(np.flatnonzero(free), model.columns(cause)) for cause in causes],
    )
    logs = []
    for sizes in product(range(len(SIZES)), repeat=len(causes)):
        scale = np.prod([np.where(at, SIZES[k], 1.0) for k, at in zip(sizes, columns, strict=True)], axis=0) * np.ones(
            len(sd)
        )
        value, axes = np.linalg.eigh(information * np.outer(scale, scale))
        along, known_to = (axes.T @ (scale * score)) ** 2, value / level + 1
        chi2 = residual @ residual / level[:, 0] - (along / level**2 / known_to).sum(axis=1)
        logs.append(
            -(chi2 + 2 * len(residual) * LEVELS + np.log(known_to).sum(axis=1)) / 2 + sum(LOG_PRIOR[k] for k in sizes)
        )
    return float(logsumexp(logs))


def compared(seed: int, number: int) -> pd.DataFrame:
    """A row a place of a case: its probability by the models in reach, by all sets, and whether it is true."""
    for attempt in range(100):
        rng = np.random.default_rng([seed, number, attempt])
        case = drawn(rng)
        extended, found, catalogue, reached = diagnosed(case, rng)
        if _ambiguous(reached):
            break
    places = shown_places(found, catalogue)
    problem = log_posterior_of(extended, case.data.on(extended.model.robot))[0].problem
    every = [
        replace(one, log_weight=one.log_prior + integrated(problem, extended, one.causes)) for one in every_set(places)
    ]
    true = case.hidden.cause, case.hidden.joint
    rows = [
        {"case": number, "attempts": attempt + 1, "cause": cause.id, "part": cause.part,
         "true": (cause.id, cause.joint) == true, "in_reach": _at(reached, cause),
         "exhaustive": _at(every, cause), "models": len(reached), "of": len(every)}
        for cause in places
    ]  # fmt: skip
    return pd.DataFrame(rows)


def _ambiguous(reached: Sequence[ModelInReach]) -> bool:
    return bool(reached) and probabilities(reached).max() < CERTAIN


def _at(models: Sequence[ModelInReach], cause: Cause) -> float:
    having = np.array([any(one.place == cause.place for one in model.causes) for model in models])
    return float(probabilities(models)[having].sum())


def told(rows: pd.DataFrame) -> str:
    """Brier scores, how far probabilities are from the exhaustive ones, and a reliability table of each."""
    cases = rows.groupby("case").first()
    said = [
        f"{len(cases)} cases of {cases['attempts'].sum()} drawn, {len(rows) / len(cases):.1f} places; in reach "
        f"{cases['models'].median():.0f} models of {cases['of'].median():.0f} sets"
    ]
    kinds = ("exhaustive", "in_reach")
    exhaustive = ((rows["exhaustive"] - rows["true"]) ** 2).mean()
    for kind in kinds:
        brier, off = ((rows[kind] - rows["true"]) ** 2).mean(), (rows[kind] - rows["exhaustive"]).abs()
        said.append(f"{kind:12} Brier {brier:.4f} ({brier / exhaustive - 1:+.1%}), from exhaustive: mean {off.mean():.4f}, "
                    f"most {off.max():.3f}")  # fmt: skip
    for kind in kinds:
        bins = pd.cut(rows[kind], BINS, include_lowest=True)
        table = rows.groupby(bins, observed=True).agg(n=("true", "size"), stated=(kind, "mean"), true=("true", "mean"))
        said.append(f"\n{kind}\n{table.round(3)}")
    return "\n".join(said)


def main() -> None:
    """Print scores and reliability."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="CSV to keep the places of all cases in")
    options = parser.parse_args()
    tables = []
    for number in range(options.cases):
        tables.append(compared(options.seed, number))
        if options.out:
            pd.concat(tables).to_csv(options.out, index=False)
    print(told(pd.concat(tables, ignore_index=True)))


if __name__ == "__main__":
    main()
