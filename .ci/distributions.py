"""What a package index asks of the files in a folder: metadata that are valid, a description that it can show, and the licence.

python .ci/distributions.py dist
"""

from __future__ import annotations

import sys
import tarfile
import zipfile
from pathlib import Path

from packaging.metadata import Metadata
from packaging.utils import parse_sdist_filename, parse_wheel_filename

SHOWN = (
    "LICENSE",
    "README.md",
    "CHANGELOG.md",
    "CITATION.cff",
    "tests/conftest.py",
    "docs/index.md",
    "studies/hh800/study.toml",
)


def main(folder: Path) -> None:
    """Look at the one sdist and the one wheel of a folder; what is wrong with them ends the program."""
    (sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    with tarfile.open(sdist) as archive:
        kept = {name.partition("/")[2]: name for name in archive.getnames()}
        assert not (missing := set(SHOWN) - set(kept)), f"{sdist.name} lacks {missing}"
        told = Metadata.from_email(archive.extractfile(kept["PKG-INFO"]).read())
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (info,) = {name.partition("/")[0] for name in names if ".dist-info/" in name}
        assert {name.partition("/")[0] for name in names} == {"calflow", info}, (
            "the wheel installs something else besides"
        )
        assert not [name for name in names if name.endswith((".pyc", ".orig", "~"))], (
            "the wheel holds what nobody wrote"
        )
        same = Metadata.from_email(archive.read(f"{info}/METADATA"))
        for name in same.license_files:
            assert archive.read(f"{info}/licenses/{name}"), f"the wheel lacks {name}"
    assert parse_sdist_filename(sdist.name) == (told.name, told.version) == parse_wheel_filename(wheel.name)[:2]
    assert (told.description, told.summary, told.version) == (same.description, same.summary, same.version)
    assert (same.license_expression, same.license_files) == ("MIT", ["LICENSE"])
    assert same.description_content_type == "text/markdown"
    assert all((same.summary, same.description, same.keywords, same.classifiers))
    print(f"{sdist.name} and {wheel.name}: metadata {same.metadata_version}, licence {same.license_expression}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
