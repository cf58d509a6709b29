"""System files: what is accepted, and that every mistake is named with its place before anything is created."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts.errors import SystemFileError
from aiorts.system import ClockEntry, load, parse
from campaign import cases

GOOD = """\
schema = 1
[components.pid0]
type = "pid.py:Pid"
params.gain = 2.0
[components.plant0]
type = "Plant"
[[connections]]
from = "pid0.command"
to = "plant0.input"
subscription = "new"
dataport.buffer.length = 4
timeout = inf
[contexts.loop]
kind = "periodic"
rate = 500.0
members = ["plant0", "pid0"]
"""
HERE = Path("system.toml")


def test_a_system_file_says_who_is_joined_how_and_run_by_whom() -> None:
    system = parse(GOOD, HERE, ["pid0.gain=3"])
    assert list(system.components) == ["pid0", "plant0"]
    assert system.components["pid0"].type == "pid.py:Pid"
    assert system.components["pid0"].params == {"gain": 2.0}
    connection = system.connections[0]
    assert connection.ports == ("pid0.command", "plant0.input")
    assert connection.options == {"subscription": "new", "dataport.buffer.length": 4, "timeout": None}
    context = system.contexts["loop"]
    assert (context.kind, context.members, context.activate) == ("periodic", ("plant0", "pid0"), True)
    assert context.options == {"rate": 500.0}
    assert [override.text for override in system.overrides] == ["pid0.gain=3"]


@pytest.mark.fault("F01")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("schema = ", "system.toml:1:"),
        ("schema = 1\nschema = 1\n", "system.toml:2:"),
        ("schema = 1\na = " + "[" * 100_000, "system.toml:2:"),
        ("schema = 1\n" + "a." * 20_000 + "b = 1", "system.toml:2:"),
        ("schema = 1\na = " + "1" * 5_000, "system.toml:2:5: a number of so many digits"),
        ("x = 1\n" * 500_000, "larger than"),
    ],
    ids=["syntax", "twice", "nested", "dotted", "digits", "large"],
)
def test_text_that_is_no_toml_is_refused_at_once(text: str, said: str) -> None:
    begun = time.monotonic()
    with pytest.raises(SystemFileError, match=said):
        parse(text, HERE)
    assert time.monotonic() - begun < 1.0


def test_a_byte_order_mark_is_no_mistake() -> None:
    assert parse("\ufeff" + GOOD, HERE).components


@pytest.mark.fault("F01")
def test_bytes_that_are_no_text_are_refused_with_their_line(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_bytes(b"schema = 1\n# caf\xe9\n")
    with pytest.raises(SystemFileError, match=r"s.toml:2:6: not UTF-8"):
        load(file)
    with pytest.raises(SystemFileError, match="cannot be read"):
        load(tmp_path / "missing.toml")
    with pytest.raises(SystemFileError, match="cannot be read"):
        load(tmp_path)


@pytest.mark.fault("F03")
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("schema = 1", "schema = 2", "this aiorts reads schema = 1 alone; update aiorts"),
        ("schema = 1", "scheme = 1", "schema"),
        ("[components.pid0]", "[component.pid0]", "did you mean 'components'"),
        ("[[connections]]", "[[connection]]", "did you mean 'connections'"),
        ("[contexts.loop]", "[context.loop]", "did you mean 'contexts'"),
        ('type = "Plant"', 'typ = "Plant"', "did you mean 'type'"),
        ('type = "Plant"', "type = 5", "expected text"),
        ("params.gain", "parms.gain", "did you mean 'params'"),
        ("params.gain = 2.0", "params = 2.0", "expected a table"),
        ('from = "pid0.command"', 'form = "pid0.command"', "unknown key 'form'; did you mean 'from'"),
        ('from = "pid0.command"', 'from = "pid.command"', "did you mean 'pid0'"),
        ('from = "pid0.command"', 'from = "pid0"', "names no port"),
        ('to = "plant0.input"', 'to = "plant.input"', "did you mean 'plant0'"),
        ('to = "plant0.input"', "to = []", "at least one port"),
        ('kind = "periodic"', 'kin = "periodic"', "kind"),
        ('members = ["plant0", "pid0"]', 'members = ["plant0", "pido"]', "did you mean 'pid0'"),
        ('members = ["plant0", "pid0"]', 'members = ["pid0", "pid0"]', "twice"),
        ('members = ["plant0", "pid0"]', 'members = "pid0"', "expected a list"),
        ("rate = 500.0", 'activate = "yes"', "expected true or false"),
        ("[components.plant0]", '[components."plant 0"]', "plant 0"),
    ],
)
def test_every_mistake_is_named_with_what_was_meant(old: str, new: str, said: str) -> None:
    assert old in GOOD
    with pytest.raises(SystemFileError, match=said) as caught:
        parse(GOOD.replace(old, new), HERE)
    assert str(caught.value).startswith("system.toml")


@pytest.mark.parametrize("text", ["gain=2", "pid0.gain", "=", ".gain=2", "pid0.=2", "pod0.gain=2"])
def test_a_bad_override_is_refused(text: str) -> None:
    with pytest.raises(SystemFileError, match="--set"):
        parse(GOOD, HERE, [text])


def test_plugins_that_are_no_table_are_named_with_what_to_write() -> None:
    with pytest.raises(SystemFileError, match=r'plugins: expected a table, got \[\]; write plugins.path = \["\."\]'):
        parse("plugins = []\nschema = 1\n", HERE)


def test_a_plugin_folder_outside_is_refused() -> None:
    with pytest.raises(SystemFileError, match="outside the system file's folder"):
        parse('schema = 1\n[plugins]\npath = [".."]\n', HERE)


@pytest.mark.parametrize(
    ("text", "clock"),
    [
        ("", ClockEntry("system")),
        ('[clock]\nkind = "system"\n', ClockEntry("system")),
        ('[clock]\nkind = "simulated"\n', ClockEntry("simulated")),
        ('[clock]\nkind = "scaled"\nspeed = 10\n', ClockEntry("scaled", 10.0)),
        ("[clock]\nspeed = 0.5\n", ClockEntry("scaled", 0.5)),
    ],
)
def test_a_system_says_how_time_passes(text: str, clock: ClockEntry) -> None:
    assert parse(GOOD + text, HERE).clock == clock


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('kind = "scale"', "did you mean 'scaled'"),
        ('kind = "scaled"', "speed is missing"),
        ('kind = "simulated"\nspeed = 2.0', 'only a clock of kind = "scaled" has a speed'),
        ("speed = 0", "expected a number above 0"),
        ("speed = inf", "expected a number above 0"),
        ("speed = nan", "expected a number above 0"),
        ("speed = true", "expected a number above 0"),
        ("spede = 2.0", "did you mean 'speed'"),
    ],
)
def test_a_clock_that_cannot_be_is_refused(text: str, said: str) -> None:
    with pytest.raises(SystemFileError, match=said):
        parse(f"{GOOD}[clock]\n{text}\n", HERE)


@pytest.mark.parametrize(
    ("written", "options"),
    [
        ('["-i", "TimedDouble", "-m", "0>1000>0"]', ("-i", "TimedDouble", "-m", "0>1000>0")),
        ("\"-i TimedDouble -m '0 > 1000 > 0'\"", ("-i", "TimedDouble", "-m", "0 > 1000 > 0")),
        ('["-r", 50, "-s", 2.5]', ("-r", "50", "-s", "2.5")),
        ("[]", ()),
    ],
)
def test_options_are_a_list_or_one_text(written: str, options: tuple[str, ...]) -> None:
    text = GOOD.replace('type = "Plant"', f'type = "Plant"\noptions = {written}')
    assert parse(text, HERE).components["plant0"].options == options


def test_only_a_time_out_may_be_for_ever() -> None:
    assert parse(GOOD.replace("= 4", "= inf"), HERE).connections[0].options["dataport.buffer.length"] == float("inf")


@pytest.mark.slow(kept_by="test_every_mistake_is_named_with_what_was_meant")
@pytest.mark.fault("F01")
@given(st.data())
@settings(max_examples=cases(10_000))
def test_no_change_to_a_file_gives_anything_but_a_system_or_a_named_error(data: st.DataObject) -> None:
    text = GOOD
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(len(text), start + 12)))
        text = text[:start] + data.draw(st.text(max_size=6)) + text[end:]
    try:
        parse(text, HERE)
    except SystemFileError as error:
        named = str(error).startswith("system.toml")
        assert named
