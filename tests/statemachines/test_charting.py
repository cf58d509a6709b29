"""What is wrong with a table is said when it is defined, with what was meant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from aiorts import EventPort, Param, StateMachineComponent
from aiorts.errors import DeclarationError
from aiorts.statechart import After, Always, Chart, ChartWarning, End, History, On, Parallel, State
from aiorts.types import TimedBoolean, TimedDouble

A = State("closed", On("button", to="open"), initial=True)


@pytest.mark.row(103)
@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Chart(State("closed", On("button", to="opne"), initial=True), State("open")), "did you mean 'open'?"),
        (lambda: Chart(State("closed", On("button", to="open")), State("open")), "needs initial=True; it says none"),
        (lambda: Chart(A, State("open", initial=True)), "'closed' and 'open'"),
        (lambda: Chart(), "has no state inside"),
        (lambda: Chart(A, State("open"), State("open")), "there is a state of that name already"),
        (lambda: Chart(A, State("o pen")), "expected a name of letters"),
        (lambda: Chart(A, State("open", On("x", to="closed"), On("x"))), "cannot be told apart"),
        (lambda: Chart(A, State("open", After(1, to="closed"), After(1.0))), "after 1.0 s cannot be told apart"),
        (
            lambda: Chart(A, State("open", On("x", guard="g"), On("x", guard="g", to="closed"))),
            "on 'x' cannot be told apart",
        ),
        (lambda: Chart(A, State("open", After(0, to="closed"))), "more than 0"),
        (lambda: Chart(A, State("open", After(float("nan"), to="closed"))), "more than 0"),
        (lambda: Chart(A, State("open", After(float("inf"), to="closed"))), "more than 0"),
        (lambda: Chart(A, State("open", Always())), "without end"),
        (lambda: Chart(A, Parallel("open")), "has no state inside"),
        (lambda: Chart(A, Parallel("open", State("l", initial=True), State("r"))), "'l' is not initial"),
        (lambda: Chart(A, State("open", On("x", to="closed", local=True))), "for a target inside 'open'"),
        (lambda: Chart(A, State("open", History("h"))), "has no state inside to remember"),
        (lambda: Chart(A, State("open", State("l"), History("h", to="closed"))), "is not inside 'open'"),
        (lambda: Chart(A, State("open", On("done.state.clsed"))), "did you mean 'closed'?"),
        (lambda: Chart(A, State("open", On("after.open.1"))), "expected an event's name"),
        (lambda: Chart(A, State("open", On("after"))), "expected an event's name"),
        (lambda: Chart(A, State("open", On("x"), On("x.y", to="closed"))), "is always taken; write it after the other"),
        (lambda: Chart(A, State("open", On("x.*"))), "'x' takes all that begins with it and a dot; write 'x'"),
        (lambda: Chart(A, State("open", 3)), "expected states and transitions, got 3"),  # type: ignore[arg-type]
        (lambda: Chart(A, State("open"), On("x", to="closed")), "local=True"),
    ],
)
def test_a_mistake_in_a_table_is_named(make: Callable[[], Any], says: str) -> None:
    with pytest.raises(DeclarationError, match=says.replace("?", r"\?").replace("(", r"\(")):
        make()


@pytest.mark.row(103)
def test_a_state_that_nothing_leads_to_is_warned_of_where_the_class_is_written() -> None:
    with pytest.warns(ChartWarning, match="Lost: nothing leads to state 'cellar'") as caught:

        class Lost(StateMachineComponent):
            chart = Chart(A, State("open"), State("cellar", State("box")))

    assert len(caught) == 1
    assert caught[0].filename == __file__


def define(chart: Chart, **members: Any) -> Any:
    return type("Door", (StateMachineComponent,), {"chart": chart, **members})


@pytest.mark.row(103)
@pytest.mark.parametrize(
    ("chart", "says"),
    [
        (Chart(State("s", entry="lamp_om")), "no method 'lamp_om'; did you mean 'lamp_on'"),
        (Chart(State("s", On("x", guard="waits"))), "waits is async; a guard only looks"),
        (Chart(State("s", entry="needs_two")), r"expected \(self\) or \(self, what came"),
        (Chart(State("s", After("dwel", to="s"))), "no parameter 'dwel'; did you mean 'dwell'"),
        (
            Chart(State("s", On("button", action="wants_number"))),
            "takes a TimedDouble, and button carries TimedBoolean",
        ),
        (Chart(State("s", entry=lambda: None)), "expected"),
    ],
)
def test_what_a_table_names_is_checked_when_the_class_is_defined(chart: Chart, says: str) -> None:
    async def waits(self: object) -> bool:
        return True

    def wants_number(self: object, sample: TimedDouble) -> None: ...

    wants_number.__annotations__["sample"] = TimedDouble
    with pytest.raises(DeclarationError, match=says):
        define(
            chart,
            lamp_on=lambda self: None,
            waits=waits,
            needs_two=lambda self, a, b: None,
            dwell=Param(1.0),
            wants_number=wants_number,
            button=EventPort(TimedBoolean),
        )


def test_the_hooks_that_the_machine_uses_are_not_overwritten() -> None:
    with pytest.raises(DeclarationError, match=r"Door.on_execute: is where the machine runs; say Chart\(..., do="):
        define(Chart(State("s")), on_execute=lambda self: None)
    with pytest.raises(DeclarationError, match="has no chart"):
        StateMachineComponent()


def test_a_declaration_is_a_value() -> None:
    assert State("a", On("x", to="b"), entry="f") == State("a", On("x", to="b"), entry="f")
    assert State("a") != Parallel("a")
    assert End("a") != State("a")
    assert repr(State("a", On("x"), initial=True)).startswith("State('a', On(event='x'")
    assert len({State("a"), State("a")}) == 1


@pytest.mark.row(103)
def test_an_event_port_that_no_transition_is_for_is_warned_of() -> None:
    with pytest.warns(ChartWarning, match="Door.buton: no transition is for event 'buton'; did you mean 'button'"):
        define(Chart(State("a", On("button"))), buton=EventPort(TimedBoolean))


def test_names_that_the_machine_needs_are_kept_for_it() -> None:
    with pytest.raises(DeclarationError, match="is the component's state machine"):
        define(Chart(State("a")), machine=3)
