"""A key and a certificate for the OPC UA server, signed by itself."""

from socket import gethostname

from asyncua.crypto import cert_gen
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from mdms_host.line.opcua import APPLICATION_URI


def certificate_of(host_name: str | None, days: int) -> tuple[bytes, bytes, str]:
    """A key (PEM), its certificate (DER) for a host's name, and its last day."""
    name = host_name or gethostname()
    key = cert_gen.generate_private_key()
    certificate = cert_gen.generate_self_signed_app_certificate(
        key,
        f"mdms table on {name}",
        {},
        [x509.UniformResourceIdentifier(APPLICATION_URI), x509.DNSName(name)],
        [ExtendedKeyUsageOID.SERVER_AUTH],
        days=days,
    )
    until = certificate.not_valid_after_utc.date().isoformat()
    return cert_gen.dump_private_key_as_pem(key), certificate.public_bytes(Encoding.DER), until
