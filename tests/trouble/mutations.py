"""Mutations: what goes wrong with files, each a function from a text and a random generator to bytes.

Structured ones are mistakes that people and programs make in a table, a TOML file or a URDF; of bytes are those that disks and
copies make.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial

import numpy as np

Mutation = Callable[[str, np.random.Generator], bytes]

NO_NUMBERS = (
    "nan", "NaN", "inf", "-inf", "1e400", "-1e400", "1e-400", "1e308", "9" * 400, "-" + "9" * 40, "0x1F", "1_500", "1,5", "1.234,5",
    "1 500", "1e", "e5", "--1", "+-1", "1.2.3", ".", "-", "", " ", "None", "null", "true", "True", "n/a", "#REF!",
    "#DIV/0!", "12mm",
    "12 mm", "1/2", "=A1", "\u22125.5", "\uff11\uff12", "\u0663", "1\u00a0500", "\ufeff12", "0", "-0", "00012", "+7", "1e3",
    "1E+2", ".5", "5.",
)  # fmt: skip
SPACES = ("\t", " ", "\u00a0", "\u2009", "\u200b", "\r", "\x0b", "\x0c", "\x85", "\u2028", "\x1f", "\x00")


# --- Tables ------------------------------------------------------------------------------------------


def cell(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """Another content of one cell."""
    return _cells(text, rng, separator, lambda cells, k: [*cells[:k], _one(NO_NUMBERS, rng), *cells[k + 1 :]])


def dressed(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """A sign that is not seen, beside or inside a cell's content."""

    def change(cells: list[str], k: int) -> list[str]:
        at, space = int(rng.integers(len(cells[k]) + 1)), _one(SPACES, rng)
        return [*cells[:k], cells[k][:at] + space + cells[k][at:], *cells[k + 1 :]]

    return _cells(text, rng, separator, change)


def quoted(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """Quotes around a cell, at one end of it, doubled or in it."""
    form = _one(('"{}"', '"{}', '{}"', '""{}""', "'{}'", '"{}"x', '{}""', '"{}\n"', ' "{}"'), rng)
    return _cells(text, rng, separator, lambda cells, k: [*cells[:k], form.format(cells[k]), *cells[k + 1 :]])


def quotes_over_lines(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """A quote that opens in one line's last cell and closes in a later one's."""
    lines = text.splitlines()
    first, last = sorted(int(k) for k in rng.choice(np.arange(1, len(lines)), 2, replace=False))
    head, _, cell_ = lines[first].rpartition(separator)
    lines[first], lines[last] = f'{head}{separator}"{cell_}', lines[last] + '"'
    return _text(lines)


def cell_lost(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """A line with a cell fewer: those after it are shifted."""
    return _cells(text, rng, separator, lambda cells, k: cells[:k] + cells[k + 1 :])


def cell_more(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """A line with a cell more."""
    return _cells(text, rng, separator, lambda cells, k: [*cells[:k], _one(("", "1", "x"), rng), *cells[k:]])


def cells_shifted(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """A line whose cells are one further to the right, of the same number."""
    return _cells(text, rng, separator, lambda cells, k: cells[:k] + cells[-1:] + cells[k:-1])


def line_cut(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """A line that ends too early."""
    return _cells(text, rng, separator, lambda cells, k: cells[: k + 1])


def trailing(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """A separator at the end of all lines, of all but the header, or of the header."""
    header, *rows = text.splitlines()
    which = rng.integers(3)
    return _text([header + separator * bool(which != 1), *(row + separator * bool(which != 2) for row in rows)])


def line_copied(text: str, rng: np.random.Generator) -> bytes:
    """A line (perhaps the header) that stands somewhere again."""
    lines = text.splitlines()
    lines.insert(int(rng.integers(len(lines) + 1)), _one(lines, rng))
    return _text(lines)


def lines_joined(text: str, rng: np.random.Generator) -> bytes:
    """Two lines without an end between them."""
    lines = text.splitlines()
    k = int(rng.integers(len(lines) - 1))
    return _text([*lines[:k], lines[k] + lines[k + 1], *lines[k + 2 :]])


def line_odd(text: str, rng: np.random.Generator) -> bytes:
    """A line that is a comment, a sum, a separator's declaration, empty, or of units."""
    lines = text.splitlines()
    odd = ("# measured on Monday", "sep=,", "", ",,,,", ";;;;", "mean,,,1.0", "mm;mm;mm", "-----", '"', "total: 80")
    lines.insert(int(rng.integers(len(lines) + 1)), _one(odd, rng))
    return _text(lines)


def head(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """A name of a column: doubled, without or with another unit, misspelt, empty, quoted, or with a sign that is not seen."""
    first, *rows = text.splitlines()
    names = first.split(separator)
    k = int(rng.integers(len(names)))
    stem, _, unit = names[k].rpartition("_")
    forms = (
        _one(names, rng), stem or "x", f"{stem or names[k]}_{_one(('m', 'mm', 'um', 'rad', 'deg', 'inch', 's', 'N', ''), rng)}",
        names[k].upper(), names[k][:-1], names[k] + "s", "", f'"{names[k]}"', f" {names[k]} ", names[k] + _one(SPACES, rng),
        f"{names[k]}.1", f"{stem} [{unit}]", "Unnamed: 3", "line", "missing", "order", "range", "series", "index",
    )  # fmt: skip
    names[k] = _one(forms, rng)
    return _text([separator.join(names), *rows])


def column(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """A column lost, there twice, exchanged with another, or moved without its name."""
    rows = [line.split(separator) for line in text.splitlines()]
    k, j = (int(number) for number in rng.integers(min(map(len, rows)), size=2))
    which = rng.integers(4)
    if which == 0:
        rows = [row[:k] + row[k + 1 :] for row in rows]
    elif which == 1:
        rows = [[*row, row[k]] for row in rows]
    else:
        for row in rows[1 if which == 2 else 0 :]:
            row[k], row[j] = row[j], row[k]
    return _text([separator.join(row) for row in rows])


def separated_otherwise(text: str, rng: np.random.Generator, separator: str = ",") -> bytes:
    """Another separator, in one line or in all."""
    other = _one(tuple(sign for sign in ";\t| ,:" if sign != separator), rng)
    if rng.integers(2):
        return text.replace(separator, other).encode()
    lines = text.splitlines()
    k = int(rng.integers(len(lines)))
    return _text([*lines[:k], lines[k].replace(separator, other), *lines[k + 1 :]])


def commas(text: str, rng: np.random.Generator) -> bytes:
    """Decimal points and commas exchanged, in one line or in all."""
    lines, turned = text.splitlines(), str.maketrans(".,", ",.")
    which = range(len(lines)) if rng.integers(2) else [int(rng.integers(len(lines)))]
    return _text([line.translate(turned) if k in which else line for k, line in enumerate(lines)])


# --- TOML --------------------------------------------------------------------------------------------

VALUES = (
    "nan", "inf", "-inf", "1e400", "-1e400", "1e308", "1e-320", "9" * 30, "9" * 400, "9" * 5000, "0x" + "f" * 5000,
    "-9223372036854775809",
    "0", "-0.0", "-1", "-1.5", "1e9", "10000000000000", "true", "false", '""', '"x"', '"5"', '"5 mm"', "[]", "[1]", "[[1]]",
    "{}", "{a = 1}",
    "2024-01-01", "07:32:00", "1_000", "1,5", "1.5.2", "'''x\ny'''", '"\\u0000"', '"\\uFFFF"', '"../../etc/passwd"',
    '"/dev/zero"', '"."',
    "0b1", "0o17", "[1, 2, 3, 4]", "[1, 'a']", "+5", "5e0", "[nan, 0, 0]", "[1e400, 0, 0]", "[0, 0, -100, ]", "None", "NaN",
    "=", "",
)  # fmt: skip


def value(text: str, rng: np.random.Generator) -> bytes:
    """Another value of a key."""
    return _entries(text, rng, lambda key, old: f"{key} = {_one(VALUES, rng)}")


def figure(text: str, rng: np.random.Generator) -> bytes:
    """Another number in a value, a legal one or not."""
    found = list(re.finditer(r"(?<![\w.\"])-?\d+\.?\d*", text))
    spot = found[int(rng.integers(len(found)))]
    old = spot.group()
    new = _one((f"-{old}", f"{old}0", f"{old}.5", f"{old}e3", f"{old}e300", f"0{old}", f"{old}_0", "0", f"{old}mm", f'"{old}"',
                f"{float(old) * 1.01:.6g}", f"{old[:-1]}", f"{old},5", f"{old} {old}"), rng)  # fmt: skip
    return (text[: spot.start()] + new + text[spot.end() :]).encode()


def key(text: str, rng: np.random.Generator) -> bytes:
    """Another key: misspelt, without or with another unit, quoted, dotted, in capitals, empty."""

    def change(old: str, said: str) -> str:
        stem, _, unit = old.rpartition("_")
        forms = (
            stem or old + "x", f"{stem or old}_{_one(('m', 'mm', 'um', 'deg', 'rad', 'kg', 'g', 'inch', 's'), rng)}",
            old[:-1] or "x", f"{old}s",
            old.upper(), f'"{old}"', f"{old}.{old}", "", f"{old} {old}", f"'{old} '", f"{unit}_{stem}", f"\u0430{old[1:]}",
            "__class__",
        )  # fmt: skip
        return f"{_one(forms, rng)} = {said}"

    return _entries(text, rng, change)


def entry_lost(text: str, rng: np.random.Generator) -> bytes:
    """A line lost."""
    lines = text.splitlines()
    k = int(rng.integers(len(lines)))
    return _text(lines[:k] + lines[k + 1 :])


def entry_twice(text: str, rng: np.random.Generator) -> bytes:
    """A line that stands again, there or elsewhere, perhaps in another unit."""
    lines = text.splitlines()
    k = int(rng.integers(len(lines)))
    copy = re.sub(r"_(mm|deg|kg)\b", lambda unit: {"mm": "_m", "deg": "_rad", "kg": "_g"}[unit.group(1)], lines[k])
    lines.insert(k + 1 if rng.integers(2) else int(rng.integers(len(lines) + 1)), copy if rng.integers(2) else lines[k])
    return _text(lines)


def table(text: str, rng: np.random.Generator) -> bytes:
    """A table's header: single or double brackets exchanged, misspelt, nested, lost, twice."""
    found = list(re.finditer(r"^(\[+)([^\]\n]+)(\]+)$", text, flags=re.M))
    if not found:
        return value(text, rng)
    spot = found[int(rng.integers(len(found)))]
    name = spot.group(2)
    new = _one((f"[{name}]", f"[[{name}]]", f"[{name}s]", f"[{name}.x]", f"[x.{name}]", "", f"[{name}", f"[ {name} ]",
    f"[{name}]\n[{name}]",
                f"[{name}] # why", f'["{name}"]', f"[{name[:-1]}]", "[]", f"[{name.upper()}]"), rng)  # fmt: skip
    return (text[: spot.start()] + new + text[spot.end() :]).encode()


def key_more(text: str, rng: np.random.Generator) -> bytes:
    """A key more that no file has, or that another table has."""
    lines = text.splitlines()
    more = ("x = 1", "mass_kg = 1", "sigma_mm = 1", "seed = 3", "name = 'y'", "a_mm = 1", "known = true", "include = 'other.toml'",
            "[extra]", "[[joints]]", "random = 5", "file = 'other.csv'", "effects = ['geometry']", "notes = 'z'",
            "holdout = 0.5")  # fmt: skip
    lines.insert(int(rng.integers(len(lines) + 1)), _one(more, rng))
    return _text(lines)


# --- URDF --------------------------------------------------------------------------------------------


def attribute(text: str, rng: np.random.Generator) -> bytes:
    """An attribute's value, its name, or one more."""
    found = list(re.finditer(r'(\w+)="([^"]*)"', text))
    spot = found[int(rng.integers(len(found)))]
    name, old = spot.groups()
    word = _one(NO_NUMBERS, rng).replace('"', "")
    words = old.split()
    if words:
        words[int(rng.integers(len(words)))] = word
    new = _one((f'{name}="{word}"', f'{name}="{" ".join(words)}"', f'{name}s="{old}"', f"{name}={old}", "",
    f'{name}="{old}" {name}="{old}"',
                f'{name}="{old} 0"', f'{name}="{old.replace(" ", ",")}"', f'{name}="{old}" sd="1"',
                f'{name.upper()}="{old}"'), rng)  # fmt: skip
    return (text[: spot.start()] + new + text[spot.end() :]).encode()


def element(text: str, rng: np.random.Generator) -> bytes:
    """An element lost, there twice, renamed, moved, or with text in it."""
    found = list(re.finditer(r"<(\w+)[^<>]*/>", text)) + list(
        re.finditer(r"<(joint|link|inertial)\b.*?</\1>", text, flags=re.S)
    )
    spot = found[int(rng.integers(len(found)))]
    old, name = spot.group(), spot.group(1)
    new = _one(("", old + old, old.replace(f"<{name}", f"<{name}s", 1), old.replace(f"<{name}", f"<x:{name}", 1), f"<!-- {old} -->",
                f"text {old}", f"<other>{old}</other>", old.replace("/>", ">", 1), f"<![CDATA[{old}]]>"), rng)  # fmt: skip
    return (text[: spot.start()] + new + text[spot.end() :]).encode()


def declared(text: str, rng: np.random.Generator) -> bytes:
    """What stands before the root: another encoding, an entity, a document type, nothing, something after it."""
    forms = ('<?xml version="1.0" encoding="latin-1"?>', '<?xml version="1.0" encoding="utf-16"?>', "", "<?xml?>",
    " " + text.splitlines()[0],
             '<?xml version="1.0"?><!DOCTYPE robot [<!ENTITY a "aaaa">]>',
             '<!DOCTYPE robot SYSTEM "file:///etc/passwd">')  # fmt: skip
    rest = text.split("\n", 1)[1]
    return (_one(forms, rng) + "\n" + rest + _one(("", "<robot/>", "text", "\x00"), rng)).encode()


# --- Bytes -------------------------------------------------------------------------------------------


def bytes_turned(text: str, rng: np.random.Generator) -> bytes:
    """Some bits turned."""
    content = bytearray(text.encode())
    for at in rng.integers(len(content), size=int(_one((1, 1, 2, 5, 50), rng))):
        content[at] ^= 1 << int(rng.integers(8))
    return bytes(content)


def bytes_lost(text: str, rng: np.random.Generator) -> bytes:
    """A piece lost."""
    content = text.encode()
    at, n = int(rng.integers(len(content))), int(_one((1, 1, 3, 20, 300), rng))
    return content[:at] + content[at + n :]


def bytes_more(text: str, rng: np.random.Generator) -> bytes:
    """A piece more: random bytes, signs that mean something, or a piece of the file itself."""
    content = text.encode()
    at, start = (int(k) for k in rng.integers(len(content), size=2))
    meaning = (
        b"\0",
        b'"',
        b"'",
        b"\n",
        b"\r",
        b"#",
        b"=",
        b"[",
        b"]",
        b",",
        b";",
        b"\xef\xbb\xbf",
        b"\xff\xfe",
        b"\xc3",
        b"\x1a",
        b"-",
        b"e",
    )
    piece = _one(
        (rng.bytes(int(rng.integers(1, 9))), _one(meaning, rng), content[start : start + int(rng.integers(1, 60))]), rng
    )
    return content[:at] + piece + content[at:]


def cut(text: str, rng: np.random.Generator) -> bytes:
    """Cut off."""
    content = text.encode()
    return content[: int(rng.integers(len(content)))]


def zeros(text: str, rng: np.random.Generator) -> bytes:
    """A block of zeros, as a disk leaves it that was not told to write."""
    content = bytearray(text.encode())
    at = int(rng.integers(len(content)))
    n = min(len(content) - at, int(_one((1, 16, 512, 4096), rng)))
    content[at : at + n] = bytes(n)
    return bytes(content)


def encoded(text: str, rng: np.random.Generator) -> bytes:
    """Another encoding, a mark at the beginning, or other ends of lines."""
    which = int(rng.integers(7))
    signs = text.replace("tool", "Prüf", 1)
    return (
        b"\xef\xbb\xbf" + text.encode(), text.encode("utf-16"), text.encode("utf-16-le"), signs.encode("latin-1", "replace"),
        text.replace("\n", "\r\n").encode(), text.replace("\n", "\r").encode(), b"\xef\xbb\xbf\xef\xbb\xbf" + text.encode(),
    )[which]  # fmt: skip


BYTES: tuple[Mutation, ...] = (bytes_turned, bytes_turned, bytes_lost, bytes_more, cut, zeros, encoded)
IN_TOML: tuple[Mutation, ...] = (value, value, figure, key, entry_lost, entry_twice, table, key_more)
IN_URDF: tuple[Mutation, ...] = (attribute, attribute, attribute, element, element, declared)
_CELLS = (cell, cell, dressed, quoted, quotes_over_lines, cell_lost, cell_more, cells_shifted, line_cut, trailing, head,
head, column,
          separated_otherwise)  # fmt: skip


def in_table(separator: str) -> tuple[Mutation, ...]:
    """Return the mutations of a table with a separator."""
    return (*(partial(one, separator=separator) for one in _CELLS), line_copied, lines_joined, line_odd, commas)


def _one(choices, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    return choices[int(rng.integers(len(choices)))]


def _text(lines: list[str]) -> bytes:
    return ("\n".join(lines) + "\n").encode()


def _cells(text: str, rng: np.random.Generator, separator: str, change: Callable[[list[str], int], list[str]]) -> bytes:
    """A change of one cell of one line that is not the header."""
    lines = text.splitlines()
    at = int(rng.integers(1, len(lines)))
    cells = lines[at].split(separator)
    lines[at] = separator.join(change(cells, int(rng.integers(len(cells)))))
    return _text(lines)


def _entries(text: str, rng: np.random.Generator, change: Callable[[str, str], str]) -> bytes:
    """A change of one line with a key and a value."""
    lines = text.splitlines()
    at = int(_one([k for k, line in enumerate(lines) if " = " in line], rng))
    old, _, said = lines[at].partition(" = ")
    lines[at] = change(old, said)
    return _text(lines)
