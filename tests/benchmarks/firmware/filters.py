"""Frames that acceptance filters pass and a cell drops, where the cells of a table steer."""

import sys
from collections.abc import Iterable
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

from mdms_host.layout import Layout
from mdms_host.places import place_values
from mdms_protocol import indices
from mdms_protocol.codecs import cob

#: Half of the 14 banks of a bxCAN (PYBv1.1, F405), of the 28 filters of a G4's FDCAN, and of the
#: 64 of an H7's; a FlexCAN has 32.
PLACES = {"bxCAN": 7, "FDCAN of a G4": 14, "FDCAN of an H7, FlexCAN": 32}
LAYOUT = Layout(6, 3)
SYNC_HZ = 100
HEARTBEAT_HZ = 10
WATCHED_HEARTBEAT_HZ = 40
STATUS_HZ = 10
PROGRAM_HZ = 1


class Share(NamedTuple):
    """Of the frames on the bus, those that reach a cell's program, and those that it drops."""

    passed: float
    dropped: float


def run() -> list[dict[str, Any]]:
    """The share of the frames on the bus that reach a cell's program, and that it drops."""
    rows = []
    for name, places in PLACES.items():
        mean = mean_share(places, LAYOUT.node_ids)
        row = {"name": f"dropped by software behind a {name}", "ours": mean.dropped, "unit": ""}
        rows.append({**row, "peer": None, "ratio": None, "passed": mean.passed})
    return rows


@cache
def can_filters() -> ModuleType:
    """The boards' module, beside a `machine` that has the constants which it names."""
    path = Path(__file__).parents[3] / "firmware" / "boards" / "can_filters.py"
    spec = spec_from_file_location("can_filters", path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    machine = ModuleType("machine")
    machine.CAN = SimpleNamespace(FLAG_EXT_ID=1)  # type: ignore[attr-defined]
    before = sys.modules.get("machine")
    sys.modules["machine"] = machine
    try:
        spec.loader.exec_module(module)
    finally:
        del sys.modules["machine"]
        if before is not None:
            sys.modules["machine"] = before
    return module


def neighbours(number: int) -> list[int]:
    """Node ids around the cell of that number."""
    values = place_values(LAYOUT, number)
    nodes = [values[indices.NEIGHBOURS, sub] for sub in range(1, 9)]
    return [node for node in nodes if node]


def accepted(number: int) -> set[int]:
    """Identifiers that a cell takes while it steers."""
    own = {cob.NMT, cob.SYNC, cob.LSS_REQUEST, cob.PROGRAM, cob.HEARTBEAT_BASE + cob.HOST_NODE}
    own |= {base + number for base in (*cob.RPDO_BASES[:2], cob.SDO_REQUEST_BASE)}
    own |= {base + number for base in (cob.SDO_RESPONSE_BASE, cob.HEARTBEAT_BASE)}
    return own | {base + node for node in neighbours(number) for base in cob.TPDO_BASES}


def traffic(at_parcel: Iterable[int]) -> dict[int, float]:
    """Frames a second by identifier, while these cells are at a parcel."""
    rates: dict[int, float] = {
        cob.SYNC: SYNC_HZ,
        cob.HEARTBEAT_BASE + cob.HOST_NODE: WATCHED_HEARTBEAT_HZ,
        cob.PROGRAM: PROGRAM_HZ,
    }
    for node in LAYOUT.node_ids:
        rates[cob.TPDO_BASES[0] + node] = SYNC_HZ
        rates[cob.TPDO_BASES[1] + node] = STATUS_HZ
        rates[cob.HEARTBEAT_BASE + node] = HEARTBEAT_HZ
    for node in at_parcel:
        rates[cob.ESTIMATE_BASE + node] = SYNC_HZ
        rates[cob.PROGRAM_BASE + node] = PROGRAM_HZ
    return rates


def share(number: int, places: int, at_parcel: Iterable[int]) -> Share:
    """For a cell behind so many places for filters."""
    wanted = accepted(number)
    made = can_filters().shared(wanted, places)
    others = {
        can_id: rate for can_id, rate in traffic(at_parcel).items() if can_id & 0x7F != number
    }
    passed = {
        can_id: rate
        for can_id, rate in others.items()
        if any(can_id & mask == pattern & mask for pattern, mask in made)
    }
    assert wanted & others.keys() <= passed.keys()
    dropped = sum(rate for can_id, rate in passed.items() if can_id not in wanted)
    total = sum(others.values())
    return Share(sum(passed.values()) / total, dropped / total)


def mean_share(places: int, at_parcel: Iterable[int]) -> Share:
    """The mean of all cells."""
    shares = [share(number, places, at_parcel) for number in LAYOUT.node_ids]
    count = len(shares)
    return Share(sum(s.passed for s in shares) / count, sum(s.dropped for s in shares) / count)
