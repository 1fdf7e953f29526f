"""Parcels that may come are announced under free names, one of each kind at each infeed."""

import numpy as np

from mdms_host.estimation.parcel import Parcel
from mdms_host.programs.newcomers import Comings, Infeed, tracker_gate
from mdms_host.programs.order import Gate


class Register:
    def __init__(self):
        self.announced = []
        self.parcels = {}

    def announce(self, parcel, region=None):
        assert parcel.name not in self.parcels
        self.parcels[parcel.name] = parcel
        self.announced.append((parcel.name, parcel.near_m, region.low_m))

    def depart(self, name, gate=None):
        raise AssertionError("nothing leaves here")

    @property
    def names(self):
        names = [name for name, *_ in self.announced]
        self.announced.clear()
        return names


def parcels(kind, count):
    return tuple(Parcel(f"{kind} {number}", 0.3, 0.3) for number in range(1, count + 1))


def infeed(name="west", x_m=-0.3):
    stock = {"box": parcels("box", 2), "disc": parcels("disc", 1)}
    return Infeed(name, np.array([x_m, 0.0, 0.1]), stock)


def test_the_first_free_name_of_each_kind_is_announced_once():
    register, comings = Register(), Comings([infeed()])
    comings.step(register, ())
    assert register.announced[0] == ("box 1", (-0.3, 0.0), (-0.4, -0.1))
    assert register.names == ["box 1", "disc 1"]
    comings.step(register, ())
    assert register.names == []


def test_when_one_has_come_the_next_of_its_kind_may():
    register, comings = Register(), Comings([infeed()])
    comings.step(register, ())
    comings.step(register, {"box 1"})
    assert register.names == ["box 1", "disc 1", "box 2"]
    comings.step(register, {"box 1", "box 2", "disc 1"})
    assert register.names == []
    del register.parcels["box 1"]  # it has left
    comings.step(register, {"box 2", "disc 1"})
    assert register.names == ["box 1"]


def test_the_name_of_a_parcel_that_is_sought_is_not_free():
    """It was found for an instant, and is believed nowhere now."""
    register, comings = Register(), Comings([infeed()])
    comings.step(register, ())
    comings.step(register, {"box 1", "disc 1"})
    comings.step(register, {"box 2"})
    assert register.names == ["box 1", "disc 1", "box 2"]


def test_gates_of_the_tracker_face_outward():
    gate = tracker_gate(Gate("south", (1, -1), 0.127, 0.0, 0.2))
    assert (gate.x_m, gate.y_m) == (0.1, -0.127)
    assert gate.past_m(np.array([0.1, -0.2])) > 0.07
