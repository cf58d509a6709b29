"""A client's session without its socket: every cell of its tables, and bytes of any kind and division."""

from __future__ import annotations

from collections import deque
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import AiortsError, BusyError, ClosedError, ControlError, LimitError, StateError, WireError
from aiorts.sessions import framed, frames
from aiorts.sessions.protocol import BYE, answer_in
from aiorts.sessions.session import (
    BYTES,
    CALL,
    ITEMS,
    SESSION,
    Answer,
    Call,
    CallState,
    ClientSession,
    Do,
    Frame,
    Said,
    SessionState,
)
from campaign import cases

HELLO = {"hello": {"protocol": 1, "epoch": "ab", "right": "view"}}
REFUSED = {"error": {"code": "E-BUSY", "text": "256 clients look into this kernel already"}}
FRAMES: dict[Frame, dict[str, Any]] = {
    "hello": {"hello": {"protocol": 1, "epoch": "cd"}},
    "answer": {"id": 1, "ok": "it"},
    "refusal": REFUSED,
    "busy": {"busy": 1.5},
    "other": {"note": "of a newer kernel"},
}
ANSWERS: dict[Said, dict[str, Any]] = {
    "ok": {"ok": "it"},
    "began": {"ok": "it"},
    "item": {"item": "it", "missed": 2},
    "end": {"end": "it", "missed": 2},
    "error": {"error": {"code": "E-STATE", "text": "it"}},
}


def opened() -> ClientSession:
    """A session whose kernel has said hello."""
    session = ClientSession("pc/k")
    assert session.receive(framed(HELLO)) == []
    return session


def said(frame: bytes) -> dict[Any, Any]:
    """What this end says in a frame."""
    (one,) = (answer_in(one) for one in frames(bytearray(frame), 1 << 20))
    return one


# -- every cell --------------------------------------------------------------------------------------------------------

IN_SESSION: dict[tuple[str, str], tuple[str, type[AiortsError] | None, bool]] = {
    ("greeting", "hello"): ("open", None, False),
    ("greeting", "answer"): ("ended", WireError, False),
    ("greeting", "refusal"): ("ended", BusyError, False),
    ("greeting", "busy"): ("greeting", None, False),
    ("greeting", "other"): ("ended", WireError, False),
    ("open", "hello"): ("open", None, False),
    ("open", "answer"): ("open", None, True),
    ("open", "refusal"): ("ended", BusyError, False),
    ("open", "busy"): ("open", None, False),
    ("open", "other"): ("open", None, False),
    **{("ended", kind): ("ended", ClosedError, False) for kind in get_args(Frame)},
}
"""State and frame: the state afterwards, the error that ends the session, whether the call has its answer."""


@pytest.mark.parametrize(("state", "kind"), IN_SESSION)
def test_each_frame_in_each_state_of_a_session(state: str, kind: str) -> None:
    session = ClientSession("pc/k") if state == "greeting" else opened()
    call, _ = session.begin("names", {})
    if state == "ended":
        session.end(ClosedError("pc/k: has ended"))
    came = session.receive(framed(FRAMES[kind]))
    after, error, answered = IN_SESSION[state, kind]
    assert session.state == after
    assert (type(session.error) if session.error is not None else None) is error
    assert came == [call] * answered
    assert session.busy == (1.5 if kind == "busy" and state != "ended" else 0.0)
    assert session.epoch == ("ab" if state != "greeting" else "cd" if kind == "hello" else "")
    if error is not None:
        with pytest.raises(error):
            session.begin("names", {})
        assert session.cancel(call) == b""


def test_the_tables_are_whole() -> None:
    for table, states, columns, cells in (
        (SESSION, SessionState, Frame, IN_SESSION),
        (CALL, CallState, Said, OF_CALL),
    ):
        whole = {(state, column) for state in get_args(states) for column in get_args(columns)}
        assert {(state, column) for state, row in table.items() for column in row} == whole == set(cells)
        for then, does in (cell for row in table.values() for cell in row.values()):
            assert (then in get_args(states), does in get_args(Do)) == (True, True)


OF_CALL: dict[tuple[str, str], str] = {
    ("opening", "ok"): "taken, ended",
    ("opening", "began"): "taken, open",
    ("opening", "item"): "fault",
    ("opening", "end"): "fault",
    ("opening", "error"): "taken, ended",
    ("opening", "cancel"): "sent, ending",
    ("opening", "leave"): "nothing, ending",
    ("open", "ok"): "never",
    ("open", "began"): "fault",
    ("open", "item"): "taken, open",
    ("open", "end"): "taken, ended",
    ("open", "error"): "taken, ended",
    ("open", "cancel"): "sent, ending",
    ("open", "leave"): "nothing, ending",
    ("ending", "ok"): "forgotten",
    ("ending", "began"): "nothing, ending",
    ("ending", "item"): "nothing, ending",
    ("ending", "end"): "forgotten",
    ("ending", "error"): "forgotten",
    ("ending", "cancel"): "nothing, ending",
    ("ending", "leave"): "nothing, ending",
    ("ended", "ok"): "nothing, ended",
    ("ended", "began"): "nothing, ended",
    ("ended", "item"): "nothing, ended",
    ("ended", "end"): "nothing, ended",
    ("ended", "error"): "nothing, ended",
    ("ended", "cancel"): "forgotten",
    ("ended", "leave"): "forgotten",
}


def call_in(session: ClientSession, state: str, *, streams: bool) -> Call:
    """A call that has come so far."""
    call, _ = session.begin("tap", {"port": "a.out"}, streams=streams)
    if streams and state in ("open", "ending"):
        session.receive(framed({"id": call.number, "ok": None}))
        call.take()
    if state == "ended":
        session.receive(framed({"id": call.number, "error": {"code": "E-STATE", "text": "no"}}))
        call.take()
    if state == "ending":
        session.leave(call)
    assert call.state == state
    return call


@pytest.mark.parametrize(("state", "what"), [cell for cell, does in OF_CALL.items() if does != "never"])
def test_each_answer_in_each_state_of_a_call(state: str, what: str) -> None:
    session, does = opened(), OF_CALL[state, what]
    beside, _ = session.begin("names", {})
    call = call_in(session, state, streams=what != "ok")
    sent, came = b"", list[Call]()
    if what == "cancel":
        sent = session.cancel(call)
    elif what == "leave":
        session.leave(call)
    else:
        came = session.receive(framed({"id": call.number, **ANSWERS[what]}))
    if does == "fault":
        assert (session.state, type(session.error)) == ("ended", WireError)
        assert f"{what!r} to call 2, which is {state}" in str(session.error)
        return
    assert (session.state, session.error) == ("open", None)
    assert came == ([call] if "taken" in does else [])
    assert len(call) == len(came)
    assert sent == (framed({"id": call.number, "cancel": True}) if "sent" in does else b"")
    if does == "forgotten":
        assert (session.calls, call.state) == ({beside.number: beside}, "ended")
    else:
        assert (session.calls[call.number], call.state) == (call, does.rpartition(" ")[2])
    if came:
        answer = call.take()
        assert (answer.said, answer.missed) == (what, 2 if what in ("item", "end") else 0)
        if what == "error":
            with pytest.raises(StateError, match="it"):
                answer.result()
        else:
            assert answer.result() == "it"
    assert session.receive(framed({"id": beside.number, "ok": 1})) == [beside]


def test_what_does_not_stream_is_never_open() -> None:
    assert all(row["ok"][0] != "open" for row in CALL.values())
    assert CALL["open"]["ok"][1] == "fault"


# -- what is sent ------------------------------------------------------------------------------------------------------


def test_what_a_client_says() -> None:
    session = ClientSession("pc/k", "of the entry")
    assert said(session.greeting("me")) == {"hello": {"oldest": 1, "newest": 1, "who": "me"}}
    assert said(session.greeting("me", carried=True))["hello"]["to"] == ["pc/k", "of the entry"]
    _, early = session.begin("names", {})
    assert said(early) == {"id": 1, "op": "names", "epoch": "of the entry", "args": {}}
    session.receive(framed(HELLO))
    assert said(session.begin("part", {"components": ["a"]})[1])["epoch"] == "ab"
    with pytest.raises(LimitError, match="524288"):
        session.begin("part", {"components": ["x" * 600_000]})
    assert session.begin("names", {})[0].number == 3
    assert session.bye() == BYE
    with pytest.raises(ClosedError, match="pc/k: the session was closed"):
        session.begin("names", {})


def test_a_kernel_that_speaks_another_protocol_is_refused() -> None:
    session = ClientSession("pc/k")
    session.receive(framed({"hello": {"protocol": 3, "epoch": "ab"}}))
    with pytest.raises(ControlError, match="pc/k speaks protocol 3, this speaks 1"):
        session.check()


# -- credit ------------------------------------------------------------------------------------------------------------


@given(st.lists(st.one_of(st.just("take"), st.integers(0, 3)), max_size=60), st.integers(1, 5))
def test_what_waits_is_kept_in_order_or_missing(actions: list[str | int], credit: int) -> None:
    """Against a plain list: `take`, or an item before which the kernel dropped so many."""
    call, kept, came, taken, missed = Call(1, streams=True), deque[int](), 0, 0, 0
    for action in actions:
        if action == "take":
            if kept:
                answer = call.take()
                assert answer.value == kept.popleft()
                taken, missed = taken + 1, missed + answer.missed
            continue
        came += 1 + int(action)
        if len(kept) < credit:
            kept.append(came)
        call.keep(Answer("item", came, int(action), 10), credit)
    while kept:
        answer = call.take()
        assert answer.value == kept.popleft()
        taken, missed = taken + 1, missed + answer.missed
    assert call.keep(Answer("end", None, 0, 10), credit)
    missed += call.take().missed + call.missed_last()
    assert taken + missed == came


def test_an_item_beyond_the_credit_is_missing_in_items_or_bytes() -> None:
    call = Call(1, streams=True)
    assert call.keep(Answer("item", 1, 0, 2 * BYTES), ITEMS)  # one alone may be larger
    assert not call.keep(Answer("item", 2, 0, 10), ITEMS)
    assert call.keep(Answer("item", 3, 0, 10), None)
    assert [call.take().missed, call.take().missed] == [0, 1]
    assert call.keep(Answer("item", 4, 0, 10), 1)
    assert not call.keep(Answer("item", 5, 0, 10), 1)
    assert call.keep(Answer("end", 6, 0, 10), 1)  # the last answer always has room
    assert [call.take().missed, call.take().missed, call.missed_last()] == [0, 1, 0]


# -- any bytes ---------------------------------------------------------------------------------------------------------

PLAIN = st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats() | st.text(max_size=4) | st.just([])
NUMBERS = st.integers(-1, 7)
KEYS = ("ok", "item", "end", "error")
ACTS = st.one_of(
    st.tuples(st.just("begin"), st.booleans()),
    st.tuples(st.sampled_from(("cancel", "leave", "take")), NUMBERS),
    *[st.tuples(st.just("say"), st.tuples(NUMBERS, st.sampled_from((*["next"] * 8, *KEYS)), st.integers(0, 2)))] * 3,
)
ODD = st.one_of(
    st.fixed_dictionaries(
        {}, optional={"id": NUMBERS | PLAIN, "busy": PLAIN, "hello": PLAIN, "missed": PLAIN, "x": PLAIN}
    ),
    st.fixed_dictionaries({"id": NUMBERS}, optional=dict.fromkeys((*KEYS, "missed"), PLAIN)),
).map(framed) | st.binary(max_size=12)


def divided(data: bytes, draw: Any) -> list[bytes]:
    """The same bytes in pieces."""
    cuts = sorted(draw(st.lists(st.integers(0, len(data)), max_size=4)))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


@given(st.lists(ACTS, max_size=40), st.sampled_from((None, 1, 3)), st.data())
@settings(max_examples=cases(10_000))
def test_each_answer_is_of_its_call_however_late_or_divided(acts: list[Any], credit: int | None, data: Any) -> None:
    """Against the book of an honest kernel, which never answers after its last answer; what it says else is a fault."""
    session = opened()
    session.credit = credit
    book: dict[int, list[str]] = {}
    """Answers to each call that somebody waits for."""
    streams: dict[int, bool] = {}
    there: dict[int, Call] = {}
    lost: dict[int, int] = {}
    got: dict[int, list[tuple[str, int]]] = {}
    waiting, serial = bytearray(), 0

    def hear() -> None:
        for piece in divided(bytes(waiting), data.draw):
            for call in session.receive(piece):
                assert there[call.number] is call
        waiting.clear()

    def take(call: Call) -> None:
        while call:
            answer = call.take()
            value = answer.value
            if answer.said == "error":
                value = [int(one) for one in str(value).split()]
            assert value[0] == call.number
            lost[call.number] += answer.missed
            got[call.number].append((answer.said, value[1]))

    for what, of in acts:
        if what == "say":
            number, key, missed = of
            if key == "next":  # what an honest kernel says
                key = "item" if streams.get(number) and book.get(number) != [] else "ok"
            serial += 1
            value: Any = [number, serial]
            if key == "error":
                value = {"code": "E-STATE", "text": f"{number} {serial}"}
            waiting += framed({"id": number, key: value, "missed": missed})
            if number in book:
                book[number].append(key)
            continue
        hear()
        if session.error is not None:
            break
        if what == "begin":
            call, frame = session.begin("tap", {}, streams=of)
            assert said(frame)["id"] == call.number == len(there) + 1
            there[call.number], streams[call.number] = call, of
            book[call.number], got[call.number], lost[call.number] = [], [], 0
        elif of in there and what == "take":
            take(there[of])
        elif of in there:
            (session.cancel if what == "cancel" else session.leave)(there[of])
            assert len(there[of]) == 0
            book.pop(of, None)
    hear()
    for number, keys in book.items():
        call = there[number]
        if session.error is None:
            take(call)
            wanted = _heard(keys, streams=streams[number])
            heard = [key for key, _ in got[number]]
            assert [key for key in heard if key != "item"] == [key for key in wanted if key != "item"]
            assert heard.count("item") <= wanted.count("item")
            if credit is None:
                assert heard == wanted
            assert (call.state == "ended") == bool(wanted and wanted[-1] not in ("began", "item"))
        serials = [serial for _, serial in got[number]]
        assert serials == sorted(set(serials))
    if session.error is not None:
        assert (session.state, type(session.error)) == ("ended", WireError)
        with pytest.raises(WireError, match="says what is no answer"):
            session.begin("names", {})


def _heard(keys: list[str], *, streams: bool) -> list[str]:
    """What of these is an answer: all until the last one."""
    heard: list[str] = []
    for key in keys:
        heard.append("began" if streams and not heard and key == "ok" else key)
        if heard[-1] in ("ok", "end", "error"):
            break
    return heard


@given(st.lists(ODD, max_size=12), st.booleans(), st.data())
@settings(max_examples=cases(10_000))
def test_bytes_of_any_kind_are_answers_or_end_the_session(said_: list[bytes], greeted: bool, data: Any) -> None:
    whole, divided_ = (opened() if greeted else ClientSession("pc/k") for _ in range(2))
    for session in (whole, divided_):
        for streams in (False, True, False):
            session.begin("tap", {}, streams=streams)
        session.leave(session.calls[3])
    stream = b"".join(said_)
    whole.receive(stream)
    for piece in divided(stream, data.draw):
        divided_.receive(piece)
    assert (whole.state, type(whole.error), str(whole.error)) == (
        divided_.state,
        type(divided_.error),
        str(divided_.error),
    )
    assert (whole.error is not None) == (whole.state == "ended")
    assert whole.error is None or isinstance(whole.error, AiortsError)
    assert repr([kept(call) for call in whole.calls.values()]) == repr([kept(call) for call in divided_.calls.values()])
    for session in (whole, divided_):
        session.end(ClosedError("pc/k: has ended"))
        assert session.receive(framed({"id": 1, "ok": 1})) == []


def kept(call: Call) -> list[Any]:
    """What a call has, as it is compared: an error by its text, since two are never the same."""
    return [call.number, call.state] + [
        (one.said, str(one.value), one.missed) for one in (call.take() for _ in range(len(call)))
    ]


@pytest.mark.parametrize("knows", [True, False])
def test_a_kernel_hears_of_new_credit_once_half_of_it_is_used_where_it_knows_what_that_is(knows: bool) -> None:
    session = ClientSession("pc/k")
    session.receive(framed({"hello": {**HELLO["hello"], **({"credits": True} if knows else {})}}))
    call, frame = session.begin("tap", {}, streams=True, window=4)
    assert said(frame)["credit"] == 4
    session.receive(framed({"id": 1, "ok": None}))
    session.take(call)
    gives = []
    for number in range(6):
        session.receive(framed({"id": 1, "item": number, "missed": 0}))
        gives.append(session.take(call)[1])
    new = framed({"id": 1, "credit": 2})
    assert gives == ([b"", new] * 3 if knows else [b""] * 6)
    session.receive(framed({"id": 1, "item": 6}) + framed({"id": 1, "item": 7}) + framed({"id": 1, "end": None}))
    assert [session.take(call)[1] for _ in range(3)] == [b""] * 3  # it has ended: there is nothing to give credit for
