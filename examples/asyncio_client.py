"""Commands and events at the same time, with asyncio: the hand taps a wall while another task prints each contact.

hapticd run                              # in one terminal
python examples/asyncio_client.py        # in another one
"""

from __future__ import annotations

import asyncio
import sys

from hapticd import aio
from hapticd.base.errors import HapticdError

FLOOR = {"kind": "wall", "point_m": [0, 0], "normal": [0, 1], "material": "wood"}
TAPS = 3


async def print_contacts(daemon: aio.Client, listening: asyncio.Event) -> None:
    """Print the first TAPS taps on the floor."""
    seen = 0
    async with daemon.events() as events:
        listening.set()
        async for event in events:
            # If the hand is below the floor when the floor appears, the contact has no tap: amplitude 0.
            if event["event"] == "contact" and event["object"] == "floor" and event["amplitude_m_per_s2"] > 0:
                seen += 1
                print(f"tap {seen}: {event['speed_m_per_s']:.3f} m/s")
                if seen == TAPS:
                    return


async def main() -> None:
    """Set the scene, subscribe to events, and let the hand tap."""
    async with aio.connect() as daemon:
        await daemon.set_scene({"objects": {"floor": FLOOR}}, wait=True)
        listening = asyncio.Event()
        contacts = asyncio.create_task(print_contacts(daemon, listening))
        await listening.wait()  # subscribe before the command, so that no event is missed
        gesture = {"kind": "tap", "object": "floor", "speed_m_per_s": 0.1, "count": TAPS}
        await daemon.set_operator(gesture=gesture)
        await asyncio.wait_for(contacts, timeout=60)


if __name__ == "__main__":
    try:
        asyncio.run(main())
    except (HapticdError, TimeoutError) as error:
        print(f"asyncio_client: {error or 'the hand did not touch the floor within a minute'}", file=sys.stderr)
        sys.exit(1)
