"""What is asked of a component at the same time as its reload reaches the instance of the day, or is refused."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import (
    Component,
    ExternalContext,
    Kernel,
    LifecycleState,
    OutPort,
    PeriodicContext,
    Provided,
    Required,
)
from aiorts.errors import AiortsError, ComponentError, StateError
from aiorts.testing import simulated
from aiorts.types import TimedDouble
from services_api import Scale  # type: ignore[import-not-found]

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from reload_files import Source

    Make = Callable[[str], Source]

pytestmark = pytest.mark.row(23)
ACTIVE, INACTIVE = LifecycleState.ACTIVE, LifecycleState.INACTIVE

LONG = """
class Long(Component):
    gain = Param(1.0)
    version = 1

    def __init__(self, name=""):
        super().__init__(name)
        self.ends = 0
        self.runs = 0

    async def on_execute(self):
        self.runs += 1
        await self.sleep(1.0)

    def on_finalize(self):
        self.ends += 1

    def on_reload(self, old):
        pass  # reload
"""
NEW = ("version = 1", "version = 2")


class Busy(Component):
    """Its context comes to the end of a cycle later than the other one."""

    async def on_execute(self) -> None:
        await self.sleep(1.5)


@pytest.mark.parametrize("first", ["reload", "request"])
@pytest.mark.parametrize("good", [True, False])
@pytest.mark.parametrize("what", ["configure", "deactivate", "remove", "leave", "join"])
def test_a_request_that_waits_for_the_same_moment(what: str, first: str, good: bool, source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(LONG)
        async with Kernel() as kernel:
            old = await kernel.create(file.get("Long"), "long")
            context = await kernel.start(PeriodicContext(rate=0.5), old, activate=True)
            busy = await kernel.create(Busy, "busy")
            other = await kernel.start(PeriodicContext(rate=0.5), busy, activate=True)
            await kernel.sleep(0.1)
            asked = {
                "configure": lambda: old.configure(gain=3.0),
                "deactivate": lambda: context.deactivate(old),
                "remove": lambda: kernel.remove(old),
                "leave": lambda: context.remove(old),
                "join": lambda: other.add(old),
            }[what]
            file.replace(*NEW)
            if not good:
                file.replace("pass  # reload", "1 / 0")
            tasks: list[asyncio.Task[Any]] = []
            begins: list[Any] = [asked, lambda: kernel.reload("Long")]
            for begin in begins if first == "request" else reversed(begins):
                tasks.append(asyncio.ensure_future(begin()))
                await kernel.sleep(0.1)
            outcomes = await asyncio.gather(*tasks, return_exceptions=True)
            assert all(isinstance(one, AiortsError) for one in outcomes if isinstance(one, BaseException))
            reload, request = outcomes if first == "reload" else reversed(outcomes)
            await kernel.sleep(3.0)
            now: Any = kernel.components.get("long")
            if now is None:
                assert what == "remove"
                assert old.ends == 1
                return
            assert (now is old) is isinstance(reload, BaseException)
            if request is None:
                if what == "configure":
                    assert (now.gain, now.params["gain"].value) == (3.0, 3.0)
                elif what == "deactivate":
                    assert now.state is INACTIVE
                elif what == "leave":
                    assert now.contexts == ()
                elif what == "join":
                    assert now.contexts == (context, other)
            assert context.members == ((now,) if what != "leave" else ())
            assert all(member in (now, busy) for each in kernel.contexts.values() for member in each.members)
            if now is not old:
                ran = old.runs
                await kernel.sleep(5.0)
                assert old.runs == ran
                with pytest.raises(AiortsError):
                    await kernel.start(PeriodicContext(rate=1.0), old)
                with pytest.raises(AiortsError, match="was removed"):
                    await old.configure(gain=9.0)

    run()


@simulated
async def test_an_external_context_changes_between_two_ticks(source: Make) -> None:
    file = source(LONG.replace("await self.sleep(1.0)", "pass"))
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Long"), "long")
        context = await kernel.start(ExternalContext(), old, activate=True)
        await context.tick()
        file.replace(*NEW)
        await kernel.reload("Long", seconds=0.1)
        new: Any = kernel.components["long"]
        await context.tick()
        assert (old.runs, new.runs, new.version) == (1, 1, 2)


class User(Component):
    scale = Required[Scale](timeout=5.0)


@simulated
async def test_constructors_that_make_others_and_ports_added_later(source: Make) -> None:
    file = source("""
    from aiorts import Provided
    from services_api import Scale

    class Parent(Component):
        out = OutPort(TimedDouble)
        service = Provided[Scale]()
        factor = 2

        def __init__(self, name=""):
            self.helper = Child("helper") if type(self) is Parent else None
            super().__init__(name)
            self.second = Parent("second") if name == "parent" else None

        def scale(self, value: float) -> float:
            return self.factor * value

    class Child(Parent):
        pass
    """)
    async with Kernel() as kernel:
        parent = await kernel.create(file.get("Parent"), "parent")
        one, two = await kernel.create(User, "one"), await kernel.create(User, "two")
        added = parent.add_port("added", Provided[Scale]())
        await kernel.connect(one.scale, parent.service)
        await kernel.connect(two.scale, added)
        file.replace("factor = 2", "factor = 3")
        await kernel.reload("Parent")
        new: Any = kernel.components["parent"]
        assert (new.out is parent.out, new.service is parent.service) == (True, True)
        for other in (new.helper, new.second):
            assert other.out is not new.out
            assert other.service is not new.service
        assert [await user.scale.proxy.scale(1.0) for user in (one, two)] == [3.0, 3.0]
        file.replace("factor = 3", "factor = 4")
        file.replace("    def scale", "    def on_reload(self, old):\n        1 / 0\n\n    def scale")
        with pytest.raises(ComponentError):
            await kernel.reload("Parent")
        assert [await user.scale.proxy.scale(1.0) for user in (one, two)] == [3.0, 3.0]


SCRIPT = '''
"""A program that reloads a component of its own file."""
import asyncio
import sys
import aiorts

PROGRAM = sys.modules["__main__"]

class Own(aiorts.Component):
    version = 1

async def main():
    async with aiorts.Kernel() as kernel:
        await kernel.create(Own, "own")
        for n in (2, 3):
            text = open(__file__).read()
            open(__file__, "w").write(text.replace(f"version = {n - 1}\\n", f"version = {n}\\n", 1))
            done = await kernel.reload(Own)
            own = kernel.components["own"]
            (event,) = done.components
            print(sys.modules["__main__"] is PROGRAM, own.version, type(own).__module__, event.old, event.new)

if __name__ == "__main__":
    asyncio.run(main())
'''


@pytest.mark.slow
def test_a_program_reloads_a_component_of_its_own_file(tmp_path: Path) -> None:
    script = tmp_path / "program.py"
    script.write_text(SCRIPT, encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=50, check=False)
    assert (done.stdout, done.stderr) == ("True 2 __main__ 0 1\nTrue 3 __main__ 1 2\n", "")


@simulated
async def test_a_caller_that_is_cancelled_ends_nothing_and_nobody_else_is_called(source: Make) -> None:
    file = source(LONG)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Long"), "long")
        await kernel.start(PeriodicContext(rate=0.5), old, activate=True)
        await kernel.sleep(0.1)
        file.replace("pass  # reload", "1 / 0")
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.2):
                await kernel.reload("Long")
        await kernel.sleep(3.0)
        assert kernel.components["long"] is old
        assert not kernel.registry.renewing
        with pytest.raises(StateError):
            await kernel.start(PeriodicContext(rate=1.0), Component("strange"))


FADING = """
class Fading(Component):
    data = InPort(TimedDouble)

    def __init__(self, name=""):
        super().__init__(name)
        self.ends = 0

    async def on_execute(self):
        pass  # execute

    async def on_finalize(self):
        await self.sleep(0.1)
        self.ends += 1
"""


class Writer(Component):
    out = OutPort(TimedDouble)


@simulated
async def test_one_that_is_removed_while_its_code_is_taken_back_is_gone_once_and_for_all(source: Make) -> None:
    file = source(FADING)
    async with Kernel() as kernel:
        writer = await kernel.create(Writer, "writer")
        old = await kernel.create(file.get("Fading"), "fading")
        connector = await kernel.connect(writer.out, old.data)
        await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
        file.replace("    data = InPort(TimedDouble)\n", "")
        file.replace("pass  # execute", "await self.sleep(1.0); 1 / 0")
        reload = asyncio.ensure_future(kernel.reload("Fading", seconds=5.0))
        await kernel.sleep(0.5)
        new: Any = kernel.components["fading"]
        removal = asyncio.ensure_future(kernel.remove(new))
        with pytest.raises(ComponentError):
            await reload
        await removal
        assert list(kernel.components) == ["writer"]
        assert (old.ends, new.ends) == (1, 1)
        assert connector.closed
        assert not kernel.registry._leaving
