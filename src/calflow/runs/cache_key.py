"""The cache key of a stage: named values on which its results depend, to explain a miss; and the environment."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from functools import lru_cache
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from calflow.files.plugins import packages
from calflow.measurements.source import sha256
from calflow.run_folder import after, code_digest, digest, robot_digest, versions
from calflow.stages.stage import Stage
from calflow.study import Study, StudyFile

REPORTED = ("title", "acceptance")  # keys of a study that only the report uses
# Keys of a study that are not in every stage's key: settings have entries of their own, and stages run or do not.
ELSEWHERE = {"stages", "workflow", "residual_field", *REPORTED}


def common_key(study: Study) -> dict[str, str]:
    """Return the entries of the cache key that all stages of a study have in common."""
    return {
        "code": code_digest(),
        "versions": digest(json.dumps(versions(), sort_keys=True)),
        **{f"package {name}": version for name, version in packages().items()},
        **{f"study's {name}": value for name, value in _asked(study, ELSEWHERE).items()},
        f"file {study.robot_path.name}": robot_digest(study.robot),
    }


def stage_key(
    study: Study, stage: Stage, common: Mapping[str, str], upstream: Mapping[str, Mapping[str, str]]
) -> dict[str, str]:
    """Return the cache key of a stage; upstream are the keys of the stages before it."""
    key = dict(common)
    if stage.titled:
        request = _asked(study, set(StudyFile.model_fields) - set(REPORTED))
        key |= {f"study's {name}": value for name, value in request.items()}
    if stage.measured:
        key |= {f"file {name}": digest for name, digest in _measurement_hashes(study).items()}
        key |= _confirming_key(study)
    settings = study.validated_settings(stage.name, stage.settings)
    key |= {f"file {path.name}": digest for path, digest in file_hashes(study, stage).items()}
    key |= {f"setting {name}": json.dumps(value) for name, value in settings.model_dump(mode="json").items()}
    return key | after({name: upstream[name] for name in (*stage.needs, *stage.uses) if name in upstream})


def file_hashes(study: Study, stage: Stage) -> dict[Path, str]:
    """Return the SHA-256 of the existing files that a stage's settings name."""
    paths = stage.reads(study, study.validated_settings(stage.name, stage.settings))
    return {path: sha256(path) for path in paths if path.is_file()}


def _confirming_key(study: Study) -> dict[str, str]:
    """Return the entries of the cache key for the confirming study: its file, robot and measurements."""
    other = study.confirming
    if other is None:
        return {}
    asked = _asked(other, ELSEWHERE | {"confirm"})
    return {
        f"confirming {other.path.name}": digest(json.dumps(asked, sort_keys=True)),
        f"confirming {other.robot_path.name}": robot_digest(other.robot),
        **{f"confirming {name}": digest for name, digest in _measurement_hashes(other).items()},
    }


def _measurement_hashes(study: Study) -> dict[str, str]:
    """Return the SHA-256 of every series' file by its name, or by its path in the study if names are equal."""
    paths = study.measurement_paths
    names = [path.name for path in paths]
    stated = zip(paths, study.file.sources, strict=True)
    return {path.name if names.count(path.name) == 1 else source.file: sha256(path) for path, source in stated}


def _asked(study: Study, without: set[str]) -> dict[str, str]:
    file = study.file.model_dump(mode="json", exclude=without)
    return {name: json.dumps(value, ensure_ascii=False) for name, value in file.items()}


@lru_cache
def machine() -> str:
    """Return the kind of machine and of linear algebra kernels, on which the last bits of numbers depend."""
    import numpy as np  # noqa: F401  # its linear algebra must be loaded to be inspected
    from threadpoolctl import threadpool_info

    kernels = sorted({library["architecture"] for library in threadpool_info() if "architecture" in library})
    return ", ".join([f"{platform.system()} {platform.machine()}", *(f"linear algebra for {name}" for name in kernels)])


def version_changes(was: dict[str, str], now: dict[str, str]) -> list[str]:
    """Return descriptions of the versions that differ."""
    names = dict.fromkeys((*was, *now))
    return [
        f"{name} {was.get(name, 'not there')} → {now.get(name, 'not there')}"
        for name in names
        if was.get(name) != now.get(name)
    ]


@lru_cache
def environment() -> dict[str, str]:
    """Return the version of every installed package that calflow needs, directly or through others, by its name."""
    installed: dict[str, str] = {}
    waiting = ["calflow"]
    while waiting:
        name = waiting.pop()
        if name in installed:
            continue
        try:
            package = metadata.distribution(name)
        except metadata.PackageNotFoundError:  # for another system, or of an extra that is not installed
            continue
        installed[name] = package.version
        waiting += [canonicalize_name(need.name) for need in requirements(package)]
    return dict(sorted(installed.items()))


def requirements(package: metadata.Distribution, extra: str = "") -> list[Requirement]:
    """Return the requirements of a package on this machine, or the additional ones of an extra."""
    every = [Requirement(text) for text in package.requires or ()]
    plain = [need for need in every if need.marker is None or need.marker.evaluate({"extra": ""})]
    if not extra:
        return plain
    return [need for need in every if need not in plain and need.marker and need.marker.evaluate({"extra": extra})]
