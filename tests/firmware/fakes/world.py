"""The surroundings of the faked peripherals: levels, counts, a bus, and a stepped clock."""

now_ms = 0
board = None  # the owner of these pins; None: every requested pin is there
names = {}  # of pins in use, by the processor's names
levels = {}  # of pins, by name
analog = {}  # readings of ADCs [u16], by pin
conversions = 0  # of ADCs so far
counts = {}  # of encoders, by timer
pulses = {}  # widths of PWM pulses, by (timer, channel)
periods = {}  # of timers
registers = {}  # of peripherals, by address
sent = []  # frames that went over the bus: (identifier, data)
events = {}  # functions to call at a time, by millisecond
timers = []  # that have a callback
buses = []  # all CAN controllers
flash = None  # what `pyb.Flash` is about
told = []  # everything that was switched on or off for good, in its order
interrupts_off = False
fed_ms = None  # when the watchdog was fed last


def advance():
    """Let a millisecond pass: frames leave, timers fire, planned events happen."""
    global now_ms  # noqa: PLW0603 - there is one clock
    now_ms += 1
    for bus in buses:
        bus.pass_ms()
    for timer in timers:
        timer.fire()
    event = events.pop(now_ms, None)
    if event is not None:
        event()
