"""Speaks with kernels of aiorts as `SPEC.md` of aiorts_zenoh says, with `zenoh` and `msgpack` alone.

    python foreign_program.py listen|connect HOST:PORT HOST KERNEL

It is the kernel HOST/KERNEL with one component, `twin`: out-port `out`, in-port `inp` (both TimedLong), parameter
`step`; while it is active, `out` counts in these steps. A line of JSON on standard input has it do something, and is
answered by one line: `{"do": "list"}`, "call", "session", "read", "write", "service", "received", "links".
"""

from __future__ import annotations

import json
import os
import queue
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import zenoh

DOMAIN = "aiorts/1/default"
TYPES = json.loads((Path(__file__).parents[2] / "plugins/aiorts_zenoh/vectors/types.json").read_text())["types"]
TYPE = next(one for one in TYPES if one["name"] == "TimedLong")
SAMPLE = struct.Struct("<Qi")

# -- envelopes ---------------------------------------------------------------------------------------------------------

HEAD = struct.Struct("<BBHIQq")
FRAME, PIECE, TAKEN, LOOK, END, HAVE = range(1, 7)
TOLD = 65_536
UNDER_WAY = 65_536


def message(kind: int, epoch: int, first: int, *blocks: bytes) -> bytes:
    head = HEAD.pack(1, kind, len(blocks), epoch, first, time.time_ns())
    return head + b"".join(struct.pack("<I", len(block)) + block for block in blocks)


def parsed(data: bytes) -> tuple[int, int, int, list[bytes]] | None:
    """Kind, epoch, first number and blocks; None: it is no message."""
    if len(data) < HEAD.size:
        return None
    version, kind, count, epoch, first, _ = HEAD.unpack_from(data)
    blocks, place = [], HEAD.size
    for _ in range(count):
        if place + 4 > len(data):
            return None
        (length,) = struct.unpack_from("<I", data, place)
        blocks.append(data[place + 4 : place + 4 + length])
        place += 4 + length
    return (kind, epoch, first, blocks) if version == 1 and FRAME <= kind <= HAVE and place == len(data) else None


def cost(size: int) -> int:
    return 2 * size if size <= 64_500 else (1 - -size // 65_400) * 65_536


# -- links -------------------------------------------------------------------------------------------------------------

HELLO, DATA, ACK, BYE = 1, 2, 3, 4
NUMBERED = struct.Struct("<BBHIQQ")


class Channel:
    """One end of the way of a link: messages with credits."""

    def __init__(self, put: Callable[[bytes, bool], None], epoch: int) -> None:
        self.put, self.epoch = put, epoch
        self.sent = self.taken = self.came = self.told = 0
        self.pieces, self.total = b"", 0

    def send(self, frame: bytes) -> bool:
        """Whether there was room for it."""
        if self.sent - self.taken >= UNDER_WAY:
            self.put(message(LOOK, self.epoch, self.sent), True)
            return False
        data = message(FRAME, self.epoch, self.sent, frame)
        self.sent += cost(len(data))
        self.put(data, False)
        return True

    def arrived(self, data: bytes) -> list[bytes]:
        """The blocks of a frame that has come."""
        found = parsed(data)
        if found is None or found[1] != self.epoch:
            return []
        kind, _, first, blocks = found
        if kind == TAKEN:
            if self.taken < first <= self.sent:
                self.taken = first
            return []
        self.came = max(self.came, first + (cost(len(data)) if kind <= PIECE else 0))
        if kind == LOOK or self.came - self.told >= TOLD:
            self.told = self.came
            self.put(message(TAKEN, self.epoch, self.told), True)
        return blocks if kind == FRAME else self.whole(blocks) if kind == PIECE else []

    def whole(self, blocks: list[bytes]) -> list[bytes]:
        total, place = struct.unpack("<QQ", blocks[0])
        if place == 0:
            self.pieces, self.total = b"", total
        if (place, total) != (len(self.pieces), self.total):
            return []
        self.pieces += blocks[1]
        if len(self.pieces) < total:
            return []
        (count,) = struct.unpack_from("<I", self.pieces)
        found, at = [], 4
        for _ in range(count):
            (length,) = struct.unpack_from("<I", self.pieces, at)
            found.append(self.pieces[at + 4 : at + 4 + length])
            at += 4 + length
        return found


class Writer:
    """The writer's end of a link."""

    def __init__(self, name: str, writer: str, reader: str, peer: tuple[str, str]) -> None:
        self.name, self.writer, self.reader, self.peer = name, writer, reader, peer
        self.epoch = int.from_bytes(os.urandom(8), "big")
        self.number = self.reader_epoch = 0
        self.channel: Channel | None = None
        self.greeted = False
        self.kept: deque[tuple[int, bytes]] = deque()
        self.next, self.sent, self.highest, self.acknowledged = 1, 0, 0, 0
        self.due = self.again = 0.0
        self.why = ""

    def offer(self) -> list[Any]:
        ends = [self.writer, self.reader, self.epoch, 0, 0]
        kind = [bytes.fromhex(TYPE["hash"]), TYPE["layout"], "", []]
        options = {"subscription": "new", "push": "all", "on_link_lost": "wait"}
        return [[1, 1], self.name, ends, kind, [self.name, options, 256, 8 << 20]]

    def connected(self, number: int, epoch: int, channel: Channel) -> None:
        if self.reader_epoch not in (0, epoch):  # another reader: what it has not seen goes to it from number 1 on
            rest = [sample for number, sample in self.kept if number > self.highest]
            self.kept, self.next = deque(enumerate(rest, 1)), 1 + len(rest)
            self.sent = self.highest = 0
        self.number, self.reader_epoch, self.channel, self.greeted, self.due = number, epoch, channel, False, 0.0

    def write(self, tm: int, value: int) -> None:
        if len(self.kept) < 256:
            self.kept.append((self.next, SAMPLE.pack(tm, value)))
            self.next += 1

    def arrived(self, frame: bytes) -> None:
        kind, _, _, link, one, two = NUMBERED.unpack_from(frame.ljust(NUMBERED.size, b"\0"))
        if link != self.number:
            return
        if kind == HELLO and one == self.reader_epoch and not self.greeted:
            self.greeted, self.sent = True, two
        elif kind == ACK and one <= two <= self.highest:
            while self.kept and self.kept[0][0] <= one:
                self.kept.popleft()
                self.acknowledged += 1
            self.sent, self.again = max(self.sent, two), time.monotonic() + 0.2
        elif kind == BYE:
            self.channel, self.why = None, "disconnected"

    def poll(self, now: float) -> None:
        if self.channel is None:
            return
        if not self.greeted:
            if now >= self.due:
                self.channel.send(NUMBERED.pack(HELLO, 0, 0, self.number, self.epoch, 0))
                self.due = now + 0.2
            return
        if self.kept and self.sent >= self.kept[0][0] and now >= self.again:
            self.sent, self.again = self.kept[0][0] - 1, now + 0.5  # lost, or its acknowledgement was
        for number, sample in self.kept:
            if number > self.sent:
                if not self.channel.send(NUMBERED.pack(DATA, 0, 1, self.number, number, self.kept[0][0]) + sample):
                    return
                self.sent, self.again = number, max(self.again, now + 0.2)
                self.highest = max(self.highest, number)


class Reader:
    """The reader's end of a link."""

    def __init__(self, take: Callable[[bytes], None]) -> None:
        self.epoch = int.from_bytes(os.urandom(8), "big")
        self.take = take
        self.number = self.writer_epoch = self.received = self.all = 0
        self.channel: Channel | None = None

    def connected(self, number: int, writer_epoch: int, channel: Channel) -> None:
        if writer_epoch != self.writer_epoch:
            self.received = 0
        self.number, self.writer_epoch, self.channel = number, writer_epoch, channel
        self.say_hello()

    def say_hello(self) -> None:
        if self.channel is not None:
            self.channel.send(NUMBERED.pack(HELLO, 0, 0, self.number, self.epoch, self.received))
            self.channel.send(NUMBERED.pack(ACK, 0, 0, self.number, self.received, self.received))

    def arrived(self, frame: bytes) -> None:
        kind, flags, count, link, one, _ = NUMBERED.unpack_from(frame.ljust(NUMBERED.size, b"\0"))
        if link != self.number or self.channel is None:
            return
        if kind == HELLO and one == self.writer_epoch:
            self.say_hello()
        elif kind == DATA:
            rest = frame[NUMBERED.size + (8 * count if flags & 2 else 0) :]
            sizes = struct.unpack_from(f"<{count}I", rest) if count > 1 else (len(rest),)
            at = 4 * count if count > 1 else 0
            for number, size in enumerate(sizes, one):
                if number == self.received + 1:
                    self.received, self.all = number, self.all + 1
                    self.take(rest[at : at + size])
                at += size
            self.channel.send(NUMBERED.pack(ACK, 0, 0, self.number, self.received, self.received))
        elif kind == BYE:
            self.channel = None


# -- sessions ----------------------------------------------------------------------------------------------------------


class Stream:
    """One end of a session: bytes whole and in order."""

    def __init__(self, put: Callable[[bytes], None], number: int) -> None:
        self.put, self.number = put, number
        self.kept: deque[tuple[int, int, bytes]] = deque()
        self.sent = self.used = self.came = 0
        self.waits, self.buffer = b"", b""
        self.looked = 0.0

    def say(self, value: dict[str, Any]) -> None:
        body = msgpack.packb(value)
        self.waits += len(body).to_bytes(4, "big") + body
        self.pump()

    def pump(self) -> None:
        while self.waits and self.sent - self.used < 131_072:
            data, self.waits = self.waits[:32_768], self.waits[32_768:]
            self.kept.append((self.sent, FRAME, data))
            self.put(message(FRAME, self.number, self.sent, data))
            self.sent += len(data)

    def arrived(self, data: bytes) -> list[dict[str, Any]]:
        """What the other end says with a message."""
        found = parsed(data)
        if found is None or found[1] != self.number:
            return []
        kind, _, first, blocks = found
        if kind == TAKEN:
            self.used = max(self.used, min(first, self.sent))
            while self.kept and self.kept[0][0] + len(self.kept[0][2]) <= self.used:
                self.kept.popleft()
            self.pump()
        elif kind == HAVE:
            for at, what, kept in self.kept:
                if at >= first:
                    self.put(message(what, self.number, at, kept))
        elif kind == LOOK:
            self.put(message(TAKEN, self.number, self.came))
            if self.came < first:
                self.put(message(HAVE, self.number, self.came))
        elif first == self.came:
            self.came += len(blocks[0]) if kind == FRAME else 1
            self.put(message(TAKEN, self.number, self.came))
            if kind == FRAME:
                self.buffer += blocks[0]
        said = []
        while len(self.buffer) >= 4 and len(self.buffer) >= 4 + (size := int.from_bytes(self.buffer[:4], "big")):
            said.append(msgpack.unpackb(self.buffer[4 : 4 + size]))
            self.buffer = self.buffer[4 + size :]
        return said

    def look(self, now: float) -> None:
        if self.kept and now >= self.looked:
            self.looked = now + 0.3
            self.put(message(LOOK, self.number, self.sent))


# -- the kernel --------------------------------------------------------------------------------------------------------


class Foreign:
    """The kernel: all that comes goes through one queue, and is handled in the main thread."""

    def __init__(self, way: str, address: str, host: str, kernel: str) -> None:
        self.host, self.kernel = host, kernel
        self.epoch = int.from_bytes(os.urandom(8), "big")
        self.own = f"{host}/{kernel}/{self.epoch:016x}"
        machine = int.from_bytes(os.urandom(8), "big")  # its host name is its own, so that any number does
        self.claim = (time.time_ns(), self.epoch, machine)
        self.token = f"{DOMAIN}/live/{host}/{kernel}/{self.claim[0]}-{self.epoch:016x}-{machine:016x}"
        self.inbox: queue.Queue[tuple[Callable[..., None], tuple[Any, ...]]] = queue.Queue()
        self.state, self.step, self.count, self.tick = "inactive", 1, 0, 0.0
        self.values: list[int] = []
        self.peers: dict[tuple[str, str], int] = {}
        self.writers: dict[str, Writer] = {}
        self.readers: dict[tuple[str, str], Reader] = {}
        self.ends: dict[str, tuple[Writer | Reader, Channel]] = {}
        self.sessions: dict[str, Stream] = {}
        self.calls: dict[str, tuple[dict[str, Any], Any, list[Any]]] = {}
        self.answered: dict[tuple[bytes, int], tuple[bool, bytes]] = {}
        self.numbers, self.link_numbers = 0, int.from_bytes(os.urandom(3), "big")
        self.due: list[tuple[float, Callable[[], None]]] = []

        config = zenoh.Config()
        settings = {
            "mode": "peer" if way == "listen" else "client",
            f"{way}/endpoints": [f"tcp/{address}"],
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "connect/timeout_ms": 20_000,
        }
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)
        self.declare()

    def handed(self, handle: Callable[..., None], *arguments: Any) -> None:
        self.inbox.put((handle, arguments))

    def declare(self) -> None:
        """Everything others may ask or send, and last that this kernel is there."""
        self.kept: list[Any] = []
        pair = f"{self.host}/{self.kernel}"
        for key in (f"{DOMAIN}/link/*/*/{pair}/*/w", f"{DOMAIN}/link/{pair}/*/*/*/r"):
            self.subscribe(key, self.frame_came)
        self.answer(f"{DOMAIN}/svc/{self.own}/**", self.was_asked)
        for branch in ("info", "ctl"):
            self.subscribe(f"{DOMAIN}/{branch}/{self.own}/*/*/c", self.session_came)
            self.answer(f"{DOMAIN}/{branch}/{self.own}/*/*", self.was_called)
            self.subscribe(f"{DOMAIN}/{branch}/*/*/*/{self.kernel}/*/s", self.answer_came)
            self.watch(f"{DOMAIN}/{branch}/{self.own}/*/*/live", self.client_present)
        self.watch(f"{DOMAIN}/live/*/*/**", self.kernel_present)
        live = self.session.liveliness()
        self.tokens = [live.declare_token(self.token)]
        self.later(1.0, lambda: self.tokens.append(live.declare_token(f"{self.token}/own")))

    def subscribe(self, key: str, came: Callable[[str, bytes], None]) -> None:
        def handler(sample: Any) -> None:
            self.handed(came, str(sample.key_expr), sample.payload.to_bytes())

        self.kept.append(self.session.declare_subscriber(key, handler))

    def watch(self, key: str, present: Callable[[str, bool], None]) -> None:
        def handler(sample: Any) -> None:
            self.handed(present, str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self.kept.append(self.session.liveliness().declare_subscriber(key, handler, history=True))

    def answer(self, key: str, asked: Callable[[Any], None]) -> None:
        self.kept.append(self.session.declare_queryable(key, lambda query: self.handed(asked, query), complete=True))

    def put(self, key: str, data: bytes, urgent: bool = True) -> None:
        priority = zenoh.Priority.INTERACTIVE_HIGH if urgent else zenoh.Priority.DATA
        self.session.put(key, data, priority=priority, congestion_control=zenoh.CongestionControl.DROP, express=urgent)

    def later(self, seconds: float, act: Callable[[], None]) -> None:
        self.due.append((time.monotonic() + seconds, act))

    def run(self) -> None:
        while True:
            try:
                handle, arguments = self.inbox.get(timeout=0.01)
                handle(*arguments)
            except queue.Empty:
                pass
            now = time.monotonic()
            for one in [one for one in self.due if one[0] <= now]:
                self.due.remove(one)
                one[1]()
            if self.state == "active" and now >= self.tick:
                self.tick = now + 0.02
                self.count += self.step
                for writer in self.writers.values():
                    if writer.writer.endswith("twin.out"):
                        writer.write(time.time_ns(), self.count)
            for writer in self.writers.values():
                writer.poll(now)
            for stream in self.sessions.values():
                stream.look(now)

    # -- who is there --------------------------------------------------------------------------------------------------

    def kernel_present(self, token: str, up: bool) -> None:
        parts = token.split("/")
        start, epoch, machine = parts[6].split("-")
        claim, owned = (int(start), int(epoch, 16), int(machine, 16)), parts[7:] == ["own"]
        pair = parts[4], parts[5]
        if claim == self.claim:
            return
        if pair[0] == self.host and (pair[1] == self.kernel or claim[2] != self.claim[2]):
            if up and ((owned and len(self.tokens) < 2) or (claim < self.claim and len(self.tokens) < 2)):
                sys.exit(f"{pair[0]}/{pair[1]} is another's")  # as of a name that is taken
            return
        if up:
            if self.peers.get(pair) != claim[1]:
                self.peers[pair] = claim[1]
                for writer in self.writers.values():
                    if writer.peer == pair:
                        self.offer(writer)
        elif not owned and self.peers.get(pair) == claim[1]:
            del self.peers[pair]
            for end, _ in [one for key, one in self.ends.items() if f"/{pair[0]}/{pair[1]}/" in key]:
                end.channel = None

    # -- questions -----------------------------------------------------------------------------------------------------

    def ask(self, pair: tuple[str, str], what: str, body: bytes, answered: Callable[[bool, bytes], None]) -> None:
        self.numbers += 1
        beside = struct.pack("<QQ", self.epoch, self.numbers) + f"{self.host}/{self.kernel}".encode()
        key = f"{DOMAIN}/svc/{pair[0]}/{pair[1]}/{self.peers[pair]:016x}/{self.kernel}/{what}"
        replies: list[tuple[bool, bytes]] = []

        def came(reply: Any) -> None:
            good = reply.ok is not None
            replies.append((good, (reply.ok if good else reply.err).payload.to_bytes()))

        def over() -> None:
            self.handed(self.ask_again_or, replies, again, answered)

        def again() -> None:
            handler = zenoh.handlers.Callback(came, over)
            self.session.get(key, handler, payload=body, attachment=beside, timeout=5.0, express=True)

        again()

    def ask_again_or(
        self, replies: list[tuple[bool, bytes]], again: Callable[[], None], answered: Callable[[bool, bytes], None]
    ) -> None:
        if replies:
            answered(*replies[0])
        else:
            self.later(0.05, again)

    def was_asked(self, query: Any) -> None:
        *_, name, what = str(query.key_expr).split("/")
        beside, body = query.attachment.to_bytes(), b"" if query.payload is None else query.payload.to_bytes()
        epoch, number = struct.unpack_from("<QQ", beside)
        host, _, kernel = beside[16:].decode().partition("/")
        who = beside[:8] + beside[16:], number
        if kernel != name or self.peers.get((host, kernel)) != epoch:
            answer = False, b"who asks is not known here"
        elif who in self.answered:
            answer = self.answered[who]
        else:
            answer = self.answered[who] = self.answer_of(what, body, (host, kernel))
        if answer[0]:
            query.reply(query.key_expr, answer[1], express=True)
        else:
            query.reply_err(answer[1])
        query.drop()

    def answer_of(self, what: str, body: bytes, pair: tuple[str, str]) -> tuple[bool, bytes]:
        if what == "clock":
            return True, struct.pack("<q", time.time_ns())
        if what == "come":
            for writer in self.writers.values():
                if writer.peer == pair:
                    self.offer(writer)
            return True, b""
        if what == "ledger":
            reader = self.readers[pair[1], msgpack.unpackb(body)[0]]
            counts = [reader.all, reader.all, 0, reader.all - reader.received]
            return True, msgpack.packb([reader.writer_epoch, reader.epoch, *counts, {}])
        if what == "offer":
            return True, msgpack.packb(self.was_offered(msgpack.unpackb(body), pair))
        if what == "request":
            _, out, in_, _ = msgpack.unpackb(body)
            if not out.endswith("/twin.out"):
                return True, msgpack.packb([0, 0, "", f"{out}: is no out-port", [1, 1]])
            self.writes(f"{out} to {in_}", out, in_, pair)
            return True, msgpack.packb([0, 0, "", "", [1, 1]])
        return False, f"does not know the question {what!r}".encode()

    # -- links ---------------------------------------------------------------------------------------------------------

    def was_offered(self, offer: list[Any], pair: tuple[str, str]) -> list[Any]:
        name, (_, reader, epoch, _, _), kind = offer[1], offer[2], offer[3]
        if not reader.endswith("/twin.inp"):
            return [0, 0, "", f"{reader}: is no in-port", [1, 1]]
        if kind[0].hex() != TYPE["hash"]:
            return [0, 0, "", "types differ", [1, 1]]
        end = self.readers.setdefault((pair[1], name), Reader(self.take))
        self.link_numbers += 1
        number = self.link_numbers
        base = f"{DOMAIN}/link/{pair[0]}/{pair[1]}/{self.host}/{self.kernel}/{number}"
        self.later(0.0, lambda: self.open(end, number, epoch, f"{base}/r", f"{base}/w", epoch))
        return [number, end.epoch, "", "", [1, 1]]

    def take(self, sample: bytes) -> None:
        self.values.append(SAMPLE.unpack(sample)[1])

    def writes(self, name: str, out: str, in_: str, pair: tuple[str, str]) -> None:
        if name not in self.writers:
            self.writers[name] = Writer(name, out, in_, pair)
        self.offer(self.writers[name])

    def offer(self, writer: Writer) -> None:
        def answered(good: bool, data: bytes) -> None:
            if not good:
                writer.why = data.decode()
                return
            number, epoch, absent, refused, _ = msgpack.unpackb(data)
            writer.why = absent or refused
            if absent:
                self.later(1.0, lambda: self.offer(writer))
            if number:
                ends = f"{self.host}/{self.kernel}/{writer.peer[0]}/{writer.peer[1]}/{number}"
                base = f"{DOMAIN}/link/{ends}"
                self.open(writer, number, epoch, f"{base}/w", f"{base}/r", writer.epoch)

        if writer.peer in self.peers:
            self.ask(writer.peer, "offer", msgpack.packb(writer.offer()), answered)

    def open(self, end: Writer | Reader, number: int, epoch: int, at: str, of: str, writer_epoch: int) -> None:
        channel = Channel(lambda data, urgent: self.put(at, data, urgent), writer_epoch & 0xFFFFFFFF)
        self.ends[of] = end, channel
        end.connected(number, epoch, channel)

    def frame_came(self, key: str, data: bytes) -> None:
        if key in self.ends:
            end, channel = self.ends[key]
            if end.channel is channel and (blocks := channel.arrived(data)):
                end.arrived(blocks[0])

    # -- clients of this kernel ----------------------------------------------------------------------------------------

    def operation(self, branch: str, name: str, given: dict[str, Any]) -> dict[str, Any]:
        if name == "hello":
            return {"ok": self.hello(branch)}
        if name == "names":
            components = {"twin": {"main": self.state}}
            names = {"address": f"{self.host}/{self.kernel}", "state": "open", "components": components}
            names |= {"contexts": {"main": ["twin"]}, "connectors": {}, "in_error": [], "links": self.kernel}
            return {"ok": names}
        if given.get("component") != "twin":
            return {"error": {"code": "E-ABSENT", "text": f"{given.get('component')}: no such component"}}
        if name == "configuration":
            row = {
                "name": "step",
                "type": "int",
                "value": self.step,
                "default": 1,
                "unit": "",
                "doc": "",
                "constraint": "",
            }
            return {"ok": {"active": "default", "sets": {"default": {"step": self.step}}, "parameters": [row]}}
        if name not in ("activate", "deactivate", "configure"):
            return {"error": {"code": "E-CONTROL", "text": f"no operation {name!r}"}}
        if branch != "ctl":
            return {"error": {"code": "E-DENIED", "text": f"{name}: needs the right 'operate'"}}
        if name == "configure":
            for values in given["values"].values():
                self.step = int(values.get("step", self.step))
        else:
            self.state = "active" if name == "activate" else "inactive"
        return {"ok": {"text": ""}}

    def hello(self, branch: str) -> dict[str, Any]:
        right = "operate" if branch == "ctl" else "view"
        return {"address": f"{self.host}/{self.kernel}", "epoch": f"{self.epoch:016x}", "kernel": self.kernel,
                "pid": os.getpid(), "right": right}  # fmt: skip

    def was_called(self, query: Any) -> None:
        *_, caller, operation = str(query.key_expr).split("/")
        branch = str(query.key_expr).split("/")[3]
        given = msgpack.unpackb(query.payload.to_bytes()) if query.payload else {}
        answer = self.operation(branch, operation, given)
        key = f"{DOMAIN}/{branch}/{self.own}/{caller}/{operation}"
        query.reply(key, msgpack.packb(answer), express=True)
        query.drop()

    def session_came(self, key: str, data: bytes) -> None:
        base, branch = key[:-2], key.split("/")[3]
        stream, found = self.sessions.get(base), parsed(data)
        if stream is None:
            if found is None or found[0] != FRAME or found[2] != 0:
                return
            stream = self.sessions[base] = Stream(lambda out: self.put(f"{base}/s", out), found[1])
        for said in stream.arrived(data):
            if "hello" in said:
                stream.say({"hello": {"protocol": 1, **self.hello(branch)}})
            elif "op" in said:
                stream.say({"id": said["id"], **self.operation(branch, said["op"], said.get("args", {}))})

    def client_present(self, key: str, up: bool) -> None:
        if not up:
            self.sessions.pop(key.removesuffix("/live"), None)

    # -- being a client ------------------------------------------------------------------------------------------------

    def answer_came(self, key: str, data: bytes) -> None:
        base = key[:-2]
        if base not in self.calls:
            return
        call, token, said = self.calls[base]
        for one in self.sessions[base].arrived(data):
            if "hello" in one:
                epoch = one["hello"]["epoch"]
                self.sessions[base].say(
                    {"id": 1, "op": call["operation"], "epoch": epoch, "args": call.get("args", {})}
                )
            else:
                said.append(one)
        if len(said) >= call.get("answers", 1):
            token.undeclare()
            del self.calls[base], self.sessions[base]
            print(json.dumps(said, default=repr), flush=True)

    def do(self, what: dict[str, Any]) -> None:
        said: Any = None
        if "kernel" in what:
            pair: tuple[str, str] = tuple(what["kernel"].split("/"))
            at = f"{what['kernel']}/{self.peers.get(pair, 0):016x}"
        match what["do"]:
            case "list":
                said = {"/".join(pair): self.get(pair, "info", "names", {}) for pair in self.peers}
            case "call":
                said = self.get(pair, what.get("branch", "ctl"), what["operation"], what.get("args", {}))
            case "session":
                number = int.from_bytes(os.urandom(4), "big")
                base = f"{DOMAIN}/{what.get('branch', 'ctl')}/{at}/{self.kernel}/{number:08x}"
                token = self.session.liveliness().declare_token(f"{base}/live")
                self.calls[base] = what, token, []
                stream = self.sessions[base] = Stream(lambda data: self.put(f"{base}/c", data), number)
                stream.say({"hello": {"oldest": 1, "newest": 1, "who": "a foreign program"}})
                return
            case "read":
                body = [[1, 1], what["port"], f"{self.kernel}/twin.inp", {"subscription": "new", "push": "all"}]
                return self.ask(pair, "request", msgpack.packb(body), self.say_answer)
            case "write":
                self.writes(what["port"], f"{self.kernel}/twin.{what['as']}", what["port"], pair)
                for value in what["values"]:
                    self.writers[what["port"]].write(time.time_ns(), value)
            case "service":
                method = [what["method"], False, "int", [["a", 1, "int", False], ["b", 1, "int", False]]]
                text = [what["interface"], [method], {}]
                body = [f"{self.kernel}/twin.calls", "", what["port"], text]

                def bound(good: bool, data: bytes) -> None:
                    number, _, absent, refused, _ = msgpack.unpackb(data)
                    if not number:
                        return print(json.dumps([absent, refused]), flush=True)
                    call = msgpack.packb([number, 1, what["method"], what["args"], {}, 5.0])
                    return self.ask(pair, "call", call, self.say_answer)

                return self.ask(pair, "bind", msgpack.packb(body), bound)
            case "received":
                said, self.values = self.values, []
            case "links":
                said = {name: [one.acknowledged, len(one.kept), one.why] for name, one in self.writers.items()}
        return print(json.dumps(said, default=repr), flush=True)

    def say_answer(self, good: bool, data: bytes) -> None:
        print(json.dumps([good, msgpack.unpackb(data) if good else data.decode()], default=repr), flush=True)

    def get(self, pair: tuple[str, str], branch: str, operation: str, given: dict[str, Any]) -> Any:
        key = f"{DOMAIN}/{branch}/{pair[0]}/{pair[1]}/{self.peers[pair]:016x}/{self.kernel}/{operation}"
        replies = self.session.get(key, payload=msgpack.packb(given), timeout=5.0, express=True)
        return next((msgpack.unpackb(one.ok.payload.to_bytes()) for one in replies if one.ok is not None), None)


def main() -> None:
    foreign = Foreign(*sys.argv[1:])
    print(json.dumps("ready"), flush=True)

    def read() -> None:
        for line in sys.stdin:
            foreign.handed(foreign.do, json.loads(line))
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    foreign.run()


if __name__ == "__main__":
    main()
