"""Rules of the lists of buses: every cell is on one bus, and each bus has node ids for all."""

from mdms_model.buses import address_cells, plan_gateways
from mdms_model.scenario.scenario import Array, Scenario, ScenarioError

#: Node ids go up to 127, which is the host's own.
MOST_NODES = 126


def check_buses(scenario: Scenario) -> None:
    """Refuse cells on no bus or on two. Raises `ScenarioError` with the key's full path."""
    array, firmware = scenario.array, scenario.run.fidelity == "firmware"
    if firmware and not array.buses and array.columns * array.rows > MOST_NODES:
        raise ScenarioError(
            f"array has {array.columns} x {array.rows} cells, but one bus takes at most "
            f"{MOST_NODES}; give it several with array.buses, make it smaller or set "
            "run.fidelity to 'ideal'"
        )
    if array.forwarded and len(array.buses) < 2:
        raise ScenarioError("array.forwarded needs several buses; list their cells in array.buses")
    if array.buses:
        _check_lists(array)
        _check_forwarding(array)


def _check_lists(array: Array) -> None:
    cells = array.columns * array.rows
    bus_of: dict[int, int] = {}
    for bus, numbers in enumerate(array.buses):
        if not 1 <= len(numbers) <= MOST_NODES:
            raise ScenarioError(
                f"array.buses.{bus} has {len(numbers)} items, but must have 1 to {MOST_NODES}"
            )
        for place, number in enumerate(numbers):
            key = f"array.buses.{bus}.{place}"
            if number > cells:
                raise ScenarioError(f"{key} is {number}, but the array has {cells} cells")
            if number in bus_of:
                raise ScenarioError(
                    f"{key} is {number}, but cell {number} is in array.buses.{bus_of[number]} "
                    "already; name each cell once"
                )
            bus_of[number] = bus
    missing = sorted(set(range(1, cells + 1)) - bus_of.keys())
    if missing:
        raise ScenarioError(
            f"array.buses lacks cell {missing[0]}; put each of the {cells} cells on a bus"
        )


def _check_forwarding(array: Array) -> None:
    addresses = address_cells(array.columns * array.rows, array.buses)
    try:
        plan_gateways(array.columns, array.rows, addresses, array.forwarded)
    except ValueError as error:
        raise ScenarioError(f"array.forwarded: {error}; put fewer cells on it") from None
