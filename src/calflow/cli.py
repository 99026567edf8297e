"""The command line."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    import pandas as pd

    from calflow.measurements.measurements import Measurements
    from calflow.stages.stage import Stage

OUT = click.option("--out", type=click.Path(path_type=Path), help="Run folder; runs/<study name> by default.")
STAGE = click.option("--stage", help="This stage alone, with what it needs.")
FORCE = click.option("--force", is_flag=True, help="Do not reuse earlier results.")
FILE = click.Path(path_type=Path)
TROUBLE = 1  # exit code of trouble of the machine
AGAIN = 0.1  # s after which an interruption that was swallowed comes again


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="calflow")
def cli() -> None:
    """Calibrate robots: from measured positions to a model that can be trusted."""


@cli.command()
@click.argument("folder", type=FILE)
def new(folder: Path) -> None:
    """Write a new study into FOLDER, to be filled in."""
    from calflow.templates import write_study

    for path in write_study(folder):
        click.echo(f"wrote {path}")
    click.echo(f"next: describe your robot in {folder / 'robot.toml'}, put the measurements into "
               f"{folder / 'measurements.csv'}, then: calflow check {folder}")  # fmt: skip
    click.echo(f"to try it with simulated measurements first: calflow simulate {folder / 'truth.toml'}")


@cli.command()
@click.argument("study", type=FILE)
def check(study: Path) -> None:
    """Check a study with its robot, workflow and measurements, and run nothing."""
    from calflow.runs.checking import check as check_study
    from calflow.study import load_study

    loaded = load_study(study)
    checked = check_study(loaded)
    click.echo(f"study {loaded.name}: {loaded.robot.name}, workflow {loaded.workflow.name} "
               f"({', '.join(loaded.workflow.stages)})")  # fmt: skip
    if checked is None:
        click.echo("no measurements yet: 'calflow run --stage select' proposes poses")
        return
    data = checked.data
    for doubt in checked.doubts:
        click.echo(f"warning: {doubt.statement}")
    for note in data.notes:
        click.echo(f"note: {note}")
    for k, path in enumerate(loaded.measurement_paths):
        click.echo(_counted(path, data.only(data.of_series(k))))
    for fault in checked.faults:
        click.echo(f"fault: {fault.said}")
    source = "as the robot file says" if loaded.robot.base.known else "placed by the poses to fit"
    click.echo(f"the nominal robot's position error, base and tool {source}:")
    for row in checked.nominal.itertuples():
        click.echo(f"  {row.split:8} mean {row.mean_mm:.3f} mm, max {row.max_mm:.3f} mm")
    click.echo(f"{checked.n_parameters} parameters: {', '.join(loaded.file.effects)}")
    click.echo("ok")


def _counted(path: Path, data: Measurements) -> str:
    fitted = data.table.loc[data.train, "pose"].nunique()
    return f"{path}: {len(data)} rows, {data.table['pose'].nunique()} poses, {fitted} of them to fit"


@cli.command()
@click.argument("study", type=FILE)
@OUT
@STAGE
@FORCE
def plan(study: Path, out: Path | None, stage: str | None, force: bool) -> None:
    """Show which stages would run, which would be reused, and why."""
    from calflow.runs.folder import default_folder
    from calflow.runs.planning import plan as make_plan
    from calflow.study import load_study

    loaded = load_study(study)
    for step in make_plan(loaded, out or default_folder(loaded), stage, force):
        click.echo(f"{step.stage.name:10} {'reuse' if step.reuse else 'run':6} {step.reason}")


@cli.command()
@click.argument("study", type=FILE)
@OUT
@STAGE
@FORCE
def run(study: Path, out: Path | None, stage: str | None, force: bool) -> None:
    """Run a study: what did not change is reused, what was interrupted is resumed."""
    from calflow.reporting.last_lines import last_lines
    from calflow.runs.run import run as run_study
    from calflow.study import load_study

    with _listener() as listener:
        result = run_study(load_study(study), out, stage, force, listener)
    for line in last_lines(result.results):
        click.echo(line)
    report = result.folder / "report.pdf"
    click.echo(f"report: {report}" if report.is_file() else f"results: {result.folder}")


@cli.command()
@click.argument("study_or_run", type=FILE)
def status(study_or_run: Path) -> None:
    """Show how far a run has come: give its folder, or its study."""
    from calflow.files.problems import refuse
    from calflow.runs.folder import run_folder
    from calflow.runs.manifest import read_manifest

    folder = run_folder(study_or_run)
    manifest = read_manifest(folder)
    if manifest is None:
        raise refuse("nothing was run here yet", folder)
    click.echo(f"{folder}: study {manifest.study}, workflow {manifest.workflow}, calflow {manifest.calflow}")
    for name, entry in manifest.stages.items():
        seconds = "" if entry.seconds is None else f"{entry.seconds:.1f} s"
        reused = f"; reused since: {entry.reused}" if entry.reused else ""
        click.echo(f"{name:10} {entry.status:12} {seconds:>8}  ran because: {entry.reason}{reused}")


@cli.command()
@click.argument("study_or_run", type=FILE)
@OUT
def report(study_or_run: Path, out: Path | None) -> None:
    """Write the report of a run's results anew: give its folder, or its study."""
    from calflow.runs.folder import study_and_folder
    from calflow.runs.run import run as run_study

    study, folder = study_and_folder(study_or_run, out)
    with _listener() as listener:
        result = run_study(study, folder, "report", True, listener)
    click.echo(f"report: {result.folder / 'report.pdf'}")


@cli.command()
@click.argument("truth", type=FILE)
@click.option("--out", type=FILE, help="Measurement CSV; measurements.csv beside the truth file by default.")
@click.option("--force", is_flag=True, help="Write over a file that holds something else.")
def simulate(truth: Path, out: Path | None, force: bool) -> None:
    """Write the measurements that a truth file describes."""
    from calflow.files.csv import csv_text
    from calflow.files.problems import refuse
    from calflow.simulation import simulate as simulate_truth

    path = out or truth.parent / "measurements.csv"
    table = simulate_truth(truth)
    if path.exists() and not force and path.read_bytes() != csv_text(table).encode():
        raise refuse("is there already and holds something else; give --force to write over it, or --out", path)
    _write(table, path)
    click.echo(f"wrote {path}")


@cli.command()
@click.argument("study_or_run", type=FILE)
@click.argument("rows", metavar="ROWS.csv", type=FILE)
@click.option("--out", type=FILE, help="CSV to write; printed by default.")
@click.option(
    "--without-conditions",
    is_flag=True,
    help="Predict rows that lack needed columns too, with a wider standard deviation.",
)
def predict(study_or_run: Path, rows: Path, out: Path | None, without_conditions: bool) -> None:
    """Predict where the calibrated robot's markers will be at the joints and conditions of ROWS.csv.

    Give the run's folder, or its study.
    """
    from calflow.files.csv import csv_text
    from calflow.runs.predict import predict as predict_rows

    table = predict_rows(study_or_run, rows, "widen" if without_conditions else "refuse")
    for note in table.attrs["notes"]:
        click.echo(f"note: {note}", err=True)
    if out is None:
        click.echo(csv_text(table), nl=False)
    else:
        _write(table, out)
        click.echo(f"wrote {out}")


def main() -> None:
    """Run the command line: wrong input ends with all problems and exit code 2, trouble of the machine with 1."""
    try:
        cli(prog_name="calflow", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted: the same command resumes where it stopped", err=True)
        sys.exit(130)
    except OSError as error:
        click.echo(
            f"error: {error}. Finished stages are kept; when this is mended the same command goes on.",
            err=True,
        )
        sys.exit(TROUBLE)
    except Exception as error:
        from calflow.files.problems import InputError

        if not isinstance(error, InputError):
            raise
        click.echo(str(error), err=True)
        sys.exit(2)


def program() -> None:
    """Run the command line as the program, which ends with it."""
    try:
        main()
    except SystemExit as leaving:
        if (
            leaving.code == TROUBLE and "h5py" in sys.modules
        ):  # HDF5 crashes on the way out where a file could not be written
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(TROUBLE)
        raise


def _write(table: pd.DataFrame, path: Path) -> None:
    from calflow.files.csv import write_csv

    write_csv(path, table)


def _listener() -> _Lines | _Bar:
    return _Bar() if sys.stderr.isatty() else _Lines()


class _Lines:
    """Progress as plain lines, for a log.

    Compiled code may swallow a KeyboardInterrupt that comes while it runs (CasADi's conversions do), so it comes again until
    the stage stops, and is raised at the next progress.
    """

    def __init__(self) -> None:
        self._told = 0.0
        self._interrupted = False
        self._again: threading.Timer | None = None

    def __enter__(self) -> _Lines:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        self._heeded()
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def _interrupt(self, *_: object) -> None:
        self._interrupted = True
        self._heeded()
        self._again = threading.Timer(AGAIN, _thread.interrupt_main)
        self._again.daemon = True
        self._again.start()
        raise KeyboardInterrupt

    def _heeded(self) -> None:
        if self._again:
            self._again.cancel()

    def start(self, stage: Stage, reason: str) -> None:
        self._told = time.monotonic()
        click.echo(f"{stage.name}: {stage.title} ({reason})")

    def reuse(self, stage: Stage, reason: str) -> None:
        click.echo(f"{stage.name}: reused ({reason})")

    def say(self, line: str) -> None:
        click.echo(f"  {line}")

    def advance(self, share: float) -> None:
        if self._interrupted:
            raise KeyboardInterrupt
        self._show(share)

    def _show(self, share: float) -> None:
        if time.monotonic() - self._told > 10:
            self._told = time.monotonic()
            click.echo(f"  {share:.0%}")

    def stop(self, stage: Stage) -> None:
        self._heeded()

    def finish(self, stage: Stage, seconds: float) -> None:
        click.echo(f"  done in {seconds:.1f} s")


class _Bar(_Lines):
    """Progress as a bar, for a terminal."""

    def __enter__(self) -> _Bar:
        super().__enter__()
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

        self._console = Console(stderr=True, highlight=False)
        columns = (
            TextColumn("{task.description:10}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
        )
        self._progress = Progress(*columns, console=self._console)
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()
        super().__exit__()

    def start(self, stage: Stage, reason: str) -> None:
        self.say(f"{stage.name}: {stage.title} ({reason})")
        self._task = self._progress.add_task(stage.name, total=1.0)

    def reuse(self, stage: Stage, reason: str) -> None:
        self.say(f"{stage.name}: reused ({reason})")

    def say(self, line: str) -> None:
        self._progress.print(line, markup=False)

    def _show(self, share: float) -> None:
        self._progress.update(self._task, completed=share)

    def finish(self, stage: Stage, seconds: float) -> None:
        self._progress.update(self._task, completed=1.0)
