"""Effects are hidden in data of the independent simulator, and `calflow run` has to find them; the answer stays sealed."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from conftest import in_process
from hidden.case import Case, write_case
from hidden.causes import Hidden


@dataclass(frozen=True)
class Findings:
    """What a run found."""

    table: pd.DataFrame
    folder: Path

    @property
    def causes(self) -> pd.DataFrame:
        """The causes, named or one of several."""
        return self.table[self.table["status"].isin(["named", "one_of"])]

    def could_be(self, row: int) -> set[str]:
        """All that a finding may be."""
        found = self.causes.iloc[row]
        return {found["cause"], *filter(None, found["cannot_tell_from"].split(";"))}

    def has(self, cause: str, joint: int = 0) -> bool:
        """Whether a cause is found at its joint, alone or among what cannot be told apart."""
        right = [not joint or j == joint for j in self.causes["joint"]]
        return any(cause in self.could_be(k) and right[k] for k in range(len(self.causes)))

    @property
    def unexplained(self) -> pd.DataFrame:
        """What nobody can name."""
        return self.table[self.table["status"] == "unexplained"]


def found(folder: Path, case: Case, seed: int) -> Findings:
    """Write a case, run it as a user would but for further starts, and read the findings."""
    once = replace(case, settings=f"[stages.identify]\nstarts = 1\n\n{case.settings}")
    write_case(folder / "case", once, np.random.default_rng(seed))
    answer = in_process("run", folder / "case", "--out", folder / "run")
    assert answer.code == 0, answer.err
    table = pd.read_csv(folder / "run" / "diagnose" / "findings.csv")
    return Findings(table.astype(TEXT).fillna({"joint": 0} | dict.fromkeys(TEXT, "")), folder / "run")


def case(robot: str, *hidden: Hidden, columns: tuple[str, ...] = ("approach",), **rest: object) -> Case:
    """A case with hidden effects."""
    return Case(robot=robot, hidden=hidden, columns=columns, **rest)


TEXT = dict.fromkeys(("cannot_tell_from", "cause", "statement"), "object")  # an empty column comes back as numbers
CLOCK = ("approach", "time")
MAP = case("serial", Hidden("joint-error-map", 2, 2.5e-4), poses=160)
SPRING = case(
    "hh800", Hidden("joint-compliance", 2, 1.8e-7), effects=("geometry",), masses=False, payloads=("full",)
)  # what it gives way to can act in all joints where nobody knows the masses


def only(*causes: str) -> str:
    """The end of a study.toml that looks for some causes: one and its look-alikes, where the whole catalogue is not the point."""
    return f"[stages.diagnose]\ncatalogue = {json.dumps(causes)}\n"


IN_ANGLES = only(
    "joint-error-map", "joint-eccentricity", "periodic-joint-error", "gear-transmission-error", "gear-ratio-error",
    "joint-backlash", "gravity-compensator", "link-bending",
)  # fmt: skip
IN_SPRINGS = only(
    "gravity-deflection", "link-bending", "link-torsion", "bearing-compliance", "base-compliance", "gravity-compensator",
    "nonlinear-joint-stiffness", "joint-error-map", "gear-ratio-error", "joint-eccentricity", "base-tilt", "tool-sag",
)  # fmt: skip


@pytest.mark.parametrize(
    ("hidden", "cause", "joint", "most"),
    [(replace(MAP, settings=IN_ANGLES), "joint-error-map", 2, 2),
     (replace(SPRING, settings=IN_SPRINGS), "gravity-deflection", 0, 6)],
    ids=["joint-error-map", "gravity-deflection on the loop"],
)  # fmt: skip
def test_a_cause_of_many_parameters_is_found(hidden, cause, joint, most, tmp_path):
    """Breaks if a cause is missed, called something else with certainty, or found at another joint."""
    seen = found(tmp_path, hidden, 11)
    assert seen.has(cause, joint), seen.causes
    assert len(seen.causes) <= most, seen.causes
    if joint:
        first = seen.causes.iloc[0]
        assert cause in seen.could_be(0), seen.causes
        assert first["gain_mean_mm"] > 0
        assert first["p_family"] < 0.01


def test_range_noise_is_a_model_of_the_noise(tmp_path):
    """Breaks if noise that grows with range is missed, taken for a cause that shifts points, or told of means of repeats."""
    assert_range_noise(tmp_path, 3)


def assert_range_noise(tmp_path, repeats: int) -> None:
    """Noise that grows with range is found alone, as large as it is."""
    few = only("range-noise", "thermal-growth", "gear-ratio-error", "joint-backlash")
    seen = found(tmp_path, case("serial", Hidden("range-noise", 0, 2.5e-5), repeats=repeats, settings=few), 12)
    assert list(seen.causes["cause"]) == ["range-noise"]
    row = seen.causes.iloc[0]
    assert abs(row["estimate"] - 2.5e-5) < 3 * row["sd"]
    summary = json.loads((seen.folder / "diagnose" / "summary.json").read_text(encoding="utf-8"))
    assert 0.0 < summary["sigma_mm"] < 0.05


def test_tracker_scale_is_said_to_be_out_of_reach(tmp_path):
    """Breaks if a scale error is claimed that equals longer links, or its candidate is skipped without a word."""
    longer = only("tracker-scale", "gear-ratio-error", "joint-eccentricity", "link-bending")
    seen = found(tmp_path, case("serial", Hidden("tracker-scale", 0, 3e-5), settings=longer), 13)
    assert seen.causes.empty
    tested = pd.read_csv(seen.folder / "diagnose" / "candidates.csv").set_index("cause")
    assert tested.loc["tracker-scale", "note"].startswith("not testable: needs relative_sd_mm")


BESIDE = case(  # benchmarks/slow finds the scale there, tests/effects by a wire beside the tracker
    "serial", Hidden("tracker-scale", 0, 8e-5), markers=3, relative_sd=2e-6, sigma=1e-5, poses=40,
    settings=only("tracker-scale", "gear-ratio-error", "tool-sag"),
)  # fmt: skip


def test_data_faults_are_found_before_the_fit(tmp_path):
    """Breaks if a fault is missed, blamed on good rows, or leads to a false cause."""
    assert_faults(tmp_path, "outlier", "encoder-turn")


def assert_faults(tmp_path, *faults: str) -> None:
    """These faults of a table are found, and no cause; benchmarks/slow has markers, signs and units."""
    variant = {"joint-sign": (4,), "encoder-turn": (2, 0.0, "gear"), "outlier": (0, 0.02)}
    hidden = [Hidden(fault, *variant.get(fault, ())) for fault in faults]
    several = {"markers": 3, "poses": 60} if "marker-swap" in faults else {}
    like_them = only("joint-backlash", "joint-eccentricity", "gear-ratio-error", "joint-step", "tool-slip", "tool-sag")
    seen = found(tmp_path, case("serial", *hidden, settings=like_them, **several), 14)
    assert {*faults} == {*seen.table.loc[seen.table["status"] == "data_fault", "cause"]}, seen.table
    assert seen.causes.empty, seen.causes


SEVERAL = {  # causes that act apart; benchmarks/hidden_cases.py has all of them found by the whole catalogue
    "loads and play": case(
        "serial", Hidden("gear-ratio-error", 4, 2e-3), Hidden("joint-backlash", 1, 1.5e-4), Hidden("torque-backlash", 3, 3e-4),
        Hidden("tool-deflection", 0, 3e-7), Hidden("frame-step", 0, 2e-4),
    ),
    "a cold robot": case(
        "serial", Hidden("thermal-growth", 0, 2.5e-4, "warm-up"), Hidden("payload-com", 0, 0.1), Hidden("link-torsion", 2, 3e-7),
        Hidden("nonlinear-joint-stiffness", 2, 1.5e-3), columns=CLOCK,
    ),
    "gas spring and bearing": case(
        "serial", Hidden("gravity-compensator", 2, 2e4), Hidden("bearing-compliance", 3, 4e-7, 0.3),
        Hidden("joint-eccentricity", 1, 3e-4, 2),
    ),
    "friction and bending": case(
        "hh800", Hidden("payload-mass", 0, 0.25), Hidden("gear-transmission-error", 1, 1e-4, 1),
        Hidden("joint-hysteresis", 2, 1e-4), Hidden("link-bending", 4, 5e-8), columns=("approach", "travel"),
    ),
    "wrist and warm air": case(
        "hh800", Hidden("wrist-coupling", 6, 2e-3, "65"), Hidden("periodic-joint-error", 1, 1.5e-4, 7.3),
        Hidden("frame-drift", 0, 3e-4), Hidden("thermal-growth", 0, 2.3e-5), columns=("approach", "time", "temperature"),
    ),
    "base and device": case(
        "hh800", Hidden("base-compliance", 0, 3e-8), Hidden("frame-step", 0, 4e-4, "turning"), Hidden("link-mass", 3, 0.3)
    ),
}  # fmt: skip


def test_several_causes_at_once_are_all_found(tmp_path):
    """Breaks if one is missed, hidden by others, found at another joint or called something else, or one more is added."""
    several = SEVERAL["loads and play"]
    seen = found(tmp_path, several, 11)
    names = sorted(zip(seen.causes["cause"], seen.causes["joint"].astype(int), strict=True))
    assert names == sorted((h.cause, h.joint) for h in several.hidden), seen.causes
    assert (seen.causes["gain_mean_mm"] > 0).all()
    assert (seen.causes["p_family"] < 0.01).all()


def test_nothing_is_found_where_nothing_is_hidden(tmp_path):
    """Breaks if noise with outliers is taken for a cause."""
    assert_silent(tmp_path, "outliers", "hh800")


def assert_silent(tmp_path, noise: str, robot: str) -> None:
    """No cause is found in noise alone; benchmarks/slow has heavy tails, and benchmarks/blind.py hundreds of cases."""
    seen = found(tmp_path, case(robot, noise=noise, columns=("approach", "time", "temperature")), 16)
    shifts = seen.causes[seen.causes["cause"] != "range-noise"]
    assert shifts.empty, shifts
    assert seen.unexplained.empty, seen.unexplained
    if noise == "outliers":
        assert set(seen.table["cause"]) == {"outlier"}
    else:
        assert seen.table.empty


TABLE_2 = case(  # of the paper on the HH800; benchmarks/slow finds the compliance of joints 2 and 3 from geometry alone
    "hh800", Hidden("joint-compliance", 0, 1.0), effects=("geometry",), payloads=("full",)
)


UNKNOWN = {  # and more in benchmarks/blind.py
    "cable drag": case("hh800", Hidden("cable-drag", 0, 6e-4)),
    "play, no side recorded": case("hh800", Hidden("joint-backlash", 3, 2e-4), columns=()),
    "load of a joint": case(
        "serial", Hidden("nonlinear-joint-stiffness", 5, 6e-4, "sides"), settings=only("joint-eccentricity", "joint-backlash")
    ),
}  # fmt: skip


def test_what_is_not_in_the_catalogue_is_not_named(tmp_path):
    """Breaks if an unknown cause is named with certainty, or passed over in silence; benchmarks/slow has the others."""
    assert_not_named(tmp_path, "load of a joint")


def assert_not_named(tmp_path, name: str) -> None:
    """An unknown cause is told as what nobody can name, or as one of several."""
    seen = found(tmp_path, UNKNOWN[name], 17)
    certain = seen.causes[(seen.causes["status"] == "named")]
    assert not seen.unexplained.empty or (len(seen.causes) and certain.empty), seen.table
    if name == "play, no side recorded":
        (statement,) = (told for told in seen.unexplained["statement"] if "comes to rest" in told)
        assert statement.startswith("joint 3 comes to rest elsewhere each time")
        low, high = map(float, re.findall(r"\(([\d.]+) to ([\d.]+)\)", statement)[0])
        assert low < 100 < high < 1.5 * low  # µrad: half of the play
    if name == "load of a joint":
        (statement,) = (told for told in seen.unexplained["statement"] if told.startswith("depends on tau5"))
        assert "nonlinear stiffness of joint 5" in statement
    if name == "cable drag":
        assert "q4" in "".join(seen.unexplained["statement"])
