"""A linear regression that the search extends by blocks of regressors, whose solutions are exact."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from calflow.diagnosis.regressors import Candidate, Regressors, TallMatrix
from calflow.diagnosis.trial import Linearisation, Trial
from calflow.estimation.variance_components import refitted_cost
from calflow.model import consecutive


@dataclass(frozen=True, eq=False)
class Block:
    """A possible cause in one variant: its regressors (n, n_parameters), with priors about zero."""

    name: str
    matrix: np.ndarray
    prior_sd: float | np.ndarray
    variant: str = ""

    part, joint, family, alike = "", 0, "", ()
    id, detail = property(lambda self: self.name), property(lambda self: self.variant)
    place = property(lambda self: (self.name, ""))
    n_parameters = property(lambda self: self.matrix.shape[1])
    bounds = property(lambda self: np.outer([-np.inf, np.inf], np.ones(self.n_parameters)))
    sd = property(lambda self: np.broadcast_to(self.prior_sd, self.n_parameters))

    def same_form(self, other: Block) -> bool:
        """Whether another block is a variant of the same cause."""
        return self.name == other.name


@dataclass(frozen=True)
class BlockTrial(Trial):
    """A residual (n,) of a constant and noise, of sigma if nothing is lacking, with some of the blocks in the model."""

    residual: np.ndarray
    sigma: float
    every: tuple[Block, ...]
    causes: tuple[Block, ...] = ()

    def with_causes(self, causes, added=None):
        """Return the trial with these blocks instead."""
        return replace(self, causes=tuple(causes))

    @cached_property
    def design(self):
        """The constant and the blocks, (n, n_parameters)."""
        return np.hstack([np.ones((len(self.residual), 1)), *(block.matrix for block in self.causes)])

    @cached_property
    def sd(self):
        """The parameters' prior standard deviations."""
        return np.concatenate([[100.0], *(block.sd for block in self.causes)])

    @cached_property
    def noise(self):
        """The standard deviation of the noise: sigma, or where there is a lack of fit, as of least squares."""
        left = self.residual - self.design @ np.linalg.lstsq(self.design, self.residual)[0]
        freedom = len(left) - len(self.sd)
        fits = chi2.sf(left @ left / self.sigma**2, freedom) > 0.01
        return self.sigma if fits else float(np.sqrt(left @ left / freedom))

    @cached_property
    def estimate(self):
        """The parameters of the maximum posterior."""
        information = self.design.T @ self.design / self.noise**2 + np.diag(self.sd**-2.0)
        return np.linalg.solve(information, -self.design.T @ self.residual / self.noise**2)

    @property
    def left(self):
        """The residual of these parameters, over the noise."""
        return (self.residual + self.design @ self.estimate) / self.noise

    @property
    def cost(self):
        """Minus twice the log evidence."""
        scaled, sizes = self.design * self.sd / self.noise, self.estimate / self.sd
        covariance = np.linalg.inv(scaled.T @ scaled + np.eye(len(sizes)))[1:, 1:]
        variants = [sum(block.same_form(other) for other in self.every) for block in self.causes]
        fitted = [(sizes[own], number) for own, number in zip(self.columns, variants, strict=True)]
        misfit = self.left @ self.left + sizes @ sizes
        return refitted_cost(
            misfit, self.noise, self.first.degrees_of_freedom, fitted, np.linalg.slogdet(covariance)[1]
        )

    @property
    def columns(self):
        """The indices of each block's columns of the design."""
        return [np.r_[span] for span in consecutive([1, *(block.n_parameters for block in self.causes)])[1:]]

    @cached_property
    def linearisation(self):
        """The solution with the regressors of all blocks."""
        own = consecutive(block.n_parameters for block in self.every)
        matrix = TallMatrix.held(np.hstack([block.matrix for block in self.every]) / self.noise)
        candidates = tuple(Candidate(block, np.r_[span]) for block, span in zip(self.every, own, strict=True))
        regressors = Regressors(
            self.left, self.design / self.noise, self.sd**-2.0, self.estimate / self.sd**2,
            float(((self.estimate / self.sd) ** 2).sum()), matrix, np.concatenate([block.sd for block in self.every]), candidates,
        )  # fmt: skip
        return Linearisation(self.causes, regressors, self.estimate, tuple(self.columns))
