"""The asyncio client under its public name: `hapticd.aio.connect`."""

from hapticd.client.asynchronous import Client, connect
from hapticd.client.methods import Subscription

__all__ = ["Client", "Subscription", "connect"]
