"""The vectors of SPEC.md are what the code sends, the code reads them, and so does a program in C."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

import msgpack

from aiorts.links.messages import Answer, LinkRequest
from aiorts.links.transport import LinkOffer, Peer
from aiorts.model.links.frames import ages_of, fates_of, head_of, samples_of
from aiorts.sessions.protocol import answer_in, frames
from aiorts.wire import LINK, MsgpackCodec
from aiorts_zenoh import envelope
from aiorts_zenoh.keys import claim_of, peer_of
from aiorts_zenoh.names import Claim, seen
from aiorts_zenoh.sending import Budget, Receiver, Sender
from aiorts_zenoh.stream import Stream
from network.vector_parts import FOLDER, KINDS, MADE, OWN, SENT_NS, TYPES, pattern, text_of

HEADS = {"hello": 1, "data": 2, "ack": 3, "bye": 4, "want": 5, "none": 6}
FIELDS = {"hello": "epoch received", "data": "first oldest", "ack": "done received", "want": "number", "none": "number"}


def vectors(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text(encoding="ascii"))
    return found


@pytest.mark.parametrize("name", MADE)
def test_a_file_of_vectors_is_what_the_code_makes(name: str) -> None:
    there = (FOLDER / f"{name}.json").read_text(encoding="ascii")
    assert there == text_of(name), "if the change of the protocol is meant: python tests/network/vector_parts.py"


def test_the_specification_names_each_file_and_nothing_else() -> None:
    text = FOLDER.with_name("SPEC.md").read_text(encoding="utf-8")
    assert {path.stem for path in FOLDER.iterdir()} == MADE.keys()
    assert all(f"`{name}.json`" in text for name in MADE)


def test_messages_are_read_and_what_is_none_is_refused() -> None:
    for one in vectors("envelopes")["messages"]:
        found = envelope.read(bytes.fromhex(one["bytes"]))
        assert found[:4] == (KINDS[one["kind"]], one["epoch"], one["first"], one["sent_ns"])
        assert [bytes(block).hex() for block in found.blocks] == one["blocks"]
    for one in vectors("envelopes")["refused"]:
        with pytest.raises(ValueError, match=r"message|block"):
            envelope.read(bytes.fromhex(one["bytes"]))


def test_pieces_are_put_together() -> None:
    for one in vectors("pieces")["joined"]:
        whole, found = envelope.Whole(), []
        for piece in one["pieces"]:
            frame = whole.add([memoryview(bytes.fromhex(part)) for part in piece])
            found += [] if frame is None else [[bytes(block).hex() for block in frame]]
        assert found == one["frames"]
    for one in vectors("pieces")["cut"]:
        blocks = [pattern(size) for size in one["blocks"]]
        rest = b"".join((len(blocks).to_bytes(4, "little"), *(len(b).to_bytes(4, "little") + b for b in blocks)))
        whole = envelope.Whole()
        for piece in one["pieces"]:
            part, rest = rest[: piece["size"]], rest[piece["size"] :]
            frame = whole.add([memoryview(bytes.fromhex(piece["place"])), memoryview(part)])
        assert frame is not None
        assert [bytes(block) for block in frame] == blocks


def test_heads_of_links_are_read() -> None:
    for one in vectors("links")["heads"]:
        head, kind = bytes.fromhex(one["bytes"]), one["kind"]
        found, flags, count, *two = head_of(head, one["link"])
        assert found == HEADS[kind]
        assert two[: len(FIELDS.get(kind, "").split())] == [one[field] for field in FIELDS.get(kind, "").split()]
        if kind == "data":
            ages = ages_of(head, count) if flags & 2 else ()
            assert [bytes(part).hex() for part in samples_of(head, count, len(ages))] == one["samples"]
            assert (list(ages), bool(flags & 1)) == (one["ages"], one["confirm"])
        elif kind == "ack":
            assert fates_of(head, count) == dict(one["fates"])
        elif kind in ("want", "none"):
            assert bool(flags & 1) == one["wait"]


def test_samples_are_decoded() -> None:
    codec, kinds = MsgpackCodec(LINK), {cls.__name__: cls for cls in TYPES}
    for one in vectors("samples")["samples"]:
        parts = [pattern(int(part.split()[1])) if " " in part else bytes.fromhex(part) for part in one["parts"]]
        found = codec.decode_parts(bytes.fromhex(one["head"]), parts, kinds[one["type"]])
        assert codec.encode_parts(found)[0].hex() == one["head"]
        assert found.tm == one["value"]["tm"]
        if one["type"] in ("TimedBoolean", "TimedLong", "TimedDouble", "TimedString"):
            assert found.data == one["value"]["data"]


def test_questions_are_read() -> None:
    bodies = {one["what"]: one for one in vectors("questions")["bodies"]}
    offer = LinkOffer.from_bytes(bytes.fromhex(bodies["offer"]["bytes"]))
    assert [str(offer.writer), str(offer.reader), offer.writer_epoch, 0, 0] == bodies["offer"]["values"][2]
    request = LinkRequest.from_bytes(bytes.fromhex(bodies["request"]["bytes"]))
    assert [list(request.protocol), request.writer, request.reader, request.options] == bodies["request"]["values"]
    for what in ("connected", "not yet", "never"):
        one = bodies[f"answer: {what}"]
        answer = Answer.from_bytes(bytes.fromhex(one["bytes"]))
        values = [answer.number, answer.epoch, answer.absent, answer.refused, list(answer.protocol)]
        assert values == one["values"] == msgpack.unpackb(bytes.fromhex(one["bytes"]))


def test_keys_and_claims_are_read() -> None:
    keys = vectors("keys")
    own = Claim(keys["kernel"]["start_ns"], keys["kernel"]["epoch"], keys["kernel"]["machine"], "pc1", "station")
    assert claim_of(keys["token"]) == (own, False)
    assert claim_of(keys["owner token"]) == (own, True)
    assert peer_of(keys["token"]) == Peer("pc1", "station", own.epoch) == OWN.own
    for one in vectors("claims")["tables"]:
        table = {Claim(*(claim[field] for field in Claim._fields)): claim["owned"] for claim in one["claims"]}
        assert {name: claim.epoch for name, claim in seen(table).items()} == one["seen"]


def test_a_session_is_gone_through_again() -> None:
    said = vectors("sessions")
    for one in said["frames"]:
        (frame,) = frames(bytearray.fromhex(one["bytes"]), 1_000)
        assert answer_in(frame) == one["value"]
    sent: list[bytes] = []
    ends = {who: Stream(sent.append, said["number"], lambda: SENT_NS) for who in ("client", "kernel")}
    for step in said["steps"]:
        sent.clear()
        end, data = ends[step["end"]], bytes.fromhex(step.get("bytes", ""))
        match step["does"]:
            case "send":
                end.send(data)
            case "arrived":
                assert end.arrived(envelope.read(data)).hex() == step.get("gives", "")
            case "took":
                end.took(step["count"])
            case "look":
                end.look()
            case _:
                end.end()
        assert [one.hex() for one in sent] == step["sends"]
    assert ends["kernel"].ended
    assert all(end.is_through for end in ends.values())


@pytest.mark.slow
def test_a_program_in_c_makes_and_reads_them(tmp_path: Path) -> None:
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("not run: there is no C compiler")
    source, program = Path(__file__).with_name("foreign_vectors.c"), tmp_path / "vectors"
    warns = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function"]
    subprocess.run([compiler, *warns, "-o", str(program), str(source)], check=True, timeout=60)
    lines: list[tuple[str, str]] = []
    for one in vectors("envelopes")["messages"]:
        blocks = " ".join(block or "-" for block in one["blocks"])
        fields = f"{KINDS[one['kind']]} {one['epoch']} {one['first']} {one['sent_ns']} {blocks}".strip()
        lines += [(f"encode {fields}", one["bytes"]), (f"decode {one['bytes']}", fields)]
    lines += [(f"decode {one['bytes']}", "none") for one in vectors("envelopes")["refused"]]
    lines += [(f"cost {size}", str(cost)) for size, cost in vectors("envelopes")["costs"]]
    for one in vectors("pieces")["joined"]:
        joined = " ".join(" ".join(["frame", *(block or "-" for block in frame)]) for frame in one["frames"])
        lines.append((" ".join(["join", *(":".join(piece) for piece in one["pieces"])]), joined))
    for one in vectors("links")["heads"]:
        kind = HEADS[one["kind"]]
        two = [*(one[field] for field in FIELDS.get(one["kind"], "").split()), 0, 0][:2]
        flags = one.get("confirm", False) + 2 * bool(one.get("ages")) + one.get("wait", False)
        fields = f"{kind} {flags} {len(one.get('samples', one.get('fates', [])))} {one['link']} {two[0]} {two[1]}"
        lines += [(f"fields {one['bytes']}", fields), (f"head {fields}", one["bytes"][: 16 if kind == 4 else 48])]
    done = subprocess.run(
        [program],
        input="".join(f"{line}\n" for line, _ in lines),
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    for (line, wanted), found in zip(lines, done.stdout.split("\n"), strict=False):
        assert found.strip() == wanted, line


def test_a_receiver_says_how_far_it_is_as_often_as_is_written() -> None:
    text = FOLDER.with_name("SPEC.md").read_text(encoding="utf-8")
    (found,) = re.findall(r"when it has come ([\d,]+) further", text)
    told = int(found.replace(",", ""))
    said: list[int] = []
    Receiver(Budget(), said.append).took(told - 1, 0)
    Receiver(Budget(), said.append).took(told, 0)
    assert said == [told]


def test_a_sender_has_as_much_under_way_as_is_written() -> None:
    text = " ".join(FOLDER.with_name("SPEC.md").read_text(encoding="utf-8").split())
    (found,) = re.findall(
        r"of up to ([\d,]+) bytes of blocks .* while at most ([\d,]+) is under way\. A longer FRAME .* at most ([\d,]+)"
        r"; or while at most ([\d,]+) is under way, if it has at most ([\d,]+) bytes",
        text,
    )
    short, room, whole, idle, longest = (int(one.replace(",", "")) for one in found)

    def takes(used: int, size: int) -> bool:
        budget = Budget()
        budget.used = used
        return budget.takes(size)

    assert [takes(room, size) for size in (short, short + 1, 800_000)] == [True, True, False]
    assert [takes(room + 1, size) for size in (1, short)] == [False, False]
    assert (takes(whole - envelope.cost(500_100), 500_000), takes(whole - envelope.cost(500_100) + 1, 500_000)) == (
        True,
        False,
    )
    assert [takes(idle, size) for size in (longest, longest + 1)] == [True, False]
    assert not takes(idle + 1, longest)
    sent: list[bytes] = []
    Sender(Budget(), sent.append, 0, lambda: 0, lambda: None).send([bytes(longest - 4)])
    assert [envelope.read(one).kind for one in sent] == [envelope.FRAME]


@pytest.mark.slow
def test_they_are_in_what_is_installed(tmp_path: Path) -> None:
    from hatchling.builders.wheel import WheelBuilder

    root = Path(__file__).parents[2]
    (wheel,) = WheelBuilder(str(root)).build(directory=str(tmp_path), versions=["standard"])
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {"aiorts_zenoh/SPEC.md", *(f"aiorts_zenoh/vectors/{name}.json" for name in MADE)} <= names
