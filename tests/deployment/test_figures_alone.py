"""Figures alone: fitted anew, they are the best that a controller without springs can have."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calflow as cf
from calflow.deployment import export as exporting
from calflow.deployment.attained import TARGET
from calflow.files.problems import InputError
from calflow.model import build
from estimation.data import SIGMA, measured
from robots import hh800, industrial

EFFECTS = ("geometry", "joint-compliance")


def held_out(data: cf.Measurements) -> cf.Measurements:
    """Rows of which a third is held out."""
    return replace(data, table=data.table.drop(columns="split")).split(holdout=0.3, seed=1)


@pytest.fixture(scope="module")
def rows():
    """Of a robot whose springs give way by millimetres; a third of the first 120 are held out."""
    robot = industrial()
    model = build(robot, EFFECTS)
    rng = np.random.default_rng(3)
    truth = model.nominal.copy()
    geometry, springs = (model.columns(effect) for effect in model.effects)
    truth[geometry] = 0.3 * model.prior_sd[geometry] * rng.standard_normal(len(geometry))
    truth[springs] = 3e-7
    return [held_out(measured(model, truth, number, rng, sigma=SIGMA)) for number in (120, 40)]


@pytest.fixture(scope="module")
def soft(rows):
    """That robot calibrated with its springs."""
    return cf.identify(rows[0].robot, rows[0], EFFECTS, starts=1)


def worn() -> tuple[cf.Robot, cf.Measurements]:
    """A rigid robot with geometry errors, and what was measured of it."""
    robot = industrial()
    model = build(robot, ("geometry",))
    rng = np.random.default_rng(5)
    truth = model.nominal + 0.3 * model.prior_sd * rng.standard_normal(len(model.nominal))
    return robot, measured(model, truth, 120, rng, sigma=SIGMA)


def missed(written: exporting.Export, folder: Path, data: cf.Measurements) -> float:
    """The mean error of held-out poses [mm], by the figures of a robot file and nothing else."""
    held, path = data.only(data.held_out), folder / "robot.toml"
    path.write_text(written.text, encoding="utf-8")
    robot = cf.Robot.from_toml(path)
    point = build(robot, (), data.given).point(np.zeros(0), held.conditions)
    return 1e3 * float(np.linalg.norm(point - held.position, axis=1).mean())


def test_figures_are_those_that_a_fit_of_them_alone_finds(soft, tmp_path):
    """Fails if what is written is the calibration cut down, or misses by another amount than is said."""
    written = exporting.export(soft, "dh", soft.levels, conditions=soft.data.conditions)
    levels = soft.levels
    alone = cf.identify(soft.robot, soft.data, ["geometry"], starts=1)
    best = next(row.mean for row in alone.accuracy if row.split == "holdout" and row.model == "geometry")
    cut = exporting.Export(exporting.robot_of(soft).toml_text(), (), ())
    assert missed(written, tmp_path, soft.data) == pytest.approx(levels.by("figures").mean, rel=1e-3)
    assert levels.by("figures").mean < 1.03 * best
    assert missed(cut, tmp_path, soft.data) > 1.15 * best
    assert (
        levels.by("commands").mean
        < levels.by("figures").mean
        < levels.by("zeros and tool").mean
        < levels.by("nothing").mean
    )
    said = "given controller figures: all lengths and angles, the robot misses at held-out poses by"
    assert f"{said} {levels.by('figures')}" in written.notes


def test_each_level_misses_by_what_is_promised_of_it(soft):
    """Fails if a level promises what the calibrated model does, or what it leaves out is not counted, or counted twice."""
    levels = soft.levels
    assert levels.by("zeros and tool").mean < levels.by("zeros").mean
    for level in levels.every:
        assert 0.9 < level.promised / level.rms < 1.15, level.level
    assert levels.by("figures").promised > 2 * levels.by("commands").promised


def test_what_was_measured_with_controller_figures_is_judged_by_them(soft, rows):
    """Fails if figures typed into a controller are promised what corrected commands reach, or pass for these."""
    new = rows[1]
    commands, figures = (soft.validate(new, tolerance=1e-3, sent=sent) for sent in (None, "controller figures"))
    assert (commands.summary.judged, figures.summary.judged) == ("calibrated", "figures")
    assert commands.summary.status == "met"
    assert figures.summary.status == "not met"
    assert 0.9 < figures.summary.promised_mm / figures.judged.rms_mm < 1.15
    assert figures.judged.rms_mm > 3 * commands.judged.rms_mm
    fit = soft.levels.figures
    believed = fit.model.point(fit.estimate, new.conditions)
    aimed = replace(new, table=new.table.assign(**dict(zip(TARGET, believed.T, strict=True))))
    assert soft.validate(aimed, sent="controller figures").judged.rms_mm == pytest.approx(figures.judged.rms_mm)
    with pytest.raises(InputError, match="where commands were to land"):
        soft.validate(new, sent="program filter")


def test_what_a_rewritten_program_promises_is_of_the_flange(soft, rows):
    """Fails if a program, which sends the flange, is promised what is known of the marker: they trade places unseen."""
    new = rows[1]
    aimed = replace(new, table=new.table.assign(**dict(zip(TARGET, new.position.T, strict=True))))
    program, commands = (soft.validate(aimed, sent=sent).summary.promised_mm for sent in ("program filter", None))
    trade = soft.parameters["joint6.d"].sd
    assert commands < 0.5 * 1e3 * trade < program


def test_figures_that_are_worse_than_the_makers_are_refused(soft):
    """Fails if figures are handed out that harm."""
    levels = soft.levels
    levels = replace(levels, every=(replace(levels.by("nothing"), mean=0.1, max=0.2), *levels.every[1:]))
    with pytest.raises(InputError, match="leave the maker's"):
        exporting.export(soft, "controller", levels, conditions=soft.data.conditions)


@pytest.mark.skipif("CALFLOW_DATA" not in os.environ, reason="CALFLOW_DATA names no folder of measured data")
def test_figures_beside_a_cause_are_as_good_as_those_without_it():
    """Fails if figures are weighed by what the model with a cause leaves: without it the markers of a pose err alike."""
    study = cf.load_study(Path(__file__).parents[2] / "studies" / "fanuc-r2000")
    known = cf.identify(study.robot, study.measurements(), ["geometry", "gravity-deflection"], starts=1, seed=5)
    assert known.levels.by("figures").mean < 0.21


def test_bars_of_a_loop_are_no_zeros():
    """Fails if a controller that takes zeros alone is given other lengths of a parallelogram."""
    robot = hh800()
    model = build(robot, ("geometry",))
    data = held_out(measured(model, model.nominal, 40, np.random.default_rng(1), sigma=SIGMA))
    levels = cf.identify(robot, data, ["geometry"], starts=1).levels
    assert {one.symbol for one in levels.alone["zeros and tool"].model.parameters if one.joint} == {"theta"}
    assert len(levels.alone["zeros and tool"].model.parameters) < len(levels.figures.model.parameters)
    assert not {"crank", "rod", "rocker"} & {one.symbol for one in levels.alone["zeros and tool"].model.parameters}


def test_what_the_device_does_is_not_the_robots():
    """Fails if figures take over that the device was moved between sessions, or it counts as what the robot misses by."""
    robot, data = worn()
    later = np.arange(len(data)) >= len(data) // 2
    table = data.table.assign(session=np.where(later, "second day", "first day"))
    shift = 2e-3 * later
    moved = held_out(replace(data, table=table.assign(x=table.x + shift, y=table.y - shift)))
    still = held_out(data)
    levels = cf.identify(robot, moved, ["geometry", "session-frame"], starts=1).levels
    unmoved = cf.identify(robot, still, ["geometry"], starts=1).levels
    assert levels.left_out == ()
    assert levels.by("figures").mean < 3e3 * SIGMA
    assert levels.by("nothing").mean == pytest.approx(unmoved.by("nothing").mean, rel=0.05)
    assert levels.by("zeros and tool").mean == pytest.approx(
        unmoved.by("zeros and tool").mean, rel=0.2
    )  # what lengths miss tilts the frames, too
