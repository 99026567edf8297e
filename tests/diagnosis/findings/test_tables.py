"""The table of findings says what the model leaves, whether anything explains it or not."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from calflow.diagnosis.findings.misfit import misfit
from calflow.diagnosis.findings.tables import Diagnosis, FindingRow, findings_table
from calflow.diagnosis.screening.catalogue import Catalogue
from calflow.diagnosis.search.extension import Extended
from calflow.diagnosis.search.linearisation import Linearisation
from calflow.files.tables import from_frame
from diagnosis.findings.test_misfit import rng, rough
from diagnosis.findings.test_remainder import fitted

FAULTS = pd.DataFrame({"cause": [], "joint": [], "line": [], "statement": []})


@pytest.fixture(scope="module")
def uneven():
    """A model whose errors are large at one quarter of the first joint's travel, and follow nothing there."""
    return fitted(rough(lambda t: t["q1"] > np.quantile(t["q1"], 0.75)))


def diagnosis(last, **more):
    """A diagnosis that found no cause."""
    first = Linearisation.at(last, Catalogue((), {})).screened(np.random.default_rng(1))
    return Diagnosis(last, Extended(last, (), (), first), (), (), None, {}, {}, 0.01, **more)


def told(found):
    """The rows of findings.csv."""
    return from_frame(findings_table(found, found.start.data, FAULTS, np.random.default_rng(1)), FindingRow)


def test_a_lack_of_fit_has_a_row_though_no_input_explains_it(uneven):
    """Fails if a model that lacks something ends in an empty table, or its row does not say where."""
    (row,) = told(diagnosis(uneven, misfit=misfit(uneven, rng())))
    assert (row.status, row.cause, row.inputs) == ("unexplained", "", ())
    assert row.detail.startswith("joint 1 is between")
    assert row.p_family < 1e-6
    assert row.detail in row.statement
    assert "times the noise" in row.statement
    assert told(diagnosis(uneven)) == []
