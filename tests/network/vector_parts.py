"""Makes the test vectors of the specification: `python tests/network/vector_parts.py` writes their files anew."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import aiorts_zenoh
from aiorts.links.layout import layout_of
from aiorts.links.messages import Answer, LinkRequest, packed
from aiorts.links.transport import LinkOffer, Peer
from aiorts.model.links import frames
from aiorts.model.names import Path as PortPath
from aiorts.model.options import connector_profile, link_options
from aiorts.sessions.protocol import framed
from aiorts.types import (
    TimedBoolean,
    TimedDouble,
    TimedDoubleSeq,
    TimedLong,
    TimedOctetSeq,
    TimedString,
    TimedVelocity2D,
    Velocity2D,
)
from aiorts.wire import LINK, MsgpackCodec
from aiorts_zenoh import envelope
from aiorts_zenoh.keys import CTL, INFO, ClientKeys, Keys
from aiorts_zenoh.names import Claim, seen
from aiorts_zenoh.stream import Stream

FOLDER = Path(aiorts_zenoh.__file__).with_name("vectors")
SENT_NS = 1_700_000_000_123_456_789
KINDS = {
    "FRAME": envelope.FRAME,
    "PIECE": envelope.PIECE,
    "TAKEN": envelope.TAKEN,
    "LOOK": envelope.LOOK,
    "END": envelope.END,
    "HAVE": envelope.HAVE,
}
TYPES = (TimedBoolean, TimedLong, TimedDouble, TimedString, TimedOctetSeq, TimedDoubleSeq, TimedVelocity2D)
WRITER, READER = Peer("pc1", "station", 0x0123456789ABCDEF), Peer("pc2.local", "robot-7", 0xFEDCBA9876543210)
OWN = Keys("default", WRITER, 1_700_000_000_000_000_001, 0x00000000DEADBEEF)


def pattern(size: int) -> bytes:
    """Bytes that everybody can make: of each its place modulo 251."""
    return bytes(place % 251 for place in range(size))


def keys() -> dict[str, Any]:
    own, client = OWN, ClientKeys("default", "anna")
    return {
        "kernel": {"domain": own.domain, "host": WRITER.host, "kernel": WRITER.kernel, "epoch": WRITER.epoch,
                   "start_ns": own.start_ns, "machine": own.machine},
        "other": {"host": READER.host, "kernel": READER.kernel, "epoch": READER.epoch},
        "token": own.token,
        "owner token": own.owned,
        "tokens of all": own.tokens,
        "tells the other at": own.told(READER),
        "is told at": own.heard,
        "answers questions at": own.questions,
        "asks the other for its time": own.question(READER, "clock"),
        "receives frames of links at": list(own.frames),
        "link 7, from the writer": own.link(WRITER, READER, "7", "w"),
        "link 7, from the reader": own.link(WRITER, READER, "7", "r"),
        "answers calls at": {branch: own.calls(branch) for branch in (INFO, CTL)},
        "receives sessions at": {branch: own.sessions(branch) for branch in (INFO, CTL)},
        "tokens of sessions": {branch: own.session_tokens(branch) for branch in (INFO, CTL)},
        "sends in the session 0a0b0c0d of anna at": own.session(CTL, "anna", "0a0b0c0d"),
        "anna calls hello in all": client.every(CTL, "hello"),
        "anna receives what sessions bring at": client.answers(CTL),
        "tokens that anna looks at": client.tokens,
        "the session 0a0b0c0d of anna": client.session(CTL, WRITER, "0a0b0c0d"),
    }  # fmt: skip


def claims() -> dict[str, Any]:
    one = Claim(100, 1, 7, "pc", "robot")
    later = Claim(200, 2, 7, "pc", "robot")
    elsewhere = Claim(50, 3, 8, "pc", "robot")
    arm = Claim(300, 4, 7, "pc", "arm")
    tables = (
        [(one, False)],
        [(one, False), (later, False)],
        [(one, False), (later, True)],
        [(one, False), (arm, False)],
        [(one, False), (elsewhere, False)],
        [(one, True), (elsewhere, False), (arm, False)],
        [(Claim(100, 2, 7, "pc", "robot"), False), (one, False)],
    )
    return {
        "tables": [
            {
                "claims": [{**claim._asdict(), "owned": owned} for claim, owned in table],
                "seen": {name: claim.epoch for name, claim in seen(dict(table)).items()},
            }
            for table in tables
        ]
    }


def envelopes() -> dict[str, Any]:
    found = []
    for what, kind, epoch, first, blocks in (
        ("one block", "FRAME", 0x01020304, 5, [b"ab"]),
        ("a head and two parts", "FRAME", 1, 2**40, [b"head", b"", pattern(9)]),
        ("an empty block", "FRAME", 1, 0, [b""]),
        ("all is as large as it goes", "FRAME", 2**32 - 1, 2**63 - 1, [b"\xff"]),
        ("how far the receiver is", "TAKEN", 7, 65_536, []),
        ("asks how far it is", "LOOK", 7, 720_896, []),
        ("nothing comes any more", "END", 7, 12, []),
        ("asks for all from 12 on", "HAVE", 7, 12, []),
    ):
        data = envelope.message(KINDS[kind], epoch, first, SENT_NS, blocks)
        found.append({"what": what, "kind": kind, "epoch": epoch, "first": first, "sent_ns": SENT_NS,
                      "blocks": [block.hex() for block in blocks], "bytes": data.hex()})  # fmt: skip
    good = envelope.message(envelope.FRAME, 1, 0, SENT_NS, [b"abc"])
    refused = [
        ("shorter than its head", good[:23]),
        ("another version", b"\x02" + good[1:]),
        ("kind 0", good[:1] + b"\x00" + good[2:]),
        ("kind 7", good[:1] + b"\x07" + good[2:]),
        ("a block that is cut", good[:-1]),
        ("a length that is cut", good[:26]),
        ("more than its blocks", good + b"\x00"),
        ("more blocks than there are", good[:2] + b"\x02" + good[3:]),
    ]
    costs = [[size, envelope.cost(size)] for size in (24, 36, 64_000, 259_999, 260_000, 260_052)]
    return {
        "messages": found,
        "refused": [{"what": what, "bytes": data.hex()} for what, data in refused],
        "costs": costs,
    }


def pieces() -> dict[str, Any]:
    long = []
    for sizes in ([63_993], [24, 100_000], [24, 300_000, 0, 5]):
        blocks = [pattern(size) for size in sizes]
        made = []
        for place, parts in envelope.pieces(blocks):
            data = envelope.message(envelope.PIECE, 9, 0, SENT_NS, [place, parts])
            made.append({"place": place.hex(), "size": sum(map(len, parts)), "message": len(data),
                         "sha256": hashlib.sha256(data).hexdigest()})  # fmt: skip
        long.append({"blocks": sizes, "pieces": made})
    whole = envelope.message(0, 0, 0, 0, [b"head", pattern(10)])[24:]
    whole = (2).to_bytes(4, "little") + whole
    cut = [[len(whole).to_bytes(8, "little") + at.to_bytes(8, "little"), whole[at : at + 10]] for at in (0, 10, 20)]

    def joined(chosen: list[int]) -> dict[str, Any]:
        one, found = envelope.Whole(), []
        for number in chosen:
            frame = one.add([memoryview(part) for part in cut[number]])
            found += [] if frame is None else [[bytes(block).hex() for block in frame]]
        return {"pieces": [[part.hex() for part in cut[number]] for number in chosen], "frames": found}

    return {
        "pattern": "a block of N bytes: of each its place modulo 251",
        "cut": long,
        "joined": [joined(chosen) for chosen in ([0, 1, 2], [0, 2], [0, 1, 0, 1, 2], [1, 2], [0, 1, 1, 2])],
    }


def links() -> dict[str, Any]:
    big = 2**64 - 1
    made = [
        ({"kind": "hello", "link": 7, "epoch": big, "received": 3}, frames.hello(7, big, 3)),
        ({"kind": "data", "link": 7, "first": 4, "oldest": 2, "confirm": False, "ages": [], "samples": ["0102"]},
         frames.data(7, 4, 2, [b"\1\2"], confirm=False)),
        ({"kind": "data", "link": 7, "first": 4, "oldest": 4, "confirm": True, "ages": [],
          "samples": ["0102", "", "03"]},
         frames.data(7, 4, 4, [b"\1\2", b"", b"\3"], confirm=True)),
        ({"kind": "data", "link": 7, "first": 4, "oldest": 4, "confirm": False, "ages": [1_000], "samples": ["0102"]},
         frames.data(7, 4, 4, [b"\1\2"], confirm=False, ages=[1_000])),
        ({"kind": "data", "link": 7, "first": 4, "oldest": 4, "confirm": True, "ages": [9, 8], "samples": ["01", "02"]},
         frames.data(7, 4, 4, [b"\1", b"\2"], confirm=True, ages=[9, 8])),
        ({"kind": "ack", "link": 7, "done": 5, "received": 6, "fates": []}, frames.acknowledgement(7, 5, 6, {})),
        ({"kind": "ack", "link": 7, "done": 5, "received": 5, "fates": [[4, "rejected"], [5, "undecodable"]]},
         frames.acknowledgement(7, 5, 5, {4: "rejected", 5: "undecodable"})),
        ({"kind": "bye", "link": 7}, frames.bye(7)),
        ({"kind": "want", "link": 7, "number": 8, "wait": True}, frames.want(7, 8, wait=True)),
        ({"kind": "none", "link": 7, "number": 8, "wait": False}, frames.none(7, 8, wait=False)),
    ]  # fmt: skip
    return {"heads": [{**fields, "bytes": head.hex()} for fields, head in made]}


def samples() -> dict[str, Any]:
    codec = MsgpackCodec(LINK)
    long = pattern(16_384)
    made: list[tuple[Any, Any]] = [
        (TimedBoolean(1, True), {"tm": 1, "data": True}),
        (TimedLong(SENT_NS, -2), {"tm": SENT_NS, "data": -2}),
        (TimedDouble(2, 0.5), {"tm": 2, "data": 0.5}),
        (TimedString(3, "h\u00e9"), {"tm": 3, "data": "h\u00e9"}),
        (TimedOctetSeq(4, b"\1\2\3"), {"tm": 4, "data": "010203"}),
        (TimedOctetSeq(4, long), {"tm": 4, "data": "pattern 16384"}),
        (TimedDoubleSeq(5, [1.0, -0.25]), {"tm": 5, "data": [1.0, -0.25]}),
        (TimedVelocity2D(6, Velocity2D(1.0, 0.0, 0.5)), {"tm": 6, "data": {"vx": 1.0, "vy": 0.0, "va": 0.5}}),
    ]
    found = []
    for sample, value in made:
        head, parts = codec.encode_parts(sample)
        shown = [f"pattern {part.nbytes}" if bytes(part) == long else bytes(part).hex() for part in parts]
        found.append({"type": type(sample).__name__, "value": value, "head": head.hex(), "parts": shown})
    return {"samples": found}


def types() -> dict[str, Any]:
    found = []
    for cls in TYPES:
        digest, text = layout_of(cls)
        found.append({"name": cls.__name__, "hash": digest.hex(), "layout": text})
    return {"types": found}


def questions() -> dict[str, Any]:
    where = "station/source.out -> robot-7/sink.inp"
    options = link_options(where, {})
    profile, _ = connector_profile(where, options, "source.out-sink.inp", ("a", "b"))
    digest, text = layout_of(TimedLong)
    writer, reader = PortPath.parse("station/source.out"), PortPath.parse("pc2.local/robot-7/sink.inp")
    offer = LinkOffer((1, 1), profile.name, writer, reader, WRITER.epoch, 0, 0, digest, text, None, None, profile,
                      256, 8 << 20)  # fmt: skip
    beside = WRITER.epoch.to_bytes(8, "little") + (3).to_bytes(8, "little") + b"pc1/station"
    bodies: list[tuple[str, list[Any], bytes]] = [
        ("offer", [[1, 1], profile.name, [str(writer), str(reader), WRITER.epoch, 0, 0], [digest.hex(), text, "", []],
                   [profile.name, {"subscription": "new", "push": "all", "on_link_lost": "wait"}, 256, 8 << 20]],
         offer.to_bytes()),
        ("answer: connected", [7, READER.epoch, "", "", [1, 1]], Answer(7, READER.epoch, protocol=(1, 1)).to_bytes()),
        ("answer: not yet", [0, 0, "no sink", "", [1, 1]], Answer(absent="no sink", protocol=(1, 1)).to_bytes()),
        ("answer: never", [0, 0, "", "types differ", [1, 1]],
         Answer(refused="types differ", protocol=(1, 1)).to_bytes()),
        ("request", [[1, 1], "pc1/station/source.out", "robot-7/sink.inp", {"subscription": "new"}],
         LinkRequest("pc1/station/source.out", "robot-7/sink.inp", {"subscription": "new"}, (1, 1)).to_bytes()),
        ("ledger", ["source.out-sink.inp"], packed(["source.out-sink.inp"])),
        ("ledger: answer", [1, 2, 10, 8, 1, 0, {"overwritten": 1}], packed([1, 2, 10, 8, 1, 0, {"overwritten": 1}])),
    ]  # fmt: skip
    return {
        "attachment": {"epoch": WRITER.epoch, "number": 3, "who": "pc1/station", "bytes": beside.hex()},
        "bodies": [{"what": what, "values": values, "bytes": body.hex()} for what, values, body in bodies],
        "clock: answer": {"ns": SENT_NS, "bytes": SENT_NS.to_bytes(8, "little", signed=True).hex()},
    }


class Talk:
    """A session in which both ends are here, and what they send is written down and may be lost."""

    def __init__(self) -> None:
        self.steps: list[dict[str, Any]] = []
        self.sent: list[bytes] = []
        self.ends = {who: Stream(self.sent.append, 0x0A0B0C0D, lambda: SENT_NS) for who in ("client", "kernel")}

    def step(self, who: str, what: str, act: Callable[[Stream], object], data: bytes = b"") -> list[bytes]:
        """An end does something; returns what it sends."""
        self.sent.clear()
        came = act(self.ends[who])
        sent = list(self.sent)
        given = {"bytes": data.hex()} if data else {}
        got = {"gives": came.hex()} if isinstance(came, bytes) and came else {}
        self.steps.append({"end": who, "does": what, **given, **got, "sends": [one.hex() for one in sent]})
        return sent

    def send(self, who: str, data: bytes) -> list[bytes]:
        return self.step(who, "send", lambda end: end.send(data), data)

    def arrive(self, who: str, messages: list[bytes]) -> list[bytes]:
        """Messages come, and what they bring is used at once; returns what the end sends."""
        found = []
        for one in messages:
            message = envelope.read(one)
            found += self.step(who, "arrived", lambda end, message=message: end.arrived(message), one)  # type: ignore[misc]
            if came := self.steps[-1].get("gives"):
                count = len(came) // 2
                found += self.step(who, "took", lambda end, count=count: end.took(count))  # type: ignore[misc]
                self.steps[-1]["count"] = count
        return found


def sessions() -> dict[str, Any]:
    hello = {"hello": {"oldest": 1, "newest": 1, "who": "anna"}}
    call = {"id": 1, "op": "activate", "epoch": "0123456789abcdef", "args": {"component": "counter"}}
    answer = {"id": 1, "ok": {"text": ""}}
    talk = Talk()
    talk.arrive("kernel", talk.send("client", framed(hello)))
    talk.send("client", framed(call))  # lost
    late = talk.send("client", framed({"id": 1, "cancel": True}))
    talk.arrive("kernel", late)  # before it one is missing
    looks = talk.step("client", "look", lambda end: end.look())
    again = talk.arrive("client", talk.arrive("kernel", looks))
    talk.arrive("kernel", again)
    talk.arrive("client", talk.send("kernel", framed(answer)))
    looks = talk.step("kernel", "look", lambda end: end.look())
    talk.arrive("kernel", talk.arrive("client", looks))
    ends = talk.step("client", "end", lambda end: end.end())
    talk.arrive("client", talk.arrive("kernel", ends))
    said = [("hello", hello), ("call", call), ("answer", answer), ("cancel", {"id": 1, "cancel": True})]
    return {
        "frames": [{"what": what, "value": value, "bytes": framed(value).hex()} for what, value in said],
        "number": 0x0A0B0C0D,
        "steps": talk.steps,
    }


MADE: dict[str, Callable[[], dict[str, Any]]] = {
    one.__name__: one for one in (keys, claims, envelopes, pieces, links, samples, types, questions, sessions)
}


def text_of(name: str) -> str:
    """A file of vectors, as it is to be."""
    return json.dumps(MADE[name](), indent=1, ensure_ascii=True) + "\n"


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for each in MADE:
        (FOLDER / f"{each}.json").write_text(text_of(each), encoding="ascii")
