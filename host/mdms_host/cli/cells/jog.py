"""`mdms jog`: one wheel turns for a time, or while a key is held down."""

import json
from argparse import Namespace
from collections.abc import Callable

from mdms_host.cli.cells.asking import LEAVE, pressed_keys
from mdms_host.cli.cells.configure_cells import open_commissioning, present_nodes
from mdms_host.cli.exits import CommandError, ExitCode
from mdms_host.cli.streams import say
from mdms_host.clock import Clock, MonotonicClock
from mdms_host.commissioning.cell_settings import check_identity
from mdms_host.commissioning.commissioner import wiring_fault
from mdms_host.commissioning.jog import STANDS, Jog
from mdms_host.commissioning.table_cells import table_of
from mdms_host.commissioning.wheel_turn import (
    Direction,
    Turn,
    limit_for,
    refuse_busy,
    refuse_steering,
    turn_wheel,
)

#: Keyboards repeat a key that is held down after half a second at the latest.
KEY_S = 0.6
#: How long a jog by keys goes on that nobody ends.
_KEYS_S = 600.0
_KEYS = {"+": 1, "f": 1, "-": -1, "b": -1}


def run(arguments: Namespace) -> ExitCode:
    """Turn the wheel, and say how far it went. Raises `CommandError` where it stands."""
    node_id, axis = arguments.node, arguments.axis
    table = table_of(arguments)
    if table.is_split:
        raise CommandError(
            f"--node: each bus has node ids of its own, and there are {len(table.buses)}: "
            f"{', '.join(table.channels)}; name one of them with -c",
            ExitCode.USAGE,
        )
    with open_commissioning(table.options) as commissioning:
        present_nodes(commissioning, [node_id])
        check_identity(node_id, commissioning.identity(node_id))
        refuse_busy(commissioning, [node_id])
        refuse_steering(commissioning, node_id)
        limit_mv = limit_for(commissioning, node_id, axis, arguments.speed)
        if arguments.keys:
            with pressed_keys("--keys needs a terminal; give --seconds") as pressed:
                say("hold + or - to turn the wheel, q to end")
                jog = Jog(node_id, axis, 0.0, _KEYS_S, limit_mv=limit_mv)
                jog.resets = arguments.reset
                by_keys = ByKeys(jog, arguments.speed, MonotonicClock(), pressed)
                turn = turn_wheel(commissioning, node_id, axis, jog, by_keys.look)
        else:
            jog = Jog(node_id, axis, arguments.speed, arguments.seconds, limit_mv=limit_mv)
            jog.resets = arguments.reset
            turn = turn_wheel(commissioning, node_id, axis, jog)
    _report(arguments, turn)
    way_m = 0.0 if arguments.keys else abs(arguments.speed) * arguments.seconds
    if jog.stands or abs(turn.distance_m) < STANDS * way_m:
        stands = wiring_fault(axis, Direction.STANDS)
        raise CommandError(f"node {node_id}, {stands}", ExitCode.NODE_FAULT)
    return ExitCode.OK


class ByKeys:
    """Turns a wheel while a key is pressed again and again, as by holding it down.

    `pressed()` returns the keys since it was called last.
    """

    def __init__(
        self, jog: Jog, speed_m_s: float, clock: Clock, pressed: Callable[[], str]
    ) -> None:
        self._jog = jog
        self._speed_m_s = speed_m_s
        self._clock = clock
        self._pressed = pressed
        self._until_s = 0.0

    def look(self) -> None:
        """Obey the keys; any other key, and none for a while, stops the wheel."""
        now_s = self._clock.now_s()
        for key in self._pressed():
            if key in LEAVE:
                self._jog.end()
            self._jog.steer(_KEYS.get(key, 0) * self._speed_m_s)
            self._until_s = now_s + KEY_S
        if now_s >= self._until_s:
            self._jog.steer(0.0)


def _report(arguments: Namespace, turn: Turn) -> None:
    if arguments.json:
        figures = {"distance_m": turn.distance_m, "peak_m_s": turn.peak_m_s}
        print(json.dumps({"node": arguments.node, "axis": arguments.axis, **figures}))
        return
    print(
        f"node {arguments.node}, axis {arguments.axis}: {turn.distance_m * 1e3:.1f} mm by its "
        f"encoder, {turn.peak_m_s:.3f} m/s at most; off again"
    )
