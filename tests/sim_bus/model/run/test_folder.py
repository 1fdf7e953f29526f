"""A run folder gives back its content, and no other folder is mistaken for one."""

import csv
import errno
import json
import os
import shutil
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from mdms_model.errors import InputError
from mdms_model.run.folder import (
    RunFolderError,
    check_target,
    export_csv,
    fresh_folder,
    read_run,
    told_of_run,
    write_run,
)
from mdms_model.run.mcap_file import read_record, write_record
from mdms_model.run.record import Contact, Event, Record, leaving
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import ScenarioError

ARRAYS = [item.name for item in fields(Record) if item.name != "events"]
SCENARIO = load_scenario("paper-fig7", ["parcel.0.name=a/b"])
FIGURES = {"title": "by hand", "wall_s": 0.25}


def assert_same_arrays(back, record):
    for name in ARRAYS:
        before, after = getattr(record, name), getattr(back, name)
        np.testing.assert_array_equal(after, before, err_msg=name, strict=before is not None)


def strict_validator(schema):
    """Refuses names that a schema lacks; an array with gaps is in none: see `messages`."""
    meant = json.loads(schema.data) | {"additionalProperties": False}
    if schema.name == "mdms.Wheels":
        meant["properties"] = dict.fromkeys(ARRAYS, True) | meant["properties"]
    validator = jsonschema.validators.validator_for(meant)
    validator.check_schema(meant)
    return validator(meant)


def save_empty(path, _scenario, _record):
    path.write_bytes(b"")


def stored(folder, scenario, record):
    """A run folder whose picture has nothing in it; who draws is tested with the verbs."""
    with fresh_folder(folder) as partial:
        write_run(partial, scenario, record, FIGURES, save_empty)
    return folder


def test_record_survives_to_the_last_bit(tmp_path, plane, plane_record):
    write_record(tmp_path / "run.mcap", plane, plane_record)
    back = read_record(tmp_path / "run.mcap", plane)
    assert_same_arrays(back, plane_record)
    assert back.events == sorted(plane_record.events, key=lambda event: event.time_s)


def test_record_without_estimates_stays_without(tmp_path, plane, plane_record):
    write_record(tmp_path / "run.mcap", plane, replace(plane_record, estimate=None))
    assert read_record(tmp_path / "run.mcap", plane).estimate is None


@given(numbers=st.lists(st.floats(allow_infinity=False), min_size=6, max_size=6))
def test_any_number_survives(tmp_path_factory, numbers):
    path = tmp_path_factory.mktemp("any") / "run.mcap"
    wheels = np.array(numbers).reshape(3, 2).repeat(SCENARIO.array.columns // 2, axis=1)
    poses = wheels[:, :1, None].repeat(3, axis=2)
    codes = np.zeros(wheels.shape, dtype=np.int8)
    times_s = np.array([0.0, 1e-9 / 3, 1.0])
    record = Record(times_s, poses, poses, *[wheels] * 5, codes)
    write_record(path, SCENARIO, record)
    assert_same_arrays(read_record(path, SCENARIO), record)


def test_two_parcels_keep_their_order(tmp_path, plane, plane_record):
    two = replace(
        plane_record,
        pose=np.concatenate((plane_record.pose, plane_record.pose + 1), axis=1),
        twist=np.concatenate((plane_record.twist, plane_record.twist + 1), axis=1),
        estimate=np.concatenate((plane_record.estimate, plane_record.estimate + 1), axis=1),
    )
    box = plane.parcel[0]
    pair = replace(plane, parcel=(replace(box, name="zebra"), replace(box, name="ant")))
    write_record(tmp_path / "run.mcap", pair, two)
    assert_same_arrays(read_record(tmp_path / "run.mcap", pair), two)


def test_other_readers_find_schemas_and_messages_in_order_of_time(tmp_path, plane, plane_record):
    write_record(tmp_path / "run.mcap", plane, plane_record)
    with (tmp_path / "run.mcap").open("rb") as stream:
        found = list(make_reader(stream).iter_messages(log_time_order=False))
    assert [m.log_time for _, _, m in found] == sorted(m.log_time for _, _, m in found)
    topics = {channel.topic for _, channel, _ in found}
    numbers = {"/parcel/box", "/wheels", "/events", "/log"}
    assert topics == numbers | {
        f"/scene/{name}" for name in ("table", "wheels", "goals", "parcels", "beliefs")
    }
    for schema, channel, _ in found:
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")


def test_an_unknown_value_is_left_out_and_read_back_as_unknown(tmp_path, plane, believed_record):
    write_record(tmp_path / "run.mcap", plane, believed_record)
    with (tmp_path / "run.mcap").open("rb") as stream:
        found = list(make_reader(stream).iter_messages())
    wheels = [json.loads(m.data) for _, channel, m in found if channel.topic == "/wheels"]
    assert {*wheels[0]} == {"time_s", "reference_m_s", "speed_m_s", "contact"}
    assert_same_arrays(read_record(tmp_path / "run.mcap", plane), believed_record)


def without_belief(record):
    return replace(record, estimate=np.full_like(record.pose, np.nan))


def with_a_lost_parcel(record):
    record.pose[7:, :, 0] = np.nan
    return record


def with_a_force_that_is_no_number(record):
    record.force_n[3, 5] = np.nan
    return record


@pytest.mark.parametrize(
    "change",
    [replace, without_belief, with_a_lost_parcel, with_a_force_that_is_no_number],
)
def test_every_message_meets_its_own_schema(tmp_path, plane, plane_record, change):
    record = change(plane_record)
    write_record(tmp_path / "run.mcap", plane, record)
    with (tmp_path / "run.mcap").open("rb") as stream:
        found = list(make_reader(stream).iter_messages())
    assert len(found) > 3 * len(record.time_s)
    schemas = {schema.id: schema for schema, _, _ in found}
    validators = {number: strict_validator(schema) for number, schema in schemas.items()}
    for schema, _, message in found:
        validators[schema.id].validate(json.loads(message.data))
    assert_same_arrays(read_record(tmp_path / "run.mcap", plane), record)


def test_run_is_read_back(tmp_path, plane, plane_record):
    run = read_run(stored(tmp_path / "deep" / "run", plane, plane_record))
    assert run.scenario == plane
    assert run.figures == FIGURES
    assert_same_arrays(run.record, plane_record)
    names = sorted(path.name for path in run.folder.iterdir())
    assert names == ["lichtblick_layout.json", "meta.json", "picture.png", "run.mcap"]
    assert [path.name for path in run.folder.parent.iterdir()] == ["run"]


def test_meta_names_the_run(tmp_path, plane, plane_record):
    folder = stored(tmp_path / "run", plane, plane_record)
    meta = json.loads((folder / "meta.json").read_text())
    assert meta["scenario"]["run"]["seed"] == plane.run.seed
    assert meta["versions"]["mdms-array"]
    assert meta["figures"] == FIGURES


def test_new_run_takes_the_place_of_an_old_one_and_leaves_other_files(
    tmp_path, plane, plane_record
):
    folder = stored(tmp_path / "run", plane, plane_record)
    (folder / "bus.log").write_text("of the old run")
    (folder / "notes.txt").write_text("mine")
    stored(folder, replace(plane, title="again"), plane_record)
    assert read_run(folder).scenario.title == "again"
    assert not (folder / "bus.log").exists()
    assert (folder / "notes.txt").read_text() == "mine"


def test_foreign_folder_is_not_touched(tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(RunFolderError, match=r"new or empty folder$"), fresh_folder(tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_empty_folder_may_be_filled(tmp_path, plane, plane_record):
    assert read_run(stored(tmp_path, plane, plane_record)).scenario == plane


def test_file_in_the_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "run").write_text("mine")
    with pytest.raises(RunFolderError, match=r"give another name$"), fresh_folder(tmp_path / "run"):
        pass


def test_a_mount_point_is_refused_before_the_run():
    with pytest.raises(RunFolderError, match=r"is a mount point; give a folder within it$"):
        check_target(Path("/"))


def test_nothing_is_left_when_the_run_fails(tmp_path):
    def fail(partial):
        (partial / "bus.log").write_text("half a run")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), fresh_folder(tmp_path / "run") as partial:
        fail(partial)
    assert list(tmp_path.iterdir()) == []


def cut_record(folder):
    path = folder / "run.mcap"
    path.write_bytes(path.read_bytes()[:5000])


@pytest.mark.parametrize("share", [0.2, 0.4, 0.6, 0.8])
def test_a_flipped_bit_of_a_record_is_never_read_as_another_run(
    tmp_path, plane, plane_record, share
):
    folder = stored(tmp_path / "run", plane, plane_record)
    path = folder / "run.mcap"
    data = bytearray(path.read_bytes())
    place = int(share * len(data))
    for bit in range(8):
        path.write_bytes(data[:place] + bytes((data[place] ^ 1 << bit,)) + data[place + 1 :])
        with suppress(RunFolderError):
            assert_same_arrays(read_run(folder).record, plane_record)


def change_version(folder):
    path = folder / "meta.json"
    path.write_text(path.read_text().replace('"format_version": 1', '"format_version": 99'))


def spoil_scenario(folder):
    path = folder / "meta.json"
    path.write_text(path.read_text().replace('"mass_kg": 2.0', '"mass_kg": -2.0'))


def change_meta(name, value):
    def change(folder):
        path = folder / "meta.json"
        tree = json.loads(path.read_text())
        tree[name] = value(tree[name])
        path.write_text(json.dumps(tree))

    return change


def one_wheel_a_cell(scenario):
    return scenario | {"cell": scenario["cell"] | {"wheel": scenario["cell"]["wheel"][:1]}}


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (change_meta("scenario", one_wheel_a_cell), r"it has \d+ wheels, and their table \d+"),
        (change_meta("scenario", lambda _: 5), "not a run folder"),
        (change_meta("figures", lambda _: None), "not a run folder"),
        (change_meta("provenance", lambda _: []), "not a run folder"),
        (change_meta("figures", lambda _: {"node_ids": 5}), "node_ids is 5, and not one of each"),
        (change_meta("figures", lambda _: {"node_ids": ["a"] * 18}), "and not one of each cell"),
        (change_meta("figures", lambda _: {"node_ids": [1]}), "and not one of each cell"),
        (cut_record, "damaged run folder"),
        (lambda folder: (folder / "run.mcap").write_bytes(b""), "parcels: it is cut off$"),
        (change_version, "written in format 99, but this version reads 1"),
        (spoil_scenario, "parcel.0.mass_kg is -2.0, but must be above 0"),
        (lambda folder: (folder / "run.mcap").unlink(), "run.mcap: cannot be read"),
        (lambda folder: (folder / "meta.json").unlink(), "not a run folder"),
        (lambda folder: (folder / "meta.json").write_text("[]"), "not a run folder"),
        (lambda folder: (folder / "meta.json").write_text("[" * 100_000), "not a run folder"),
    ],
)
def test_damaged_run_is_refused(tmp_path, plane, plane_record, spoil, told):
    folder = stored(tmp_path / "run", plane, plane_record)
    spoil(folder)
    with pytest.raises(RunFolderError, match=told):
        read_run(folder)


def test_a_run_that_tells_nothing_of_itself_has_no_figures(tmp_path):
    (tmp_path / "meta.json").write_text('{"format": "mdms-run", "format_version": 1}')
    assert told_of_run(tmp_path) == ({}, {})
    with pytest.raises(ScenarioError, match="holds no scenario"):
        load_scenario(tmp_path)


def test_a_folder_that_is_no_path_is_refused(plane, plane_record):
    with pytest.raises(InputError, match="folder is 3, but must be a path"):
        read_run(3)
    with pytest.raises(InputError, match="folder is 3, but must be a path"):
        write_run(3, plane, plane_record, {})


def test_missing_folder_is_refused(tmp_path):
    with pytest.raises(RunFolderError, match="no such run folder"):
        read_run(tmp_path / "none")


def test_event_without_a_place_stays_without(tmp_path, plane, plane_record):
    record = replace(plane_record, events=[Event(0.5, "coordinator", "running")])
    write_record(tmp_path / "run.mcap", plane, record)
    assert read_record(tmp_path / "run.mcap", plane).events == record.events


class KilledError(BaseException):
    """Stands for the end of the process: nothing after it is carried out."""


@pytest.mark.parametrize("renames", [0, 1])
def test_crash_at_any_rename_leaves_the_old_run_whole_or_brings_it_back(
    tmp_path, plane, plane_record, monkeypatch, renames
):
    folder = stored(tmp_path / "run", plane, plane_record)
    (folder / "notes.txt").write_text("mine")
    left, rename = [renames], Path.rename

    def killed(path, target):
        if not left[0]:
            raise KilledError
        left[0] -= 1
        return rename(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", killed)
        with pytest.raises(KilledError):
            stored(folder, replace(plane, title="new"), plane_record)
    assert folder.exists() == (renames == 0)
    if renames == 0:
        assert read_run(folder).scenario.title == plane.title
    # The process that left them is gone by the next run.
    monkeypatch.setattr("mdms_model.run.folder._is_alive", lambda _process: False)
    stored(folder, replace(plane, title="again"), plane_record)
    assert read_run(folder).scenario.title == "again"
    assert (folder / "notes.txt").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.fixture
def read_only_parent(monkeypatch):
    """No folder can be renamed as long as the list holds something."""
    denied, rename = [True], Path.rename

    def refused(path, target):
        if denied:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", refused)
    return denied


@pytest.mark.parametrize("again", [False, True])
def test_a_run_that_cannot_take_its_place_is_kept_and_named(
    tmp_path, plane, plane_record, read_only_parent, again
):
    partial = tmp_path / f".run.{os.getpid()}.partial"
    if again:
        write_run(tmp_path / "run", plane, plane_record, {})
    with pytest.raises(PermissionError) as refused:
        stored(tmp_path / "run", replace(plane, title="new"), plane_record)
    assert refused.value.filename == str(tmp_path / "run")
    assert refused.value.strerror == f"Permission denied; what was written is in {partial}"
    assert read_run(partial).scenario.title == "new"
    # It is whole, so that the next run here leaves it.
    read_only_parent.clear()
    kept = partial.rename(tmp_path / ".run.4194999.partial")
    stored(tmp_path / "run", plane, plane_record)
    assert sorted(path.name for path in tmp_path.iterdir()) == [kept.name, "run"]
    assert read_run(kept).scenario.title == "new"


def test_a_run_whose_place_is_gone_says_so(tmp_path):
    (tmp_path / "gone").mkdir()
    with pytest.raises(FileNotFoundError) as refused, fresh_folder(tmp_path / "gone" / "run"):
        shutil.rmtree(tmp_path / "gone")
    assert refused.value.filename == str(tmp_path / "gone" / "run")
    assert refused.value.strerror == "No such file or directory"


def test_old_run_comes_back_though_the_next_one_fails_too(tmp_path, plane, plane_record):
    """Between its two renames the process was killed; its number is beyond any."""
    old = tmp_path / ".run.4194999.old"
    stored(tmp_path / "run", plane, plane_record).rename(old)
    with pytest.raises(ZeroDivisionError), fresh_folder(tmp_path / "run"):
        raise ZeroDivisionError
    assert read_run(tmp_path / "run").scenario.title == plane.title
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_partial_folders_of_killed_runs_go_with_the_next_and_those_of_others_stay(
    tmp_path, plane, plane_record
):
    names = [".run.4194999.partial", f".run.{os.getppid()}.partial", ".other.4194999.partial"]
    for name in names:
        (tmp_path / name).mkdir()
        (tmp_path / name / "bus.log").write_text("half")
    stored(tmp_path / "run", plane, plane_record)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names[1:], "run"])


def test_a_killed_run_of_the_same_process_number_is_in_nobodys_way(tmp_path, plane, plane_record):
    """In a container the next run has the number of the one that was killed."""
    folder = stored(tmp_path / "run", plane, plane_record)
    folder.rename(tmp_path / f".run.{os.getpid()}.old")
    (tmp_path / f".run.{os.getpid()}.partial").mkdir()
    with fresh_folder(folder):
        assert read_run(folder).scenario.title == plane.title
        # A thread of this process that writes the same run is in the way, as before.
        with pytest.raises(RunFolderError, match="File exists"), fresh_folder(folder):
            pass
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def rows(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_header_is_the_promised_one(tmp_path, plane, plane_record):
    paths = export_csv(tmp_path, plane, plane_record)
    assert [path.read_text().splitlines()[0] for path in paths] == [
        "time_s,parcel,true_x_m,true_y_m,true_yaw_rad,true_vx_m_s,true_vy_m_s,true_yaw_rate_rad_s,"
        "believed_x_m,believed_y_m,believed_yaw_rad",
        "time_s,cell,axis,reference_m_s,true_speed_m_s,reported_speed_m_s,true_voltage_v,"
        "true_normal_n,true_force_n,true_contact,true_slip_m_s",
        "time_s,kind,parcel,cell,text",
        "time_s,parcel,event,exit,wrong_exit",
    ]


def test_events_and_streams_are_rows(tmp_path, plane, plane_record):
    record = replace(
        plane_record,
        events=[
            Event(0.5, "arrival", "set down", parcel="box"),
            Event(1.0, "fault", "off begins", cell=3),
            leaving(1.5, "box", "east", wrong=True),
        ],
    )
    _, _, events, streams = map(rows, export_csv(tmp_path, plane, record))
    assert [(row["kind"], row["cell"], row["text"]) for row in events][1] == (
        *("fault", "3", "off begins"),
    )
    assert [tuple(row.values()) for row in streams] == [
        ("0.5", "box", "came", "", ""),
        ("1.5", "box", "left", "east", "1"),
    ]


def test_parcels_give_back_every_bit(tmp_path, plane, plane_record):
    table = rows(export_csv(tmp_path / "new" / "folder", plane, plane_record)[0])
    assert {row["parcel"] for row in table} == {"box"}
    for name, values in (
        ("time_s", plane_record.time_s),
        ("true_x_m", plane_record.pose[:, 0, 0]),
        ("true_yaw_rate_rad_s", plane_record.twist[:, 0, 2]),
    ):
        np.testing.assert_array_equal([float(row[name]) for row in table], values)


def test_wheels_are_told_by_cell_and_axis(tmp_path, plane, plane_record):
    table = rows(export_csv(tmp_path, plane, plane_record)[1])
    assert len(table) == plane_record.contact.size
    row = next(row for row in table if (row["cell"], row["axis"]) == ("18", "2"))
    assert float(row["time_s"]) == plane_record.time_s[0]
    assert float(row["true_normal_n"]) == plane_record.normal_n[0, 35]
    assert row["true_contact"] == "sliding_backward"


def test_contact_is_told_in_words(tmp_path, plane, plane_record):
    table = rows(export_csv(tmp_path, plane, plane_record)[1])
    told = [Contact[row["true_contact"].upper()] for row in table]
    np.testing.assert_array_equal(told, plane_record.contact.ravel())


def test_belief_and_reports_are_no_truth(tmp_path, plane, believed_record):
    parcels, cells, *_ = map(rows, export_csv(tmp_path, plane, believed_record))
    np.testing.assert_array_equal(
        [float(row["believed_yaw_rad"]) for row in parcels], believed_record.estimate[:, 0, 2]
    )
    assert {row["true_yaw_rad"] for row in parcels} == {"nan"}
    assert {row["true_vx_m_s"] for row in parcels} == {"nan"}
    assert {row["true_contact"] for row in cells} == {"unknown"}
    assert {row["true_speed_m_s"] for row in cells} == {"nan"}
    np.testing.assert_array_equal(
        [float(row["reported_speed_m_s"]) for row in cells], believed_record.speed_m_s.ravel()
    )
