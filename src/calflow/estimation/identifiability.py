"""Identifiability in words: what the data determine, what trades against what, and what they say nothing about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from scipy.linalg import qr

from calflow.estimation.fit import Fit

NULL = 1e-9  # singular values below this share of the largest are zero but for rounding
KNOWN = 3.0  # a direction is determined where the data know it this many times better than the prior does
NAMED = 0.02  # share of a direction's largest coefficient from which a parameter is named in it
STRONG_CORRELATION = 0.9


@dataclass(frozen=True)
class Identifiability:
    """How many directions the data determine, by effect and in all, and statements: kind, parameters, statement."""

    rank: int
    n_parameters: int
    rank_by_effect: Mapping[str, int]
    statements: pd.DataFrame


def identifiability(fit: Fit) -> Identifiability:
    """Analyse a fit's Jacobian, scaled by the priors and without their help."""
    parameters = fit.model.parameters
    names = [parameter.name for parameter in parameters]
    scaled = _scaled(fit)
    _, singular, directions = np.linalg.svd(scaled)
    singular = np.concatenate([singular, np.zeros(len(names) - len(singular))])
    null = singular <= NULL * singular[0]
    weak = (singular < KNOWN) & ~null
    rows = [
        *_directions(directions[null], names, null=True),
        *_directions(directions[weak], names, null=False),
    ]
    told = {tuple(sorted(pair)) for row in rows for pair in combinations(row[1].split(";"), 2)}
    for name, parameter, bound in zip(names, parameters, fit.at_bound, strict=True):
        if bound:
            rows.append(("bound", name, f"{name} sits on a bound ({parameter.lower:g} to {parameter.upper:g} {parameter.unit}): "
                         "its error is one-sided and no standard deviation is given"))  # fmt: skip
    rows += [
        (
            "correlated",
            f"{first};{second}",
            f"{first} and {second} are correlated ({value:+.3f}): known better together than apart",
        )
        for first, second, value in correlations(fit).itertuples(index=False)
        if tuple(sorted((first, second))) not in told
    ]
    effects = np.array([parameter.effect for parameter in parameters])
    ranks: dict[str, int] = {}
    seen = 0
    for effect in dict.fromkeys(effects):
        upto = np.isin(effects, [*ranks, effect])
        now = int((np.linalg.svd(scaled[:, upto], compute_uv=False) >= KNOWN).sum())
        ranks[effect], seen = now - seen, now
    statements = pd.DataFrame(rows, columns=["kind", "parameters", "statement"])
    return Identifiability(int((~null & ~weak).sum()), len(names), ranks, statements)


def correlations(fit: Fit) -> pd.DataFrame:
    """Return the pairs of parameters whose posterior correlation is strong, strongest first."""
    covariance = fit.covariance
    sd = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        matrix = np.nan_to_num(covariance / np.outer(sd, sd))
    i, j = np.triu_indices(len(sd), k=1)
    strong = np.abs(matrix[i, j]) > STRONG_CORRELATION
    names = np.array([parameter.name for parameter in fit.model.parameters], dtype=object)
    table = pd.DataFrame({"first": names[i[strong]], "second": names[j[strong]], "correlation": matrix[i, j][strong]})
    return table.sort_values("correlation", key=np.abs, ascending=False, kind="stable").reset_index(drop=True)


def best_subset(fit: Fit, count: Mapping[str, int]) -> pd.DataFrame:
    """Return which parameters a smaller count a model would keep: effect, parameter, kept.

    Effect by effect, the columns that add most to what is already kept come first (QR with column pivoting).
    """
    scaled = _scaled(fit)
    effects = np.array([parameter.effect for parameter in fit.model.parameters])
    kept = np.zeros(len(effects), dtype=bool)
    for effect, number in count.items():
        own = np.flatnonzero(effects == effect)
        block = scaled[:, own]
        if kept.any():
            basis, _ = np.linalg.qr(scaled[:, kept])
            block = block - basis @ (basis.T @ block)
        order = qr(block, mode="economic", pivoting=True)[2]
        kept[own[order[:number]]] = True
    return pd.DataFrame(
        {"effect": p.effect, "parameter": p.name, "kept": bool(keep)}
        for p, keep in zip(fit.model.parameters, kept, strict=True)
        if p.effect in count
    )


def _scaled(fit: Fit) -> np.ndarray:
    return fit.r_factor * fit.model.prior_sd


def _directions(basis: np.ndarray, names: list[str], null: bool) -> list[tuple[str, str, str]]:
    """Put a subspace into words, each direction with as few parameters as elimination leaves."""
    rows = []
    for direction in _echelon(basis):
        named = [(names[k], direction[k]) for k in np.argsort(-np.abs(direction)) if abs(direction[k]) > NAMED]
        parts = ";".join(name for name, _ in named)
        if len(named) == 1:
            say = "nothing" if null else "hardly anything"
            rows.append(("silent", parts, f"the data say {say} about {named[0][0]}; its value is the prior's"))
        else:
            others = ", ".join(f"{name} ({value / named[0][1]:+.2g})" for name, value in named[1:])
            tail = "only their combination is known" if null else "the data hardly tell them apart"
            rows.append(("trade", parts, f"{named[0][0]} trades against {others}: {tail}"))
    return rows


def _echelon(basis: np.ndarray) -> np.ndarray:
    """Reduce rows to echelon form with full pivoting, each scaled to a largest entry of 1; shape (n_directions, n)."""
    rows = basis.copy()
    left = list(range(len(rows)))
    while left:
        block = np.abs(rows[left])
        r, column = np.unravel_index(np.argmax(block), block.shape)
        pivot = left.pop(int(r))
        rows[pivot] /= rows[pivot, column]
        for other in range(len(rows)):
            if other != pivot:
                rows[other] -= rows[other, column] * rows[pivot]
    return rows / np.abs(rows).max(axis=1, keepdims=True) if len(rows) else rows
