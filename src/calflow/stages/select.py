"""The stage select: which poses to measure, by observability."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from calflow.design.candidates import candidates
from calflow.design.measuring_order import DriftPull, drift_words, sides_words
from calflow.design.planned import Planned
from calflow.design.selection import Certificate, Observability, PlannedPose, Selection, select
from calflow.design.separability import (
    Isolability,
    IsolabilityCell,
    Visits,
    isolability,
    isolability_gaps,
    isolability_summary,
    isolability_table,
)
from calflow.design.worth import HowMany, Worth, worth_words
from calflow.diagnosis.search.trial import FALSE_ALARM
from calflow.files.problems import InputError
from calflow.files.results import Results, to_document
from calflow.files.tables import to_frame
from calflow.model import Model, build
from calflow.robot.parts import Base
from calflow.stages.select_settings import SelectSettings
from calflow.stages.select_study import (
    SIDES,
    by_sides,
    from_outside,
    measured_rows,
    named_files,
    planned_of,
    problems,
    request_of,
)
from calflow.stages.stage import Context, Stage

SAID = 5  # gaps in words


def run(context: Context) -> Results:
    """Choose poses by D-optimal greedy addition and exchange, and tell what every number of them is worth."""
    study, settings = context.study, context.settings
    if wrong := problems(study, settings, None):
        raise InputError(wrong)
    robot = study.robot if from_outside(study) else replace(study.robot, base=Base(fixed=True))
    planned = planned_of(study, settings)
    effects = tuple(dict.fromkeys((*study.file.effects, *settings.also_effects)))
    one_sided = by_sides(effects)
    model = build(robot, [effect for effect in effects if effect not in one_sided], (), (planned.observation,))
    request = replace(
        request_of(study, settings, model, planned, context.rng("task")),
        there=measured_rows(study.measurements()) if settings.add_to_measured else None, tolerance=settings.tolerance,
        refine=settings.refine, order=settings.order, drift=settings.drift, both_sides=bool(one_sided),
    )  # fmt: skip
    chosen = select(model, request, rng=context.rng, say=context.say, advance=context.advance)
    for line in (*worth_words(chosen.worth), *drift_words(chosen.drift), *sides_words(chosen.poses, one_sided)):
        context.say(line)
    tables = {
        "select/poses.csv": chosen.poses,
        "select/observability.csv": chosen.observability,
        "select/worth.csv": to_frame(chosen.worth, Worth),
        "select/order.csv": to_frame(chosen.drift, DriftPull),
    }
    if settings.isolability:
        tables["select/isolability.csv"] = _isolability(context, model, planned, chosen)
    documents = {"select/certificate.json": chosen.certificate, "select/how_many.json": chosen.how_many}
    return Results(tables, {path: to_document(one) for path, one in documents.items()})


def _isolability(context: Context, model: Model, planned: Planned, chosen: Selection) -> pd.DataFrame:
    """Say what the poses can tell apart, with and without what could be added to them."""
    study, settings, n = context.study, context.settings, len(chosen.readings)
    marker = settings.marker or next(iter(model.robot.markers))
    records = frozenset(settings.records) | (frozenset() if chosen.vias is None else SIDES)
    visits = Visits(model.robot, chosen.readings, (settings.payload,) * n, (marker,), records, chosen.vias)
    more, _ = candidates(
        model, n, settings.payload, marker, settings.region, context.rng("further poses"), planned.observation
    )
    false_alarm = float(study.settings("diagnose").get("false_alarm", FALSE_ALARM))

    def told(of: Visits) -> Isolability:
        rng = context.rng("isolability")  # the same noise each time: what differs is the plan
        return isolability(
            study.file.effects, planned, of, rng, size=settings.isolability_size, false_alarm=false_alarm,
            holdout=study.file.split.holdout, seed=study.file.seed,
        )  # fmt: skip

    now = told(visits)
    table = isolability_table(
        now, settings.isolability_size, {words: told(added) for words, added in visits.additions(more)}
    )
    context.say(isolability_summary(table))
    gaps = isolability_gaps(table)
    for line in gaps[:SAID]:
        context.say(line)
    if more_gaps := int(table["worst"].sum()) - len(gaps[:SAID]):
        context.say(f"{more_gaps} further gaps are in select/isolability.csv")
    return table


STAGE = Stage(
    "select",
    "choose the poses to measure",
    SelectSettings,
    run,
    measured=False,
    tables={
        "select/poses.csv": PlannedPose,
        "select/observability.csv": Observability,
        "select/worth.csv": Worth,
        "select/order.csv": DriftPull,
        "select/isolability.csv": IsolabilityCell,
    },
    documents={"select/certificate.json": Certificate, "select/how_many.json": HowMany},
    problems=problems,
    reads=named_files,
)
