"""A client of asyncua, as a user of the table has it."""

from pathlib import Path
from typing import Any


async def opcua_client(
    url: str, folder: Path, user: str = "plc", password: str = "secret", *, secure: bool = True
) -> Any:
    """A client that connects as a user, signed and encrypted by the certificate of a folder."""
    # OPC UA is an extra.
    from asyncua import Client
    from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

    client = Client(url)
    client.session_timeout = 60_000
    client.set_user(user)
    client.set_password(password)
    if secure:
        client.application_uri = "urn:mdms-array:table"
        certificate, key = folder / "certificate.der", folder / "key.pem"
        await client.set_security(SecurityPolicyBasic256Sha256, str(certificate), str(key))
    return client
