"""Every object has one name by which cell and host find it."""

from dataclasses import dataclass

import pytest

from mdms_protocol import indices
from mdms_protocol.dictionary import AXIS_OFFSET, OBJECTS
from mdms_protocol.generators import index_names


@dataclass
class Named:
    index: int
    name: str


def named():
    return {name: value for name, value in vars(indices).items() if name.isupper()}


def test_names_lead_to_the_objects_that_they_say():
    assert indices.TARGET == 0x60FF
    assert indices.UNDERVOLTAGE_LIMIT == 0x3003
    assert indices.GAIN + indices.AXIS_OFFSET == 0x2800


def test_every_object_has_a_name_or_follows_one_that_has():
    found = named()
    assert found.pop("AXIS_OFFSET") == AXIS_OFFSET
    reached = set(found.values())
    reached |= {index + AXIS_OFFSET for index in reached if index >= 0x2000}
    for first in (0x1400, 0x1600, 0x1800, 0x1A00):
        reached |= set(range(first, first + 4))
    assert {each.index for each in OBJECTS} <= reached
    assert all(name.isidentifier() for name in found)


def test_two_objects_of_one_name_are_refused(monkeypatch):
    twice = (Named(0x2010, "Axis 1 gain"), Named(0x3010, "Gain"))
    monkeypatch.setattr(index_names, "OBJECTS", twice)
    with pytest.raises(ValueError, match="0x2010 and 0x3010 are both called GAIN"):
        index_names.names()
