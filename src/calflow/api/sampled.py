"""A posterior: how sure every parameter is, as a notebook holds it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from calflow.api.inputs import check_same
from calflow.api.model import Model
from calflow.estimation.progress import Say, draws, nobody
from calflow.measurements.measurements import Measurements
from calflow.sampling.models import cause_table, models_table
from calflow.sampling.posterior_tables import ChainSummary, chain_summary, posterior_table, predictive_table
from calflow.sampling.sample import ChainLength, Sampled
from calflow.sampling.sample import sample as sampled

NOISE = "noise.factor"
NO_ARVIZ = "to_inference_data needs ArviZ: pip install 'calflow[arviz]' (or arviz-base)"


@dataclass(frozen=True, eq=False, repr=False)
class Posterior:
    """A sampled posterior; its tables are those of a run's folder `sample`."""

    sampled: Sampled
    seed: int

    @cached_property
    def table(self) -> pd.DataFrame:
        """Each parameter's mean, quantiles and convergence (see `sample/posterior.csv`)."""
        return posterior_table(self.sampled)

    @cached_property
    def predictive(self) -> pd.DataFrame:
        """Each row's error, and the interval in which it should be (see `sample/predictive.csv`)."""
        return predictive_table(self.sampled, draws(self.seed)("predictive"))

    @cached_property
    def models(self) -> pd.DataFrame:
        """The models that may be right, and how probable each is (see `sample/models.csv`); none where nothing was found."""
        return models_table(self.sampled.models)

    @cached_property
    def causes(self) -> pd.DataFrame:
        """How probable each cause of these models is (see `sample/cause_probabilities.csv`)."""
        return cause_table(self.sampled.models)

    @cached_property
    def summary(self) -> ChainSummary:
        """Length and mixing of the chain."""
        return chain_summary(self.sampled, self.table)

    @property
    def names(self) -> list[str]:
        """The parameters' names, the noise's factor last."""
        return [*(parameter.name for parameter in self.sampled.known.model.parameters), NOISE]

    @cached_property
    def values(self) -> np.ndarray:
        """All draws [SI], shape (n_ensembles, n_steps, n_walkers, n_names)."""
        values = self.sampled.values.copy()
        values[..., -1] = np.exp(values[..., -1])
        return values

    @cached_property
    def draws(self) -> pd.DataFrame:
        """All draws [SI], a row a draw: ensemble, walker and step, and a column a parameter."""
        n_ensembles, n_steps, n_walkers, n = self.values.shape
        index = pd.MultiIndex.from_product(
            [range(n_ensembles), range(n_steps), range(n_walkers)], names=["ensemble", "step", "walker"]
        )
        return pd.DataFrame(self.values.reshape(-1, n), columns=self.names, index=index).reset_index()

    def to_inference_data(self) -> Any:
        """Return the draws as ArviZ takes them; each walker is a chain.

        The groups are `posterior`, and `log_prior` and `log_likelihood` of all parameters and of all rows together, as ArviZ's
        `psense` wants them; `loo` would want them row by row.

        Raises:
            ImportError: ArviZ is not installed.
        """
        try:
            from arviz_base import from_dict
        except ImportError:
            raise ImportError(NO_ARVIZ) from None

        def by_walker(draws: np.ndarray) -> np.ndarray:
            return np.concatenate(draws.swapaxes(1, 2))

        chains = by_walker(self.values)
        return from_dict({
            "posterior": {name: chains[..., k] for k, name in enumerate(self.names)},
            "log_prior": {"parameters": by_walker(self.sampled.log_prior)},
            "log_likelihood": {"measurements": by_walker(self.sampled.log_likelihood)},
        })  # fmt: skip

    def __repr__(self) -> str:
        found = self.summary
        short = f"; about {found.missing_steps} more steps are needed" if found.missing_steps else ""
        return (f"Posterior of {len(self.names)} parameters: {found.ensembles} ensembles of {found.walkers} walkers, "
                f"{found.steps} steps, worst R-hat {found.worst_rhat:.3f}{short}")  # fmt: skip

    def _repr_html_(self) -> str:
        return f"<p>{self!r}</p>{self.table.to_html(index=False)}"


def sample(
    model: Model,
    data: Measurements,
    *,
    ess: int = ChainLength.ess,
    max_steps: int = ChainLength.max_steps,
    ensembles: int = ChainLength.ensembles,
    walkers: int | None = None,
    block: int = ChainLength.block,
    independent: float = ChainLength.independent,
    seed: int = 1,
    say: Say = nobody,
) -> Posterior:
    """Sample the posterior of a calibrated model's parameters.

    Args:
        model: of a fit or of a diagnosis.
        data: the measurements that it is from.
        ess: effective number of draws at which it is enough.
        max_steps: the most steps of a walker.
        ensembles: independent ensembles of walkers.
        walkers: in each ensemble; None: twice the number of parameters.
        block: steps that are made before it is looked whether they are enough.
        independent: share of the independence proposal.
        seed: of all draws.
        say: is told how it goes on.

    Raises:
        InputError: the measurements are others than the model's, or the walkers are too few.
    """
    check_same(data, model.measured)
    length = ChainLength(ensembles, walkers, block, max_steps, ess, independent)
    with TemporaryDirectory() as folder:
        chain = sampled(model.known, model.data, Path(folder) / "chain.h5", length, rng=draws(seed), say=say)
    return Posterior(chain, seed)
