"""Robots that a cluster is given together: a job of several, and each calibrated as it is alone."""

from __future__ import annotations

import os
import shutil

from calflow.fleet.engine import FleetFolder
from calflow.fleet.standing import read_outcome
from conftest import _measured  # noqa: F401, a fixture
from fleet.conftest import plant  # noqa: F401, a fixture
from fleet.plant import FLEET, ROBOTS, Plant

# An executor plugin of Snakemake's, as a cluster has one: it writes down how many robots each job has, and runs it here.
EXECUTOR = """\
import os, subprocess

from snakemake_interface_executor_plugins.executors.base import SubmittedJobInfo
from snakemake_interface_executor_plugins.executors.remote import RemoteExecutor
from snakemake_interface_executor_plugins.settings import CommonSettings

common_settings = CommonSettings(
    non_local_exec=True, implies_no_shared_fs=False, job_deploy_sources=False, init_seconds_before_status_checks=0
)


class Executor(RemoteExecutor):
    def run_job(self, job):
        with open(os.environ["SUBMITTED"], "a") as told:
            told.write(f"{len(list(job.jobs)) if job.is_group() else 1} ")
        process = subprocess.Popen(self.format_job_exec(job), shell=True)
        self.report_job_submission(SubmittedJobInfo(job, external_jobid=str(process.pid), aux={"process": process}))

    async def check_active_jobs(self, active_jobs):
        self.next_seconds_between_status_checks = 0.1
        for one in active_jobs:
            code = one.aux["process"].poll()
            if code is None:
                yield one
            elif code:
                self.report_job_error(one)
            else:
                self.report_job_success(one)

    def cancel_jobs(self, active_jobs):
        for one in active_jobs:
            one.aux["process"].kill()
"""


def test_a_cluster_is_given_so_many_robots_as_one_job_wherever_they_lie(plant, monkeypatch, tmp_path):  # noqa: F811
    """Fails if `--batch` does not come to a cluster, gives it a job a robot, or loses a robot of a job.

    Nor may jobs fail to learn that data elsewhere are allowed, or Snakemake take braces in a folder's name for a wildcard.
    """
    site = tmp_path / "site" / "snakemake_executor_plugin_toy"
    site.mkdir(parents=True)
    (site / "__init__.py").write_text(EXECUTOR, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(site.parent), os.environ.get("PYTHONPATH", ""))))
    monkeypatch.setenv("SUBMITTED", str(tmp_path / "submitted"))
    hall, elsewhere = Plant(plant.path.rename(tmp_path / "hall {north}")), tmp_path / "else {where}"
    shutil.rmtree(hall.measurements("C-3").parent)
    shutil.move(hall / "data", elsewhere)
    hall.file.write_text(FLEET.replace("data/", f"{elsewhere}/"), encoding="utf-8")
    for command in ("plan", "run", "report"):
        answer = hall.fleet(command)
        assert (answer.code, hall.out.exists()) == (2, False)
        assert "--allow" in answer.err
    options = ("--executor", "toy", "--jobs", 2)
    answer = hall.fleet("run", "--batch", 2, "--allow", elsewhere, "--", *options)
    assert answer.code == 0, (hall.out / "snakemake.log").read_text()
    assert (tmp_path / "submitted").read_text().split() == ["2"]
    folder = FleetFolder(hall.out)
    assert [read_outcome(folder.outcome(name)).status for name in ROBOTS[:2]] == ["calibrated"] * 2
    assert hall.fleet("status", "--allow", elsewhere).out.startswith("2 of 2 robots calibrated")
