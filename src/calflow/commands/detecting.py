"""The command detect, which converts images of a printed target to measurements."""

from __future__ import annotations

import re
from pathlib import Path

import click

from calflow.commands.console import FILE, FOLDER, cli, say, say_notes
from calflow.files.deferred import pd
from calflow.files.problems import Problem, escaped, refuse, refuse_any
from calflow.files.words import listed, plural

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
READING = re.compile(r"q\d+_\w+")  # the name of a column of joint readings
MOST_SAID = 10  # most images left out that are named


@cli.command("detect")
@click.argument("images", metavar="IMAGE…", type=FILE, nargs=-1, required=True)
@click.option("--target", type=FILE, required=True, help="The printed target: board.toml.")
@click.option(
    "--joints", type=FILE, help="CSV of joint readings, q1_deg …, a row an image, named by its column 'image'."
)
@click.option("--into", type=FOLDER, default=Path("."), help="Folder of the study; the working folder by default.")
def detect_command(images: tuple[Path, ...], target: Path, joints: Path | None, into: Path) -> None:
    """Find the points of a printed target in images, and write them as measurements.

    IMAGE may be a folder: every image in it counts. Pictures of what was found are written into the folder detections,
    and why an image was left out into detections/left_out.csv.
    """
    from calflow.files.tables import csv_text
    from calflow.files.writing import write_text, write_whole
    from calflow.importing.target_detection import detect_targets
    from calflow.measurements.rows import Layout, read_cells

    measured = into / "measurements.csv"
    refuse_any([Problem("is there already; nothing was written", measured)] if measured.exists() else [])
    files = [file for path in images for file in (_images_in(path) if path.is_dir() else [path])]
    if not files:
        raise refuse(f"holds no image: expected {', '.join(SUFFIXES)}", images[0])
    readings = read_cells(joints, Layout()) if joints else None
    notes = () if readings is None else _check_readings(readings, [file.name for file in files], joints)
    detected = detect_targets(files, target)
    table, left_out = detected.table, dict(detected.left_out)
    if readings is not None:
        in_images = table["image"].isin(readings["image"])
        left_out |= dict.fromkeys(table.loc[~in_images, "image"], "has no row of joint readings")
        readings_only = readings.drop(columns=[name for name in readings if name in table and name != "image"])
        table = table[in_images].merge(readings_only.drop_duplicates("image"), on="image", how="left")
        table = _with_repeats(table)
    if not len(table):
        name, reason = next(iter(left_out.items()))
        raise refuse(f"no image is of use: {escaped(name)} {reason}", files[0])
    write_text(measured, csv_text(table))
    for name, picture in detected.pictures.items():
        write_whole(into / "detections" / f"{name}.png", picture)
    reasons = pd.DataFrame({"image": list(left_out), "reason": list(left_out.values())})
    write_text(into / "detections" / "left_out.csv", csv_text(reasons))
    say(f"{plural(len(table), 'point')} in {table['image'].nunique()} of {plural(len(files), 'image')}")
    if "repeat" in table:
        say(f"images with the same joint readings are repeats of one pose: {table['pose'].nunique()} poses")
    say(*(f"left out: {escaped(name)} {reason}" for name, reason in list(left_out.items())[:MOST_SAID]))
    if len(left_out) > MOST_SAID:
        say(f"and {len(left_out) - MOST_SAID} more, see {into / 'detections' / 'left_out.csv'}")
    say_notes((*detected.notes, *notes))
    say(f"wrote {measured}, pictures of what was found into {into / 'detections'}")
    state, give = 'state [measurements] kind = "camera" in the study', "give each pose its joint readings, or --joints"
    say(f"next: {state if joints else give}")


def _check_readings(readings: pd.DataFrame, files: list[str], path: Path | None) -> tuple[str, ...]:
    """Check that a table of readings names images and has figures of joints; return a note on images that are not there.

    Raises:
        InputError: it does not, or an image has two rows that differ.
    """
    if "image" not in readings:
        raise refuse("expected a column 'image' with the images' names", path)
    joints = [name for name in map(str, readings) if READING.fullmatch(name)]
    if not joints:
        raise refuse(
            f"expected joint readings, q1_deg … (or _rad, _mm), found columns {', '.join(map(str, readings))}", path
        )
    missing = readings[joints].apply(pd.to_numeric, errors="coerce").isna().any(axis=1)
    each = readings.drop_duplicates(["image", *joints])
    wrong = dict.fromkeys(readings.index[missing], "expected a number in each of its joint columns")
    first = dict(zip(each["image"][::-1], each.index[::-1], strict=True))
    again = each.index[each.duplicated("image")]
    wrong |= {row: f"has other joint readings in line {first[readings['image'][row]]}" for row in again}
    refuse_any(Problem(f"{readings['image'][row]}: {what}", path, row) for row, what in wrong.items())
    names = dict.fromkeys(readings["image"].astype(str))
    absent = [name for name in names if name not in files]
    if len(absent) == len(names):
        raise refuse(
            f"its column 'image' names none of the images: expected {listed(files, 2)}, found {listed(absent, 2)}", path
        )
    more = f" and {len(absent) - 1} more" if len(absent) > 1 else ""
    return (f"the readings of {escaped(absent[0])}{more} belong to no image that was given",) if absent else ()


def _with_repeats(table: pd.DataFrame) -> pd.DataFrame:
    """Return the points with images of equal joint readings, of one standstill, as repeats of the first one's pose."""
    images = table.drop_duplicates("image").set_index("image")
    readings = [name for name in map(str, table) if READING.fullmatch(name)]
    if not readings or "repeat" in table or not images.duplicated(readings).any():
        return table
    alike = images.groupby(readings, dropna=False)["pose"]
    pose, repeat = alike.transform("min"), alike.cumcount() + 1
    return table.assign(pose=table["image"].map(pose), repeat=table["image"].map(repeat))


def _images_in(folder: Path) -> list[Path]:
    """Return the images of a folder, in numerical order (2 before 10)."""
    return sorted((f for f in folder.iterdir() if f.suffix.lower() in SUFFIXES), key=lambda f: (len(f.stem), f.name))
