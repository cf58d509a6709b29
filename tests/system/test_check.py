"""Everything that can be known of a system file without running it: all of it, with its place, and no hook runs."""

from __future__ import annotations

import asyncio
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aiorts import Kernel
from aiorts.errors import AiortsError, SystemFileError
from aiorts.system import Finding, build, check, check_text, load, prepare
from system_parts import CHAIN

ROOT = Path(__file__).parents[2]
Write = Callable[..., Path]


def found(path: Path, *severities: str) -> list[Finding]:
    return [one for one in check(path) if not severities or one.severity in severities]


def only(path: Path, *severities: str) -> Finding:
    findings = found(path, *severities)
    assert len(findings) == 1, findings
    return findings[0]


def changed(old: str, new: str, text: str = CHAIN) -> str:
    assert old in text
    return text.replace(old, new, 1)


def marked(one: Finding) -> str:
    """What the mark stands under."""
    return one.quote[one.column - 1 : one.column - 1 + one.width]


@pytest.mark.parametrize("name", ["hello", "roomba"])
def test_the_examples_are_clean(name: str) -> None:
    findings = check(ROOT / "examples" / name / "system.toml")
    assert [one for one in findings if one.severity != "note"] == []


def test_a_good_system_has_nothing_to_say_and_no_hook_of_it_runs(write: Write, tmp_path: Path) -> None:
    assert found(write(CHAIN)) == []
    assert not (tmp_path / "HOOK").exists()


@pytest.mark.parametrize(
    ("old", "new", "meant"),
    [
        ('from = "source.out"', 'form = "source.out"', "from"),
        ('to = "sink.input"', 'too = "sink.input"', "to"),
        ('kind = "event"', 'knd = "event"', "kind"),
        ('type = "parts.py:Sink"', 'typ = "parts.py:Sink"', "type"),
    ],
)
def test_a_misspelt_key_is_marked_once_where_it_stands_with_what_mends_it(
    old: str, new: str, meant: str, write: Write
) -> None:
    misspelt = new.partition(" ")[0]
    (one,) = [one for one in found(write(changed(old, new)), "error") if one.cause == f"unknown key {misspelt!r}"]
    assert (marked(one), one.where.rpartition(".")[2], one.mended) == (misspelt, misspelt, meant)
    assert not [other for other in found(write(changed(old, new))) if "is missing" in other.cause]


def test_all_mistakes_are_found_at_once_in_the_order_of_the_file(write: Write) -> None:
    text = changed("params.rate_limit = 3", "params.rate_limit = 30\nparams.rate_limt = 2")
    text = changed('type = "parts.py:Middle"', 'type = "parts.py:Midle"', text)
    text = changed("length = 4", "lenght = 4\nfull = 'blok'\npush_rate = -1", text)
    text = changed('to = "sink.input"', 'to = "sink.inptu"', text)
    text = changed("rate = 100.0", "overrun = 5\ndeadlin = 2", text)
    text = changed('["middle", "sink"]', '["middle", "snik"]\n[context.x]', text)
    findings = found(write(text))
    assert [(marked(one), one.severity) for one in findings] == [
        ("30", "error"),
        ("rate_limt", "error"),
        ('"parts.py:Midle"', "error"),
        ("lenght", "error"),
        ("'blok'", "error"),
        ("-1", "error"),
        ('"sink.inptu"', "error"),
        ("fast", "error"),
        ("5", "error"),
        ("deadlin", "error"),
        ('"snik"', "error"),
        ("context", "error"),
    ]
    hints = [one.remedy for one in findings]
    for hint, meant in ((1, "rate_limit"), (2, "Middle"), (3, "length"), (4, "block"), (6, "input"), (9, "deadline")):
        assert f"did you mean '{meant}'" in hints[hint].replace("mean rate_limit?", "mean 'rate_limit'?")
    assert "rate = 100.0" in hints[7]
    assert [one.line for one in findings] == sorted(one.line for one in findings)


def test_the_broken_roomba_says_what_is_wrong_where(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples" / "roomba", tmp_path / "roomba")
    path = tmp_path / "roomba" / "system.toml"
    text = path.read_text()
    for old, new in (
        ('"odometry.py:Odometry"', '"odometry.py:Odometri"'),
        ('params.path = "imu.txt"', 'params.paht = "imu.txt"'),
        ("0:2 > -0.017453292519943295 > 0", "0:7 > 1 > 0"),
        ("0:heading > 0:heading", "0:haeding > 0:heading"),
        ('to = "show.turn_rate"', 'to = "show.turnrate"'),
        ("rate = 200.0\n", ""),
    ):
        text = changed(old, new, text)
    path.write_text(text)
    errors = found(path, "error")
    assert [(one.code, marked(one)) for one in errors] == [
        ("E-CONFIG", "paht"),
        ("E-PLUGIN", '"odometry.py:Odometri"'),
        ("E-CONFIG", "0"),
        ("E-CONFIG", "0"),
        ("E-SYSTEM", '"show.turnrate"'),
        ("E-SYSTEM", "player"),
    ]
    # The mark in a map stands at its entry, in a text of several lines, too.
    assert errors[2].quote[errors[2].column - 1 :].startswith("0:haeding > 0:heading")
    assert errors[3].quote[errors[3].column - 1 :].startswith("0:7 > 1 > 0")
    assert "there is no such pin; the last one is 2" in errors[3].message
    assert "did you mean 'turn_rate'" in errors[4].remedy


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(78)
@pytest.mark.fault("F03")
def test_eighteen_of_twenty_typing_mistakes_get_the_right_hint(write: Write) -> None:
    typos = [
        ("[components.source]", "[componets.source]", "components"),
        ("[[connections]]", "[[conections]]", "connections"),
        ("[contexts.fast]", "[contxts.fast]", "contexts"),
        ("schema = 1\n", "schema = 1\n[plugin]\npath = []\n", "plugins"),
        ("schema = 1\n", "schema = 1\n[clok]\n", "clock"),
        ("schema = 1\n", "schema = 1\n[clock]\nkind = 'simulatd'\n", "simulated"),
        ('type = "parts.py:Sink"', 'typ = "parts.py:Sink"', "type"),
        ('type = "parts.py:Sink"', 'type = "parts.py:Snik"', "Sink"),
        ('type = "parts.py:Sink"', 'type = "part.py:Sink"', "parts.py"),
        ('type = "parts.py:Sink"', 'type = "FlexiFliter"', "FlexiFilter"),
        ("params.rate_limit", "param.rate_limit", "params"),
        ("params.rate_limit", "params.ratelimit", "rate_limit"),
        ("length = 4", "lengt = 4", "length"),
        ("length = 4", "subscription = 'nwe'", "new"),
        ("length = 4", "push_polcy = 'new'", "push"),
        ('from = "middle.output"', 'from = "midle.output"', "middle"),
        ('from = "middle.output"', 'from = "middle.ouptut"', "output"),
        ('kind = "periodic"', 'kind = "periodc"', "periodic"),
        ("rate = 100.0", "raet = 100.0", "rate"),
        ('["middle", "sink"]', '["middle", "snk"]', "sink"),
    ]
    right = 0
    for old, new, meant in typos:
        errors = found(write(changed(old, new)), "error")
        right += any(re.search(rf"did you mean '?{re.escape(meant)}\b", one.message) for one in errors)
    assert len(typos) == 20
    assert right >= 18


@pytest.mark.fault("F20")
@pytest.mark.parametrize(("version", "said"), [(0, "write the file for schema 1"), (2, "update aiorts")])
def test_another_version_of_the_format_says_which_one_is_read_and_nothing_else(
    write: Write, version: int, said: str
) -> None:
    one = only(write(changed("schema = 1", f"schema = {version}\n[future]\n")))
    assert (marked(one), one.remedy) == (str(version), said)
    assert f"version {version}, and this aiorts reads schema = 1 alone" in one.cause


# -- components --------------------------------------------------------------------------------------------------------


def flexi(line: str) -> str:
    return f'schema = 1\n[components.it]\n{line}\n[contexts.c]\nkind = "event"\nmembers = ["it"]\n'


@pytest.mark.parametrize(
    ("line", "mark", "said"),
    [
        ('type = "FlexiFilter"\nparams.inputs = ["TimedLong"]\nparams.outputs = ["TimedFoo"]', "T", "TimedFoo"),
        ('type = "FlexiFilter"\noptions = ["-i", "TimedLong", "-o", "TimedLong", "-m", "garbage"]', "g", "character 1"),
        ('type = "FlexiFilter"\noptions = "-i TimedLong -o TimedLong:3"', ":", "is no sequence"),
        ('type = "FlexiFilter"\noptions = ["-i", "TimedLong"]', '"FlexiFilter"', "outputs"),
        ('type = "FlexiFilter"\noptions = ["-x"]', '["-x"]', "no option '-x'"),
        ('type = "FlexiFilter"\noptions = ["--mapp", "0>0"]', '["--mapp", "0>0"]', "did you mean --map?"),
        ('type = "FlexiFilter"\noptions = ["-i"]', '["-i"]', "its value is missing"),
        ('type = "FlexiFilter"\noptions = ["--check"]', '["--check"]', "for a command line"),
        ('type = "FlexiFilter"\noptions = "-i \'x"', '"-i \'x"', "no closing quotation"),
        ('type = "FlexiFilter"\noptions = [true]', "true", "expected text or a number"),
        ('type = "FlexiConst"\noptions = ["-p", "TimedLong", "-c", "__import__"]', "_", "constant 0"),
        ('type = "FlexiDump"\nparams.inputs = []', "[]", "at least one in-port"),
        ('type = "FlexiSelect"\nparams.port = "TimedLong:2"\nparams.initial = 7', "7", "expected 0..1"),
    ],
)
def test_the_interface_that_parameters_state_is_checked_with_its_place(
    write: Write, line: str, mark: str, said: str
) -> None:
    one = only(write(flexi(line)), "error")
    assert said in one.message
    assert marked(one) == mark


def test_what_keeps_a_module_from_being_imported_is_said_once_with_the_line_of_the_field(write: Write) -> None:
    path = write(CHAIN)
    parts = path.parent / "parts.py"
    text = "from aiorts.types import record\n@record\nclass Bad:\n    tm: int = 0\n    level: float | str = 0.0\n"
    parts.write_text(text + parts.read_text().replace("from __future__ import annotations\n", ""))
    one = only(path, "error")
    assert one.where == "components.source.type"
    assert "Bad.level: float | str has more than one type" in one.message
    assert "parts.py:5)" in one.message


def test_a_wrong_parameter_hides_no_wrong_port(write: Write) -> None:
    text = changed('type = "parts.py:Middle"', 'type = "parts.py:Middle"\nparams.gain = 0.0', CHAIN)
    text = changed('to = "middle.input"', 'to = "middle.inptu"', text)
    said = [(one.where, one.remedy) for one in found(write(text), "error")]
    assert [where for where, _ in said] == ["components.middle.params.gain", "connections[1].to"]
    assert said[1][1] == "did you mean 'input'?"


def test_options_and_params_that_set_the_same_are_refused_naming_both(write: Write) -> None:
    text = flexi(
        'type = "FlexiFilter"\noptions = ["-i", "TimedLong", "-o", "TimedLong", "-m", "0>0"]\nparams.map = "0>2>0"'
    )
    one = only(write(text), "error")
    assert one.cause == "options (-m) and params.map both set map"
    with pytest.raises(AiortsError, match=r"options \(-m\) and params.map both set map"):
        prepare(load(write(text)))


@pytest.mark.fault("F04")
def test_an_unknown_type_names_the_nearest_and_what_is_installed(write: Write) -> None:
    one = only(write(flexi('type = "Zzz"')), "error")
    assert one.remedy.startswith("there are Awaiting, Broken, Dynamic, FlexiAdd, ")
    one = only(write(flexi('type = "flexifilter"')), "error")
    assert "did you mean FlexiFilter" in one.remedy


def test_a_plugin_that_does_not_load_and_a_class_that_is_not_constructed_are_findings(write: Write) -> None:
    path = write(flexi('type = "bad.py:It"'))
    (path.parent / "bad.py").write_text("x = 1\nraise SystemExit(4)\n")
    one = only(path, "error")
    assert one.code == "E-PLUGIN"
    assert "bad.py:It cannot be loaded: SystemExit: 4 (" in one.message
    assert "ValueError: not like this" in only(write(flexi('type = "parts.py:Broken"')), "error").message


def test_a_folder_with_a_link_that_leads_out_is_refused(write: Write, tmp_path: Path) -> None:
    outside = tmp_path.parent / f"{tmp_path.name}-outside"
    (outside / "pkg").mkdir(parents=True)
    (outside / "pkg" / "pyproject.toml").write_text(
        '[project]\nname = "p"\n[project.entry-points."aiorts.components"]\nFar = "far:Far"\n'
    )
    (outside / "pkg" / "far.py").write_text("raise SystemError('was run')")
    path = write(flexi('type = "Far"'))
    (tmp_path / "linked").symlink_to(outside / "pkg")
    one = only(path, "error")
    assert "leads out of the system file's folder" in one.message
    (tmp_path / "linked").unlink()
    shutil.copytree(outside / "pkg", tmp_path / "inside")
    (tmp_path / "inside" / "far.py").unlink()
    (tmp_path / "inside" / "far.py").symlink_to(outside / "pkg" / "far.py")
    assert "leads out of the system file's folder" in only(path, "error").message


# -- connections -------------------------------------------------------------------------------------------------------


def joined(out: str, in_: str, extra: str = "") -> str:
    return (
        f'schema = 1\n[components.a]\ntype = "parts.py:Metres"\n[components.b]\ntype = "parts.py:Takers"\n'
        f'[components.s]\ntype = "parts.py:Stated"\n'
        f'[[connections]]\nfrom = "{out}"\nto = "{in_}"\n{extra}'
        f'[contexts.c]\nkind = "event"\nmembers = ["a", "b", "s"]\n'
    )


@pytest.mark.parametrize(
    ("out", "in_", "entries"),
    [
        ("a.out", "b.whole", "0>0"),
        ("a.out", "b.mm", "0>1000>0"),
        ("a.out", "b.text", "0>0"),
        ("a.pose", "b.point", "0:position.x>0:x,0:position.y>0:y"),
        ("a.pose", "b.heading", "0:heading>0"),
        ("a.three", "b.velocity", "0:0>0:vx,0:1>0:vy,0:2>0:va"),
        ("a.any", "b.velocity", "0:0>0:vx,0:1>0:vy,0:2>0:va"),
        ("a.any", "b.heading", "0:0>0"),
    ],
)
def test_the_filter_that_would_join_two_ports_is_told_and_does(write: Write, out: str, in_: str, entries: str) -> None:
    text = joined(out, in_, 'subscription = "new"\ntimeout = inf\n')
    one = only(write(text), "error")
    assert one.code == "E-CONNECT"
    assert "differ" in one.cause
    assert f'"-m", "{entries}"]' in one.suggestion
    # Done as it says: the entry put in, the connection replaced, the filter in the context.
    entry, connections = one.suggestion.split("# in place of connections[1]\n")
    name = re.search(r"components\.(\w+)", entry)
    assert name is not None
    start, end = text.index("[[connections]]"), text.index("[contexts.c]")
    mended = text[:start] + entry + connections + text[end:].replace('"b",', f'"{name[1]}", "b",')
    path = write(mended)
    assert found(path, "error", "warning") == []
    assert mended.count('subscription = "new"\ntimeout = inf') == 2

    async def run() -> set[str]:
        async with Kernel() as kernel:
            await build(kernel, load(path))
            return set(kernel.connectors)

    assert asyncio.run(run()) == {f"{out}-{name[1]}.input0", f"{name[1]}.output0-{in_}"}


@pytest.mark.parametrize(
    ("out", "in_", "said"),
    [
        (
            "a.out",
            "b.volt",
            "units differ: a.out sends 'm', b.volt takes 'V'; declare one unit at both",
        ),
        ("a.three", "b.two", "shapes differ: a.three sends (3,), b.two takes (2,)"),
        ("a.out", "a.pose", "are out-ports"),
        ("a.pose", "b.strict", "types differ: a.pose sends TimedPose2D, b.strict takes "),
        ("a.out", "b.hole", "did you mean 'whole'?"),
        ("s.out7", "b.whole", "did you mean 'out"),
        ("s.nothing", "b.whole", "there are out0, out1"),
    ],
)
def test_ends_that_do_not_go_together_are_named(write: Write, out: str, in_: str, said: str) -> None:
    one = only(write(joined(out, in_)), "error")
    assert said in one.message
    assert ("FlexiFilter" in one.message) is said.startswith("types differ")
    assert one.suggestion == ""
    assert marked(one) in (f'"{out}"', f'"{in_}"')


@pytest.mark.parametrize(
    ("option", "value"), [("stamp", "send"), ("subscription", "periodic"), ("push", "skip"), ("stamp", "received")]
)
def test_what_only_the_writers_kernel_can_do_is_refused_where_the_reader_is(
    write: Write, option: str, value: str
) -> None:
    rate = "push_rate = 5.0\n" if value == "periodic" else ""
    errors = found(write(joined("plant/a.out", "b.whole", f'{option} = "{value}"\n{rate}')), "error")
    said = [f"{option} = {value}: the writer is in another kernel; connect them there"]
    assert [one.message for one in errors] == (said if value != "received" else [])


def test_a_connection_made_twice_and_one_the_wrong_way_round(write: Write) -> None:
    twice = joined("s.out0", "b.whole", '[[connections]]\nfrom = "s.out0"\nto = "b.whole"\n')
    assert "connected already, by connections[1]" in only(write(twice), "error").message
    with pytest.raises(SystemFileError, match=r"connections\[2\]: s.out0 and b.whole are connected already"):
        load(write(twice))
    assert only(write(joined("b.whole", "s.out0")), "warning").code == "W-TURNED"
    assert found(write(twice.replace('to = "b.whole"', 'to = "b.whole"\nallow_duplicate = true')), "error") == []


def test_a_stamp_needs_a_type_with_a_time(write: Write) -> None:
    text = changed("length = 4", 'stamp = "send"').replace("params.rate_limit = 3\n", "")
    text = text.replace("parts.py:Source", "parts.py:Mutable")
    errors = found(write(text), "error")
    assert [one.cause.partition(":")[0] for one in errors] == [
        "types differ",
        "source.out sends Loose, which has no field tm to put it in",
    ]


# -- the whole ---------------------------------------------------------------------------------------------------------


def test_who_is_in_no_context_and_which_ports_are_open_is_said(write: Write) -> None:
    findings = found(write(CHAIN + '[components.lone]\ntype = "parts.py:Middle"\n'))
    assert [(one.severity, one.code, one.where) for one in findings] == [
        ("warning", "W-UNUSED", "components.lone"),
        ("note", "N-OPEN", "components.lone"),
    ]
    assert "2 ports have no connection: input (in TimedLong), output (out TimedLong)" in findings[1].cause


BESIDE = """\
schema = 1
[components.source]
type = "parts.py:Source"
[components.one]
type = "parts.py:Middle"
[components.two]
type = "parts.py:Sink"
[[connections]]
from = "source.out"
to = "one.input"
length = 16
[[connections]]
from = "one.output"
to = "two.input"
full = "block"
timeout = inf
[contexts.a]
kind = "periodic"
rate = 10.0
members = ["source"]
[contexts.b]
kind = "event"
members = ["one", "two"]
"""


@pytest.mark.slow
@pytest.mark.row(38)
def test_a_rendezvous_within_one_context_or_composite_is_an_error(write: Write) -> None:
    meets = BESIDE.replace('full = "block"', "length = 0")
    one = only(write(meets))
    assert (one.code, one.severity) == ("E-CONNECT", "error")
    assert "would wait for a read that cannot begin before it is done: both run in b" in one.cause
    assert "run two in another context, or set length = 1 or more" in one.remedy
    alone = meets.replace('members = ["one", "two"]', 'members = ["one"]')
    assert found(write(alone + '[contexts.c]\nkind = "event"\nmembers = ["two"]\n'), "warning", "error") == []
    pair = '[composites.pair]\nmembers = ["one", "two"]\n'
    one = only(write(meets.replace('["one", "two"]', '["pair"]').replace("[contexts.a]", pair + "[contexts.a]")))
    assert "both run in b" in one.cause
    one = found(write(alone.replace('["one"]', "[]") + pair), "error")[0]
    assert "both are members of pair" in one.cause


PULLED = BESIDE.replace('full = "block"\ntimeout = inf', 'dataflow = "pull"').replace('["one", "two"]', '["one"]') + (
    '[contexts.c]\nkind = "event"\nmembers = ["two"]\n'
)


def test_a_component_on_events_that_pulls_all_it_reads_never_runs(write: Write) -> None:
    one = only(write(PULLED))
    assert (one.severity, one.code, marked(one)) == ("warning", "W-UNFED", '"pull"')
    assert "two runs on events, and what it reads is pulled" in one.cause
    assert "every = SECONDS" in one.remedy


@pytest.mark.parametrize(
    "more",
    [
        'every = 1.0\nmembers = ["two"]\n',
        'members = ["two"]\n[contexts.d]\nkind = "periodic"\nrate = 1.0\nmembers = ["two"]\n',
        'members = ["two"]\n[[connections]]\nfrom = "source.out"\nto = "two.input"\n',
    ],
)
def test_what_pulls_and_is_woken_by_something_else_is_none_of_those(write: Write, more: str) -> None:
    assert found(write(PULLED.replace('members = ["two"]\n', more)), "warning", "error") == []


CYCLE = """\
schema = 1
[components.one]
type = "parts.py:Middle"
[components.two]
type = "parts.py:Middle"
[[connections]]
from = "one.output"
to = "two.input"
[[connections]]
from = "two.output"
to = "one.input"
[contexts.a]
kind = "event"
members = ["one"]
[contexts.b]
kind = "event"
members = ["two"]
"""
MUTUAL = CYCLE.replace('to = "two.input"', 'to = "two.input"\nlength = 0\ntimeout = inf').replace(
    'to = "one.input"', 'to = "one.input"\nlength = 0\ntimeout = inf'
)


def test_components_that_wait_for_each_others_reads_are_a_warning(write: Write) -> None:
    paced = MUTUAL.replace('kind = "event"', 'kind = "periodic"\nrate = 10.0')
    one = only(write(paced))
    assert (one.severity, one.code, marked(one)) == ("warning", "W-BLOCK", "0")
    assert one.cause.startswith("one.output → two.input → two.output → one.input → one.output: length = 0 ")
    assert "or a timeout" in one.remedy
    assert found(write(paced.replace("timeout = inf", "timeout = 1.0", 1)), "warning", "error") == []
    assert found(write(paced.replace("length = 0", "length = 1", 1)), "warning", "error") == []


def test_a_writer_that_would_wait_for_its_own_context_is_a_warning(write: Write) -> None:
    one = only(write(BESIDE))
    assert (one.code, marked(one)) == ("W-BLOCK", '"block"')
    assert "one may have 16 samples to pass on and there is room for 8" in one.cause
    assert "length = 16 or more" in one.remedy


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("timeout = inf", "length = 16\ntimeout = inf"),
        ("timeout = inf", "timeout = 1.0"),
        ("length = 16", "length = 8"),
        ('members = ["one", "two"]', 'members = ["one"]\n[contexts.c]\nkind = "event"\nmembers = ["two"]'),
        ('full = "block"\n', ""),
    ],
)
def test_a_writer_that_has_room_a_timeout_or_another_context_is_not_warned_of(write: Write, old: str, new: str) -> None:
    assert found(write(changed(old, new, BESIDE))) == []


def test_a_mutable_type_is_a_note_and_so_are_ports_that_only_a_hook_makes(write: Write) -> None:
    notes = found(write(flexi('type = "parts.py:Mutable"')), "note")
    assert [one.code for one in notes] == ["N-OPEN", "N-COPY"]
    assert "each write makes one snapshot" in notes[1].cause
    text = changed('type = "parts.py:Sink"', 'type = "parts.py:Dynamic"').replace("sink.input", "sink.late")
    assert only(write(text)).code == "N-PORTS"


def test_ports_whose_samples_may_be_too_large_are_noted_where_they_become_bytes(write: Write) -> None:
    texts = flexi(
        'type = "FlexiFilter"\nparams.inputs = ["TimedDouble"]\nparams.outputs = ["TimedString", "TimedDoubleSeq:3"]'
    )
    assert "N-LIMITS" not in [one.code for one in found(write(texts), "note")]
    (note,) = [one for one in found(write(f'{texts}\n[record]\nfile = "run.mcap"\n'), "note") if one.code == "N-LIMITS"]
    assert "output0 (a text above 1 MiB)" in note.cause
    assert "output1" not in note.cause


def test_a_member_that_its_context_cannot_run_is_an_error(write: Write) -> None:
    text = flexi('type = "parts.py:Awaiting"').replace('kind = "event"', 'kind = "thread"')
    assert "on_execute is `async def`" in only(write(text), "error").message


def test_a_periodic_context_without_a_rate_says_so_when_run_too(write: Write) -> None:
    path = write(changed("rate = 100.0\n", ""))
    assert marked(only(path)) == "fast"
    with pytest.raises(AiortsError, match=r"system.toml:16:11: contexts.fast: a periodic context needs its rate in Hz"):
        prepare(load(path))


@pytest.mark.parametrize(("line", "said"), [("timing = 0", "true or false"), ('deadline = "1"', "a number")])
def test_a_key_of_a_context_takes_values_of_its_type_alone(write: Write, line: str, said: str) -> None:
    one = only(write(changed("rate = 100.0", f"rate = 100.0\n{line}")))
    assert marked(one) == line.partition(" = ")[2]
    assert f"expected {said}" in one.cause


def test_order_is_spelled_members(write: Write) -> None:
    one = only(write(changed('members = ["source"]', 'order = ["source"]')))
    assert (marked(one), one.remedy) == ("order", "write members = [...]")


def test_a_parameter_of_the_command_line_is_checked_too(write: Write) -> None:
    findings = check(write(CHAIN), ["sorce.rate_limit=2", "x", "source.rate_limit=11"])
    assert [(one.line, one.where) for one in findings] == [
        (0, "--set sorce.rate_limit=2"),
        (0, "--set 'x'"),
        (0, "--set source.rate_limit=11"),
    ]
    assert "did you mean 'source'" in findings[0].message
    assert "must be <= 10" in findings[2].message


def test_a_text_that_was_not_saved_is_checked_as_well(write: Write) -> None:
    path = write(CHAIN)
    text = changed("length = 4", "lenght = 4")
    assert [one.line for one in check_text(text, path)] == [12]
    assert check(path) == ()


def test_what_is_found_is_plain_data(write: Write) -> None:
    one = only(write(changed("length = 4", "lenght = 4")))
    plain: dict[str, Any] = one.plain()
    assert plain["line"] == 12
    assert plain["remedy"] == "did you mean 'length'?"
    assert one.place == f"{one.path}:12:1"


@pytest.mark.parametrize(("old", "new"), [("100.0", "15000.0\nmax_rate = 20000.0"), ("100.0", "20.0\nmax_rate = 50.0")])
def test_options_of_a_context_that_fit_together_are_taken_together(write: Write, old: str, new: str) -> None:
    assert found(write(changed(f"rate = {old}", f"rate = {new}")), "error") == []


@pytest.mark.parametrize(
    ("options", "marks"),
    [
        ("rate = 20.0\nmax_rate = 10.0", ["fast"]),
        ("rate = 20000.0", ["20000.0"]),
        ("rate = 20.0\noverrun = 'x'\ndeadline = -1.0", ["'x'", "-1.0"]),
    ],
)
def test_each_option_of_a_context_that_is_wrong_is_marked(write: Write, options: str, marks: list[str]) -> None:
    errors = found(write(changed("rate = 100.0", options)), "error")
    assert [marked(one) for one in errors] == marks


def test_a_wrong_every_of_an_event_context_is_marked(write: Write) -> None:
    one = only(write(changed('kind = "event"', 'kind = "event"\nevery = -1.0')), "error")
    assert (one.code, marked(one)) == ("E-CONFIG", "-1.0")


def test_a_context_with_an_argument_that_it_needs_may_have_others(write: Write, tmp_path: Path) -> None:
    (tmp_path / "lines.py").write_text(
        "from aiorts import EventContext\n\n"
        "class Line(EventContext):\n"
        "    def __init__(self, port: str, samples: int = 1, *, name: str = '') -> None:\n"
        "        super().__init__(name=name)\n"
        "        if samples < 1:\n"
        "            raise ValueError('no samples')\n"
    )
    (tmp_path / "pyproject.toml").write_text(
        '[project]\nname = "line"\n[project.entry-points."aiorts.contexts"]\nline = "lines:Line"\n'
    )
    text = changed('kind = "periodic"', 'kind = "line"')
    path = write(changed("rate = 100.0", "port = 'a'\nsamples = 2", text))
    assert [one for one in check(path, plugins=[tmp_path]) if one.severity == "error"] == []
    write(changed("rate = 100.0", "port = 'a'\nsamples = 0", text))
    (one,) = (one for one in check(path, plugins=[tmp_path]) if one.severity == "error")
    assert "no samples" in one.message
    write(changed("rate = 100.0", "samples = 2", text))
    (one,) = (one for one in check(path, plugins=[tmp_path]) if one.severity == "error")
    assert "'port'" in one.message


@pytest.mark.parametrize(("kind", "count"), [("periodic", 0), ("thread", 0), ("realtime", 1)])
def test_an_option_that_no_real_time_thread_has_is_found_where_it_stands(write: Write, kind: str, count: int) -> None:
    text = changed("length = 4", "lifespan = 0.5\nmax_gap = 1.0")
    findings = found(write(text.replace('kind = "event"', f'kind = "{kind}"\nrate = 10.0')))
    assert len(findings) == count
    for one in findings:
        assert (one.code, one.severity, one.where) == ("E-CONNECT", "error", "connections[1].lifespan")
        assert marked(one) == "lifespan"
        assert "middle runs in a realtime context" in one.cause
        assert one.remedy.startswith("take it away")
