"""The cases of a blind benchmark, by Snakemake: a job is a batch of them. The benchmark calls it itself.

What it is told, with --configfile: script, what, number and seed as on the benchmark's command line, and batch, the cases in a
job. A job draws all cases, as they follow from the seed, and works on its own.
"""

import sys
from pathlib import Path

from calflow.run_folder import code_digest, versions

SCRIPT = Path(config["script"])
JOBS = range(-(-config["number"] // config["batch"]))
PYTHON = sys.executable


localrules:
    all,


rule all:
    input:
        expand("job_{job}.json", job=JOBS),


rule work:
    input:
        SCRIPT,
        sorted(SCRIPT.parent.glob("blind_*.py")),
        sorted(SCRIPT.parents[1].glob("tests/hidden/*.py")),
    output:
        "job_{job}.json",
    params:
        made_by=[code_digest(), versions()],
        asked=[config["what"], config["number"], "--seed", config["seed"], "--batch", config["batch"]],
    retries: 1
    shell:
        "{PYTHON:q} {SCRIPT:q} {params.asked:q} --job {wildcards.job} --out {output:q}"
