"""Edits: replacements of numbers and configuration flags in the bytes of a program, in the maker's notation."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal

import numpy as np

from calflow.deployment.conventions import pose_values
from calflow.programs.target import Declaration, Flag, Number, Target

# Coarsest resolution of a number's last decimal: 1 µm, 1 µrad, and for a joint what moves a tool 3 m away by 1 µm.
PLACE_STEP, TURN_STEP, JOINT_STEP = 1e-6, 1e-6, 3e-7
UNMOVED = 1e-7  # m and rad: a smaller change of a target is none


@dataclass(frozen=True)
class Edit:
    """New text for the bytes [start, end)."""

    start: int
    end: int
    text: str


def with_edits(source: bytes, edits: Iterable[Edit]) -> bytes:
    """Return a program with edits applied."""
    pieces = []
    place = 0
    for edit in sorted(edits, key=lambda edit: edit.start):
        if edit.start < place:
            raise ValueError(f"edits overlap at byte {edit.start}")
        pieces += [source[place : edit.start], edit.text.encode("latin-1")]
        place = edit.end
    return b"".join([*pieces, source[place:]])


def to_pose(target: Target, pose: np.ndarray) -> tuple[Edit, ...]:
    """Return the edits that set a target to a pose (4, 4) in its frame; none if it is there already."""
    assert target.turn is not None
    change = pose - target.pose
    # A small rotation changes the rotation matrix by sqrt(2) times its angle (Frobenius norm).
    if np.linalg.norm(change[:3, 3]) < UNMOVED and np.linalg.norm(change[:3, :3]) < UNMOVED * np.sqrt(2):
        return ()
    values = pose_values(pose, target.turn, target.values)
    steps = [PLACE_STEP] * 3 + [TURN_STEP] * (len(values) - 3)
    return _edits(target, values, steps)


def to_readings(target: Target, readings: np.ndarray) -> tuple[Edit, ...]:
    """Return the edits that set a target to joint readings [rad or m]; none if it has them already."""
    if np.abs(readings - target.values).max() < UNMOVED:
        return ()
    return _edits(target, readings, [JOINT_STEP] * len(readings))


def to_flags(changes: Iterable[tuple[Flag, str]]) -> tuple[Edit, ...]:
    """Return the edits that set configuration flags to new texts."""
    return tuple(Edit(flag.start, flag.end, text) for flag, text in changes)


def declared_again(declared: Declaration, name: str, source: bytes, changes: Iterable[Edit]) -> Edit:
    """Return the edit that declares the target again under another name in the next line, with changes to its value."""
    start, end = declared.value
    value = with_edits(
        source[start:end], (Edit(change.start - start, change.end - start, change.text) for change in changes)
    )
    begun = max(source.rfind(b"\n", 0, declared.start), source.rfind(b"\r", 0, declared.start)) + 1
    indent = re.compile(rb"[ \t]*").match(source, begun)
    remark = re.compile(rb"[ \t]*(?:%s[^\r\n]*)?(?=[\r\n]|\Z)" % declared.remark.encode()).match(source, declared.end)
    place = remark.end() if remark else declared.end
    line_end = next((mark for mark in (b"\r\n", b"\n", b"\r") if mark in source), b"\n")
    text = f"{declared.head}{name}{declared.sign}{value.decode('latin-1')}{declared.tail}"
    return Edit(place, place, ((line_end + indent.group() if indent else line_end).decode("latin-1")) + text)


def spelled(number: Number, value: float, step: float) -> str:
    """Return a value [SI] in a number's notation, with its decimals, or as many as the step needs."""
    decimals = max(
        -int(Decimal(number.text).as_tuple().exponent), int(np.ceil(-np.log10(step / number.scale) - 1e-9)), 0
    )
    new = value / number.scale
    if abs(new - number.written) < 0.5 * 10.0**-decimals:
        return number.text
    text = f"{new:.{decimals}f}"
    if float(text) == 0:
        text = text.lstrip("-")
    bare = number.text.lstrip("+-")
    # The file's notation omits the zero before the decimal point.
    if bare.startswith("."):
        text = text.replace("0.", ".", 1) if text.lstrip("-").startswith("0.") else text
    return f"+{text}" if number.text.startswith("+") and not text.startswith("-") else text


def _edits(target: Target, values: Iterable[float], steps: Iterable[float]) -> tuple[Edit, ...]:
    texts = [spelled(number, value, step) for number, value, step in zip(target.numbers, values, steps, strict=True)]
    return tuple(
        Edit(number.start, number.end, text)
        for number, text in zip(target.numbers, texts, strict=True)
        if text != number.text
    )
