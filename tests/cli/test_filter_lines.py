"""Lines of all sorts through real filters: each is taken or said to be bad in one line, and all others go through."""

from __future__ import annotations

import json
import time
from typing import Any

import pytest

from aiorts.cli.console.report import LONGEST
from campaign import CAMPAIGN
from run_parts import here

pytestmark = pytest.mark.row(123)
NESTED = 100_000


def aiorts(*arguments: str, stdin: bytes = b"") -> tuple[int, list[Any], list[str]]:
    """Exit status, lines of standard output as JSON, lines of standard error."""
    done = here(*arguments, stdin=stdin)
    return (
        done.returncode,
        [json.loads(line) for line in done.stdout.decode().splitlines()],
        done.stderr.decode().splitlines(),
    )


THROUGH = ("flexifilter", "-i", "TimedString", "-o", "TimedString")
BAD: list[tuple[bytes, str]] = [
    (b"[" * NESTED, "no JSON"),
    (b'{"data":' * NESTED, "no JSON"),
    (b"[" * 900 + b"]" * 900, "TimedString.data"),
    (b"9" * 1_000_000, "no JSON"),
    (b'{"data": ' + b"9" * 1_000_000 + b"}", "no JSON"),
    (b'"\xff"', "no UTF-8: invalid start byte at byte 1"),
    (b'"\xed\xa0\x80"', "no UTF-8"),
    (b'"\\ud800"', "TimedString.data"),
    (b'"a\0b"', "no JSON"),
    (b'\xef\xbb\xbf"a mark that begins no file"', "no JSON"),
    (b"NaN", "NaN is not JSON"),
    (b'{"data": "x", "data": "y"}', "stands there twice"),
    (b'{"data": "x", "prot": "input0"}', "did you mean 'port'?"),
    (b'{"type": "TimedLong", "data": "x"}', "put a flexifilter between them"),
    (b'{"tm": "now", "data": "x"}', "TimedString.tm"),
    (b'{"tm": true, "data": "x"}', "TimedString.tm"),
    (b"{" + b", ".join(b'"k%d": 1' % number for number in range(50_000)) + b"}", "TimedString.data"),
    (b"\x1b[2J", "no JSON"),
    (b"'x'", "no JSON"),
]
GOOD: list[tuple[bytes, str]] = [
    (b'\xef\xbb\xbf"a mark begins the file"', "a mark begins the file"),
    (b'"x"\r', "x"),
    (b'  {"data" : "x"}  ', "x"),
    (b'{"tm": 5, "data": "x"}', "x"),
    (b'{"port": "input0", "type": "TimedString", "tm": 5, "data": "x"}', "x"),
    (b'{"port": "of somebody else", "data": "x"}', "x"),
    ('"\u65e5\u672c"'.encode(), "\u65e5\u672c"),
    (b'"\\u65e5\\ud83d\\ude00"', "\u65e5\U0001f600"),
    (b'"\\u0000\\u001b"', "\0\x1b"),
    (b'"' + b"x" * 10_000_000 + b'"', "x" * 10_000_000),
    (b'"the last one has no end"', "the last one has no end"),
]


@pytest.mark.slow(kept_by="wire/test_lines.py::test_a_bad_line_says_what_is_wrong")
def test_whatever_a_line_is_it_goes_through_or_is_one_line_of_error_and_neither_takes_long() -> None:
    lines, bad, good = [], {}, []
    for number in range(max(len(BAD), len(GOOD))):
        if number < len(GOOD):
            lines.append(GOOD[number][0])
            good.append(GOOD[number][1])
        if number < len(BAD):
            lines += [b"", BAD[number][0]]
            bad[len(lines)] = BAD[number][1]
    lines += [b"", b'"\xf0\x9f', b'"over"']
    bad[len(lines) - 1] = "no UTF-8: unexpected end of data at byte 1"
    began = time.monotonic()
    status, out, err = aiorts(*THROUGH, stdin=b"\n".join(lines))
    assert time.monotonic() - began < 30  # 0.8 s on a machine that is free
    assert status == 1
    assert [line["data"] for line in out] == [*good, "over"]
    assert len(err) == len(bad)
    for line, (number, said) in zip(err, bad.items(), strict=True):
        assert line.startswith(f"aiorts: E-LINE: standard input, line {number}: ")
        assert said in line
        assert len(line) <= LONGEST
        assert line.isprintable()


@pytest.mark.slow(kept_by="test_of_ten_thousand_lines_one_in_a_hundred_is_bad_and_all_others_are_processed")
def test_lines_that_are_bad_for_one_reason_are_folded_and_all_are_counted() -> None:
    lines = [b'{"data": "x"}' if number % 4 else b"nix" for number in range(1, 20_001)]
    status, out, err = aiorts(*THROUGH, stdin=b"\n".join(lines))
    del out
    assert status == 1
    for reason, numbers in (("no JSON", range(4, 20_001, 4)),):
        told = [line.removeprefix("aiorts: E-LINE: standard input, line ") for line in err if reason in line]
        assert [int(line.partition(":")[0]) for line in told[:10]] == list(numbers[:10])
        assert 10 < len(told) <= 20
        assert told[-1].startswith(f"{numbers[-1]}: and ")
        assert f" {len(numbers)} in all: " in told[-1]
        # What is told one by one and what is told to have been before it is all there were.
        assert sum(1 + (int(line.split()[2]) if ": and " in line else 0) for line in told) == len(numbers)


def test_of_ten_thousand_lines_one_in_a_hundred_is_bad_and_all_others_are_processed() -> None:
    count = 100_000 if CAMPAIGN else 10_000
    lines = [f'{{"data": {number}}}' if number % 100 != 37 else f'{{"data": "{number}"' for number in range(count)]
    status, out, err = aiorts(
        *["flexifilter", "-i", "TimedDouble", "-o", "TimedLong", "-m", "0>2>0"], stdin="\n".join(lines).encode()
    )
    assert status == 1
    assert [line["data"] for line in out] == [2 * number for number in range(count) if number % 100 != 37]
    assert [int(line.split("line ")[1].split(":")[0]) for line in err] == [
        number + 1 for number in range(count) if number % 100 == 37
    ]


def test_several_ports_in_and_out_are_told_apart_by_their_names() -> None:
    stdin = b'{"port": "input1", "tm": 7, "data": 2}\n{"data": 3}\n{"port": "input0", "tm": 8, "data": 1.5}\n'
    status, out, err = aiorts(
        *["flexifilter", "-i", "TimedDouble", "-i", "TimedLong", "-o", "TimedLong", "-o", "TimedString"],
        *["-m", "0>10>0, 1>1"],
        stdin=stdin,
    )
    assert status == 1
    assert {"port": "output0", "type": "TimedLong", "tm": 8, "data": 15} in out
    assert {"port": "output1", "type": "TimedString", "tm": 7, "data": "2"} in out
    assert len(out) == 2
    (line,) = err
    assert "line 2: which in-port? write" in line
    assert "there are input0, input1" in line


@pytest.mark.slow
def test_the_lines_of_one_filter_are_what_another_reads() -> None:
    """Records, bytes, enumerations and numbers that are none, through filters that change nothing."""
    kinds = ["RangeData", "GPSData", "TimedOctetSeq", "TimedDoubleSeq", "CameraImage"]
    ports = [part for kind in kinds for part in ("-p", f"{kind}:1")]
    stdin = b"\n".join(
        [
            b'{"port": "input2", "tm": 1, "data": "AP8="}',
            b'{"port": "input3", "tm": 2, "data": ["NaN", "Infinity", "-Infinity", -0.0, 1e-320]}',
        ]
    )
    status, out, err = aiorts("flexidupe", *ports, stdin=stdin)
    assert (status, err) == (0, [])
    assert [line["data"] for line in out] == ["AP8=", ["NaN", "Infinity", "-Infinity", -0.0, 1e-320]]
    constants = ["-p", "RangeData", "-c", '{"ranges": [1.5]}', "-p", "GPSData", "-c", "{}"]
    status, made, err = aiorts("flexiconst", *constants, "--port-names", "input0,input1", "--count", "1")
    assert (status, err) == (0, [])
    assert "tm" not in made[0]["data"]
    assert isinstance(made[1]["data"]["fixType"], str)
    status, out, err = aiorts("flexidupe", *ports, stdin="\n".join(map(json.dumps, made)).encode())
    assert (status, err) == (0, [])
    assert [(line["type"], line["tm"], line["data"]) for line in out] == [
        (line["type"], line["tm"], line["data"]) for line in made
    ]


@pytest.mark.fault("F18")
@pytest.mark.parametrize("name", ["flexidump", "flexifilter"])
def test_standard_output_is_json_to_its_last_line_whatever_goes_wrong(name: str) -> None:
    options = (
        ["-p", "TimedShort", "--format", "json"] if name == "flexidump" else ["-i", "TimedLong", "-o", "TimedShort"]
    )
    lines = [str(number) if number % 10 else "{" for number in range(1, 2_000)]
    if name == "flexifilter":
        lines.append("99999")  # which no TimedShort holds: a bad line
    status, out, err = aiorts(name, *options, stdin="\n".join(lines).encode())  # json.loads of each line
    assert status == 1
    assert [line["data"] for line in out] == [number for number in range(1, 2_000) if number % 10]
    assert all(line.startswith("aiorts: E-") for line in err)
    assert any("line 1990: and " in line and "199 in all: column 2: no JSON" in line for line in err)
    assert any("line 2000: " in line for line in err) == (name == "flexifilter")
