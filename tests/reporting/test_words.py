"""Numbers and names in words, and units that are easy to read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calflow.deployment.run_outcome import RunOutcome
from calflow.estimation.accuracy import Accuracy
from calflow.estimation.model_tables import FitSummary, Solver
from calflow.estimation.parameters import FittedParameter
from calflow.files.tables import Results, from_frame, to_frame
from calflow.files.words import interval, listed, mm, number, part_words, plural, readable, rounded, with_sd
from calflow.reporting.sections.parameters import known_from, lines
from calflow.reporting.sections.posterior import corner_names, short_names
from calflow.reporting.sections.verdict import step_name
from calflow.reporting.style import magnification
from calflow.robot.parts import Parameter


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (866.0254, "866.0"),
        (30.4622, "30.46"),
        (1.7533, "1.75"),
        (0.04458, "0.045"),
        (0.00123, "0.0012"),
        (0.0, "0.000"),
        (float("nan"), "–"),
    ],
)
def test_millimetres(value: float, words: str) -> None:
    assert mm(value) == words


@pytest.mark.parametrize(
    ("value", "digits", "words"),
    [
        (1893.7, 3, "1,890"),
        (0.5, 3, "0.5"),
        (2e-5, 2, "0.00002"),
        (-12.34, 3, "-12.3"),
        (0.0, 3, "0"),
        (np.inf, 2, "–"),
    ],
)
def test_no_figure_is_a_power_of_ten(value: float, digits: int, words: str) -> None:
    """Fails if a reader is told 1.89e+03 mm, or digits that were not asked for."""
    assert rounded(value, digits) == words


@pytest.mark.parametrize(
    ("value", "sd", "words"),
    [
        (5.018467, 0.0139, ("5.018", "0.014")),
        (-0.2807, 1.769, ("−0.3", "1.8")),
        (-0.01, 2.0, ("0.0", "2.0")),
        (123.4, 56.0, ("123", "56")),
        (0.0192, float("nan"), ("0.0192", "–")),
        (1.5e-9, 2e-10, ("1.5000e−09", "2.0e-10")),
    ],
)
def test_a_value_has_the_digits_that_its_sd_allows(value: float, sd: float, words: tuple[str, str]) -> None:
    assert with_sd(value, sd) == words


@pytest.mark.parametrize(
    ("unit", "value", "shown"),
    [
        ("m", 0.005, "5 mm"),
        ("rad", 2e-3, "2 mrad"),
        ("rad/Nm", 1.8e-7, "0.18 µrad/Nm"),
        ("1", 0.5, "0.5 "),
        ("kg", 3.0, "3 kg"),
    ],
)
def test_units_are_easy_to_read(unit: str, value: float, shown: str) -> None:
    factor, name = readable(unit)
    assert f"{factor * value:.4g} {name}" == shown


def test_lists_and_counts() -> None:
    assert listed([]) == "none"
    assert listed(["a"]) == "a"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed(range(20), 3) == "0, 1, 2 and 17 more"
    assert (plural(1, "row"), plural(2, "row")) == ("1 row", "2 rows")


def test_axes_have_short_names_where_these_are_clear() -> None:
    """Fails if two parameters of a figure share a name, or a long name stands where a short one would do."""
    rows = [
        ("joint2", "alpha", ""),
        ("joint3", "cos", "wave[order 1]"),
        ("joint3", "cos", "wave[order 2]"),
        ("base", "c", "tilt"),
    ]
    parameters = [Parameter("any", part, symbol, "rad", 1.0, -1.0, 1.0, tag=tag) for part, symbol, tag in rows]
    assert short_names(parameters) == ["joint2.alpha", "joint3.wave[order 1].cos", "joint3.wave[order 2].cos", "base.c"]


def test_parts_have_their_number_apart() -> None:
    """Fails if a reader is shown an id, or a marker's name is taken to pieces."""
    assert [part_words(part) for part in ("joint2", "link12", "base", "T20")] == ["joint 2", "link 12", "base", "T20"]


def test_numbers_have_a_true_minus_and_none_before_zero() -> None:
    assert number(-1.25, ".1f") == "−1.2"
    assert number(-0.01, ".1f") == "0.0"
    assert interval(-3000.0, 3000.0) == "−3,000 … 3,000"


@pytest.mark.parametrize(
    ("share", "at_bound", "together", "words"),
    [
        (0.01, False, False, "data"),
        (0.01, False, True, "data, only in combination"),
        (0.3, False, False, "data, little prior"),
        (0.7, False, True, "mostly prior"),
        (0.97, False, False, "prior alone"),
        (0.01, True, False, "data, at a bound"),
        (1.0, True, False, "at a bound, data say nothing"),
    ],
)
def test_where_a_value_is_known_from(share: float, at_bound: bool, together: bool, words: str) -> None:
    assert known_from(share, at_bound, together) == words


@pytest.mark.parametrize("size", [1e-3, 0.04, 3.0, 250.0])
def test_arrows_are_magnified_by_a_round_factor_to_a_visible_length(size: float) -> None:
    rng = np.random.default_rng(0)
    position, error = rng.uniform(0, 2000, (200, 3)), size * rng.standard_normal((200, 3))
    factor = magnification(position, error)
    digit = factor / 10 ** np.floor(np.log10(factor))
    assert digit == pytest.approx([1, 2, 5][np.argmin(np.abs(np.array([1, 2, 5]) - digit))])
    assert 0.03 < np.quantile(np.linalg.norm(factor * error, axis=1), 0.9) / 2000 < 0.1
    assert magnification(position, 0 * error) == 1


def test_steps_are_named_by_what_they_add() -> None:
    named = (("nominal", 0, ""), ("geometry", 1, "geometry"), ("geometry + joint-compliance", 2, "joint-compliance"))
    rows = [
        Accuracy(model=model, split="holdout", n=3, mean_mm=1.0, rms_mm=1.0, max_mm=2.0, step=step, effect=effect)
        for model, step, effect in (*named, ("other", 1, "other"))
    ]
    results = Results({"identify/accuracy.csv": to_frame(rows, Accuracy)})
    assert [step_name(step) for step in RunOutcome(results).steps_on("holdout")] == [
        "nominal robot",
        "geometry",
        "+ joint compliance",
        "other",
    ]
    assert RunOutcome(results).steps_on("train") == []


def test_lack_of_fit_is_a_factor_on_the_noise() -> None:
    solver = Solver(status="Solve_Succeeded", iterations=9)
    known = FitSummary(noise_sources=("repeats",), noise=(), sigma_mm=0.05, discrepancies={"mm": 0.0}, rest_mm=0.0,
                       loss="linear",
                       converged=True, reduced_chi2=20.25, lack_of_fit_p=0.0, solver=solver)  # fmt: skip
    assert known.lack_of_fit == pytest.approx(4.5)
    assert np.isnan(replace(known, noise_sources=("estimated",)).lack_of_fit)


UNTOLD = {
    "joint": 0,
    "prior_mean": 0.0,
    "prior_sd": 0.0,
    "fixed": False,
    "figure": 0.0,
    "calibrated": 0.0,
    "meaning": "",
    "of_size": False,
}


def test_corner_shows_bounds_then_correlated_pairs_then_compliances() -> None:
    names = [f"p{i}" for i in range(9)]
    parameters = pd.DataFrame(
        {
            "parameter": names,
            "effect": ["geometry"] * 7 + ["joint-compliance"] * 2,
            "at_bound": [i == 3 for i in range(9)],
        }
    ).assign(**UNTOLD, part="", symbol="", variant="", unit="", nominal=0.0, estimate=0.0, sd=0.0, lower=0.0, upper=0.0,
             prior_share=0.0)  # fmt: skip
    pairs = pd.DataFrame({"first": ["p5"], "second": ["p1"], "correlation": [-0.99]})
    tables = {"identify/parameters.csv": parameters, "identify/correlations.csv": pairs}
    assert corner_names(RunOutcome(Results(tables))) == ["p1", "p3", "p5", "p7", "p8"]


def test_a_curves_figures_stand_in_one_line() -> None:
    """Fails if pages of a report are filled with figures of a curve, or single parameters are told with them."""
    wave = [f"wave{k}" for k in range(30)]
    parameters = pd.DataFrame({"symbol": ["a", *wave, "d"], "part": ["joint1", *["joint1"] * 30, "joint2"]}).assign(
        effect=["geometry", *["joint-error-map"] * 30, "geometry"], variant="", unit=["m", *["rad"] * 30, "m"], nominal=0.0,
        estimate=[1e-3, *np.linspace(-2e-4, 3e-4, 30), 2e-3], sd=1e-5, lower=-1.0, upper=1.0, at_bound=False, prior_share=0.0,
    )  # fmt: skip
    parameters["parameter"] = parameters["part"] + "." + parameters["symbol"]
    told, _ = lines(from_frame(parameters.assign(**UNTOLD), FittedParameter), set())
    assert [row if isinstance(row, str) else row[0] for row in told] == [
        "geometry", "joint1.a", "joint error map", "joint1, 30 figures", "geometry", "joint2.d"
    ]  # fmt: skip
    assert told[3][1:4] == ("mrad", "−0.2 … 0.3", "0.01 … 0.01")
