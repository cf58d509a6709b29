"""Options of a connection that nobody knows, and tables in the place of values: check says so, and run once."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.errors import SystemFileError
from aiorts.system import build, check, load
from system_parts import CHAIN

Write = Callable[..., Path]


def with_option(line: str) -> str:
    return CHAIN.replace("[[connections]]\n", f"[[connections]]\n{line}\n", 1)


@pytest.mark.parametrize(
    ("line", "cause", "remedy", "quoted"),
    [
        (
            'dataport.subscription_typ = "new"',
            "dataport.subscription_typ is no option that is known",
            "did you mean 'dataport.subscription_type'?",
            "subscription_typ",
        ),
        (
            "inport.buffer.lenght = 500",
            "inport.buffer.lenght is no option that is known",
            "did you mean 'inport.buffer.length'?",
            "lenght",
        ),
        ('dataflow = "pull"', "length chooses nothing where the reader pulls", "take it away", "length"),
        ('subscription = "new"', "length chooses nothing where a newer sample", "take it away", "length"),
        (
            'push = "new"',
            "push chooses nothing where every sample is sent: push takes subscription",
            "take it away",
            "push",
        ),
        ("foo.bar = 1", "foo.bar is no option that is known", "it is kept and does nothing: take it away", "bar"),
        ('name = ""', "connector name '': is empty", "choose another, or take it away", '""'),
        ('name = "a.b"', "connector name 'a.b': ", "choose another, or take it away", '"a.b"'),
    ],
)
def test_an_option_that_does_nothing_is_a_warning_with_its_place(
    write: Write, line: str, cause: str, remedy: str, quoted: str
) -> None:
    (found,) = (one for one in check(write(with_option(line))) if one.severity != "note" and one.code != "W-UNFED")
    assert (found.severity, found.code, found.remedy) == ("warning", "W-OPTION", remedy)
    assert found.cause.startswith(cause)
    assert found.quote[found.column - 1 : found.column - 1 + found.width] == quoted


def test_a_push_policy_chooses_on_the_way_to_a_process(write: Write) -> None:
    text = (
        with_option('push = "new"').replace("length = 4\n", "").replace(':Middle"', ':Middle"\nisolation = "process"')
    )
    assert not [one for one in check(write(text)) if one.code == "W-OPTION"]


@pytest.mark.parametrize(
    ("line", "cause", "remedy"),
    [
        ("push.rate = 10", "expected a value, got the table {'rate': 10}", "did you mean 'push_rate'?"),
        ("out_length = {value = 16}", "expected a value, got the table {'value': 16}", "write out_length = VALUE"),
        ("subscription = {}", "expected a value, got the table {}", "write subscription = VALUE"),
        ("timeout = {x = 1}", "expected a value, got the table {'x': 1}", "write timeout = VALUE"),
        ("buffer = {}", "is an empty table and says nothing", "take it away"),
        ("inport = {buffer = {}}", "is an empty table and says nothing", "take it away"),
    ],
)
def test_a_table_in_the_place_of_a_value_is_refused(write: Write, line: str, cause: str, remedy: str) -> None:
    path = write(with_option(line))
    (found,) = (one for one in check(path) if one.severity == "error")
    assert (found.line, found.cause, found.remedy) == (with_option(line).split("\n").index(line) + 1, cause, remedy)
    with pytest.raises(SystemFileError):
        load(path)


def test_what_openrtm_says_of_its_transports_is_told_once_by_check_and_by_a_kernel(
    write: Write, caplog: pytest.LogCaptureFixture
) -> None:
    """OpenRTM's tools write such keys for every connection."""
    first = 'dataport.interface_type = "corba_cdr"\noutport.buffer.write.full_policy = "block"'
    more = 'dataport.interface_type = "direct"\nbuffer.read.empty_policy = "readback"'
    text = with_option(first).replace('to = "sink.input"\n', f'to = "sink.input"\n{more}\n')
    path = write(text)
    (found,) = (one for one in check(path) if one.severity != "note")
    assert (found.severity, found.code, found.line) == (
        "warning",
        "W-TRANSPORT",
        text.split("\n").index(first[:37]) + 1,
    )
    keys = "dataport.interface_type, outport.buffer.write.full_policy, buffer.read.empty_policy"
    assert found.cause.startswith(f"{keys}: keys of OpenRTM's transports and backlogs")
    assert found.quote[found.column - 1 : found.column - 1 + found.width] == "interface_type"

    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(path))
            assert [one.profile.full for one in kernel.connectors.values()] == ["overwrite", "overwrite"]
            assert dict(kernel.connectors["source.out-middle.input"].profile.extra) == {
                "dataport.interface_type": "corba_cdr",
                "outport.buffer.write.full_policy": "block",
            }

    asyncio.run(main())
    told = [record.getMessage() for record in caplog.records if "W-TRANSPORT" in record.getMessage()]
    assert [line.partition(": keys of")[0].partition(": a key of")[0] for line in told] == [
        "W-TRANSPORT: source.out-middle.input: dataport.interface_type, outport.buffer.write.full_policy",
        "W-TRANSPORT: middle.output-sink.input: buffer.read.empty_policy",
    ]


@pytest.mark.parametrize(
    "line",
    [
        'subscription = " Flush "',
        'dataport.serializer.cdr.endian = "little,big"',
        'dataport.buffer.read.timeout = "1.0"',
        'dataport.interface_option.ros.topic = "chatter"',
        'dataport.fsm_event_name = "go"',
        'port.port_type = "DataInPort"',
        "dataport.publisher.skip_count = 0",
        "outport.buffer.length = 4",
        "buffer = {length = 4}",
        'name = "wire-1"',
    ],
)
def test_a_key_of_openrtm_is_taken_without_a_word_and_built(write: Write, line: str) -> None:
    path = write(with_option(line))
    assert [one for one in check(path) if one.severity != "note"] == []

    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(path))

    asyncio.run(main())
