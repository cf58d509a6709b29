"""The diagrams are those of the table that runs: Mermaid, SCXML and back."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import pytest
from hypothesis import HealthCheck, given, settings

from aiorts import EventContext
from aiorts.errors import DeclarationError
from aiorts.statechart import After, Chart, On, Parallel, State
from aiorts.testing import Rig
from statemachines.test_microstep import chart_of, charts
from statemachines.test_state_machine import Door, Noted, Player

W3C = "{http://www.w3.org/2005/07/scxml}"
CONTENT = {"state", "parallel", "final", "history", "transition", "onentry", "onexit", "initial", "send", "cancel"}


def valid(text: str) -> None:
    """Elements and attributes are SCXML's or of another namespace; targets exist; ids are unique."""
    root = ElementTree.fromstring(text)
    assert root.tag == f"{W3C}scxml"
    assert root.get("version") == "1.0"
    ids = [e.get("id") for e in root.iter() if e.tag.removeprefix(W3C) in ("state", "parallel", "final", "history")]
    assert len(ids) == len(set(ids))
    for element in root.iter():
        if element is not root and element.tag.startswith(W3C):
            assert element.tag.removeprefix(W3C) in CONTENT
        for target in (element.get("target") or "").split():
            assert target in ids
        if element.get("initial") is not None:
            assert element.get("initial") in [child.get("id") for child in element]
    for element in root.iter(f"{W3C}final"):
        assert not list(element.iter(f"{W3C}transition"))
    assert root.find(f"{W3C}transition") is None


@pytest.mark.slow(kept_by="test_components_charts_go_there_and_back")
@pytest.mark.row(104)
@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
@given(charts())
def test_what_is_written_is_valid_and_read_back_it_is_the_same_chart(states: tuple[Any, ...]) -> None:
    chart = chart_of(states)
    if chart is None:
        return
    text = chart.to_scxml()
    valid(text)
    again = Chart.from_scxml(text)
    assert again.structure == chart.structure
    assert again.to_scxml() == text


@pytest.mark.row(104)
@pytest.mark.parametrize("kind", [Door, Noted, Player])
def test_components_charts_go_there_and_back(kind: Any) -> None:
    text = kind.chart.to_scxml()
    valid(text)
    again = Chart.from_scxml(text)
    assert again.structure == kind.chart.structure
    assert again.name == kind.__name__


@pytest.mark.row(104)
def test_a_change_of_the_table_is_a_change_of_the_structure() -> None:
    """OpenRTM's service answers with the same sample text whatever machine runs."""

    class Slower(Door):
        chart = Chart(
            *(
                State("open", After(9.0, to="closing"), On("button", to="closing"), entry="lamp_on")
                if state.name == "open"
                else state
                for state in Door.chart.states
                if isinstance(state, State)
            )
        )

    assert Slower("s").machine.structure != Door("d").machine.structure
    assert "9.0s" in Slower.chart.to_scxml()
    assert "after 9 s" in Slower.chart.to_mermaid()


@pytest.mark.row(104)
@pytest.mark.anyio
async def test_the_drawing_marks_what_is_active() -> None:
    door = Door("door0")
    async with Rig(door, context=EventContext()) as rig:
        rig.feed("button", True)
        await rig.tick()
        lines = [line.strip() for line in door.machine.to_mermaid().splitlines()]
    assert [line for line in lines if line.startswith("class ")] == ["class moving active", "class opening active"]


@pytest.mark.row(104)
def test_the_drawing_has_every_state_and_every_transition_where_both_ends_are() -> None:
    assert Door.chart.to_mermaid() == (
        """stateDiagram-v2
    [*] --> closed
    state closed
    state moving {
        [*] --> opening
        state opening
        state closing
        closing --> opening : obstacle [is_near] / complain
    }
    moving : entry / motor_on
    moving : exit / motor_off
    state open
    open : entry / lamp_on
    open : exit / lamp_off
    closed --> opening : button
    opening --> open : after 2 s
    closing --> closed : after 2 s
    open --> closing : after dwell
    open --> closing : button
"""
    )
    text = Chart(Parallel("end", State("a-b"), State("state", On("x"))), name="odd").to_mermaid()
    assert 'state "end" as s_end_ {' in text
    assert 'state "a-b" as s_a_b_' in text
    assert "s_state_ : x" in text
    assert "\n        --\n" in text


OTHER = """<scxml xmlns="http://www.w3.org/2005/07/scxml" version="1.0">
  <state id="a"><transition event="x y" target="b" cond="ready"/></state>
  <state id="b"><onentry><send event="t" delay="250ms"/></onentry><transition event="t" target="a"/></state>
</scxml>"""


@pytest.mark.row(104)
def test_the_chart_of_another_program_is_read_where_it_means_the_same() -> None:
    expected = Chart(
        State("a", On("x", to="b", guard="ready"), On("y", to="b", guard="ready"), initial=True),
        State("b", After(0.25, to="a")),
    )
    assert Chart.from_scxml(OTHER).structure == expected.structure


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('<state id="a">', '<state id="a"><invoke/>', "invoke is not supported"),
        ('cond="ready"', 'cond="x > 1"', "expected names of methods and In"),
        ('<state id="a">', '<state id="a"><onexit><send event="u" delay="1s"/></onexit>', "send is not supported"),
        ('<state id="a">', '<state id="a"><onentry><cancel sendid="t"/></onentry>', "cancel is not supported"),
        ('delay="250ms"', 'delay="250ms" target="#_parent"', "send is supported as a timer"),
        ('delay="250ms"', 'delayexpr="1 + x"', "send is supported as a timer"),
        ('<state id="a">', '<state id="a"><initial/>', "expected one transition, got 0"),
        ('target="b"', 'target="a b"', "2 targets"),
        ('target="b"', 'target="c"', "no state 'c'"),
        ("250ms", "soon", "send is supported as a timer"),
        ("07/scxml", "08/scxml", "expected scxml of"),
        ("<scxml", "<!DOCTYPE x><scxml", "a document type is not read"),
        ("</scxml>", "", "SCXML: no element found"),
    ],
)
def test_what_a_chart_has_no_word_for_is_refused_by_name(old: str, new: str, says: str) -> None:
    with pytest.raises(DeclarationError, match=says):
        Chart.from_scxml(OTHER.replace(old, new))


def scxml(*states: str, **attributes: str) -> str:
    words = "".join(f' {word}="{value}"' for word, value in attributes.items())
    return f'<scxml xmlns="http://www.w3.org/2005/07/scxml" version="1.0"{words}>{"".join(states)}</scxml>'


@pytest.mark.row(104)
@pytest.mark.parametrize("event", ["door", "door.", "door.*", "door.* door", "door door.open"])
def test_an_event_of_scxml_takes_what_begins_with_it_however_it_is_written(event: str) -> None:
    chart = Chart.from_scxml(
        scxml(f'<state id="a"><transition event="{event}" target="b"/></state>', '<state id="b"/>')
    )
    assert chart.structure == Chart(State("a", On("door", to="b"), initial=True), State("b")).structure


TIMER = '<onentry><send event="t" delay="1s"/></onentry>'
CANCEL = '<onexit><cancel sendid="t"/></onexit>'
HEARD = '<transition event="t" target="a"/>'
A, B = '<state id="a"><transition event="go" target="b"/></state>', '<state id="b"/>'


@pytest.mark.row(104)
@pytest.mark.parametrize(
    ("text", "says"),
    [
        (scxml(A, f'<state id="b">{TIMER}{HEARD}<transition event="x" target="a"/></state>'), "goes on when the state"),
        (
            scxml(f'<state id="o">{A}<state id="b">{TIMER}{HEARD}</state><transition event="x" target="a"/></state>'),
            "goes on when the state is left",
        ),
        (
            scxml(f'<parallel id="p">{A}<state id="b">{TIMER}{HEARD}</state></parallel>'),
            "goes on when the state is left",
        ),
        (
            scxml(
                f'<state id="a"><transition event="t" target="b"/></state><state id="b">{TIMER}{CANCEL}{HEARD}</state>'
            ),
            "event 't' is also a timer of b",
        ),
        (
            scxml(A, '<state id="b"><onentry><send event="go.1" delay="1s"/></onentry></state>'),
            "SCXML: a: event 'go' is also a timer of b",
        ),
        (
            scxml(A, f'<state id="b">{TIMER}{CANCEL}<transition event="t" cond="g"/>{HEARD}</state>'),
            "one transition that stays in the state hides another",
        ),
        (scxml(A, f'<state id="b">{CANCEL}</state>'), "cancel 't': is no timer of this state"),
        (
            scxml(A, f'<state id="b">{TIMER}{CANCEL}<transition event="*" target="a"/></state>'),
            "event '\\*' takes timers",
        ),
        (
            scxml('<state id="a"><final id="f"/><transition event="*" target="b"/></state>', B),
            "takes timers and done.state, too",
        ),
        (scxml(A.replace("go", "error.execution"), B), "there is none of the kind here"),
        (scxml(A.replace("go", "error"), B), "there is none of the kind here"),
        (scxml(A.replace("go", "done.invoke.x"), B), "there is none of the kind here"),
        (
            scxml('<state id="o"><state id="m"><state id="x"/><state id="y"/></state></state>', initial="y"),
            "initial='y'",
        ),
        (
            scxml('<state id="o" initial="y"><state id="m"><state id="x"/><state id="y"/></state></state>'),
            "initial='y' is no state directly inside it",
        ),
        (
            scxml(
                '<state id="o"><state id="x"/>',
                '<history id="h"><transition target="x"><log/></transition></history></state>',
            ),
            "history h: only one transition without actions",
        ),
    ],
)
def test_a_chart_of_another_program_that_means_otherwise_is_refused(text: str, says: str) -> None:
    with pytest.raises(DeclarationError, match=says):
        Chart.from_scxml(text)


@pytest.mark.row(104)
@pytest.mark.parametrize(
    "text",
    [
        scxml(A, f'<state id="b">{TIMER}{CANCEL}{HEARD}<transition event="x" target="a"/></state>'),
        scxml(A, f'<state id="b">{TIMER}{HEARD}</state>'),
        scxml(A, f'<state id="b">{TIMER}{CANCEL}<transition event="t" cond="g" target="a"/>{HEARD}</state>'),
        scxml(A, '<state id="b"><transition event="*" target="a"/></state>'),
        scxml('<state id="o" initial="y"><state id="x"/><state id="y"/></state>', initial="o"),
        scxml('<state id="a"><transition event="errors done.state.a" target="b"/><final id="f"/></state>', B),
    ],
)
def test_what_means_the_same_in_both_is_read(text: str) -> None:
    valid(Chart.from_scxml(text).to_scxml())
