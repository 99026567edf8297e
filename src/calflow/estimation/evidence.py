"""The evidence of a cause: how much more likely it makes the data, whatever its size, in closed form on a linearised model.

Before the data a cause's amplitudes are normal about zero, and how large nobody knows: their standard deviations are those that
it declares times one of SIZES, the usual ones alike and larger ones the rarer the larger they are. Such a mixture has the tails
of a Cauchy distribution (as Jeffreys 1961 asks of a test), so that a catalogue's usual sizes may be ten times too wide and a
file may hold a gross mistake. Amplitudes are integrated out (Kass and Raftery 1995). So neither the number of rows nor that of
a cause's parameters counts for itself, as they do in BIC: what counts is how much the data narrow them down.
"""

from __future__ import annotations

import numpy as np

SIZES = 0.5 ** np.arange(-3.0, 6.0)  # over the usual size: from eight times to a thirtieth
LOG_PRIOR = np.log(np.minimum(1.0, 1 / SIZES)) - np.log(np.minimum(1.0, 1 / SIZES).sum())


def directions(information: np.ndarray, score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what `explained` asks of amplitudes: squared and value, both (…, n), along the principal axes.

    Args:
        information: what the data know of the amplitudes, in units of their usual sizes, (…, n, n).
        score: the slope of half chi² by them, likewise, (…, n).
    """
    value, axes = np.linalg.eigh(information)
    value = np.maximum(value, np.finfo(float).tiny)
    return np.einsum("...ab,...a->...b", axes, score) ** 2 / value, value


def explained(squared: np.ndarray, value: np.ndarray, sizes: np.ndarray = SIZES) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much chi² falls with amplitudes of each size, and what narrowing them down costs, both (n_sizes, …).

    Args:
        squared: the fall of chi² along each direction of the amplitudes without any prior, (…, n_directions).
        value: what the data know of each direction at the usual size, over the prior, of a shape that spreads over squared.
        sizes: over the usual one, (n_sizes,).
    """
    known = sizes.reshape(-1, *[1] * squared.ndim) ** 2 * value.reshape(
        *[1] * (squared.ndim - value.ndim), *value.shape
    )
    fallen = np.einsum("...d,...d->...", squared, known / (1 + known))  # value is often one of many squared
    return fallen, np.broadcast_to(np.log1p(known).sum(axis=-1), fallen.shape)


def log_likelihood(share: np.ndarray, narrowed: np.ndarray, degrees_of_freedom: float) -> np.ndarray:
    """Return the logarithm of the likelihood with amplitudes over that without them, the noise's level integrated out.

    The noise is told by what the model leaves, which has lost the degrees of freedom of the model's own parameters (O'Hagan and
    Forster 2004): counted are these, not the residuals.

    Args:
        share: by how much of chi² it falls.
        narrowed: what narrowing the amplitudes down costs.
        degrees_of_freedom: of what the model without the amplitudes leaves.
    """
    return np.asarray(-(degrees_of_freedom * np.log1p(-np.minimum(share, 1 - 1e-12)) + narrowed) / 2)


def mixed(logs: np.ndarray) -> np.ndarray:
    """Return the logarithm of a mean over sizes of what has logarithms (n_sizes, …), by what they are before the data."""
    logs = logs + LOG_PRIOR.reshape(-1, *[1] * (logs.ndim - 1))
    most = logs.max(axis=0)
    return np.asarray(most + np.log(np.exp(logs - most).sum(axis=0)))


def size_cost(pulled: float, number: int) -> float:
    """Return -2 log of the prior density at estimates, over that of a standard normal's peak.

    Args:
        pulled: the sum of the squares of the estimates over their usual sizes.
        number: how many there are.
    """
    return float(-2 * mixed(-pulled / SIZES**2 / 2 - number * np.log(SIZES)))
