"""Events of parcels that come and leave, as they are written and read again."""

from mdms_model.run.record import Event

_BY = "leaves by "
_WRONG = ", which is not for its kind"


def leaving(time_s: float, parcel: str, exit_name: str, wrong: bool) -> Event:
    """A parcel leaves by an exit; `wrong` is whether that is for other kinds."""
    return Event(time_s, "exit", f"{_BY}{exit_name}" + _WRONG * wrong, parcel=parcel)


def exit_of(event: Event) -> str:
    """The exit by which a parcel has left."""
    return event.detail.removeprefix(_BY).removesuffix(_WRONG)


def is_wrong(event: Event) -> bool:
    """Whether that exit is for other kinds."""
    return event.detail.endswith(_WRONG)
