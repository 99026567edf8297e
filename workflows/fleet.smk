"""All robots of a fleet, by Snakemake. `calflow fleet run` calls it; by hand:

    snakemake -s workflows/fleet.smk --config fleet=plant.toml --cores 2

What it is told, with --config or --configfile: fleet, the fleet file; out, the fleet's folder (runs/<its name>); batch, how
many robots a job calibrates one after the other (10); allow, a list of folders in which the fleet file may name files besides its
own. A robot that fails has an outcome that says so: delete that, and it is tried anew.

Outputs are named as seen from the fleet's folder, and inputs are told by their state: braces in a folder's name would be
wildcards to Snakemake.
"""

import sys
from pathlib import Path

from calflow.fleet.fleet import load_fleet
from calflow.fleet.fleet_folder import FleetFolder
from calflow.fleet.jobs import jobs, made_by

ALLOW = [str(Path(folder).resolve()) for folder in config.get("allow", [])]
FLEET = load_fleet(Path(config["fleet"]).resolve(), ALLOW)
FOLDER = FleetFolder(Path(config.get("out", Path("runs") / FLEET.name)).resolve())
HERE = FleetFolder(Path())
JOBS = jobs(FLEET, int(config.get("batch", 10)))
OUTCOMES = [outcome for job in JOBS for outcome in job.outputs(HERE)]
COMMAND = [sys.executable, "-m", "calflow", "fleet"]
TOLD = ["--out", str(FOLDER.path), *(f"--allow={folder}" for folder in ALLOW), str(FLEET.path)]


workdir: str(FOLDER.path)


localrules:
    all,
    report,


rule all:
    input:
        HERE.results,
        OUTCOMES,  # also where a report of fewer robots is there


rule report:
    input:
        OUTCOMES,
    output:
        HERE.results,
    params:
        made_by=made_by(),
    shell:
        "{COMMAND:q} report {TOLD:q}"


for number, job in enumerate(JOBS):

    rule:
        name:
            f"calibrate_{number}"
        output:
            job.outputs(HERE),
        params:
            made_by=made_by(),
            inputs=job.inputs,
            robots=job.names,
        retries: 1
        shell:
            "{COMMAND:q} work {TOLD:q} {params.robots:q}"
