"""The array in Python: simulate a scenario, drive a table by hand, connect to a real one.

>>> import mdms_array as mdms
>>> run = mdms.simulate("array18", limit_s=3.0)
>>> run.status
'reached'
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mdms_array.connection import connect as connect
    from mdms_array.experiments.settings import Distribution as Distribution
    from mdms_array.experiments.settings import integers as integers
    from mdms_array.experiments.settings import log_uniform as log_uniform
    from mdms_array.experiments.settings import run_seed as run_seed
    from mdms_array.experiments.settings import uniform as uniform
    from mdms_array.experiments.sweep import Progress as Progress
    from mdms_array.experiments.sweep import SweepResult as SweepResult
    from mdms_array.experiments.sweep import sweep as sweep
    from mdms_array.run import FailedError as FailedError
    from mdms_array.run import FaultError as FaultError
    from mdms_array.run import Incident as Incident
    from mdms_array.run import LostError as LostError
    from mdms_array.run import ParcelRun as ParcelRun
    from mdms_array.run import Run as Run
    from mdms_array.run import RunError as RunError
    from mdms_array.run import StoppedError as StoppedError
    from mdms_array.run import TimeLimitError as TimeLimitError
    from mdms_array.run import ViolationError as ViolationError
    from mdms_array.run import WheelRun as WheelRun
    from mdms_array.simulation import simulate as simulate
    from mdms_array.simulation import virtual as virtual
    from mdms_array.table import BlockingParcel as BlockingParcel
    from mdms_array.table import BlockingTable as BlockingTable
    from mdms_host.programs import tasks as tasks
    from mdms_host.programs.table import Newcomer as Newcomer
    from mdms_host.programs.table import ProgramError as ProgramError
    from mdms_host.programs.table import Table as Table
    from mdms_host.programs.table import TableParcel as TableParcel
    from mdms_model.errors import Error as Error
    from mdms_model.errors import InputError as InputError
    from mdms_model.run.folder import StoredRun as StoredRun
    from mdms_model.run.folder import read_run as read_run
    from mdms_model.run.folder import write_run as write_run

#: Each name is imported when it is first used: the simulator takes half a second.
_NAMES = {
    "mdms_array.connection": ("connect",),
    "mdms_array.experiments.settings": (
        *("Distribution", "integers", "log_uniform", "run_seed", "uniform"),
    ),
    "mdms_array.experiments.sweep": ("Progress", "SweepResult", "sweep"),
    "mdms_array.run": (
        *("FailedError", "FaultError", "Incident", "LostError", "ParcelRun", "Run", "RunError"),
        *("StoppedError", "TimeLimitError", "ViolationError", "WheelRun"),
    ),
    "mdms_array.simulation": ("simulate", "virtual"),
    "mdms_array.table": ("BlockingParcel", "BlockingTable"),
    "mdms_host.programs.table": ("Newcomer", "ProgramError", "Table", "TableParcel"),
    "mdms_model.errors": ("Error", "InputError"),
    "mdms_model.run.folder": ("StoredRun", "read_run", "write_run"),
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = [
    "BlockingParcel",
    "BlockingTable",
    "Distribution",
    "Error",
    "FailedError",
    "FaultError",
    "Incident",
    "InputError",
    "LostError",
    "Newcomer",
    "ParcelRun",
    "ProgramError",
    "Progress",
    "Run",
    "RunError",
    "StoppedError",
    "StoredRun",
    "SweepResult",
    "Table",
    "TableParcel",
    "TimeLimitError",
    "ViolationError",
    "WheelRun",
    "connect",
    "integers",
    "log_uniform",
    "read_run",
    "run_seed",
    "simulate",
    "sweep",
    "tasks",
    "uniform",
    "virtual",
    "write_run",
]


def __getattr__(name: str) -> Any:
    if name == "tasks":
        return import_module("mdms_host.programs.tasks")
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return list(__all__)
