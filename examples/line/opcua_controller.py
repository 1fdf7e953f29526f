"""A controller by OPC UA: has one scanned parcel leave to the north, and follows its events.

python examples/line/opcua_controller.py URL FOLDER USER PASSWORD, beside `mdms serve
examples/line/table.toml --opcua 4840`. FOLDER has a certificate of `mdms line certificate`.
"""

import asyncio
import sys
import time

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

url, folder, user, password = sys.argv[1:]


class Events:
    """Prints what happens to parcels."""

    def event_notification(self, event) -> None:
        """See `asyncua.common.subscription.SubHandler`."""
        if hasattr(event, "Parcel"):
            print(f"{event.Parcel}: {event.Event} {event.Exit}".rstrip(), flush=True)


async def main() -> None:
    """From Stopped to Execute and back."""
    client = Client(url)
    client.application_uri = "urn:mdms-array:table"  # that of the certificate
    client.set_user(user)
    client.set_password(password)
    certificate, key = f"{folder}/certificate.der", f"{folder}/key.pem"
    await client.set_security(SecurityPolicyBasic256Sha256, certificate, key)
    async with client:
        packml = await client.get_namespace_index("http://opcfoundation.org/UA/PackML/")
        own = await client.get_namespace_index("urn:mdms-array:line")
        table = await client.nodes.objects.get_child(f"{own}:Table")
        line = await table.get_child(f"{own}:Line")
        machine = await table.get_child([f"{packml}:BaseStateMachine", f"{packml}:MachineState"])
        execute = await machine.get_child(f"{packml}:ExecuteState")
        state = await line.get_child(f"{own}:StateName")
        heartbeat = await line.get_child(f"{own}:ClientHeartbeat")
        subscription = await client.create_subscription(100, Events())
        event_type = await client.nodes.base_event_type.get_child(f"{own}:ParcelEvent")
        await subscription.subscribe_events(table, event_type)

        async def until(done, what: str) -> None:
            for number in range(1, 1200):
                await heartbeat.write_value(ua.Variant(number, ua.VariantType.UInt32))
                if await done():
                    return print(what, flush=True)
                await asyncio.sleep(0.1)
            raise SystemExit(f"not {what} within two minutes; in {await state.read_value()}")

        async def reached(name: str) -> None:
            async def there() -> bool:
                return await state.read_value() == name

            await until(there, name)

        key = f"{time.time():.0f}"
        priority = ua.Variant(0, ua.VariantType.Int32)
        await line.call_method(f"{own}:GiveOrderToExit", key, f"P-{key}", "north", priority)
        await execute.call_method(f"{packml}:Reset")
        await reached("Idle")
        await line.call_method(f"{own}:ParcelComing", f"P-{key}", "box")
        await execute.call_method(f"{packml}:Start")
        await reached("Execute")

        async def left() -> bool:
            return (await line.call_method(f"{own}:GetOrder", key))[0] == "left"

        await until(left, "the parcel has left")
        await machine.call_method(f"{packml}:Stop")
        await reached("Stopped")


asyncio.run(main())
