"""The asyncio client under its public name: `hapticd.aio.connect`."""

from hapticd.client.asynchronous import Client, Subscription, connect

__all__ = ["Client", "Subscription", "connect"]
