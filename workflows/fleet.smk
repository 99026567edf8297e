"""All robots of a fleet, by Snakemake. `calflow fleet run` calls it; by hand:

    snakemake -s workflows/fleet.smk --config fleet=plant.toml --cores 2

What it is told, with --config or --configfile: fleet, the fleet file; out, the fleet's folder (runs/<its name>); allow, a list of
folders in which the fleet file may name files besides its own. A robot that fails has an outcome that says so: delete that, and
it is tried anew.

Outputs are named as seen from the fleet's folder, and inputs are told by their state: braces in a folder's name would be
wildcards to Snakemake.
"""

import sys
from pathlib import Path

from calflow.fleet.calibration import input_state, made_by
from calflow.fleet.engine import RETRIES, FleetFolder
from calflow.fleet.fleet import load_fleet

ALLOW = [str(Path(folder).resolve()) for folder in config.get("allow", [])]
FLEET = load_fleet(Path(config["fleet"]).resolve(), ALLOW)
FOLDER = FleetFolder(Path(config.get("out", Path("runs") / FLEET.name)).resolve())
HERE = FleetFolder(Path())
OUTCOMES = [HERE.outcome(robot.name) for robot in FLEET.robots]
COMMAND = [sys.executable, "-m", "calflow", "fleet"]
TOLD = ["--out", str(FOLDER.path), *(f"--allow={folder}" for folder in ALLOW), str(FLEET.path)]
MADE_BY = made_by()


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
        made_by=MADE_BY,
    shell:
        "{COMMAND:q} report {TOLD:q}"


rule calibrate:
    output:
        "outcomes/{robot}.json",
    params:
        made_by=MADE_BY,
        state=lambda wildcards: input_state(FLEET.robot(wildcards.robot)),
        minutes=FLEET.file.fleet.minutes_per_robot,
    retries: RETRIES
    resources:
        attempt=lambda wildcards, attempt: attempt,
    shell:
        "{COMMAND:q} work {TOLD:q} --minutes {params.minutes} --attempt {resources.attempt} {wildcards.robot:q}"
