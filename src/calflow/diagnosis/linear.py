"""The diagnosis without a robot: which blocks of regressors a fitted model lacks, how sure that is, and what else it may be.

It is the robot's own: the same screening, family of tests, gate, stepwise search with exchanges, and verdict. Only what that
does by another fit is exact here, since the problem is linear; and residuals far off the others are not weighed down.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calflow.diagnosis.findings.verdict import verdict
from calflow.diagnosis.linear_trial import Block, LinearProblem, LinearTrial
from calflow.diagnosis.screening.family import Family
from calflow.diagnosis.search.acceptance import FALSE_ALARM, Acceptance
from calflow.diagnosis.search.linearisation import Finding
from calflow.diagnosis.search.stepwise import Stepwise
from calflow.diagnosis.search.verification import verified
from calflow.files.problems import InputError, Problem

__all__ = ["Block", "LinearDiagnosis", "LinearFinding", "LinearRival", "diagnose_linear"]

FLAT = 1e4  # by how much a parameter without a prior may move the residuals, over their length


@dataclass(frozen=True)
class LinearRival:
    """What else may explain the data: a block's name, its best variant, and its BIC above the finding's (variants averaged)."""

    name: str
    variant: str
    delta_bic: float


@dataclass(frozen=True, eq=False)
class LinearFinding:
    """A block that the model lacks.

    estimate and sd (n_parameters,) are in the parameters' units, sd nan at a bound; p is the chance that anything in the family
    looks like this where nothing is hidden, probability that it is this block rather than a rival; rivals are those that the
    data do not exclude (a BIC within 10), the nearest first.
    """

    name: str
    variant: str
    estimate: np.ndarray
    sd: np.ndarray
    p: float
    probability: float
    rivals: tuple[LinearRival, ...]


@dataclass(frozen=True)
class LinearDiagnosis:
    """What was found, in the order in which it was, and the names of what these data cannot show in any variant."""

    findings: tuple[LinearFinding, ...]
    untestable: tuple[str, ...]


def diagnose_linear(
    residual: np.ndarray,
    jacobian: np.ndarray,
    candidates: Sequence[Block],
    *,
    rng: np.random.Generator,
    prior_sd: np.ndarray | None = None,
    noise: np.ndarray | float | None = None,
    groups: np.ndarray | None = None,
    false_alarm: float = FALSE_ALARM,
    most: int = 10,
) -> LinearDiagnosis:
    """Find the blocks that explain what a linear, or linearised, model leaves of measurements.

    Residuals are predictions minus measurements (or the other way round, the matrices' sign with them), at the means of the
    fitted parameters' priors, or at any estimate where there are no priors: those parameters are fitted here again.

    Args:
        residual: (n,), in any unit.
        jacobian: its derivative by the parameters that are fitted anyway, shape (n, n_fitted).
        candidates: what the model may lack, all variants of each; see `Block`.
        rng: draws the bootstrap that tells how many tests the candidates are worth.
        prior_sd: standard deviations (n_fitted,) of the fitted parameters about the means; None: nothing is known of them.
        noise: standard deviation of the residuals, (n,) or one for all, in their unit; None: it is the same for all and not
            known. What a model leaves beyond it, where that is significant (1 %), is added in proportion.
        groups: (n,) numbers, equal where residuals may share an error; where they do, it counts once. None: none do.
        false_alarm: chance that anything at all is found where nothing is hidden.
        most: how many blocks to find at most.

    Raises:
        InputError: shapes do not match, or figures are not finite or of no use, all of them named.
    """
    residual, jacobian = np.asarray(residual, dtype=float), np.asarray(jacobian, dtype=float)
    if wrong := _problems(residual, jacobian, candidates, prior_sd, noise, groups):
        raise InputError(Problem(message) for message in wrong)
    sigma = np.broadcast_to(1.0 if noise is None else noise, residual.shape)
    whitened, design = residual / sigma, jacobian / sigma[:, None]
    matrix = np.hstack([block.matrix for block in candidates]) / sigma[:, None]
    prior = _flat(whitened, design) if prior_sd is None else np.asarray(prior_sd, dtype=float)
    group = None if groups is None else np.unique(groups, return_inverse=True)[1]
    problem = LinearProblem(whitened, design, prior, tuple(candidates), matrix, noise is not None, group)
    first = LinearTrial(Family({}, 1.0), problem).linearisation.screened(rng)
    search = Stepwise(Acceptance(false_alarm, most), first, rng, lambda _: None, lambda _: None)
    best, tried = search.best(LinearTrial(first.family, problem))
    return LinearDiagnosis(
        tuple(map(_finding, verified(best, tried))), tuple(dict.fromkeys(block.name for block in first.hidden))
    )


def _finding(finding: Finding[Block]) -> LinearFinding:
    told, own = verdict(finding), finding.own
    rivals = tuple(LinearRival(rival.id, rival.cause.detail if rival.cause else "", rival.bic) for rival in told.rivals)
    held = (own.estimate == finding.cause.bounds).any(axis=0)
    sd = np.where(held, np.nan, np.sqrt(np.diag(own.covariance)))
    cause = finding.cause
    return LinearFinding(cause.name, cause.variant, own.estimate, sd, finding.p, told.probability, rivals)


def _flat(residual: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Standard deviations (n_fitted,) of priors that hold back nothing, and keep what the data do not show from drifting."""
    length = np.linalg.norm(jacobian, axis=0)
    return np.asarray(FLAT * np.linalg.norm(residual) / np.where(length > 0, length, 1.0))


def _problems(
    residual: np.ndarray,
    jacobian: np.ndarray,
    candidates: Sequence[Block],
    prior_sd: np.ndarray | None,
    noise: np.ndarray | float | None,
    groups: np.ndarray | None,
) -> list[str]:
    """Everything that is wrong with what was given."""
    if residual.ndim != 1:
        return [f"residual: expected shape (n,), found {residual.shape}"]
    n = len(residual)
    found = []
    if jacobian.ndim != 2 or len(jacobian) != n:
        found.append(f"jacobian: expected shape ({n}, n_fitted), found {jacobian.shape}")
    elif n <= jacobian.shape[1]:
        found.append(f"residual: expected more than the {jacobian.shape[1]} fitted parameters, found {n}")
    elif prior_sd is not None and np.shape(prior_sd) != jacobian.shape[1:]:
        found.append(f"prior_sd: expected shape {jacobian.shape[1:]}, found {np.shape(prior_sd)}")
    found += [f"{name}: has figures that are not finite" for name, one in (("residual", residual), ("jacobian", jacobian))
              if not np.isfinite(one).all()]  # fmt: skip
    if not residual.any():
        found.append("residual: is zero throughout, nothing is left to explain")
    for name, figure in (("prior_sd", prior_sd), ("noise", noise)):
        if figure is not None and not (np.isfinite(figure) & (np.asarray(figure) > 0)).all():
            found.append(f"{name}: expected figures above 0")
    if noise is not None and np.shape(noise) not in ((), (n,)):
        found.append(f"noise: expected one figure or shape ({n},), found {np.shape(noise)}")
    if groups is not None and np.shape(groups) != (n,):
        found.append(f"groups: expected shape ({n},), found {np.shape(groups)}")
    if not candidates:
        found.append("candidates: expected at least one block")
    for block in candidates:
        found += [f"candidate {' '.join(filter(None, (block.name, block.variant)))}: {m}" for m in _wrong(block, n)]
    return found


def _wrong(block: Block, n: int) -> list[str]:
    """Everything that is wrong with a block for so many residuals."""
    shape = np.shape(block.matrix)
    if len(shape) != 2 or shape[0] != n or not shape[1]:
        return [f"expected a matrix of shape ({n}, n_parameters), found {shape}"]
    if any(np.shape(figure) not in ((), shape[1:]) for figure in (block.prior_sd, block.lower, block.upper)):
        return [f"expected one figure or shape {shape[1:]} for prior_sd, lower and upper"]
    found = [] if np.isfinite(block.matrix).all() else ["its matrix has figures that are not finite"]
    if not (np.isfinite(block.sd) & (block.sd > 0)).all():
        found.append("expected a prior_sd above 0")
    lower, upper = block.bounds
    if not ((lower <= 0) & (upper >= 0) & (lower < upper)).all():
        found.append("expected lower <= 0 <= upper, and lower < upper: zero is where it does nothing")
    return found
