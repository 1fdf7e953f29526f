"""Compiled functions: kept between processes, renewed with their sources, plain without numba."""

import fcntl
import gc
import json
import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from mdms_model import compiled as module
from mdms_model.compiled import COMPILING, borrowed, compiled, for_types_of
from mdms_model.errors import Error

needs_numba = pytest.mark.skipif(not COMPILING, reason="nothing is compiled")

INNER = """
from mdms_model.compiled import compiled

@compiled
def one(x):
    return x * {factor}
"""
OUTER = """
from mdms_model.compiled import compiled
from mdms_probe_inner import one

@compiled
def twice(x):
    return 2 * one(x)
"""
MAIN = """
import sys
from mdms_probe_outer import twice
print([twice(eval(text)) for text in sys.argv[1:]])
print(sum(twice.stats.cache_misses.values()), "compiled")
"""


@pytest.fixture
def probe(tmp_path):
    """Two modules, one of which calls the other, and processes that run them."""
    (tmp_path / "mdms_probe_inner.py").write_text(INNER.format(factor=1))
    (tmp_path / "mdms_probe_outer.py").write_text(OUTER)
    environment = os.environ | {
        "PYTHONPATH": str(tmp_path),
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
    }

    def start(*arguments, code=MAIN):
        return subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )

    return start


def said(process):
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    return output.splitlines()[-2:]


@contextmanager
def taken(folder):
    """Another process compiles functions of the folder's module."""
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@needs_numba
def test_processes_compile_a_module_one_after_the_other_and_another_beside(probe, tmp_path):
    assert said(probe("1")) == ["[2]", "1 compiled"]
    (folder,) = (tmp_path / "cache").glob("mdms_probe_outer-*")
    (inner,) = (tmp_path / "cache").glob("mdms_probe_inner-*")
    kept = set(folder.rglob("*"))
    with taken(folder):
        one, other = probe("2.5"), probe("2.5", "1j")
        with pytest.raises(subprocess.TimeoutExpired):
            one.wait(1.0)
        assert set(folder.rglob("*")) == kept
        code = "from mdms_probe_inner import one; print(one(3j))"
        assert said(probe(code=code)) == ["3j"]
        assert len(list(inner.rglob("*.nbc"))) == 2
    one, other = said(one), said(other)
    assert (one[0], other[0]) == ("[5.0]", "[5.0, 2j]")
    assert sorted((one[1], other[1])) in (["0 compiled", "2 compiled"], ["1 compiled"] * 2)
    assert said(probe("1", "2.5", "1j")) == ["[2, 5.0, 2j]", "0 compiled"]


@needs_numba
def test_a_folder_that_takes_no_code_is_named_with_the_way_out(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setattr(module.numba.config, "CACHE_DIR", str(tmp_path / "file" / "cache"))
    told = "cache: compiled code cannot be kept there: Not a directory; set NUMBA_CACHE_DIR to a"
    with pytest.raises(Error, match=told):
        module.is_kept("mdms_model.errors")


@needs_numba
def test_a_change_in_another_module_is_noticed_and_code_of_older_sources_goes(probe, tmp_path):
    assert said(probe("1")) == ["[2]", "1 compiled"]
    (old,) = (tmp_path / "cache").glob("mdms_probe_outer-*")
    os.utime(old, (old.stat().st_mtime - module.KEPT_S - 60,) * 2)
    # Another length too: Python takes a file of the same second and length for the same.
    (tmp_path / "mdms_probe_inner.py").write_text(INNER.format(factor=50))
    assert said(probe("1")) == ["[100]", "1 compiled"]
    (new,) = (tmp_path / "cache").glob("mdms_probe_outer-*")
    assert new != old


@needs_numba
def test_a_change_after_a_module_was_loaded_leaves_no_older_code_as_newer(probe, tmp_path):
    inner = tmp_path / "mdms_probe_inner.py"
    changed = f"open({str(inner)!r}, 'w').write({INNER.format(factor=50)!r})"
    assert said(probe("1", code=f"import mdms_probe_inner; {changed}{MAIN}"))[0] == "[2]"
    assert said(probe("1"))[0] == "[100]"


LOADS = """
import json
import numpy as np
from mdms_model.compiled import COMPILING
from mdms_model.statics.limits import parcel_limits
from mdms_model.statics.normal_bounds import centred_normal_n
from mdms_model.scenario.file import load_scenario
from mdms_model.statics.supports import press
box = load_scenario("array18", ["parcel.0.centre_of_mass_m=[0.02, 0.01]"])
row = load_scenario("paper-fig7", ["parcel.0.centre_of_mass_m=[0.02, 0.0]"])
loads = np.zeros(9)
press(np.random.default_rng(1).uniform(-0.2, 0.3, (9, 2)), 20.0, loads)
found = parcel_limits(row, row.parcel[0])
print(json.dumps([COMPILING, *loads, centred_normal_n(box, box.parcel[0]), found.supports_max,
                  found.normal_min_n, found.normal_max_n]))
"""


@needs_numba
def test_the_model_gives_the_same_without_numba(capsys):
    without = f"import sys\nsys.modules['numba'] = None\n{LOADS}"
    done = subprocess.run(
        [sys.executable, "-c", without], capture_output=True, text=True, check=True
    )
    exec(LOADS, {})
    (plain, *loads), (compiles, *compiled_loads) = map(
        json.loads, (done.stdout, capsys.readouterr().out)
    )
    assert (plain, compiles) == (False, True)
    assert loads == pytest.approx(compiled_loads, rel=1e-12)


@compiled
def total(values):
    result = 0.0
    for value in values:
        result += value
    return result


@needs_numba
def test_garbage_is_looked_for_again_after_a_compilation_though_it_failed():
    def no_sum(x):
        return x + "1"

    from numba import TypingError

    assert compiled(lambda x: x + 1)(1) == 2
    assert gc.isenabled()
    with pytest.raises(TypingError):
        compiled(no_sum)(1)
    assert gc.isenabled()


def test_code_for_given_types_gives_the_result_of_the_function():
    quick = for_types_of(total, np.zeros(3))
    assert quick(np.array([1.0, 2.0, 3.5])) == total(np.array([1.0, 2.0, 3.5])) == 6.5


@needs_numba
def test_code_for_given_types_refuses_others():
    with pytest.raises(TypeError):
        for_types_of(total, np.zeros(3))([1.0, 2.0])


@needs_numba
def test_a_wait_for_another_process_is_told_as_an_event(tmp_path, monkeypatch):
    from numba.core.event import Listener, install_listener

    # A folder of its own: another worker of these tests may be compiling this module.
    monkeypatch.setattr(module, "_folder", lambda _: tmp_path)
    own_total = compiled(total.py_func)
    told = []
    with (tmp_path / "lock").open("w") as lock:

        class Releasing(Listener):
            def on_start(self, _):
                told.append("waits")
                fcntl.flock(lock, fcntl.LOCK_UN)

            def on_end(self, _):
                told.append("goes on")

        fcntl.flock(lock, fcntl.LOCK_EX)
        with install_listener(module.WAITING, Releasing()):
            assert own_total(np.ones(2, np.int16)) == 2.0
            assert own_total(np.ones(2, np.int32)) == 2.0
    assert told == ["waits", "goes on"]


def test_a_module_depends_on_all_that_it_imports_of_ours():
    import mdms_sim.nodes.python_bank

    found = module.closure(mdms_sim.nodes.python_bank.__name__)
    assert {"mdms_cell.drive.speed_loop", "mdms_sim.bus.controller"} <= found
    assert all(Path(sys.modules[each].__file__).is_file() for each in found)


class Lent(NamedTuple):
    """A tuple in a tuple, with arrays and a number."""

    inner: tuple[np.ndarray, float]
    row: np.ndarray


@compiled
def add_to(lent, at):
    mine = borrowed(lent)
    mine.row[at] += mine.inner[0][at, 0] + mine.inner[1]
    return mine.row.size


def test_a_borrowed_array_is_the_callers_own():
    lent = Lent((np.array([[1.0], [2.0]]), 0.5), np.zeros(2))
    counts = sys.getrefcount(lent.row), sys.getrefcount(lent.inner[0])
    for _ in range(100):
        assert add_to(lent, 1) == 2
    assert lent.row.tolist() == [0.0, 250.0]
    assert (sys.getrefcount(lent.row), sys.getrefcount(lent.inner[0])) == counts


@compiled
def fill(row, value):
    for k in range(row.size):
        row[k] += value


@compiled
def fill_counted(rows):
    for k in range(rows.shape[0]):
        row = rows[k]
        if row[0] >= 0.0:
            fill(row, 1.0)


@compiled
def fill_borrowed(rows):
    lent = borrowed(rows)
    for k in range(lent.shape[0]):
        row = lent[k]
        if row[0] >= 0.0:
            fill(row, 1.0)


@needs_numba
@pytest.mark.parametrize(("function", "counts"), [(fill_counted, True), (fill_borrowed, False)])
def test_nobody_counts_the_users_of_borrowed_arrays(function, counts):
    rows = np.zeros((3, 2))
    function(rows)
    assert rows.tolist() == [[1.0, 1.0]] * 3
    # Code that an earlier run of the tests has kept shows nothing.
    function.recompile()
    (code,) = function.inspect_llvm().values()
    assert ("call void @NRT_decref" in code[: code.index("@_ZN7cpython")]) is counts
