"""What `import mdms_array as mdms` offers: runs, a table by hand, signals, errors."""

import json
import pickle
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from runpy import run_path

import numpy as np
import pytest

import mdms_array as mdms
from mdms_array.recording import provenance_of
from mdms_array.source import open_program
from mdms_host.cli.exits import ExitCode
from mdms_host.cli.simulation.simulate import verdict
from mdms_model.scenario.file import load_scenario, read_tree

EXAMPLES = Path(__file__).parents[3] / "examples"


async def no_table():
    pass


async def sorter(table):
    async for parcel in table.arrivals():
        code = await table.signal("scanner")
        table.start(parcel.leave("north" if code == "A" else None))


def test_a_run_has_one_status_and_poses_by_name():
    run = mdms.simulate("array18", limit_s=3.0)
    assert (run.status, run.reason) == ("reached", "")
    box = run.parcels["box"]
    assert box.reached
    assert box.true_pose == pytest.approx((0.1, 0.0, 0.5236), abs=5e-3)
    assert box.believed_pose == pytest.approx(box.true_pose, abs=5e-3)
    assert {len(column) for column in box.columns.values()} == {len(run.record.time_s)}
    assert run.wheels[18, 2].speed_m_s.shape == run.record.time_s.shape
    run.raise_for_status()
    again = pickle.loads(pickle.dumps(run))
    assert again.log_sha256 == run.log_sha256 == mdms.simulate("array18", limit_s=3.0).log_sha256


def test_a_run_with_too_little_time_raises_with_the_distance_left():
    run = mdms.simulate("array18", limit_s=0.8)
    assert run.status == "time limit"
    with pytest.raises(mdms.TimeLimitError, match=r"goal not reached: box is \d+") as raised:
        run.raise_for_status()
    assert raised.value.run is run


async def heeds_a_refusal(table):
    try:
        await table["box"].move(0.9, 0.0)
    except mdms.ProgramError:
        await table.sleep(0.1)


async def awaits_nothing(table):
    table.start(table["box"].move(0.1, 0.0))
    await table.sleep(0.1)


@pytest.mark.parametrize(
    ("program", "status"), [(heeds_a_refusal, "reached"), (awaits_nothing, "time limit")]
)
def test_a_program_that_ends_without_its_parcel_at_its_goal_breaks_no_rule(program, status):
    """A caught refusal is asked for no more. A task without `await` leaves its goal unreached."""
    run = mdms.simulate("array18", program=program, limit_s=3.0)
    assert (run.status, bool(run.reason)) == (status, status != "reached")
    assert run.violations == ()


def test_wheels_are_named_by_their_cells_also_where_a_cell_has_fewer():
    run = mdms.simulate(
        {
            "scenario": "array18",
            "run": {"fidelity": "ideal", "duration_s": 0.2},
            "motion": {"field": "uniform", "speed_m_s": 0.2, "heading_rad": 0.0},
            "patch": [{"cells": [1], "wheel": [{"direction_rad": 0.5}]}],
        }
    )
    assert len(run.wheels) == 35
    assert [key for key in run.wheels if key[0] < 3] == [(1, 1), (2, 1), (2, 2)]
    assert run.wheels[2, 1].reference_m_s[-1] == run.record.reference_m_s[-1, 1]


def test_a_buffer_with_a_place_given_twice_is_refused():
    twice = [[0.1, 0.0], [0.0, 0.1], [0.1, 0.0]]
    task = {"do": "buffer", "exit": "east", "places": twice}
    with pytest.raises(mdms.InputError, match=r"task\.0\.places\.2 is \[0\.1, 0\.0\] once more"):
        mdms.simulate(read_tree("sort54") | {"task": [task]}, limit_s=1.0)

    async def main(table):
        mdms.tasks.Buffer(table, twice)

    assert "give each place once" in mdms.simulate("array18", main, limit_s=1.0).reason


def test_a_call_without_a_limit_is_given_up_too(monkeypatch):
    monkeypatch.setattr("mdms_array.simulation.LONGEST_S", 0.5)
    with (
        mdms.virtual("array18") as table,
        pytest.raises(mdms.TimeLimitError, match=r"within 0\.5 s"),
    ):
        table.signal("nobody")


@pytest.mark.parametrize("wrap", [lambda main: main, partial], ids=["plain", "partial"])
def test_the_source_of_a_program_is_kept_whatever_its_encoding_is(tmp_path, wrap):
    path = tmp_path / "program.py"
    text = "# -*- coding: latin-1 -*-\n# Größe\nasync def main(table):\n    pass\n"
    path.write_bytes(text.encode("latin-1"))
    told = provenance_of(wrap(run_path(str(path))["main"]), None)["program"]
    assert told == {"file": "program.py", "source": text, "function": "main"}


def test_a_program_of_any_name_is_repeated_from_its_folder_and_one_with_arguments_is_not(tmp_path):
    path, folder, again = tmp_path / "sorters.py", tmp_path / "run", tmp_path / "again"
    path.write_text("async def shift(table, x_m=-0.05):\n    await table['box'].move(x_m, 0.0)\n")
    shift = run_path(str(path))["shift"]
    bound = tmp_path / "bound"
    mdms.simulate("array18", partial(shift, x_m=0.05), limit_s=0.1, record=bound)
    first = mdms.simulate("array18", program=shift, limit_s=0.5, record=folder)
    path.unlink()
    scenario, main = open_program(str(folder), [])
    assert mdms.simulate(scenario, program=main, record=again).log_sha256 == first.log_sha256
    assert mdms.simulate(folder).log_sha256 == first.log_sha256
    # A folder of the repetition has the program, too.
    assert open_program(str(again), [])[1].__name__ == "shift"
    with pytest.raises(mdms.InputError, match="arguments bound to it, so nothing repeats it"):
        open_program(str(bound), [])


def test_a_record_overwrites_no_other_run_unless_forced(tmp_path):
    def seed(number, **options):
        scenario = load_scenario("paper-fig7", [f"run.seed={number}", "run.duration_s=0.05"])
        mdms.simulate(scenario, record=tmp_path, **options)
        return mdms.read_run(tmp_path).figures["seed"]

    # The same run again is no loss.
    assert [seed(1), seed(1)] == [1, 1]
    with pytest.raises(mdms.InputError, match="holds another run; force=True overwrites it"):
        seed(2)
    assert mdms.read_run(tmp_path).figures["seed"] == 1
    assert seed(2, force=True) == 2


def test_a_table_by_hand_goes_on_after_a_call_that_failed():
    with mdms.virtual("array18") as table:
        box = table["box"]
        box.move(0.10, 0.0, yaw_rad=0.2)
        assert box.pose == pytest.approx((0.10, 0.0, 0.2), abs=3e-3)
        before_s = table.now_s
        with pytest.raises(mdms.ProgramError, match=r"0\.900 m"):
            box.move(0.9, 0.0)
        for wrong in ("bx", 3, ["box"]):
            named = re.escape(repr(wrong))
            with pytest.raises(mdms.ProgramError, match=f"no parcel {named} is on the table"):
                table[wrong]
            with pytest.raises(mdms.ProgramError, match=f"no exit {named}"):
                box.leave(wrong)
        box.move(-0.10, 0.0)
        assert table.now_s > before_s
        true_pose = table.run_so_far.parcels["box"].true_pose
        assert true_pose == pytest.approx((-0.10, 0.0, 0.2), abs=5e-3)


@pytest.mark.parametrize("opens", [mdms.virtual, partial(mdms.connect, channel="none")])
def test_a_table_is_for_one_block(opens):
    opened = opens(scenario="no such")
    for told in ("no such scenario file", "for one `with` block; open another one for the next"):
        with pytest.raises(mdms.InputError, match=told), opened:
            pass


def test_a_program_that_has_not_come_to_its_end_is_broken_off_with_the_run():
    ended = []

    async def main(table):
        try:
            await table.signal("never")
        finally:
            ended.append(table.now_s)

    async def start(table):
        table.start(main(table))

    assert mdms.simulate("array18", program=main, limit_s=0.6).endless
    assert len(ended) == 1
    with mdms.virtual("array18") as table:
        table.run(start)
        assert len(ended) == 1
    assert len(ended) == 2
    assert table.run_so_far.status == "reached"


def test_an_error_of_a_program_that_is_broken_off_with_the_run_is_told():
    """Its `finally` may have been to write what the program has found out."""

    async def main(table):
        try:
            await table.signal("never")
        finally:
            raise OSError("no room for results")

    async def start(table):
        table.start(main(table))

    run = mdms.simulate("array18", program=main, limit_s=0.6)
    told = r"^the program failed as the run ended: OSError: no room for results, in main \(test_api"
    with pytest.raises(mdms.FailedError, match=told):
        run.raise_for_status()
    assert (run.figures["status"], run.figures["reason"]) == (run.status, run.reason)
    with pytest.raises(mdms.FailedError, match=told), mdms.virtual("array18") as table:
        table.run(start)


def test_a_table_that_was_interrupted_within_a_step_does_not_go_on(monkeypatch):
    """The next step of time was not asked for yet, so no later call would come to its end."""

    def interrupt(*_arguments):
        raise KeyboardInterrupt

    with mdms.virtual("array18") as table:
        monkeypatch.setattr("mdms_sim.physics.plane.world.World.step_cells", interrupt)
        with pytest.raises(KeyboardInterrupt):
            table.sleep(0.1)
        monkeypatch.undo()
        with pytest.raises(mdms.StoppedError, match="broken off within a step; begin another"):
            table.signal("never", limit_s=0.1)


def test_a_call_that_takes_too_long_is_given_up_and_the_table_goes_on():
    with mdms.virtual("array18", signals={"scanner": [(1.0, "A")]}) as table:
        with pytest.raises(mdms.TimeLimitError, match=r"not done within 0.2 s: it waits in signal"):
            table.signal("never", limit_s=0.2)
        with pytest.raises(mdms.TimeLimitError):
            table["box"].move(0.10, 0.0, limit_s=0.05)
        # Nobody waits for it, so it comes to rest.
        table.sleep(1.0)
        assert table["box"].pose[0] < -0.05
        table["box"].move(-0.05, 0.0)
        assert table["box"].pose[:2] == pytest.approx((-0.05, 0.0), abs=3e-3)
        assert table.signal("scanner", limit_s=1.0) == "A"


async def fails_beside(table):
    async def ask_for_too_much():
        await table["box"].move(0.9, 0.0)

    table.start(ask_for_too_much())
    await table.sleep(5.0)


async def is_wrong_beside(table):
    async def is_wrong():
        raise ValueError("too far")

    table.start(is_wrong())
    await table.sleep(1.0)


@pytest.mark.parametrize(
    ("program", "kind", "told"),
    [
        (fails_beside, mdms.StoppedError, r"broken off: .*0\.900 m"),
        (is_wrong_beside, mdms.FailedError, "failed: ValueError: too far"),
    ],
)
def test_a_program_by_hand_that_is_broken_off_has_not_been_done(program, kind, told):
    with mdms.virtual("array18") as table:
        with pytest.raises(kind, match=told):
            table.run(program)
        with pytest.raises(kind, match=told):
            table["box"].move(0.1, 0.0)


def test_signals_come_at_their_times_and_the_same_run_has_the_same_bytes():
    signals = {"scanner": [(1.0, "A"), (2.2, "B")]}
    runs = [mdms.simulate("sort54", program=sorter, signals=signals, limit_s=6.0) for _ in range(2)]
    assert runs[0].log_sha256 == runs[1].log_sha256
    exits = [event for event in runs[0].events if event.kind == "exit"]
    assert len(exits) == 2
    runs[0].raise_for_status()


def test_a_signal_that_no_record_keeps_is_refused_before_the_run(tmp_path):
    async def waiter(table):
        await table.signal("scanner")

    signals = {"scanner": [(0.0, 7)]}
    with pytest.raises(mdms.InputError, match="scanner has 7, but a record keeps text; give '7'"):
        mdms.simulate("array18", program=waiter, signals=signals, record=tmp_path / "run")
    assert not (tmp_path / "run").exists()
    assert mdms.simulate("array18", program=waiter, signals=signals).status == "reached"


def test_a_signal_of_the_scenario_reaches_its_program():
    tree = read_tree("array18") | {"signal": [{"name": "go", "value": "east", "time_s": 1.0}]}
    got = []

    async def waiter(table):
        got.append((await table.signal("go"), table.now_s))

    mdms.simulate(tree, program=waiter).raise_for_status()
    ((value, at_s),) = got
    assert value == "east"
    assert 0.0 < at_s <= 1.0


def test_a_mistake_of_a_caller_is_told_and_the_table_goes_on():
    with mdms.virtual("array18") as table:
        for wrong in (print, no_table):
            with pytest.raises(mdms.InputError, match="program: "):
                table.run(wrong)
        for wrong in (float("nan"), -1.0, "1"):
            with pytest.raises(mdms.InputError, match="seconds is "):
                table.sleep(wrong)
            with pytest.raises(mdms.InputError, match="limit_s is "):
                table["box"].move(0.0, 0.0, limit_s=wrong)
            with pytest.raises(mdms.ProgramError, match="x_m of box is "):
                table["box"].move("0.1", 0.0)
        table["box"].move(np.float32(0.05), np.int64(0))
        assert table["box"].pose[0] == pytest.approx(0.05, abs=3e-3)
    with pytest.raises(mdms.StoppedError, match="its `with` block has ended"):
        table["box"].move(0.0, 0.0)


class OfAnotherLoop:
    def __await__(self):
        yield 5


def test_a_program_by_hand_that_awaits_what_no_table_knows_fails_at_once():
    async def main(_table):
        await OfAnotherLoop()

    with mdms.virtual("array18") as table:
        with pytest.raises(mdms.Error, match="awaits int, but a program waits only for its table"):
            table.run(main)
        with pytest.raises(mdms.ProgramError, match=r"time to sleep \[s\] is nan, but must be"):
            table.run(sleeps_for_no_time, limit_s=1.0)


async def sleeps_for_no_time(table):
    await table.sleep(float("nan"))


def test_a_call_by_hand_within_a_program_is_refused_and_the_table_goes_on():
    with mdms.virtual("array18") as table:

        async def calls_by_hand(_table):
            table["box"].move(0.05, 0.0)

        with pytest.raises(mdms.ProgramError, match="in a program await the calls of the table"):
            table.run(calls_by_hand, limit_s=1.0)

        async def has_a_thread_call(_table):
            with ThreadPoolExecutor(1) as other:
                other.submit(table["box"].move, 0.05, 0.0).result()

        with pytest.raises(mdms.ProgramError, match="of several threads let one call at a time"):
            table.run(has_a_thread_call, limit_s=1.0)
        table["box"].move(0.05, 0.0)


def test_a_run_is_shown_in_a_line_and_its_arrays_are_taken_by_numpy():
    run = mdms.simulate("paper-fig7", limit_s=0.5)
    assert repr(run) == "<Run 'Paper, figure 7: full rolling', 0.5 s, reached>"
    assert len(repr(run.parcels["box"])) < 80
    assert np.asarray(run.parcels["box"].true).shape == (len(run.record.time_s), 3)
    columns = np.column_stack(list(run.wheels[1, 1].columns.values()))
    assert columns.shape == (len(run.record.time_s), 6)


@pytest.mark.parametrize("wrong", [{"limit": 3.0}, {"fidelity": "ideal"}])
def test_an_unknown_keyword_is_refused(wrong):
    with pytest.raises(TypeError, match="unexpected keyword argument"):
        mdms.simulate("array18", **wrong)


@pytest.mark.parametrize(
    ("status", "error", "code"),
    [
        ("reached", None, ExitCode.OK),
        ("time limit", mdms.TimeLimitError, ExitCode.TIME_LIMIT),
        ("stopped", mdms.StoppedError, ExitCode.TIME_LIMIT),
        ("fault", mdms.FaultError, ExitCode.NODE_FAULT),
        ("lost", mdms.LostError, ExitCode.FAILURE),
        ("failed", mdms.FailedError, ExitCode.FAILURE),
    ],
)
def test_one_verdict_is_error_message_and_exit_code(status, error, code, capsys):
    run = replace(mdms.simulate("paper-fig7", limit_s=0.01), status=status, reason="why")
    assert verdict(run) == code
    assert ("mdms: why" in capsys.readouterr().err) == (error is not None)
    if error is not None:
        with pytest.raises(error, match="why"):
            run.raise_for_status()
    # A time limit ends a job that has no end of its own.
    endless = replace(run, endless=True)
    assert verdict(endless) == (ExitCode.OK if status == "time limit" else code)


def test_nobody_else_sends_signals_in_virtual_time():
    with mdms.virtual("array18") as table, pytest.raises(mdms.Error, match="in virtual time"):
        table.send_signal("scanner", "A")


def test_a_fault_of_the_cells_ends_the_calls_that_wait():
    fault = {"kind": "off", "cells": [8], "start_s": 2.0}
    tree = read_tree("array18") | {"fault": [fault]}

    async def back_and_forth(table):
        while True:
            await table["box"].move(0.1, 0.0)
            await table["box"].move(-0.1, 0.0)

    with mdms.virtual(tree) as table, pytest.raises(mdms.FaultError, match="8") as raised:
        table.run(back_and_forth, limit_s=20.0)
    assert raised.value.run.status == "fault"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"scenario": "aray18"}, "no such scenario file"),
        ({"scenario": {"title": "x"}}, "array is missing"),
        ({"scenario": "array18", "program": print}, "is not `async def"),
        ({"scenario": "paper-fig7", "program": sorter}, "run.fidelity is 'row'"),
        ({"scenario": "array18", "signals": {"a": [(0.0, "b")]}}, "no program takes it"),
        ({"scenario": "array18", "program": no_table}, "does not take one table"),
        ({"scenario": None}, "neither a name, a file, a dict nor a Scenario"),
        ({"scenario": "array18", "limit_s": -1}, "limit_s is -1, but must be 0.001 to 100000"),
        ({"scenario": "array18", "limit_s": "3"}, "limit_s is '3'"),
        (
            {"scenario": "paper-fig7", "limit_s": 1e5},
            "duration_s is 100000.0, .* make the run short",
        ),
        ({"scenario": "array18", "record": 3}, "record is 3, but must be a path"),
        ({"scenario": "array18", "limit_s": float("nan")}, "limit_s is nan"),
        ({"scenario": "array18", "limit_s": 1e12}, "limit_s is 1000000000000.0"),
        (
            {"scenario": "sort54", "signals": {"scanner": [(-1.0, "A")]}},
            "the time of scanner is -1.0, but must be 0 to 100000",
        ),
        ({"scenario": "sort54", "signals": {"scanner": (1.0, "A")}}, "scanner has 1.0, but must"),
        ({"scenario": "sort54", "signals": {"scanner": 1.0}}, "'scanner' has 1.0, but must have"),
        ({"scenario": "sort54", "signals": [("scanner", "A")]}, "is no table of lists by name"),
    ],
)
def test_a_scenario_that_cannot_be_run_is_refused(arguments, told):
    with pytest.raises(mdms.InputError, match=told):
        mdms.simulate(**arguments)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"array_file": 3}, "array_file is 3, but must be a path"),
        ({"scenario": "array18", "interface": "virtual", "bitrate": "1M"}, "bitrate is '1M', but"),
        ({"scenario": "array18", "interface": "virtual", "bitrate": -1}, "bitrate is -1, but must"),
    ],
)
def test_a_table_that_cannot_be_reached_by_its_arguments_is_refused(arguments, told):
    with pytest.raises(mdms.InputError, match=told), mdms.connect(**arguments):
        pass


@pytest.mark.parametrize(
    ("missing", "calls"),
    [
        (
            "numba",
            {
                "mdms.simulate('array18')": r"mdms_array.simulate needs pip install .*\[sim\]",
                "mdms.virtual('array18').__enter__()": "mdms_array.virtual needs .*numba",
            },
        ),
        (
            "mcap",
            {
                "mdms.simulate('array18', record='run')": r"with a record needs .*\[record\]",
                "mdms.write_run('run', None, None, {})": r"a run folder needs .*\[record\]",
            },
        ),
        ("pandas", {"mdms.sweep('array18', {})": r"mdms_array.sweep needs .*\[sweep\]"}),
    ],
)
def test_a_function_that_needs_an_extra_names_it(missing, calls, tmp_path):
    script = (
        f"import sys; sys.modules[{missing!r}] = None\n"
        "import mdms_array as mdms\n"
        "mdms.connect, mdms.Table, mdms.tasks, mdms.read_run\n"
    )
    for call in calls:
        script += f"try: {call}\nexcept mdms.Error as error: print(error)\n"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, check=True, text=True, cwd=tmp_path
    )
    for told, expected in zip(done.stdout.splitlines(), calls.values(), strict=True):
        assert re.search(expected, told)


def test_the_import_is_light():
    script = (
        "import sys, json, mdms_array; "
        "print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    heavy = {"numba", "matplotlib", "mdms_sim", "numpy", "pandas", "pyarrow", "scipy", "optuna"}
    assert heavy.isdisjoint(json.loads(done.stdout))


def test_every_name_can_be_imported_and_helps_to_write_programs():
    names = {}
    exec("from mdms_array import *", names)
    assert set(mdms.__all__) <= names.keys()
    assert mdms.tasks.swap.__name__ == "swap"
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        mdms.simulat  # noqa: B018


def test_run_folders_are_named_by_strings_or_paths(tmp_path):
    run = mdms.simulate("paper-fig7", limit_s=0.5, record=str(tmp_path / "run"))
    stored = mdms.read_run(str(tmp_path / "run"))
    assert stored.record.time_s.tolist() == run.record.time_s.tolist()
    mdms.write_run(str(tmp_path / "again"), stored.scenario, stored.record, stored.figures)
    assert mdms.read_run(tmp_path / "again").figures == stored.figures
    with pytest.raises(mdms.InputError, match="no such run folder"):
        mdms.read_run("nowhere")


def test_an_exit_asked_for_by_its_name_is_no_wrong_one():
    async def to_south(table):
        for _ in range(2):
            await (await table.arrival()).leave("south")

    run = mdms.simulate("sort54", program=to_south, limit_s=20.0)
    assert run.status == "reached"
    assert run.figures["stream"]["by_exit"]["south"] == 2
    assert run.figures["stream"]["wrong"] == 0


def test_a_run_that_ends_before_its_stream_begins_has_no_stream_yet():
    stream = mdms.simulate("sort54", limit_s=0.1).figures["stream"]
    assert (stream["came"], stream["lasts_s"], stream["parcels_per_hour"]) == (0, 0.0, 0.0)


async def stops_and_leaves(table):
    parcel = await table.arrival()
    await parcel.move(-0.1, 0.0)
    await parcel.leave("north")


async def ends_while_it_leaves(table):
    parcel = await table.arrival()
    await parcel.move(-0.1, 0.0)
    table.start(parcel.leave("north"))
    await table.sleep(0.6)


def test_a_parcel_on_its_way_out_is_at_no_fault_for_being_away_from_an_earlier_goal():
    infeed = EXAMPLES / "infeed18.toml"
    run = mdms.simulate(infeed, program=stops_and_leaves, limit_s=2.2)
    assert run.status == "time limit"
    assert "has not come to its end: it waits in stops_and_leaves" in run.reason
    run = mdms.simulate(infeed, program=ends_while_it_leaves, limit_s=10.0)
    assert (run.status, run.violations) == ("reached", ())
