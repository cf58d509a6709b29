"""Services across a reload: who is bound stays bound, no call is lost, and each is answered by the code of its day."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, Kernel, PeriodicContext, Required, ThreadContext
from aiorts.errors import ComponentError, PluginError, ServiceUnavailable
from aiorts.testing import simulated
from services_api import Scale  # type: ignore[import-not-found]

if TYPE_CHECKING:
    from collections.abc import Callable

    from reload_files import Source

    Make = Callable[[str], Source]

pytestmark = pytest.mark.row(23)
PROVIDER = """
from services_api import Scale

class Scaler(Component):
    service = Provided[Scale]()
    version = 1
    pause = Param(0.01)

    inside = False

    async def scale(self, value: float) -> float:
        self.inside = True
        await self.sleep(self.pause)
        self.inside = False
        return value * self.version

    def on_reload(self, old):
        assert not old.inside

    async def on_execute(self):
        await self.sleep(0.003)
"""
NEW = ("version = 1", "version = 2")


class User(Component):
    scale = Required[Scale](timeout=5.0)


@pytest.mark.parametrize("where", ["periodic", "nowhere"])
@pytest.mark.parametrize("good", [True, False])
def test_no_call_is_lost(where: str, good: bool, source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(PROVIDER.replace("from services_api", "from aiorts import Provided, Required\nfrom services_api"))
        async with Kernel() as kernel:
            user, scaler = await kernel.create(User, "user"), await kernel.create(file.get("Scaler"), "scaler")
            connector = await kernel.connect(user.scale, scaler.service)
            if where == "periodic":
                await kernel.start(PeriodicContext(rate=100.0), scaler, activate=True)
            answers: list[float] = []

            async def call() -> None:
                answers.append(await user.scale.proxy.scale(1.0))

            calls = []
            file.replace(*NEW)
            if not good:
                file.replace("        await self.sleep(0.003)", "        raise OSError")
            for number in range(60):
                calls.append(asyncio.ensure_future(call()))
                await kernel.sleep(0.005)
                if number == 10:
                    calls.append(asyncio.ensure_future(kernel.reload("Scaler", cycles=10)))
            outcomes = await asyncio.gather(*calls, return_exceptions=True)
            errors = [one for one in outcomes if isinstance(one, BaseException)]
            if good or where == "nowhere":
                assert errors == []
                assert sorted(answers) == answers
                assert set(answers) == {1.0, 2.0}
                assert kernel.components["scaler"].version == 2  # type: ignore[attr-defined]
            else:
                assert [type(one) for one in errors] == [ComponentError]
                assert kernel.components["scaler"] is scaler
            assert len(answers) == 60
            assert user.scale.is_bound
            assert not connector.closed
            new: Any = kernel.components["scaler"]
            assert new.service is scaler.service
            assert new.service.statistics.calls == 60

    run()


@simulated
async def test_who_asks_stays_bound_and_what_is_gone_is_reported(source: Make) -> None:
    file = source("""
    from aiorts import Provided, Required
    from services_api import Scale

    class Both(Component):
        mine = Provided[Scale]()
        theirs = Required[Scale]()

        def scale(self, value: float) -> float:
            return value + 1

    """)
    async with Kernel() as kernel:
        one, two = await kernel.create(file.get("Both"), "one"), await kernel.create(file.get("Both"), "two")
        first = await kernel.connect(one.theirs, two.mine)
        second = await kernel.connect(two.theirs, one.mine)
        proxy = one.theirs.proxy
        file.replace("return value + 1", "return value + 2")
        await kernel.reload("Both")
        now: Any = kernel.components["one"]
        assert await proxy.scale(1.0) == 3.0
        assert await now.theirs.proxy.scale(1.0) == 3.0
        file.replace("    mine = Provided[Scale]()\n", "")
        done = await kernel.reload("Both")
        assert (first.closed, second.closed) == (True, True)
        assert {(each.what, each.name) for each in done.components[0].dropped} == {("port", "mine")}
        with pytest.raises(ServiceUnavailable):
            await proxy.scale(1.0)


@pytest.mark.anyio
async def test_in_a_thread_calls_are_answered_by_the_code_of_the_day(source: Make) -> None:
    file = source("""
    from aiorts import Provided
    from services_api import Scale

    class Threaded(Component):
        service = Provided[Scale]()
        version = 1

        def scale(self, value: float) -> float:
            return value * self.version

        def on_execute(self):
            pass
    """)
    async with Kernel() as kernel:
        user, threaded = await kernel.create(User, "user"), await kernel.create(file.get("Threaded"), "threaded")
        await kernel.connect(user.scale, threaded.service)
        await kernel.start(ThreadContext(rate=200.0), threaded, activate=True)
        assert await user.scale.proxy.scale(1.0) == 1.0
        file.replace(*NEW)
        await kernel.reload("Threaded", cycles=2)
        assert await user.scale.proxy.scale(1.0) == 2.0
        for old, new in (("def on_execute", "async def on_execute"), ("def scale", "async def scale")):
            file.replace(old, new)
            with pytest.raises(PluginError, match="is `async def` now, and it runs in a thread"):
                await kernel.reload("Threaded", cycles=2)
            file.replace(new, old)
        assert await user.scale.proxy.scale(1.0) == 2.0


@simulated
async def test_an_interface_that_goes_is_not_answered_by_the_old_code_and_comes_back_with_it(source: Make) -> None:
    file = source("""
    from aiorts import Provided
    from services_api import Scale

    class Scaler(Component):
        service = Provided[Scale](always=True)
        bad = False

        def scale(self, value: float) -> float:
            return value

        def on_execute(self):
            if self.bad: 1 / 0
    """)
    async with Kernel() as kernel:
        user, scaler = await kernel.create(User, "user"), await kernel.create(file.get("Scaler"), "scaler")
        connector = await kernel.connect(user.scale, scaler.service)
        await kernel.start(PeriodicContext(rate=100.0), scaler, activate=True)
        file.replace("    service = Provided[Scale](always=True)\n", "")
        reload = asyncio.ensure_future(kernel.reload("Scaler", cycles=1000, seconds=5.0))
        await kernel.sleep(1.0)
        with pytest.raises(ServiceUnavailable):
            await user.scale.proxy.scale(1.0)
        kernel.components["scaler"].bad = True  # type: ignore[attr-defined]
        with pytest.raises(ComponentError):
            await reload
        assert await user.scale.proxy.scale(1.0) == 1.0
        assert not connector.closed


@simulated
async def test_a_call_that_waits_is_the_new_codes_in_every_respect(source: Make) -> None:
    file = source(PROVIDER.replace("from services_api", "from aiorts import Provided\nfrom services_api"))
    async with Kernel() as kernel:
        user, scaler = await kernel.create(User, "user"), await kernel.create(file.get("Scaler"), "scaler", pause=0.5)
        await kernel.connect(user.scale, scaler.service)
        context = await kernel.start(PeriodicContext(rate=1.0), scaler, activate=True)
        calls = [asyncio.ensure_future(user.scale.proxy.scale(1.0)) for _ in range(2)]
        await kernel.sleep(0.01)
        file.replace(
            "        self.inside = True",
            "        assert self.kernel.components[self.name] is self\n        self.inside = True",
        )
        file.replace(
            "await self.sleep(self.pause)", "self.begun = asyncio.current_task()\n        await self.sleep(self.pause)"
        )
        reload = asyncio.ensure_future(kernel.reload("Scaler", cycles=1))
        await kernel.sleep(0.1)
        calls.append(asyncio.ensure_future(user.scale.proxy.scale(1.0)))
        assert await asyncio.gather(*calls) == [1.0, 1.0, 1.0]
        await reload
        new: Any = kernel.components["scaler"]
        assert new.begun._aiorts_component is new
        assert context.members == (new,)
