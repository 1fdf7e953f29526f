"""What clients of OPC UA may write and call, with a client of asyncua."""

import asyncio
import socket
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from asyncua import ua
from tests.free_port import free_port
from tests.host.line.played_table import PlayedTable, plant_in
from tests.system.line.opcua import opcua_client

from mdms_host.line.opcua import LINE_URI, MOST_CONNECTIONS, OpcUaServer, certificate_of
from mdms_host.line.plant import Plant

pytestmark = pytest.mark.slow


class Served:
    """A plant that is served, its table, and the object `Line` as a client has it."""

    def __init__(self, plant: Plant, table: PlayedTable, server: OpcUaServer, line: Any) -> None:
        self.plant = plant
        self.table = table
        self.server = server
        self.line = line

    async def show(self) -> None:
        """Have the table send a snapshot, and the server show it."""
        await self.table.show(self.plant)
        await self.server.show()


def with_client(folder: Path, talk: Callable[[Served], Awaitable[None]]) -> None:
    """Have a client talk to the server of a plant."""
    key, certificate, _ = certificate_of("localhost", 1)
    (folder / "key.pem").write_bytes(key)
    (folder / "certificate.der").write_bytes(certificate)
    settings = {
        "users": {"plc": "secret"},
        "anonymous": False,
        "certificate": str(folder / "certificate.der"),
        "key": str(folder / "key.pem"),
        "cells": 1,
    }

    async def serve() -> None:
        async with plant_in(folder) as (plant, table):
            server = OpcUaServer(plant, "a table")
            await server.open("127.0.0.1", free_port(), settings)
            try:
                async with await opcua_client(server.address, folder) as client:
                    own = await client.get_namespace_index(LINE_URI)
                    line = await client.nodes.objects.get_child([f"{own}:Table", f"{own}:Line"])
                    await talk(Served(plant, table, server, line))
            finally:
                await server.close()

    asyncio.run(serve())


def number(value: int) -> ua.Variant:
    return ua.Variant(value, ua.VariantType.UInt32)


BAD = ua.StatusCode(ua.StatusCodes.BadNotConnected)
UNCERTAIN = ua.StatusCode(ua.StatusCodes.UncertainLastUsableValue)


def test_only_numbers_of_good_status_are_heartbeats(tmp_path: Path) -> None:
    async def talk(served: Served) -> None:
        heartbeat = await served.line.get_child(
            f"{served.line.nodeid.NamespaceIndex}:ClientHeartbeat"
        )
        for written, beats in (
            (ua.DataValue(number(7)), 1),
            (ua.DataValue(number(8), BAD), 1),
            (ua.DataValue(number(9), UNCERTAIN), 1),
            (ua.DataValue(ua.Variant([1, 2], ua.VariantType.UInt32)), 1),
            (ua.DataValue(number(7)), 1),
            (ua.DataValue(number(8)), 2),
        ):
            await heartbeat.write_value(written)
            # It counts when it comes, and not with the next snapshot.
            assert len(served.table.named("beat")) == beats, written

    with_client(tmp_path, talk)


TEXT, NUMBER, WHOLE, TRUTH = (
    *(ua.VariantType.String, ua.VariantType.Double, ua.VariantType.Int32),
    ua.VariantType.Boolean,
)
NOTHING = ua.Variant(None, ua.VariantType.Null)


def texts(*values: str | None) -> tuple[ua.Variant, ...]:
    return tuple(ua.Variant(value, TEXT) for value in values)


def test_arguments_of_other_types_or_numbers_are_invalid_and_nothing_is_done(
    tmp_path: Path,
) -> None:
    to_north = texts("k1", "P", "north")
    calls = [
        ("GiveOrderToExit", to_north),
        ("GiveOrderToExit", (*to_north, NOTHING)),
        ("GiveOrderToExit", (*to_north, *texts("high"))),
        ("GiveOrderToExit", (*to_north, ua.Variant(2**63, ua.VariantType.UInt64))),
        ("GiveOrderToExit", (*to_north, ua.Variant([1], WHOLE))),
        ("GiveOrderToExit", (*to_north, ua.Variant(0, WHOLE), ua.Variant(0, WHOLE))),
        ("GiveOrderToPose", (*texts("k2", "P", "x", "y", "yaw"), ua.Variant(0, WHOLE))),
        ("GetOrder", (ua.Variant(5, WHOLE),)),
        ("CancelOrder", (NOTHING,)),
        ("ParcelComing", (ua.Variant(5, WHOLE), ua.Variant(7, WHOLE))),
        ("ParcelNotComing", ()),
        ("SetExitFull", texts("north", "no")),
        ("ChooseRecipe", (NOTHING,)),
        ("SetIdealRate", texts("x")),
    ]

    async def talk(served: Served) -> None:
        own = served.line.nodeid.NamespaceIndex
        before = len(served.table.told)
        for name, arguments in calls:
            with pytest.raises(ua.uaerrors.BadInvalidArgument):
                await served.line.call_method(f"{own}:{name}", *arguments)
        place = ua.Variant(0.0, NUMBER)
        for angle_rad in (float("inf"), 1e300):
            pose = place, place, ua.Variant(angle_rad, NUMBER), ua.Variant(0, WHOLE)
            with pytest.raises(ua.uaerrors.BadInvalidState):
                await served.line.call_method(f"{own}:GiveOrderToPose", *texts("k", "P"), *pose)
        assert len(served.table.told) == before
        assert served.plant.book.counts() == {}
        await served.line.call_method(f"{own}:ParcelComing", *texts("P", None))
        assert served.table.named("coming")[0]["kind"] == ""
        await served.line.call_method(
            f"{own}:SetExitFull", *texts("north"), ua.Variant(True, TRUTH)
        )
        given = await served.line.call_method(
            f"{own}:GiveOrderToExit", *to_north, ua.Variant(1, WHOLE)
        )
        assert given == ["accepted", True]
        # A client may guess the types of numbers.
        for guessed in (1, ua.Variant(1, ua.VariantType.Byte)):
            given = await served.line.call_method(f"{own}:GiveOrderToExit", *to_north, guessed)
            assert given == ["accepted", False]
        await served.line.call_method(f"{own}:SetIdealRate", 600)

    with_client(tmp_path, talk)


def test_a_crowd_that_opens_no_session_disturbs_no_client(tmp_path: Path) -> None:
    async def talk(served: Served) -> None:
        (transport,) = served.server._server.iserver.asyncio_transports
        connection = transport.get_extra_info("socket")
        # A client whose cable was pulled is found out.
        assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        place = ("127.0.0.1", int(served.server.address.split(":")[2].split("/")[0]))
        crowd = []
        for _ in range(MOST_CONNECTIONS + 20):
            crowd.append(socket.create_connection(place))
            await asyncio.sleep(0)
        await served.line.read_browse_name()
        # The last ones are closed, and hold no file descriptor.
        crowd[-1].setblocking(False)
        closed = asyncio.get_running_loop().sock_recv(crowd[-1], 1)
        assert await asyncio.wait_for(closed, 5.0) == b""
        for each in crowd:
            each.close()

    with_client(tmp_path, talk)


def test_few_nodes_are_looked_at_when_a_parcel_leaves(tmp_path: Path) -> None:
    async def talk(served: Served) -> None:
        parcels = [
            {"parcel": name, "kind": "box", "pose": [0.0, 0.0, 0.0]} for name in ("box 1", "box 2")
        ]
        folder = await served.line.get_child(f"{served.line.nodeid.NamespaceIndex}:Parcels")

        async def shown(there: list[dict[str, Any]]) -> list[str]:
            await served.table.show(served.plant, parcels=there)
            await served.server.show()
            return [(await each.read_browse_name()).Name for each in await folder.get_children()]

        space = served.server._server.iserver.aspace
        assert await shown([]) == []
        before = len(space._nodes)
        assert await shown(parcels) == ["box 1", "box 2"]
        gone = (await folder.get_children())[0]
        nodes = space._nodes = CountingDict(space._nodes)
        assert await shown(parcels[1:]) == ["box 2"]
        assert nodes.looks < 500
        with pytest.raises(ua.UaStatusCodeError):
            await gone.read_browse_name()
        assert await shown([]) == []
        assert len(nodes) == before
        assert await shown(parcels) == ["box 1", "box 2"]

    with_client(tmp_path, talk)


class CountingDict(dict[Any, Any]):
    """A dictionary that counts how often one of its values is read."""

    looks = 0

    def __getitem__(self, key: Any) -> Any:
        self.looks += 1
        return super().__getitem__(key)
