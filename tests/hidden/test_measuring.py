"""The measuring loop on hidden robots: it stops where the tool is within, and not where something keeps it without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

import calflow as cf
from calflow.stages.measuring_loop import next_poses
from calflow.study import load_study
from hidden.backgrounds import displaced
from hidden.case import Case, draw, write_case
from hidden.causes import measured_points
from hidden.test_hidden import only

SIGMA, MEASURED, POSES = 3e-5, 60, 400
REGION = "region_min_m = [1.5, -1.6, 0.5]\nregion_max_m = [3.6, 1.6, 3.0]"
ONCE = "[stages.identify]\nstarts = 1\n\n"
SELECT = f'{ONCE}[stages.select]\npayload = "full"\ncandidates = 200\n{REGION}\n[stages.select.task]\nnumber = 150\n'


def measured(folder, background, tolerance):
    """Measure some poses of a hidden robot.

    Return what the study says next by any tolerance, what it says by this one, and the true error [m] of its tool elsewhere.
    """
    case = Case(
        robot="hh800", sigma=SIGMA, poses=POSES, payloads=("full",), columns=("approach", "sigma"), background=background,
        settings=SELECT + only("joint-backlash", "joint-eccentricity", "gear-ratio-error"),
    )  # fmt: skip
    write_case(folder, case, np.random.default_rng(5))
    world = draw(case, np.random.default_rng(5))
    point = measured_points(world.real, world.rows, world.hidden)
    point = point + displaced(background, world.real, world.rows) if background else point
    table = pd.read_csv(folder / "measurements.csv")
    table[:MEASURED].assign(split="train").to_csv(folder / "measurements.csv", index=False)
    study = load_study(folder)

    def asked(tolerance):
        return next_poses(study, 3, tolerance)

    step = asked(tolerance)
    known = step.calibrated
    sides = world.rows.approach[MEASURED:]
    rows = cf.Measurements.from_arrays(
        known.model.robot, world.rows.q[MEASURED:], None, payload="full", marker="E", approach=sides
    )
    model = replace(known.model, given=rows.given)
    off = model.point(known.estimate, rows.conditions) - point[MEASURED:]
    return asked, step.verdict, float(np.sqrt((off**2).sum(axis=1).mean()))


def test_it_stops_where_the_tool_is_within(tmp_path):
    """Fails if a robot that the model describes is measured on for ever, or is said to be within what it is not within."""
    asked, wide, error = measured(tmp_path, None, 3 * SIGMA)
    assert error < 1.5 * SIGMA
    narrow = asked(0.7 * error).verdict
    assert wide.status == "stop"
    assert narrow.status == "measure"
    assert narrow.probability < 0.5
    assert wide.error_most_mm > 1e3 * error > 0.5 * wide.error_mm
