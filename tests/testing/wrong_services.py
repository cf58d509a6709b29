"""Services that break one promise each; the conformance suite must find every one of them."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aiorts import Component, KernelService, setting

if TYPE_CHECKING:
    from aiorts import Microkernel
    from aiorts.kernel.loop.deadlines import StopBudget


@dataclass(frozen=True)
class Pace:
    """How often."""

    interval: float = setting(1.0, "Seconds.")


class Good(KernelService):
    """Keeps every promise."""

    name, settings = "pace", Pace

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self.names = set(kernel.components)

    def component_added(self, component: Component) -> None:
        self.names.add(component.name)

    def component_removed(self, component: Component) -> None:
        self.names.remove(component.name)

    def report(self) -> Mapping[str, Any]:
        return {"components": len(self.names)}


class NamedAsATable(Good):
    """Its table would be taken for a misspelt one."""

    name = "component"


@dataclass
class Changing:
    """Is not frozen."""

    interval: float = setting(1.0, "Seconds.")


class ChangingSettings(Good):
    """Its settings may change behind its back."""

    settings = Changing


@dataclass(frozen=True)
class Several:
    """No command line can say this."""

    sizes: tuple[int, ...] = setting((), "Of components.", option=True)


class OptionOfSeveral(Good):
    """A list is to be an option."""

    settings = Several


@dataclass(frozen=True)
class Doubling:
    """What stands in the file is not what is in force."""

    interval: float = setting(1.0, "Seconds.")

    def __post_init__(self) -> None:
        object.__setattr__(self, "interval", 2 * self.interval)


class DoublingSettings(Good):
    """What it goes by, written down and read again, is something else."""

    settings = Doubling


class KnowsOnlyTheNew(Good):
    """Has not looked at what was there before it was attached."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self.names.clear()


class ForgetsReplaced(Good):
    """Raises at a replacement."""

    def components_replaced(self, pairs: Mapping[Component, Component]) -> None:
        raise KeyError("sink")


class ReportsNaN(Good):
    """JSON has no such number."""

    def report(self) -> Mapping[str, Any]:
        return {"mean": float("nan")}


class LeavesATask(Good):
    """Never ends what it began."""

    def configure(self, settings: Any) -> None:
        self.task = asyncio.ensure_future(asyncio.sleep(1e6))


class LeavesATimer(Good):
    """Looks on and on."""

    def configure(self, settings: Pace) -> None:
        self.kernel.call_later(1e6, lambda: None)


class LeavesAThread(Good):
    """A thread that waits forever."""

    def configure(self, settings: Pace) -> None:
        threading.Thread(target=THREADS_END.wait, args=(30.0,), daemon=True).start()


THREADS_END = threading.Event()


class TakesItsTime(Good):
    """The kernel waits for it."""

    async def closing(self, budget: StopBudget) -> None:
        await asyncio.sleep(3.0)
