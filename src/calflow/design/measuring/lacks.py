"""Lacks: what a fitted model may lack though no test has proven it, each as likely as the data leave it.

Besides nothing that is a cause of the catalogue at any place, a smooth background along any input, or an error of every pose
for itself. Each is a set of columns b ~ N(0, size²) beside the model's own parameters, so that the likelihood of the data with it
is known in closed form (Kass and Raftery 1995): nothing is fitted anew. Two at once are not weighed: what was found is in the
model.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.special import logsumexp

from calflow.diagnosis.findings.verdict import label
from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.screening.regressors import Regressors
from calflow.diagnosis.screening.screening import Screening
from calflow.diagnosis.search.background import functions
from calflow.diagnosis.search.decoys import InTime
from calflow.diagnosis.search.fitted import Fitted
from calflow.effects import Effect
from calflow.effects.cause import Cause

Kind = Literal["nothing", "cause", "background", "pose"]
KINDS: tuple[Kind, ...] = ("nothing", "cause", "background", "pose")  # as likely as each other before any data
TIMES_USUAL = 0.5 ** np.arange(-1.0, 6.0)  # sizes of a cause, over what is usual for it: from twice to a thirtieth
TIMES_NOISE = 2.0 ** np.arange(-3.0, 5.0)  # sizes of a background, over the noise: from an eighth to sixteen times


@dataclass(frozen=True, eq=False)
class Form:
    """A form of what may be lacking: effects at nothing, which of their columns are its own, and these' usual sizes (n,)."""

    kind: Kind
    name: str
    effects: tuple[Effect, ...]
    columns: np.ndarray
    sd: np.ndarray

    @property
    def of_robot(self) -> bool:
        """Whether it moves the tool; what only the device makes of it does not."""
        if self.kind == "background":
            return not any(isinstance(effect, InTime) for effect in self.effects)
        return not any(isinstance(effect, Cause) and effect.effect.of_device() for effect in self.effects)


@dataclass(frozen=True, eq=False)
class Lack:
    """A form in one size, with its logarithmic weight: prior times likelihood; amplitudes are in units of the form's sd."""

    form: Form
    size: float
    log_weight: float

    @property
    def alone(self) -> float:
        """Size of an error of each row for itself, over the noise."""
        return self.size if self.form.kind == "pose" else 0.0


@dataclass(frozen=True, eq=False)
class Lacks:
    """What a fitted model may lack, and the linearised model beside which it was weighed, with all these effects."""

    fitted: Fitted
    effects: tuple[Effect, ...]
    regressors: Regressors[Cause]
    every: tuple[Lack, ...]

    @staticmethod
    def of(fitted: Fitted, catalogue: Catalogue) -> Lacks:
        """Weigh all that a fitted model may lack beside the noise and a discrepancy that is significant."""
        bare = replace(fitted, background=None)
        kinds = [(inputs, effects) for inputs, effects in functions(bare)]
        smooth = [effect for _, effects in kinds for effect in effects]
        effects = (*catalogue.effects, *smooth)
        regressors = bare.regressors(effects)
        seen = Screening(regressors)
        n_smooth = sum(len(effect.declared) for effect in smooth)
        forms = [*_causes(regressors, fitted.causes, smooth), *_backgrounds(regressors, kinds, n_smooth)]
        weighed = [one for kind in KINDS for one in _weighed(seen, kind, forms)]
        return Lacks(bare, effects, regressors, tuple(weighed))

    @cached_property
    def weights(self) -> np.ndarray:
        """How probable each is, shape (n_lacks,)."""
        logs = np.array([one.log_weight for one in self.every])
        return np.asarray(np.exp(logs - logsumexp(logs)))

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the free parameters where the model lacks nothing, (n_free, n_free)."""
        return self.parameters(0.0)[1]

    def parameters(self, alone: float) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (n_free,), from the estimate, and covariance (n_free, n_free) of the free parameters.

        alone is an error of each row for itself, over the noise.
        """
        covariance = np.linalg.inv(_information(self.regressors, 1 + alone**2))
        return -covariance @ _gradient(self.regressors, 1 + alone**2), covariance

    @cached_property
    def screening(self) -> Screening[Cause]:
        """What the data tell of any column beside the model."""
        return Screening(self.regressors)

    def amplitude(self, lack: Lack) -> tuple[np.ndarray, np.ndarray]:
        """Return mean (n,) and covariance (n, n) of a lack's amplitudes, in their own units."""
        own, sd = lack.form.columns, lack.form.sd * lack.size
        shown = self.screening.information(own) * np.outer(sd, sd)
        covariance = np.linalg.inv(np.eye(len(own)) + shown)
        return -sd * (covariance @ (sd * self.screening.score[own])), covariance * np.outer(sd, sd)

    def response(self, columns: np.ndarray) -> np.ndarray:
        """Return by how much the fit makes up for a unit of each column, (n_free, n_columns)."""
        return np.asarray(-self.covariance @ self.regressors.products.mixed[:, columns])

    def probability(self, kind: Kind, name: str = "") -> float:
        """Return how probable a kind is, or all sizes and forms of that name."""
        own = [one.form.kind == kind and (not name or one.form.name == name) for one in self.every]
        return float(self.weights[np.array(own)].sum())


def _causes(regressors: Regressors[Cause], known: Sequence[Cause], smooth: Sequence[Effect]) -> Iterator[Form]:
    """Every cause that the model does not have at the same place already."""
    places, decoys = {cause.place for cause in known}, set(map(id, smooth))
    for candidate in regressors.candidates:
        cause, columns = candidate.cause, candidate.columns
        if id(cause.effect) not in decoys and cause.place not in places:
            yield Form("cause", label(cause.id, cause.joint), (cause,), columns, regressors.prior_sd[columns])


def _backgrounds(
    regressors: Regressors[Cause], kinds: Sequence[tuple[tuple[str, ...], Sequence[Effect]]], n_smooth: int
) -> Iterator[Form]:
    """Smooth functions of each input, of the noise's size over the rows; their columns are the regressors' last ones."""
    start = regressors.matrix.shape[1] - n_smooth
    for inputs, effects in kinds:
        number = sum(len(effect.declared) for effect in effects)
        columns = start + np.arange(number)
        spectrum = np.concatenate([effect.spectrum for effect in effects])  # type: ignore[attr-defined]
        sd = regressors.prior_sd[columns] * spectrum
        moved = float(np.sqrt(regressors.products.squared[columns] @ sd**2 / len(regressors.residual)))
        start += number
        if moved > 0:
            yield Form("background", " and ".join(inputs), tuple(effects), columns, sd / moved)


def _weighed(seen: Screening[Cause], kind: Kind, forms: Sequence[Form]) -> Iterator[Lack]:
    """Weigh all forms of one kind: its names alike, and in each its forms and sizes."""
    nothing = Form(kind, kind, (), np.arange(0), np.zeros(0))
    if kind == "nothing":
        yield Lack(nothing, 0.0, 0.0)
    elif kind == "pose":
        for size in TIMES_NOISE:
            yield Lack(nothing, float(size), _alone(seen, float(size)) - np.log(len(TIMES_NOISE)))
    else:
        own = [form for form in forms if form.kind == kind]
        names = Counter(form.name for form in own)
        sizes = TIMES_USUAL if kind == "cause" else TIMES_NOISE
        for form in own:
            prior = -np.log(len(names) * names[form.name] * len(sizes))
            for size, log_likelihood in zip(sizes, _likelihoods(seen, form, sizes), strict=True):
                yield Lack(form, float(size), float(log_likelihood) + prior)


def _likelihoods(seen: Screening[Cause], form: Form, sizes: np.ndarray) -> np.ndarray:
    """Return the logarithms of the likelihood with a form in each size, over that without it, shape (n_sizes,)."""
    shown = seen.information(form.columns) * np.outer(form.sd, form.sd)
    value, turned = np.linalg.eigh(shown)
    along, value = (turned.T @ (form.sd * seen.score[form.columns])) ** 2, np.maximum(value, 0.0)
    widened = 1 + sizes[:, None] ** 2 * value
    return np.asarray((sizes[:, None] ** 2 * along / widened - np.log(widened)).sum(axis=1) / 2)


def _alone(seen: Screening[Cause], size: float) -> float:
    """Return the same of an error of each row for itself, which is as if the noise were larger."""
    r, level = seen.regressors, 1 + size**2
    information, gradient = _information(r, level), _gradient(r, level)
    chi2 = float(r.residual @ r.residual / level + r.prior_rss - gradient @ np.linalg.solve(information, gradient))
    spent = len(r.residual) * np.log(level) + np.linalg.slogdet(information)[1]
    spent -= np.linalg.slogdet(_information(r, 1.0))[1]
    return float(seen.chi2 - chi2 - spent) / 2


def _information(r: Regressors[Cause], level: float) -> np.ndarray:
    """What the data, whose noise's variance is so many times larger, and the priors tell of the free parameters."""
    return np.asarray(r.products.fitted / level + np.diag(r.precision))


def _gradient(r: Regressors[Cause], level: float) -> np.ndarray:
    """The slope of half of chi² by the free parameters at the estimate."""
    return np.asarray(r.products.fitted_left / level + r.pull)
