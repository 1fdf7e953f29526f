"""`mdms serve`: the virtual array in real time, for other programs."""

from argparse import Namespace
from contextlib import closing

from mdms_host.cli.exits import Exit
from mdms_host.cli.scenario.gain import open_program
from mdms_host.cli.streams import say
from mdms_model.scenario.scenario import Scenario
from mdms_sim.serve.server import Server, ways_in
from mdms_sim.simulation import Simulation, open_bank


def run(arguments: Namespace) -> Exit:
    """Serve until Ctrl-C, or until a parcel tips."""
    scenario = open_program(arguments.scenario, [*arguments.overrides, "run.fidelity=firmware"])
    try:
        return _serve(scenario, arguments)
    except KeyboardInterrupt:
        return Exit.OK


def _serve(scenario: Scenario, arguments: Namespace) -> Exit:
    cells = scenario.array.columns * scenario.array.rows
    with closing(open_bank(arguments.nodes, cells)) as bank:
        simulation = Simulation(scenario, bank, recorded=False)
        name = arguments.name or _name_of(arguments.scenario)
        with Server(simulation, name, arguments.tcp_port, arguments.speed, report=say) as server:
            print(f"{scenario.title}: {cells} cells on a virtual CAN bus; connect with")
            print(*(f"  {line}" for line in ways_in(server.addresses)), sep="\n", flush=True)
            server.run()
            for event in simulation.world.events:
                if event.kind == "tip":
                    say(f"mdms: {event.parcel} tips at {event.time_s:.3f} s: {event.detail}")
    return Exit.FAILURE


def _name_of(scenario: str) -> str:
    """The channel for a scenario: its name, or its file's."""
    return scenario.rsplit("/", 1)[-1].removesuffix(".toml")
