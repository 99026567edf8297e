"""What the report says of the models in reach."""

from __future__ import annotations

from calflow.deployment.run_outcome import RunOutcome
from calflow.diagnosis.cause_tables import CauseProbability, ModelRow
from calflow.files.tables import Results, to_frame
from calflow.reporting.blocks import Table
from calflow.reporting.sections.model_choice import model_choice_section
from reporting.case import weighed_models


def told(tables):
    """The section's blocks."""
    return model_choice_section.write(RunOutcome(Results(tables)))


def test_models_are_listed_with_the_forms_of_their_causes():
    """Fails if a model is listed without its cause's form, one that has no other with a mark for it, or with what all share."""
    _, table = [block for block in told(weighed_models()) if isinstance(block, Table)]
    assert [row[0] for row in table.rows] == [
        "as found: backlash of joint 1",
        "with eccentricity of joint 3 (order 2); without backlash of joint 1",
    ]


def test_nothing_found_has_no_section():
    """Fails if a study in which diagnose found nothing has an empty section."""
    empty = {"diagnose/models_in_reach.csv": to_frame((), ModelRow),
             "diagnose/cause_probabilities.csv": to_frame((), CauseProbability)}  # fmt: skip
    assert not model_choice_section.has_content(RunOutcome(Results(empty)))
    assert model_choice_section.has_content(RunOutcome(Results(weighed_models())))
