"""The types that the table says of arguments, results and items: complete, and what kernels answer is of them."""

from __future__ import annotations

import dataclasses
import re
import typing
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, Final, Protocol

import pytest
from anyio import create_task_group

from aiorts import Component, Goal, MultiModeComponent, PeriodicContext, Provided, StateMachineComponent
from aiorts.control.operation import Operation
from aiorts.control.operations import OPERATIONS
from aiorts.model.annotations import fields_of_row
from aiorts.model.reading import from_plain
from aiorts.model.wanted.carried import carried
from aiorts.planning import wanted_of
from aiorts.sessions import END, Client
from aiorts.statechart import Chart, On, State
from control_parts import WAIT, controlled, with_client

ROWS = list(OPERATIONS.values())
OPEN = {
    # Arguments: values of parameters and calls, and options that a kind or a plugin defines.
    *("Calling.args", "Calling.kwargs", "Configuring.values", "Creation.params", "Sending.data"),
    *("Start.options", "Wiring.options"),
    # Results and items: values of parameters, of calls, of samples, of fields of events; what plugins' services say.
    *("ConfigurationProfile.sets", "ConfigurationReport.sets", "GoalEnd.result", "Happened.event", "Reading.values"),
    *("ParameterProfile.choices", "ParameterProfile.default", "ParameterProfile.value"),
    *("Limits.choices", "ParameterReport.choices", "ParameterReport.default", "ParameterReport.value"),
    *("Result.value", "SystemProfile.services", "Tapping.data", "ToldChange.event", "goal.item"),
    # Steps of plans: parameters and options, as system files have them.
    *("ComponentEntry.limits", "ComponentEntry.params", "ComponentEntry.sets"),
    *("ConnectionEntry.options", "ContextEntry.options", "PlannedStep.after", "PlannedStep.before"),
}
"""Where any value may be, as "Class.field"."""


def anywhere(hint: Any, path: str, seen: set[Any]) -> Iterator[str]:
    """The places in a type where any value may be."""
    if hint is Any or hint is object:
        yield path
    elif isinstance(hint, type) and dataclasses.is_dataclass(hint):
        if hint not in seen:
            seen.add(hint)
            names = typing.get_type_hints(hint)
            for one in dataclasses.fields(hint):
                yield from anywhere(names[one.name], f"{hint.__name__}.{one.name}", seen)
    else:
        for one in fields_of_row(hint).values() or typing.get_args(hint):
            yield from anywhere(one, path, seen)


def test_any_value_may_be_only_where_it_is_said() -> None:
    found: set[str] = set()
    for row in ROWS:
        for what in ("arguments", "result", "item", "end"):
            found |= set(anywhere(getattr(row, what), f"{row.name}.{what}", set()))
    assert found == OPEN


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_a_row_is_described_in_one_sentence(row: Operation) -> None:
    assert re.fullmatch(r"[A-Z][^\n]*[^.]\.", row.text)
    assert ". " not in row.text
    assert row.streams or row.end is None


# -- what a kernel answers --------------------------------------------------------------------------------------------


class Driving(Protocol):
    def gears(self) -> int: ...
    async def drive(self, metres: int) -> Goal[int, str]: ...


class Car(Component):
    """Drives a metre in a cycle."""

    driving = Provided[Driving]()
    goal: Goal[int, str] | None = None

    def gears(self) -> int:
        return 5

    async def drive(self, metres: int) -> Goal[int, str]:
        self.goal = Goal()
        return self.goal

    def on_execute(self) -> None:
        if self.goal is not None and self.goal.state == "running":
            self.goal.feedback(1)
            self.goal.succeed("there")


class Lamp(MultiModeComponent):
    """Shines."""

    modes = ("dark", "bright")


class Gate(StateMachineComponent):
    """Opens."""

    chart = Chart(State("closed", On("open", to="opened"), initial=True), State("opened"))


BEFORE: Final[list[str]] = []
"""The system as it was at first."""
CALLS: Final[tuple[tuple[str, dict[str, Any]], ...]] = (
    ("names", {}),
    ("origin", {}),
    ("outline", {}),
    ("part", {"components": ["counter0"]}),
    ("connectors", {}),
    ("catalogue", {"components": ["FlexiAdd"], "contexts": ["periodic"]}),
    ("contexts", {}),
    ("fits", {"port": "counter0.out"}),
    ("configuration", {"component": "counter0"}),
    ("dump_configuration", {}),
    ("log_levels", {}),
    ("machine", {"component": "lamp0"}),
    ("machine", {"component": "gate0"}),
    ("save", {"folder": str(Path(__file__).parents[2])}),
    ("schema", {"type": "TimedDouble"}),
    ("sizes", {"connectors": ["counter0.out-reader0.in"]}),
    ("measure", {"connectors": ["counter0.out-reader0.in"]}),
    ("statistics", {"timed": ["counter0.out-reader0.in"]}),
    ("profile", {}),
    ("events", {}),
    ("changes", {}),
    ("log", {"follow": True}),
    ("tap", {"port": "counter0.out"}),
    ("tap", {"port": "counter0.out", "frames": True}),
    ("counters", {"rate": 50.0, "measured": ["counter0.out-reader0.in"]}),
    ("monitor", {"paths": ["counter0.out", "counter0.step"], "rate": 100.0}),
    ("interfaces", {"port": "car0.driving"}),
    ("call", {"path": "car0.driving.gears"}),
    ("goal", {"path": "car0.driving.drive", "args": [1]}),
    ("send_event", {"component": "gate0", "event": "open"}),
    ("set_mode", {"component": "lamp0", "mode": "bright"}),
    ("log_level", {"level": "info"}),
    ("inject", {"port": "reader0.in", "lines": ['{"data": 1.0}']}),
    ("configure", {"component": "counter0", "values": {"": {"step": 2.0}}}),
    ("load_configuration", {"parts": ["schema = 1\n"]}),
    ("set_rate", {"context": "loop", "rate": 200.0}),
    ("deactivate", {"component": "reader0"}),
    ("activate", {"component": "reader0"}),
    ("leave_context", {"context": "loop", "members": ["reader0"]}),
    ("start_context", {"name": "more", "options": {"rate": 10.0}}),
    ("join_context", {"context": "more", "members": ["reader0"]}),
    ("stop_context", {"context": "more"}),
    ("create", {"type": f"{__file__}:Gate", "name": "gate1"}),
    ("disconnect", {"at": ["reader0"]}),
    ("connect", {"ports": ["counter0.out", "reader0.in"]}),
    ("hold", {"component": "gate1", "holder": "another"}),
    ("plan", {"wanted": BEFORE}),
    ("change", {"wanted": BEFORE}),
    ("decide", {"keep": False}),
    ("apply", {"wanted": BEFORE}),
    ("remove", {"components": ["gate0"]}),
    ("stop", {}),
)
"""Each operation, in an order in which each has something to answer; the system is changed back to what it was."""
UNCALLED: Final = frozenset({"add_members", "remove_members", "reset", "reload"})
"""Answered by `Done`; and by what names a file as this process has it."""


@pytest.mark.anyio
async def test_what_a_kernel_answers_is_of_the_type_that_the_row_says() -> None:
    assert {name for name, _ in CALLS} | UNCALLED == set(OPERATIONS)

    def work(client: Client) -> None:
        for name, arguments in CALLS:
            row = OPERATIONS[name]
            if not row.streams:
                _check(row.result, client.call(name, WAIT, **arguments))
                continue
            with closing(client.stream(name, WAIT, **arguments)) as stream:
                _check(row.result, stream.began)
                if name == "log":
                    continue  # nothing is wrong
                if name in ("events", "changes"):
                    client.call("configure", WAIT, component="counter0", values={"": {"step": float(len(name))}})
                while (item := stream.next(WAIT)) is not END:
                    _check(row.item, item)
                    if name != "goal":
                        break
                else:
                    _check(row.end, stream.result)

    async with controlled("types") as kernel, create_task_group() as group:
        group.start_soon(kernel.wait_stop_requested)  # as `stop` wants it
        others = [await kernel.create(kind, name) for kind, name in ((Car, "car0"), (Gate, "gate0"), (Lamp, "lamp0"))]
        await kernel.start(PeriodicContext(rate=100.0, name="other"), *others, activate=True)
        BEFORE[:] = [carried(wanted_of(kernel, []))]
        await with_client("types", work)


def _check(kind: Any, value: Any) -> None:
    unknown: dict[str, Any] = {}
    from_plain(type(None) if kind is None else kind, value, unknown=unknown)
    assert unknown == {}
