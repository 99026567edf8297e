"""A page of the documentation for an effect, from what its file says of itself and what it does on the bench."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Iterable

import numpy as np

from calflow.effects import Effect, catalogue
from calflow.effects.base import NEEDS
from calflow.files.words import first_up, part_words
from made import pictures
from made.bench import FITTED, Bench, benches
from made.rivals import NOTHING, WORTH, Likeness, likenesses

FORMS = 8  # of one effect that a page names
COLUMNS = 76


def effect_page(effect: type[Effect]) -> tuple[str, bytes]:
    """Return the page's text, in Markdown, and its picture, as SVG."""
    bench = next((bench for bench in benches() if bench.forms(effect)), benches()[0])
    forms = bench.forms(effect)
    shown = pictures.shown(bench, forms[0])
    picture = pictures.of_effect(bench, forms[0], shown)
    words = effect.in_words()
    pieces = [
        f"# {first_up(effect.title)}",
        f"`{effect.id}`: {words.what}. In a report it is *{words.name}*." if words.what else f"`{effect.id}`",
        *_equation(effect),
        *_parameters(bench, forms[0]),
        *_needs(effect),
        "## What it does",
        f"![error by {effect.id}]({effect.id}.svg)",
        f"{first_up(part_words(shown.part))}, of a size that moves the tool by {1e3 * pictures.MOVED:g} mm (root mean square): "
        f"{_figures(shown.figures)}. Each point, and each arrow, is one of {len(bench.data)} random poses of {_which(bench)}.",
        *_likenesses(bench, forms),
        "All effects and how to add one: [effects](../effects.md).",
    ]
    return "\n\n".join(pieces) + "\n", picture


def paragraphs(thing: type) -> list[str]:
    """Return the paragraphs of a docstring, each on one line."""
    return [" ".join(piece.split()) for piece in (inspect.getdoc(thing) or "").split("\n\n")]


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table in Markdown."""
    lines = [list(head), *map(list, rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


def _equation(effect: type[Effect]) -> list[str]:
    first, *rest = paragraphs(effect)
    return ["## Equation", f"```text\n{textwrap.fill(first, COLUMNS)}\n```", *rest]


def _parameters(bench: Bench, form: Effect) -> list[str]:
    """One row for each kind of parameter: its parts and numbers brought together."""
    moved = 1e3 * np.sqrt((bench.response(form) ** 2).sum(axis=1).mean(axis=0))
    kinds: dict[tuple[str, str], list[int]] = {}
    for k, parameter in enumerate(form.declared):
        symbol = re.sub(r"^wave\d+", "waveK", parameter.symbol)
        kinds.setdefault((re.sub(r"\d+$", "N", parameter.part) + "." + symbol, parameter.unit), []).append(k)
    rows = []
    for (name, unit), of in kinds.items():
        mine = [form.declared[k] for k in of]
        rows.append((
            f"`{name}`", unit, _range([p.prior_sd for p in mine]),
            _range([p.lower for p in mine]) + " … " + _range([p.upper for p in mine]),
            "–" if form.is_noise() else _range([moved[k] * form.declared[k].prior_sd for k in of]),
        ))  # fmt: skip
    head = ("parameter", "unit", "prior sd", "bounds", "moves the tool by one sd of it [mm]")
    return ["## Parameters", table(head, rows)]


def _needs(effect: type[Effect]) -> list[str]:
    needed = [NEEDS[need].words for need in effect.needs]
    arm = benches()[0]
    bare = effect.lacking(arm.robot, arm.data.stating(()))
    said = [f"- {one}" for one in needed] or [
        f"- {bare}" if bare else "- nothing besides joint readings and what was measured"
    ]
    if instead := effect.superseded(arm.robot, arm.data):
        said.append(f"- not looked for where {instead}")
    if effect.id in FITTED:
        said.append(
            "- a study begins with it, in `effects`; any other effect can be listed there too, or is looked for"
        )
    return ["## What it needs", "\n".join(said)]


def _likenesses(bench: Bench, forms: tuple[Effect, ...]) -> list[str]:
    effect = forms[0]
    said = ["## What looks like it"]
    if effect.family:
        others = [other.id for other in catalogue().values() if other.family == effect.family and other.id != effect.id]
        said.append(
            f"It is of the family *{effect.family}*, with {_links(others)}: if the data do not show which, the family is named."
        )
    if effect.alike:
        said.append(f"No pose distinguishes it from {_links(effect.alike)}.")
    if effect.taken_for:
        said.append(f"If the data lack what a test of it needs, it may be mistaken for {_links(effect.taken_for)}.")
    if effect.told_by:
        said.append(f"To distinguish it from its rivals: {effect.told_by}.")
    if not effect.is_noise() and effect not in bench.fitted:
        rows = [(part_words(one.part), _percent(one.taken), _rivals(one)) for one in likenesses(bench, effect)]
        absorb = "geometry and joint compliance absorb" if len(bench.fitted) > 1 else "geometry absorbs"
        said.append(
            f"At the {len(bench.data)} poses of the picture, {absorb} part of its error. Other causes would explain these "
            "shares of what is left, the closest first:"
        )
        said.append(table(("place", "absorbed", "what is left looks like"), rows))
        said.append("Other poses, loads and robots give other figures; `diagnose` computes those of your data.")
    if len(forms) > 1:
        named = [form.detail or form.variant for form in forms[:FORMS]]
        more = f", and {len(forms) - FORMS} more" if len(forms) > FORMS else ""
        said.append(f"Forms that are tried: {'; '.join(named)}{more}. The figures here are of the first.")
    return said if len(said) > 1 else []


def _rivals(one: Likeness) -> str:
    if 1 - one.taken <= NOTHING:
        return "nothing is left"
    named = [f"{_links([name])} ({part_words(part)}) {_percent(share)}" for name, part, share in one.rivals]
    return ", ".join(named) or f"nothing else by more than {_percent(WORTH)}"


def _links(ids: Iterable[str]) -> str:
    return ", ".join(f"[`{one}`]({one}.md)" for one in ids)


def _which(bench: Bench) -> str:
    rail = any(joint.kind == "prismatic" for joint in bench.robot.joints)
    known = "" if bench.robot.has_masses else " whose masses nobody knows"
    return f"the robot that `calflow new` writes{', on a rail' if rail else ''}{known}"


def _figures(figures: dict[str, tuple[float, str]]) -> str:
    named = [f"`{name}` = {value:.2g}{'' if unit == '1' else f' {unit}'}" for name, (value, unit) in figures.items()]
    return ", ".join(named[:4]) + (f" and {len(named) - 4} more" if len(named) > 4 else "")


def _range(values: list[float]) -> str:
    low, high = (f"{value:.2g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
