"""The packages that the host's core needs on its machine, and the dependencies of its modules."""

import json
import pkgutil
import subprocess
import sys

import pytest

import mdms_host

FORBIDDEN = {"mdms_sim", "mdms_cell", "numba", "matplotlib"}
CORE = sorted(
    module.name
    for module in pkgutil.walk_packages(mdms_host.__path__, "mdms_host.")
    if not module.name.startswith(("mdms_host.cli", "mdms_host.page.simulated"))
)


def imported_by(modules: list[str], missing: tuple[str, ...] = ()) -> set[str]:
    """Top-level packages that a fresh interpreter without some has imported after these modules."""
    script = (
        "import sys, json, importlib; "
        f"sys.modules.update(dict.fromkeys({missing!r})); "
        f"[importlib.import_module(name) for name in {modules!r}]; "
        "print(json.dumps(sorted(name for name in sys.modules if sys.modules[name])))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    return {name.partition(".")[0] for name in json.loads(done.stdout)}


def test_core_needs_neither_simulator_nor_cell_nor_compiler():
    assert len(CORE) > 30
    # Routes are compiled where numba is installed, and found without it too.
    assert imported_by(CORE, missing=("numba",)).isdisjoint(FORBIDDEN)


@pytest.mark.parametrize("package", ["estimation", "motion", "coordination"])
def test_deciding_packages_need_no_bus_library(package):
    modules = [name for name in CORE if name.startswith(f"mdms_host.{package}.")]
    modules = [name for name in modules if not name.endswith((".operation", ".other_host"))]
    assert imported_by(modules).isdisjoint({"can", "canopen", "serial", "rich"})


def test_a_stop_waits_for_no_compiler():
    """Loading it takes as long as all else before the first frame of `mdms stop`."""
    stop = ["mdms_host.cli.array.cells"]
    assert imported_by(stop).isdisjoint(FORBIDDEN)
    served = imported_by([*stop, "mdms_sim.serve.python_can"])
    assert served.isdisjoint(FORBIDDEN - {"mdms_sim"})


#: Verbs for a table of real cells, and their reading of a scenario.
HARDWARE = sorted(
    module.name
    for module in pkgutil.walk_packages(mdms_host.__path__, "mdms_host.")
    if module.name.startswith(
        ("mdms_host.cli.array", "mdms_host.cli.cells.configure_", "mdms_host.cli.stored_run")
    )
)


def test_verbs_on_hardware_need_neither_simulator_nor_extras():
    assert {"mdms_host.cli.array.run"} <= {*HARDWARE}
    script = (
        "import sys, importlib; "
        f"sys.modules.update(dict.fromkeys({sorted(FORBIDDEN)!r})); "
        f"[importlib.import_module(name) for name in {HARDWARE!r}]"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
