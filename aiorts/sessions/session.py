"""A client's session with a kernel, without its socket: bytes in; answers, and bytes out.

It has no socket, thread, loop or time: the blocking `Client` and `aiorts.remote.session`, on an event loop, drive the
same one. Two tables say what it does: `SESSION` with each frame that comes, `CALL` with each answer to a call.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from enum import Enum
from typing import Any, Final

from aiorts.errors import AiortsError, ClosedError, LimitError, WireError
from aiorts.late import dataclass
from aiorts.sessions.protocol import (
    ANSWERS,
    BYE,
    NEWEST,
    OLDEST,
    REQUESTS,
    agreed,
    answer_in,
    error_in,
    framed,
    frames,
)

ITEMS: Final = 4_096
"""Items of a stream that are kept for a taker that is behind, where its credit is limited."""
BYTES: Final = 32 << 20
"""Bytes of them, as they came; one alone may be larger."""


class SessionState(Enum):
    """How far a session is."""

    GREETING = "greeting"
    """The kernel has not said hello; calls may be on their way all the same."""
    OPEN = "open"
    ENDED = "ended"
    """By either end, or by what is no answer."""


class Frame(Enum):
    """What a frame of the kernel is."""

    HELLO = "hello"
    ANSWER = "answer"
    """To the call whose number it has."""
    REFUSAL = "refusal"
    """An error of the session as a whole."""
    BUSY = "busy"
    OTHER = "other"
    """What a newer kernel may say."""


class CallState(Enum):
    """How far a call is."""

    OPENING = "opening"
    """Nothing has come for it."""
    OPEN = "open"
    """A stream that has begun."""
    ENDING = "ending"
    """Nobody waits for it, and its last answer is still to come."""
    ENDED = "ended"
    """Its last answer has come, and may be still to be taken."""


class Said(Enum):
    """What is said of a call: the answers of the kernel, and what this end does with it."""

    OK = "ok"
    """The one answer of a call that does not stream."""
    BEGAN = "began"
    """The first of one that does."""
    ITEM = "item"
    END = "end"
    ERROR = "error"
    CANCEL = "cancel"
    """This end wants no more of it, and the kernel is to end it."""
    LEAVE = "leave"
    """This end waits for it no longer."""


class Do(Enum):
    """What is done with what is said."""

    TAKE = "take"
    SKIP = "skip"
    """Nothing: it is passed over."""
    SEND = "send"
    """The kernel is told."""
    FORGET = "forget"
    """The call is given up, with its number."""
    FAULT = "fault"
    """It is no answer, and ends the session."""


def _table(text: str, states: Any, columns: Any) -> Mapping[Any, Mapping[Any, tuple[Any, Do]]]:
    """A table as it is written: a line for each state; in each column the next state, and what is done."""
    head, *lines = (line.split() for line in text.strip().splitlines())
    table = {}
    for state, *cells in lines:
        steps = (cell.split(":") for cell in cells)
        table[states[state]] = {
            columns[said]: (states[then], Do[do]) for said, (then, do) in zip(head, steps, strict=True)
        }
    return table


SESSION: Final[Mapping[SessionState, Mapping[Frame, tuple[SessionState, Do]]]] = _table(
    """
             HELLO      ANSWER      REFUSAL    BUSY          OTHER
    GREETING OPEN:TAKE  ENDED:FAULT ENDED:TAKE GREETING:TAKE ENDED:FAULT
    OPEN     OPEN:SKIP  OPEN:TAKE   ENDED:TAKE OPEN:TAKE     OPEN:SKIP
    ENDED    ENDED:SKIP ENDED:SKIP  ENDED:SKIP ENDED:SKIP    ENDED:SKIP
    """,
    SessionState,
    Frame,
)
CALL: Final[Mapping[CallState, Mapping[Said, tuple[CallState, Do]]]] = _table(
    """
            OK           BEGAN        ITEM         END          ERROR        CANCEL       LEAVE
    OPENING ENDED:TAKE   OPEN:TAKE    ENDED:FAULT  ENDED:FAULT  ENDED:TAKE   ENDING:SEND  ENDING:SKIP
    OPEN    ENDED:FAULT  ENDED:FAULT  OPEN:TAKE    ENDED:TAKE   ENDED:TAKE   ENDING:SEND  ENDING:SKIP
    ENDING  ENDED:FORGET ENDING:SKIP  ENDING:SKIP  ENDED:FORGET ENDED:FORGET ENDING:SKIP  ENDING:SKIP
    ENDED   ENDED:SKIP   ENDED:SKIP   ENDED:SKIP   ENDED:SKIP   ENDED:SKIP   ENDED:FORGET ENDED:FORGET
    """,
    CallState,
    Said,
)


@dataclass(slots=True)
class Answer:
    """What a kernel says to a call."""

    said: Said
    value: Any
    """Of an ERROR the exception."""
    missed: int
    """Items that are missing before it, dropped in the kernel or here."""
    size: int
    """Bytes of its frame."""

    def result(self) -> Any:
        """The value; raises the error that it is."""
        if self.said is Said.ERROR:
            raise self.value
        return self.value


class Call:
    """One call: its state, and the answers that are not taken yet, in order."""

    __slots__ = ("_bytes", "_kept", "_missed", "number", "state", "streams")

    def __init__(self, number: int, *, streams: bool) -> None:
        self.number = number
        self.streams = streams
        self.state = CallState.OPENING
        self._kept: deque[Answer] = deque()
        self._bytes = 0
        self._missed = 0
        """Items that are missing before the next answer."""

    def __len__(self) -> int:
        return len(self._kept)

    def keep(self, answer: Answer, credit: int | None) -> bool:
        """Whether there is room for an answer: an item without credit is missing, and the next answer says so."""
        answer.missed += self._missed
        kept = len(self._kept)
        full = credit is not None and (kept >= credit or (kept > 0 and self._bytes + answer.size > BYTES))
        if full and answer.said is Said.ITEM:
            self._missed = answer.missed + 1
            return False
        self._missed = 0
        self._bytes += answer.size
        self._kept.append(answer)
        return True

    def take(self) -> Answer:
        """The next answer, whose credit is free again; IndexError where there is none."""
        answer = self._kept.popleft()
        self._bytes -= answer.size
        return answer

    def missed_last(self) -> int:
        """Items that are missing after the last answer; they are told once."""
        missed, self._missed = self._missed, 0
        return missed

    def clear(self) -> None:
        """Nobody takes what is kept."""
        self._kept.clear()
        self._bytes = 0


class ClientSession:
    """What a client says and hears in one session.

    Attributes:
        state: how far it is.
        hello: what the kernel says of itself; empty before.
        epoch: the kernel's, which goes with each call.
        error: why it has ended; None before.
        busy: seconds for which the kernel's loop is held up, as said since the last answer; 0.0 where it is not.
        credit: items that are kept of each stream for a taker that is behind, with at most `BYTES`; None: all.

    Args:
        address: of the kernel, "host/kernel", for texts.
        longest: bytes of a frame that are taken.
    """

    def __init__(self, address: str, epoch: str = "", *, longest: int = ANSWERS) -> None:
        self.address, self.epoch = address, epoch
        self.state = SessionState.GREETING
        self.hello: Mapping[str, Any] = {}
        self.error: AiortsError | None = None
        self.busy = 0.0
        self.credit: int | None = None
        self.calls: dict[int, Call] = {}
        """By number: those whose last answer is still to come, or to be taken."""
        self.last = 0
        """The number of the last call that was begun."""
        self._longest = longest
        self._buffer = bytearray()

    # -- out -------------------------------------------------------------------------------------------------------

    def greeting(self, who: str, *, carried: bool = False) -> bytes:
        """What is sent first.

        Args:
            who: this end, for the kernel's log.
            carried: whether the socket carries sessions with several kernels, and is to be told which is meant.
        """
        hello: dict[str, object] = {"oldest": OLDEST, "newest": NEWEST, "who": who}
        if carried:
            hello["to"] = [self.address, self.epoch]
        return framed({"hello": hello})

    def begin(self, operation: str, arguments: Mapping[str, object], *, streams: bool = False) -> tuple[Call, bytes]:
        """A call that is under way once the bytes are sent.

        Raises:
            LimitError: it is larger than a kernel takes; the session goes on.
            AiortsError: the session has ended: why.
        """
        self.check()
        number = self.last + 1
        frame = framed({"id": number, "op": operation, "epoch": self.epoch, "args": arguments})
        if len(frame) > REQUESTS.frame:
            raise LimitError(f"a call of {len(frame)} bytes; at most {REQUESTS.frame} are allowed")
        self.last = number
        call = self.calls[number] = Call(number, streams=streams)
        return call, frame

    def cancel(self, call: Call) -> bytes:
        """End a call for which nobody waits any more; the bytes for the kernel, or none where it has ended."""
        do = self._step(call, Said.CANCEL)
        return framed({"id": call.number, "cancel": True}) if do is Do.SEND and self.error is None else b""

    def leave(self, call: Call) -> None:
        """Wait no longer for a call, which runs on in the kernel; what comes for it is passed over. Idempotent."""
        self._step(call, Said.LEAVE)

    def _step(self, call: Call, said: Said) -> Do:
        call.state, do = CALL[call.state][said]
        if said is Said.CANCEL or said is Said.LEAVE:
            call.clear()
        if do is Do.FORGET:
            self.calls.pop(call.number, None)
        return do

    def check(self) -> None:
        """Raises what has ended the session, if it has ended."""
        if self.error is not None:
            raise self.error.with_traceback(None)

    def bye(self) -> bytes:
        """End the session in order: the last bytes."""
        self.end(ClosedError(f"{self.address}: the session was closed"))
        return BYE

    def end(self, error: AiortsError) -> None:
        """Nothing comes any more: say why. What was said first holds."""
        self.state = SessionState.ENDED
        self.error = self.error or error
        self._buffer.clear()

    # -- in --------------------------------------------------------------------------------------------------------

    def receive(self, data: bytes) -> list[Call]:
        """Take bytes of the kernel, however they are divided.

        Returns:
            The calls with answers to be taken, in the order in which these came; one for each answer.
        """
        came: list[Call] = []
        if self.state is SessionState.ENDED:
            return came
        self._buffer += data
        try:
            for frame in frames(self._buffer, self._longest):
                self._take(answer_in(frame), len(frame), came)
        except AiortsError as error:
            self.end(error)
        return came

    def _take(self, frame: dict[Any, Any], size: int, came: list[Call]) -> None:
        kind = _kind(frame)
        self.state, do = SESSION[self.state][kind]
        if do is Do.FAULT:
            raise self._no_hello()
        if do is not Do.TAKE:
            return
        if kind is Frame.ANSWER:
            self._answered(frame, size, came)
        elif kind is Frame.BUSY:
            self.busy = float(frame["busy"])
        elif kind is Frame.HELLO:
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
        key = next((key for key in _ANSWERS if key in frame), None)
        if call is None or key is None:
            return  # nobody waits for it; or a newer kernel says more than is known here
        said, before = _ANSWERS[key], call.state
        if said is Said.OK and call.streams:
            said = Said.BEGAN
        do = self._step(call, said)
        if do is Do.FAULT:
            raise WireError(
                f"{self.address}: says what is no answer: {said.value!r} to call {call.number}, which is {before.value}"
            )
        if do is Do.TAKE:
            self.busy = 0.0
            missed = frame.get("missed")
            missed = missed if type(missed) is int and missed > 0 else 0
            value = error_in(frame[key], self.address) if said is Said.ERROR else frame[key]
            if call.keep(Answer(said, value, missed, size), self.credit):
                came.append(call)


_ANSWERS: Final = {said.value: said for said in (Said.ERROR, Said.OK, Said.ITEM, Said.END)}
"""The keys of answers; of several in one frame the first counts."""


def _kind(frame: Mapping[Any, Any]) -> Frame:
    if "hello" in frame:
        return Frame.HELLO
    if "id" in frame:
        return Frame.ANSWER if type(frame["id"]) is int else Frame.OTHER
    if "error" in frame:
        return Frame.REFUSAL
    return Frame.BUSY if type(frame.get("busy")) in (int, float) else Frame.OTHER
