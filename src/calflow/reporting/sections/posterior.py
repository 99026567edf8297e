"""Posterior: convergence of its chains, comparison with the Laplace approximation, and influence of the prior."""

from __future__ import annotations

from collections.abc import Sequence
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
from calflow.reporting.section import section
from calflow.reporting.style import ACCENT, ALONE, DARK, LIGHT, WIDTH, figure, panels
from calflow.robot.parts import Parameter
from calflow.sampling.chain import Chain
from calflow.sampling.log_posterior import log_posterior_of
from calflow.sampling.posterior import ChainSummary, PosteriorRow, told_by_prior

SAMPLED = "sample/posterior.csv"
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


def traces(courses: pd.DataFrame, discard: int) -> Figure:
    """Draw each ensemble's median and 95 % band over its walkers at each step; steps before discard were not used.

    courses has columns parameter, ensemble, step, q025, median and q975.
    """
    every = courses.groupby("parameter", sort=False)
    drawn, grid = panels(len(every), 1, 0.5 + 0.95 * len(every), sharex=True)
    for axes, (parameter, course) in zip(grid[:, 0], every, strict=True):
        axes.axvspan(0, discard, color=LIGHT, alpha=0.6, linewidth=0)
        for (ensemble, rows), (colour, line, _) in zip(course.groupby("ensemble"), cycle(ALONE), strict=False):
            for name, width in (("median", 0.9), ("q025", 0.5), ("q975", 0.5)):
                named = f"ensemble {ensemble}" if axes is grid[0, 0] and name == "median" else None
                axes.plot(rows["step"], rows[name], color=colour, linestyle=line, linewidth=width, label=named)
        axes.set_ylabel(str(parameter).replace(" [", "\n["))
        axes.margins(x=0)
        axes.locator_params(axis="y", nbins=4)
    grid[-1, 0].set_xlabel("step (grey: left out as burn-in)")
    drawn.align_ylabels()
    drawn.legend(loc="outside upper center", ncols=5)
    return drawn


def corner(draws: pd.DataFrame) -> Figure:
    """Draw the posterior of every pair of parameters, a column each: grey is density; lines enclose 68 % and 95 %."""
    labels, values = [str(name).replace(" [", "\n[") for name in draws], draws.to_numpy()
    n = len(labels)
    drawn = figure(0.4 + 0.68 * n, 0.5 + 0.85 * n)
    drawn.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02, wspace=0.02, hspace=0.02)
    grid = drawn.add_gridspec(n, n)
    low, high = values.min(axis=0), values.max(axis=0)
    ends = np.column_stack([low, high]) + np.outer(high - low, (-0.05, 0.05))
    for i in range(n):
        for j in range(i + 1):
            axes = drawn.add_subplot(grid[i, j], xlim=ends[j])
            axes.grid(visible=False)
            if i == j:
                axes.hist(values[:, i], BINS, histtype="stepfilled", color=LIGHT, edgecolor=DARK, linewidth=0.8)
            else:
                _density(axes, values[:, j], values[:, i])
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


def walkers_shown(path: Path, material: Material) -> tuple[np.ndarray, np.ndarray]:
    """Return the walkers' parameters [SI], the last one the noise's factor, at some of the steps that the stage sample used.

    Shape (n_ensembles, n_shown, n_walkers, n_parameters + 1); with the numbers of these steps (n_shown,).
    """
    posterior, _ = log_posterior_of(material.sampled[0], material.data)  # it has the coordinates of the sampling
    n_steps = material.chain_summary.steps
    steps = np.arange(0, n_steps, -(-n_steps // SHOWN_STEPS))
    values = posterior.parameters(Chain.read(path).walkers(0, n_steps)[:, steps])
    values[..., -1] = np.exp(values[..., -1])
    return values, steps


@section(75, "How sure: the sampled posterior", SAMPLED)
def posterior_section(material: Material) -> list[Block]:
    """Tabulate the checks, and draw traces and correlated pairs."""
    rows, summary = material.results.rows(SAMPLED, PosteriorRow), material.chain_summary
    model, held = material.sampled
    return [
        Paragraph(INTRODUCTION + LINEAR * bool(model.errors.functions), keep=True),
        Table(("check", "value", "criterion"), _checks(rows, summary), "lll"),
        *listing(cut_words(summary)),
        *listing(prior_words(material.tables[SAMPLED])),
        *([Paragraph(HELD.format(listed([cause_name(cause.id, cause.joint) for cause in held])))] if held else []),
        *(_chain(material, material.chain, rows) if material.chain else []),
        *(Paragraph(NOISE.format(row.q500, row.q025, row.q975)) for row in rows if row.parameter == "noise.factor"),
    ]


def _checks(rows: Sequence[PosteriorRow], summary: ChainSummary) -> list[tuple[str, str, str]]:
    worst, least = max(rows, key=lambda row: row.rhat), min(rows, key=lambda row: row.ess)
    low, high = summary.sd_over_laplace_least, summary.sd_over_laplace_most
    over = "every parameter is at a bound" if low is None or high is None else f"{low:.2f} to {high:.2f}"
    criterion = f"below {ENSEMBLES_AGREE:g}"
    return [
        ("agreement of ensembles (largest R-hat)", f"{worst.rhat:.4f} ({worst.parameter})", criterion),
        ("effective sample size (smallest)", f"{least.ess:,.0f} ({least.parameter})", "thousands"),
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


def _chain(material: Material, path: Path, rows: Sequence[PosteriorRow]) -> list[Block]:
    """Draw the chain's traces of the parameters that mix worst, and its draws of correlated ones, tabulated too."""
    (values, steps), names = walkers_shown(path, material), [row.parameter for row in rows]
    units = [readable(row.unit) for row in rows]
    values, discard = values * [factor for factor, _ in units], material.chain_summary.burn_in_steps
    shown = [*short_names(material.sampled[0].model.parameters), names[-1]]
    labels = [f"{name} [{unit}]" if unit else name for name, (_, unit) in zip(shown, units, strict=True)]
    slow = sorted(range(len(rows)), key=lambda k: rows[k].ess)[:TRACED]
    courses = _courses(values[..., slow], steps, [labels[k] for k in slow])
    blocks: list[Block] = [Plot("traces", traces(courses, discard), TRACES, courses)]
    pairs = [names.index(name) for name in corner_names(material)]
    if len(pairs) > 1:
        kept = values[:, steps >= discard][..., pairs].reshape(-1, len(pairs))
        draws = pd.DataFrame(kept[:: max(1, len(kept) // CORNER_DRAWS)], columns=[labels[k] for k in pairs])
        drawn, thinned = corner(draws), draws[:: max(1, len(draws) // SAVED_DRAWS)]
        header = ("parameter", "unit", "mean", "sd", "2.5 %", "median", "97.5 %")
        blocks += [
            Heading("Correlated parameters"),
            Plot("corner", drawn, CORNER, thinned, round(100 * drawn.get_figwidth() / WIDTH)),
            Table(header, [_row(rows[k]) for k in pairs], "llrrrrr"),
        ]
    return blocks


def _courses(values: np.ndarray, steps: np.ndarray, labels: Sequence[str]) -> pd.DataFrame:
    """Return the data of the traces: median and middle 95 % of each parameter and ensemble at each step."""
    quantiles = np.quantile(values, [0.025, 0.5, 0.975], axis=2)
    tables = []
    for e, k in np.ndindex(quantiles.shape[1], len(labels)):
        low, middle, high = quantiles[:, e, :, k]
        columns = {"step": steps, "q025": low, "median": middle, "q975": high}
        tables.append(pd.DataFrame({"parameter": labels[k], "ensemble": e + 1, **columns}))
    return pd.concat(tables)


def corner_names(outcome: RunOutcome) -> list[str]:
    """Return up to six parameters to show in pairs: at a bound, then most correlated, then of the last effect."""
    parameters = outcome.fitted_parameters
    names = [row.parameter for row in parameters if row.at_bound][:2]
    names += [name for pair in outcome.correlations for name in (pair.first, pair.second)]
    names += [row.parameter for row in parameters if row.effect == parameters[-1].effect]
    sampled = set(outcome.tables[SAMPLED]["parameter"] if SAMPLED in outcome.results else names)
    chosen = [name for name in dict.fromkeys(names) if name in sampled][:PAIRED]
    return [row.parameter for row in parameters if row.parameter in chosen]


def short_names(parameters: Sequence[Parameter]) -> list[str]:
    """Return names for a figure's axis: part and symbol where unique, else a parameter's full name."""
    short = [f"{parameter.part}.{parameter.symbol}" for parameter in parameters]
    return [
        cut(name if short.count(name) == 1 else parameter.name)
        for name, parameter in zip(short, parameters, strict=True)
    ]


def _row(row: PosteriorRow) -> tuple[str, ...]:
    factor, unit = readable(row.unit)
    mean, *quantiles = (
        with_sd(factor * value, factor * row.sd)[0] for value in (row.mean, row.q025, row.q500, row.q975)
    )
    return row.parameter, unit, mean, with_sd(0.0, factor * row.sd)[1], *quantiles
