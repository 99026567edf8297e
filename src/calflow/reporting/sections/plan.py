"""The first page of a plan: how many poses, how sure they make the tool, what they cannot tell apart, and what to do."""

from __future__ import annotations

import math

from calflow.design.separability import isolability_gaps, isolability_summary
from calflow.design.worth import HowMany, Worth
from calflow.files.results import Results
from calflow.files.words import first_up, listed, mm, percent, plural
from calflow.reporting.blocks import Block, Bullets, Card, Columns, Gap, Heading, Item, Paragraph, Plot, RestOfPage
from calflow.reporting.figures.poses import expected_error
from calflow.reporting.material import Material
from calflow.reporting.section import Section
from calflow.reporting.sections.told_apart import TABLE as ISOLABILITY

NEEDS = ("select/poses.csv", "select/observability.csv", "select/how_many.json", "select/worth.csv")
GAPS = 5  # that are told on the first page
UNASKED = "Not worked out: isolability = true in the study's [stages.select] says which causes these poses would show."
WORTH = "Expected standard deviation of the predicted tool position over the task, by the number of poses."


def write(material: Material) -> list[Block]:
    """Put the plan on one page."""
    results = material.results
    how_many = results.document("select/how_many.json", HowMany)
    worth = results.rows("select/worth.csv", Worth)
    curve = results.tables["select/observability.csv"]
    expected, largest = how_many.expected_sd_mm, float(curve["worst_sd_mm"].iloc[-1])
    cards = [
        Card(plural(how_many.n_poses, "pose"), mm(expected), f"where least sure {mm(largest)} mm", dark=True),
        *(Card(first_up(row.addition), mm(row.expected_sd_mm), f"{row.gain_percent:.0f} % less") for row in worth[1:3]),
    ]
    lists: list[tuple[str, list[Item]]] = [
        ("What these poses cannot tell apart, and what would change that", _gaps(results)),
        ("What to do next", _next(how_many, worth)),
    ]
    return [
        Paragraph("Measurement plan", 10),
        Heading(material.title, 0),
        Paragraph(_planned(material), 10),
        Gap(20),
        Paragraph(verdict(how_many), 14, bold=True),
        Gap(16),
        Columns([[card] for card in cards], [1] * len(cards), 8),
        Gap(16),
        Columns(
            [[Plot("expected_error", expected_error(curve, how_many), WORTH, curve)],
             [Heading("How many poses?"), Bullets([*number_words(how_many), *_held_out(material, how_many)], 10.5)]],
            [1, 1],
        ),
        RestOfPage([block for title, lines in lists for block in (Heading(title), Bullets(lines, None))]),
    ]  # fmt: skip


def verdict(how_many: HowMany) -> str:
    """Say what the poses are worth."""
    said = f"{plural(how_many.n_poses, 'pose')} make the tool's position certain to {mm(how_many.expected_sd_mm)} mm"
    if how_many.tolerance_mm is None:
        return f"{said}."
    met = "met" if how_many.expected_sd_mm <= how_many.tolerance_mm else "not met"
    return f"{said}: the {mm(how_many.tolerance_mm)} mm asked for are {met}."


def number_words(how_many: HowMany) -> list[Item]:
    """Say what the number of poses is worth: the knee, ten more, and the tolerance."""
    said: list[Item] = [
        ("Knee:", f"the curve bends at {how_many.knee_poses} poses: fewer cost much, more gain little."),
        ("Ten more", f"would lower it by {mm(how_many.next_ten_mm)} mm."),
    ]
    if how_many.tolerance_mm is None:
        return said
    asked = f"{mm(how_many.tolerance_mm)} mm"
    if how_many.enough_poses is None:
        return [*said, (f"{asked}", "are not met by any number of these candidates.")]
    return [
        *said,
        (f"{asked}", f"are met with {how_many.enough_poses} poses; no choice of fewer than {how_many.needed_poses} meets them."),
    ]  # fmt: skip


def _held_out(material: Material, how_many: HowMany) -> list[Item]:
    """Say that poses which are held out do not count."""
    share = material.study.file.split.holdout
    if not share:
        return []
    more = math.ceil(how_many.n_poses / (1 - share))
    return [
        (
            "Held out:",
            f"these are poses that are fitted. The study holds out {percent(share)}: for that measure {more}.",
        )
    ]


def _planned(material: Material) -> str:
    poses, study = material.tables["select/poses.csv"], material.study
    loads = [str(load) for load in poses["payload"].dropna().unique() if load]
    parts = [
        f"Robot: {study.robot.name}",
        plural(len(poses), "pose"),
        f"marker {listed(list(poses['marker'].astype(str).unique()), 3)}",
        *([f"payload {listed(loads, 3)}"] if loads else []),
        "1 sd, root mean square over the task; nothing is measured yet",
    ]
    return "  ·  ".join(parts)


def _gaps(results: Results) -> list[Item]:
    """What the poses cannot tell, each with the cheapest thing that fills it."""
    if ISOLABILITY not in results:
        return [UNASKED]
    table = results.tables[ISOLABILITY]
    gaps = isolability_gaps(table)
    left = int(table["worst"].sum()) - len(gaps[:GAPS])
    more: list[Item] = (
        [f"{plural(left, 'further gap')} in {ISOLABILITY}, some of which nothing tried fills."] if left else []
    )
    return [*(f"{first_up(words)}." for words in (isolability_summary(table), *gaps[:GAPS])), *more]


def _next(how_many: HowMany, worth: list[Worth]) -> list[Item]:
    """What to do with the plan."""
    said: list[Item] = []
    if how_many.enough_poses and how_many.enough_poses > how_many.n_poses:
        said.append(f"Plan {how_many.enough_poses} poses for the tolerance that was asked for.")
    if len(worth) > 1:
        best = worth[1]
        said.append(f"Weigh this first: {best.addition} takes {best.gain_percent:.0f} % off the tool's error.")
    return [
        *said,
        "Try the way from pose to pose in simulation, then measure select/poses.csv in its order.",
        "Fill in x_mm, y_mm and z_mm: the file is then one of measurements, with which a study is run.",
    ]


SECTION = Section(
    1, "Plan", NEEDS, write, worth_telling=lambda results: "identify/summary.json" not in results
)  # a calibration has a first page of its own
