"""Formatting of numbers, probabilities and names for reports, figures and messages."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

AXIS = 40  # characters for which the axis of a figure has room
CERTAIN = 0.99  # larger probabilities are displayed as greater than this
SMALLEST_CHANCE = 1e-6  # smaller probabilities are displayed as less than this
HUGE = 1e7  # mm and more are stated by their power of ten: of rows that are nobody's
READABLE = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}


def mm(value: float) -> str:
    """Return a length [mm] as text without its unit, to 0.001 mm below 1 mm, 0.01 below 100, and at least two digits."""
    if not math.isfinite(value):
        return "–"
    size = abs(value)
    if size >= 1:
        return f"{value:.{2 if size < 100 else 1}f}" if size < HUGE else f"{value:.1e}"
    return f"{value:.3f}" if size >= 0.0095 or size == 0 else f"{value:.{min(9, 1 - math.floor(math.log10(size)))}f}"


def ratio(value: float) -> str:
    """Return a ratio as text with two or three digits."""
    if not math.isfinite(value):
        return "–"
    return f"{value:,.0f}" if value >= 10 else f"{value:.1f}" if value >= 2 else f"{value:.2f}"


def readable(unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which a quantity in an SI unit is displayed."""
    if unit in READABLE:
        return READABLE[unit]
    if unit.startswith(("m/", "rad/")):
        return 1e6, f"µ{unit}"
    return 1.0, "" if unit == "1" else unit


def number(value: float, form: str) -> str:
    """Return a formatted number with a typographic minus sign, and no sign before zero; a dash if it is not finite."""
    if not math.isfinite(value):
        return "–"
    text = format(value, form)
    return text.replace("-", "−") if any(digit in text for digit in "123456789") else text.lstrip("+-")


def interval(lower: float, upper: float) -> str:
    """Return an interval as text, its bounds to four significant digits."""
    return f"{number(lower, ',.4g')} … {number(upper, ',.4g')}"


def percent(share: float) -> str:
    """Return a fraction as a percentage, never rounded to 0 or 100 % unless it is exactly that."""
    digits = 0 if share in (0, 1) or 0.005 <= share < 0.995 else 1
    return f"{100 * share:.{digits}f} %"


def chance(p: float) -> str:
    """Return a small probability in words, as one in a round number."""
    if not math.isfinite(p):
        return "unknown"
    if p < SMALLEST_CHANCE:
        return "less than one in a million"
    if p > 0.1:
        return f"about {percent(p)}"
    digits = 10 ** max(0, math.floor(math.log10(1 / p)) - 1)
    return f"about one in {round(1 / p / digits) * digits:,}"


def chance_figure(p: float) -> str:
    """Return a small probability in digits, for a table."""
    if not math.isfinite(p):
        return "–"
    if p < SMALLEST_CHANCE or p >= 1e-3:
        return "< 10⁻⁶" if p < SMALLEST_CHANCE else f"{p:.2g}"
    digit, power = f"{p:.0e}".split("e-0")
    return f"{digit} · 10⁻{'³⁴⁵⁶'[int(power) - 3]}"


def sureness(probability: float) -> str:
    """Return a probability as a percentage, capped at `> 99 %`."""
    if not math.isfinite(probability):
        return "–"
    return f"> {percent(CERTAIN)}" if probability > CERTAIN else percent(probability)


def capped(value: float) -> str:
    """Return a probability estimated from a thousand draws or so, capped by their number."""
    return "over 0.999" if value > 0.999 else "below 0.001" if value < 0.001 else f"{value:.3f}"


def with_sd(value: float, sd: float) -> tuple[str, str]:
    """Return a value and its standard deviation, both rounded to the second significant digit of the latter."""
    if not (math.isfinite(sd) and sd > 0):
        return rounded(value).replace("-", "−"), "–"
    decimals = max(0, 1 - math.floor(math.log10(sd)))
    if decimals > 6:
        return number(value, ".4e"), f"{sd:.1e}"
    return number(value, f".{decimals}f"), f"{sd:.{decimals}f}"


def quantity(value: float, sd: float, unit: str) -> str:
    """Return a value in an SI unit with its standard deviation as text, in the display unit."""
    factor, shown = readable(unit)
    figures = with_sd(factor * value, factor * sd)
    return f"{' ± '.join(figures if math.isfinite(sd) else figures[:1])} {shown}"


def rounded(value: float, digits: int = 3) -> str:
    """Return a number rounded to so many significant digits, in positional notation."""
    if not math.isfinite(value):
        return "–"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0
    text = f"{float(f'{value:.{digits}g}'):,.{decimals}f}"
    return text.rstrip("0").rstrip(".") if decimals else text


def listed(names: Sequence[object], limit: int = 12) -> str:
    """Return names joined by commas and `and`; beyond the limit, the others are counted."""
    words = [str(name) for name in names]
    if len(words) > limit:
        return f"{', '.join(words[:limit])} and {len(words) - limit} more"
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else "none"


def plural(number: int, noun: str) -> str:
    """Return a number followed by the noun, in the plural unless the number is one."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def plural_word(things: Sequence[object], noun: str) -> str:
    """Return a noun in the singular or plural, by the number of things."""
    return noun if len(things) == 1 else f"{noun}s"


def first_up(text: str) -> str:
    """Return a text with its first letter capitalized."""
    return text[:1].upper() + text[1:]


def effect_words(effect: str) -> str:
    """Return the id of an effect or model with blanks for hyphens."""
    return effect.replace("-", " ")


def part_words(part: str) -> str:
    """Return the name of a joint or link with a blank before its number."""
    return re.sub(r"^(joint|link)(\d+)$", r"\1 \2", part)


def cut(name: str) -> str:
    """Return a name shortened in its middle to fit the axis of a figure."""
    return name if len(name) <= AXIS else f"{name[: AXIS // 2]}…{name[-AXIS // 2 + 1 :]}"
