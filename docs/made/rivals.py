"""What looks like what, worked out on the bench: how much of one cause's error another one would explain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from calflow.effects import Effect, catalogue
from made.bench import Bench

KEPT = 1e-9  # of a matrix's largest singular value: what is less is rounding
NOTHING = 1e-4  # share of an error below which nothing is left of it
WORTH = 0.25  # share of an error that is worth a word
MOST = 3  # rivals a row


@dataclass(frozen=True, eq=False)
class Place:
    """A cause at one place: how it moves what is reported (3 rows, parameters), beside what is fitted anyway."""

    effect: Effect
    part: str
    taken: float  # the share of its error that geometry and the joints' springs take
    left: np.ndarray


@dataclass(frozen=True)
class Likeness:
    """A place of an effect, and which others explain how much of what is left of it: (effect, part, share), nearest first.

    There are none where geometry and springs take all of it.
    """

    part: str
    taken: float
    rivals: tuple[tuple[str, str, float], ...]


@lru_cache
def _fitted(bench: Bench) -> np.ndarray:
    """An orthonormal basis of what the fitted parameters can do (3 rows, rank)."""
    return _basis(np.concatenate([_scaled(bench, effect) for effect in bench.fitted], axis=1))


@lru_cache
def _places(bench: Bench) -> tuple[tuple[Place, ...], np.ndarray, np.ndarray]:
    """Every cause that can be looked for here, the bases of all side by side, and which one each column is of."""
    found = tuple(
        place
        for effect in catalogue().values()
        if not effect.is_noise()
        for form in bench.forms(effect)
        if form not in bench.fitted
        for place in places(bench, form)
    )
    bases = [_basis(place.left) for place in found]
    return found, np.concatenate(bases, axis=1), np.repeat(np.arange(len(found)), [base.shape[1] for base in bases])


def places(bench: Bench, effect: Effect) -> tuple[Place, ...]:
    """An effect at each of its places, scaled by its prior."""
    all_of_it, fitted = _scaled(bench, effect), _fitted(bench)
    found = []
    for part, columns in effect.parts.items():
        own = all_of_it[:, columns]
        left = own - fitted @ (fitted.T @ own)
        found.append(Place(effect, part, 1 - float((left**2).sum() / max((own**2).sum(), 1e-30)), left))
    return tuple(found)


def likenesses(bench: Bench, effect: Effect) -> tuple[Likeness, ...]:
    """What an effect looks like at each of its places, once what is fitted anyway has taken its part."""
    others, bases, owner = _places(bench)
    found = []
    for place in places(bench, effect):
        explained = np.bincount(owner, ((bases.T @ place.left) ** 2).sum(axis=1), len(others))
        best: dict[str, tuple[str, float]] = {}
        for other, share in zip(others, explained / max((place.left**2).sum(), 1e-30), strict=True):
            if other.effect.id != effect.id and share >= max(WORTH, best.get(other.effect.id, ("", 0.0))[1]):
                best[other.effect.id] = (other.part, float(share))
        nearest = sorted(((name, *said) for name, said in best.items()), key=lambda one: -one[2])[:MOST]
        found.append(Likeness(place.part, place.taken, tuple(nearest) if 1 - place.taken > NOTHING else ()))
    return tuple(found)


def _scaled(bench: Bench, effect: Effect) -> np.ndarray:
    response = bench.response(effect)
    return response.reshape(-1, response.shape[2]) * [parameter.prior_sd for parameter in effect.declared]


def _basis(matrix: np.ndarray) -> np.ndarray:
    u, size, _ = np.linalg.svd(matrix, full_matrices=False)
    return u[:, size > KEPT * max(size.max(initial=0.0), 1e-30)]
