"""The database decodes what is on the bus."""

import logging

import cantools
import pytest

from mdms_protocol import cob, nmt
from mdms_protocol.generators import dbc


@pytest.fixture
def database(caplog):
    with caplog.at_level(logging.DEBUG):
        loaded = cantools.database.load_string(dbc.text(), "dbc", strict=True)
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []
    return loaded


def test_database_decodes_a_bus_log_to_the_same_values(database, recorded_log):
    for carried, node_id, values, data in recorded_log:
        raw = database.decode_message(carried.can_id(node_id), data, scaling=False)
        assert tuple(raw.values()) == values
        scaled = database.decode_message(carried.can_id(node_id), data, decode_choices=False)
        for entry, value, physical in zip(carried.entries, values, scaled.values(), strict=True):
            assert physical == pytest.approx(value * entry.unit.factor)


def test_database_names_states(database):
    decoded = database.decode_message(cob.HEARTBEAT_BASE + 3, bytes((nmt.OPERATIONAL,)))
    assert str(decoded["state"]) == "operational"
    assert database.get_message_by_frame_id(cob.SYNC).length == 0
