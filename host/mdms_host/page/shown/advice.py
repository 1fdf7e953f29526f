"""What a person can do about what an event says."""

#: By what an event says, the first that fits.
_ADVICE = (
    ("no cell was heard", "Check that the bus is connected and terminated and the cells powered."),
    ("fallen silent", "Check the cell's power and its bus plug."),
    ("no longer operational", "The cell has restarted: check its supply, then start again."),
    ("supply is below its limit", "Release the emergency stop, or mend the supply; start again."),
    ("supply was cut", "Release the emergency stop, look around, then start again."),
    ("disabled its drives", "Click on the cell for its errors; remove the cause and start again."),
    ("does not follow", "See whether the wheel is held or its encoder unplugged."),
    ("contradict all others", "Clean the cell's sensors, and look whether something lies on them."),
    ("has not been found", "Put the parcel where the program expects it, flat on the wheels."),
    ("press each other", "Move the parcels apart by hand, or give one of them another goal."),
    ("does not move as its cells", "See what holds the parcel; a new goal has it steered again."),
    ("does not get on", "See what holds the parcel; a new goal has it steered again."),
    ("another host", "Only one program may drive the cells: end the other one."),
    ("not set up as this run expects", "`mdms configure restore` sets the cell back."),
    ("settings not written", "Start the program again; `mdms configure show` says what differs."),
    ("supports no longer hold", "Lift the parcel and set it down where more wheels carry it."),
    ("suspects", "The cell that is suspected may be in the wrong place, or its sensors stuck."),
    ("not confirmed to be off", "Cut the motors' power."),
    ("transmit queue stays full", "Does anybody acknowledge frames, and is the bit rate right?"),
    ("too busy", "Lower the speed, or close what else runs on this machine."),
)


def advice_for(text: str) -> str | None:
    """What to do about an event; None where there is nothing to do."""
    return next((advice for says, advice in _ADVICE if says in text), None)
