"""`hapticd web --demo` under pages that come, go, freeze and are killed: does its memory grow?

python -m tests.soak.soak_web [--for 3600s] [--warm-up 60s] [--seed 1] [--out build/soak]

Four pages at a time, each in a process of its own: it takes all telemetry and calls something a few times a second.
After some seconds it closes in order, goes without a word, is killed, or freezes (SIGSTOP) until the server lets it go.
Each ten seconds memory, threads and descriptors of web process and daemon are looked at. After the warm-up neither
memory may grow by a mebibyte or more: medians of the last fifth and of the first. What was found goes into
soak_web.json. Exit code 1 if anything grew, or a call or a page was refused.

python -m tests.soak.soak_web --page ADDRESS COOKIE SECONDS HOW      one page
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

import aiohttp
import msgpack

from tests.support.processes import descriptors, memory_kib, threads

LOOK_S = 10.0
PAGES = 4
PAGE_S = (2.0, 12.0)
FROZEN_S = 60.0
"""A page that does not read is let go within this."""
GROWTH_KIB = 1024
HOW = ("close", "vanish", "kill", "freeze")
TOPICS = ["samples", "state", "event", "change", "status"]


# ---- A page ----------------------------------------------------------------------------------------------------------


async def page(address: str, cookie: str, lasts_s: float, how: str) -> None:
    """Takes everything for so long; then goes, or stays and waits to be killed."""
    headers = {"Origin": address, "Cookie": cookie}
    async with aiohttp.ClientSession() as session, session.ws_connect(f"{address}/socket", headers=headers) as socket:

        async def say(id: int, method: str, params: dict[str, Any]) -> None:
            await socket.send_bytes(msgpack.packb({"jsonrpc": "2.0", "id": id, "method": method, "params": params}))

        await say(0, "web.subscribe", {"topics": TOPICS})
        end, calls, due, errors = time.monotonic() + lasts_s, 0, 0.0, 0
        while time.monotonic() < end:
            if time.monotonic() > due:
                calls, due = calls + 1, time.monotonic() + 0.2
                method, params = (
                    ("get_scene", {}),
                    ("get_status", {"detail": True}),
                    ("web.hello", {}),
                    ("update_materials", {"materials": {"comb": {"stiffness_n_per_m": 700.0 + calls % 100}}}),
                )[calls % 4]
                await say(calls, method, params)
            message = await socket.receive(timeout=30.0)
            if message.type is not aiohttp.WSMsgType.BINARY:
                raise SystemExit(f"the page was closed: {message}")
            decoded = msgpack.unpackb(message.data)
            errors += isinstance(decoded, dict) and "error" in decoded
        if errors:
            raise SystemExit(f"{errors} of {calls} calls were refused")
        if how == "close":
            await socket.close()
        print("done", flush=True)
        if how == "vanish":
            os._exit(0)
        if how in ("kill", "freeze"):
            await asyncio.sleep(3600.0)


# ---- What is looked at -----------------------------------------------------------------------------------------------


def look(pid: int) -> dict[str, int]:
    return {"memory_kib": memory_kib(pid), "threads": threads(pid), "descriptors": descriptors(pid)}


class Soak:
    """One run."""

    def __init__(self, random_: random.Random) -> None:
        self._random = random_
        self._web = subprocess.Popen(
            [sys.executable, "-m", "hapticd", "web", "--demo", "--port", "0"], stdout=subprocess.PIPE, text=True
        )
        assert self._web.stdout is not None
        link = self._web.stdout.readline().strip()
        self._address = link.partition("/?")[0]
        self._cookie = asyncio.run(self._let_in(link))
        (self._daemon,) = map(int, Path(f"/proc/{self._web.pid}/task/{self._web.pid}/children").read_text().split())
        self.visits: Counter[str] = Counter()
        self.failures: list[str] = []

    @staticmethod
    async def _let_in(link: str) -> str:
        async with aiohttp.ClientSession() as session, session.get(link, allow_redirects=False) as response:
            return response.headers["Set-Cookie"].partition(";")[0]

    def looked(self) -> dict[str, dict[str, int]]:
        return {"web": look(self._web.pid), "daemon": look(self._daemon)}

    async def visit(self) -> None:
        """One page after the other."""
        while True:
            how = self._random.choice(HOW)
            lasts = self._random.uniform(*PAGE_S)
            words = ("-m", "tests.soak.soak_web", "--page", self._address, self._cookie, str(lasts), how)
            process = await asyncio.create_subprocess_exec(
                sys.executable, *words, stdout=subprocess.PIPE, stderr=subprocess.PIPE
            )
            assert process.stdout is not None and process.stderr is not None
            try:
                said = await process.stdout.readline()
                if said != b"done\n":
                    self.failures.append(f"{how}: {(await process.stderr.read()).decode().strip()[-300:]}")
                elif how == "freeze":
                    process.send_signal(signal.SIGSTOP)
                    await asyncio.sleep(FROZEN_S)
                self.visits[how] += 1
            finally:
                with suppress(ProcessLookupError):
                    process.kill()
                await process.wait()

    def stop(self) -> int:
        self._web.terminate()
        code = self._web.wait(30)
        assert self._web.stdout is not None
        self._web.stdout.close()
        return code


async def soak(run: Soak, lasts_s: float) -> list[dict[str, Any]]:
    tasks = [asyncio.create_task(run.visit()) for _ in range(PAGES)]
    looks = []
    begin = time.monotonic()
    try:
        while (now := time.monotonic() - begin) < lasts_s:
            looks.append({"at_s": now, **run.looked()})
            done, _ = await asyncio.wait(tasks, timeout=LOOK_S, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    return looks


def growth(looks: list[dict[str, Any]], of: str, what: str) -> float:
    """Median of the last fifth over that of the first."""
    part = max(1, len(looks) // 5)
    values = [each[of][what] for each in looks]
    return statistics.median(values[-part:]) - statistics.median(values[:part])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--for", dest="lasts", default="3600s")
    parser.add_argument("--warm-up", default="60s")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("build/soak"))
    parser.add_argument("--page", nargs=4, metavar=("ADDRESS", "COOKIE", "SECONDS", "HOW"))
    options = parser.parse_args()
    if options.page:
        address, cookie, lasts, how = options.page
        asyncio.run(page(address, cookie, float(lasts), how))
        return 0
    lasts_s, warm_s = (float(word.removesuffix("s")) for word in (options.lasts, options.warm_up))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # which ends what was started
    run = Soak(random.Random(options.seed))
    try:
        looks = asyncio.run(soak(run, lasts_s))
    finally:
        code = run.stop()
    warm = [each for each in looks if each["at_s"] >= warm_s]
    found = {
        of: {what: growth(warm, of, what) for what in ("memory_kib", "threads", "descriptors")}
        for of in ("web", "daemon")
    }
    grown = [of for of, each in found.items() if each["memory_kib"] >= GROWTH_KIB]
    options.out.mkdir(parents=True, exist_ok=True)
    report = {"visits": run.visits, "failures": run.failures, "growth": found, "exit_code": code, "looks": looks}
    (options.out / "soak_web.json").write_text(json.dumps(report, indent=1))
    print(f"{sum(run.visits.values())} pages {dict(run.visits)}, {len(run.failures)} failures, growth {found}")
    for failure in run.failures[:10]:
        print(failure, file=sys.stderr)
    return 1 if grown or run.failures or code else 0


if __name__ == "__main__":
    sys.exit(main())
