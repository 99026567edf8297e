"""Told apart: the chances of a plan as a table, with the cheapest addition that would fill each cause's worst gap."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calflow.design.isolability.discrimination import ANY_MEANS, ENOUGH
from calflow.design.isolability.isolability import Isolability, Place
from calflow.diagnosis.findings.verdict import label
from calflow.effects import catalogue
from calflow.files.tables import column, to_frame

Known = Place | str  # a cause at its place; only its id where no data show it


@dataclass(frozen=True, kw_only=True)
class IsolabilityCell:
    """A cause at a stated size: the chance that it is seen (no rival), or that it is seen and told from a rival."""

    cause: str = column("id of the cause")
    joint: int | None = column("its joint or link; empty: none, or all")
    part: str = column("where it acts; empty: the poses do not test it anywhere")
    size: float | None = column("root mean square of its parameters of the first one's unit", "as unit says")
    unit: str = column("unit of size")
    rival: str = column("id of what it is to be told from; empty: from nothing being there, that is whether it is seen")
    rival_joint: int | None = column("its joint or link; empty: none")
    rival_part: str = column("where it acts; empty where the poses do not test it")
    chance: float = column("chance that it is seen, and told from the rival")
    enough: bool = column("whether that is 0.9 or more")
    needs: str = column("what a test of the cause, or of the rival, needs; empty: nothing")
    worst: bool = column("whether it is the cause's worst gap")
    addition: str = column("the cheapest addition that fills the worst gap; empty: none of those that were tried does")
    chance_then: float | None = column("chance with it; empty: none")
    words: str = column("the worst gap in words; empty elsewhere")


def isolability_table(planned: Isolability, size: float, tried: Mapping[str, Isolability]) -> pd.DataFrame:
    """Return select/isolability.csv; size is that of the causes in usual ones.

    tried says what the plan could tell with each addition, in the order of what they cost.
    """
    rows: list[IsolabilityCell] = []
    every: list[Known] = [*planned.causes, *planned.lacking]
    for cause in every:
        rivals = tuple(_rivals(planned, cause))
        worst = _worst(planned, cause, rivals)
        filled = _filled(tried, cause, worst[0]) if worst else None
        id_, joint, part = _place(planned, cause)
        size_, unit = _usual(planned, cause, size)
        gaps: list[Known | None] = [None, *rivals]
        for rival in gaps:
            is_worst = worst is not None and worst[0] == rival
            chance = chance_of(planned, cause, rival)
            other, other_joint, other_part = _place(planned, rival) if rival else ("", None, "")
            rows.append(
                IsolabilityCell(
                    cause=id_, joint=joint, part=part, size=size_, unit=unit, rival=other, rival_part=other_part,
                    rival_joint=joint if isinstance(rival, str) else other_joint, chance=chance, enough=chance >= ENOUGH,
                    needs=_needs(planned, cause, rival), worst=is_worst, addition=filled[0] if is_worst and filled else "",
                    chance_then=filled[1] if is_worst and filled else None,
                    words=_words(planned, cause, rival, chance, filled, tried) if is_worst else "",
                )
            )  # fmt: skip
    return to_frame(rows, IsolabilityCell)


def isolability_summary(table: pd.DataFrame) -> str:
    """Say how many causes are seen, and how many of these are told from all others."""
    tested = table[table["part"].fillna("") != ""]
    seen = int(tested.loc[tested["rival"].fillna("") == "", "enough"].sum())
    told = tested.groupby(["cause", "part"])["enough"].all()
    return f"of {len(told)} causes {seen} would be seen, and {int(told.sum())} of these told from all others"


def isolability_gaps(table: pd.DataFrame) -> list[str]:
    """Return in words the causes' worst gaps that an addition fills, the widest first."""
    gaps = table[table["worst"] & (table["addition"].fillna("") != "")]
    return list(gaps.sort_values("chance", kind="stable")["words"])


def chance_of(planned: Isolability, cause: Known, rival: Known | None) -> float:
    """Return the chance that a cause is seen (rival None), or seen and told from a rival; 0 for what the poses do not test.

    A cause or rival that is known by its id alone is the one that is seen best, or told worst.
    """
    true = [cause] if isinstance(cause, tuple) else [place for place in planned.seen if place[0] == cause]
    if rival is None:
        return max((planned.seen.get(place, 0.0) for place in true), default=0.0)
    others = [rival] if isinstance(rival, tuple) else [place for place in planned.seen if place[0] == rival]
    return min((planned.told.get((place, other), 0.0) for place in true for other in others), default=0.0)


def _rivals(planned: Isolability, cause: Known) -> Iterator[Known]:
    if isinstance(cause, tuple):
        yield from (place for place in planned.causes if place != cause)
        yield from planned.untold[cause]


def _worst(planned: Isolability, cause: Known, rivals: tuple[Known, ...]) -> tuple[Known | None] | None:
    """The rival of the worst gap, in a tuple since None means that the cause is not seen; None where there is no gap."""
    if chance_of(planned, cause, None) < ENOUGH:
        return (None,)
    least = min(rivals, key=lambda rival: chance_of(planned, cause, rival), default=None)
    return (least,) if least is not None and chance_of(planned, cause, least) < ENOUGH else None


def _filled(tried: Mapping[str, Isolability], cause: Known, rival: Known | None) -> tuple[str, float] | None:
    """The first addition with which a gap is none, and the chance then."""
    then = ((words, chance_of(with_it, cause, rival)) for words, with_it in tried.items())
    return next((one for one in then if one[1] >= ENOUGH), None)


def _needs(planned: Isolability, cause: Known, rival: Known | None) -> str:
    if not isinstance(cause, tuple):
        return planned.lacking[cause]
    return planned.untold[cause][rival] if isinstance(rival, str) else ""


def _usual(planned: Isolability, cause: Known, size: float) -> tuple[float | None, str]:
    """The size that was drawn, and its unit."""
    if not isinstance(cause, tuple):
        return None, ""
    declared = planned.causes[cause].declared
    same = [parameter.prior_sd for parameter in declared if parameter.unit == declared[0].unit]
    return size * float(np.sqrt(np.mean(np.square(same)))), declared[0].unit


def _place(planned: Isolability, known: Known) -> tuple[str, int | None, str]:
    """Id, joint and part."""
    if not isinstance(known, tuple):
        return known, None, ""
    one = planned.causes[known]
    return one.id, one.joint or None, one.part


def _name(planned: Isolability, known: Known) -> str:
    """Name a cause with its joint, or with its part where it has several."""
    if not isinstance(known, tuple):
        return known
    joint = planned.causes[known].joint
    alone = joint or sum(place[0] == known[0] for place in planned.causes) == 1
    return label(known[0], joint) if alone else f"{known[0]} ({known[1]})"


def _words(
    planned: Isolability,
    cause: Known,
    rival: Known | None,
    chance: float,
    filled: tuple[str, float] | None,
    tried: Mapping[str, Isolability],
) -> str:
    """Say a gap and what fills it."""
    what = "seen" if rival is None else f"told from {_name(planned, rival)}"
    needs = _needs(planned, cause, rival)
    how = f"not {what}: it takes {needs}" if needs else f"{what} in {_hundred(chance)}"
    if filled:
        where = _where(tried[filled[0]], cause) if rival is None else ""
        return f"{_name(planned, cause)} is {how}; with {filled[0]} in {_hundred(filled[1])}{where}"
    if needs:
        return f"{_name(planned, cause)} is {how}"
    means = ["at this size it takes a surer device or more poses"]
    if rival is not None:
        known = [catalogue().get(one if isinstance(one, str) else one[0]) for one in (cause, rival)]
        means = [effect.told_by for effect in known if effect and effect.told_by] or [ANY_MEANS]
    return f"{_name(planned, cause)} is {how}, and nothing tried changes that: {', or '.join(dict.fromkeys(means))}"


def _where(then: Isolability, cause: Known) -> str:
    """Say where a cause is seen that was not tested anywhere."""
    if isinstance(cause, tuple):
        return ""
    shown = [place[1] for place, chance in then.seen.items() if place[0] == cause and chance >= ENOUGH]
    return f" ({', '.join(shown)})"


def _hundred(chance: float) -> str:
    return f"{100 * chance:.0f} of 100"
