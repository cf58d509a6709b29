"""Takes samples out of a kernel in another process and records them, until the recording ends.

Each port has a tap: a connector of this session's own, which never makes a writer wait. Samples that it loses are
counted: for each port `written = recorded + dropped`, from its tap to its last sample here.
"""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, Final, TypeAlias, TypeVar

from aiorts.errors import AiortsError, ClosedError, NoAnswerError
from aiorts.sessions import END, Client, Stream
from aiorts_log.live.choice import Choice
from aiorts_log.live.frames import Frame, FrameWriter, frame_kind, type_in

T = TypeVar("T")
Say: TypeAlias = Callable[[str, str], None]
"""A function that reports: called with a code and a text."""
_EVENTS: Final = ("ComponentAdded", "PortAdded", "ComponentReloaded")
"""The events after which there may be more ports."""
_TAPS: Final = 200
"""The most taps of one session: a kernel lets each session have 256 calls at a time."""
_FULL: Final = 0.75
"""The load of the writer's queue above which nothing is read: the kernel then counts the samples that it drops."""
_PAUSE: Final = 0.005
_LOOK: Final = 0.25
"""Seconds between two looks at the clock and the disk."""
_LAST: Final = 1.0
"""Seconds in which samples that are under way at the end have to arrive."""


class Recorded:
    """A port that is recorded.

    Attributes:
        name: as the recording has it.
        offered: samples that came or were dropped on the way; the writer counts what became of them.
        refused: samples that cannot travel.
    """

    def __init__(self, name: str, kind: type[Frame], unit: str | None) -> None:
        self.name = name
        self.kind = kind
        self.unit = unit
        self.number = -1
        self.offered = self.refused = 0


class Taking:
    """The recording of a kernel's samples.

    Args:
        choice: the ports.
        say: reports a problem with one of the ports.
    """

    def __init__(self, choice: Choice, say: Say) -> None:
        self.ports: dict[str, Recorded] = {}
        """The recorded ports, by name in the recording."""
        self.ended = ""
        """The reason why the kernel has ended the recording; "" while it goes on."""
        self.cut_off = False
        """Whether the kernel runs on, and has given up waiting for this end."""
        self._choice = choice
        self._say = say
        self._clients: list[Client] = [choice.running.client]
        self._taps: dict[str, tuple[Stream, Recorded]] = {}
        """The taps, by the path by which their port was chosen."""
        self._passed: set[str] = set()
        """Paths that are not recorded: refused, or another name of a port that is recorded."""
        self._opened = 0
        self._look_at = 0.0
        self._displaced = False
        self._kinds: dict[str, type[Frame]] = {}
        self._writer: FrameWriter | None = None
        self._left: int | None = None
        self._events = self._client.stream("events", kinds=_EVENTS)
        outlines = self._client.call("outline")
        choice.check(outlines)
        self._tap_all(choice.of(outlines))

    @property
    def _client(self) -> Client:
        return self._clients[0]

    @property
    def kernel(self) -> str:
        """The kernel's name."""
        return self._choice.running.name

    def profile(self) -> Any:
        """The kernel's profile, as JSON has it."""
        return self._client.call("profile")

    def origin(self) -> dict[str, bytes]:
        """The system file that the kernel was made of, if any, by its name in recordings."""
        text: str = self._client.call("origin")
        return {"system.toml": text.encode()} if text else {}

    def close(self) -> None:
        """End the sessions that were opened here."""
        for client in self._clients[1:]:
            client.close()

    # -- taps ------------------------------------------------------------------------------------------------------

    def _tap_all(self, paths: Iterable[str]) -> None:
        """Record ports from now on; one that cannot be recorded is refused, or only reported if a pattern meant it."""
        begun = [(path, self._guarded(path, partial(self._stream, path))) for path in paths]
        for path, stream in begun:
            if stream is not None:
                self._guarded(path, partial(self._begin, path, stream))

    def _guarded(self, path: str, do: Callable[[], T]) -> T | None:
        try:
            return do()
        except (ClosedError, NoAnswerError):
            raise
        except AiortsError as error:
            if path in self._choice.exact:
                raise
            self._passed.add(path)
            self._say(error.code, f"{path}: is not recorded: {error}")
            return None

    def _stream(self, path: str) -> Stream:
        if self._opened >= _TAPS * len(self._clients):
            self._clients.append(Client.open(self._client.entry, right="view"))
        self._opened += 1
        return self._clients[-1].stream("tap", port=path, frames=True)

    def _begin(self, path: str, stream: Stream) -> None:
        name: str = stream.began["port"]
        if any(one.name == name for _, one in self._taps.values()):
            stream.close()
            self._passed.add(path)
            return
        kind = self._kind(str(stream.began["full_type"]))
        known = self.ports.get(name)
        if known is not None and known.kind is not kind:
            stream.close()
            self._passed.add(path)
            now, before = kind.schema.name, known.kind.schema.name
            self._say("E-RECORDING", f"{name}: is recorded as {before}, and sends {now} now, which is not recorded")
            return
        one = known or Recorded(name, kind, stream.began["unit"])
        self.ports[name] = one
        self._taps[path] = stream, one
        self._add(one)

    def _kind(self, type_name: str, base: type[Frame] = Frame) -> type[Frame]:
        if type_name not in self._kinds:
            found = self._client.call("schema", type=type_name)
            name = found["type"]
            self._kinds[type_name] = self._kinds.setdefault(name, frame_kind(name, found["schema"], base))
        return self._kinds[type_name]

    def _add(self, one: Recorded) -> None:
        if self._writer is not None and one.number < 0:
            one.number = self._writer.add_port(one.name, one.kind, {"unit": one.unit} if one.unit else {})

    # -- samples ---------------------------------------------------------------------------------------------------

    def record(
        self, writer: FrameWriter, seconds: float | None, count: int | None, stopped: Callable[[], bool], wake: int
    ) -> None:
        """Record for so many seconds, until `count` samples, `stopped()`, the kernel's end or the writer's failure.

        Args:
            wake: a descriptor that can be read when `stopped()` is to be checked.
        """
        self._writer, self._left = writer, count
        until = None if seconds is None else time.monotonic() + seconds
        for one in self.ports.values():
            self._add(one)
        try:
            while self._take() and not stopped() and writer.failure is None:
                now = time.monotonic()
                if until is not None and now >= until:
                    break
                self._wait(_LOOK if until is None else min(_LOOK, until - now), wake)
                if now >= self._look_at:
                    self._look_at = now + _LOOK
                    self._look_after(writer)
            if self._left != 0 and writer.failure is None:
                self._last()
        except ClosedError as error:
            entry = self._client.entry
            self.ended = str(error).replace(entry.address, entry.name, 1)
            self.cut_off = ": runs on" in str(error)
            self._take()  # its last items
            if self._taps:
                self.ended += " without an end of its ports; what they sent last may be missing, and is not counted"

    def _look_after(self, writer: FrameWriter) -> None:
        path, what = writer.displaced
        if what and not self._displaced:
            self._displaced = True
            text = f"{path}: was {what} while it is recorded; what comes goes where it was moved to, or is lost"
            self._say("E-RECORDING", text)

    def _wait(self, seconds: float, wake: int) -> None:
        while self._writer is not None and self._writer.load > _FULL and self._writer.failure is None:
            time.sleep(_PAUSE)
        poll = select.poll()
        poll.register(wake, select.POLLIN)
        for client in self._clients:
            poll.register(client.fileno(), select.POLLIN)
        ready = {descriptor for descriptor, _ in poll.poll(seconds * 1000)}
        for client in self._clients:
            if client.fileno() in ready:
                client.read()

    def _last(self) -> None:
        """Take the samples that are under way at the end."""
        for client in self._clients:
            try:
                client.call("outline", _LAST, components=[])
            except NoAnswerError:
                continue
        self._take()

    def _take(self) -> bool:
        """Record the samples that have come; False when there are enough, or the kernel has ended."""
        happened = False
        for item in _items(self._events):
            if item is END:
                self._has_ended()
            happened = True
        for path, (stream, one) in tuple(self._taps.items()):
            self._take_from(path, stream, one)
            if self._left == 0:
                return False
        if happened and not self.ended:
            self._look()
        return not self.ended

    def _has_ended(self) -> None:
        self.ended = self.ended or f"{self.kernel}: has ended"

    def _take_from(self, path: str, stream: Stream, one: Recorded) -> None:
        for item in _items(stream):
            self._count(stream, one)
            if item is END:
                del self._taps[path]
                if isinstance(stream.result, str):
                    self._say("E-CLOSED", f"{stream.result}; it is recorded on when it is there again")
                return
            if "error" in item:
                one.refused += 1
                if one.refused == 1:
                    self._say("E-RECORD", f"{one.name}: {item['error']}; such samples are left out")
                continue
            self._write(one, item)
            if self._left == 0:
                return
        self._count(stream, one)  # what was missed after the last item

    def _count(self, stream: Stream, one: Recorded) -> None:
        missed, stream.missed = stream.missed, 0
        if missed and self._writer is not None:
            one.offered += missed
            self._writer.drop(one.number, missed)

    def _write(self, one: Recorded, item: Any) -> None:
        frame, time_ns = item["frame"], item["time_ns"]
        kind = one.kind
        if not frame.startswith(kind.begin):
            kind = self._kind_of(frame, kind)
        stamp = item["tm"]
        assert self._writer is not None  # noqa: S101 - `record` sets it
        one.offered += 1
        taken = self._writer.write(one.number, kind(time_ns if stamp is None else stamp, frame), time_ns)
        if taken and self._left is not None:
            self._left -= 1

    def _kind_of(self, frame: bytes, base: type[Frame]) -> type[Frame]:
        """The class for frames of a type that derives from that of its port."""
        name = type_in(frame)
        known = self._kinds.get(name)
        if known is not None and issubclass(known, base):
            return known
        found = self._client.call("schema", type=name)
        self._kinds[name] = made = frame_kind(found["type"], found["schema"], base)
        return made

    def _look(self) -> None:
        """Tap the ports that were added since the last look."""
        paths = self._choice.of(self._client.call("outline"))
        self._tap_all([path for path in paths if path not in self._taps and path not in self._passed])


def _items(stream: Stream) -> Iterator[Any]:
    """The items of a stream that have come, then END where it has ended; a session that has ended gives no more."""
    while True:
        try:
            item = stream.next(0.0)
        except (NoAnswerError, ClosedError):
            return
        yield item
        if item is END:
            return
