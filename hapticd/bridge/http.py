"""The endpoint for Prometheus: GET /metrics over HTTP/1.1, one answer a connection.

Whoever may connect may also be slow, or say nothing: a request has so many bytes, so much time, and so many beside it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final

from hapticd.bridge.metrics import CONTENT_TYPE

REQUEST_BYTES: Final = 8192
REQUEST_S: Final = 5.0
AT_ONCE: Final = 8


class Endpoint:
    """Answers by `text`. Belongs to the running event loop."""

    def __init__(self, text: Callable[[], str]) -> None:
        self._text = text
        self._open = 0

    async def listen(self, host: str, port: int) -> asyncio.Server:
        """Raises OSError."""
        return await asyncio.start_server(self._serve, host, port, limit=REQUEST_BYTES)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._open += 1
        try:
            if self._open > 2 * AT_ONCE:
                return  # too many even to answer
            async with asyncio.timeout(REQUEST_S):
                busy = self._open > AT_ONCE
                writer.write(_reply("503 Service Unavailable", "busy\n") if busy else await self._answer(reader))
                await writer.drain()
                writer.write_eof()
                # What still comes is read, so that closing does not take the answer back.
                while await reader.read(REQUEST_BYTES):
                    pass
        except (TimeoutError, OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
            pass  # too slow, or gone, or we are ending: there is nobody to answer
        finally:
            self._open -= 1
            writer.transport.abort()

    async def _answer(self, reader: asyncio.StreamReader) -> bytes:
        try:
            head = await reader.readuntil(b"\r\n\r\n")
        except asyncio.LimitOverrunError:
            return _reply("431 Request Header Fields Too Large", f"at most {REQUEST_BYTES} bytes are taken\n")
        parts = head.split(b"\r\n", 1)[0].split(b" ")
        if len(parts) != 3 or not parts[2].startswith(b"HTTP/1."):
            return _reply("400 Bad Request", "this is HTTP/1.1: GET /metrics\n")
        method, target = parts[0], parts[1].split(b"?", 1)[0]
        if method != b"GET":
            return _reply("405 Method Not Allowed", "only GET\n", "Allow: GET\r\n")
        if target != b"/metrics":
            return _reply("404 Not Found", "only /metrics\n")
        return _reply("200 OK", self._text())


def _reply(status: str, text: str, more: str = "") -> bytes:
    body = text.encode()
    head = (
        f"HTTP/1.1 {status}\r\nContent-Type: {CONTENT_TYPE}\r\nContent-Length: {len(body)}\r\n"
        f"{more}Connection: close\r\n\r\n"
    )
    return head.encode("ascii") + body
