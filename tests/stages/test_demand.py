"""What a stage will take is foreseen and told before it begins."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd
import pytest

from calflow.diagnosis.regressors import Regressors
from calflow.files.problems import InputError
from calflow.runs import checking, run
from calflow.stages import demand
from calflow.stages.catalogue import STAGES
from calflow.stages.demand import Demand, duration, memory_available, warned
from calflow.study import load_study

GB = 1e9


def test_little_is_not_told():
    """Fails if every run begins with a warning."""
    assert warned("identify", Demand(1000, 40, 3.5, 1.0), 8 * GB) == ""
    assert warned("identify", Demand(), None) == ""


def test_much_is_told_against_what_there_is():
    """Fails if a run that will need all memory, or an hour, begins without a word, or the figures are not the array's."""
    said = warned("diagnose", Demand(300_000, 3500, 1.5, 600.0, "name causes"), 16 * GB)
    assert said.startswith(
        "warning: diagnose is foreseen to take some 12.8 GB (this machine has 16 GB) and at least 10 minutes"
    )
    assert said.endswith("for 300,000 residuals by 3,500 columns; to take less, name causes")
    assert "at least 60 minutes" in warned("diagnose", Demand(10, 10, 1.0, 3600.0), 16 * GB)
    assert "is not known" in warned("diagnose", Demand(10, 10, 1.0, 3600.0), None)


def test_what_certainly_cannot_be_done_is_refused():
    """Fails if a run works for an hour and then dies of memory that was never there, or one is refused that might do."""
    with pytest.raises(
        InputError, match=r"diagnose cannot be done here: one array .* takes 84.0 GB, this machine has 16 GB; name"
    ):
        warned("diagnose", Demand(3_000_000, 3500, 1.5, 600.0, "name causes"), 16 * GB)
    assert warned("diagnose", Demand(300_000, 3500, 1.5, 600.0, "name causes"), 9 * GB)


def test_the_machine_tells_its_memory():
    """Fails if the unit is wrong."""
    assert 0.1 * GB < memory_available() < 1e5 * GB


def test_the_array_of_a_stage_is_the_one_that_it_makes(small, monkeypatch):
    """Fails if rows are counted otherwise than the tests count them, or columns are missed; means of repeats may have fewer."""
    made, real = [], Regressors.of
    monkeypatch.setattr("calflow.stages.diagnose.ANY_MACHINE", 0)
    small.edit(
        "quick.toml",
        (', "sample"]', ', "diagnose"]'),
        ("[settings.sample]\nmax_steps = 60\nblock = 20\ness = 100\n", ""),
    )
    study = load_study(small.path)
    settings = study.validated_settings("diagnose", STAGES["diagnose"].settings)
    foreseen = STAGES["diagnose"].demand(study, settings, study.measurements())

    def of(*arguments, **more):
        found = real(*arguments, **more)
        made.append(found.matrix.shape[1] + len(arguments[0].estimate))
        assert len(found.residual) == foreseen.rows
        return found

    monkeypatch.setattr(Regressors, "of", of)
    assert small.calflow("run", "--stage", "diagnose").code == 0
    assert max(made) <= foreseen.columns < 1.3 * max(made)


def test_a_run_says_it_before_it_begins(small, monkeypatch):
    """Fails if it is told afterwards, or what cannot be done leaves a folder behind."""
    monkeypatch.setattr(run, "memory_available", lambda: 100_000.0)
    out = small.calflow("run", "--stage", "identify").out
    assert out.index("warning: identify is foreseen to take") < out.index("identify: identify geometry")
    monkeypatch.setattr(run, "memory_available", lambda: 1000.0)
    (told,) = small.refused("run", "--stage", "identify", "--out", small / "other")
    assert told.startswith("identify cannot be done here")
    assert not (small / "other").exists()


def test_check_and_plan_say_what_stages_will_take(small, monkeypatch):
    """Fails if one learns it from the run alone, it is said of what any machine has, or a plan says it of what is reused."""
    assert "GB" not in small.calflow("check").out + small.calflow("plan").out
    monkeypatch.setattr(demand, "LITTLE", 0.0)
    told = [
        line
        for line in small.calflow("check").out.splitlines()
        if " will take about 0.2 GB and less than 2 min" in line
    ]
    assert [line.split()[0] for line in told] == ["identify", "sample"]
    assert small.calflow("run", "--stage", "identify").code == 0
    steps = {line.split()[0]: line for line in small.calflow("plan").out.splitlines()}
    assert "takes" not in steps["identify"]
    assert "; takes about 0.2 GB and less than 2 minutes of one core" in steps["sample"]


def test_check_refuses_what_a_run_would_refuse(small, monkeypatch):
    """Fails if a study passes the check whose run does not begin, or a warning is left to the run."""
    monkeypatch.setattr(checking, "memory_available", lambda: 1e6)
    assert "warning: identify is foreseen to take some 0.2 GB" in small.calflow("check").out
    monkeypatch.setattr(checking, "memory_available", lambda: 1000.0)
    assert [line.split(" ")[0] for line in small.refused("check")] == ["identify", "sample"]


def test_what_sample_takes_grows_with_steps_walkers_and_rows(small):
    """Fails if a chain of a million rows, which takes days, begins without a word."""
    study = load_study(small.path)
    stage = STAGES["sample"]
    settings = study.validated_settings("sample", stage.settings)
    data = study.measurements()
    few = stage.demand(study, settings, data)
    assert few.rows == 3 * len(data)
    longer = settings.model_copy(update={"max_steps": 2 * settings.max_steps})
    assert stage.demand(study, longer, data).seconds == pytest.approx(2 * few.seconds)
    twice = replace(data, table=pd.concat([data.table, data.table.assign(pose=-data.table["pose"])], ignore_index=True))
    assert stage.demand(study, settings, twice).seconds == pytest.approx(2 * few.seconds)
    again = replace(data, table=pd.concat([data.table, data.table.assign(repeat=9)], ignore_index=True))
    assert stage.demand(study, settings, again).seconds == pytest.approx(few.seconds)
    assert duration(3 * 86400) == "3 days"
    assert duration(few.seconds) == "less than 2 minutes"
