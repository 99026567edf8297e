"""TOML files: quantities in SI units, and every mistake told with file, line, key and what was expected."""

from __future__ import annotations

import pytest

from calflow import InputError, load_study
from calflow.files.problems import nearest
from calflow.files.toml import Angle, FileModel, Length, Lengths3, line_numbers, read_toml


class Part(FileModel):
    """A table."""

    length: Length
    turn: Angle | None = None
    point: Lengths3 = (0.0, 0.0, 0.0)
    limits_deg: tuple[float, float] | None = None


class Whole(FileModel):
    """A file."""

    name: str
    first: Part
    parts: tuple[Part, ...] = ()
    named: dict[str, Part] = {}


def read(folder, text, **options):
    path = folder / "whole.toml"
    path.write_text(text, **options)
    return read_toml(path, Whole)


WHOLE = """
name = "whole"
first = { length_um = 5 }
[[parts]]
length_mm = 1
turn_deg = 180
point_mm = [1, 2.5, -3]
limits_deg = [1, 2]
[named.one]
length_m = 2
"""


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_quantities_are_converted_by_their_keys(tmp_path, encoding, newline):
    """Fails if a unit is dropped or used twice, an optional or listed quantity is forgotten, or Windows' files are refused."""
    whole = read(tmp_path, WHOLE, encoding=encoding, newline=newline)
    part = whole.parts[0]
    assert (part.length, *part.point) == pytest.approx((1e-3, 1e-3, 2.5e-3, -3e-3))
    assert (part.turn, part.limits_deg) == (pytest.approx(3.14159265358979), (1, 2))
    assert (whole.first.length, whole.named["one"].length) == pytest.approx((5e-6, 2))


MISTAKES = {
    "robot.toml": [
        ("a_mm = 100", "aa_mm = 100", "12: joints[2].aa_mm: unknown key, did you mean 'a_mm'?"),
        ("a_mm = 100", "A_MM = 100", "12: joints[2].A_MM: unknown key, did you mean 'a_mm'?"),
        ("a_mm = 100", "a_inch = 100", "12: joints[2].a_inch: unknown key"),
        ("a_mm = 100", "a = 100", "12: joints[2].a: needs its unit in the key: a_m or a_mm or a_um"),
        ("a_mm = 100", "a_deg = 100", "12: joints[2].a_deg: expected a unit of length: a_m or a_mm or a_um"),
        ("a_mm = 100", "a_mm = 100\na_m = 0.1", "13: joints[2].a_m: 'a' is given twice, in different units"),
        ("a_mm = 100", "a_mm = true", "12: joints[2].a_mm: expected a number, found true"),
        ("a_mm = 100", "a_mm = nan", "12: joints[2].a_mm: expected a finite number, found nan"),
        ("a_mm = 100", "a_mm = -inf", "12: joints[2].a_mm: expected a finite number, found -inf"),
        ("a_mm = 100", "a_mm = 1e300", "12: joints[2].a_mm: expected at most 1000 m, found 1e+300"),
        ("a_mm = 100", "a_m = 100", "12: joints[2].a_m: 100 m: no link of a robot is so long. Did you mean mm?"),
        ("[350, 0, 50]", "[350, 0, 50000]", "16: joints[2].com_mm: 50 m: no link of a robot is so long. Did you mean mm?"),
        ("alpha_deg = -90", "alpha_deg = -1e300", "13: joints[2].alpha_deg: expected at most 10000 rad, found -1e+300"),
        ("mass_kg = 30", "mass_kg = 1e300", "15: joints[2].mass_kg: expected at most 1e+06 kg, found 1e+300"),
        ("[350, 0, 50]", "[350, 0, 1e300]", "16: joints[2].com_mm: expected at most 1000 m, found [350, 0, 1e+300]"),
        ("[-100, 40]", "[-1e300, 40]", "14: joints[2].limits_deg: expected at most 10000 rad, found [-1e+300, 40]"),
        ("[-100, 40]", "[-100, 40]\ngear_ratio = 1e300", "15: joints[2].gear_ratio: expected at most 1e+09, found 1e+300"),
        ("a_mm = 100", "a_mm = 1" + 400 * "0", "12: joints[2].a_mm: expected a whole number of at most 9223372036854775807"),
        ("a_mm = 100", "a_mm = 1" + 5000 * "0", " cannot be read: Exceeds the limit"),
        ("a_mm = 100", "a_mm = 100\na_mm = 2", "13: not TOML: Cannot overwrite a value"),
        ("a_mm = 100", "a_mm = = 100", "12: not TOML: Invalid value"),
        ("[600, 50, 80]", "[600, 50, 80", "33: not TOML: Unclosed array"),
        ("[350, 0, 50]", "[350, 0]", "16: joints[2].com_mm: value 3 is missing"),
        ("[350, 0, 50]", "[350, 0, 50, 9]", "16: joints[2].com_mm: expected at most 3 of them, found [350, 0, 50, 9]"),
        ("[350, 0, 50]", '[350, 0, "x"]', "16: joints[2].com_mm[3]: expected a number, found 'x'"),
        ("mass_kg = 30", "mass_kg = -30", "15: joints[2].mass_kg: expected a number greater than or equal to 0, found -30"),
        ("mass_kg = 2\n", "", "25: payloads.light: missing: expected mass_kg or mass_g"),
        ("mass_kg = 2\n", 'mass_kg = "Unknown"\n',
         "26: payloads.light.mass_kg: expected a number or \"unknown\", found 'Unknown'"),
        ("[600, 50, 80]", "[600, 50, 80]\nrelative_sd_mm = 1\nknown = false", "32: markers.tool: a marker with relative_sd"),
        ("modified-dh", "modifed-dh", "3: convention: expected 'dh', 'modified-dh' or 'frames', found 'modifed-dh'"),
        ("[-100, 40]", "[40, -100]", "14: joints[2].limits_deg: expected lower < upper, found 40 and -100"),
        ("limits_deg = [-100, 40]", "limits_mm = [-1, 1]", "11: joints[2]: a revolute joint has limits_deg, not limits_mm"),
        ("a_mm = 100", 'kind = "prismatic"', "11: joints[2]: a prismatic joint needs limits_mm"),
        ("[markers.tool]", "[[couplings]]\njoint = 1\nsource = 4\nfactor = 1\n[markers.tool]",
         "34: couplings[1].source: there is no joint 4: this robot has joints 1 to 3"),
        ("[markers.tool]\npoint_mm", "[payloads.tool]\nmass_kg = 1\ncom_mm", " markers: expected at least one marker"),
        ("[markers.tool]", "[markers.base]", "32: markers: a marker cannot be called 'base'"),
    ],
    "study.toml": [
        ("seed = 7", "seed = 7\nefects = []", "5: efects: unknown key, did you mean 'effects'?"),
        ("seed = 7", "seed = 7\n" + 100_000 * "k" + " = 1", f"5: {60 * 'k'} …: is too long: expected at most 200 characters"),
        ('"small"', f'"{100_000 * "n"}"', "1: name: is too long: expected at most 200 characters in a name, 10000 in a text"),
        ("joint-compliance", 9000 * "j", f"5: effects: unknown effect '{9000 * 'j'}"[:900]),
        ("seed = 7", "", " missing: expected 'seed'"),
        ("seed = 7", 'seed = "7"', "4: seed: expected a whole number, found '7'"),
        ("seed = 7", "seed = 0x" + 5000 * "f", "4: seed: expected a whole number of at most 9223372036854775807"),
        ("seed = 7", "seed = -7", "4: seed: expected a number greater than or equal to 0, found -7"),
        ('"small"', "5", "1: name: expected a text in quotes, found 5"),
        ('"small"', '".."', "1: name: expected letters, digits"),
        ('"small"', '"a/b"', "1: name: expected letters, digits"),
        ('"small"', '"small', "1: not TOML: Illegal character"),
        ('["geometry", "joint-compliance"]', '"geometry"', "5: effects: expected a list [ … ], found 'geometry'"),
        ("joint-compliance", "joint-complance", "5: effects: unknown effect 'joint-complance', did you mean 'joint-compliance'?"),
        ("joint-compliance", "geometry", "5: effects: expected at least one effect, and each once"),
        ("quick.toml", "calibrat", "3: workflow: unknown workflow 'calibrat'; there are calibrate, diagnose, paper-table"),
        ("[split]\nholdout", "[split]\nhold_out", "11: split.hold_out: unknown key, did you mean 'holdout'?"),
        ("holdout = 0.3", "holdout = 1", "11: split.holdout: expected a number less than 1, found 1"),
        ("[split]", "[measurements]", "10: not TOML: Cannot declare ('measurements',) twice"),
        ("[split]", 'sha256 = "abc"\n[split]', "10: measurements.sha256: expected 64 digits 0-9 and a-f, found 3 characters"),
        ("[split]", 'url = "https://a.b/c"\n[split]', "7: measurements: a url needs the file's sha256"),
        ("[split]", 'decimal = ","\n[split]', "7: measurements: separator and decimal are both ','"),
        ("[split]", 'separator = ""\n[split]', "10: measurements.separator: expected one character, found ''"),
        ("[split]", 'encoding = "uft-8"\n[split]', "10: measurements.encoding: expected a name such as utf-8"),
        ("[split]", 'decimal = ";"\n[split]', "10: measurements.decimal: expected '.' or ',', found ';'"),
        ("poses = 8", "poses = 8\ntask = {region_mm = [0, 0, 0]}",
         "15: stages.select.task.region_mm: unknown key, did you mean 'region_min_mm'?"),
        ("poses = 8", "posse = 8", "14: stages.select.posse: unknown key, did you mean 'poses'?"),
        ("poses = 8", "poses = 8.0", "14: stages.select.poses: expected a whole number, found 8.0"),
        ("poses = 8", "region_min_mm = [0, 0, 0]", "13: stages.select: region_min and region_max go together"),
        ("[stages.select]", "[stages.selct]", "13: stages.selct: unknown stage, did you mean 'select'?"),
        ("[stages.select]\nposes", "[stages]\nselect", "14: stages.select: expected a table, found 8"),
    ],
    "quick.toml": [
        ('"identify", ', '"identfy", ', "2: stages: unknown stage 'identfy', did you mean 'identify'?"),
        ('"identify", "sample"', '"identify", "identify"', "2: stages: expected each stage once"),
        ('"identify", "sample"', '"sample", "identify"', "2: stages: stage 'sample' comes before 'identify', which it needs"),
        ('"identify", "sample"', '"sample"', "2: stages: stage 'sample' needs 'identify', which is not there"),
        ('["select", "identify", "sample"]', "[]", "2: stages: expected at least 1 of them, found []"),
        ("[settings.identify]", "[setings.identify]", "7: setings: unknown key, did you mean 'settings'?"),
        ("[settings.identify]", "[settings.identfy]", "7: settings.identfy: unknown stage, did you mean 'identify'?"),
        ("starts = 1", "start = 1", "8: settings.identify.start: unknown key, did you mean 'starts'?"),
        ("starts = 1", "starts = 0", "8: settings.identify.starts: expected a number greater than or equal to 1, found 0"),
    ],
}  # fmt: skip
ALL = [
    pytest.param(file, *mistake, id=f"{file}:{mistake[2]}")
    for file, mistakes in MISTAKES.items()
    for mistake in mistakes
]


@pytest.mark.parametrize(("file", "old", "new", "expected"), ALL)
def test_a_mistake_is_told_once_with_its_place(small, file, old, new, expected):
    """Fails if a mistake passes or tears others along, or is told without line, key as written, or what was expected."""
    small.edit(file, (old, new))
    (told,) = small.refused("check")
    assert told.startswith(f"{file}:{expected}")


def test_mistakes_of_stages_and_kinds_are_told_with_all_others(small):
    """Fails if a mistake in a stage's settings, or in what was measured, waits until all others of the study are mended."""
    small.edit(
        "study.toml",
        ("joint-compliance", "joint-complance"),
        ("[split]", 'kind = "posse"\nsepparator = ";"\n[split]'),
        ("holdout = 0.3", "holdout = 1"),
        ("poses = 8", "posse = 8"),
    )
    small.edit("quick.toml", ("starts = 1", "starts = 0"))
    small.edit("robot.toml", ("mass_kg", "mas_kg"))
    told = small.refused("check")
    for expected in (
        "study.toml:5: effects: unknown effect 'joint-complance', did you mean 'joint-compliance'?",
        "study.toml:10: measurements.kind: unknown kind 'posse'; there are ",
        "study.toml:11: measurements.sepparator: unknown key, did you mean 'separator'?",
        "study.toml:13: split.holdout: expected a number less than 1, found 1",
        "study.toml:16: stages.select.posse: unknown key, did you mean 'poses'?",
        "quick.toml:8: settings.identify.starts: expected a number greater than or equal to 1, found 0",
        "mas_kg: unknown key, did you mean 'mass_kg'?",
    ):
        assert any(expected in message for message in told), (expected, told)


def test_settings_of_a_kind_are_told_with_all_others(small):
    """Fails if settings that a kind does not have are read as those of another, or wait until the rest is mended."""
    small.edit("study.toml", ("[split]\nholdout = 0.3", "[measurements.settings]\nlens_mm = 3\n[split]\nholdout = 1"))
    told = small.refused("check")
    assert told[0].startswith("study.toml:11: measurements.settings.lens_mm: unknown key")
    assert told[1].startswith("study.toml:13: split.holdout: expected a number less than 1")
    assert len(told) == 2


def test_a_name_in_short_is_not_taken_for_another():
    """Fails if a temperature in degrees Celsius is said to be meant in kelvin, whose key has as many letters."""
    names = ("temperature_K", "temperature_degC", "time_s")
    assert nearest("temperature_C", names) == ", did you mean 'temperature_degC'?"
    assert nearest("temperatur_K", names) == ", did you mean 'temperature_K'?"


def test_a_copy_without_its_workflows_is_told_as_such(small, monkeypatch, tmp_path):
    """Fails if an incomplete copy of calflow is told as a mistake of the study, with an empty list of workflows."""
    small.edit("study.toml", ("quick.toml", "calibrate"))
    monkeypatch.setattr("calflow.study.workflow_folder", lambda: tmp_path / "workflows")
    (told,) = small.refused("check")
    assert "3: workflow: calflow's own workflows are not in" in told
    assert "install calflow again" in told


@pytest.mark.parametrize(
    ("robot", "told"),
    [
        ("robt.toml", "no such file, did you mean 'robot.toml'?"),
        (".", "cannot be read"),
        ("measurements.csv", "not TOML"),
    ],
)
def test_a_file_that_is_not_there_or_no_toml_is_named(small, robot, told):
    """Fails if a missing file, a folder, or a table in place of TOML ends in a traceback."""
    small.edit("study.toml", ('"robot.toml"', f'"{robot}"'))
    (problem,) = small.refused("check")
    assert told in problem


@pytest.mark.parametrize(
    "path", ["C:\\data\\points.csv", "C:\\Users\\me.csv", "D:\\new.csv", "C:\\bin.csv", "..\\data.csv", "data\\a.csv"]
)
def test_a_path_with_backslashes_is_told_how_to_be_written(small, path):
    """Fails if a Windows path in double quotes ends in TOML's words alone, or as a file that is not there."""
    study = small / "study.toml"
    text = study.read_text(encoding="utf-8")
    study.write_text(text.replace('"measurements.csv"', f'"{path}"'), encoding="utf-8")
    with pytest.raises(InputError, match="write the path with /"):
        load_study(study)
    study.write_text(text.replace('"measurements.csv"', f"'{path}'"), encoding="utf-8")
    assert load_study(study)


def test_a_decimal_comma_is_told(small):
    """Fails if a number with a decimal comma ends in TOML's words alone."""
    small.edit("robot.toml", ("a_mm = 100", "a_mm = 100,5"))
    assert small.refused("check")[0].endswith("; numbers have a decimal point")


def test_of_many_mistakes_the_first_are_told_and_the_others_counted(small):
    """Fails if thousands of problems scroll by, one kind hides another, or none says how many there are."""
    small.edit("robot.toml", ("a_mm = 100", "a = 100"), ("[payloads.light]", "\n".join(
        f"[payloads.p{i}]\nmass_kg = -1\ncolour = 1" for i in range(2000)) + "\n[payloads.light]"))  # fmt: skip
    told = small.refused("check")
    assert told[0].startswith("robot.toml:12: joints[2].a: needs its unit")
    assert len(told) == 1 + 2 * (20 + 1)
    assert sum(problem.endswith(": and 1980 more problems like this one") for problem in told) == 2


def test_all_mistakes_of_all_files_are_told_at_once(small):
    """Fails if the user has to come back for the next mistake, of the same table or of the other file."""
    small.edit("robot.toml", ("a_mm = 100", "a = 100"), ("alpha_deg = -90", "alpha_mm = 5"), ("mass_kg = 30", "mas_kg = 30"),
               ("point_mm", "pont_mm"))  # fmt: skip
    small.edit("quick.toml", ("stages =", "stage ="), ("[settings.identify]", "[setting.identify]"))
    assert [problem.rsplit(": ", 1)[0] for problem in small.refused("check")] == [
        "robot.toml:12: joints[2].a: needs its unit in the key",
        "robot.toml:13: joints[2].alpha_mm: expected a unit of angle",
        "robot.toml:15: joints[2].mas_kg",
        "robot.toml:32: markers.tool: missing",
        "robot.toml:33: markers.tool.pont_mm",
        "quick.toml: missing",
        "quick.toml:2: stage",
        "quick.toml:7: setting",
    ]


def test_mistakes_in_the_settings_of_several_stages_are_told_at_once(small):
    """Fails if one stage's settings hide another's, or a stage that the workflow leaves out is not looked at."""
    small.edit("quick.toml", (', "sample"', ""), ("starts = 1", "starts = 0"), ("block = 20", "block = 2"))
    small.edit("study.toml", ("poses = 8", "poses = 1\n[stages.report]\ncolour = 1"))
    assert small.refused("check") == [
        "study.toml:14: stages.select.poses: expected a number greater than or equal to 4, found 1",
        "quick.toml:8: settings.identify.starts: expected a number greater than or equal to 1, found 0",
        "quick.toml:12: settings.sample.block: expected a number greater than or equal to 10, found 2",
        "study.toml:16: stages.report.colour: unknown key",
    ]


def test_a_line_is_found_past_texts_lists_and_tables_of_any_form():
    """Fails if a text of several lines or a nested list is read as keys and tables, or quoted and dotted keys are missed."""
    text = '''
name = """ a text of
[parts]
length = 5
"""
limits = [
  [1, 2],
  [3]
]
"odd key" = 1
gravity.x = 0
[[parts]] # one
length_mm = 1
[parts.sub]
a = 1
[[ parts ]]
length_mm = 2
[ named . "b c" ]
length_mm = { x = 3 }
note = in one line
last = 4
'''
    assert line_numbers(text) == {
        ("name",): 2,
        ("limits",): 6,
        ("odd key",): 10,
        ("gravity", "x"): 11,
        ("parts", 0): 12,
        ("parts", 0, "length_mm"): 13,
        ("parts", 0, "sub"): 14,
        ("parts", 0, "sub", "a"): 15,
        ("parts", 1): 16,
        ("parts", 1, "length_mm"): 17,
        ("named", "b c"): 18,
        ("named", "b c", "length_mm"): 19,
        ("named", "b c", "note"): 20,
        ("named", "b c", "last"): 21,
    }
