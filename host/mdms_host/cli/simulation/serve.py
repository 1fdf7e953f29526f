"""`mdms serve`: the virtual array in real time, for other programs."""

import math
from argparse import ArgumentTypeError, Namespace
from contextlib import closing
from typing import TYPE_CHECKING

from mdms_host.cli.console import say
from mdms_host.cli.exits import CommandError, Exit
from mdms_host.cli.options import Verbs, add_nodes, add_scenario
from mdms_host.cli.scenario.inputs import open_program, refusing_bad_scenarios

if TYPE_CHECKING:
    from mdms_model.scenario.scenario import Scenario

#: Beyond this no machine keeps up.
SPEED_MAX = 100.0
PORT_MAX = 65535


def add_to(verbs: Verbs) -> None:
    """Register the verb."""
    parser = verbs.add_parser("serve", help="run the virtual array in real time for other programs")
    add_scenario(parser)
    parser.add_argument("--name", help="python-can's channel (default: the scenario's name)")
    add_nodes(parser)
    parser.add_argument("--speed", type=_speed, default=1.0, help="times real time (default 1)")
    parser.add_argument(
        "--tcp-port", type=_port, default=0, help="of SLCAN on loopback (default: a free one)"
    )
    parser.set_defaults(run=run)


def run(arguments: Namespace) -> Exit:
    """Serve until Ctrl-C, or until a parcel tips."""
    from mdms_host.cli.simulation.compose import telling_of_nodes
    from mdms_sim.serve.endpoint import ServeError

    scenario = open_program(arguments.scenario, [*arguments.overrides, "run.fidelity=firmware"])
    try:
        with refusing_bad_scenarios(), telling_of_nodes():
            return _serve(scenario, arguments)
    except KeyboardInterrupt:
        return Exit.OK
    except ServeError as error:
        raise CommandError(str(error), Exit.FAILURE) from None


def _serve(scenario: "Scenario", arguments: Namespace) -> Exit:
    from mdms_sim.serve.server import Server, ways_in
    from mdms_sim.simulation import Simulation, open_bank

    cells = scenario.array.columns * scenario.array.rows
    with closing(open_bank(arguments.nodes, cells)) as bank:
        simulation = Simulation(scenario, bank, recorded=False)
        name = arguments.name or _name_of(arguments.scenario)
        with Server(simulation, name, arguments.tcp_port, arguments.speed, tell=say) as server:
            print(f"{scenario.title}: {cells} cells on a virtual CAN bus; connect with")
            print(*(f"  {line}" for line in ways_in(server.doors)), sep="\n", flush=True)
            server.run()
            for event in simulation.world.events:
                if event.kind == "tip":
                    say(f"mdms: {event.parcel} tips at {event.time_s:.3f} s: {event.detail}")
    return Exit.FAILURE


def _name_of(scenario: str) -> str:
    """The channel for a scenario: its name, or its file's."""
    return scenario.rsplit("/", 1)[-1].removesuffix(".toml")


def _speed(text: str) -> float:
    speed = float(text)
    if not math.isfinite(speed) or not 0 < speed <= SPEED_MAX:
        raise ArgumentTypeError(f"{text} is not above 0 and at most {SPEED_MAX:g}")
    return speed


def _port(text: str) -> int:
    port = int(text)
    if not 0 <= port <= PORT_MAX:
        raise ArgumentTypeError(f"{text} is not 0 to {PORT_MAX}")
    return port
