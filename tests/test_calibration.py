"""The sample of the documentation: from files to a diagnosis, a posterior, joint commands and a report."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import calflow as cf
from calflow.sampling.log_posterior import log_posterior_of

DOCUMENT = Path(__file__).parents[1] / "docs" / "api.md"
RUNOUT = 6e-4  # rad, of a gear: an eccentricity, which is not among the sample's effects


def the_sample() -> str:
    """The first block of Python in the documentation."""
    return re.search(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)[1]


@pytest.fixture
def points(small, monkeypatch):
    """A working folder with robot.toml and points.csv, of a robot whose first gear does not run true."""
    small.edit("robot.toml", ("[payloads.heavy]", "[payloads.full]"))
    small.edit(
        "truth.toml", ('"joint-compliance"]', '"joint-compliance", "joint-eccentricity"]\napproach = true'),
        ('"heavy"', '"full"'), ("random = 40", "random = 60"),
    )  # fmt: skip
    with (small / "truth.toml").open("a", encoding="utf-8") as file:
        file.write(f"\n[values.joint1]\nsin_rad = {RUNOUT}\n")
    assert small.calflow("simulate", small / "truth.toml", "--out", small / "points.csv").code == 0
    monkeypatch.chdir(small.path)
    monkeypatch.setitem(cf.Calibration.sample.__wrapped__.__kwdefaults__, "max_steps", 60)  # a short chain: it says so
    return small


def test_the_sample_runs_as_written(points):
    """Fails if a line of the documentation's sample does not run, or its objects do not hold what the sample says."""
    q, a = np.array([[0.1, -0.5, 0.7], [1.0, -0.9, 1.2]]), np.array([[1, 1, -1], [-1, 1, 1]])
    targets = np.array([[0.9, 0.3, 0.8], [9.0, 0.0, 0.0]])
    said = {"q": q, "a": a, "targets": targets}
    exec(compile(the_sample(), "sample", "exec"), said)
    fit, found, posterior = said["calibration"], said["better"], said["posterior"]
    assert found.accuracy[-1].mean_mm < 0.1 < fit.accuracy[-1].mean_mm
    assert fit.covariance_table.loc["joint2.a", "joint2.a"] == pytest.approx(
        fit.parameters.table.set_index("parameter")["sd"]["joint2.a"] ** 2
    )
    assert found.findings[0].cause == "joint-eccentricity"
    assert found.findings.table["cause"].tolist() == [finding.cause for finding in found.findings]
    assert found.findings[0].estimate == pytest.approx(RUNOUT, rel=0.1)
    assert set(found.findings[0].cannot_tell_from) <= {rival.split()[0] for rival in found.findings[0].rivals}
    assert len(found.next_poses) == len(found.next_poses.table)
    assert "missing_steps" in repr(posterior.summary)
    assert len(posterior.draws) == posterior.values[..., 0].size
    assert posterior.draws["joint2.a"].mean() == pytest.approx(
        posterior.table.set_index("parameter")["mean"]["joint2.a"]
    )
    assert isinstance(fit.plot.residuals(), Figure)
    assert (points / "report.pdf").read_bytes().startswith(b"%PDF")


def test_a_fit_says_what_it_is_worth(points):
    """Fails if a notebook hides the error, a parameter at its bound, or what the data do not tell."""
    robot = cf.Robot.from_toml("robot.toml")
    data = cf.Measurements.from_csv("points.csv", robot).split(holdout=0.3, seed=1)
    fit = cf.identify(robot, data, effects=["geometry", "joint-compliance"])
    for shown in (repr(fit), fit._repr_html_()):
        assert "at bounds: joint1.s" in shown
        assert "the data say nothing about joint1.s" in shown
        assert "geometry + joint-compliance" in shown
    assert "<table" in fit._repr_html_()
    again = cf.identify(robot, data, effects=["geometry", "joint-compliance"])
    assert again.parameters.table.equals(fit.parameters.table)


def test_poses_are_chosen_for_a_calibration(points):
    """Fails if the next campaign cannot be planned from what the last one found, or what it is to tell is left out."""
    robot = cf.Robot.from_toml("robot.toml")
    data = cf.Measurements.from_csv("points.csv", robot).split(holdout=0.3, seed=1)
    calibration = cf.identify(robot, data, effects=["geometry"], starts=1)
    chosen = calibration.select(25, payload="full", candidates=300)
    assert len(chosen.poses) == chosen.certificate.n_poses == 25
    assert chosen.certificate.n_parameters == len(calibration.model.parameters)
    assert set(chosen.poses["payload"]) == {"full"}
    refused = {"aim": "aim: expected 'parameters', 'tool' or 'worst'", "marker": "unknown marker 'tol'"}
    for name, message in refused.items():
        with pytest.raises(cf.InputError, match=message):
            calibration.select(25, candidates=300, **{name: "tol"})
    with pytest.raises(cf.InputError, match=r"stated: expected joint readings of shape \(n, 3\), found \(30, 5\)"):
        calibration.select(25, stated=np.zeros((30, 5)))
    alike = np.random.default_rng(1).uniform(-0.5, 0.5, (40, 3))
    assert calibration.select(25, stated=alike.tolist()).poses.equals(calibration.select(25, stated=alike).poses)
    wrong = {"stated": [[1, 2], [1]], "region": [0, 1], "there": ["here"]}
    with pytest.raises(cf.InputError) as refusal:
        calibration.select(25, **wrong)
    assert {problem.key for problem in refusal.value.problems} == set(wrong)
    with pytest.raises(cf.InputError, match=r"there: expected packed conditions of shape \(\d+, n\), found \(1, 2\)"):
        calibration.select(25, candidates=300, there=[[1, 2]])
    for draw in (calibration.select, calibration.sample, calibration.diagnose, calibration.with_residual_field):
        with pytest.raises(cf.InputError, match="seed: expected a number greater than or equal to 0, found -1"):
            draw(seed=-1)
    again = calibration.select(25, payload="full", candidates=300)
    assert again.poses.equals(chosen.poses)


def test_wrong_requests_are_refused_together(points):
    """Fails if what an effect lacks, a wrong name or a missing split ends in a traceback of NumPy."""
    robot = cf.Robot.from_toml("robot.toml")
    rows = cf.Measurements.from_csv("points.csv", robot)
    with pytest.raises(cf.InputError, match=r"data\.split\(holdout=0\.3"):
        cf.identify(robot, rows)
    with pytest.raises(cf.InputError, match=r"effects: expected several, in a list: \['geometry'\]"):
        cf.identify(robot, rows.split(), effects="geometry")
    with pytest.raises(cf.InputError, match="unknown effect 'geometri', did you mean 'geometry'"):
        cf.identify(robot, rows.split(), effects=["geometri"])
    with pytest.raises(cf.InputError) as refused:
        cf.identify(robot, rows.split(), effects=["gear-transmission-error", "range-noise", "joint-step"])
    assert len(refused.value.problems) == 4
    assert "'joint-step' happens at a row that nobody knows yet; diagnose looks for it" in str(refused.value)
    with pytest.raises(cf.InputError) as refused:
        cf.identify(robot, rows.split(), effects=["geometry", "joint-slack"], count={"geometri": 3, "geometry": -1})
    assert [problem.key for problem in refused.value.problems] == ["effects[2]", "count: geometri", "count: geometry"]
    with pytest.raises(cf.InputError, match=r"count: geometry: expected a count from 0 to \d+, .* found 2\.5"):
        cf.identify(robot, rows.split(), effects=["geometry"], count={"geometry": 2.5})
    for seed in (-1, 2**40):
        with pytest.raises(cf.InputError, match="seed: expected a number"):
            cf.identify(robot, rows.split(), seed=seed)
        with pytest.raises(cf.InputError, match="seed: expected a number"):
            rows.split(seed=seed)


def test_without_arviz_it_says_what_to_install(points):
    """Fails if the draws cannot be handed to ArviZ, or its absence is a riddle."""
    robot = cf.Robot.from_toml("robot.toml")
    data = cf.Measurements.from_csv("points.csv", robot).split(holdout=0.3, seed=1)
    fit = cf.identify(robot, data, effects=["geometry"], starts=1)
    with pytest.raises(cf.InputError) as refused:
        fit.sample(ensembles=2, walkers=3, independent=2.0)
    assert [problem.key for problem in refused.value.problems] == ["ensembles", "walkers", "independent"]
    posterior = fit.sample(max_steps=100)
    try:
        import arviz_base  # noqa: F401
    except ImportError:
        with pytest.raises(ImportError, match="pip install arviz-base"):
            posterior.to_inference_data()
        return
    given = posterior.to_inference_data()
    drawn = given["posterior"]["joint2.a"]
    ensembles, steps, walkers, _ = posterior.points.shape
    assert (drawn.sizes["chain"], drawn.sizes["draw"]) == (ensembles * walkers, steps)
    assert float(drawn.mean()) == pytest.approx(posterior.draws["joint2.a"].mean())
    log_posterior, _ = log_posterior_of(posterior.calibrated, posterior.data)
    prior, likelihood = log_posterior.densities_at(posterior.points[0, :, 3])
    np.testing.assert_allclose(given["log_prior"]["parameters"][3], prior, rtol=1e-9)
    np.testing.assert_allclose(given["log_likelihood"]["measurements"][3], likelihood, rtol=1e-9)


def test_the_package_shows_its_public_names_only():
    """Fails if a notebook's completion shows modules, a public name leads nowhere, or the version is another."""
    from importlib.metadata import version

    assert set(dir(cf)) == {*cf.__all__, "__version__"}
    assert all(getattr(cf, name).__doc__ for name in cf.__all__)
    assert cf.__version__ == version("calflow")
    import calflow.reporting.section  # noqa: F401

    assert callable(cf.report)


def test_a_mistake_put_right_in_these_measurements_alone_is_to_be_mended_first(points):
    """Fails if commands are made in silence of a table whose signs were turned: they turn the joint the other way."""
    robot = cf.Robot.from_toml("robot.toml")
    data = cf.Measurements.from_csv("points.csv", robot).split(holdout=0.3, seed=1)
    data.table["q3"] *= -1
    fit = cf.identify(robot, data, effects=["geometry", "joint-compliance"])
    assert fit.accuracy[-1].mean_mm < 1
    (said,) = fit.warnings
    assert "run again before this model is used: joint 3: all readings have the wrong sign" in said
