"""A hidden smooth error of joints that the study asks to correct: what that gains, how sure it is, and where it ends."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import calflow as cf
from conftest import in_process
from hidden.backgrounds import Background, displaced
from hidden.case import Case, draw, write_case
from hidden.causes import measured_points

X, FIELD = ["x_mm", "y_mm", "z_mm"], [f"not_physical_{axis}_mm" for axis in "xyz"]
SD = ["sd_x_mm", "sd_y_mm", "sd_z_mm"]
MEASURED = 400
CASE = Case(
    poses=900,
    payloads=("none",),
    effects=("geometry",),
    columns=("sigma",),
    workflow="own.toml",
    seed=3,
    background=Background("joints", 3e-4, 3),
    settings="[stages.identify]\nstarts = 1\n",
)
WORKFLOW = 'name = "own"\nstages = ["identify"]\n'


def written(folder, case):
    """Write a study whose poses reach over the middle of joint 2's travel alone; all rows, and which are not measured."""
    write_case(folder, case, np.random.default_rng(case.seed))
    world = draw(case, np.random.default_rng(case.seed))
    point = measured_points(world.real, world.rows, world.hidden)
    point = point + displaced(case.background, world.real, world.rows) if case.background else point
    every = pd.read_csv(folder / "measurements.csv")
    low, high = every["q2_deg"].quantile([0.15, 0.85])
    inside = every["q2_deg"].between(low, high)
    measured = inside & (inside.cumsum() <= MEASURED)
    every[measured].to_csv(folder / "measurements.csv", index=False)
    every[X] = 1e3 * point
    edge = 0.1 * (high - low)
    beyond = (every["q2_deg"] < low - edge) | (every["q2_deg"] > high + edge)
    (folder / "own.toml").write_text(WORKFLOW, encoding="utf-8")
    ask(folder, True)
    return every[inside & ~measured], every[beyond]


def ask(folder, wanted):
    """Switch the residual field of a study on or off."""
    text = (folder / "study.toml").read_text(encoding="utf-8").replace("residual_field = true\n", "")
    (folder / "study.toml").write_text("residual_field = true\n" * wanted + text, encoding="utf-8")


def predicted(folder, rows):
    """What calflow predicts of rows, and what it says."""
    rows.drop(columns=[*X, "sigma_mm"]).to_csv(folder / "rows.csv", index=False)
    answer = in_process("predict", folder / "run", folder / "rows.csv", "--out", folder / "predicted.csv", "--force")
    assert answer.code == 0, answer
    return pd.read_csv(folder / "predicted.csv"), answer.err


@pytest.fixture(scope="module")
def corrected(tmp_path_factory):
    """A run with a residual field, and the true places of poses that it has not seen: inside and outside."""
    folder = tmp_path_factory.mktemp("residual")
    inside, outside = written(folder, CASE)
    answer = in_process("run", folder, "--out", folder / "run")
    assert answer.code == 0, answer
    assert "not physical" in answer.out + answer.err
    return folder, inside, outside


def test_it_takes_off_what_is_hidden_and_says_how_sure_it_is(corrected):
    """Fails if unseen poses are not predicted far better, or the standard deviations do not hold for their true errors."""
    folder, inside, _ = corrected
    found, said = predicted(folder, inside)
    assert "not physical" in said
    after = found[X].to_numpy() - inside[X].to_numpy()
    before = after - found[FIELD].to_numpy()
    assert np.sqrt(np.mean(after**2)) < 0.5 * np.sqrt(np.mean(before**2))
    assert 0.9 < np.mean(np.abs(after) < 1.96 * found[SD].to_numpy()) < 0.995  # parameters are as unsure as without it
    table = pd.read_csv(folder / "run/residual_field/accuracy.csv").set_index(["where", "correction"])["rms_mm"]
    told = table["holdout", "residual field (not physical)"] / table["holdout", "none"]
    assert told == pytest.approx(np.sqrt(np.mean(after**2) / np.mean(before**2)), rel=0.3)


def test_it_ends_where_nothing_was_measured(corrected):
    """Fails if anything is corrected beyond the measured travel of a joint, or as much is promised there as inside."""
    folder, inside, outside = corrected
    within, beyond = (predicted(folder, rows)[0] for rows in (inside, outside))
    size = np.sqrt(np.mean(within[FIELD].to_numpy() ** 2))
    assert np.abs(beyond[FIELD].to_numpy()).max() < 0.05 * size
    assert beyond[SD].to_numpy().mean() > 1.5 * within[SD].to_numpy().mean()


def test_commands_go_by_it(corrected):
    """Fails if commands land elsewhere than predict says, or are of the model without the field."""
    folder, inside, _ = corrected
    inside[:50].drop(columns=["sigma_mm"]).to_csv(folder / "targets.csv", index=False)
    answer = in_process("compensate", folder / "run", folder / "targets.csv", "--out", folder / "commands.csv")
    assert answer.code == 0, answer
    assert "not physical" in answer.err
    commands = pd.read_csv(folder / "commands.csv")
    assert commands["reached"].all()
    rows = commands.filter(regex=r"^q\d_deg").assign(pose=commands["pose"], payload=commands["payload"], sigma_mm=0)
    landed, _ = predicted(folder, rows.assign(x_mm=0, y_mm=0, z_mm=0))
    np.testing.assert_allclose(landed[X], commands[X], atol=1e-4)
    np.testing.assert_allclose(landed[FIELD], commands[FIELD], atol=1e-4)


def test_proof_and_export_tell_of_it(corrected):
    """Fails if validate judges another robot than commands are made for, or export leaves the field out in silence."""
    folder, inside, _ = corrected
    inside.drop(columns=["sigma_mm"]).to_csv(folder / "new.csv", index=False)
    answer = in_process("validate", folder / "run", folder / "new.csv", "--out", folder / "proof")
    assert answer.code == 0, answer
    told = json.loads((folder / "proof/summary.json").read_text())
    assert any("not physical" in note for note in told["notes"])
    found, _ = predicted(folder, inside)
    off = np.linalg.norm(found[X].to_numpy() - inside[X].to_numpy(), axis=1)
    models = pd.read_csv(folder / "proof/accuracy.csv").set_index("model")
    assert models["mean_mm"]["calibrated"] == pytest.approx(off.mean(), rel=1e-4)
    exported = in_process("export", folder / "run", "--to", "dh", "--out", folder / "exported.toml")
    assert "residual field (not physical)" in exported.err + exported.out


def test_from_python_it_is_the_same(corrected):
    """Fails if the objects cannot have what a study can, or do not say what it is."""
    folder, inside, _ = corrected
    robot = cf.Robot.from_toml(folder / "robot.toml")
    data = cf.Measurements.from_csv(folder / "measurements.csv", robot).split(0.25, 3)
    said = list[str]()
    model = cf.identify(robot, data, effects=["geometry"], starts=1).with_residual_field(say=said.append)
    assert "applied" in said[0]
    assert "not physical" in repr(model)
    q = np.deg2rad(inside.filter(regex=r"^q\d_deg").to_numpy())
    found = model.predict(q)
    off = 1e3 * found.position - inside[X].to_numpy()
    assert np.sqrt(np.mean(off**2)) < 0.5 * np.sqrt(np.mean((off - 1e3 * found.not_physical) ** 2))
    assert any("not physical" in note for note in found.notes)


def test_what_lacks_is_said(corrected):
    """Fails if a field whose tables are gone or changed is used, or is left out in silence."""
    folder, inside, _ = corrected
    table, aside = folder / "run/residual_field/poses.csv", folder / "aside.csv"
    table.rename(aside)
    found, said = predicted(folder, inside)
    assert FIELD[0] not in found
    assert "without the residual field that the study asks for: residual_field/poses.csv is missing" in said
    aside.rename(table)
    assert FIELD[0] in predicted(folder, inside)[0]


def test_switched_off_it_is_gone_and_nothing_is_fitted_again(corrected):
    """Fails if a field that the study no longer asks for is used, or to ask for it makes identify run again."""
    folder, inside, _ = corrected
    ask(folder, False)
    answer = in_process("run", folder, "--out", folder / "run")
    assert answer.code == 0, answer
    assert "unchanged" in answer.out + answer.err
    without, said = predicted(folder, inside)
    assert FIELD[0] not in without
    assert "not physical" not in said
    ask(folder, True)
    assert in_process("run", folder, "--out", folder / "run").code == 0
    assert FIELD[0] in predicted(folder, inside)[0]


def test_clean_data_are_left_alone(tmp_path):
    """Fails if a correction is made of noise alone, or it is not said that there is none; how often, is estimation's."""
    case = replace(CASE, poses=150, seed=1, background=None)
    _, outside = written(tmp_path, case)
    answer = in_process("run", tmp_path, "--out", tmp_path / "run")
    assert "not applied" in answer.out + answer.err
    assert FIELD[0] not in predicted(tmp_path, outside)[0]
