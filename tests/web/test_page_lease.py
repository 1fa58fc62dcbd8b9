"""Only a page that holds a lease can turn forces on, and every page can stop them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from hapticd.protocol.messages import Code
from hapticd.web.page_lease import PageLease
from tests.web.served import served, tab, until


class Control:
    """The connection to a daemon that a test plays."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, dict[str, Any]]] = []
        self.before = lambda: None

    async def call(self, method: str, params: dict[str, Any]) -> object:
        self.before()
        self.calls.append((method, params))
        return {"token": "t" if params.get("duration_s") else None} if method == "lease" else {"forces": "on"}


def test_on_takes_a_lease_of_the_same_page() -> None:
    async def test() -> None:
        async with served() as site, tab(site) as one, tab(site) as other:
            for page in (one, other):
                assert (await page.call("set_forces", {"enabled": True}))["error"]["code"] == Code.LEASE_LAPSED
            assert (await one.call("lease", {"duration_s": 1.0}))["result"] == {"token": "t"}
            assert "result" in await one.call("set_forces", {"enabled": True})
            assert (await other.call("set_forces", {"enabled": True}))["error"]["code"] == Code.LEASE_LAPSED
            assert "result" in await other.call("set_forces", {"enabled": False})
            turned_on = [request for request in site.daemon.requests if request["params"].get("enabled") is True]
            assert len(turned_on) == 1

    asyncio.run(test())


@pytest.mark.parametrize("duration", [1.001, 3600, float("inf"), 10**400])
def test_a_page_holds_no_longer_lease_than_a_second(duration: float) -> None:
    async def test() -> None:
        control = Control()
        lease = PageLease(control)  # type: ignore[arg-type]
        with pytest.raises(Exception, match="at most 1 s"):
            await lease.lease({"duration_s": duration})
        assert control.calls == [] and not lease.held

    asyncio.run(test())


def test_a_lease_lives_from_before_the_daemon_was_asked() -> None:
    async def test() -> None:
        now, control = 0.0, Control()
        lease = PageLease(control, lambda: now)  # type: ignore[arg-type]

        def slow() -> None:
            nonlocal now
            now += 0.6

        control.before = slow
        await lease.lease({"duration_s": 1.0})
        assert lease.held
        now = 0.99
        assert lease.held
        now = 1.0
        assert not lease.held
        await lease.lease({"duration_s": 1.0, "token": "t"})
        assert lease.held
        await lease.lease({"duration_s": 0, "token": "t"})
        assert not lease.held

    asyncio.run(test())


def test_forces_that_come_on_after_the_lease_lapsed_go_off_again() -> None:
    async def test() -> None:
        now, control = 0.0, Control()
        lease = PageLease(control, lambda: now)  # type: ignore[arg-type]
        await lease.lease({"duration_s": 0.5})

        def slow() -> None:
            nonlocal now
            now += 0.6

        control.before = slow
        with pytest.raises(Exception, match="lapsed while"):
            await lease.set_forces({"enabled": True})
        assert [params for method, params in control.calls if method == "set_forces"] == [
            {"enabled": True},
            {"enabled": False},
        ]

    asyncio.run(test())


def test_a_closed_page_does_not_renew_its_lease() -> None:
    async def test() -> None:
        async with served() as site:
            async with tab(site) as page:
                await page.call("lease", {"duration_s": 0.5})
                await page.call("set_forces", {"enabled": True})
                before = len(site.daemon.requests)
            await until(lambda: not site.pages.open)
            async with tab(site) as other:
                # The daemon ends the lease: the server sent nothing more for the closed page.
                await other.call("get_status")
                assert [request["method"] for request in site.daemon.requests[before:]] == ["get_status"]

    asyncio.run(test())


@pytest.mark.parametrize("params", [{"enabled": 1}, {"enabled": "true"}, {}, {"enabled": None}])
def test_only_true_turns_forces_on(params: dict[str, Any]) -> None:
    """The daemon refuses other values; the server does not treat them as a request to turn forces on."""

    async def test() -> None:
        control = Control()
        await PageLease(control).set_forces(params)  # type: ignore[arg-type]
        assert control.calls == [("set_forces", params)]

    asyncio.run(test())
