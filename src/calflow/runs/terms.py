"""Terms: under which licence the files of a packed run may be used, and whose work they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from calflow.files.problems import refuse

LICENCE = "#licence"
SPDX = "https://spdx.org/licenses/"
REFERENCE = "LicenseRef-"  # in SPDX: terms that are on no list


@dataclass(frozen=True)
class Terms:
    """A licence as an SPDX expression (https://spdx.org/licenses), e.g. `CC-BY-4.0`, and authors by name; empty: not stated."""

    licence: str = ""
    authors: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

        if not all(name.strip() for name in self.authors):
            raise refuse("--author is empty: expected a name")
        if not self.licence:
            return
        try:
            object.__setattr__(self, "licence", canonicalize_license_expression(self.licence))
        except InvalidLicenseExpression:
            raise refuse(
                f"--licence '{self.licence}' is no SPDX licence expression: expected e.g. CC-BY-4.0, CC0-1.0, MIT, "
                f"'MIT AND CC-BY-4.0', or {REFERENCE}NAME for terms of your own ({SPDX} has the list)"
            ) from None

    def entities(self) -> list[dict[str, Any]]:
        """Return the licence and the authors as entities of an RO-Crate, the licence first."""
        people = [{"@id": f"#author-{k}", "@type": "Person", "name": name} for k, name in enumerate(self.authors, 1)]
        return [self._licence(), *people]

    def _licence(self) -> dict[str, Any]:
        if not self.licence:
            return {
                "@id": LICENCE, "@type": "CreativeWork", "name": "no licence stated",
                "description": "Who packed this run has not said under which terms its files may be used.",
            }  # fmt: skip
        listed = " " not in self.licence and not self.licence.startswith(REFERENCE)
        said = f"SPDX licence expression {self.licence}: the terms under which the files may be used."
        name = f"{SPDX}{self.licence}" if listed else LICENCE
        return {"@id": name, "@type": "CreativeWork", "name": self.licence, "description": said}
