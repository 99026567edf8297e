"""Units at the file boundary: the unit is part of a name (`x_mm`, `limits_deg`) and is converted once, here."""

from __future__ import annotations

from functools import lru_cache

# The suffixes that files may use, by dimension; the first of each is the SI unit that calflow computes in.
SUFFIXES: dict[str, tuple[str, ...]] = {
    "length": ("m", "mm", "um"),
    "angle": ("rad", "deg", "mrad", "urad"),
    "mass": ("kg", "g"),
    "force": ("N", "kN"),
    "moment": ("Nm", "kNm"),
    "time": ("s", "min", "h"),
    "temperature": ("K", "degC"),
    "compliance": ("rad_per_Nm",),
    "compliance of a slide": ("m_per_N",),
    "acceleration": ("m_per_s2",),
    "ratio": ("m_per_m", "mm_per_m"),
}
_PINT_NAMES = {"Nm": "N*m", "kNm": "kN*m", "m_per_N": "m/N", "rad_per_Nm": "rad/(N*m)", "m_per_s2": "m/s^2",
               "m_per_m": "m/m", "mm_per_m": "mm/m"}  # fmt: skip


@lru_cache
def to_si(suffix: str) -> tuple[float, float]:
    """Return (factor, offset) with value_SI = factor * value + offset for a unit suffix."""
    dimension = next(name for name, suffixes in SUFFIXES.items() if suffix in suffixes)
    si = SUFFIXES[dimension][0]
    if suffix == si:
        return 1.0, 0.0
    import pint  # heavy: only files that use other units than SI pay for it

    registry: pint.UnitRegistry = pint.UnitRegistry()
    unit, target = _PINT_NAMES.get(suffix, suffix), _PINT_NAMES.get(si, si)
    zero = registry.Quantity(0.0, unit).to(target).magnitude
    one = registry.Quantity(1.0, unit).to(target).magnitude
    return one - zero, zero


def split_unit(name: str, dimension: str | None = None) -> tuple[str, str] | None:
    """Split `q1_deg` into (`q1`, `deg`); None where the name carries no unit (of that dimension)."""
    dimensions = [dimension] if dimension else list(SUFFIXES)
    suffixes = sorted((s for d in dimensions for s in SUFFIXES[d]), key=len, reverse=True)
    for suffix in suffixes:
        if name.endswith("_" + suffix) and len(name) > len(suffix) + 1:
            return name[: -len(suffix) - 1], suffix
    return None


def spellings(unit: str) -> dict[str, float]:
    """Return the suffixes that a quantity may carry whose SI unit is written so (`rad/Nm`), and the factor of each."""
    si = unit.replace("/", "_per_")
    same = next((suffixes for suffixes in SUFFIXES.values() if suffixes[0] == si), (si,))
    return {"": 1.0} if unit == "1" else {f"_{suffix}": to_si(suffix)[0] if suffix != si else 1.0 for suffix in same}
