"""Colours that stand for the same in pictures, animations and scenes."""

from mdms_model.scenario.scenario import Scenario

#: One a parcel; the first six are told apart by people with any kind of colour vision (Okabe, Ito).
PARCEL_COLOURS = (
    *("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"),
    *("#6a4c93", "#7a8b1e", "#8c6a2f", "#a23b72", "#2f4858", "#4aa3a2"),
)
#: Wheels that run ahead and back, and that slip.
AHEAD, BACK, SLIPS = "#0072b2", "#9a5bb0", "#d6124a"
COVERED = "#19b35a"


def parcel_colour(number: int) -> str:
    """The colour of a parcel by its place in the scenario."""
    return PARCEL_COLOURS[number % len(PARCEL_COLOURS)]


def colours_of(scenario: Scenario) -> list[str]:
    """The colours of all parcels: their own or, where they come and go, those of their kinds.

    Then parcels of a kind are alike, and host and truth need not call them by the same names.
    """
    if not scenario.stream:
        return [parcel_colour(number) for number in range(len(scenario.parcel))]
    kinds = list(dict.fromkeys(parcel.kind or parcel.name for parcel in scenario.parcel))
    return [parcel_colour(kinds.index(each.kind or each.name)) for each in scenario.parcel]


def between(one: str, other: str, share: float) -> str:
    """The colour at this share of the way from one to another."""
    pairs = zip(_parts(one), _parts(other), strict=True)
    return "#" + "".join(f"{round(low + share * (high - low)):02x}" for low, high in pairs)


def unit_rgb(colour: str) -> tuple[float, float, float]:
    """Red, green and blue from 0 to 1."""
    red, green, blue = (round(part / 255, 3) for part in _parts(colour))
    return red, green, blue


def _parts(colour: str) -> tuple[int, int, int]:
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
