"""Robots that a cluster is given together: a job of several, and each calibrated as it is alone."""

from __future__ import annotations

import os
import shutil

from calflow.fleet.engine import FleetFolder
from calflow.fleet.standing import read_outcome
from fleet.plant import ROBOTS

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


def test_a_cluster_is_given_so_many_robots_as_one_job(plant, monkeypatch, tmp_path):
    """Fails if `--batch` does not come to a cluster, gives it a job a robot, or loses a robot of a job."""
    site = tmp_path / "site" / "snakemake_executor_plugin_toy"
    site.mkdir(parents=True)
    (site / "__init__.py").write_text(EXECUTOR, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(site.parent), os.environ.get("PYTHONPATH", ""))))
    monkeypatch.setenv("SUBMITTED", str(tmp_path / "submitted"))
    shutil.rmtree(plant.measurements("C-3").parent)
    options = ("--executor", "toy", "--jobs", 2, "--seconds-between-status-checks", 1)
    answer = plant.fleet("run", "--batch", 2, "--", *options)
    assert answer.code == 0, (plant.out / "snakemake.log").read_text()
    assert (tmp_path / "submitted").read_text().split() == ["2"]
    folder = FleetFolder(plant.out)
    assert [read_outcome(folder.outcome(name)).status for name in ROBOTS[:2]] == ["calibrated"] * 2
