"""The commands of the command line, by topic: thin layers over the functions of the Python interface."""

from __future__ import annotations

from calflow.commands.apply import compensate_command, export_command, filter_command, predict_command
from calflow.commands.check import check_command, check_poses_command, drift_command, validate_command
from calflow.commands.detecting import detect_command
from calflow.commands.fleet import fleet_command
from calflow.commands.importing import import_command
from calflow.commands.run import doctor_command, plan_command, report_command, run_command, status_command
from calflow.commands.runs import compare_command, history_command, pack_command, reproduce_command
from calflow.commands.study import new_command, next_command, schema_command, simulate_command

COMMANDS = (
    new_command,
    import_command,
    detect_command,
    check_command,
    plan_command,
    run_command,
    status_command,
    report_command,
    simulate_command,
    predict_command,
    compensate_command,
    export_command,
    filter_command,
    validate_command,
    check_poses_command,
    drift_command,
    compare_command,
    history_command,
    fleet_command,
    reproduce_command,
    pack_command,
    schema_command,
    doctor_command,
    next_command,
)
