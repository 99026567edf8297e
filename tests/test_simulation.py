"""Simulation: a truth file becomes measurements that say what it says, and nothing else ever reads it."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2, kstest

from calflow.design.candidates import packed_conditions
from calflow.files.problems import InputError
from calflow.model import build
from calflow.robot.robot import Robot
from calflow.simulation import simulate

Q, X = ["q1_deg", "q2_deg", "q3_deg"], ["x_mm", "y_mm", "z_mm"]
DEVICE = "origin_mm = [3000, 0, 1000]\nfloor_mm = 0.02\nnoise_mm_per_m = 0.005"
SETS = "[[sets]]\nrandom = 40"


def simulated(small, *changes):
    small.edit("truth.toml", *changes)
    return simulate(small / "truth.toml")


def true_positions(small, table):
    """Where the markers are with the errors of the truth file: the graph's, with the values put in by hand."""
    model = build(Robot.from_toml(small / "robot.toml"), ("geometry", "joint-compliance"))
    true = {"joint2.a": 0.5e-3, "joint2.s": 2e-6}
    values = np.array([true.get(parameter.name, 0.0) for parameter in model.parameters])
    found = np.empty((len(table), 3))
    for payload in ("light", "heavy"):
        own = (table["payload"] == payload).to_numpy()
        found[own] = model.position(
            values, packed_conditions(model, np.deg2rad(table.loc[own, Q].to_numpy()), payload, "tool")
        )
    return 1e3 * found


def test_the_same_seed_gives_the_same_file(small):
    """Fails if noise or poses depend on anything but the truth file, or the seed on nothing."""
    first, again = (
        small.calflow("simulate", small / "truth.toml", "--out", small / name) for name in ("1.csv", "2.csv")
    )
    assert (first.code, again.code) == (0, 0)
    assert (small / "1.csv").read_bytes() == (small / "2.csv").read_bytes() == (small / "measurements.csv").read_bytes()
    other = simulated(small, ("seed = 3", "seed = 4"))
    assert not np.isin(other["q1_deg"], pd.read_csv(small / "1.csv")["q1_deg"]).any()


def test_without_noise_the_file_holds_the_true_positions(small):
    """Fails if a true value is dropped or scaled, or the readings stated are not those simulated."""
    table = simulated(small, (DEVICE, ""))
    assert "sigma_mm" not in table
    np.testing.assert_allclose(table[X], true_positions(small, table), atol=6e-5)
    assert small.calflow("simulate", small / "truth.toml", "--force").code == 0
    assert small.calflow("check").code == 0


def test_noise_grows_with_range_as_stated(small):
    """Fails if noise is not normal, not the same on all axes, or not floor + noise · range, as a series states it."""
    device = ("origin_mm = [900, 0, 1000]", "floor_mm = 0.01", "noise_mm_per_m = 0.05")
    table = simulated(small, ("random = 40", "random = 3000"), (DEVICE, "\n".join(device)))
    true = true_positions(small, table)
    distance = np.linalg.norm(true - [900, 0, 1000], axis=1)
    sigma = 0.01 + 0.05e-3 * distance
    assert distance.max() > 4 * distance.min()
    np.testing.assert_allclose(table["sigma_mm"], sigma, atol=2e-5)
    unit = (table[X].to_numpy() - true) / sigma[:, None]
    for part in (
        *unit.T,
        unit[distance < np.quantile(distance, 0.1)].ravel(),
        unit[distance > np.quantile(distance, 0.9)].ravel(),
    ):
        assert chi2(len(part)).cdf((part**2).sum()) == pytest.approx(0.5, abs=0.4999)
        assert kstest(part, "norm").pvalue > 1e-4
    assert abs(np.corrcoef(unit[table["repeat"] == 1].ravel(), unit[table["repeat"] == 2].ravel())[0, 1]) < 0.05


def test_a_file_is_not_divided_in_part(small):
    """Fails if simulate writes rows, some without a split, that check and run then refuse."""
    small.edit("truth.toml", (SETS, SETS + '\n[[sets]]\nrandom = 5\nsplit = "holdout"'))
    (told,) = small.refused("simulate", small / "truth.toml", "--out", small / "new.csv")
    assert "expected split in all [[sets]] or in none" in told
    assert not (small / "new.csv").exists()


def test_repeats_payloads_and_sets_are_laid_out(small):
    """Fails if repeats are other poses, payloads do not take turns, or a set's split or numbering is lost."""
    table = simulated(
        small,
        ("repeats = 2", "repeats = 3"),
        (SETS, SETS + '\nsplit = "train"\n[[sets]]\nrandom = 5\nsplit = "holdout"'),
    )
    assert len(table) == 3 * 45
    poses = table.groupby("pose")
    assert list(poses["repeat"].agg(list)) == [[1, 2, 3]] * 45
    assert (poses[[*Q, "payload", "split"]].nunique() == 1).all(axis=None)
    assert list(poses["payload"].first()[:3]) == ["light", "heavy", "light"]
    assert list(poses["split"].first()) == ["train"] * 40 + ["holdout"] * 5
    assert table.groupby(Q).ngroups == 45


def test_the_approach_is_where_the_joint_came_from(small):
    """Fails if the sign is turned round, or a direction is made up for the first pose."""
    table = simulated(small, ("repeats = 2", "repeats = 1\napproach = true"))
    moved = np.sign(np.diff(table[Q].to_numpy(), axis=0, prepend=table[Q].to_numpy()[:1]))
    np.testing.assert_array_equal(table[["approach1", "approach2", "approach3"]], moved)
    assert (moved[0] == 0).all()
    assert set(np.unique(moved[1:])) == {-1, 1}


def test_poses_come_from_the_selection(finished):
    """Fails if the poses that select chose are not those measured, in their order."""
    chosen = pd.read_csv(finished / "runs" / "select" / "poses.csv")
    table = simulated(finished, ("random = 40", 'poses = "runs/select/poses.csv"'), ("repeats = 2", "repeats = 1"))
    np.testing.assert_array_equal(table[Q], chosen[Q])


def test_all_markers_are_measured(small):
    """Fails if a pose's markers are not all there."""
    small.edit("robot.toml", ("[markers.tool]", "[markers.other]\npoint_mm = [0, 0, 0]\n[markers.tool]"))
    table = simulated(small)
    assert list(table["marker"][:4]) == ["other", "tool"] * 2
    assert len(table) == 160


def test_random_poses_stay_in_the_region(small):
    """Fails if a pose is simulated that the device cannot see."""
    table = simulated(small, (SETS, f"[region]\nmin_m = [0.3, -2, 0.2]\nmax_m = [3, 2, 1.5]\n{SETS}"))
    assert ((table[X] > [299, -2000, 199]) & (table[X] < [3000, 2000, 1501])).all(axis=None)


MISTAKES = [
    ("seed = 3", "sed = 3", ["missing: expected 'seed'", "3: sed: unknown key, did you mean 'seed'?"]),
    ("joint-compliance", "joint-complance", ["2: effects: unknown effect 'joint-complance', did you mean 'joint-compliance'?"]),
    ("repeats = 2", "repeats = 0", ["4: repeats: expected a number greater than or equal to 1, found 0"]),
    ("noise_mm_per_m", "noise_mm", ["10: device.noise_mm: expected a unit of ratio: noise_m_per_m or noise_mm_per_m"]),
    ("random = 40", "random = 40\nposes = 'p.csv'", ["12: sets[1]: expected either poses ="]),
    ("random = 40", "", ["12: sets[1]: expected either poses ="]),
    (SETS, "", ["missing: expected 'sets'"]),
    (SETS, f"[region]\nmin_m = [0, 0, 1]\nmax_m = [1, 1, 0]\n{SETS}", ["12: region: expected min < max along every axis"]),
    (SETS, f"[region]\nmin_m = [8, 8, 8]\nmax_m = [9, 9, 9]\n{SETS}", ["12: region: of 10240 poses within the joint"]),
    ('"heavy"]', '"havy"]', ["5: payloads: unknown payload 'havy', did you mean 'heavy'?"]),
    ("a_mm = 0.5", "aa_mm = 0.5", ["16: values.joint2.aa_mm: unknown parameter or unit, did you mean 'joint2.a_mm'?"]),
    ("a_mm = 0.5", "a = 0.5", ["16: values.joint2.a: unknown parameter or unit, did you mean 'joint2.a_m"]),
    ("a_mm = 0.5", "a_mrad = 0.5", ["16: values.joint2.a_mrad: unknown parameter or unit, did you mean 'joint2.a"]),
    ("a_mm = 0.5", "a_mm = 0.5\na_um = 500.0", ["17: values.joint2.a_um: is given twice, in different units"]),
    ("a_mm = 0.5", "a_mm = 1e300", ["16: values.joint2.a_mm: expected at most 1e+09, found 1e+300"]),
    ("a_mm = 0.5", 'a_mm = "0.5"', ["16: values.joint2.a_mm: expected a number, found '0.5'"]),
    ("[values.joint2]", "[values.joint4]", ["16: values.joint4.a_mm: unknown parameter", "17: values.joint4.s_rad_per_Nm"]),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "expected"), MISTAKES)
def test_a_wrong_truth_file_is_refused(small, old, new, expected):
    """Fails if a value goes to another parameter or none, or a mistake is told without its line or the nearest name."""
    small.edit("truth.toml", (old, new))
    told = small.refused("simulate", small / "truth.toml", "--out", small / "other.csv")
    assert len(told) == len(expected), told
    for problem, part in zip(told, expected, strict=True):
        assert problem.startswith("truth.toml:")
        assert part in problem
    assert not (small / "other.csv").exists()


def test_wrong_values_and_payloads_are_told_together(small):
    """Fails if one kind of mistake hides the other."""
    small.edit("truth.toml", ("a_mm = 0.5", "b_mm = 0.5"), ('"heavy"]', '"havy"]'))
    assert len(small.refused("simulate", small / "truth.toml")) == 2


@pytest.mark.parametrize(
    ("poses", "expected"),
    [
        (None, ["p.csv: no such file"]),
        ("q1_deg,q2_deg,q3_deg\n", ["p.csv: is empty"]),
        (
            "q1_deg,q2_dg,q3_inch\n1,2,3\n",
            [
                "p.csv:1: unknown column 'q2_dg', did you mean 'q2_deg'?",
                "p.csv:1: unknown column 'q3_inch', did you mean 'q3_",
                "p.csv:1: missing column: expected q2_rad or q2_deg or q2_mrad or q2_urad or q2_arcsec",
                "p.csv:1: missing column: expected q3_rad",
            ],
        ),
        (
            "q1_deg,q2_deg,q3_deg,q1_rad\n1,2,3,4\n",
            ["p.csv:1: column 'q1_rad': 'q1' is there twice, in different units"],
        ),
        ("q1_deg,q2_deg,q3_deg\n1,2,3\n\n1,,3\n", ["p.csv:4: column 'q2_deg' is empty"]),
        (
            "q1_deg,q2_deg,q3_deg\n1,2,3\n1,,3\n1,2,x\n",
            ["p.csv:3: column 'q2_deg' is empty", "p.csv:4: column 'q3_deg': expected a number, found 'x'"],
        ),
    ],
)
def test_a_wrong_pose_file_is_refused(small, poses, expected):
    """Fails if an empty reading is simulated as nan."""
    if poses is not None:
        (small / "p.csv").write_text(poses, encoding="utf-8")
    small.edit("truth.toml", ("random = 40", 'poses = "p.csv"'))
    told = small.refused("simulate", small / "truth.toml")
    assert len(told) == len(expected)
    for problem, part in zip(told, expected, strict=True):
        assert part in problem


def test_a_pose_that_cannot_be_reached_is_refused(looped):
    """Fails if a loop that cannot be closed is simulated as nan."""
    looped.edit("robot.toml", ("[loop.rod]\nlength_m = 1.6", "[loop.rod]\nlength_m = 1.2"))
    before = (looped / "measurements.csv").read_bytes()
    told = looped.refused("simulate", looped / "truth.toml")
    assert "cannot be closed" in told[0]
    assert (looped / "measurements.csv").read_bytes() == before


def test_compliance_of_massless_links_is_refused(small):
    """Fails if springs are simulated without the weights that load them."""
    small.edit("robot.toml", ("mass_kg = 30\ncom_mm = [350", "com_mm = [350"))
    (told,) = small.refused("simulate", small / "truth.toml")
    assert told.startswith("robot.toml:11: joints[2]: effect 'joint-compliance' needs")


BOTH = (
    'effects = ["geometry", "joint-compliance"]',
    'effects = ["joint-backlash", "torque-backlash"]\napproach = true',
)


def test_a_value_of_two_effects_is_given_by_the_effect(small):
    """Fails if a name that two effects share goes to one of them in silence, or cannot be given to the other."""
    small.edit("truth.toml", BOTH, ("a_mm = 0.5\ns_rad_per_Nm = 2e-6", "b_mrad = 0.5"), (DEVICE, ""))
    (told,) = small.refused("simulate", small / "truth.toml", "--out", small / "other.csv")
    assert told == (
        "truth.toml:15: values.joint2.b_mrad: belongs to 2 parameters: expected "
        "[values.joint2.joint-backlash] b_mrad or [values.joint2.torque-backlash] b_mrad"
    )
    moved = {}
    for effect in ("joint-backlash", "torque-backlash"):
        before = (small / "truth.toml").read_text(encoding="utf-8")
        table = simulated(small, ("[values.joint2]", f"[values.joint2.{effect}]"))
        (small / "truth.toml").write_text(before, encoding="utf-8")
        moved[effect] = table[X].to_numpy()
    still = simulated(small, ("b_mrad = 0.5", ""))[X].to_numpy()
    assert all(np.abs(positions - still).max() > 0.05 for positions in moved.values())
    assert np.abs(moved["joint-backlash"] - moved["torque-backlash"]).max() > 0.05


def test_an_effect_without_its_condition_is_refused(small):
    """Fails if a backlash is asked for and simulated as none, since no row says which side it came from."""
    small.edit("truth.toml", BOTH, ("approach = true", ""), ("a_mm = 0.5\ns_rad_per_Nm = 2e-6", ""))
    assert small.refused("simulate", small / "truth.toml") == [
        "truth.toml:2: effects: effect 'joint-backlash' needs approach = true"
    ]


def test_an_effect_s_table_names_what_it_has(small):
    """Fails if a value of an effect that is not there passes, or is told without the nearest name."""
    small.edit(
        "truth.toml",
        BOTH,
        ("[values.joint2]\na_mm = 0.5\ns_rad_per_Nm = 2e-6", "[values.joint2.joint-backlsh]\nb_mrad = 1"),
    )
    (told,) = small.refused("simulate", small / "truth.toml")
    assert told.startswith(
        "truth.toml:17: values.joint2.joint-backlsh.b_mrad: unknown parameter or unit, did you mean 'joint2.joint-b"
    )


def test_poses_may_be_stated_in_radians(small):
    """Fails if a pose file's unit is taken for another."""
    (small / "p.csv").write_text("q1_deg,q2_rad,q3_mrad\n10,-0.5,250\n", encoding="utf-8")
    table = simulated(small, ("random = 40", 'poses = "p.csv"'))
    np.testing.assert_allclose(table[Q].iloc[0], [10.0, np.rad2deg(-0.5), np.rad2deg(0.25)], atol=6e-5)


def test_no_run_reads_the_truth(small):
    """Fails if a study knows what it is to find."""
    (small / "truth.toml").unlink()
    assert small.calflow("run", "--stage", "identify").code == 0


@pytest.mark.parametrize("repeats", [10**13, 10**7 + 1])
def test_a_mistyped_number_of_repeats_is_refused(small, repeats):
    """Fails if a figure with some zeros too many fills the memory instead of being told."""
    with pytest.raises(InputError, match="expected at most 10,000,000 rows a marker"):
        simulated(small, ("repeats = 2", f"repeats = {repeats}"))
