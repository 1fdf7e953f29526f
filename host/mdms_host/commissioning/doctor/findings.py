"""The findings of `mdms doctor`: one table, from which `docs/troubleshooting.md` is made too."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of finding: its symptom, cause and cure.

    With a serious one the array does not run, or not as it should.
    """

    symptom: str
    cause: str
    cure: str
    serious: bool = True


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding: its kind by name, the nodes that have it, and the measurement."""

    kind: str
    text: str
    nodes: tuple[int, ...] = ()

    @property
    def row(self) -> Kind:
        """The row of its kind."""
        return KINDS[self.kind]


KINDS: Mapping[str, Kind] = {
    # The bus
    "silence": Kind(
        "No cell answers.",
        "No power, no connection, another bit rate than 1 Mbit/s, or an adapter that nobody "
        "acknowledges: frames that are not sent, or error frames, speak for the latter two.",
        "Check the 24 V and the cable; give the adapter -b 1000000; measure 60 ohm between CAN_H "
        "and CAN_L with the power off: 120 ohm means one terminator is missing, 40 one too many.",
    ),
    "bus-errors": Kind(
        "Error frames on the bus; runs end now and then with a cell that is silent.",
        "A missing or third terminator, long stubs, a node of another bit rate, or a bad plug.",
        "60 ohm between CAN_H and CAN_L with the power off, stubs below 30 cm; then take cells off "
        "one by one until the errors end.",
    ),
    "node-errors": Kind(
        "A cell's CAN controller counts errors, in sending or in receiving; one cell's, or all.",
        "At one cell: its plug, stub or transceiver, or another cell has its node id. At all: a "
        "missing or a third terminator. Counters fall with every good frame, so they show the "
        "present.",
        "One cell: another plug and cable, then another board. All: 60 ohm between CAN_H and CAN_L "
        "with the power off.",
    ),
    "adapter": Kind(
        "Garbled lines, or frames that the adapter does not take.",
        "A serial adapter that is too slow for the bus, a bad USB cable, or a busy computer.",
        "Another cable and USB port; prefer gs_usb or SocketCAN to SLCAN where 18 cells run.",
    ),
    "bus-off": Kind(
        "A cell was off the bus for a while (0x8140) since it was switched on.",
        "It could not send at all: a short of CAN_H and CAN_L, another bit rate, or no second node "
        "that acknowledges.",
        "Check its plug and transceiver; a cell that comes back drives only when it is enabled "
        "again.",
    ),
    "overrun": Kind(
        "A cell has lost frames.",
        "More frames than its inbox of 63 holds came while its program was held up, or the "
        "controller's FIFO ran over.",
        "Look for a node that floods the bus (python -m can.viewer); slow SYNC with "
        "wire.sync_period_s.",
        serious=False,
    ),
    "not-sent": Kind(
        "A cell could not send frames.",
        "The bus was full, or nobody acknowledged.",
        "As of error frames; and look at the load that mdms status reports.",
        serious=False,
    ),
    "other-host": Kind(
        "Another host's heartbeat is on the bus (node 127).",
        "mdms run, or another coordinator, is at work.",
        "End it; two hosts would steer the same wheels. Wheels are not turned meanwhile.",
        serious=False,
    ),
    # Who is there
    "missing": Kind(
        "A cell of the array file does not answer.",
        "It has no power, is not connected, has lost its node id, or was replaced.",
        "Look for its LEDs; a new board gets its place with mdms commission.",
    ),
    "unlisted": Kind(
        "A cell is there that the array file does not list.",
        "A board was added or replaced.",
        "mdms commission gives it a place and writes a new file.",
    ),
    "double-id": Kind(
        "Two cells have the same node id; one stays silent with error 0x8150, or both answer.",
        "A board came from another table, or ids were given by hand.",
        "mdms commission gives each its own: it goes by serial numbers.",
    ),
    "twin-serial": Kind(
        "Two cells have the same serial number.",
        "The serial number is made of the chip's own; two of four thousand million may agree, or a "
        "board was flashed with a fixed one.",
        "Take one off the bus and use another board: LSS cannot tell them apart.",
    ),
    "host-id": Kind(
        "A cell has node id 127.",
        "127 is the host's own.",
        "mdms configure assign --from FILE, or mdms commission, gives it another.",
    ),
    "blank": Kind(
        "Cells without a node id.",
        "They are new, or their board has no memory for settings (NUCLEO-G474RE).",
        "mdms commission, or mdms configure assign; --from FILE after each loss of power where "
        "boards have no memory.",
    ),
    "stranger": Kind(
        "A node is there that is no cell.",
        "Something else shares the bus.",
        "Give it a node id that no cell has, and leave it room: mdms scan shows it.",
        serious=False,
    ),
    "silent-node": Kind(
        "A node sends, but does not answer all questions.",
        "Its program hangs, two nodes answer at once, or it is an older firmware.",
        "Switch it off and on; mdms flash; look for double ids.",
    ),
    "other-protocol": Kind(
        "A cell speaks another revision of the protocol; a run refuses it.",
        "Firmware and host are of different versions.",
        "mdms flash brings the same version onto the board.",
    ),
    "versions": Kind(
        "Cells have different firmware, or another version than this host.",
        "Some were not flashed, or the host was updated.",
        "mdms flash for those named.",
        serious=False,
    ),
    # A cell
    "drive-fault": Kind(
        "An axis is in fault, and its wheel does not turn.",
        "As its error code says.",
        "Remove the cause; the next run resets the fault, and so does mdms jog --reset.",
    ),
    "supply-low": Kind(
        "The motors' supply is below the limit; wheels do not turn (0x3220).",
        "The emergency stop is pressed, a fuse blown, the supply too weak, or a stop relay stuck.",
        "Release the stop and reset its module; measure 24 V at the bridges, then at S of the stop "
        "circuit.",
    ),
    "supply-uneven": Kind(
        "A cell measures another supply than the rest.",
        "A loose or thin wire, or its divider of 100 kOhm over 8.2 kOhm.",
        "Compare with a meter at its terminals: wire if the meter agrees, divider if not.",
        serious=False,
    ),
    "clock": Kind(
        "A cell's heartbeats come at another period than it is set to.",
        "Its clock is off: a bad crystal, a clock that was set up wrongly, or a program that is "
        "held up.",
        "Restart it; if it stays, use another board: all its times, ramps and speeds are off too.",
    ),
    "sensor": Kind(
        "A presence sensor contradicts all others around it.",
        "Dirt, a loose plug, light from aside, or a stuck output.",
        "Clean it; look at mdms status while a hand covers the cell. On an empty table --empty "
        "names every sensor that is covered.",
    ),
    "heap": Kind(
        "Little heap is left on a cell.",
        "Something besides the firmware runs on the board, or an object table that grew.",
        "Restart it; mdms flash brings the firmware alone.",
        serious=False,
    ),
    "flash": Kind(
        "Little flash is left on a board.",
        "Files of others, or a long crash.log.",
        "mpremote fs ls, and delete files that are not of the firmware.",
        serious=False,
    ),
    "rolled-back": Kind(
        "Firmware that came over the bus did not stay, and the one before runs.",
        "It crashed, hung or lost its supply on trial, or the host fell silent before it had "
        "confirmed it.",
        "mdms flash --bus again; if it does not stay then either, look at crash.log over USB.",
        serious=False,
    ),
    "on-trial": Kind(
        "No axis can be enabled: firmware is on trial that nobody has confirmed.",
        "mdms flash --bus was broken off.",
        "Wait a minute, after which the firmware before comes back; then mdms flash --bus.",
    ),
    "settings": Kind(
        "A cell's settings are not those of the array file; a run refuses it.",
        "They were changed by hand, or lost.",
        "mdms commission --from FILE, or mdms configure load FILE --save.",
    ),
    # Cells together
    "neighbours": Kind(
        "Cells disagree about their neighbours or their places.",
        "A board has changed places, or was commissioned for another table.",
        "mdms commission --from FILE, or without a file if boards were moved.",
    ),
    "suspected": Kind(
        "Neighbours leave a cell out since it contradicts them (0x3015).",
        "Stuck sensors, a wheel that does not follow, or a cell in another's place.",
        "Look at its other findings; mdms status while something lies on it.",
    ),
    # Wheels, where they may turn
    "opposed": Kind(
        "A wheel runs away as soon as it is enabled (0x7302).",
        "Motor and encoder are wired against each other.",
        "Swap the motor's two wires, or the encoder's A and B: no setting can mend it.",
    ),
    "stands": Kind(
        "A wheel does not move, or its encoder does not see it.",
        "It is jammed or not connected, the bridge has no supply, or the encoder is dead.",
        "Turn it by hand and look at its position (0x6063): if that counts, the motor is off.",
    ),
    "scale": Kind(
        "A wheel is much faster or slower than its encoder says.",
        "Another gear, wheel or encoder than the resolution (0x2001) is for, one of its channels "
        "dead, or other motors than those of --scenario.",
        "mdms configure set resolution=COUNTS_PER_METRE --save; a quarter or half of the counts "
        "points at a channel.",
    ),
    "no-drive": Kind(
        "A drive does not come on.",
        "As its error says, or it steers by itself.",
        "As of a drive in fault.",
    ),
    # The emergency stop, where a person presses and releases it
    "stop-welded": Kind(
        "The emergency stop is pressed, and a cell still measures its supply.",
        "One cell: a contact of its stop relay is welded, or its sense wire is off. All: the "
        "contacts of the emergency stop or of its module are bridged or welded.",
        "Do not run the table. Exchange the relay, or the module; then test again.",
    ),
    "stop-delay": Kind(
        "The supply is still there when the time relay should have cut it (category 1).",
        "The contact of the time relay is welded, or its time is set too long.",
        "Do not run the table. Set the time to 1 s, or exchange the module; then test again.",
    ),
    "stop-silent": Kind(
        "A cell falls silent when the emergency stop is pressed.",
        "Its controller is supplied behind the emergency stop.",
        "Give controllers the 5 V supply that stays on.",
    ),
    "stop-stays": Kind(
        "The emergency stop is released, and a cell has no supply.",
        "A coil or wire of its stop relay is broken, or a contact that shorts a motor is welded.",
        "Measure 24 V at the coil; exchange the relay.",
    ),
    "stop-restarts": Kind(
        "The emergency stop is released, and a wheel is driven before anybody has asked for it.",
        "Another host enables the cell, its firmware is not of this version, or its bridge is "
        "damaged.",
        "Do not run the table. End other hosts, mdms flash, then test again; else another bridge.",
    ),
}
