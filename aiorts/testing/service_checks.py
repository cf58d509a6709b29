"""The conformance suite of services: the promises on which a kernel and its other parts rely; run in virtual time."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
import tomllib
from collections.abc import Callable, Coroutine, Iterable, Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from aiorts.assembly import Kernel
from aiorts.contexts import PeriodicContext
from aiorts.kernel import Component, InPort, KernelService, OutPort
from aiorts.kernel.extensions.arguments import OPTION_TYPES, flags_of, settings_faults, settings_of
from aiorts.kernel.loop.bus import HookAfter
from aiorts.kernel.service import HOOKS, notify
from aiorts.model.declared import options_of
from aiorts.model.names import check_name
from aiorts.model.plain import plain
from aiorts.system.file.parse import may_be_a_service
from aiorts.testing.conformance import Suite, expect
from aiorts.testing.simulation import simulate

if TYPE_CHECKING:
    from aiorts.clock import SimulatedClock


class _Case(NamedTuple):
    kind: type[KernelService]
    given: Mapping[str, Any]


_SUITE: Suite[_Case] = Suite()


def check_service(
    kind: type[KernelService],
    settings: Mapping[str, Any] | None = None,
    *,
    only: Iterable[str] | None = None,
    skip: Iterable[str] = (),
) -> None:
    """Hold a service to what a kernel relies on; `SERVICE_CHECKS` lists the promises.

    Args:
        kind: the class, as it is offered.
        settings: the settings to check it with, as in its table of a system file; its defaults by default.
        only: names of the checks to run; by default all. skip: names of checks to leave out.

    Raises:
        ConformanceError: names the check that failed, what was expected, what happened.
    """
    _SUITE.run(kind.__name__, _Case(kind, settings or {}), only, skip)


class _Source(Component):
    """Writes a number in each cycle."""

    out = OutPort(float)

    def on_execute(self) -> None:
        self.out.write_nowait(1.0)


class _Sink(Component):
    """Reads the numbers."""

    inp = InPort(float)

    def on_execute(self) -> None:
        self.inp.drain()


class _Faults(logging.Handler):
    """Collects, while entered, what the kernel logs of services whose methods raised."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.told: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.getMessage().startswith("service "):
            self.told.append(record.getMessage())

    def __enter__(self) -> list[str]:
        logging.getLogger("aiorts").addHandler(self)
        return self.told

    def __exit__(self, *_: object) -> None:
        logging.getLogger("aiorts").removeHandler(self)


def _played(check: Callable[[_Case, Kernel], Coroutine[Any, Any, None]]) -> Callable[[_Case], None]:
    """Add a check that runs in an open kernel of its own, and fails when a method of the service raises."""

    def run(case: _Case) -> None:
        async def main() -> None:
            async with Kernel("stage") as kernel:
                await check(case, kernel)

        with _Faults() as told:
            simulate(main())
        expect(not told, "methods that raise nothing", "; ".join(told))

    run.__name__, run.__doc__ = check.__name__, check.__doc__
    return _SUITE.check(run)


async def _life(case: _Case, kernel: Kernel) -> KernelService:
    """Attach a service to an empty kernel, then start, run and end a small system; return the service."""
    service = kernel.service(case.kind)
    service.configure(settings_of(case.kind.settings, case.given))
    source, sink = await kernel.add(_Source("source")), await kernel.add(_Sink("sink"))
    await kernel.connect(source.out, sink.inp)
    await service.starting()
    context = await kernel.start(PeriodicContext(10.0), source, sink, activate=True)
    await kernel.sleep(1.0)
    newer = _Sink("sink")
    notify([service], "components_replaced", {sink: newer})
    notify([service], "components_replaced", {newer: sink})
    unsubscribe = kernel.bus.subscribe(HookAfter, lambda _event: None)
    await kernel.sleep(1.0)
    unsubscribe()
    await kernel.stop(context)
    await kernel.remove(source)
    return service


@_SUITE.check
def has_a_name(case: _Case) -> None:
    """Its name can be a table of a system file, and is not nearly one of aiorts' own."""
    check_name(case.kind.name, "service")
    expect(may_be_a_service(case.kind.name), "a name of its own", repr(case.kind.name))


@_SUITE.check
def has_settings(case: _Case) -> None:
    """Its settings are a frozen dataclass; each field has a right default, a text and, as an option, a type for it."""
    settings: type = case.kind.settings
    expect(is_dataclass(settings), "a dataclass", settings)
    params: Any = getattr(settings, "__dataclass_params__", None)
    expect(bool(params and params.frozen), "a frozen one", settings)
    expect(settings() == settings(), "equal defaults", settings())
    told = options_of(settings)
    bare = [one.name for one in fields(settings) if not (one.name in told and told[one.name].doc)]
    expect(not bare, "a text for each field", f"none for {', '.join(bare)}")
    unfit = [name for name, kind in flags_of(settings).items() if kind is None]
    expect(not unfit, f"as an option of `aiorts run` {OPTION_TYPES}", f"another type for {', '.join(unfit)}")


def _toml(value: Any) -> str:
    return str(value) if isinstance(value, float) else json.dumps(plain(value))  # TOML has inf and nan


@_SUITE.check
def comes_back_from_its_table(case: _Case) -> None:
    """Settings written as the table of a system file and read again are the same; an unknown key is refused."""
    settings = settings_of(case.kind.settings, case.given)
    lines = [f"{key} = {_toml(value)}" for key, value in asdict(settings).items() if value is not None]
    table = tomllib.loads("\n".join(lines))
    faults = [f"{key}: {what}" for key, what, _ in settings_faults(case.kind.settings, table)]
    expect(not faults, "no fault", "; ".join(faults))
    expect(settings_of(case.kind.settings, table) == settings, f"{settings}", settings_of(case.kind.settings, table))
    faults = [what for _, what, _ in settings_faults(case.kind.settings, {"no_such_key": 1})]
    expect(len(faults) == 1, "no_such_key refused", faults)


@_played
async def follows_a_system(case: _Case, kernel: Kernel) -> None:
    """It hears of components that come, are replaced and go, of connectors and of observers, and raises nothing."""
    await _life(case, kernel)
    expect(set(kernel.components) == {"sink"}, "the components that were there", set(kernel.components))


@_played
async def comes_to_a_system_that_runs(case: _Case, kernel: Kernel) -> None:
    """It may be attached when there are components and contexts, and hears of those that go."""
    source = await kernel.add(_Source("source"))
    await kernel.start(PeriodicContext(10.0), source, activate=True)
    service = kernel.service(case.kind)
    service.configure(settings_of(case.kind.settings, case.given))
    await kernel.sleep(1.0)
    await kernel.remove(source)


@_played
async def reports_what_json_can_carry(case: _Case, kernel: Kernel) -> None:
    """`report` gives figures and texts by name, again and again, and they stand in the kernel's profile."""
    service = await _life(case, kernel)
    told = dict(service.report())
    json.dumps(told, allow_nan=False)
    got = dict(kernel.profile().services.get(case.kind.name, {}))
    expect(got.keys() == told.keys(), f"{sorted(told)}", sorted(got))


@_SUITE.check
def leaves_nothing(case: _Case) -> None:
    """Closed within 2 s it leaves no task, thread or timer, whether it was used or not."""

    async def main(clock: SimulatedClock) -> None:
        for used in (False, True):
            tasks, threads, timers = asyncio.all_tasks(), set(threading.enumerate()), clock.pending
            async with Kernel("stage", clock=clock) as kernel:
                if used:
                    await _life(case, kernel)
                else:
                    kernel.service(case.kind)
                began = clock.monotonic_ns()
            took = (clock.monotonic_ns() - began) / 1e9
            expect(took <= 2.0, "closing within 2 s", f"{took:g} s")
            left = [task.get_name() for task in asyncio.all_tasks() - tasks]
            expect(not left, "no task left", ", ".join(left))
            others = [thread.name for thread in set(threading.enumerate()) - threads]
            expect(not others, "no thread left", ", ".join(others))
            expect(clock.pending <= timers, "no timer left", f"{clock.pending - timers} more")

    simulate(main)


@_SUITE.check
def closes_after_a_fault(case: _Case) -> None:
    """When its own methods have raised, the kernel goes on, says so, and closes."""
    for hook in (*HOOKS, "closing", "ending"):
        kind = type(case.kind.__name__, (case.kind,), {hook: _failing(getattr(case.kind, hook), hook)})

        async def main(kind: type[KernelService] = kind) -> None:
            async with Kernel("stage") as kernel:
                await _life(_Case(kind, case.given), kernel)

        with _Faults() as told:
            simulate(main())
        expect(any(f": {hook} failed" in line for line in told), f"a line of the log that {hook} failed", told)


def _failing(method: Callable[..., Any], hook: str) -> Callable[..., Any]:
    """The method, changed to raise an exception when its work is done."""

    def fail(self: KernelService, *args: Any) -> Any:
        method(self, *args)
        raise ZeroDivisionError("a conformance check makes this method fail")

    async def fail_later(self: KernelService, *args: Any) -> Any:
        await method(self, *args)
        raise ZeroDivisionError("a conformance check makes this method fail")

    return fail_later if hook in ("closing", "ending") else fail


SERVICE_CHECKS: Mapping[str, str] = _SUITE.promises
"""The promises that `check_service` demands: name of the check -> promise."""
