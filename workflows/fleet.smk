"""All robots of a fleet, by Snakemake. `calflow fleet run` calls it; by hand:

    snakemake -s workflows/fleet.smk --config fleet=plant.toml --cores 2

What it is told, with --config or --configfile: fleet, the fleet file; out, the fleet's folder (runs/<its name>); batch, how
many robots a job calibrates one after the other (10). A robot that fails has an outcome that says so: delete that, and it is tried anew.
"""

import sys
from pathlib import Path

from calflow.fleet.fleet import load_fleet
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.jobs import jobs, made_by

FLEET = load_fleet(config["fleet"])
FOLDER = FleetFolder(Path(config.get("out", Path("runs") / FLEET.name)))
JOBS = jobs(FLEET, int(config.get("batch", 10)))
OUTCOMES = [outcome for job in JOBS for outcome in job.outputs(FOLDER)]
PYTHON = sys.executable


localrules:
    all,
    report,


rule all:
    input:
        FOLDER.results,
        OUTCOMES,  # also where a report of fewer robots is there


rule report:
    input:
        OUTCOMES,
    output:
        FOLDER.results,
    params:
        made_by=made_by(),
    shell:
        "{PYTHON:q} -m calflow fleet report {FLEET.path:q} --out {FOLDER.path:q}"


for number, job in enumerate(JOBS):

    rule:
        name:
            f"calibrate_{number}"
        input:
            job.inputs,
        output:
            job.outputs(FOLDER),
        params:
            made_by=made_by(),
            robots=job.names,
        retries: 1
        shell:
            "{PYTHON:q} -m calflow fleet work {FLEET.path:q} --out {FOLDER.path:q} {params.robots:q}"
