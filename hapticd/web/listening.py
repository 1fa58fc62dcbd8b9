"""The listening socket of the server: for this machine only or, with TLS and a password, for others too."""

from __future__ import annotations

import errno
import ipaddress
import socket
import ssl
from dataclasses import dataclass
from typing import Final, cast

from hapticd.base.errors import HapticdError
from hapticd.base.yaml_source import printable
from hapticd.system.trusted_files import read_trusted
from hapticd.web.hosts import Hosts
from hapticd.web.passwords import Passwords

_LISTEN_BACKLOG: Final = 64
"""Number of connections that the kernel queues until the server accepts them."""
_MAX_PEM_FILE_BYTES: Final = 1 << 20
"""Maximum size of a certificate or key file."""


@dataclass(frozen=True, slots=True)
class Listening:
    """A bound socket, the host names and the address of its server, and the server's access rules."""

    socket: socket.socket
    hosts: Hosts
    url: str
    """The address to open in a browser: scheme, name and port, without a slash at the end."""
    tls: ssl.SSLContext | None
    passwords: Passwords | None


def listen(host: str, port: int, cert: str | None, key: str | None, password_file: str | None) -> Listening:
    """Bind the listening socket. Raises HapticdError if options are missing or files or the port cannot be used."""
    address = _address_of(host, port)
    loopback = ipaddress.ip_address(address.partition("%")[0]).is_loopback
    _require_options(host, loopback, cert, key, password_file)
    passwords = None if password_file is None else Passwords(password_file)
    name = f"[{address}]" if ":" in address else address
    names, tls = frozenset({name, "localhost"} if loopback else {name}), None
    shown = host.lower() if host.lower() == "localhost" else name
    if cert is not None and key is not None:
        tls, of_certificate = _tls(cert, key)
        names = frozenset(of_certificate)
        shown = next((each for each in of_certificate if each == shown), of_certificate[0].replace("*", "hapticd"))
    bound = _bind(host, address, port)
    port = bound.getsockname()[1]
    scheme = "http" if tls is None else "https"
    return Listening(bound, Hosts(names, port, tls is not None), f"{scheme}://{shown}:{port}", tls, passwords)


def _address_of(host: str, port: int) -> str:
    try:
        infos = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, UnicodeError) as error:
        raise HapticdError(f"--host {printable(host)}: {getattr(error, 'strerror', None) or error}") from None
    if host.lower() == "localhost":
        return "127.0.0.1"
    return str(infos[0][4][0])


def _require_options(host: str, loopback: bool, cert: str | None, key: str | None, password_file: str | None) -> None:
    options = {"--tls-cert": cert, "--tls-key": key, "--password-file": password_file}
    missing = [name for name, value in options.items() if value is None]
    if not loopback and missing:
        raise HapticdError(
            f"--host {printable(host)}: other machines can reach this address, so TLS and a password are needed: "
            f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
        )
    if (cert is None) != (key is None):
        here, other = ("--tls-key", "--tls-cert") if cert is None else ("--tls-cert", "--tls-key")
        raise HapticdError(f"{here}: {other} is missing; give both, the certificate and its key")


def _bind(host: str, address: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.setblocking(False)
        bound.bind((address, port))
        bound.listen(_LISTEN_BACKLOG)
    except OSError as error:
        bound.close()
        where = f"--port {port}"
        if error.errno == errno.EADDRINUSE:
            raise HapticdError(f"{where}: is in use at {host}; choose another, or 0 for a free one") from None
        if error.errno == errno.EADDRNOTAVAIL:
            raise HapticdError(f"--host {host}: not an address of this machine") from None
        raise HapticdError(f"{where}: {error.strerror}") from None
    return bound


# ---- TLS -------------------------------------------------------------------------------------------------------------


def _tls(cert: str, key: str) -> tuple[ssl.SSLContext, list[str]]:
    """Return the TLS context of a server with this certificate, and the certificate's names in lower case.

    Raises HapticdError.
    """
    read_trusted(cert, _MAX_PEM_FILE_BYTES)
    read_trusted(key, _MAX_PEM_FILE_BYTES, secret=True)
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        # The empty password makes an encrypted key fail instead of prompting on the terminal.
        server.load_cert_chain(cert, key, password="")
    except ssl.SSLError as error:
        why = "the key belongs to another certificate" if "MISMATCH" in (error.reason or "") else error.reason or error
        raise HapticdError(f"--tls-cert {printable(cert)}, --tls-key {printable(key)}: cannot be used: {why}") from None
    return server, _names_in(cert, server)


def _names_in(cert: str, server: ssl.SSLContext) -> list[str]:
    """Return the names and addresses of the certificate, read by a handshake in memory as a client sees them."""
    client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    client.check_hostname = False
    client.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    here = server.wrap_bio(to_server, to_client, server_side=True)
    try:
        client.load_verify_locations(cert)
        there = client.wrap_bio(to_client, to_server)
        for side in (there, here, there, here):
            try:
                side.do_handshake()
            except ssl.SSLWantReadError:
                continue
        certificate = there.getpeercert() or {}
        subjects = cast("tuple[tuple[str, str], ...]", certificate.get("subjectAltName", ()))
    except ssl.SSLError as error:
        why = getattr(error, "verify_message", None) or error.reason or error
        raise HapticdError(f"--tls-cert {printable(cert)}: browsers would refuse it: {why}") from None
    names = [name.lower() for kind, name in subjects if kind in ("DNS", "IP Address")]
    if not names:
        raise HapticdError(f"--tls-cert {printable(cert)}: needs a host name in subjectAltName (openssl -addext)")
    return [f"[{ipaddress.ip_address(name).compressed}]" if ":" in name else name for name in names]
