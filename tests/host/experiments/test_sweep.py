"""A sweep: one row for each run, kept as it ends, and the same again."""

import errno
import multiprocessing
import os
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from datetime import date
from math import inf, nan
from pathlib import Path

import pandas
import pytest

import mdms_array as mdms
from mdms_array.experiments import execution
from mdms_array.experiments import sweep as sweeps
from mdms_array.experiments.journal import WALL_CLOCK, Journal, write_tables
from mdms_array.experiments.measures import NAMED
from mdms_array.experiments.settings import uniform
from mdms_model.scenario.file import read_tree

ROW = read_tree("paper-fig7") | {"run": {"duration_s": 0.2, "fidelity": "row"}}
# By this, runs of a row have seeds.
ROW["cell"] = ROW.get("cell", {}) | {"motor_spread": 0.01}
OVER = {"cell.friction": [0.2, 0.3], "motion.speed_m_s": [0.02, 0.04]}


def end_m(run):
    return run.parcels["box"].true_pose[0]


FACTOR = 1.0


class Scale:
    """Scales by a factor of the module, and by one of its own."""

    own = 1.0

    def of(self, value):
        return FACTOR * self.own * value

    def end_m(self, run):
        return self.of(end_m(run))


def scaled_m(run):
    return Scale().of(end_m(run))


def fails_at_02(run):
    if run.scenario.cell.friction == 0.2:
        raise ZeroDivisionError("on purpose")
    return 1.0


def a_list(_run):
    return [1.0]


def not_a_number(_run):
    return nan


async def wait(table):
    await table.sleep(0.1)


def test_a_sweep_has_a_row_for_each_setting_and_seed(executor):
    seen = []
    result = mdms.sweep(
        ROW, OVER, seeds=2, measures=["time_s", end_m], executor=executor, progress=seen.append
    )
    frame = result.frame
    assert len(frame) == 8
    assert [*frame["row"]] == [*range(1, 9)]
    # All settings see the same seeds.
    assert [*frame["seed"]] == 4 * [mdms.run_seed(1, 0), mdms.run_seed(1, 1)]
    assert frame["key"].nunique() == 8
    # All wheels roll, so that friction changes nothing.
    assert frame["record_sha256"].nunique() == 4
    assert frame["end_m"].nunique() == 4
    assert frame["log_sha256"].isna().all()
    assert {"revision", "mdms_version", "numba_version", *WALL_CLOCK} <= {*frame.columns}
    assert [state.done for state in seen] == [*range(9)]
    assert seen[-1].total == 8
    assert seen[-1].left_s == pytest.approx(0.0)


def test_a_row_is_the_run_that_anybody_simulates(executor):
    tree = read_tree("array18") | {"run": {"duration_s": 0.5, "fidelity": "firmware"}}
    result = mdms.sweep(
        tree, {"cell.friction": [0.25]}, seeds=[3], measures=sorted(NAMED), executor=executor
    )
    assert result.meanings == {"cell.friction": "truth and belief"}
    (row,) = result.rows
    tree["cell"] |= {"friction": 0.25}
    tree["run"] |= {"seed": 3}
    run = mdms.simulate(tree)
    assert row["log_sha256"] == run.log_sha256
    assert row["status"] == run.status == "time limit"
    assert row["time_s"] == 0.5
    assert row["energy_j"] > 0.0
    assert row["bus_load"] == run.bus.load
    assert row["position_error_m"] == pytest.approx(0.2, abs=0.02)


def test_a_finished_run_is_not_run_again(executor, tmp_path):
    first = mdms.sweep(ROW, OVER, seeds=1, executor=executor, folder=tmp_path / "s")
    seen = []
    again = mdms.sweep(
        ROW, OVER, seeds=2, executor=executor, folder=tmp_path / "s", progress=seen.append
    )
    assert (seen[0].kept, seen[-1].done) == (4, 8)
    kept = [row for row in again.rows if row["replication"] == 0]
    assert [row["started"] for row in kept] == [row["started"] for row in first.rows]
    frame = pandas.read_parquet(tmp_path / "s" / "table.parquet")
    assert frame.equals(again.frame)
    assert len(pandas.read_csv(tmp_path / "s" / "table.csv")) == 8


def test_a_run_is_run_again_if_its_measure_uses_another_value(executor, tmp_path, monkeypatch):
    given = {"seeds": 1, "measures": [scaled_m], "executor": executor, "folder": tmp_path}
    (before,) = mdms.sweep(ROW, {"cell.friction": [0.3]}, **given).rows
    (same,) = mdms.sweep(ROW, {"cell.friction": [0.3]}, **given).rows
    assert same == before
    monkeypatch.setitem(globals(), "FACTOR", 2.0)
    (after,) = mdms.sweep(ROW, {"cell.friction": [0.3]}, **given).rows
    assert after["scaled_m"] == 2.0 * before["scaled_m"]


def test_a_run_that_raises_is_a_row(executor):
    over = {"cell.friction": [0.2, 0.3], "parcel.box.mass_kg": [2.0, -1.0]}
    measures = [end_m, fails_at_02]
    rows = mdms.sweep(ROW, over, seeds=1, measures=measures, executor=executor).rows
    too_light = "must be above 0 and at least 1e-06 and at most 1e+06"
    assert [row["failure"] for row in rows] == [
        "ZeroDivisionError: on purpose",
        f"ScenarioError: parcel.0.mass_kg is -1.0, but {too_light}",
        None,
        f"ScenarioError: parcel.0.mass_kg is -1.0, but {too_light}",
    ]
    assert [row["fails_at_02"] for row in rows] == [None, None, 1.0, None]
    # Those that were measured before the failing one do not count either.
    assert [row["end_m"] is None for row in rows] == [True, True, False, True]


def no_memory(_run):
    raise MemoryError("none is left")


def test_a_failure_of_the_machine_is_run_again_and_one_of_the_run_stays(executor, tmp_path):
    given = {"seeds": 1, "executor": executor, "folder": tmp_path / "s", "records": True}
    over = {"cell.friction": [0.2, 0.3]}
    (tmp_path / "s").mkdir()
    mdms.sweep(ROW, {"cell.friction": [0.4]}, **{**given, "records": False})
    (tmp_path / "s" / "records").touch()
    failed = mdms.sweep(ROW, over, measures=[fails_at_02], **given)
    assert failed.failed == 2
    assert "cannot be made: Not a directory" in failed.rows[1]["failure"]
    assert "of_machine" not in failed.rows[1]
    (tmp_path / "s" / "records").unlink()
    seen = []
    mended = mdms.sweep(ROW, over, measures=[fails_at_02], progress=seen.append, **given)
    assert [row["failure"] for row in mended.rows] == ["ZeroDivisionError: on purpose", None]
    assert (seen[0].kept, seen[-1].done) == (0, 2)
    kept = mdms.sweep(ROW, over, measures=[fails_at_02], **given)
    assert kept.rows == mended.rows


def test_a_measure_without_memory_is_run_again(executor, tmp_path):
    given = {"seeds": 1, "executor": executor, "folder": tmp_path, "measures": [no_memory]}
    seen = []
    for _ in range(2):
        result = mdms.sweep(ROW, {"cell.friction": [0.2]}, progress=seen.append, **given)
        assert result.rows[0]["failure"] == "MemoryError: none is left"
    assert [state.kept for state in seen] == 4 * [0]


def no_file(_run):
    return float(Path("/nowhere/reference.csv").read_text())


def no_file_told(run):
    try:
        return no_file(run)
    except OSError as error:
        raise mdms.InputError("the measure needs /nowhere/reference.csv") from error


@pytest.mark.parametrize("measure", [no_file, no_file_told])
def test_a_measure_whose_own_file_is_missing_is_not_run_again(measure, executor, tmp_path):
    given = {"seeds": 1, "executor": executor, "folder": tmp_path, "measures": [measure]}
    failed = mdms.sweep(ROW, {"cell.friction": [0.2]}, **given)
    assert "/nowhere/reference.csv" in failed.rows[0]["failure"]
    seen = []
    again = mdms.sweep(ROW, {"cell.friction": [0.2]}, progress=seen.append, **given)
    assert again.rows == failed.rows
    assert [state.kept for state in seen] == [1]


def leaves(_run):
    raise SystemExit(0)


def test_a_measure_that_ends_its_process_is_a_failed_run(executor):
    result = mdms.sweep(ROW, OVER, seeds=1, measures=[leaves], executor=executor)
    assert result.failed == len(result.rows) == 4
    assert result.rows[0]["failure"] == "SystemExit: 0"


def too_large(_run):
    return 1 << 63


def without_end(_run):
    return inf


def near_the_end(_run):
    return -1e308


def no_letter(_run):
    return "a\udc80"


def fails_without_letter(_run):
    raise ValueError("b\udc80")


def test_values_that_no_table_holds_end_no_sweep(executor, tmp_path):
    result = mdms.sweep(
        ROW, {"cell.friction": [0.3]}, seeds=1, measures=[no_letter], executor=executor
    )
    assert result.rows[0]["no_letter"] == r"a\udc80"
    given = {"seeds": 1, "executor": executor, "folder": tmp_path}
    for measure, told in (
        (too_large, "gave a whole number of 64 bits and a sign, but a table has 64 in all"),
        (without_end, "gave inf, of which there is no mean; give a finite number, or None"),
        (near_the_end, "gave -1e+308, but at most 1e+100 has a mean and an axis; give it in"),
        (fails_without_letter, r"ValueError: b\udc80"),
    ):
        result = mdms.sweep(ROW, {"cell.friction": [0.3]}, measures=[measure], **given)
        assert told in pandas.read_parquet(tmp_path / "table.parquet")["failure"][0]
        assert result.failed == 1


def test_a_measure_gives_one_value(executor):
    (row,) = mdms.sweep(
        ROW, {"cell.friction": [0.3]}, seeds=1, measures=[a_list], executor=executor
    ).rows
    assert "measure a_list gave list, but must give a number" in row["failure"]
    (row,) = mdms.sweep(
        ROW,
        {"cell.friction": [0.3]},
        seeds=1,
        measures=[not_a_number, "parcels.0.x_m", "parcels.7.x_m"],
        executor=executor,
    ).rows
    assert row["not_a_number"] is row["parcels.7.x_m"] is None
    assert row["parcels.0.x_m"] < 0.0


def test_a_program_is_swept(executor):
    tree = read_tree("array18") | {"run": {"duration_s": 2.0, "fidelity": "firmware"}}
    (row,) = mdms.sweep(
        tree, {"cell.friction": [0.3]}, seeds=1, program=wait, executor=executor
    ).rows
    assert (row["failure"], row["status"]) == (None, "reached")


def test_another_checkout_is_refused_or_marked(executor, tmp_path, monkeypatch):
    def swept(seeds, **more):
        return mdms.sweep(ROW, OVER, seeds=seeds, executor=executor, folder=tmp_path / "s", **more)

    def change(revision):
        for module in (sweeps, execution):
            monkeypatch.setattr(module, "code_revision", lambda: revision)

    change("aaaa")
    swept(1)
    change("bbbb")
    with pytest.raises(mdms.InputError, match=r"revision aaaa, but the code is of bbbb; mark"):
        swept(2)
    rows = swept(2, on_changed="mark").rows
    assert [row["changed"] for row in rows] == 4 * [True, False]
    assert [row["revision"] for row in rows] == 4 * ["aaaa", "bbbb"]


def test_a_worker_with_other_code_ends_the_sweep(executor, monkeypatch):
    monkeypatch.setattr(execution, "code_revision", lambda: "cccc")
    with pytest.raises(
        mdms.Error, match=r"runs code of revision cccc, but here it is \w{16}; inst"
    ):
        mdms.sweep(ROW, OVER, seeds=1, executor=executor)


def test_an_ended_sweep_keeps_its_finished_runs(executor, tmp_path):
    def end(state):
        if state.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mdms.sweep(ROW, OVER, seeds=2, executor=executor, folder=tmp_path / "s", progress=end)
    assert len(pandas.read_csv(tmp_path / "s" / "table.csv")) == 3
    seen = []
    mdms.sweep(ROW, OVER, seeds=2, executor=executor, folder=tmp_path / "s", progress=seen.append)
    assert (seen[0].kept, seen[-1].done) == (3, 8)


def test_a_run_that_the_journal_has_is_in_the_table_if_ctrl_c_comes_between(
    executor, tmp_path, monkeypatch
):
    add, seen = Journal.add, []

    def add_and_end(self, *run):
        add(self, *run)
        if seen[-1].done == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(Journal, "add", add_and_end)
    with pytest.raises(KeyboardInterrupt):
        mdms.sweep(ROW, OVER, seeds=2, executor=executor, folder=tmp_path, progress=seen.append)
    assert len(pandas.read_csv(tmp_path / "table.csv")) == seen[-1].done == 3


def test_a_run_that_is_counted_is_reported_if_ctrl_c_comes_between(executor, tmp_path, monkeypatch):
    class Ending:
        def now_s(self):
            raise KeyboardInterrupt

    monkeypatch.setattr(sweeps, "MonotonicClock", Ending)
    seen = []
    with pytest.raises(KeyboardInterrupt):
        mdms.sweep(ROW, OVER, seeds=2, executor=executor, folder=tmp_path, progress=seen.append)
    assert len(pandas.read_csv(tmp_path / "table.csv")) == seen[-1].done == 2


def kept_friction(result):
    """The friction of each row, and that of the run which is kept under its key."""
    rows = [
        (row["cell.friction"], result.folder / "records" / row["key"][:16]) for row in result.rows
    ]
    return [(friction, mdms.read_run(kept).scenario.cell.friction) for friction, kept in rows]


def test_records_are_kept_if_they_are_asked_for(executor, tmp_path):
    # No name in UTF-8.
    folder = tmp_path / os.fsdecode(b"\xe4")
    result = mdms.sweep(
        ROW, {"cell.friction": [0.3]}, seeds=1, executor=executor, folder=folder, records=True
    )
    assert kept_friction(result) == [(0.3, 0.3)]


def test_records_are_those_of_their_rows_after_a_sweep_has_grown(executor, tmp_path):
    given = {"seeds": 1, "executor": executor, "folder": tmp_path}
    mdms.sweep(ROW, {"cell.friction": [0.2, 0.3]}, records=True, **given)
    grown = mdms.sweep(ROW, {"cell.friction": [0.1, 0.2, 0.3]}, records=True, **given)
    assert kept_friction(grown) == [(0.1, 0.1), (0.2, 0.2), (0.3, 0.3)]


def test_a_run_that_was_kept_without_its_record_gets_one(executor, tmp_path):
    given = {"seeds": 1, "executor": executor, "folder": tmp_path}
    seen = []
    before = mdms.sweep(ROW, {"cell.friction": [0.2, 0.3]}, **given)
    after = mdms.sweep(
        ROW, {"cell.friction": [0.2, 0.3]}, records=True, progress=seen.append, **given
    )
    assert kept_friction(after) == [(0.2, 0.2), (0.3, 0.3)]
    assert after.rows == before.rows
    assert (seen[0].kept, seen[-1].done, seen[-1].total) == (0, 2, 2)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"over": {"cell.fricton": [0.3]}}, "no setting can be run: cell.fricton is not a known"),
        ({"over": {"cell.friction": [0.2, date(2024, 1, 1)]}}, r"friction has datetime.date\(2024"),
        ({"over": {"cell.friction": [0.2, [date(2024, 1, 1)]]}}, r"friction has \[datetime.date"),
        ({"over": {"parcel.box.name": ["a", "b\udc80"]}}, r"name has 'b\\udc80', which no table"),
        ({"over": {"cell.friction": [0.2, 1 << 63]}}, "has 9223372036854775808, which no table"),
        ({"measures": ["speed"]}, "'speed' is unknown; there are reached, time_s"),
        ({"measures": [lambda run: 1.0]}, "cannot be sent to a worker"),
        ({"measures": [Scale().end_m]}, "cannot be sent to a worker"),
        ({"measures": ["reached", "reached"]}, "reached stands there twice"),
        ({"scenario": 3}, "neither a name, a file, a dict nor a Scenario"),
        ({"scenario": "fig70"}, "no such scenario file"),
        ({"workers": 2}, "the executor that is given has its own"),
        ({"executor": 3}, "executor is 3, but must be an executor of `concurrent.futures`, such"),
        ({"executor": ThreadPoolExecutor}, "executor is <class 'concurrent.futures.thread.Thread"),
        ({"folder": 5}, "folder is 5, but must be a path, as text or a Path"),
        ({"progress": "x"}, "progress is 'x', but must be a function of a Progress"),
        ({"on_changed": "maybe"}, "on_changed is 'maybe'"),
        ({"records": True}, "no folder to keep them in"),
        ({"program": end_m}, "is not `async def program"),
    ],
)
def test_an_impossible_sweep_is_refused(change, told, executor):
    arguments = {"scenario": ROW, "over": OVER, "seeds": 1, "executor": executor} | change
    with pytest.raises(mdms.InputError, match=told):
        mdms.sweep(**arguments)


def test_folders_of_others_are_left_alone(executor, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    told = "holds files but no journal.sqlite; give a new folder$"
    with pytest.raises(mdms.InputError, match=told):
        mdms.sweep(ROW, OVER, seeds=1, executor=executor, folder=tmp_path)
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "journal.sqlite").write_text("no database at all" * 100)
    with pytest.raises(mdms.InputError, match="cannot be used as a journal"):
        mdms.sweep(ROW, OVER, seeds=1, executor=executor, folder=tmp_path / "s")
    other = sqlite3.connect(tmp_path / "s2.sqlite")
    other.execute("PRAGMA user_version=9")
    other.close()
    (tmp_path / "s2").mkdir()
    (tmp_path / "s2.sqlite").rename(tmp_path / "s2" / "journal.sqlite")
    with pytest.raises(mdms.InputError, match="in format 9, but this version reads 1"):
        mdms.sweep(ROW, OVER, seeds=1, executor=executor, folder=tmp_path / "s2")


def write_often(folder):
    for _ in range(60):
        write_tables(folder, [{"row": row} for row in range(200)])


def test_two_sweeps_write_their_tables_into_one_folder_at_once(tmp_path):
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=write_often, args=(tmp_path,)) for _ in range(2)]
    for each in writers:
        each.start()
    for each in writers:
        each.join()
    assert [each.exitcode for each in writers] == [0, 0]
    assert {path.name for path in tmp_path.iterdir()} == {"table.csv", "table.parquet"}


def full(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("name", ["csv", "parquet"])
def test_a_table_on_a_full_disk_is_named(name, tmp_path, monkeypatch):
    monkeypatch.setattr(pandas.DataFrame, f"to_{name}", full)
    told = f"{tmp_path}/table.{name}: cannot be written: No space left on device; the same"
    with pytest.raises(mdms.Error, match=told):
        write_tables(tmp_path, [{"row": 1}])


def test_a_journal_on_a_full_disk_is_named(executor, tmp_path, monkeypatch):
    opened = Journal.__init__

    def open_full(self, path):
        opened(self, path)
        pages = self._file.execute("PRAGMA page_count").fetchone()[0]
        self._file.execute(f"PRAGMA max_page_count={pages}")

    monkeypatch.setattr(Journal, "__init__", open_full)
    told = f"{tmp_path}/journal.sqlite: the journal cannot be written: database or disk is full"
    with pytest.raises(mdms.Error, match=told):
        mdms.sweep(ROW, OVER, seeds=9, executor=executor, folder=tmp_path)


def test_a_damaged_journal_is_named(executor, tmp_path):
    given = {"seeds": 1, "executor": executor, "folder": tmp_path}
    mdms.sweep(ROW, OVER, **given)
    journal = tmp_path / "journal.sqlite"
    whole = journal.read_bytes()
    # The head is whole, as after a disk that has lost the rest.
    journal.write_bytes(whole[:4096] + bytes(len(whole) - 4096))
    with pytest.raises(mdms.InputError, match=r"journal.sqlite: the journal is damaged: database"):
        mdms.sweep(ROW, OVER, **given)


def test_a_sample_has_the_same_row_whatever_runs_it(executor):
    over = {"motion.speed_m_s": uniform(0.02, 0.06)}
    rows = [mdms.sweep(ROW, over, seeds=1, samples=3, executor=executor).rows for _ in range(2)]
    first, second = (
        [{name: row[name] for name in row if name not in WALL_CLOCK} for row in each]
        for each in rows
    )
    assert first == second
