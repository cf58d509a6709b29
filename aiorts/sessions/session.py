"""A client's session with a kernel, as a pure state machine: it takes bytes, and returns answers and bytes.

The session has no socket, thread, loop or clock: the blocking `Client` and the `AsyncClient` of a loop both drive it.
Two tables define it: `SESSION` for each frame that comes, `CALL` for each answer to a call.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Mapping
from typing import Any, Final, Literal

from aiorts.errors import AiortsError, ClosedError, LimitError, WireError
from aiorts.late import dataclass
from aiorts.sessions.protocol import (
    ANSWERS,
    BYE,
    NEWEST,
    OLDEST,
    REQUESTS,
    RightName,
    agreed,
    answer_in,
    error_in,
    framed,
    frames,
)

ITEMS: Final = 4_096
"""The most items of a stream that are kept for a slow reader, where `credit` is limited."""
WINDOW: Final = 1_024
"""Items of a stream that a kernel may send to a reader on a loop before it takes some. The reader gives new credit
after half of them: early enough even where the kernel delays calls for half a second."""
BYTES: Final = 32 << 20
"""The most bytes of the frames of kept items; a single item may be larger."""

SessionState = Literal["greeting", "open", "ended"]
"""The state of a session. In "greeting" the kernel has not said hello; calls may be sent all the same."""
Frame = Literal["hello", "answer", "refusal", "busy", "other"]
"""The kinds of frames: a "refusal" is an error without a call's number; "other" may come from a newer kernel."""
CallState = Literal["opening", "open", "ending", "ended"]
"""The state of a call. "open": it streams and has begun; "ending": this end has given the call up, and its last answer
is still to come; "ended": its last answer has come, taken or not."""
Said = Literal["ok", "began", "item", "end", "error", "cancel", "leave"]
"""The answers of a kernel ("began": the "ok" of a stream), and the ways in which this end gives a call up: after
"cancel" the kernel ends the call, after "leave" it still carries the call out."""
Do = Literal["take", "skip", "send", "forget", "fault"]
"""The effects, in order: the frame or answer is taken; it is skipped; the cancellation is sent to the kernel; the
call's number is forgotten; the session ends with a fault."""
Table = Mapping[Any, Mapping[Any, tuple[Any, Do]]]


def _table(text: str) -> Table:
    """Read a table from its text: a line for each state; in each column the next state and the effect."""
    head, *lines = (line.split() for line in text.strip().splitlines())
    rows: dict[str, Any] = {}
    for state, *cells in lines:
        rows[state] = dict(zip(head, (tuple(map(sys.intern, cell.split(":"))) for cell in cells), strict=True))
    return rows


SESSION: Final = _table(
    """
             hello      answer      refusal    busy          other
    greeting open:take  ended:fault ended:take greeting:take ended:fault
    open     open:skip  open:take   ended:take open:take     open:skip
    ended    ended:skip ended:skip  ended:skip ended:skip    ended:skip
    """
)
CALL: Final = _table(
    """
            ok           began        item         end          error        cancel       leave
    opening ended:take   open:take    ended:fault  ended:fault  ended:take   ending:send  ending:skip
    open    ended:fault  ended:fault  open:take    ended:take   ended:take   ending:send  ending:skip
    ending  ended:forget ending:skip  ending:skip  ended:forget ended:forget ending:skip  ending:skip
    ended   ended:skip   ended:skip   ended:skip   ended:skip   ended:skip   ended:forget ended:forget
    """
)


@dataclass(slots=True)
class Answer:
    """One answer of the kernel to a call."""

    said: Said
    value: Any
    """The plain value; of an "error", the exception."""
    missed: int
    """Items that are missing before this answer, dropped in the kernel or here."""
    size: int
    """Bytes of the answer's frame."""

    def result(self) -> Any:
        """The value; an "error" is raised."""
        if self.said == "error":
            raise self.value
        return self.value


@dataclass(slots=True)
class Heard:
    """Decoded frames, each with its size in bytes, and the fault that comes after them."""

    frames: list[tuple[dict[Any, Any], int]]
    fault: WireError | None = None


class Call:
    """One call: its state, and its answers that are not taken yet. `take` and `keep` may run in two threads."""

    __slots__ = ("_came", "_kept", "_missed", "_taken", "due", "given_up", "number", "state", "streams", "window")

    def __init__(self, number: int, *, streams: bool, window: int = 0) -> None:
        self.number, self.streams, self.window = number, streams, window
        self.given_up = False
        """Whether this end has cancelled or left the call."""
        self.due = 0
        """Items that were taken and for which the kernel has no new credit yet."""
        self.state: CallState = "opening"
        self._kept: deque[Answer] = deque()
        self._came = self._taken = 0
        """Bytes of the answers that came, and of those that were taken."""
        self._missed = 0
        """Items that are missing before the next answer."""

    def __len__(self) -> int:
        return len(self._kept)

    def keep(self, answer: Answer, credit: int | None) -> bool:
        """Keep an answer; returns whether there was room.

        An item without room is dropped, and the next answer counts it as missed.
        """
        answer.missed += self._missed
        kept = len(self._kept)
        full = credit is not None and (kept >= credit or (kept > 0 and self._came - self._taken + answer.size > BYTES))
        if full and answer.said == "item":
            self._missed = answer.missed + 1
            return False
        self._missed = 0
        self._came += answer.size
        self._kept.append(answer)
        return True

    def take(self) -> Answer:
        """Take the next answer, which makes room for another; IndexError where there is none."""
        answer = self._kept.popleft()
        self._taken += answer.size
        return answer

    def missed_last(self) -> int:
        """Return the number of items that are missing after the last answer, and count them no more."""
        missed, self._missed = self._missed, 0
        return missed

    def give_up(self) -> None:
        """Drop the answers that are kept: this end has cancelled or left the call."""
        self.given_up = True
        self._kept.clear()


class ClientSession:
    """The client's end of one session: its state, its calls, and the bytes of both ways.

    Attributes:
        state: the state of the session.
        hello: the kernel's hello; empty before it comes.
        epoch: the kernel's epoch, which goes with each call.
        error: the reason of the session's end; None before.
        busy: seconds for which the kernel's loop is held up, as reported since the last answer; 0.0: not reported.
        credit: the most items of each stream that are kept for a slow reader, of at most `BYTES`; None: all.

    Args:
        address: the kernel's address, "host/kernel", for texts.
        longest: bytes of the longest frame that is accepted.
    """

    def __init__(self, address: str, epoch: str = "", *, longest: int = ANSWERS) -> None:
        self.address, self.epoch = address, epoch
        self.state = "greeting"
        self.hello: Mapping[str, Any] = {}
        self.error: AiortsError | None = None
        self.busy = 0.0
        self.credit: int | None = None
        self.calls: dict[int, Call] = {}
        """The calls, by number, whose last answer has not come, or is not taken."""
        self.last = 0
        """The number of the last call that was begun."""
        self._longest = longest
        self._buffer = bytearray()

    # -- out -------------------------------------------------------------------------------------------------------

    def greeting(self, who: str, right: RightName = "", *, carried: bool = False) -> bytes:
        """The first bytes of a session: hello.

        Args:
            who: this end, for the kernel's log.
            right: the highest right wanted; "" is all that the kernel allows.
            carried: whether the socket carries sessions with several kernels; hello then names the kernel.
        """
        hello: dict[str, object] = {"oldest": OLDEST, "newest": NEWEST, "who": who}
        if right:
            hello["right"] = right
        if carried:
            hello["to"] = [self.address, self.epoch]
        return framed({"hello": hello})

    def begin(
        self, operation: str, arguments: Mapping[str, object], *, streams: bool = False, window: int = 0
    ) -> tuple[Call, bytes]:
        """Begin a call; returns it with the bytes to send.

        Args:
            window: items of a stream that the kernel may send before `take` gives it new credit; 0: all.

        Raises:
            LimitError: the call is larger than a kernel accepts; the session goes on.
            AiortsError: the session has ended; the error is the reason.
        """
        self.check()
        number = self.last + 1
        message = {"id": number, "op": operation, "epoch": self.epoch, "args": arguments}
        frame = framed(message | {"credit": window} if window else message)
        if len(frame) > REQUESTS.frame:
            raise LimitError(f"a call of {len(frame)} bytes; at most {REQUESTS.frame} are allowed")
        self.last = number
        call = self.calls[number] = Call(number, streams=streams, window=window)
        return call, frame

    def take(self, call: Call) -> tuple[Answer, bytes]:
        """Take the next answer of a call, as `Call.take`; returns it with the bytes that give the kernel new credit."""
        answer = call.take()
        if call.window and answer.said == "item" and self.hello.get("credits"):
            call.due += 1
            if call.due * 2 >= call.window and call.state == "open" and self.error is None:
                credit, call.due = call.due, 0
                return answer, framed({"id": call.number, "credit": credit})
        return answer, b""

    def cancel(self, call: Call) -> bytes:
        """Give a call up so that the kernel ends it; returns the bytes to send: none if the call has ended already."""
        do = self._step(call, "cancel")
        return framed({"id": call.number, "cancel": True}) if do == "send" and self.error is None else b""

    def leave(self, call: Call) -> None:
        """Give a call up, and let the kernel carry it out: its answers are skipped. Idempotent."""
        self._step(call, "leave")

    def _step(self, call: Call, said: Said) -> Do:
        call.state, do = CALL[call.state][said]
        if said == "cancel" or said == "leave":
            call.give_up()
        if do == "forget":
            self.calls.pop(call.number, None)
        return do

    def check(self) -> None:
        """Raise the error that has ended the session, if it has ended."""
        if self.error is not None:
            raise self.error.with_traceback(None)

    def bye(self) -> bytes:
        """End the session in order; returns the last bytes to send."""
        self.end(ClosedError(f"{self.address}: the session was closed"))
        return BYE

    def end(self, error: AiortsError) -> None:
        """End the session with a reason; the first reason stays."""
        self.state = "ended"
        self.error = self.error or error

    # -- in --------------------------------------------------------------------------------------------------------

    def receive(self, data: bytes) -> list[Call]:
        """Take bytes of the kernel, divided at any place.

        Returns:
            The calls with new answers, in the order of the answers: a call is listed once for each answer.
        """
        return self.hear(self.decode(data))

    def decode(self, data: bytes) -> Heard:
        """Decode the frames that these bytes complete: slow, but changes nothing that another thread reads."""
        heard = Heard([])
        self._buffer += data
        try:
            heard.frames.extend((answer_in(frame), len(frame)) for frame in frames(self._buffer, self._longest))
        except WireError as error:
            heard.fault = error
        return heard

    def hear(self, heard: Heard) -> list[Call]:
        """Take frames in the order in which they were decoded; returns what `receive` does."""
        came: list[Call] = []
        fault: AiortsError | None = heard.fault
        try:
            for frame, size in heard.frames:
                self._take(frame, size, came)
        except AiortsError as error:
            fault = error
        if fault is not None:
            self.end(fault)
        return came

    def _take(self, frame: dict[Any, Any], size: int, came: list[Call]) -> None:
        kind = _kind(frame)
        self.state, do = SESSION[self.state][kind]
        if do == "fault":
            raise self._no_hello()
        if do != "take":
            return
        if kind == "answer":
            self._answered(frame, size, came)
        elif kind == "busy":
            self.busy = float(frame["busy"])
        elif kind == "hello":
            self._greeted(frame["hello"])
        else:
            raise error_in(frame["error"], self.address)

    def _greeted(self, hello: object) -> None:
        if not isinstance(hello, dict):
            raise self._no_hello()
        agreed(hello.get("protocol"), hello.get("protocol"), self.address)
        self.epoch, self.hello = str(hello.get("epoch", "")), hello

    def _no_hello(self) -> WireError:
        return WireError(f"{self.address}: no hello; what listens there is no kernel of aiorts")

    def _answered(self, frame: dict[Any, Any], size: int, came: list[Call]) -> None:
        call = self.calls.get(frame["id"])
        said = _said(frame)
        if call is None or said is None:
            return  # the call has ended and its answers were taken, or a newer kernel sent an unknown answer
        if said == "ok" and call.streams:
            said = "began"
        before = call.state
        do = self._step(call, said)
        if do == "fault":
            raise WireError(
                f"{self.address}: says what is no answer: {said!r} to call {call.number}, which is {before}"
            )
        if do == "take":
            self.busy = 0.0
            missed = frame.get("missed")
            missed = missed if type(missed) is int and missed > 0 else 0
            value = frame["ok" if said == "began" else said]
            if said == "error":
                value = error_in(value, self.address)
            if call.keep(Answer(said, value, missed, size), self.credit):
                came.append(call)


def _said(frame: Mapping[Any, Any]) -> Said | None:
    """The kind of answer in a frame; of several keys, "error" counts first, then "ok", "item" and "end"."""
    if "error" in frame:
        return "error"
    if "ok" in frame:
        return "ok"
    if "item" in frame:
        return "item"
    return "end" if "end" in frame else None


def _kind(frame: Mapping[Any, Any]) -> Frame:
    if "id" in frame:
        return "answer" if type(frame["id"]) is int else "other"
    if "hello" in frame:
        return "hello"
    if "error" in frame:
        return "refusal"
    return "busy" if type(frame.get("busy")) in (int, float) else "other"
