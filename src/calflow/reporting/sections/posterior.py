"""Posterior: convergence of its chains, comparison with the Laplace approximation, and influence of the prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter

from calflow.deployment.run_outcome import RunOutcome
from calflow.effects.wording import cause_name
from calflow.files.deferred import pd
from calflow.files.words import cut, listed, readable, rounded, with_sd
from calflow.reporting.advice import ENSEMBLES_AGREE, lengthen
from calflow.reporting.blocks import Block, Heading, Paragraph, Plot, Table, listing
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.reporting.style import ACCENT, ALONE, DARK, LIGHT, WIDTH, figure, panels
from calflow.robot.parts import Parameter
from calflow.sampling.log_posterior import LogPosterior, log_posterior_of
from calflow.sampling.posterior import ChainSummary, told_by_prior

BINS = 32
SMOOTH = 0.7  # bins, of the density in a pair
SHARES = (0.95, 0.68)  # of the posterior within contours
SHOWN_STEPS = 600
TRACED, PAIRED = 3, 6  # parameters in the figures
CORNER_DRAWS = 40_000
SAVED_DRAWS = 2_000  # of the figure's draws, in its data
INTRODUCTION = (
    "The standard deviations of the fit assume a linear model and no bound nearby. Markov chains (MCMC) sample the posterior "
    "within the bounds. Agreement of the two confirms the standard deviations."
)
LINEAR = " As this model has smooth errors, it is linearised for the sampling too."
TRACES = (
    "The parameters that mix worst. Thick lines: median over the walkers of each ensemble; thin: the middle 95 %. Level "
    "bands that coincide show that the ensembles agree and are long enough."
)
CORNER = (
    "Posterior of parameters at a bound and of those most correlated: grey is density, lines enclose 68 % and 95 %. Narrow "
    "slanted shapes are pairs of which only a combination is determined."
)
HELD = (
    "Fixed at their estimates, having too many parameters to sample: {}. Their uncertainty is not in the sampled standard "
    "deviations."
)
NOISE = "The sampled noise is {:.2f} times that of the fit (95 % interval {:.2f} to {:.2f})."


def traces(steps: np.ndarray, chain: np.ndarray, labels: Sequence[str], discard: int) -> Figure:
    """Draw each ensemble's median and 95 % band over its walkers at each step.

    chain has shape (n_ensembles, n_steps, n_walkers, n_parameters); steps before discard were not used.
    """
    drawn, grid = panels(len(labels), 1, 0.5 + 0.95 * len(labels), sharex=True)
    for k, (axes, label) in enumerate(zip(grid[:, 0], labels, strict=True)):
        bands = np.quantile(chain[..., k], [0.5, 0.025, 0.975], axis=2)
        axes.axvspan(0, discard, color=LIGHT, alpha=0.6, linewidth=0)
        for e, (colour, line, _) in zip(range(len(chain)), cycle(ALONE), strict=False):
            for band, width in zip(bands, (0.9, 0.5, 0.5), strict=True):
                named = f"ensemble {e + 1}" if k == 0 and width == 0.9 else None
                axes.plot(steps, band[e], color=colour, linestyle=line, linewidth=width, label=named)
        axes.set_ylabel(label)
        axes.margins(x=0)
        axes.locator_params(axis="y", nbins=4)
    grid[-1, 0].set_xlabel("step (grey: left out as burn-in)")
    drawn.align_ylabels()
    drawn.legend(loc="outside upper center", ncols=5)
    return drawn


def corner(draws: np.ndarray, labels: Sequence[str]) -> Figure:
    """Draw the posterior of every pair of parameters; draws has shape (n_draws, n_parameters).

    Grey is density; the lines enclose 68 % and 95 %.
    """
    n = len(labels)
    drawn = figure(0.4 + 0.68 * n, 0.5 + 0.85 * n)
    drawn.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02, wspace=0.02, hspace=0.02)
    grid = drawn.add_gridspec(n, n)
    low, high = draws.min(axis=0), draws.max(axis=0)
    ends = np.column_stack([low, high]) + np.outer(high - low, (-0.05, 0.05))
    for i in range(n):
        for j in range(i + 1):
            axes = drawn.add_subplot(grid[i, j], xlim=ends[j])
            axes.grid(visible=False)
            if i == j:
                axes.hist(draws[:, i], BINS, histtype="stepfilled", color=LIGHT, edgecolor=DARK, linewidth=0.8)
            else:
                _density(axes, draws[:, j], draws[:, i])
            axes.locator_params(nbins=3)
            axes.tick_params(labelsize=6)
            axes.tick_params("x", labelrotation=30)
            # Hidden ticks would be laid out too.
            if i < n - 1:
                axes.set_xticks([])
            if j > 0 or i == 0:
                axes.set_yticks([])
            axes.set(xlabel=labels[j] if i == n - 1 else "", ylabel=labels[i] if j == 0 < i else "")
    drawn.align_xlabels(drawn.axes[-n:])
    drawn.align_ylabels([axes for axes in drawn.axes if axes.get_ylabel()])
    return drawn


def _density(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    counts, x_edges, y_edges = np.histogram2d(x, y, BINS)
    counts = gaussian_filter(counts, SMOOTH)
    ends = (x_edges[0], x_edges[-1], y_edges[0], y_edges[-1])
    axes.imshow(counts.T, cmap="Greys", origin="lower", aspect="auto", extent=ends, interpolation="nearest")
    ordered = np.sort(counts.ravel())[::-1]
    inside = np.cumsum(ordered) / ordered.sum()
    levels = sorted({float(ordered[np.searchsorted(inside, share)]) for share in SHARES} - {0.0, float(ordered[0])})
    if levels:
        middle = [(edges[1:] + edges[:-1]) / 2 for edges in (x_edges, y_edges)]
        axes.contour(*middle, counts.T, levels=levels, colors=[ACCENT], linewidths=0.8)


@dataclass(frozen=True)
class ThinnedChain:
    """Walkers in the coordinates of the sampling, shape (n_ensembles, n_shown, n_walkers, n_dimensions), at some steps."""

    posterior: LogPosterior
    walkers: np.ndarray
    steps: np.ndarray
    discard: int

    @staticmethod
    def read(path: Path, material: Material) -> ThinnedChain:
        """Read the steps that the stage sample used, and rebuild the coordinates in which it sampled them."""
        import h5py

        posterior, _ = log_posterior_of(material.sampled[0], material.data)
        summary = material.chain_summary
        steps, discard = summary.steps, summary.burn_in_steps
        stride = -(-steps // SHOWN_STEPS)
        with h5py.File(path, "r") as file:
            names = sorted(file, key=lambda name: (len(name), name))
            walkers = np.array([file[name]["chain"][:steps:stride] for name in names])
        return ThinnedChain(posterior, walkers, np.arange(0, steps, stride), discard)

    def values(self, which: np.ndarray) -> np.ndarray:
        """Return these parameters [SI], the last one being the noise factor, shape (…, n_walkers, n_which)."""
        values = self.posterior.parameters(self.walkers)[..., which]
        return np.where(which == self.posterior.n_dimensions - 1, np.exp(values), values)

    def draws(self, which: np.ndarray, number: int) -> np.ndarray:
        """Return evenly spaced draws after the burn-in, shape (at most about number, n_which)."""
        kept = self.values(which)[:, self.steps >= self.discard].reshape(-1, len(which))
        return kept[:: max(1, len(kept) // number)]


def _posterior(material: Material) -> list[Block]:
    """Tabulate the checks, and draw traces and correlated pairs."""
    posterior, summary = material.tables["sample/posterior.csv"], material.chain_summary
    model, held = material.sampled
    free = ~model.at_bound
    ratio = posterior["sd"].to_numpy(dtype=float)[: len(free)][free] / np.sqrt(np.diag(model.covariance))[free]
    return [
        Paragraph(INTRODUCTION + LINEAR * bool(model.errors.functions), keep=True),
        Table(("check", "value", "criterion"), _checks(posterior, ratio, summary), "lll"),
        *listing(cut_words(summary)),
        *listing(prior_words(posterior)),
        *([Paragraph(HELD.format(listed([cause_name(cause.id, cause.joint) for cause in held])))] if held else []),
        *_chain(material),
        *(
            Paragraph(NOISE.format(q500, q025, q975))
            for name, q025, q500, q975 in posterior[["parameter", "q025", "q500", "q975"]].to_numpy()
            if name == "noise.factor"
        ),
    ]


def _checks(posterior: pd.DataFrame, ratio: np.ndarray, summary: ChainSummary) -> list[tuple[str, str, str]]:
    worst, least = posterior.sort_values("rhat").iloc[-1], posterior.sort_values("ess").iloc[0]
    over = f"{np.nanmin(ratio):.2f} to {np.nanmax(ratio):.2f}" if len(ratio) else "every parameter is at a bound"
    return [
        (
            "agreement of ensembles (largest R-hat)",
            f"{worst['rhat']:.4f} ({worst['parameter']})",
            f"below {ENSEMBLES_AGREE:g}",
        ),
        ("effective sample size (smallest)", f"{least['ess']:,.0f} ({least['parameter']})", "thousands"),
        ("ratio of sampled sd to that of the fit", over, "near 1"),
        *([("length", f"{summary.steps} steps", lengthen(summary))] if summary.missing_steps else []),
    ]


def cut_words(summary: ChainSummary) -> list[str]:
    """Return a sentence on the parameters whose posteriors are cut by their bounds."""
    bounds = [
        f"{parameter.parameter} ({rounded(factor * parameter.lower)} to {rounded(factor * parameter.upper)} {unit})"
        for parameter in summary.cut
        for factor, unit in [readable(parameter.unit)]
    ]
    return [f"Bounds cut the posterior of {listed(bounds)}: use its quantiles, not its mean and sd."] if bounds else []


def prior_words(posterior: pd.DataFrame) -> list[str]:
    """Return sentences on the parameters that the prior determines, alone or with the data."""
    names = posterior["parameter"].astype(str)
    assumed, both = (names[rows].tolist() for rows in told_by_prior(posterior))
    this = "this is" if len(assumed) == 1 else "these are"
    alone = (
        f"{listed(assumed)}: {this} your prior, not your data. The estimate depends on the prior of the parameter, or of one "
        "correlated with it, and hardly on the measurements."
    )
    partly = f"{listed(both)}: prior and data both count; a narrower prior would change the result."
    return [alone] * bool(assumed) + [partly] * bool(both)


def _chain(material: Material) -> list[Block]:
    if material.chain is None:
        return []
    posterior = material.tables["sample/posterior.csv"]
    chain = ThinnedChain.read(material.chain, material)
    names = posterior["parameter"].astype(str).tolist()
    shown = [*short_names(material.sampled[0].model.parameters), names[-1]]
    units = [readable(str(unit)) for unit in posterior["unit"]]

    def labels(which: Sequence[int]) -> list[str]:
        return [f"{shown[k]}\n[{units[k][1]}]" if units[k][1] else shown[k] for k in which]

    def factors(which: Sequence[int]) -> np.ndarray:
        return np.array([units[k][0] for k in which])

    slow = np.argsort(posterior["ess"].to_numpy(dtype=float), kind="stable")[:TRACED].tolist()
    traced = traces(chain.steps, chain.values(np.array(slow)) * factors(slow), labels(slow), chain.discard)
    blocks: list[Block] = [Plot("traces", traced, TRACES, _courses(chain, slow, labels(slow), factors(slow)))]
    pairs = [names.index(name) for name in corner_names(material)]
    if len(pairs) > 1:
        draws = chain.draws(np.array(pairs), CORNER_DRAWS) * factors(pairs)
        drawn = corner(draws, labels(pairs))
        some = draws[:: max(1, len(draws) // SAVED_DRAWS)]
        thinned = pd.DataFrame(some, columns=[name.replace("\n", " ") for name in labels(pairs)])
        width = round(100 * drawn.get_figwidth() / WIDTH)
        rows = [_row(posterior.iloc[k]) for k in pairs]
        blocks += [
            Heading("Correlated parameters"),
            Plot("corner", drawn, CORNER, thinned, width),
            Table(("parameter", "unit", "mean", "sd", "2.5 %", "median", "97.5 %"), rows, "llrrrrr"),
        ]
    return blocks


def _courses(chain: ThinnedChain, which: Sequence[int], labels: Sequence[str], factors: np.ndarray) -> pd.DataFrame:
    """Return the data of the traces: median and middle 95 % of each parameter and ensemble at each step."""
    quantiles = np.quantile(chain.values(np.array(which)) * factors, [0.025, 0.5, 0.975], axis=2)
    tables = []
    for e, k in np.ndindex(quantiles.shape[1], len(labels)):
        low, middle, high = quantiles[:, e, :, k]
        columns = {"step": chain.steps, "q025": low, "median": middle, "q975": high}
        tables.append(pd.DataFrame({"parameter": labels[k].replace("\n", " "), "ensemble": e + 1, **columns}))
    return pd.concat(tables)


def corner_names(outcome: RunOutcome) -> list[str]:
    """Return up to six parameters to show in pairs: at a bound, then most correlated, then of the last effect."""
    parameters = outcome.fitted_parameters
    names = [row.parameter for row in parameters if row.at_bound][:2]
    names += [name for pair in outcome.correlations for name in (pair.first, pair.second)]
    names += [row.parameter for row in parameters if row.effect == parameters[-1].effect]
    path = "sample/posterior.csv"
    sampled = set(outcome.tables[path]["parameter"] if path in outcome.results else names)
    chosen = [name for name in dict.fromkeys(names) if name in sampled][:PAIRED]
    return [row.parameter for row in parameters if row.parameter in chosen]


def short_names(parameters: Sequence[Parameter]) -> list[str]:
    """Return names for a figure's axis: part and symbol where unique, else a parameter's full name."""
    short = [f"{parameter.part}.{parameter.symbol}" for parameter in parameters]
    return [
        cut(name if short.count(name) == 1 else parameter.name)
        for name, parameter in zip(short, parameters, strict=True)
    ]


def _row(row: pd.Series) -> tuple[str, ...]:
    factor, unit = readable(str(row["unit"]))
    sd = factor * float(row["sd"])
    cells = [with_sd(factor * float(row[name]), sd)[0] for name in ("mean", "q025", "q500", "q975")]
    return (str(row["parameter"]), unit, cells[0], with_sd(0.0, sd)[1], *cells[1:])


POSTERIOR_SECTION = Section(75, "How sure: the sampled posterior", "sample/posterior.csv", _posterior)
