"""The shipped studies reach what they promise, run as a user runs them."""

from __future__ import annotations

import json
import os
import re
import runpy
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calflow.study import load_study
from conftest import in_process
from forked import forked
from reporting.page_one import of_run, unreadable

STUDIES = Path(__file__).parents[1] / "studies"
UR10 = STUDIES / "ur10-tmac"
TRUE_COMPLIANCE = {"joint2.s": 1.792e-7, "joint3.s": 1.915e-7, "joint4.s": 1.959e-7, "joint5.s": 1.820e-7}  # rad/Nm
measured_data = pytest.mark.skipif(
    "CALFLOW_DATA" not in os.environ, reason="CALFLOW_DATA names no folder of measured data"
)


def calflow(*arguments: object) -> str:
    """Run the command line; its output."""
    done = forked("-m", "calflow", *arguments, cwd=Path.cwd())
    assert done.returncode == 0, done.stderr
    return done.stdout


def heldout(folder: Path) -> pd.DataFrame:
    """Held-out rows of the accuracy table, by model."""
    accuracy = pd.read_csv(folder / "identify" / "accuracy.csv")
    return accuracy[accuracy["split"] == "holdout"].set_index("model")


@pytest.fixture(scope="session")
def hh800(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of the whole study but for its report; test_docs.py has one of a whole study."""
    folder = tmp_path_factory.mktemp("hh800")
    for stage in ("select", "diagnose", "sample"):
        calflow("run", STUDIES / "hh800" / "study.toml", "--out", folder, "--stage", stage)
    return folder


def test_hh800_reaches_the_noise_floor(hh800):
    """Fails if the fit, the loop, the compliance or the split goes wrong: the paper's Table 2 and better."""
    table = heldout(hh800)
    full = table.loc["geometry + joint-compliance"]
    assert table.loc["nominal", "mean_mm"] == pytest.approx(29.74, rel=0.1)
    assert table.loc["geometry", "mean_mm"] > 4 * full["mean_mm"]
    assert full["mean_mm"] <= 0.06
    assert full["max_mm"] <= 0.15


def test_hh800_finds_the_compliances(hh800):
    """Fails if a compliance is biased: the torques, the equilibrium or the priors would be wrong."""
    posterior = pd.read_csv(hh800 / "sample" / "posterior.csv").set_index("parameter")
    for name, truth in TRUE_COMPLIANCE.items():
        assert abs(posterior.loc[name, "mean"] - truth) < 3 * posterior.loc[name, "sd"]


def document(path):
    """A summary."""
    return json.loads(path.read_text(encoding="utf-8"))


def test_hh800_posterior_agrees_with_laplace(hh800):
    """Fails if sampling or Laplace's approximation is wrong, or the chain too short."""
    parameters = pd.read_csv(hh800 / "identify" / "parameters.csv").set_index("parameter")
    posterior = pd.read_csv(hh800 / "sample" / "posterior.csv").set_index("parameter")
    summary = document(hh800 / "sample" / "summary.json")
    free = parameters.index[~parameters["at_bound"]]
    level = posterior.loc["noise.factor", "mean"]
    known = free[parameters.loc[free, "prior_share"] < 0.01]
    np.testing.assert_allclose(posterior.loc[known, "sd"], level * parameters.loc[known, "sd"], rtol=0.05)
    assert summary["sd_over_laplace_least"] > 0.95
    assert summary["sd_over_laplace_most"] < 1.05
    assert posterior["rhat"].max() < 1.01
    assert posterior["ess"].min() > 4000
    assert summary["missing_steps"] == 0


def test_hh800_says_what_it_cannot_know(hh800):
    """Fails if a direction is not named or a bound that cuts the posterior is passed over."""
    summary = document(hh800 / "identify" / "summary.json")
    assert summary["rank_by_effect"] == {"geometry": 29, "joint-compliance": 5}
    words = pd.read_csv(hh800 / "identify" / "identifiability.csv")
    assert (words["kind"].isin(["silent", "trade"])).sum() == 3
    count = pd.read_csv(hh800 / "identify" / "count.csv")
    assert count.groupby("effect")["kept"].sum().to_dict() == {"geometry": 25, "joint-compliance": 4}
    assert "joint1.s" in [cut["parameter"] for cut in document(hh800 / "sample" / "summary.json")["cut"]]


def test_hh800_predicts_held_out_errors(hh800):
    """Fails if the predictive intervals are too narrow or too wide for 60 held-out poses."""
    predictive = pd.read_csv(hh800 / "sample" / "predictive.csv")
    assert 0.87 <= predictive["heldout_coverage"].iloc[0] <= 1.0


def test_hh800_page_one_is_read_at_a_glance(hh800):
    """Fails if page one of a whole study has jargon, keys or long sentences, or does not say how the model in use was tested."""
    said = of_run(STUDIES / "hh800" / "study.toml", hh800, "select", "identify", "diagnose", "sample")
    assert unreadable(said) == []
    assert len([text for text in said if re.match(r"Tested: \d+ of 60 held-out errors", text)]) == 1


def test_hh800_run_folder_keeps_the_contract(hh800):
    """Fails if a file or column that other programs read is missing."""
    contract = {
        "select/poses.csv": ["pose", *(f"q{i}_deg" for i in range(1, 7)), *(f"approach{i}" for i in range(1, 7))],
        "select/observability.csv": ["n_poses", "O1", "O2", "O3", "O4", "O5", "expected_sd_mm", "worst_sd_mm"],
        "identify/parameters.csv": [
            "parameter", "effect", "unit", "nominal", "estimate", "sd", "lower", "upper", "at_bound", "prior_share",
        ],
        "identify/accuracy.csv": ["model", "split", "n", "mean_mm", "rms_mm", "max_mm"],
        "identify/residuals.csv": ["pose", "repeat", "marker", "dx_mm", "dy_mm", "dz_mm", "whitened", "flagged"],
        "diagnose/candidates.csv": [
            "cause", "joint", "statistic", "p_family", "delta_bic", "probability", "visible_share", "estimate", "sd", "unit",
        ],
        "diagnose/accuracy.csv": ["model", "split", "n", "mean_mm", "rms_mm", "max_mm"],
        "sample/posterior.csv": ["parameter", "unit", "mean", "sd", "q025", "q500", "q975", "rhat", "ess"],
        "sample/predictive.csv": ["pose"],
    }  # fmt: skip
    for name, columns in contract.items():
        table = pd.read_csv(hh800 / name)
        assert set(columns) <= set(table.columns), name
        assert len(table), name
    findings = pd.read_csv(hh800 / "diagnose" / "findings.csv")
    assert list(findings.columns[:13]) == [
        "status", "cause", "joint", "estimate", "sd", "unit", "p_family", "probability", "cannot_tell_from", "gain_mean_mm",
        "gain_low_mm", "gain_high_mm", "heldout_mean_mm",
    ]  # fmt: skip
    assert findings.empty  # the model lacks nothing
    accuracy = pd.read_csv(hh800 / "identify" / "accuracy.csv")
    assert accuracy["model"].iloc[0] == "nominal"
    for name in ("manifest.json", "sample/chain.h5"):
        assert (hh800 / name).is_file()


def test_hh800_measurements_are_what_its_truth_file_describes(tmp_path):
    """Fails if the simulation changes without its measurements, or differs between two runs."""
    calflow("simulate", STUDIES / "hh800" / "truth.toml", "--out", tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == (STUDIES / "hh800" / "measurements.csv").read_bytes()


def test_hh800_poses_reach_more_than_random_ones(hh800):
    """Fails if the selection is no better than chance: as many random poses must tell clearly less."""
    from calflow.design.candidates import candidates
    from calflow.design.optimality import indices
    from calflow.model import build
    from calflow.stage_settings import SelectSettings
    from calflow.study import load_study

    study = load_study(STUDIES / "hh800")
    settings = study.validated_settings("select", SelectSettings)
    model = build(study.robot, study.file.effects)
    region = np.array([settings.region_min, settings.region_max])
    _, conditions = candidates(model, 500, "rated", "E", region, np.random.default_rng(3))
    whitened = model.position_jacobian(model.nominal, conditions) * model.prior_sd / settings.sigma
    table = pd.read_csv(hh800 / "select" / "observability.csv").set_index("n_poses").loc[100]
    for start in range(0, 500, 100):
        part = whitened[start : start + 100]
        covariance = np.linalg.inv(np.eye(37) + np.einsum("cai,caj->ij", part, part))
        expected = 1e3 * settings.sigma * np.sqrt(np.einsum("cai,ij,caj->c", whitened, covariance, whitened).mean())
        assert table["expected_sd_mm"] < 0.95 * expected
        assert table["O1"] > 1.2 * indices(part.reshape(-1, 37), 34)[0]


def test_the_papers_table_alone(tmp_path):
    """Fails if the workflow paper-table does more or less than the three rows of the paper."""
    calflow("run", STUDIES / "hh800" / "paper-table.toml", "--out", tmp_path)
    assert list(heldout(tmp_path).index) == ["nominal", "geometry", "geometry + joint-compliance"]
    assert not (tmp_path / "sample").exists()


@measured_data
@pytest.mark.parametrize(("study", "rows"), [("study.toml", 2773), ("series_b.toml", 1495)])
def test_real_ur10_is_read_whole(study, rows):
    """Fails if the shipped studies do not read the measured files as they are published."""
    assert len(load_study(UR10 / study).measurements()) == rows


@measured_data
def test_real_fanuc(tmp_path):
    """Fails if markers side by side, repeats or joint signs go wrong on real data; the tutorial has it diagnosed."""
    calflow("run", STUDIES / "fanuc-r2000" / "study.toml", "--out", tmp_path, "--stage", "identify")
    table = heldout(tmp_path)
    assert table.loc["geometry", "mean_mm"] <= 0.24
    assert table.loc["nominal", "mean_mm"] < 0.8
    assert len(pd.read_csv(tmp_path / "identify" / "residuals.csv")) == 24 * 10 * 3


def diagnosed(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, *options: str, causes: Sequence[str] = (), every: int = 1
) -> pd.Series:
    """Mean held-out errors [mm] from nominal to diagnosed, by all causes or these, of a study converted first.

    One of so many of its rows to fit is kept.
    """
    study = shutil.copytree(STUDIES / name, folder / name)
    with (study / "study.toml").open("a", encoding="utf-8") as file:
        file.write(f"\n[stages.identify]\nstarts = 1\n\n[stages.diagnose]\ncatalogue = {json.dumps(list(causes))}\n")
    monkeypatch.setattr("sys.argv", ["convert.py"])
    runpy.run_path(str(study / "convert.py"), run_name="__main__")
    if every > 1:
        rows = pd.read_csv(study / "measurements.csv", dtype=str)
        rows[(rows["split"] == "holdout") | (rows.index % every == 0)].to_csv(study / "measurements.csv", index=False)
    assert in_process("run", study / "study.toml", "--out", folder / "run", *options).code == 0
    assert unreadable(of_run(study / "study.toml", folder / "run", "identify", "diagnose")) == []
    accuracy = pd.read_csv(folder / "run" / "diagnose" / "accuracy.csv")
    return accuracy.loc[accuracy["split"] == "holdout", "mean_mm"]


@measured_data
def test_real_franka_by_its_camera(tmp_path):
    """Fails if camera and board of unknown places go wrong on real poses of a camera, or its odd images are not told."""
    calflow("run", STUDIES / "franka-camera" / "study.toml", "--out", tmp_path, "--stage", "identify")
    rows = pd.read_csv(tmp_path / "identify" / "residuals.csv")
    rows = rows[rows["split"] == "holdout"].set_index("pose")
    assert {113, 114} <= set(rows.index[rows["flagged"]])
    assert rows.loc[~rows["flagged"], "error_mm"].mean() <= 1.2
    assert rows["error_mm"].mean() <= 1.45
    assert unreadable(of_run(STUDIES / "franka-camera" / "study.toml", tmp_path, "identify")) == []


FIRST_STEPS = STUDIES / "first-steps"


@pytest.mark.parametrize("name", ["tracker", "sockets", "wire"])
def test_the_first_steps_find_what_is_hidden(name, tmp_path, monkeypatch):
    """Fails if a newcomer's study does not run, its page states other errors, or what is hidden is neither found nor left open."""
    monkeypatch.chdir(tmp_path)
    assert in_process("run", FIRST_STEPS / f"{name}.toml", "--out", "run").code == 0
    accuracy = pd.read_csv("run/diagnose/accuracy.csv")
    means = accuracy.loc[accuracy["split"] == "holdout", "mean_mm"]
    page = (STUDIES.parent / "docs" / "examples.md").read_text(encoding="utf-8")
    (row,) = re.findall(rf"^\| `{name}.toml` \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|", page, re.MULTILINE)
    assert [float(cell) for cell in row] == pytest.approx([*means.iloc[:2], means.iloc[-1]], abs=6e-4)
    assert unreadable(of_run(FIRST_STEPS / f"{name}.toml", Path("run"), "identify", "diagnose")) == []
    findings = pd.read_csv("run/diagnose/findings.csv", keep_default_na=False)
    if name == "sockets":
        assert findings.empty
        return
    first = findings.iloc[0]
    assert f"{first['cause']} {first['cannot_tell_from']}".count("joint-eccentricity") >= 1
    assert first["joint"] == 3
    if name == "tracker":
        hidden = runpy.run_path(str(FIRST_STEPS / "measured.py"))
        assert abs(first["estimate"] - hidden["ECCENTRIC"]) < 3 * first["sd"]
        zeros = pd.read_csv("run/diagnose/parameters.csv").set_index("parameter")
        for joint in (3, 4, 5):
            zero = zeros.loc[f"joint{joint}.theta"]
            assert abs(zero["estimate"] - hidden["ZEROS"][joint - 1]) < 4 * zero["sd"] + 1e-4, joint


def test_the_first_steps_are_what_their_simulation_measures():
    """Fails if a table of the newcomers' studies was edited, or the simulation that they are told to be of was."""
    hidden = runpy.run_path(str(FIRST_STEPS / "measured.py"))
    wire = pd.read_csv(FIRST_STEPS / "wire.csv")
    readings = np.radians(wire.filter(like="_deg").to_numpy())
    lengths = np.linalg.norm(hidden["ball"](readings) - [1.9, 0.3, -0.2], axis=1)
    assert np.std(1e3 * lengths - wire["length_mm"]) == pytest.approx(0.05, rel=0.2)
    sockets = pd.read_csv(FIRST_STEPS / "sockets.csv")
    place = 1e3 * hidden["ball"](np.radians(sockets.filter(like="_deg").to_numpy()))
    spread = pd.DataFrame(place).groupby([sockets["placement"], sockets["socket"]]).std()
    assert spread.to_numpy().mean() == pytest.approx(0.03, rel=0.3)
