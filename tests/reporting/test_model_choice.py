"""What the report says of the models in reach."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from calflow.files.results import Results
from calflow.files.tables import to_frame
from calflow.reporting.blocks import Bullets, Paragraph, Table
from calflow.reporting.sections.model_choice import MODEL_CHOICE_SECTION, SHARED
from calflow.sampling.models import CauseProbability, ModelRow
from reporting.case import weighed_models


def told(tables):
    """The section's blocks."""
    return MODEL_CHOICE_SECTION.write(SimpleNamespace(results=Results(tables)))


def test_where_the_tests_of_diagnose_say_otherwise_it_is_told():
    """Fails if a probability far from diagnose's is shown without a word, or a model without its form."""
    blocks = told(weighed_models())
    (bullets,) = [block for block in blocks if isinstance(block, Bullets)]
    assert any("backlash" in item and "70 %" in item and "90 %" in item for item in bullets.items)
    (table,) = [block for block in blocks if isinstance(block, Table)]
    assert any("order 2" in row[0] for row in table.rows)
    assert not any("(-)" in row[0] for row in table.rows)


def test_where_errors_are_not_independent_it_is_told():
    """Fails if figures of the tests pass for integrals."""
    tables = weighed_models()
    shared = tables["sample/models.csv"].assign(log_evidence=np.nan)
    said = [block.text for block in told(tables | {"sample/models.csv": shared}) if isinstance(block, Paragraph)]
    assert SHARED in said
    assert SHARED not in [block.text for block in told(tables) if isinstance(block, Paragraph)]


def test_nothing_found_has_no_section():
    """Fails if a study in which diagnose found nothing has an empty section."""
    empty = {"sample/models.csv": to_frame((), ModelRow),
             "sample/cause_probabilities.csv": to_frame((), CauseProbability)}  # fmt: skip
    assert not MODEL_CHOICE_SECTION.worth_telling(Results(empty))
    assert MODEL_CHOICE_SECTION.worth_telling(Results(weighed_models()))
