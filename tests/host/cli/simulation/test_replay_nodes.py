"""A recorded host moves simulated cells as it did: same bytes on the bus, same pose."""

import json

import pytest

from mdms_host.cli import main
from mdms_host.cli.simulation.simulate import ready_s
from mdms_protocol.codecs.frame import Frame


def told(capsys, *arguments):
    assert main([*map(str, arguments), "--json"]) in (0, 3)
    return json.loads(capsys.readouterr().out)


def assert_same_bytes(again, run):
    """All but the load, in which a frame counts that is still under way at the end."""
    for name in ("frames", "errors", "log_sha256"):
        assert again["bus"][name] == run["bus"][name]


@pytest.mark.parametrize("bitrate", [1_000_000, 800_000])
def test_replayed_host_carries_the_parcel_to_the_same_place(capsys, tmp_path, bitrate):
    short = ("--set", "run.duration_s=0.8", "--set", f"wire.bitrate={bitrate}")
    run = told(capsys, "simulate", "array18", *short, "--out", tmp_path / "run")
    again = told(capsys, "replay", tmp_path / "run", "--nodes", "cpython")
    (before,), (after,) = run["parcels"], again["parcels"]
    before.pop("estimate", None)
    assert after == before
    assert_same_bytes(again, run)


def test_micropython_cells_follow_the_same_recording(capsys, tmp_path):
    short = ("--set", "run.duration_s=0.2", "--set", "array.columns=3")
    fidelity = ("--fidelity", "firmware", "--out", tmp_path / "run")
    small = ("--set", "parcel.0.length_m=0.3", "--set", "parcel.0.x_m=0")
    run = told(capsys, "simulate", "paper-fig7", *short, *small, *fidelity)
    again = told(capsys, "replay", tmp_path / "run", "--nodes", "micropython")
    assert again["nodes"] == "micropython"
    assert_same_bytes(again, run)


@pytest.mark.parametrize("option", [("--only", "cells"), ("-i", "virtual"), ("-c", "name")])
def test_cells_and_a_bus_at_once_are_refused(capsys, tmp_path, option):
    assert main(["replay", str(tmp_path), "--nodes", "cpython", *option]) == 2
    assert "--nodes" in capsys.readouterr().err


def test_frame_is_ready_half_a_bit_before_it_began():
    # 44 bits without data, and at most 8 stuff bits.
    sync = Frame(0x080, b"")
    bits = round((0.001 - ready_s(0.001, sync, 1_000_000)) * 1e6 - 0.5)
    assert 44 <= bits <= 52
    # 800 bits of 1.25 us end at 1 ms; one bit later the log says 1.001 ms for 1.00125 ms.
    first, second = (ready_s(end_s, sync, 800_000) for end_s in (0.001, 0.001001))
    assert second - first == pytest.approx(1.25e-6, abs=1e-12)
