"""Reloads among everything else that can be asked of a system, in any order and at the same time: it stays whole."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aiorts import EventContext, Kernel, PeriodicContext
from aiorts.errors import AiortsError
from aiorts.kernel.execution.cell import cell
from aiorts.testing import simulate
from campaign import LENGTH, ORDERS, time_limit

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from reload_files import Source

    Make = Callable[[str], Source]

PART = """
class Part(Component):
    data = InPort(TimedDouble)
    out = OutPort(TimedDouble)
    gain = Param(1.0)
    # more

    def __init__(self, name=""):
        super().__init__(name)
        self.ends = 0
        self.mark = {"inside": False}
        self.n = 0

    async def on_execute(self):
        assert not self.mark["inside"]
        assert self.kernel.components[self.name] is self
        self.mark["inside"] = True
        try:
            # execute
            for sample in self.data.drain():
                pass
            self.out.write_nowait(TimedDouble(Time(0, 0), float(self.n)))
            self.n += 1
            await self.sleep(0.002)
        finally:
            self.mark["inside"] = False

    def on_finalize(self):
        assert not self.ends
        self.ends += 1

    async def on_reload(self, old):
        self.mark = old.mark
        assert not self.mark["inside"]
        # reload
        await self.sleep(0.003)
"""
EDITS = {
    "good": ("# execute", "pass"),
    "more": ("# more", "more = InPort(TimedDouble)"),
    "less": ("    data = InPort(TimedDouble)\n", "    data = OutPort(TimedDouble)\n"),
    "bad cycle": ("# execute", "if self.n == 3: 1 / 0"),
    "bad reload": ("# reload", "if self.name == 'b': 1 / 0"),
    "bad file": ("class Part", "klass Part"),
}
NAMES = "abc"
OPERATIONS = (
    "reload",
    "activate",
    "deactivate",
    "reset",
    "configure",
    "connect",
    "disconnect",
    "join",
    "leave",
    "remove",
)
SCRIPT = st.lists(
    st.tuples(
        st.sampled_from(OPERATIONS + ("reload",) * 5),
        st.sampled_from(NAMES),
        st.sampled_from(NAMES),
        st.integers(0, 1),
        st.sampled_from(sorted(EDITS)),
        st.integers(0, 25),
    ),
    min_size=3,
    max_size=LENGTH,
)


@pytest.mark.slow(kept_by="reload/test_moments.py::test_anything_else_in_the_midst_of_a_reload")
@pytest.mark.row(23)
@pytest.mark.timeout(time_limit(900))
@settings(max_examples=ORDERS, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(script=SCRIPT, event=st.booleans(), seed=st.integers(0, ORDERS))
def test_whatever_is_asked_at_the_same_time_the_system_stays_whole(
    script: list[tuple[str, str, str, int, str, int]], event: bool, seed: int, source: Make
) -> None:
    async def run() -> None:
        file = source(PART)
        async with Kernel() as kernel:
            parts = [await kernel.create(file.get("Part"), name) for name in NAMES]
            other: Any = EventContext() if event else PeriodicContext(rate=70.0)
            contexts = [
                await kernel.start(PeriodicContext(rate=100.0), *parts[:2], activate=True),
                await kernel.start(other, parts[2], activate=True),
            ]
            connectors = [await kernel.connect(parts[0].out, parts[2].data, length=20)]

            async def operate(what: str, name: str, peer: str, where: int, edit: str) -> None:
                component, context = kernel.components.get(name), contexts[where]
                if what == "reload":
                    file.write(PART.replace(*EDITS[edit]))
                    await kernel.reload("Part", cycles=5, seconds=0.2)
                elif component is None:
                    await kernel.create(file.get("Part"), name)
                elif what in ("activate", "deactivate", "reset"):
                    await getattr(context, what)(component)
                elif what == "configure":
                    await component.configure(gain=float(where))
                elif what == "connect":
                    second: Any = kernel.components[peer]
                    connectors.append(await kernel.connect(component.ports["out"], second.ports["data"], length=20))
                elif what == "disconnect":
                    await kernel.disconnect(connectors[-1])
                elif what == "remove":
                    await kernel.remove(component)
                else:
                    await (context.add if what == "join" else context.remove)(component)

            async def tried(operation: Coroutine[Any, Any, None]) -> None:
                with suppress(AiortsError, KeyError):
                    await operation

            tasks = []
            for what, name, peer, where, edit, pause in script:
                tasks.append(asyncio.ensure_future(tried(operate(what, name, peer, where, edit))))
                await kernel.sleep(pause / 1000)
            await asyncio.gather(*tasks)
            await kernel.sleep(0.1)
            for name, component in kernel.components.items():
                assert component.name == name
                assert all(member.component is component for member in cell(component).members)
                assert all(component in context.members for context in component.contexts)
            for context in contexts:
                assert all(kernel.components[one.name] is one for one in context.members)
                assert context._updating == 0
            live = {id(port) for one in kernel.components.values() for port in one.ports.values()}
            for connector in connectors:
                counts = connector.statistics
                assert counts.written == counts.delivered + counts.buffered + sum(counts.dropped.values())
                if not connector.closed:
                    assert {id(connector.out), id(connector.in_)} <= live
            assert not kernel.registry.renewing
            assert not kernel.registry.tasks
            for component in kernel.components.values():
                assert "data" in component.ports
                assert "AssertionError" not in str(type(component.last_error))

    simulate(run(), seed=seed)
