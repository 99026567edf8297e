"""A posterior: how sure every parameter is, as a notebook asks for it."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from calflow.api.inputs import check_same
from calflow.api.model import Model
from calflow.estimation.progress import Say, draws, nobody
from calflow.measurements.measurements import Measurements
from calflow.sampling.chain import ChainLength
from calflow.sampling.posterior import Posterior
from calflow.sampling.sample import sample as sampled


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
        return sampled(model.known, model.data, Path(folder) / "chain.h5", length, rng=draws(seed), say=say)
