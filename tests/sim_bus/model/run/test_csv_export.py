"""The exported tables hold the record, number by number."""

import csv

import numpy as np

from mdms_model.run.folder import export_csv
from mdms_model.run.record import Contact


def rows(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_header_is_the_promised_one(tmp_path, plane, plane_record):
    parcels, cells = export_csv(tmp_path, plane, plane_record)
    assert parcels.read_text().splitlines()[0] == (
        "time_s,parcel,x_m,y_m,yaw_rad,vx_m_s,vy_m_s,yaw_rate_rad_s"
    )
    assert (
        cells.read_text()
        .splitlines()[0]
        .startswith("time_s,cell,axis,reference_m_s,speed_m_s,voltage_v,normal_n,force_n,contact")
    )


def test_parcels_give_back_every_bit(tmp_path, plane, plane_record):
    table = rows(export_csv(tmp_path / "new" / "folder", plane, plane_record)[0])
    assert {row["parcel"] for row in table} == {"box"}
    for name, values in (
        ("time_s", plane_record.time_s),
        ("x_m", plane_record.pose[:, 0, 0]),
        ("yaw_rate_rad_s", plane_record.twist[:, 0, 2]),
    ):
        np.testing.assert_array_equal([float(row[name]) for row in table], values)


def test_wheels_are_told_by_cell_and_axis(tmp_path, plane, plane_record):
    table = rows(export_csv(tmp_path, plane, plane_record)[1])
    assert len(table) == plane_record.contact.size
    row = next(row for row in table if (row["cell"], row["axis"]) == ("18", "2"))
    assert float(row["time_s"]) == plane_record.time_s[0]
    assert float(row["normal_n"]) == plane_record.normal_n[0, 35]
    assert row["contact"] == "sliding_backward"


def test_contact_is_told_in_words(tmp_path, plane, plane_record):
    table = rows(export_csv(tmp_path, plane, plane_record)[1])
    told = [Contact[row["contact"].upper()] for row in table]
    np.testing.assert_array_equal(told, plane_record.contact.ravel())


def test_belief_stands_for_poses_that_nobody_knows(tmp_path, plane, believed_record):
    parcels, cells = map(rows, export_csv(tmp_path, plane, believed_record))
    np.testing.assert_array_equal(
        [float(row["yaw_rad"]) for row in parcels], believed_record.estimate[:, 0, 2]
    )
    assert {row["contact"] for row in cells} == {"unknown"}
    assert {row["vx_m_s"] for row in parcels} == {"nan"}
