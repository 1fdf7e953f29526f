"""A controller by OPC UA: brings the table to Execute, has a box leave to the north, and stops.

python examples/line/opcua_controller.py URL FOLDER USER PASSWORD, beside `mdms serve
examples/line/table.toml --opcua 4840`. FOLDER has a certificate of `mdms line certificate`.
"""

import asyncio
import sys
import time

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

url, folder, user, password = sys.argv[1:]
files = f"{folder}/certificate.der", f"{folder}/key.pem"
order = f"{time.time():.0f}"
parcel = f"P-{order}"


async def main() -> None:
    """From Stopped to Execute and back."""
    client = Client(url)
    client.application_uri = "urn:mdms-array:table"  # that of the certificate
    client.set_user(user)
    client.set_password(password)
    await client.set_security(SecurityPolicyBasic256Sha256, *files)
    async with client:
        packml = await client.get_namespace_index("http://opcfoundation.org/UA/PackML/")
        own = await client.get_namespace_index("urn:mdms-array:line")
        table = await client.nodes.objects.get_child(f"{own}:Table")
        line = await table.get_child(f"{own}:Line")
        machine = await table.get_child([f"{packml}:BaseStateMachine", f"{packml}:MachineState"])
        execute = await machine.get_child(f"{packml}:ExecuteState")
        state = await line.get_child(f"{own}:StateName")
        heartbeat = await line.get_child(f"{own}:ClientHeartbeat")

        async def reach(wanted: str, read) -> None:
            """Give the heartbeat, a number that changes, until the wanted value is read."""
            while await read() != wanted:
                number = int(10 * time.monotonic())
                await heartbeat.write_value(ua.Variant(number, ua.VariantType.UInt32))
                await asyncio.sleep(0.1)
            print(wanted, flush=True)

        async def order_state() -> str:
            return (await line.call_method(f"{own}:GetOrder", order))[0]

        priority = ua.Variant(0, ua.VariantType.Int32)
        await line.call_method(f"{own}:GiveOrderToExit", order, parcel, "north", priority)
        await execute.call_method(f"{packml}:Reset")
        await reach("Idle", state.read_value)
        await line.call_method(f"{own}:ParcelComing", parcel, "box")
        await execute.call_method(f"{packml}:Start")
        await reach("Execute", state.read_value)
        await reach("left", order_state)
        await machine.call_method(f"{packml}:Stop")
        await reach("Stopped", state.read_value)


asyncio.run(main())
