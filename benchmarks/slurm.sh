#!/bin/bash
# A fleet on SLURM: one node of Debian's package, set up in a folder of its own, and 20 small robots through Snakemake's executor.
#
#   benchmarks/slurm.sh [ROBOTS] [FOLDER]      (20 robots, a new folder below /tmp)
#
# Run it as root in a container: it installs slurm-wlm and munge where they lack, starts their daemons without systemd and cgroups,
# and takes them and their /etc/slurm/slurm.conf away when it is done. Needs `pip install -e '.[fleet]' snakemake-executor-plugin-slurm`.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
robots=${1:-20}
folder=$(realpath "${2:-$(mktemp -d /tmp/fleet-slurm.XXXX)}")
node=$(hostname -s)
cores=$(nproc)

if ! command -v slurmctld munged >/dev/null; then
    apt-get update -q
    apt-get install -y -q slurm-wlm munge
fi

conf=/etc/slurm/slurm.conf # jobs that jobs start do not know of another place
if [ -e $conf ]; then
    echo "$conf is there: this machine has a SLURM already, which this script would disturb" >&2
    exit 2
fi
started=()
cleanup() {
    for pid in "${started[@]}"; do kill "$pid" 2>/dev/null || true; done
    rm -f $conf
}
trap cleanup EXIT

mkdir -p "$folder/slurm/state" "$folder/slurm/spool" /run/munge
cat >$conf <<END
ClusterName=one
SlurmctldHost=$node
SlurmUser=root
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
MinJobAge=600
StateSaveLocation=$folder/slurm/state
SlurmdSpoolDir=$folder/slurm/spool
SlurmctldPidFile=$folder/slurm/slurmctld.pid
SlurmdPidFile=$folder/slurm/slurmd.pid
SlurmctldLogFile=$folder/slurm/slurmctld.log
SlurmdLogFile=$folder/slurm/slurmd.log
NodeName=$node CPUs=$cores RealMemory=2000 State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
END

if ! munge -n 2>/dev/null | unmunge >/dev/null 2>&1; then
    chown munge: /run/munge
    runuser -u munge -- /usr/sbin/munged --foreground &
    started+=($!)
    sleep 1
fi
slurmctld -D 2>/dev/null &
started+=($!)
slurmd -D 2>/dev/null &
started+=($!)
for _ in $(seq 30); do
    [ "$(sinfo --noheader --format=%T 2>/dev/null)" = idle ] && break
    sleep 1
done
sinfo

cd "$here"
python - "$folder/plant" "$robots" <<END
import sys
from pathlib import Path

import numpy as np
from fleet import built

built(Path(sys.argv[1]), int(sys.argv[2]), "identify", np.random.default_rng(1))
END

mkdir -p "$folder/profile"
cat >"$folder/profile/config.yaml" <<END
executor: slurm
jobs: 10
slurm-status-command: squeue
slurm-no-account: true
slurm-keep-successful-logs: true
slurm-init-seconds-before-status-checks: 5
latency-wait: 10
default-resources:
  slurm_partition: main
  runtime: 30
  mem_mb: 500
END

code=0
calflow fleet run "$folder/plant/fleet.toml" --out "$folder/out" --batch 5 --profile "$folder/profile" || code=$?
grep -E "submitted|Finished jobid|SLURM run ID" "$folder/out/snakemake.log"
echo "calflow fleet run ended with $code; all is in $folder"
exit $code
