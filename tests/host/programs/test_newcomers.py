"""Parcels that a program announces, or names where they lie."""

import numpy as np
import pytest
from tests.host.programs.hands import Stage

from mdms_host.estimation.belief import Belief, BeliefKind
from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.parcel import Parcel
from mdms_host.estimation.size import Size
from mdms_host.programs.table import Newcomer, ProgramError

SEEN = Size(0.30, 0.26, (0.02, 0.02), 0.1)
CRATE = Newcomer("crate", 0.3, 0.26, kind="crate", mass_kg=1.5)


class Register:
    """Refuses as the tracker does; a taken parcel is found when a test puts it on the stage."""

    def __init__(self, stage, size=SEEN):
        self.stage, self.expected, self.gone, self.withdrawn = stage, {}, [], []
        self._size = size
        stage.program.attend(self)

    def announce(self, parcel, region=None):
        self._add(parcel, region)

    @property
    def parcels(self):
        there = {name: Parcel(name, 0.3, 0.3) for name in self.stage.beliefs}
        return there | {name: parcel for name, (parcel, _) in self.expected.items()}

    def name(self, unknown, parcel):
        if unknown not in self.stage.beliefs:
            raise KeyError(unknown)
        self._add(parcel, unknown)

    def size(self, name):
        return self._size

    @property
    def is_clear(self):
        return not self.stage.beliefs

    def lay_there(self, name):
        return False

    def take_withdrawn(self):
        withdrawn, self.withdrawn = self.withdrawn, []
        return withdrawn

    def depart(self, name, gate=None):
        del self.expected[name]
        self.gone.append(name)

    def _add(self, parcel, where):
        if parcel.name in {*self.expected, *self.stage.beliefs}:
            raise ValueError(f"there is a parcel {parcel.name!r} already")
        self.expected[parcel.name] = parcel, where


def lay_unknown(stage, x_m=0.1):
    outline, pose = Rectangle(0.4, 0.36), np.array([x_m, 0.0, 0.0])
    stage.beliefs["unknown-1"] = Belief(
        "unknown-1", outline, pose, np.zeros(3), np.zeros((3, 3)), kind=BeliefKind.UNKNOWN
    )


def naming(newcomer, x_m=0.15):
    async def main(table):
        parcel = await table.name(newcomer, x_m, 0.05)
        await parcel.move(-0.2, 0.0)

    stage = Stage(main)
    return stage, Register(stage)


def test_a_thing_at_a_place_is_named_found_and_moved():
    stage, register = naming(CRATE)
    lay_unknown(stage)
    stage.run(0.1)
    parcel, unknown = register.expected["crate"]
    assert (parcel.length_m, parcel.width_m, unknown) == (0.3, 0.26, "unknown-1")
    assert stage.program.table.unknown == {"unknown-1": (0.1, 0.0)}
    del stage.beliefs["unknown-1"]
    stage.put("crate", 0.1)
    stage.run(0.1)
    assert stage.log == [("crate", -0.2)]
    assert stage.program.table["crate"].kind == "crate"
    known, mass = stage.hands.known["crate"]
    assert (known.name, mass.mass_kg) == ("crate", 1.5)


def test_without_a_size_that_of_the_sensors_is_taken():
    stage, register = naming(Newcomer("crate"))
    lay_unknown(stage)
    stage.run(0.1)
    parcel, _ = register.expected["crate"]
    assert (parcel.length_m, parcel.width_m, parcel.spread_m) == (0.30, 0.26, 0.01)


@pytest.mark.parametrize(
    ("newcomer", "x_m", "size", "text"),
    [
        (CRATE, -0.3, SEEN, "nothing unknown lies at (-0.3 m, 0.05 m)"),
        (CRATE, "-0.3", SEEN, "x_m of crate is '-0.3', but must be a number"),
        (Newcomer("crate"), 0.15, None, "unknown-1 is no rectangle: crate needs a size"),
        (Newcomer("box 1", 0.3), 0.15, SEEN, "there is a parcel 'box 1' already"),
        (CRATE, 0.15, SEEN, "unknown-1 has not the outline of crate"),
    ],
)
def test_a_thing_that_cannot_be_named_is_refused_with_the_reason(newcomer, x_m, size, text):
    stage, _ = naming(newcomer, x_m)
    register = Register(stage, size)
    lay_unknown(stage)
    stage.put("box 1")
    stage.run(3.5)
    assert text in stage.program.stuck
    assert register.gone == ([newcomer.name] if "outline" in text else [])
    assert not register.expected


def test_a_thing_whose_outline_sensors_contradict_is_refused_with_the_reason():
    stage, register = naming(CRATE)
    lay_unknown(stage)
    stage.run(0.1)
    # So does the tracker, which knows the thing as before.
    del register.expected["crate"]
    stage.run(3.5)
    assert "unknown-1 has not the outline of crate" in stage.program.stuck
    assert not stage.program.failed


def test_a_parcel_that_is_announced_arrives():
    seen = []

    async def main(table):
        table.announce(CRATE, near_m=(-0.2, 0.0))
        with pytest.raises(ProgramError, match="needs a size"):
            table.announce(Newcomer("bag"))
        seen.append((await table.arrival()).name)

    stage = Stage(main)
    register = Register(stage)
    stage.run(0.5)
    assert register.expected["crate"][1].low_m == pytest.approx((-0.3, -0.1))
    assert stage.program.endless
    stage.come("crate")
    assert seen == ["crate"]
    assert stage.program.finished


def test_a_parcel_that_is_heavier_than_the_emergency_stop_holds_is_not_taken():
    stage, register = naming(CRATE)
    stage.program.attend(register, 1.4)
    lay_unknown(stage)
    stage.run(0.5)
    told = "crate has 1.5 kg, but the table's emergency stop holds 1.4 kg at most (stop.mass_kg)"
    assert told in stage.program.stuck
    assert not register.expected


def test_a_parcel_as_heavy_as_the_emergency_stop_holds_is_taken():
    stage, register = naming(CRATE)
    stage.program.attend(register, 1.5)
    lay_unknown(stage)
    stage.run(0.1)
    assert "crate" in register.expected


def test_a_false_newcomer_is_withdrawn_and_the_parcel_is_expected_again():
    came = []

    async def main(table):
        table.announce(CRATE, (-0.4, 0.0))
        for _ in range(2):
            crate = await table.arrival()
            came.append(table.now_s)
            await crate.move(0.2, 0.0)

    stage = Stage(main)
    register = Register(stage)
    stage.run()
    stage.put("crate")
    stage.run(0.1)
    parcel, region = register.expected.pop("crate")
    del stage.beliefs["crate"]
    register.withdrawn.append((parcel, region))
    stage.run(0.1)
    assert register.expected == {"crate": (parcel, region)}
    assert stage.program.table.parcels == ()
    stage.put("crate")
    stage.run(0.1)
    stage.arrive("crate")
    assert len(came) == 2
    assert stage.program.finished


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"length_m": float("nan")}, "length_m of crate is nan, but must be above 0"),
        ({"width_m": -0.3}, "width_m of crate is -0.3"),
        ({"length_m": "0.3"}, "length_m of crate is '0.3'"),
        ({"mass_kg": 0.0}, "mass_kg of crate is 0.0"),
        ({"mass_kg": 1e-300}, "mass_kg of crate is 1e-300, but must be at least 1e-06 and at most"),
        ({"mass_kg": 1e308}, "mass_kg of crate is 1e.308, but must be at least 1e-06 and at most"),
        ({"shape": "star"}, "shape of crate is 'star', but must be one of"),
    ],
)
def test_a_newcomer_that_no_parcel_can_be_is_refused(wrong, told):
    with pytest.raises(ProgramError, match=told):
        Newcomer("crate", **wrong)


def test_a_newcomer_is_announced_near_numbers_only():
    async def main(table):
        table.announce(CRATE, near_m=(float("nan"), 0.0))

    stage = Stage(main)
    register = Register(stage)
    stage.run(1.0)
    assert stage.program.stuck.startswith(
        "the program was broken off: x_m of crate is nan, but must be a number from "
    )
    assert not register.expected
