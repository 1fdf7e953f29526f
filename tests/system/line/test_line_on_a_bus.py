"""`mdms run` with both servers, on a served table: protocols, order book and the truth agree."""

import asyncio
from pathlib import Path
from typing import Any

import pytest
from tests.system.line.controller import EXECUTE, PATIENCE_S, STOPPED, admit_user
from tests.system.line.opcua import opcua_client
from tests.system.links.going_away import Plant

pytestmark = [pytest.mark.real_time, pytest.mark.slow]
pytest.importorskip("asyncua")


def test_both_servers_and_the_table_agree_about_an_order(tmp_path: Path) -> None:
    admit_user(tmp_path)
    with Plant(tmp_path, "mdms", "--opcua", "0") as plant:
        controller = plant.controller
        assert controller.order(2, "", "P-1")[0] == 0
        assert controller.order(0, "o1", "P-1", exit=2) == (0, 1)
        plant.bring_to_execute()
        plant.until_with_beats(lambda: controller.order(3, "o1")[1] == 4, PATIENCE_S)
        assert controller.command(3)
        controller.until_state(STOPPED)
        shown = asyncio.run(_shown(plant.opcua, tmp_path))
        assert (shown["State"], shown["StateName"]) == (STOPPED, "Stopped")
        assert shown["order"][0] == "left"
        assert (0, shown["ParcelsOut"]) == controller.read(12, 2)
        assert (0, shown["ParcelsRejected"]) == controller.read(86, 2)
        by_exit = shown["ParcelsOutByExit"]
        assert by_exit[1] >= 1
        assert sum(by_exit) == shown["ParcelsOut"]
        assert controller.read(20, 6) == (0, by_exit[0], 0, by_exit[1], 0, by_exit[2])
        execute_s = shown["StateTimes"][EXECUTE - 1]
        assert execute_s > 0.5
        assert controller.read(52 + 2 * (EXECUTE - 1), 2) == (0, round(execute_s))
    left = [event for event in plant.simulation.world.events if event.kind == "exit"]
    assert left[0].parcel == "box 1"
    exits = [each.name for each in plant.scenario.exit]
    assert left[0].detail.startswith(f"leaves by {exits[1]}")
    assert any("order o1: P-1 left" in line for line in plant.said)


async def _shown(address: str, folder: Path) -> dict[str, Any]:
    """The variables of `Line`, and the order, as an OPC UA client of a user reads them."""
    async with await opcua_client(address, folder) as client:
        index = await client.get_namespace_index("urn:mdms-array:line")
        line = await client.nodes.objects.get_child([f"{index}:Table", f"{index}:Line"])
        names = ("State", "StateName", "ParcelsOut", "ParcelsOutByExit", "ParcelsRejected")
        names += ("StateTimes",)
        values = {
            name: await (await line.get_child(f"{index}:{name}")).read_value() for name in names
        }
        order = await line.call_method(f"{index}:GetOrder", "o1")
        await line.call_method(f"{index}:ParcelComing", "P-2", "")
        await line.call_method(f"{index}:ParcelNotComing", "P-2")
    return {**values, "order": list(order)}
