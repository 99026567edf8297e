"""Stages: thin functions from a study and earlier tables to tables, in the order in which they may run."""

from __future__ import annotations

from collections.abc import Mapping

from calflow.stages import diagnose, identify, report, residual_field, sample, select
from calflow.stages.stage import Stage

STAGES: Mapping[str, Stage] = {
    module.STAGE.name: module.STAGE for module in (select, identify, diagnose, residual_field, sample, report)
}
