"""Runs: what is reused and why, what an interruption leaves, and that the same inputs give the same bytes."""

from __future__ import annotations

import errno
import hashlib
import json
import resource
import shutil
import signal
from dataclasses import replace
from functools import partial
from importlib import metadata

import h5py
import pandas as pd
import pytest
from filelock import FileLock

import calflow
from calflow.files import tables
from calflow.files.problems import refuse
from calflow.files.tables import Results
from calflow.files.toml import FileModel
from calflow.run_folder import default_folder
from calflow.runs import cache_key, planning
from calflow.sampling.chain import Chain
from calflow.stages.stage import Stage
from conftest import without_data

STAGES = ["select", "identify", "sample"]
UNCHANGED = "inputs, settings, upstream results and code are unchanged"
AGAIN = "identify runs before it"


def reasons(folder, *options):
    """What a plan says of each stage; nothing where it is reused."""
    answer = folder.calflow("plan", *options)
    assert answer.code == 0, answer
    lines = [line.split(None, 2) for line in answer.out.splitlines()]
    assert all(reason == UNCHANGED for _, verb, reason in lines if verb == "reuse")
    return {stage: reason if verb == "run" else None for stage, verb, reason in lines}


def ran(answer):
    """Which stages a run ran, which it reused."""
    assert answer.code == 0, answer
    began = [line.split(": ")[:2] for line in answer.out.splitlines() if line.split(":")[0] in STAGES]
    return [stage for stage, how in began if not how.startswith("reused")]


def whole(folder, run="runs"):
    """Whether nothing unfinished lies in a run folder, and every output is as the manifest says."""
    manifest = json.loads((folder / run / "manifest.json").read_text(encoding="utf-8"))
    outputs = {name: digest for entry in manifest["stages"].values() for name, digest in entry["outputs"].items()}
    lying = {str(path.relative_to(folder / run)) for path in (folder / run).rglob("*") if path.is_file()}
    inputs = {f"inputs/{name}.toml" for name in ("study", "robot", "workflow")}
    sums = {name: hashlib.sha256((folder / run / name).read_bytes()).hexdigest() for name in outputs}
    return sums == outputs and lying == {*outputs, *inputs, "manifest.json", "datapackage.json", ".lock"}


# --- What is reused --------------------------------------------------------------------------------


def test_a_second_run_reuses_everything(finished):
    """Fails if a stage runs again for nothing, or its results change in being reused."""
    before = finished.results()
    answer = finished.calflow("run")
    assert answer.out.splitlines()[:3] == [f"{stage}: reused ({UNCHANGED})" for stage in STAGES]
    assert finished.results() == before
    assert whole(finished)


def changed(name, old, new):
    return lambda folder: folder.edit(name, (old, new))


def touched(name):
    """A file edited by hand: the last line again."""

    def change(folder):
        text = (folder / name).read_text(encoding="utf-8")
        (folder / name).write_text(text + text.splitlines(True)[-1], encoding="utf-8")

    return change


def gone(name):
    return lambda folder: (folder / name).unlink()


CHANGES = {
    "nothing": (lambda folder: None, {}),
    "a comment of the robot": (changed("robot.toml", "# a robot", "# the robot"), {}),
    "the form of the robot": (changed("robot.toml", "a_mm = 700\nalpha_deg = 5", "alpha_deg = 5.0\na_mm = 700.0"), {}),
    "a comment of the study": (changed("study.toml", "seed = 7", "seed = 7 # why not"), {}),
    "the truth": (changed("truth.toml", "seed = 3", "seed = 4"), {}),
    "the study's setting": (changed("study.toml", "poses = 8", "poses = 9"), {"select": "setting poses changed from 8 to 9"}),
    "the workflow's setting": (changed("quick.toml", "starts = 1", "starts = 2"),
                               {"identify": "setting starts changed from 1 to 2", "sample": AGAIN}),
    "two settings": (changed("quick.toml", "block = 20\ness = 100", "block = 30\ness = 200"),
                     {"sample": "setting block changed from 20 to 30; setting ess changed from 100 to 200"}),
    "the seed": (changed("study.toml", "seed = 7", "seed = 8"),
                 {"select": "study's seed changed from 7 to 8", "identify": "study's seed changed from 7 to 8", "sample": AGAIN}),
    "the effects": (changed("study.toml", ', "joint-compliance"', ""),
                    dict.fromkeys(STAGES[:2], 'study\'s effects changed from ["geometry", "joint-compliance"] to ["geometry"]')
                    | {"sample": AGAIN}),
    "the robot": (changed("robot.toml", "a_mm = 700", "a_mm = 701"),
                  {"select": "robot.toml changed", "identify": "robot.toml changed", "sample": AGAIN}),
    "an output by hand": (touched("runs/identify/accuracy.csv"),
                          {"identify": "identify/accuracy.csv was changed by hand", "sample": AGAIN}),
    "an output lost": (gone("runs/identify/residuals.csv"), {"identify": "identify/residuals.csv is missing", "sample": AGAIN}),
    "the chain lost": (gone("runs/sample/chain.h5"), {"sample": "sample/chain.h5 is missing"}),
    "the manifest lost": (gone("runs/manifest.json"), dict.fromkeys(STAGES, "was never run")),
}  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), CHANGES.values(), ids=CHANGES)
def test_a_change_reruns_what_depends_on_it_and_says_why(finished, change, expected):
    """Fails if old results are taken for new ones, work is done for nothing, or the reason does not name the change."""
    change(finished)
    assert reasons(finished) == dict.fromkeys(STAGES) | expected


def test_changed_measurements_rerun_what_reads_them(finished):
    """Fails if a fit of other measurements is reused, or poses are selected anew for them."""
    rows = finished.rows
    rows.loc[0, "x_mm"] = str(float(rows.loc[0, "x_mm"]) + 0.001)
    finished.measure(rows)
    assert reasons(finished) == {"select": None, "identify": "measurements.csv changed", "sample": AGAIN}
    assert ran(finished.calflow("run", "--stage", "identify")) == ["identify"]
    assert reasons(finished)["identify"] is None
    assert reasons(finished) == {
        "select": None,
        "identify": None,
        "sample": "measurements.csv changed; identify changed",
    }


@pytest.mark.parametrize(("name", "told"), [("code_digest", "code changed"), ("versions", "versions changed")])
def test_other_code_reruns_everything(finished, monkeypatch, name, told):
    """Fails if results of another version of calflow or numpy pass for this one's."""
    monkeypatch.setattr(cache_key, name, lambda: {"numpy": "0"} if name == "versions" else "0")
    assert reasons(finished) == {"select": told, "identify": told, "sample": AGAIN}


OPTIONS = {
    "force": (["--force"], dict.fromkeys(STAGES, "forced")),
    "a stage": (["--stage", "sample"], {"identify": None, "sample": None}),
    "a stage, force": (["--stage", "identify", "--force"], {"identify": "forced"}),
    "the first stage": (["--stage", "select"], {"select": None}),
}


@pytest.mark.parametrize(("options", "expected"), OPTIONS.values(), ids=OPTIONS)
def test_options_choose_the_stages(finished, options, expected):
    """Fails if --stage runs more than it needs, or --force more than was named."""
    assert reasons(finished, *options) == expected


def test_an_unknown_stage_is_refused(finished):
    """Fails if a misspelt stage means all of them."""
    (told,) = finished.refused("plan", "--stage", "identfy")
    assert told.startswith("unknown stage 'identfy'; there are ")
    assert told.endswith("did you mean 'identify'?")


def test_a_stage_takes_others_into_account_only_where_they_hold(finished, monkeypatch):
    """Fails if a late stage run alone misses results that are there, passes over outdated ones in silence or calls those of a stage
    outdated that failed, or asks for more.
    """

    class None_(FileModel):
        """No settings."""

    seen = []
    last = Stage(
        "last",
        "last",
        None_,
        lambda context: seen.append(sorted(context.tables)) or Results(),
        ("identify",),
        ("select", "sample"),
    )
    monkeypatch.setattr(planning, "STAGES", {**planning.STAGES, "last": last})
    assert reasons(finished, "--stage", "last") == dict.fromkeys(STAGES) | {"last": "was never run"}
    answer = finished.calflow("run", "--stage", "last")
    assert answer.code == 0
    assert "left out" not in answer.out
    assert {name.split("/")[0] for name in seen[-1]} == set(STAGES)
    assert reasons(finished, "--stage", "last") == dict.fromkeys([*STAGES, "last"])
    finished.edit("quick.toml", ("block = 20", "block = 30"))
    found = reasons(finished, "--stage", "last")
    assert found == {"select": None, "identify": None, "last": "sample changed"}
    assert "sample is left out: its results are of other" in finished.calflow("run", "--stage", "last").out

    def fails(context):
        raise refuse("no chain")

    broken = replace(planning.STAGES["sample"], run=fails)
    monkeypatch.setattr(planning, "STAGES", {**planning.STAGES, "sample": broken})
    assert finished.calflow("run", "--stage", "sample").code == 2
    assert "sample is left out: it failed; run the study" in finished.calflow("run", "--stage", "last").out


def test_a_report_has_what_was_sampled_besides_the_workflow(small):
    """Fails if the posterior of a study whose workflow does not sample is left out of a report that is made after it."""
    workflow = (small / "quick.toml").read_text(encoding="utf-8")
    (small / "quick.toml").write_text(workflow.replace(', "sample"', ""), encoding="utf-8")
    for asked in ([], ["--stage", "sample"]):
        assert small.calflow("run", *asked).code == 0
    assert reasons(small, "--stage", "report") == dict.fromkeys(STAGES) | {"report": "was never run"}


# --- The same inputs, the same bytes ---------------------------------------------------------------


def test_the_same_inputs_give_the_same_bytes_elsewhere(finished, small, tmp_path):
    """Fails if a table depends on the folder, the time, or what ran before in the process."""
    elsewhere = tmp_path / "else" / "where"
    shutil.copytree(small.path, elsewhere)
    result = calflow.run(calflow.load_study(elsewhere), tmp_path / "out")
    found = {name: (tmp_path / "out" / name).read_bytes() for name in result.tables}
    assert found == {name: content for name, content in finished.results().items() if name in found}
    assert {name.split("/")[0] for name in found} == set(STAGES)


def test_a_run_is_a_library_call(finished):
    """Fails if tables are not the files', a path must be a Path, or the study's own name is not used."""
    study = calflow.load_study(str(finished.path))
    result = calflow.run(study, str(finished / "runs"))
    assert result.folder == finished / "runs"
    assert all(isinstance(table, pd.DataFrame) for table in result.tables.values())
    assert {str(name) for name in result.tables} == {
        name for name in finished.results() if not name.startswith("inputs")
    }
    accuracy = result.tables["identify/accuracy.csv"]
    pd.testing.assert_frame_equal(accuracy, pd.read_csv(finished / "runs" / "identify" / "accuracy.csv"))
    assert default_folder(study).parts == ("runs", "small")


def test_the_package_offers_functions_not_modules():
    """Fails if `calflow.simulate` is the function once and its module afterwards."""
    assert [callable(calflow.simulate) for _ in range(2)] == [True, True]
    assert [callable(calflow.predict) for _ in range(2)] == [True, True]


def test_the_manifest_lets_anyone_repeat_the_run(finished):
    """Fails if a version, the seed, an input or a stage is missing, or a hash is not the file's."""
    manifest = json.loads((finished / "runs" / "manifest.json").read_text(encoding="utf-8"))
    assert (manifest["seed"], manifest["study"], manifest["workflow"]) == (7, "small", "quick")
    assert manifest["calflow"] == metadata.version("calflow")
    assert {"numpy", "scipy", "casadi", "emcee", "pandas", "python"} <= set(manifest["versions"])
    assert manifest["versions"]["casadi"] == metadata.version("casadi")
    names = {path.rsplit("/")[-1]: digest for path, digest in manifest["inputs"].items()}
    assert set(names) == {"study.toml", "robot.toml", "quick.toml", "measurements.csv"}
    for name, digest in names.items():
        assert digest == hashlib.sha256((finished / name).read_bytes()).hexdigest()
    for copy, name in (("study", "study"), ("robot", "robot"), ("workflow", "quick")):
        assert (finished / "runs" / "inputs" / f"{copy}.toml").read_bytes() == (finished / f"{name}.toml").read_bytes()
    assert list(manifest["stages"]) == STAGES
    assert all(entry["status"] == "done" and entry["seconds"] >= 0 for entry in manifest["stages"].values())
    assert whole(finished)


def test_a_renamed_measurement_file_replaces_the_old_one(finished):
    """Fails if the manifest lists an input that is none any more, or selecting poses forgets the measurements."""
    (finished / "measurements.csv").rename(finished / "other.csv")
    finished.edit("study.toml", ("measurements.csv", "other.csv"))
    for stage in ("identify", "select"):
        assert finished.calflow("run", "--stage", stage).code == 0
        inputs = json.loads((finished / "runs" / "manifest.json").read_text(encoding="utf-8"))["inputs"]
        assert sorted(path.rsplit("/")[-1] for path in inputs) == [
            "other.csv",
            "quick.toml",
            "robot.toml",
            "study.toml",
        ]


# --- Interruptions ---------------------------------------------------------------------------------

KILL = """
import os, signal, sys
from calflow import cli, run_folder
from calflow.files import tables, writing
from calflow.runs import run
from calflow.sampling.chain import Chain

how, what, *arguments = sys.argv[1:]
calls = []

def die():
    os.kill(os.getpid(), signal.SIGKILL)

def write(path, content, real=writing.write_whole):
    if how == "write" and str(path).endswith(what):
        path.with_name(path.name + ".part").write_bytes(content[: len(content) // 2])
        die()
    real(path, content)

def replace(source, target, real=os.replace):
    if how == "move" and str(target).endswith(what) and ".partial" not in str(target):
        die()
    real(source, target)

def save(self, real=Chain.save):
    calls.append(0)
    if how == "save" and len(calls) == int(what):
        die()
    real(self)

for module in (tables, writing, run_folder, run):
    module.write_whole = write
os.replace, Chain.save = replace, save
sys.argv = ["calflow", *arguments]
cli.main()
"""


@pytest.mark.parametrize(
    ("how", "what"), [("write", "residuals.csv"), ("move", "identify/covariance.csv"), ("move", "manifest.json")]
)
def test_a_run_killed_while_it_writes_leaves_nothing_half_written(small, finished, how, what):
    """Fails if a half-written or half-moved stage passes for a whole one, or the next run does not finish it."""
    if what == "manifest.json":  # the very first: nothing has happened yet
        (small / "runs").mkdir()
    killed = small.forked("-c", KILL, how, what, "run", small.path, "--out", small / "runs", "--stage", "identify")
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    expected = {name: content for name, content in finished.results().items() if name.startswith("identify")}
    left = small.results()
    assert {name: content for name, content in left.items() if name.startswith("identify/")}.items() <= expected.items()
    if how == "move" and what != "manifest.json":
        assert 0 < len([name for name in left if name.startswith("identify/")]) < len(expected)
    reason = "was never run" if what == "manifest.json" else "did not finish last time (running)"
    assert reasons(small, "--stage", "identify") == {"identify": reason}
    assert small.calflow("run", "--stage", "identify").code == 0
    assert {name: content for name, content in small.results().items() if name.startswith("identify/")} == expected
    assert whole(small)


def test_a_run_killed_while_it_samples_goes_on_where_it_was(small, finished):
    """Fails if saved steps are sampled again, or the chain differs by a bit from that of a run that was left alone."""
    killed = small.forked("-c", KILL, "save", 2, "run", small.path, "--out", small / "runs")
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert not (small / "runs" / "sample").exists()
    answer = small.calflow("run")
    assert ran(answer) == ["sample"]
    assert "sample: sample the posterior (did not finish last time (running))" in answer.out
    assert "resuming after 20 steps" in answer.out
    assert small.results() == finished.results()
    assert whole(small)


def interrupt_after(blocks):
    """Interrupt the next run after so many blocks were saved, as Ctrl-C does."""
    calls = []

    def save(self, real=Chain.save):
        if len(calls) == blocks:
            patch.undo()
            raise KeyboardInterrupt
        calls.append(0)
        real(self)

    patch = pytest.MonkeyPatch()
    patch.setattr(Chain, "save", save)


@pytest.fixture(scope="module")
def _interrupted(_finished, tmp_path_factory):
    folder = _finished.copied(tmp_path_factory.mktemp("interrupted"))
    interrupt_after(1)
    with without_data():
        assert folder.calflow("run", "--stage", "sample", "--force").code == 130
    return folder


@pytest.fixture
def interrupted(_interrupted, tmp_path, monkeypatch):
    """The finished run, of which sample ran again and was interrupted after its first block."""
    monkeypatch.delenv("CALFLOW_DATA", raising=False)
    return _interrupted.copied(tmp_path / "interrupted")


def test_what_an_interrupted_stage_had_written_does_not_count(finished, interrupted):
    """Fails if tables that a stage wrote before it was killed are taken for what it makes when it runs again."""
    work = interrupted / "runs" / ".partial" / "sample"
    (work / "sample" / "old.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    (work / "figures").mkdir()
    (work / "figures" / "old.svg").write_text("<svg/>", encoding="utf-8")
    answer = interrupted.calflow("run")
    assert "resuming after" in answer.out
    assert interrupted.results() == finished.results()
    assert whole(interrupted)


def test_an_interrupted_run_says_how_to_go_on(small, finished):
    """Fails if Ctrl-C is a failure, loses the chain, or a stage run in between does."""
    interrupt_after(2)
    answer = small.calflow("run")
    assert (answer.code, answer.err.lstrip()) == (130, "interrupted: the same command resumes where it stopped\n")
    assert reasons(small)["sample"] == "did not finish last time (interrupted)"
    assert ran(small.calflow("run", "--stage", "select", "--force")) == ["select"]
    answer = small.calflow("run")
    assert "resuming after 40 steps" in answer.out
    assert small.results() == finished.results()


def test_an_interruption_that_comes_as_an_error_is_one(finished, monkeypatch):
    """Fails if Ctrl-C during a conversion of CasADi's ends in the traceback of the SystemError that it makes of it."""

    def save(self):
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr(Chain, "save", save)
    answer = finished.calflow("run", "--stage", "sample", "--force")
    assert (answer.code, answer.err.lstrip()) == (130, "interrupted: the same command resumes where it stopped\n")
    assert reasons(finished)["sample"] == "did not finish last time (interrupted)"


def test_a_chain_of_other_inputs_is_not_resumed(finished):
    """Fails if a run of changed measurements goes on from the chain of the old ones, also after an interruption."""
    finished.measure(finished.rows[:60])
    interrupt_after(0)
    assert finished.calflow("run").code == 130
    shutil.rmtree(finished / "runs" / ".partial")
    answer = finished.calflow("run")
    assert answer.code == 0
    assert "resuming" not in answer.out
    assert finished.calflow("run", "--out", finished / "fresh").code == 0
    assert finished.results() == finished.results("fresh")


def test_more_steps_go_on_from_the_finished_chain(finished):
    """Fails if a longer chain starts anew, or differs from one sampled at once, in blocks of another size."""
    finished.edit("quick.toml", ("max_steps = 60", "max_steps = 70"))
    answer = finished.calflow("run")
    assert ran(answer) == ["sample"]
    assert "setting max_steps changed from 60 to 70" in answer.out
    assert "resuming after 60 steps" in answer.out
    finished.edit("quick.toml", ("block = 20", "block = 30"))
    fresh = finished.calflow("run", "--out", finished / "fresh")
    assert "resuming" not in fresh.out
    left, right = ({k: v for k, v in finished.results(run).items() if "inputs" not in k} for run in ("runs", "fresh"))
    assert left == right


def test_force_does_not_go_on_from_an_old_chain(finished):
    """Fails if --force reuses what it was told not to."""
    before = finished.results()
    answer = finished.calflow("run", "--stage", "sample", "--force")
    assert ran(answer) == ["sample"]
    assert "resuming" not in answer.out
    assert finished.results() == before


@pytest.mark.parametrize(
    ("where", "damage"),
    [("runs/sample", None), ("runs/.partial/sample/sample", b"garbage")],
    ids=["finished", "garbage"],
)  # benchmarks/faults.py damages all of a run folder
def test_a_damaged_chain_is_sampled_anew(finished, interrupted, where, damage):
    """Fails if a broken chain ends in a traceback or gives other results."""
    folder = interrupted if ".partial" in where else finished
    chain = folder / where / "chain.h5"
    chain.write_bytes(chain.read_bytes()[: chain.stat().st_size // 2] if damage is None else damage)
    answer = folder.calflow("run")
    assert ran(answer) == ["sample"]
    assert ("chain.h5 cannot be read" if ".partial" in where else "sample/chain.h5 was changed by hand") in answer.out
    assert folder.results() == finished.results()
    assert whole(folder)


def step_turned(chain):
    with h5py.File(chain, "a") as file:
        file["ensemble2/chain"][3, 0, 0] += 1e-9


def state_turned(chain):
    with h5py.File(chain, "a") as file:
        file["ensemble1"].attrs["random_state_2"] = 1


@pytest.mark.parametrize("damage", [step_turned, state_turned], ids=lambda damage: damage.__name__)
def test_a_chain_with_turned_bits_is_not_sampled_on(finished, interrupted, damage):
    """Fails if sampling goes on from steps or a random state that were never drawn, or ends in a traceback."""
    damage(interrupted / "runs" / ".partial" / "sample" / "sample" / "chain.h5")
    answer = interrupted.calflow("run")
    assert ran(answer) == ["sample"]
    assert "sampling starts anew" in answer.out
    assert interrupted.results() == finished.results()


# --- Trouble of the machine ------------------------------------------------------------------------


def limited(size):
    """What a process does first, so that its files cannot grow beyond a size, as on a full disk; Python ignores SIGXFSZ."""
    return partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size))


def test_a_full_disk_is_told_and_the_same_command_goes_on(small, finished):
    """Fails if a full disk ends in a traceback or a crash, loses finished stages, or leaves halves that pass for wholes."""
    size, stage = 1_000_000, "sample"  # benchmarks/faults.py fills it at other moments
    full = small.forked("-m", "calflow", "run", small.path, "--out", small / "runs", begin=limited(size))
    assert full.returncode == 1, full.stderr
    assert full.stderr.splitlines()[-1].startswith("error: ") or "File too large" in full.stderr
    assert full.stderr.endswith("Finished stages are kept: once this is corrected, the same command goes on.\n")
    assert not (small / "runs" / stage).exists()
    answer = small.calflow("run")
    assert ran(answer) == STAGES[STAGES.index(stage) :]
    assert small.results() == finished.results()
    assert whole(small)


def test_a_write_that_fails_leaves_the_old_results(finished, monkeypatch):
    """Fails if a stage's files are replaced before all new ones are written."""

    def full(path, table, exact=False, real=tables.write_csv):
        if path.name == "residuals.csv":
            raise OSError(errno.ENOSPC, "No space left on device")
        real(path, table, exact)

    before = {name: content for name, content in finished.results().items() if "inputs" not in name}
    with monkeypatch.context() as patch:
        patch.setattr(tables, "write_csv", full)
        with pytest.raises(OSError, match="No space left"):
            calflow.run(calflow.load_study(finished.path), finished / "runs", "identify", force=True)
    after = finished.results()
    assert {name: after[name] for name in before} == before
    assert finished.calflow("run").code == 0
    assert whole(finished)


def test_the_lock_of_a_dead_run_does_not_count(finished):
    """Fails if a run that was killed keeps all later ones out."""
    hold = "import os, sys; from filelock import FileLock; FileLock(sys.argv[1]).acquire(); os.kill(os.getpid(), 9)"
    assert finished.apart("-c", hold, finished / "runs" / ".lock").returncode == -signal.SIGKILL
    assert finished.calflow("run").code == 0


def test_two_runs_at_once_are_refused(finished):
    """Fails if two runs write into one folder, or the lock of a run that is over counts."""
    with FileLock(finished / "runs" / ".lock"):
        (told,) = finished.refused("run")
        assert told.startswith("runs: another run is at work in this folder")
    assert finished.calflow("run").code == 0


def test_a_run_needs_no_fcntl(small):
    """Fails if a run is a traceback where the system has no such locks, as Windows."""
    without = "import sys; sys.modules['fcntl'] = None; from calflow.cli import main; sys.argv[0] = 'calflow'; main()"
    done = small.apart("-c", without, "run", small.path, "--out", small / "runs", "--stage", "select")
    assert done.returncode == 0, done.stderr
    assert "select: choose the poses" in done.stdout


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "[1]", '"text"', '{"stages": []}', '{"stages": {"identify": 3}}', "\0"]
)
@pytest.mark.parametrize("command", ["run", "plan", "status", "predict"])
def test_a_broken_manifest_is_told(finished, text, command):
    """Fails if a manifest that no run wrote ends in a traceback, or in running everything in silence."""
    manifest = finished / "runs" / "manifest.json"
    manifest.write_text(text, encoding="utf-8")
    arguments = {"status": [finished / "runs"], "predict": [finished / "runs", finished / "measurements.csv"]}
    (told,) = finished.refused(command, *arguments.get(command, []))
    assert told.startswith("runs/manifest.json: ")
    assert told.endswith("delete it to run everything anew")
    manifest.unlink()
    assert set(reasons(finished).values()) == {"was never run"}


def test_another_studys_folder_is_refused(finished):
    """Fails if one study's results are overwritten with, or mixed into, another's."""
    finished.edit("study.toml", ('"small"', '"large"'))
    (told,) = finished.refused("run")
    assert told == "runs: holds the run of another study, 'small'; give another folder with --out"


def test_a_file_as_run_folder_is_refused(small):
    """Fails if a wrong --out counts as trouble of the machine."""
    (told,) = small.refused("run", "--out", small / "robot.toml")
    assert told == "robot.toml: is a file; expected a run folder, which may not exist yet"


def test_a_run_is_not_put_into_its_study_s_folder(small):
    """Fails if a study's folder becomes a run folder, which every command then takes for the run, whatever is run later."""
    (told,) = small.refused("run", "--out", small.path)
    assert "is the study's own folder; expected another for the run" in told
    assert not (small / "manifest.json").exists()


@pytest.mark.parametrize(
    ("name", "column"),
    [("parameters", "estimate"), ("parameters", "parameter"), ("covariance", "parameter"), ("effects", "variant"),
     ("faults", "statement")],
)  # fmt: skip
def test_a_table_of_another_version_is_one_message(finished, name, column):
    """Fails if a run whose table lacks a column, and is vouched for, ends a command that uses it with a traceback."""
    path = f"identify/{name}.csv"
    table = pd.read_csv(finished / "runs" / path)
    finished.rewrite(path, table.drop(columns=column))
    finished.measure(finished.rows[:2].drop(columns=["x_mm", "y_mm", "z_mm"]), "rows.csv")
    (told,) = finished.refused("predict", finished / "runs", finished / "rows.csv")
    assert path in told
    assert "again" in told


def test_an_interrupted_stage_goes_on_with_no_link(finished, interrupted, tmp_path):
    """Fails if a chain that lies outside of the run folder is written to where a link in a work folder names it."""
    work, outside = interrupted / "runs" / ".partial" / "sample" / "sample", tmp_path / "outside"
    work.rename(outside)
    work.symlink_to(outside)
    before = (outside / "chain.h5").read_bytes()
    assert interrupted.calflow("run").code == 0
    assert (outside / "chain.h5").read_bytes() == before
    assert interrupted.results() == finished.results()
