"""Every verb of `log` beside every fault of a source: what is lost is said, and the exit status says so too.

The tables are what a user was promised: status 1 where recorded data are not in what a verb made or printed, 2 where a
source cannot be used at all, 0 where nothing is lost; what is left out by its kind is no loss.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import aiorts.types as t
from aiorts.cli.app import run_command
from aiorts_log import RecordingOptions, RecordingWriter
from foreign_parts import float64, mcap_file, old_bag
from log_parts import BEGIN, MS, make

DONE, FAILED, REFUSED = 0, 1, 2
LARGE = "y" * 1_048_577


def converted(folder: Path, name: str) -> Path:
    make(folder / "made.mcap", 20)
    assert run_command(["log", "convert", str(folder / "made.mcap"), str(folder / name)]) == DONE
    return folder / name


def whole_mcap(folder: Path) -> Path:
    make(folder / "whole.mcap", 200, chunk=512)
    return folder / "whole.mcap"


def torn_mcap(folder: Path) -> Path:
    whole = whole_mcap(folder).read_bytes()
    path = folder / "torn.mcap"
    path.write_bytes(whole[: len(whole) // 2])
    return path


def unclosed_mcap(folder: Path) -> Path:
    """Killed between two chunks: all bytes that are there can be read."""
    from aiorts_log import RecordingReader

    path = whole_mcap(folder)
    with RecordingReader(path) as reader:
        end = max(piece.offset + piece.length for piece in reader.pieces[:3])
    short = folder / "unclosed.mcap"
    short.write_bytes(path.read_bytes()[:end])
    return short


def torn_lines(folder: Path) -> Path:
    path = converted(folder, "torn.jsonl")
    path.write_bytes(path.read_bytes()[:-20])
    return path


def torn_text(folder: Path) -> Path:
    path = converted(folder, "torn.txt")
    data = path.read_bytes()
    path.write_bytes(data[: data.index(b"\n", len(data) // 2) + 12])
    return path


def no_samples(folder: Path) -> Path:
    make(folder / "none.mcap", 0)
    return folder / "none.mcap"


def no_bytes(folder: Path) -> Path:
    (folder / "empty.mcap").touch()
    return folder / "empty.mcap"


def unknown_type(folder: Path) -> Path:
    channel = ("/p", "protobuf", "P", "protobuf", "x", [(BEGIN, b"\x08\x01")])
    return mcap_file(folder / "unknown.mcap", [channel])


def refused(folder: Path) -> Path:
    """One text of three was longer than a recording takes."""
    path = folder / "refused.mcap"
    with RecordingWriter(path, RecordingOptions(min_free=0)) as writer:
        port = writer.add_port("pid0.command", t.TimedString)
        for i, text in enumerate(("a", LARGE, "b")):
            writer.write(port, t.TimedString(BEGIN + i * MS, text), BEGIN + i * MS)
    return path


SOURCES: dict[str, Callable[[Path], Path]] = {
    "whole": whole_mcap,
    "torn": torn_mcap,
    "unclosed": unclosed_mcap,
    "torn lines": torn_lines,
    "torn text": torn_text,
    "no samples": no_samples,
    "no bytes": no_bytes,
    "unknown type": unknown_type,
    "refused": refused,
}
VERBS = ("info", "check", "cat", "plot", "diff", "convert", "cut", "merge", "salvage")
LOST_AT_ITS_END = {
    **dict.fromkeys(("cat", "plot", "diff", "convert", "cut", "merge", "check"), FAILED),
    **dict.fromkeys(("info", "salvage"), DONE),  # both say what is lost, and that is what they are for
}
STATUS: dict[str, dict[str, int]] = {
    "whole": dict.fromkeys(VERBS, DONE),
    "torn": LOST_AT_ITS_END,
    "unclosed": dict.fromkeys(VERBS, DONE),  # every byte that was written is read
    "torn lines": LOST_AT_ITS_END,
    "torn text": LOST_AT_ITS_END,
    "no samples": {**dict.fromkeys(VERBS, DONE), "plot": REFUSED},
    "no bytes": dict.fromkeys(VERBS, REFUSED),
    "unknown type": {**dict.fromkeys(VERBS, DONE), "plot": REFUSED},
    "refused": {**dict.fromkeys(VERBS, DONE), "plot": REFUSED},  # the run that lost it has ended with 1
}


def run(verb: str, source: Path, folder: Path) -> int:
    target, other = str(folder / "new.mcap"), folder / "other.mcap"
    if verb in ("merge", "diff"):
        with RecordingWriter(other, RecordingOptions(min_free=0, existing="overwrite")) as writer:
            writer.write(writer.add_port("elsewhere", t.TimedDouble), t.TimedDouble(BEGIN, 1.0), BEGIN)
    arguments = {
        "info": ["info", str(source)],
        "check": ["info", "--check", str(source)],
        "cat": ["cat", str(source)],
        "plot": ["plot", str(source), "pid0.command", "-o", str(folder / "p.svg")],
        "diff": ["diff", str(source), str(source)],
        "convert": ["convert", str(source), target],
        "cut": ["cut", str(source), target],
        "merge": ["merge", str(source), str(other), target],
        "salvage": ["salvage", str(source), target],
    }
    if verb != "plot":
        return run_command(["log", *arguments[verb]])
    # In a process of its own: matplotlib keeps the files of its fonts open for the next picture.
    done = subprocess.run(
        [sys.executable, "-m", "aiorts", "log", *arguments[verb]],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    sys.stdout.write(done.stdout + done.stderr)
    return done.returncode


@pytest.mark.parametrize("fault", SOURCES)
@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_ends_with_1_where_what_was_recorded_is_not_in_its_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str, fault: str
) -> None:
    if verb == "plot":
        pytest.importorskip("matplotlib")
    source = SOURCES[fault](tmp_path)
    capsys.readouterr()
    assert run(verb, source, tmp_path) == STATUS[fault][verb]
    said = "".join(capsys.readouterr())
    if STATUS[fault][verb] == FAILED and verb != "check":
        assert "not closed" in said
        assert "bytes at its end are unusable" in said
    if fault == "unclosed" and verb not in ("check", "salvage"):
        assert "not closed" in said
    if (fault, verb) == ("refused", "info"):
        assert "refused of pid0.command: 1 sample: TimedString: byte" in said


def test_a_torn_recording_equals_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Not even the copy of what can be read: nobody knows what its end was."""
    torn = torn_mcap(tmp_path)
    assert run_command(["log", "cut", str(torn), str(tmp_path / "cut.mcap")]) == FAILED
    capsys.readouterr()
    assert run_command(["log", "diff", str(torn), str(tmp_path / "cut.mcap")]) == FAILED
    assert capsys.readouterr().out.startswith("equal as far as they can be read: ")
    assert run_command(["log", "diff", "--json", str(torn), str(tmp_path / "cut.mcap")]) == FAILED
    found = json.loads(capsys.readouterr().out)
    assert (found["equal"], [one["file"] for one in found["not_closed"]]) == (False, [str(torn)])


def test_refused_samples_are_in_the_document_of_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["log", "info", "--json", str(refused(tmp_path))]) == DONE
    ((port, reasons),) = json.loads(capsys.readouterr().out)["refused"].items()
    assert (port, list(reasons.values())) == ("pid0.command", [1])
    assert "1048577; at most 1048576" in next(iter(reasons))


def aiorts(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "aiorts", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize(("fault", "status"), [("whole", DONE), ("unclosed", DONE), ("torn", FAILED)])
def test_a_replay_of_a_torn_recording_ends_with_1(tmp_path: Path, fault: str, status: int) -> None:
    source = SOURCES[fault](tmp_path)
    done = aiorts(tmp_path, "flexilogger", "-o", "-l", str(source), "--speed", "max")
    assert (done.returncode, "not closed" in done.stderr) == (status, fault != "whole")
    assert done.stdout


def test_a_run_warns_once_for_each_port_whose_samples_are_not_recorded(tmp_path: Path) -> None:
    (tmp_path / "long.py").write_text(
        "from aiorts import Component, OutPort\nfrom aiorts.types import TimedString\n"
        "class Long(Component):\n    text = OutPort(TimedString)\n    short = OutPort(TimedString)\n"
        "    def on_execute(self):\n        t = self.clock.time_ns()\n"
        "        self.text.write_nowait(TimedString(t, 'y' * 1_048_577))\n"
        "        self.short.write_nowait(TimedString(t, 'y'))\n"
    )
    how = ("--rate", "10", "--simulate", "--for", "0.3", "--quiet", "--control=off", "--record", "long.mcap")
    done = aiorts(tmp_path, "run", "long.py:Long", *how)
    assert done.returncode == FAILED
    (warning,) = [line for line in done.stderr.splitlines() if "long.text" in line]
    assert warning.startswith("aiorts: warning: long.mcap: a sample of long.text is not recorded: TimedString: ")
    assert warning.endswith("a length of 1048577; at most 1048576 is allowed")
    found = json.loads(aiorts(tmp_path, "log", "info", "--json", "long.mcap").stdout)
    assert {name: sum(reasons.values()) for name, reasons in found["refused"].items()} == {"long.text": 4}


# -- import ------------------------------------------------------------------------------------------------------------

Channel = tuple[str, str, str, str, str, list[tuple[int, bytes]]]
PACKED = b"\x28\xb5\x2f\xfd1234"
READ, TAKEN, LEFT_OUT, LOST = "read", "taken", "left_out", "lost"


def json_channel(topic: str, *bodies: Any, start: int = BEGIN) -> Channel:
    data = [(start + i, json.dumps(body).encode()) for i, body in enumerate(bodies)]
    return (topic, "json", "T", "jsonschema", '{"type": "object"}', data)


def cdr_channel(topic: str, *bodies: bytes) -> Channel:
    return (topic, "cdr", "std_msgs/msg/Float64", "ros2msg", "float64 data", list(enumerate(bodies, BEGIN)))


def json_file(*bodies: Any, **options: Any) -> Callable[[Path], Path]:
    return lambda folder: mcap_file(folder / "source.mcap", [json_channel("/t", *bodies, **options)])


def torn_foreign(folder: Path) -> Path:
    path = folder / "source.mcap"
    with path.open("wb") as stream:
        writer = pytest.importorskip("mcap.writer").Writer(stream, chunk_size=64)
        writer.start()
        channel = writer.register_channel("/t", "json", writer.register_schema("T", "jsonschema", b"{}"))
        for i in range(100):
            writer.add_message(channel, BEGIN + i, b'{"v": 1.0}', BEGIN + i)
        writer.finish()
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


def cdr_file(*bodies: bytes) -> Callable[[Path], Path]:
    return lambda folder: mcap_file(folder / "source.mcap", [cdr_channel("/t", *bodies)])


def database(*bodies: bytes, kind: str = "std_msgs/msg/Float64") -> Callable[[Path], Path]:
    rows = [(1, "/t", kind, list(enumerate(bodies, BEGIN)))]
    return lambda folder: old_bag(folder / "source.db3", rows)


def bag_folder(*bodies: bytes) -> Callable[[Path], Path]:
    def made(folder: Path) -> Path:
        (folder / "bag").mkdir()
        mcap_file(folder / "bag" / "bag_0.mcap", [cdr_channel("/t", *bodies)])
        return folder / "bag"

    return made


def good() -> bytes:
    return float64(1.0)


IMPORTS: dict[str, tuple[Callable[[], Callable[[Path], Path]], int, dict[str, int], str]] = {
    "json whole": (lambda: json_file({"v": 1.0}, {"v": 2.0}), DONE, {READ: 2, TAKEN: 2}, "2 messages: 2 taken"),
    "json empty": (lambda: json_file(), DONE, {READ: 0}, "0 samples"),
    "json far": (lambda: json_file({"v": 1.0}, start=2**63), FAILED, {READ: 1, LOST: 1}, "outside 1970..2106"),
    "json large": (
        lambda: json_file({"s": LARGE}, {"s": "a"}),
        FAILED,
        {READ: 2, TAKEN: 1, LOST: 1},
        "at most 1048576",
    ),
    "json large beside": (
        lambda: json_file({"s": LARGE, "v": 1.0}),
        FAILED,
        {READ: 1, TAKEN: 1},
        "lost of /t s: 1 times",
    ),
    "json torn": (lambda: torn_foreign, FAILED, {READ: 81, TAKEN: 81}, "bytes at its end are unusable"),
    "json without fields": (
        lambda: json_file({}, {"a": {}}),
        DONE,
        {READ: 2, LEFT_OUT: 2},
        "left out: /t: it has no fields",
    ),
    "json some without fields": (
        lambda: json_file({}, {"v": 1.0}),
        DONE,
        {READ: 2, TAKEN: 1, LEFT_OUT: 1},
        "left out: /t: 1 of its messages have no fields",
    ),
    "json null": (lambda: json_file({"v": None}), DONE, {READ: 1, LEFT_OUT: 1}, "left out: /t v: null"),
    "json changed": (lambda: json_file({"v": 1.0}, {"v": "a"}), FAILED, {READ: 2, TAKEN: 1, LOST: 1}, "no TimedDouble"),
    "cdr whole": (lambda: cdr_file(good(), good()), DONE, {READ: 2, TAKEN: 2}, "2 messages: 2 taken"),
    "cdr short": (lambda: cdr_file(good(), good()[:7]), FAILED, {READ: 2, TAKEN: 1, LOST: 1}, "lost of /t: 1 times"),
    "cdr compressed": (lambda: cdr_file(PACKED, PACKED), FAILED, {READ: 2, LOST: 2}, "compressed one by one"),
    "folder compressed": (lambda: bag_folder(PACKED), FAILED, {READ: 1, LOST: 1}, "compressed one by one"),
    "folder whole": (lambda: bag_folder(good()), DONE, {READ: 1, TAKEN: 1}, "1 message: 1 taken"),
    "database whole": (lambda: database(good()), DONE, {READ: 1, TAKEN: 1}, "1 message: 1 taken"),
    "database short": (lambda: database(good()[:7]), FAILED, {READ: 1, LOST: 1}, "lost of /t: 1 times"),
    "database compressed": (lambda: database(PACKED), FAILED, {READ: 1, LOST: 1}, "compressed one by one"),
    "database without fields": (
        lambda: database(b"\0\1\0\0\0", kind="std_msgs/msg/Empty"),
        DONE,
        {READ: 1, LEFT_OUT: 1},
        "left out: /t: it has no fields",
    ),
}


@pytest.mark.parametrize("what", IMPORTS)
def test_an_import_counts_every_message_and_ends_with_1_where_one_is_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    pytest.importorskip("rosbags")
    source_of, status, counts, said = IMPORTS[what]
    source, target = source_of()(tmp_path), str(tmp_path / "new.mcap")
    assert run_command(["log", "import", str(source), target]) == status
    assert said in "".join(capsys.readouterr())
    assert run_command(["log", "import", str(source), target, "--overwrite", "--json"]) == status
    messages = json.loads(capsys.readouterr().out)["messages"]
    assert {what: n for what, n in messages["/t"].items() if n or what in counts} == counts
    assert all(one[READ] == one[TAKEN] + one[LEFT_OUT] + one[LOST] for one in messages.values())


def test_of_a_kind_that_nothing_is_made_of_no_message_is_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    protobuf: Channel = ("/p", "protobuf", "P", "protobuf", "x", [(BEGIN, b"\x08\x01")] * 3)
    source = mcap_file(tmp_path / "source.mcap", [protobuf, json_channel("/t", {"v": 1.0})])
    assert run_command(["log", "import", str(source), str(tmp_path / "new.mcap")]) == DONE
    out = capsys.readouterr().out
    assert "read of /p: 3 messages: 3 left out\n" in out
    assert "left out: /p: its messages are protobuf" in out


KEYS: tuple[tuple[Any, Any], ...] = (
    ({"a.b": 1.0, "a": {"b": 2.0}}, {'/t "a.b"': [1.0], "/t a.b": [2.0]}),
    ({'a"': 1.0, "a\\": 2.0, "": 3.0}, {'/t "a\\""': [1.0], "/t a\\": [2.0], '/t ""': [3.0]}),
    (
        {"a": {"b.c": 1.0, "b": {"c": 2.0}}, "a.b": {"c": 3.0}},
        {'/t a."b.c"': [1.0], "/t a.b.c": [2.0], '/t "a.b".c': [3.0]},
    ),
)


@pytest.mark.parametrize(("document", "expected"), KEYS)
def test_no_two_keys_of_a_document_become_one_port(tmp_path: Path, document: Any, expected: Any) -> None:
    from aiorts_log.foreign.importing import import_recording
    from log_parts import read

    source = mcap_file(tmp_path / "source.mcap", [json_channel("/t", document)])
    report = import_recording(source, tmp_path / "new.mcap")
    found = {
        what: [one.data for port, _, one in read(tmp_path / "new.mcap") if port == name]
        for name, what in report.ports.items()
    }
    assert found == expected
