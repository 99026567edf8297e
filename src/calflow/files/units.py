"""Units at the file boundary: keys and columns state their unit as a suffix (`x_mm`, `limits_deg`), converted here."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

# Every suffix that a file may use, by dimension, with (factor, offset): value_SI = factor * value + offset. The first
# of each dimension is the SI unit of all computation.
UNITS: dict[str, dict[str, tuple[float, float]]] = {
    "length": {"m": (1.0, 0.0), "mm": (1e-3, 0.0), "um": (1e-6, 0.0)},
    "angle": {
        "rad": (1.0, 0.0),
        "deg": (math.pi / 180, 0.0),
        "mrad": (1e-3, 0.0),
        "urad": (1e-6, 0.0),
        "arcsec": (math.pi / 648_000, 0.0),
    },
    "mass": {"kg": (1.0, 0.0), "g": (1e-3, 0.0)},
    "force": {"N": (1.0, 0.0), "kN": (1e3, 0.0)},
    "moment": {"Nm": (1.0, 0.0), "kNm": (1e3, 0.0)},
    "time": {"s": (1.0, 0.0), "min": (60.0, 0.0), "h": (3600.0, 0.0)},
    "temperature": {"K": (1.0, 0.0), "degC": (1.0, 273.15)},
    "compliance": {"rad_per_Nm": (1.0, 0.0)},
    "compliance of a slide": {"m_per_N": (1.0, 0.0)},
    "acceleration": {"m_per_s2": (1.0, 0.0), "mm_per_s2": (1e-3, 0.0)},
    "angular acceleration": {"rad_per_s2": (1.0, 0.0), "deg_per_s2": (math.pi / 180, 0.0)},
    "angular speed": {"rad_per_s": (1.0, 0.0), "deg_per_s": (math.pi / 180, 0.0)},
    "speed": {"m_per_s": (1.0, 0.0), "mm_per_s": (1e-3, 0.0)},
    "image": {"px": (1.0, 0.0)},
    "ratio": {"m_per_m": (1.0, 0.0), "mm_per_m": (1e-3, 0.0), "um_per_m": (1e-6, 0.0)},
}
# Quantities that a device may report, of which the key alone says which it is.
MEASURED = "what was measured"
UNITS[MEASURED] = {unit: to for kind in ("length", "angle", "image", "force") for unit, to in UNITS[kind].items()}
SUFFIXES: dict[str, tuple[str, ...]] = {dimension: tuple(units) for dimension, units in UNITS.items()}
# Suffixes of keys in files, where a joint variable is an angle or a position, depending on the kind of joint.
KEY_SUFFIXES = SUFFIXES | {"joint variable": ("rad", "m", "deg", "mm")}
# The largest plausible magnitude of each dimension for a robot, in its SI unit; "" stands for a dimensionless number.
LARGEST = {
    "": 1e9,
    "length": 1e3,
    "angle": 1e4,
    "mass": 1e6,
    "force": 1e8,
    "moment": 1e8,
    "time": 1e11,
    "temperature": 1e4,
    "compliance": 1.0,
    "compliance of a slide": 1.0,
    "acceleration": 1e4,
    "angular acceleration": 1e5,
    "angular speed": 1e4,
    "speed": 1e3,
    "image": 1e6,
    "ratio": 1e3,
    MEASURED: 1e6,
    "joint variable": 1e4,
}
_CONVERSIONS = {suffix: conversion for units in UNITS.values() for suffix, conversion in units.items()}

_LONGEST_FIRST = sorted(_CONVERSIONS, key=len, reverse=True)


def to_si(suffix: str) -> tuple[float, float]:
    """Return (factor, offset) with value_SI = factor * value + offset for a unit suffix."""
    return _CONVERSIONS[suffix]


def in_si(suffix: str, figure: float) -> float:
    """Return a value, given in the unit of a suffix, in SI."""
    factor, offset = to_si(suffix)
    return factor * figure + offset


def split_unit(name: str) -> tuple[str, str]:
    """Split `q1_deg` into (`q1`, `deg`); a name that carries no unit into itself and an empty one."""
    units = (unit for unit in _LONGEST_FIRST if name.endswith(f"_{unit}") and len(name) > len(unit) + 1)
    unit = next(units, "")
    return name.removesuffix(f"_{unit}") if unit else name, unit


def spellings(unit: str) -> dict[str, float]:
    """Return the suffixes that a quantity of an SI unit (such as `rad/Nm`) may carry, with their factors to SI."""
    si = unit.replace("/", "_per_")
    same = next((suffixes for suffixes in SUFFIXES.values() if suffixes[0] == si), (si,))
    return {"": 1.0} if unit == "1" else {f"_{suffix}": to_si(suffix)[0] if suffix != si else 1.0 for suffix in same}


@dataclass(frozen=True)
class MeasurementUnit:
    """The unit of a residual, computed in `symbol` (SI, or px in images) and displayed in `label`.

    scale is the factor from symbol to label; usual is the noise [symbol] of a typical device, used as default.
    """

    symbol: str
    label: str
    scale: float
    usual: float

    @property
    def dimension(self) -> str:
        """The dimension of the columns and keys that hold values in this unit."""
        return next((name for name, suffixes in SUFFIXES.items() if self.symbol in suffixes), "")

    def shown(self, value: Any) -> Any:
        """Return a value or an array [symbol] in the display unit."""
        return self.scale * value

    def words(self, value: float, form: str = ".3g") -> str:
        """Return a value [symbol] as text in the display unit, followed by the unit."""
        return f"{self.shown(value):{form}} {self.label}"


METRE = MeasurementUnit("m", "mm", 1e3, 1e-4)
RADIAN = MeasurementUnit("rad", "mrad", 1e3, 1e-4)
PIXEL = MeasurementUnit("px", "px", 1.0, 0.1)
NEWTON = MeasurementUnit("N", "N", 1.0, 1.0)
