"""A client's session without its socket: every cell of its tables, and bytes of any kind and division."""

from __future__ import annotations

from collections import deque
from typing import Any

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
    Frame.HELLO: HELLO,
    Frame.ANSWER: {"id": 1, "ok": "it"},
    Frame.REFUSAL: REFUSED,
    Frame.BUSY: {"busy": 1.5},
    Frame.OTHER: {"note": "of a newer kernel"},
}
ANSWERS: dict[Said, dict[str, Any]] = {
    Said.OK: {"ok": "it"},
    Said.BEGAN: {"ok": "it"},
    Said.ITEM: {"item": "it", "missed": 2},
    Said.END: {"end": "it", "missed": 2},
    Said.ERROR: {"error": {"code": "E-STATE", "text": "it"}},
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
    ("GREETING", "HELLO"): ("OPEN", None, False),
    ("GREETING", "ANSWER"): ("ENDED", WireError, False),
    ("GREETING", "REFUSAL"): ("ENDED", BusyError, False),
    ("GREETING", "BUSY"): ("GREETING", None, False),
    ("GREETING", "OTHER"): ("ENDED", WireError, False),
    ("OPEN", "HELLO"): ("OPEN", None, False),
    ("OPEN", "ANSWER"): ("OPEN", None, True),
    ("OPEN", "REFUSAL"): ("ENDED", BusyError, False),
    ("OPEN", "BUSY"): ("OPEN", None, False),
    ("OPEN", "OTHER"): ("OPEN", None, False),
    **{("ENDED", kind.name): ("ENDED", ClosedError, False) for kind in Frame},
}
"""State and frame: the state afterwards, the error that ends the session, whether the call has its answer."""


@pytest.mark.parametrize(("state", "kind"), IN_SESSION)
def test_each_frame_in_each_state_of_a_session(state: str, kind: str) -> None:
    session = ClientSession("pc/k") if state == "GREETING" else opened()
    call, _ = session.begin("names", {})
    if state == "ENDED":
        session.end(ClosedError("pc/k: has ended"))
    came = session.receive(framed(FRAMES[Frame[kind]]))
    after, error, answered = IN_SESSION[state, kind]
    assert session.state is SessionState[after]
    assert (type(session.error) if session.error is not None else None) is error
    assert came == [call] * answered
    assert session.busy == (1.5 if kind == "BUSY" and state != "ENDED" else 0.0)
    assert bool(session.hello) == (state != "GREETING" or kind == "HELLO")
    if error is not None:
        with pytest.raises(error):
            session.begin("names", {})
        assert session.cancel(call) == b""


def test_the_tables_are_whole() -> None:
    assert set(IN_SESSION) == {(state.name, kind.name) for state in SESSION for kind in SESSION[state]}
    assert set(SESSION) == set(SessionState)
    assert {kind for row in SESSION.values() for kind in row} == set(Frame)
    assert set(CALL) == set(CallState)
    assert all(set(row) == set(Said) for row in CALL.values())
    assert set(OF_CALL) == {(state.name, what.name) for state in CallState for what in Said}


OF_CALL: dict[tuple[str, str], str] = {
    ("OPENING", "OK"): "taken, ENDED",
    ("OPENING", "BEGAN"): "taken, OPEN",
    ("OPENING", "ITEM"): "fault",
    ("OPENING", "END"): "fault",
    ("OPENING", "ERROR"): "taken, ENDED",
    ("OPENING", "CANCEL"): "sent, ENDING",
    ("OPENING", "LEAVE"): "nothing, ENDING",
    ("OPEN", "OK"): "never",
    ("OPEN", "BEGAN"): "fault",
    ("OPEN", "ITEM"): "taken, OPEN",
    ("OPEN", "END"): "taken, ENDED",
    ("OPEN", "ERROR"): "taken, ENDED",
    ("OPEN", "CANCEL"): "sent, ENDING",
    ("OPEN", "LEAVE"): "nothing, ENDING",
    ("ENDING", "OK"): "forgotten",
    ("ENDING", "BEGAN"): "nothing, ENDING",
    ("ENDING", "ITEM"): "nothing, ENDING",
    ("ENDING", "END"): "forgotten",
    ("ENDING", "ERROR"): "forgotten",
    ("ENDING", "CANCEL"): "nothing, ENDING",
    ("ENDING", "LEAVE"): "nothing, ENDING",
    ("ENDED", "OK"): "nothing, ENDED",
    ("ENDED", "BEGAN"): "nothing, ENDED",
    ("ENDED", "ITEM"): "nothing, ENDED",
    ("ENDED", "END"): "nothing, ENDED",
    ("ENDED", "ERROR"): "nothing, ENDED",
    ("ENDED", "CANCEL"): "forgotten",
    ("ENDED", "LEAVE"): "forgotten",
}


def call_in(session: ClientSession, state: str, *, streams: bool) -> Call:
    """A call that has come so far."""
    call, _ = session.begin("tap", {"port": "a.out"}, streams=streams)
    if streams and state in ("OPEN", "ENDING"):
        session.receive(framed({"id": call.number, "ok": None}))
        call.take()
    if state == "ENDED":
        session.receive(framed({"id": call.number, "error": {"code": "E-STATE", "text": "no"}}))
        call.take()
    if state == "ENDING":
        session.leave(call)
    assert call.state is CallState[state]
    return call


@pytest.mark.parametrize(("state", "what"), [cell for cell, does in OF_CALL.items() if does != "never"])
def test_each_answer_in_each_state_of_a_call(state: str, what: str) -> None:
    session, does = opened(), OF_CALL[state, what]
    beside, _ = session.begin("names", {})
    call = call_in(session, state, streams=what != "OK")
    sent, came = b"", list[Call]()
    if what == "CANCEL":
        sent = session.cancel(call)
    elif what == "LEAVE":
        session.leave(call)
    else:
        came = session.receive(framed({"id": call.number, **ANSWERS[Said[what]]}))
    if does == "fault":
        assert (session.state, type(session.error)) == (SessionState.ENDED, WireError)
        assert f"{Said[what].value!r} to call 2, which is {state.lower()}" in str(session.error)
        return
    assert (session.state, session.error) == (SessionState.OPEN, None)
    assert came == ([call] if "taken" in does else [])
    assert len(call) == len(came)
    if sent:
        assert (does, said(sent)) == ("sent, ENDING", {"id": call.number, "cancel": True})
    if does == "forgotten":
        assert session.calls == {beside.number: beside}
    else:
        assert (session.calls[call.number], call.state.name) == (call, does.rpartition(" ")[2])
    if came:
        answer = call.take()
        assert (answer.said, answer.missed) == (Said[what], 2 if what in ("ITEM", "END") else 0)
        if what == "ERROR":
            with pytest.raises(StateError, match="it"):
                answer.result()
        else:
            assert answer.result() == "it"
    assert session.receive(framed({"id": beside.number, "ok": 1})) == [beside]


def test_what_does_not_stream_is_never_open() -> None:
    assert [CALL[state][Said.OK][0] for state in CallState].count(CallState.OPEN) == 0
    assert CALL[CallState.OPEN][Said.OK][1] is Do.FAULT


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
        call.keep(Answer(Said.ITEM, came, int(action), 10), credit)
    while kept:
        answer = call.take()
        assert answer.value == kept.popleft()
        taken, missed = taken + 1, missed + answer.missed
    assert call.keep(Answer(Said.END, None, 0, 10), credit)
    missed += call.take().missed + call.missed_last()
    assert taken + missed == came


def test_an_item_beyond_the_credit_is_missing_in_items_or_bytes() -> None:
    call = Call(1, streams=True)
    assert call.keep(Answer(Said.ITEM, 1, 0, 2 * BYTES), ITEMS)  # one alone may be larger
    assert not call.keep(Answer(Said.ITEM, 2, 0, 10), ITEMS)
    assert call.keep(Answer(Said.ITEM, 3, 0, 10), None)
    assert [call.take().missed, call.take().missed] == [0, 1]
    assert call.keep(Answer(Said.ITEM, 4, 0, 10), 1)
    assert not call.keep(Answer(Said.ITEM, 5, 0, 10), 1)
    assert call.keep(Answer(Said.END, 6, 0, 10), 1)  # the last answer always has room
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
            if answer.said is Said.ERROR:
                value = [int(one) for one in str(value).split()]
            assert value[0] == call.number
            lost[call.number] += answer.missed
            got[call.number].append((answer.said.value, value[1]))

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
            assert (call.state is CallState.ENDED) == bool(wanted and wanted[-1] not in ("began", "item"))
        serials = [serial for _, serial in got[number]]
        assert serials == sorted(set(serials))
    if session.error is not None:
        assert (session.state, type(session.error)) == (SessionState.ENDED, WireError)
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
    assert (whole.error is not None) == (whole.state is SessionState.ENDED)
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
