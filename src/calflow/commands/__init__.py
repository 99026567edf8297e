"""Commands: one a file, a thin user of the same functions as Python's."""

from __future__ import annotations

from calflow.commands.check import check
from calflow.commands.check_poses import check_poses
from calflow.commands.compare import compare
from calflow.commands.compensate import compensate
from calflow.commands.doctor import doctor
from calflow.commands.drift import drift
from calflow.commands.export import export
from calflow.commands.filter import filter_targets
from calflow.commands.fleet import fleet
from calflow.commands.history import history
from calflow.commands.new import new
from calflow.commands.next import next_poses
from calflow.commands.pack import pack
from calflow.commands.plan import plan
from calflow.commands.predict import predict
from calflow.commands.report import report
from calflow.commands.reproduce import reproduce
from calflow.commands.run import run
from calflow.commands.schema import schema
from calflow.commands.simulate import simulate
from calflow.commands.status import status
from calflow.commands.validate import validate

COMMANDS = (
    new,
    check,
    plan,
    run,
    status,
    report,
    simulate,
    predict,
    compensate,
    export,
    filter_targets,
    validate,
    check_poses,
    drift,
    compare,
    history,
    fleet,
    reproduce,
    pack,
    schema,
    doctor,
    next_poses,
)
