"""Arguments that cannot be meant: each is one error of aiorts that says what was expected, and nothing is changed."""

from __future__ import annotations

import asyncio
import math
import platform
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, Composite, Kernel, LifecycleState, OutPort, Param, PeriodicContext, Supervision
from aiorts.errors import AiortsError, ConfigurationError, StateError, WiringError
from aiorts.events import StateChanged
from aiorts.testing import simulated
from aiorts.types import TimedDouble

if TYPE_CHECKING:
    from collections.abc import Callable


class Pid(Component):
    gain = Param(1.0)


async def _now(result: object) -> None:
    """For calls that are not awaited."""


CALLS: dict[str, tuple[Callable[[Kernel, Any], Any], str]] = {
    "change list": (lambda k, c: c.configuration.change("default", []), "pid0: expected values by parameter"),
    "change text": (lambda k, c: c.configuration.change("default", "gain=1"), "pid0: expected values by parameter"),
    "change none": (lambda k, c: c.configuration.change("default", None), "pid0: expected values by parameter"),
    "add a set": (lambda k, c: c.configuration.add("soft", 3), r"pid0 \(set soft\): expected values by parameter"),
    "replace sets": (lambda k, c: c.configuration.replace([]), "pid0: expected sets by name"),
    "merge sets": (lambda k, c: c.configuration.merge("soft"), "pid0: expected sets by name"),
    "merge a set": (
        lambda k, c: c.configuration.merge({"soft": 3}),
        r"pid0 \(set soft\): expected values by parameter",
    ),
    "wait for list": (lambda k, c: k.wait_ready([c]), "expected components or their names, one argument each"),
    "wait for number": (lambda k, c: k.wait_ready(3), "3: expected components or their names"),
    "systemd": (
        lambda k, c: _now(k.notify_systemd(3, environ={"NOTIFY_SOCKET": "/nowhere/aiorts"})),  # type: ignore[arg-type]
        "3: expected components or their names",
    ),
    "start in order text": (lambda k, c: k.start_in_order("pid0"), r"expected rules, such as \[StartRule"),
    "start in order names": (lambda k, c: k.start_in_order(["pid0"]), r"expected rules, such as \[StartRule"),
    "monitor number": (lambda k, c: _now(k.monitor([3])), r"expected a list of paths"),  # type: ignore[list-item]
    "monitor all of it": (
        lambda k, c: _now(k.monitor(["pid0"])),
        "pid0: is a component; say what of it, such as pid0.state",
    ),
    "watch of none": (lambda k, c: _now(k.changes(length=0)), "changes: length = 0: expected a whole number from 1 on"),
    "watch of text": (lambda k, c: _now(k.changes(length="8")), "changes: length = '8': expected"),  # type: ignore[arg-type]
    "subscribe length": (
        lambda k, c: _now(k.bus.subscribe(StateChanged, print, length=-1)),
        "subscribe: length = -1: expected a whole number",
    ),
    "subscribe nobody": (
        lambda k, c: _now(k.bus.subscribe(StateChanged, None)),  # type: ignore[arg-type]
        r"subscribe\(StateChanged\): expected a function to call, got None",
    ),
    "supervise a name": (lambda k, c: _now(k.supervise("pid0", Supervision())), "'pid0': does not belong to"),  # type: ignore[arg-type]
    "factory": (
        lambda k, c: _now(k.supervise(c, Supervision("restart"), factory=3)),  # type: ignore[arg-type]
        "pid0: factory = 3: expected a function of a name",
    ),
    "remove nobody": (lambda k, c: k.remove(None), "None: does not belong to"),  # type: ignore[arg-type]
    "remove the kernel": (lambda k, c: k.remove(k), "kernel: does not belong to"),  # type: ignore[arg-type]
    "remove a name": (lambda k, c: k.remove("pid0"), "'pid0': does not belong to"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("name", CALLS)
@simulated
async def test_what_cannot_be_meant_is_said_and_changes_nothing(name: str) -> None:
    call, why = CALLS[name]
    async with Kernel() as kernel:
        pid = await kernel.create(Pid, "pid0")
        await kernel.start(PeriodicContext(100.0), pid, activate=True)
        kernel.supervise(pid, Supervision())
        before = pid.configuration.profile, kernel.profile().structure(), kernel.bus.observers
        with pytest.raises(AiortsError, match=why):
            await call(kernel, pid)
        assert (pid.configuration.profile, kernel.profile().structure(), kernel.bus.observers) == before


@pytest.mark.parametrize("seconds", ["5", math.nan, math.inf, -1.0, 0, True, [5]], ids=repr)
@pytest.mark.parametrize("composed", [False, True], ids=["", "composite"])
@simulated
async def test_a_start_is_not_given_any_time_out(composed: bool, seconds: Any) -> None:
    async with Kernel() as kernel:
        pid: Component = await kernel.create(Pid, "pid0")
        if composed:
            pid = await kernel.add(Composite("whole", pid))
        context, before = PeriodicContext(100.0), kernel.profile().structure()
        with pytest.raises(ConfigurationError, match=r"start: timeout = .*: expected seconds above 0, or None"):
            await kernel.start(context, pid, activate=True, timeout=seconds)
        assert (context.name, context.running, dict(kernel.contexts), pid.states) == ("", False, {}, {})
        assert kernel.profile().structure() == before
        await kernel.start(context, pid, activate=True, timeout=1)
        assert pid.state is LifecycleState.ACTIVE


class Unsightly(Pid):
    """Raises when it is looked at."""

    out = OutPort(TimedDouble)

    def __repr__(self) -> str:
        raise RuntimeError("no text")


@simulated
async def test_a_component_without_a_text_is_as_good_as_any() -> None:
    async with Kernel() as kernel:
        one, stranger = await kernel.create(Unsightly), Unsightly("stranger")
        await kernel.start(PeriodicContext(100.0), one, activate=True)
        with pytest.raises(StateError, match="stranger: does not belong to"):
            await kernel.remove(stranger)
        stranger_port: Any = stranger
        with pytest.raises(WiringError, match=r"unsightly0.out -> <Unsightly that cannot be shown>: expected"):
            await kernel.connect(one.out, stranger_port)
        await kernel.remove(one)
        assert not kernel.components


@pytest.mark.parametrize(
    ("wishes", "why"),
    [
        ({"groups": 3}, "whole: groups = 3: expected groups of names"),
        ({"groups": ["pid0"]}, r"whole: groups = \['pid0'\]: expected groups of names"),
        ({"groups": [["pid0", 3]]}, "3: no member"),
        ({"exported": 3}, "whole: exported = 3: expected patterns"),
        ({"members": "pid0"}, "whole: members = 'pid0': expected a list of components or names"),
        ({"members": 3}, "whole: members = 3: expected a list"),
        ({"members": ["pid0", 3]}, "whole: expected components or their names, got 3"),
    ],
)
@simulated
async def test_nor_can_a_composite_be_made_of_anything(wishes: dict[str, Any], why: str) -> None:
    async with Kernel() as kernel:
        pid = await kernel.create(Pid, "pid0")
        whole = await kernel.add(Composite("whole", pid))
        await kernel.start(PeriodicContext(100.0), whole, activate=True)
        before = kernel.profile().structure()
        with pytest.raises(AiortsError, match=why):
            await whole.change(**wishes)
        with pytest.raises(AiortsError, match="3: is no member of whole; it has pid0"):
            await whole.remove_members(3)  # type: ignore[arg-type]
        with pytest.raises(AiortsError, match="expected components or their names, got 3"):
            await whole.add_members(3)  # type: ignore[arg-type]
        assert kernel.profile().structure() == before


@simulated
async def test_a_kernel_stops_its_own_contexts_alone() -> None:
    async with Kernel("one") as one, Kernel("two") as two:
        context = await one.start(PeriodicContext(100.0), await one.create(Pid), activate=True)
        with pytest.raises(StateError, match="runs in another kernel than two; stop it there"):
            await two.stop(context)
        assert context.running
        await one.stop(context)
        await one.stop(context)
        await two.stop(PeriodicContext(1.0))


HERE = platform.node()


class Source(Component):
    out = OutPort(TimedDouble)


@pytest.mark.parametrize(
    "before", ["", "here/", f"{HERE}/here/", f"{HERE.upper()}/here/"], ids=["", "kernel", "host", "HOST"]
)
def test_a_path_of_this_kernel_finds_its_port(before: str) -> None:
    async def main() -> None:
        async with Kernel("here") as kernel:
            pid = await kernel.create(Source, "pid0")
            assert kernel.find(f"{before}pid0.out") is pid.out
            assert kernel.find(f"{before}pid0") is pid

    asyncio.run(main())


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("other/pid0", "is in the kernel 'other', and this is 'here'; ask that kernel, or for 'pid0' here"),
        ("Here/pid0.out", "is in the kernel 'Here', and this is 'here'; ask that kernel, or for 'pid0.out' here"),
        (f"{HERE}/other/pid0", "is in the kernel 'other'"),
        (f"far.{HERE}/here/pid0.out", f"is on the host 'far.{HERE}', and this is '{HERE}'; ask a kernel there"),
        ("elsewhere/here/nobody", "is on the host 'elsewhere'"),
    ],
)
def test_a_path_of_another_kernel_or_host_is_refused(path: str, told: str) -> None:
    """It found what has the same name here."""

    async def main() -> None:
        async with Kernel("here") as kernel:
            await kernel.create(Source, "pid0")
            with pytest.raises(WiringError) as caught:
                kernel.find(path)
            assert str(caught.value).startswith(f"{path}: {told}")

    asyncio.run(main())
