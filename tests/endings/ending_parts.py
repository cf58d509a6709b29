"""Components of generated systems. Each counts what it does, and writes its book when it is finalised."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Protocol

from aiorts import Component, Connector, Goal, InPort, OutPort, Param, Provided, Required, Synchronizer
from aiorts.errors import GoalCancelled, GoalFailed
from aiorts.events import Event, HookFailed, StateChanged
from aiorts.types import TimedLong

STEP_NS = 10_000_000
"""Between the stamps of two numbers: those of equal number belong together."""


class Asking(Protocol):
    async def ask(self, number: int) -> int: ...


class Working(Protocol):
    async def work(self, steps: int) -> Goal[int, int]: ...


class Booked(Component):
    """Keeps a book: what it counted, and the ledgers of the connectors that it has had."""

    book: str = Param("", doc="folder of the books")

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.counts: dict[str, int] = {}
        self.had: dict[int, Connector] = {}

    def count(self, what: str, more: int = 1) -> None:
        self.counts[what] = self.counts.get(what, 0) + more

    def look(self) -> None:
        """Note which connectors there are: their counts survive them."""
        for port in self.ports.values():
            if isinstance(port, (InPort, OutPort)):
                self.had |= {id(one): one for one in port.connectors}

    def on_startup(self) -> None:
        self.look()

    def on_activated(self) -> None:
        self.count("activated")
        self.look()

    def on_deactivated(self) -> None:
        self.look()
        self.last()
        self.count("deactivated")

    def last(self) -> None:
        """What it does in its last hook."""

    def on_aborting(self, error: BaseException) -> None:
        self.count("aborted")

    def more(self) -> dict[str, Any]:
        """What else is in its book."""
        return {}

    def on_finalize(self) -> None:
        ledgers = []
        for one in self.had.values():
            now = one.statistics
            ledgers.append(
                {
                    "out": one.out.path,
                    "in": one.in_.path,
                    "written": now.written,
                    "delivered": now.delivered,
                    "dropped": {reason: count for reason, count in now.dropped.items() if count},
                    "left": now.buffered + now.in_flight,
                    "acknowledged": now.acknowledged,
                }
            )
        text = json.dumps({"counts": self.counts, "ledgers": ledgers} | self.more())
        Path(self.book, f"{self.name}.json").write_text(text, encoding="utf-8")


class Keeper(Booked):
    """Says when all is active, and notes whatever fails."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.faults: list[str] = []

    def on_initialize(self) -> None:
        self.kernel.bus.subscribe(HookFailed, self._note)
        self.kernel.bus.subscribe(StateChanged, self._note)

    def _note(self, event: Event) -> None:
        if isinstance(event, HookFailed) or getattr(event, "new", "") == "error":
            self.faults.append(str(event))

    def on_activated(self) -> None:
        super().on_activated()
        print("ready", flush=True)

    def more(self) -> dict[str, Any]:
        return {"faults": self.faults}


class Numbers(Booked):
    """Writes numbers, and one more when it ends."""

    out = OutPort(TimedLong)
    burst: int = Param(1)

    def send(self) -> None:
        self.look()
        self.count("written")
        self.out.write_nowait(TimedLong(self.counts["written"] * STEP_NS, self.counts["written"]))

    def on_execute(self) -> None:
        for _ in range(self.burst):
            self.send()

    def last(self) -> None:
        self.send()


class Patient(Booked):
    """Writes numbers, and waits where there is no room."""

    out = OutPort(TimedLong)
    burst: int = Param(1)

    async def on_execute(self) -> None:
        for _ in range(self.burst):
            self.count("written")
            await self.out.write(TimedLong(0, self.counts["written"]))


class Take(Booked):
    """Reads all that there is."""

    inp = InPort(TimedLong)

    def on_execute(self) -> None:
        self.look()
        self.count("read", len(self.inp.drain()))


class TakeOne(Booked):
    """Reads one sample in a cycle."""

    inp = InPort(TimedLong)

    def on_execute(self) -> None:
        self.look()
        if self.inp.is_new:
            self.inp.read_nowait()
            self.count("read")


class Await(Booked):
    """Waits for a sample in each cycle."""

    inp = InPort(TimedLong)

    async def on_execute(self) -> None:
        await self.inp.read()
        self.look()
        self.count("read")


class Pass(Booked):
    """Passes on what it reads."""

    inp = InPort(TimedLong)
    out = OutPort(TimedLong)

    def on_execute(self) -> None:
        self.look()
        for sample in self.inp.drain():
            self.count("read")
            self.count("written")
            self.out.write_nowait(sample)


class Plant(Booked):
    """Reads what there is, and writes once in each cycle: the other half of a circle."""

    inp = InPort(TimedLong)
    out = OutPort(TimedLong)

    def on_execute(self) -> None:
        self.count("read", len(self.inp.drain()))
        self.count("written")
        self.out.write_nowait(TimedLong(0, self.counts["written"]))


class Fuse(Booked):
    """Passes on the numbers of equal stamps."""

    a = InPort(TimedLong)
    b = InPort(TimedLong)
    out = OutPort(TimedLong)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.sync = Synchronizer(self.a, self.b, policy="exact", length=500)

    def on_execute(self) -> None:
        for one, other in self.sync.drain():
            assert one.data == other.data
            self.count("written")
            self.out.write_nowait(one)

    def more(self) -> dict[str, Any]:
        return {
            "sync": {
                name: {
                    "taken": one.taken,
                    "matched": one.matched,
                    "dropped": {reason: count for reason, count in one.dropped.items() if count},
                    "held": one.held,
                }
                for name, one in self.sync.statistics.items()
            }
        }


class Answer(Booked):
    """Answers, and takes its time."""

    s = Provided[Asking]()

    async def ask(self, number: int) -> int:
        await self.sleep(0.001)
        self.count("answered")
        return number + 1


class AnswerAtOnce(Booked):
    """Answers at once, in whichever thread."""

    s = Provided[Asking]()

    def ask(self, number: int) -> int:
        self.count("answered")
        return number + 1


class Between(Booked):
    """Answers with what another one answers, and asks that one when it ends."""

    s = Provided[Asking](concurrent=True)
    r = Required[Asking](timeout=20.0)

    async def ask(self, number: int) -> int:
        self.count("answered")
        if number > 100:  # it has gone round a circle
            return number
        self.count("asked")
        return await self.r.proxy.ask(number + 100)

    async def on_deactivated(self) -> None:  # type: ignore[override]
        self.count("asked")
        await self.r.proxy.ask(1000)
        super().on_deactivated()


class Ask(Booked):
    """Asks in each cycle, and when it ends."""

    r = Required[Asking](timeout=20.0)
    out = OutPort(TimedLong)

    async def _ask(self) -> None:
        self.count("asked")
        await self.r.proxy.ask(1)
        self.count("written")
        self.out.write_nowait(TimedLong(0, self.counts["written"]))

    async def on_execute(self) -> None:
        for _ in range(3):
            await self._ask()

    async def on_deactivated(self) -> None:  # type: ignore[override]
        await self._ask()
        super().on_deactivated()


class Work(Booked):
    """Works on its goals, a step in each cycle."""

    s = Provided[Working]()

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.goals: list[tuple[Goal[int, int], list[int]]] = []

    def work(self, steps: int) -> Goal[int, int]:
        self.count("accepted")
        self.goals.append((Goal(), [steps]))
        return self.goals[-1][0]

    def on_execute(self) -> None:
        for goal, left in self.goals:
            if goal.cancel_requested:
                goal.cancelled()
            elif left[0] == 0:
                goal.succeed(7)
            else:
                left[0] -= 1
                goal.feedback(left[0])
        self.goals = [one for one in self.goals if one[0].state == "running"]

    def more(self) -> dict[str, Any]:
        now = self.s.statistics.goals
        return {
            "goals": {
                "accepted": now.accepted,
                "ended": now.succeeded + now.cancelled + sum(now.failed.values()),
                "running": now.running,
            }
        }


class Order(Booked):
    """Waits for a goal in each cycle, and for a last one when it ends."""

    r = Required[Working](timeout=20.0)

    async def _order(self) -> None:
        self.count("ordered")
        goal = await self.r.proxy.work(2)
        async for _ in goal:
            self.count("heard")
        await goal.result(timeout=20.0)
        self.count("done")

    async def on_execute(self) -> None:
        await self._order()

    async def on_deactivated(self) -> None:  # type: ignore[override]
        await self._order()
        super().on_deactivated()


class Watch(Booked):
    """Looks at its goal in each cycle, and leaves it when it ends."""

    r = Required[Working](timeout=20.0)
    goal: Goal[int, int] | None = None

    async def on_execute(self) -> None:
        if self.goal is None:
            self.count("ordered")
            self.goal = await self.r.proxy.work(5)
        elif self.goal.state != "running":
            try:
                await self.goal.result()
                self.count("done")
            except (GoalCancelled, GoalFailed):
                self.count("undone")
            self.goal = None
