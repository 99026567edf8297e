"""Plugins: any group's classes are found alike, and a change of their packages shows."""

from __future__ import annotations

import decimal

from calflow.files import plugins
from plugin import install

LENGTHS = "import decimal\n\n\nclass Wire(decimal.Decimal):\n    id = 'wire'\n"


def test_any_group_is_found_by_its_base_class(tmp_path, monkeypatch):
    """Fails if the loader knows effects alone, or gives one group's classes to another."""
    install(tmp_path, "wires", LENGTHS, "wire = wires:Wire", plugins.OBSERVATIONS)
    monkeypatch.syspath_prepend(tmp_path)

    def found(group: str) -> dict[str, type[decimal.Decimal]]:
        return plugins.catalogue_of("calflow.files", group, decimal.Decimal, lambda kind: "")

    (kind,) = found(plugins.OBSERVATIONS).values()
    assert (kind.__module__, kind.id) == ("wires", "wire")
    assert found(plugins.EFFECTS) == {}


def test_packages_are_known_by_version_and_code(tmp_path, monkeypatch):
    """Fails if an edited or newer package passes for the one that results came from."""
    install(tmp_path, "ropes", LENGTHS, "wire = ropes:Wire", plugins.OBSERVATIONS)
    monkeypatch.syspath_prepend(tmp_path)
    read = plugins.packages.__wrapped__
    before = read()
    assert list(before) == ["ropes"]
    assert read() == before
    (tmp_path / "ropes.py").write_text(LENGTHS + "\n", encoding="utf-8")
    edited = read()
    assert edited["ropes"].split()[0] == before["ropes"].split()[0] == "1.2"
    assert edited != before


def test_all_files_of_a_package_count_also_within_a_namespace(tmp_path, monkeypatch):
    """Fails if a helper beside the class, or data that it reads, may change unseen."""
    inner = tmp_path / "firm" / "wires"
    (inner / "data").mkdir(parents=True)
    (inner / "__init__.py").write_text(LENGTHS, encoding="utf-8")
    (inner / "data" / "table.csv").write_text("1\n", encoding="utf-8")
    (tmp_path / "firm" / "other.txt").write_text("not its own", encoding="utf-8")
    install(tmp_path, "firm_wires", "", "wire = firm.wires:Wire", plugins.OBSERVATIONS)
    monkeypatch.syspath_prepend(tmp_path)
    before = plugins.packages.__wrapped__()
    (tmp_path / "firm" / "other.txt").write_text("still not", encoding="utf-8")
    assert plugins.packages.__wrapped__() == before
    (inner / "data" / "table.csv").write_text("2\n", encoding="utf-8")
    assert plugins.packages.__wrapped__() != before


def test_without_other_packages_there_is_nothing():
    """Fails if results depend on packages that bring nothing."""
    assert plugins.packages.__wrapped__() == {}
