"""Units in names are split off and converted to SI."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pint
import pytest

from calflow.files.units import MEASURED, SUFFIXES, spellings, split_unit, to_si

IN_SI = {  # what 1 of each unit is, written by hand
    "m": 1, "mm": 1e-3, "um": 1e-6, "rad": 1, "deg": np.pi / 180, "mrad": 1e-3, "urad": 1e-6, "kg": 1, "g": 1e-3,
    "N": 1, "kN": 1e3, "Nm": 1, "kNm": 1e3, "s": 1, "min": 60, "h": 3600, "K": 1, "degC": 274.15,
    "rad_per_Nm": 1, "m_per_N": 1, "m_per_s2": 1, "m_per_m": 1, "mm_per_m": 1e-3, "um_per_m": 1e-6,
    "arcsec": np.pi / 648_000, "px": 1, "rad_per_s": 1, "deg_per_s": np.pi / 180, "m_per_s": 1, "mm_per_s": 1e-3,
    "mm_per_s2": 1e-3, "rad_per_s2": 1, "deg_per_s2": np.pi / 180,
}  # fmt: skip


@pytest.mark.parametrize("suffix", [suffix for suffixes in SUFFIXES.values() for suffix in suffixes])
def test_every_suffix_converts_to_si(suffix):
    """Fails if a factor or an offset is wrong, or a new unit has no value here."""
    factor, offset = to_si(suffix)
    assert factor + offset == pytest.approx(IN_SI[suffix], rel=1e-12)
    assert offset == (pytest.approx(273.15) if suffix == "degC" else 0)


PINT_NAMES = {"Nm": "N*m", "kNm": "kN*m", "m_per_N": "m/N", "rad_per_Nm": "rad/(N*m)", "m_per_s2": "m/s^2",
              "m_per_m": "m/m", "px": "pixel", "mm_per_m": "mm/m", "um_per_m": "um/m",
              "rad_per_s": "rad/s", "deg_per_s": "deg/s", "m_per_s": "m/s", "mm_per_s": "mm/s",
              "mm_per_s2": "mm/s^2", "rad_per_s2": "rad/s^2", "deg_per_s2": "deg/s^2"}  # fmt: skip


def test_the_table_agrees_with_pint():
    """Fails if a factor or an offset differs from what a library of units says."""
    registry = pint.UnitRegistry()
    for dimension, suffixes in SUFFIXES.items():
        if dimension == MEASURED:  # of several dimensions, which are looked at one by one
            continue
        si = registry.Unit(PINT_NAMES.get(suffixes[0], suffixes[0]))
        for suffix in suffixes:
            unit = registry.Unit(PINT_NAMES.get(suffix, suffix))
            zero, one = (registry.Quantity(value, unit).to(si).magnitude for value in (0.0, 1.0))
            assert to_si(suffix) == (pytest.approx(one - zero, rel=1e-12), pytest.approx(zero, abs=1e-12)), suffix


def test_no_unit_needs_pint():
    """Fails if reading a file loads a library of units, which takes longer than reading it."""
    code = "import sys; from calflow.files.units import to_si; to_si('deg'); sys.exit('pint' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("q1_deg", ("q1", "deg")),
        ("x_mm", ("x", "mm")),
        ("s_rad_per_Nm", ("s", "rad_per_Nm")),
        ("noise_mm_per_m", ("noise", "mm_per_m")),
        ("m1_Nm", ("m1", "Nm")),
        ("region_min_m", ("region_min", "m")),
        ("time_min", ("time", "min")),
        ("temperature_degC", ("temperature", "degC")),
        ("pose", ("pose", "")),
        ("x_MM", ("x_MM", "")),
        ("x_inch", ("x_inch", "")),
        ("_mm", ("_mm", "")),
        ("mm", ("mm", "")),
    ],
)
def test_the_longest_unit_is_split_off(name, expected):
    """Fails if `rad_per_Nm` is taken for `Nm`, a name for a unit, or a unit guessed."""
    assert split_unit(name) == expected


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("rad/Nm", {"_rad_per_Nm": 1}),
        ("m", {"_m": 1, "_mm": 1e-3, "_um": 1e-6}),
        ("1", {"": 1}),
        ("1/K", {"_1_per_K": 1}),
    ],
)
def test_a_parameters_unit_has_its_spellings(unit, expected):
    """Fails if a truth file cannot state a parameter in its own unit, or states it in another dimension's."""
    assert spellings(unit) == pytest.approx(expected)
