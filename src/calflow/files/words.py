"""Numbers and names as a reader wants them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

AXIS = 40  # letters for which a figure's axis has room
CERTAIN = 0.99  # probability beyond which only this is said
SMALLEST_CHANCE = 1e-6  # chance below which only this is said
READABLE = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}


def mm(value: float) -> str:
    """Return a length in mm without its unit: micrometres where they matter, at least two digits."""
    if not math.isfinite(value):
        return "–"
    size = abs(value)
    if size >= 1:
        return f"{value:.2f}"
    return f"{value:.3f}" if size >= 0.0095 or size == 0 else f"{value:.{min(9, 1 - math.floor(math.log10(size)))}f}"


def ratio(value: float) -> str:
    """Return a factor with two or three digits."""
    if not math.isfinite(value):
        return "–"
    return f"{value:,.0f}" if value >= 10 else f"{value:.1f}" if value >= 2 else f"{value:.2f}"


def readable(unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which a quantity in an SI unit is easy to read."""
    if unit in READABLE:
        return READABLE[unit]
    if unit.startswith(("m/", "rad/")):
        return 1e6, f"µ{unit}"
    return 1.0, "" if unit == "1" else unit


def number(value: float, form: str) -> str:
    """Return a formatted number with a true minus sign, and none before a zero."""
    text = format(value, form)
    return text.replace("-", "−") if any(digit in text for digit in "123456789") else text.lstrip("-")


def interval(lower: float, upper: float) -> str:
    """Return a range in three digits."""
    return f"{number(lower, ',.4g')} … {number(upper, ',.4g')}"


def percent(share: float) -> str:
    """Return a share as percent, never all or none where it is not."""
    digits = 0 if share in (0, 1) or 0.005 <= share < 0.995 else 1
    return f"{100 * share:.{digits}f} %"


def chance(p: float) -> str:
    """Return a small probability as words: one in so many."""
    if not math.isfinite(p):
        return "unknown"
    if p < SMALLEST_CHANCE:
        return "less than one in a million"
    if p > 0.1:
        return f"about {percent(p)}"
    digits = 10 ** max(0, math.floor(math.log10(1 / p)) - 1)
    return f"about one in {round(1 / p / digits) * digits:,}"


def chance_figure(p: float) -> str:
    """Return a small probability for a table."""
    if not math.isfinite(p):
        return "–"
    if p < SMALLEST_CHANCE or p >= 1e-3:
        return "< 10⁻⁶" if p < SMALLEST_CHANCE else f"{p:.2g}"
    digit, power = f"{p:.0e}".split("e-0")
    return f"{digit} · 10⁻{'³⁴⁵⁶'[int(power) - 3]}"


def sureness(probability: float) -> str:
    """Return a probability as percent that never claims certainty."""
    if not math.isfinite(probability):
        return "–"
    return f"> {percent(CERTAIN)}" if probability > CERTAIN else percent(probability)


def with_sd(value: float, sd: float) -> tuple[str, str]:
    """Return a value and its standard deviation, both to the second digit of the latter."""
    if not (math.isfinite(sd) and sd > 0):
        return rounded(value).replace("-", "−"), "–"
    decimals = max(0, 1 - math.floor(math.log10(sd)))
    if decimals > 6:
        return number(value, ".4e"), f"{sd:.1e}"
    return number(value, f".{decimals}f"), f"{sd:.{decimals}f}"


def quantity(value: float, sd: float, unit: str) -> str:
    """Return a value in an SI unit with its standard deviation, in a unit that is easy to read."""
    factor, shown = readable(unit)
    figures = with_sd(factor * value, factor * sd)
    return f"{' ± '.join(figures if math.isfinite(sd) else figures[:1])} {shown}"


def rounded(value: float, digits: int = 3) -> str:
    """Return a figure rounded to so many digits, never as a power of ten."""
    if not math.isfinite(value):
        return "–"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0
    text = f"{float(f'{value:.{digits}g}'):,.{decimals}f}"
    return text.rstrip("0").rstrip(".") if decimals else text


def listed(names: Sequence[object], limit: int = 12) -> str:
    """Return names as a list in words, cut where it gets long."""
    words = [str(name) for name in names]
    if len(words) > limit:
        return f"{', '.join(words[:limit])} and {len(words) - limit} more"
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else "none"


def plural(number: int, noun: str) -> str:
    """Return a number with its noun."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def plural_word(things: Sequence[object], noun: str) -> str:
    """Return a noun as it stands before so many things."""
    return noun if len(things) == 1 else f"{noun}s"


def first_up(text: str) -> str:
    """Return a text with its first letter as a sentence begins."""
    return text[:1].upper() + text[1:]


def effect_words(effect: str) -> str:
    """Return an effect's or a model's id as words."""
    return effect.replace("-", " ")


def part_words(part: str) -> str:
    """Return a part of the robot as words, its number apart."""
    return re.sub(r"^(joint|link)(\d+)$", r"\1 \2", part)


def cut(name: str) -> str:
    """Return a name as a figure's axis has room for it: of a very long one, its beginning and its end."""
    return name if len(name) <= AXIS else f"{name[: AXIS // 2]}…{name[-AXIS // 2 + 1 :]}"
