"""Rivals in a cause's place: what does nothing there widens no promise, what does something elsewhere does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import calflow as cf
from hidden.case import Case, World, draw, measure, write_case
from hidden.causes import Hidden, measured_points
from hidden.simulator import Array

BENDING = Case(hidden=(Hidden("link-bending", 2, 5e-8),), payloads=("none",), poses=90, effects=("geometry",))
OFF_CENTRE = Case(hidden=(Hidden("joint-eccentricity", 2, 1e-3),), payloads=("none",), poses=240, effects=("geometry",))
WARMS = Case(
    hidden=(Hidden("thermal-growth", size=2.3e-5),), payloads=("none",), poses=120, effects=("geometry",),
    columns=("time", "temperature"),
)  # fmt: skip


def written(folder: Path, case: Case, seed: int, heavier: Array, low: float) -> tuple[World, Array]:
    """Write a case with links heavier than its maker says (6,) [kg], measured where joint 2 is below an angle [rad].

    Returns what was drawn and where each of its points truly is (rows, 3) [m].
    """
    rng = np.random.default_rng(seed)
    write_case(folder, case, np.random.default_rng(seed))
    world = draw(case, rng)
    points = measured_points(replace(world.real, mass=world.real.mass + heavier), world.rows, world.hidden)
    table, _ = measure(case, world, points, rng)
    table[world.rows.q[:, 1] < low].to_csv(folder / "measurements.csv", index=False)
    return world, points


def diagnosed(folder: Path, *catalogue: str) -> cf.Calibration:
    """What is found in it of these causes; all are weighed as rivals."""
    study = cf.load_study(folder / "study.toml")
    first = cf.identify(study.robot, study.measurements(), study.file.effects, starts=1, seed=1)
    return first.diagnose(catalogue=catalogue)


def test_a_rival_that_differs_elsewhere_widens_the_promise_there(tmp_path: Path) -> None:
    """Fails if a promise beyond the measured angles goes by the likeliest alone of the causes that explain these alike, or a drift
    check of such a model ends.

    A quarter of a turn of an eccentric joint is nearly the error of a gear ratio, and the next quarter is not.
    """
    world, points = written(tmp_path, OFF_CENTRE, 1, np.zeros(6), 0.0)
    found = diagnosed(tmp_path, "joint-eccentricity", "gear-ratio-error")
    assert max(alternative.probability for alternative in found.alternatives) > 0.1
    angle = world.rows.q[:, 1]
    beyond, here = (promised(found, world.rows.q[rows]) for rows in (angle > np.deg2rad(20), angle < 0))
    alone = promised(replace(found, alternatives=()), world.rows.q[angle > np.deg2rad(20)])
    error = rms(found.predict(world.rows.q[angle > np.deg2rad(20)]).position - points[angle > np.deg2rad(20)])
    assert alone < 0.3 * error < beyond
    assert here < 0.3 * beyond
    bent = replace(world.real, theta=world.real.theta + 3e-4 * np.eye(6)[0])  # joint 1's zero, or the foot
    check = angle < 0
    seen = measured_points(bent, world.rows, world.hidden)[check][:2]
    moved = cf.drift(
        found, cf.Measurements.from_arrays(found.model.robot, world.rows.q[check][:2], seen, payload="none")
    )
    assert moved.moved[0].cannot_tell_from
    assert moved.next_poses


def test_a_form_by_another_clock_widens_the_promise_where_the_two_part(tmp_path: Path) -> None:
    """Fails if a promise goes by the time alone where a warm-up is told as well by the thermometer that rose with it,
    or if it widens where the two still agree, the thermometer being no input of the likeliest form.

    The arm grows with its temperature, which rises as by one time constant while it is measured. Later it has cooled.
    """
    rng = np.random.default_rng(3)
    world = draw(WARMS, rng)
    rows = replace(world.rows, temperature=20 + 6 * (1 - np.exp(-world.rows.time / 3000)))
    world = replace(world, rows=rows)
    write_case(tmp_path, WARMS, np.random.default_rng(3))
    table, _ = measure(WARMS, world, measured_points(world.real, rows, world.hidden), rng)
    table.to_csv(tmp_path / "measurements.csv", index=False)
    found = diagnosed(tmp_path, "thermal-growth")
    assert [finding.cause for finding in found.findings] == ["thermal-growth"]
    forms = [one for one in found.alternatives if one.gone and one.rival and one.gone.place == one.rival.place]
    assert "with the temperature" in {cause.detail for one in forms for cause in (one.gone, one.rival)}
    by_the_likeliest = replace(found, alternatives=tuple(one for one in found.alternatives if one not in forms))
    later = rows.time + rows.time.max()
    cold = replace(rows, time=later, temperature=np.full(len(later), 21.0))
    warm = replace(rows, time=later, temperature=20 + 6 * (1 - np.exp(-later / 3000)))
    (parted, parted_alone), (alike, alike_alone) = (
        [rms(one.predict(at.q, payload="none", time=later, temperature=at.temperature + 273.15).sd)
         for one in (found, by_the_likeliest)]
        for at in (cold, warm)
    )  # fmt: skip
    position = found.predict(cold.q, payload="none", time=later, temperature=cold.temperature + 273.15).position
    error = rms(position - measured_points(world.real, cold, world.hidden))
    assert parted_alone < 0.5 * error < parted
    assert alike < 1.1 * alike_alone


def promised(found: cf.Calibration, q: Array) -> float:
    """The standard deviation [m] that is promised of positions at joint readings (rows, 6), on average."""
    return rms(found.predict(q).sd)


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))
