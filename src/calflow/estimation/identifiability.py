"""Identifiability: the directions of parameter space that the data determine, and those they leave to the priors.

Method: singular values of the Jacobian scaled by the priors. Redundant: dimensions whose effect others have at every pose.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
import scipy

from calflow.effects.geometry import Geometry
from calflow.estimation.fit import Fit
from calflow.files.deferred import pd
from calflow.files.problems import nearest
from calflow.files.tables import column, to_frame, typed
from calflow.files.words import number
from calflow.model import build
from calflow.robot.frames import origins_left_out
from calflow.robot.robot import Robot

NULL = 1e-9  # singular values below this share of the largest are zero but for rounding
KNOWN = 3.0  # a direction is determined where the data know it this many times better than the prior does
ALMOST_NULL = 1e-6  # as NULL, for a direction that is null only to first order
NAMED = 0.02  # share of a direction's largest coefficient from which a parameter is named in it
# Share of a parameter's standard deviation (half its variance) that one direction must hold for the parameter to be named in it.
MOSTLY = 0.7
STRONG_CORRELATION = 0.9
BASE = "the base's place and turn"


@dataclass(frozen=True, kw_only=True)
class Statement:
    """A direction of parameter space that the data do not determine, or a related warning."""

    kind: Literal["silent", "trade", "scale", "bound", "correlated"] = column(
        "a parameter that the data do not determine, several of which they determine a combination alone, all lengths of the "
        "robot in proportion, a parameter on a bound, a strongly correlated pair"
    )
    parameters: tuple[str, ...] = column("the names; weights refer to the first")
    statement: str = column("the statement in words")
    weights: tuple[float, ...] = column(
        "of a trade or scale: components of the direction in prior sd, relative to the first", default=()
    )
    wholly: bool = column(
        "of silent, trade, scale: the data have no information at all, not merely less than the prior", default=False
    )


@dataclass(frozen=True, kw_only=True)
class Correlation:
    """A strongly correlated pair of parameters; the table is sorted by strength."""

    first: str = column("a parameter")
    second: str = column("another")
    correlation: float = column("of the estimates, -1 to 1")


@dataclass(frozen=True, kw_only=True)
class Counted:
    """A parameter of an effect whose size the study limits, and whether a model of that size would keep it."""

    effect: str = column("id of the effect")
    parameter: str = column("its name")
    kept: bool = column("whether it is among those that add most information")


def rank_by_effect(fit: Fit) -> dict[str, int]:
    """Return the number of directions that the data determine, by the effect that adds them to those before it."""
    scaled, ranks = _scaled(fit), dict[str, int]()
    effects = np.array([parameter.effect for parameter in fit.model.parameters])
    for effect in dict.fromkeys(effects):
        singular = np.linalg.svd(scaled[:, np.isin(effects, [*ranks, effect])], compute_uv=False)
        ranks[effect] = int((singular >= KNOWN).sum()) - sum(ranks.values())
    return ranks


def left_open(fit: Fit) -> pd.DataFrame:
    """Return the table of `Statement`s on what the data leave open."""
    parameters = fit.model.parameters
    names = [parameter.name for parameter in parameters]
    scaled = _scaled(fit)
    _, singular, directions = np.linalg.svd(scaled)
    singular = np.concatenate([singular, np.zeros(len(names) - len(singular))])
    device = {observation.id for observation in fit.model.observations}
    unsure = np.sqrt(np.diag(fit.covariance)) / fit.model.prior_sd
    follower = np.array([parameter.effect in device for parameter in parameters]) & (unsure > 0)
    null = singular <= NULL * singular[0]
    weak = (singular < KNOWN) & ~null
    rows = [
        *_directions(directions[null], names, unsure, follower, null=True),
        *_directions(directions[weak], names, unsure, follower, null=False),
    ]
    rows = [*_scale(fit, scaled, float(singular[0])), *rows]
    listed = {tuple(sorted(pair)) for row in rows for pair in combinations(row.parameters, 2)}
    for name, parameter, bound in zip(names, parameters, fit.at_bound, strict=True):
        if bound:
            statement = (
                f"{name} sits on a bound ({parameter.lower:g} to {parameter.upper:g} {parameter.unit}): its error is one-sided "
                "and no standard deviation is given"
            )
            rows.append(Statement(kind="bound", parameters=(name,), statement=statement))
    for first, second, value in correlations(fit).itertuples(index=False):
        if tuple(sorted((first, second))) not in listed:
            statement = f"{first} and {second} are correlated ({value:+.3f}): known better together than apart"
            rows.append(Statement(kind="correlated", parameters=(first, second), statement=statement))
    return to_frame(rows, Statement)


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
    table = table.sort_values("correlation", key=np.abs, ascending=False, kind="stable").reset_index(drop=True)
    return typed(table, Correlation)


def wrong_counts(robot: Robot, effects: Sequence[str], count: Mapping[str, int]) -> Iterator[tuple[str, str]]:
    """Yield each effect whose number of parameters to keep is impossible, and why."""
    for effect, asked in count.items():
        most = len(build(robot, (effect,)).parameters) if effect in effects else 0
        if effect not in effects:
            yield effect, f"unknown effect '{effect}'{nearest(effect, effects)}; there are {', '.join(effects)}"
        elif asked not in range(most + 1):
            yield effect, f"expected a count from 0 to {most}, as many parameters as the effect has, found {asked}"


def best_subset(fit: Fit, count: Mapping[str, int]) -> pd.DataFrame:
    """Return which parameters a model would keep of each effect, given their number: those that add most (QR with pivoting)."""
    scaled = _scaled(fit)
    effects = np.array([parameter.effect for parameter in fit.model.parameters])
    kept = np.zeros(len(effects), dtype=bool)
    for effect, asked in count.items():
        columns = np.flatnonzero(effects == effect)
        block = scaled[:, columns]
        if kept.any():
            basis, _ = np.linalg.qr(scaled[:, kept])
            block = block - basis @ (basis.T @ block)
        order = scipy.linalg.qr(block, mode="economic", pivoting=True)[2]
        kept[columns[order[: int(asked)]]] = True
    both = zip(fit.model.parameters, kept, strict=True)
    rows = [Counted(effect=p.effect, parameter=p.name, kept=bool(keep)) for p, keep in both if p.effect in count]
    return to_frame(rows, Counted)


def _scale(fit: Fit, scaled: np.ndarray, largest: float) -> list[Statement]:
    """Return a statement where data do not determine scale: all lengths in proportion, with device and target free to move."""
    model = fit.model
    direction = np.zeros(len(model.parameters))
    for effect in model.effects:
        if isinstance(effect, Geometry):
            direction[model.columns(effect)] = [
                (error.parameter.figure + value) / error.parameter.prior_sd if error.is_length else 0.0
                for error, value, columns in zip(
                    effect.errors, model.values(effect, fit.estimate), effect.declared, strict=True
                )
                if columns.held is None
            ]
    if not direction.any():
        return []
    direction /= np.linalg.norm(direction)
    places = [i for o in model.observations for i in model.columns(o) if model.parameters[i].unit != "1"]
    moved = scaled @ direction
    if places:
        basis, sizes, _ = np.linalg.svd(scaled[:, places], full_matrices=False)
        free = basis[:, sizes > NULL * largest]
        moved = moved - free @ (free.T @ moved)
    length = float(np.linalg.norm(moved))
    if length >= KNOWN:
        return []
    order = [int(k) for k in np.argsort(-np.abs(direction)) if direction[k]]
    names = tuple(model.parameters[k].name for k in order)
    weights = tuple(float(direction[k] / direction[order[0]]) for k in order)
    wholly = length <= ALMOST_NULL * largest
    return [Statement(kind="scale", parameters=names, statement=scale_words(wholly), weights=weights, wholly=wholly)]


def _scaled(fit: Fit) -> np.ndarray:
    return fit.problem.reweighted(fit.estimate, fit.loss).r_factor(fit.estimate) * fit.model.prior_sd


def _directions(
    basis: np.ndarray, names: list[str], unsure: np.ndarray, follower: np.ndarray, null: bool
) -> list[Statement]:
    """Return statements of a subspace, each direction in as few parameters as elimination leaves.

    A device's place or lens has a prior so wide that compensating a joint's zero takes a tiny share of it: such a parameter is
    named where most of its variance lies along the direction. unsure (n_parameters,) are posterior over prior standard
    deviations, follower (n_parameters,) marks the device's parameters.
    """
    rows = []
    for direction in _echelon(basis):
        order = np.argsort(-np.abs(direction))
        follows = follower & (np.abs(direction) * unsure[order[0]] > MOSTLY * unsure)
        named = [k for k in order if abs(direction[k]) > NAMED or follows[k]]
        traded = tuple(names[k] for k in named)
        if len(named) == 1:
            statement = f"the data say {_little(null)} about {traded[0]}; its value was assumed, not measured"
            rows.append(Statement(kind="silent", parameters=traded, statement=statement, wholly=null))
            continue
        weights = tuple(float(direction[k] / direction[named[0]]) for k in named)
        pairs = zip(traded[1:], weights[1:], strict=True)
        others = ", ".join(f"{name} ({number(weight, '+.2g')})" for name, weight in pairs)
        tail = "only their combination is known" if null else "the data hardly separate them"
        statement = f"{traded[0]} trades against {others}: {tail}"
        rows.append(Statement(kind="trade", parameters=traded, statement=statement, weights=weights, wholly=null))
    return rows


def scale_words(wholly: bool) -> str:
    """Return the sentence that the data do not determine the robot's scale."""
    return (
        f"the data say {_little(wholly)} about how large the robot is, only about its proportions. "
        "One known length would settle it, such as the distance between two sockets, a bar or a wire"
    )


def _little(wholly: bool) -> str:
    return "nothing" if wholly else "hardly anything"


def _echelon(basis: np.ndarray) -> np.ndarray:
    """Reduce rows to echelon form, pivots by QR, each scaled to a largest entry of 1; shape (n_directions, n)."""
    if not len(basis):
        return basis
    _, upper, order = scipy.linalg.qr(basis, mode="economic", pivoting=True)
    rows = np.empty_like(basis)
    rows[:, order] = scipy.linalg.solve_triangular(upper[:, : len(basis)], upper)
    return np.asarray(rows / np.abs(rows).max(axis=1, keepdims=True))


@dataclass(frozen=True, kw_only=True)
class Redundant:
    """A dimension of a joint's origin that is not a parameter, since the parameters of others have the same effect at all poses."""

    figure: str = column("its name, in the form of a parameter's")
    joint: int = column("number of its joint")
    symbol: str = column("its symbol")
    same: str = column("errors that, with the joint's own parameters, move the tool in the same way at every pose")


def redundant(robot: Robot) -> pd.DataFrame:
    """Return the table of `Redundant` dimensions; empty where joints are not described by full origins."""
    rows = [
        Redundant(figure=f"joint{joint}.{symbol}", joint=joint, symbol=symbol, same=_same(robot, joint))
        for joint, frame in enumerate(robot.frames, start=1)
        for symbol in origins_left_out(frame)
    ]
    return to_frame(rows, Redundant)


def _same(robot: Robot, joint: int) -> str:
    """Return, in words, the parameters that replace the dimensions left out of a joint (counted from 1)."""
    if joint == 1:
        return BASE
    slides = robot.joints[joint - 2].kind == "prismatic"
    shifts = "shifts of slide" if slides else "a shift along and a turn about the axis of joint"
    return f"{shifts} {joint - 1}{' and a turn about its axis' if slides else ''}"
