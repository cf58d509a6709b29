"""Sets, composites, supervision and start in a system file: each mistake is named with its place before it runs."""

from __future__ import annotations

import asyncio
import tomllib
from collections.abc import Callable
from pathlib import Path

import jsonschema
import pytest

from aiorts import Catalogue, Composite, Kernel, LifecycleState, StartRule, Supervision
from aiorts.diagnostics.loop_monitor import LoopLimit
from aiorts.errors import AiortsError
from aiorts.system import Finding, build, check, graph, load, prepare, schema, wait_finished, wanted
from aiorts.testing import simulate
from system_parts import CHAIN, TABLES

Write = Callable[..., Path]
VALIDATOR = jsonschema.Draft202012Validator(schema(Catalogue()))


def changed(old: str, new: str, text: str = TABLES) -> str:
    assert old in text
    return text.replace(old, new, 1)


def marked(one: Finding) -> str:
    return one.quote[one.column - 1 : one.column - 1 + one.width]


def test_the_tables_are_read_as_the_values_that_python_code_would_give(write: Write) -> None:
    system = load(write(TABLES))
    source = system.components["source"]
    assert source.active == "slow"
    assert source.sets == {"slow": {"rate_limit": 2}}
    assert source.supervision == Supervision("reset", backoff=0.5, budget=3, deadlines={"on_execute": 0.1})
    assert source.start == StartRule("source", after=("arm active", "sink"), wait=0.25)
    assert system.composites["arm"].errors == "isolate"
    assert system.composites["hand"].members == ("two",)
    assert prepare(system).services["watch_loop"].settings == LoopLimit(2.0, "exit")
    assert prepare(system).settings["source"].sets == {"slow": {"rate_limit": 2}}


def test_a_good_file_has_nothing_to_be_said_of(write: Write) -> None:
    assert check(write(TABLES)) == ()
    assert list(VALIDATOR.iter_errors(tomllib.loads(TABLES))) == []


WRONG = [
    ("rate_limit = 2", "rate_limt = 2", "rate_limt", "source.rate_limt: no such parameter; did you mean rate_limit?"),
    ("rate_limit = 2", "rate_limit = 20", "20", "source.rate_limit = 20: must be <= 10"),
    ('"slow"', '"slwo"', '"slwo"', "source: no set 'slwo'; did you mean slow?"),
    ("sets.slow.", "sets.default.", "default", "the set 'default' is what params says; write it under params"),
    ("sets.slow.", "sets._slow.", "_slow", "names that begin with '_' are not for configuration sets"),
    ("sets.slow.rate_limit = 2", "sets.slow = 2", "2", "expected a table of parameters, got 2"),
    ('active = "slow"', "active = 3", "3", "expected text, got 3"),
    ('restart = "reset"', 'restart = "rest"', '"rest"', "'rest': expected one of never, reset, restart"),
    ("backoff = 0.5", "backof = 0.5", "backof", "unknown key 'backof'; did you mean 'backoff'?"),
    ("backoff = 0.5", "backoff = -1", "-1", "-1: expected seconds above 0"),
    ("backoff = 0.5", "backoff = 40", "supervision", "backoff_max = 30.0: is less than backoff = 40"),
    ("budget = 3", "budget = 1.5", "1.5", "1.5: expected a whole number from 0 to 1000000"),
    ("{on_execute = 0.1}", "0.1", "0.1", "expected a table of seconds by hook, got 0.1"),
    ("{on_execute", "{on_exec", "{on_exec = 0.1}", "deadlines: no hook 'on_exec' that a context runs"),
    ('restart = "reset"\nbackoff = 0.5', "backoff = 0.5", "0.5", None),
    ('"sink"]\n', '"snik"]\n', '"snik"', "unknown component 'snik'; did you mean 'sink'?"),
    ('"arm active"', '"arm running"', '"arm running"', "condition 'arm running': expected a component and one of"),
    ('"sink"]\nwait', '"source"]\nwait', '"source"', "cannot wait for itself (source active)"),
    ("wait = 0.25", "wiat = 0.25", "wiat", "unknown key 'wiat'; did you mean 'wait'?"),
    ("wait = 0.25", 'wait = "1"', '"1"', "'1': expected seconds from 0 on"),
    ('["one", "hand"]', '["one", "hnad"]', '"hnad"', "unknown component 'hnad'; did you mean 'hand'?"),
    ('["one", "hand"]', '["one", "one", "hand"]', '"one"', "'one' stands there twice"),
    ('members = ["two"]', 'members = ["two", "one"]', '"one"', "'one' is a member of arm already; take it away"),
    (
        'members = ["two"]',
        'members = ["two", "arm"]',
        '["one", "hand"]',
        "a member of itself: arm -> hand -> arm",
    ),
    ("[composites.hand]", "[composites.sink]", "sink", "there is a component 'sink'; choose another name"),
    ("[composites.hand]", "[composites.ha+nd]", None, None),
    ('"one.input" =', '"won.input" =', '"won.input"', "unknown member 'won'; did you mean 'one'?"),
    ('"one.input" =', '"one.inptu" =', '"command"', "no member has a port 'one.inptu'; did you mean 'one.input'?"),
    ('"one.input" =', '"input" =', '"command"', "exported 'input': expected component.port, each may hold * and ?"),
    ('= "command"', '= "a.b"', '"a.b"', "exported 'one.input': "),
    ('= "{component}_{port}"', '= "{name}"', '"{name}"', "only {component} and {port} can be filled in"),
    ('= "{component}_{port}"', '= "same"', None, "would both be exported as 'same'"),
    ('errors = "isolate"', 'errors = "isolat"', '"isolat"', "unknown errors 'isolat'; did you mean 'isolate'?"),
    ('order = "dataflow"', 'order = "flow"', '"flow"', "unknown order 'flow'; did you mean 'dataflow'?"),
    ('errors = "isolate"', "own_schedule = 1", "1", "expected true or false, got 1"),
    ('errors = "isolate"', 'groups = "one|hnd"', '"one|hnd"', "'one|hnd': hnd: no member"),
    ('errors = "isolate"', 'groups = "one"', '"one"', "'one': hand: in no group"),
    ('errors = "isolate"', "groups = 1", "1", 'expected a text such as "a,b|c,d", or lists of names, got 1'),
    ('errors = "isolate"', 'erors = "isolate"', "erors", "unknown key 'erors'; did you mean 'errors'?"),
    ('"arm.command"', '"arm.comand"', '"arm.comand"', "arm has no port 'comand'; did you mean 'command'?"),
    ('"arm.hand_output"', '"amr.hand_output"', '"amr.hand_output"', "unknown component 'amr'; did you mean 'arm'?"),
    ('["source"]', '["source", "two"]', '"two"', "'two' runs in loop already, as a part of arm; take it away here"),
    ('["source"]', '["source", "arm"]', '"arm"', "'arm' runs in loop already; a composite is in one context"),
    ('["source"]', '["source", "hand"]', '"hand"', "'hand' is a member of arm and runs with it; give it own_schedule"),
    ("limit = 2\n", "limit = 0\n", "0", "expected seconds above 0, such as 5.0, got 0"),
    ('policy = "exit"', 'policy = "exti"', '"exti"', "unknown policy 'exti'; did you mean 'exit'?"),
    ("[watch_loop]", "[watchloop]", "watchloop", "unknown key 'watchloop'; did you mean 'watch_loop'?"),
]


@pytest.mark.parametrize(
    ("old", "new", "mark", "said"), [row for row in WRONG if row[3] is not None], ids=lambda text: str(text)[:30]
)
def test_each_mistake_is_named_with_its_place(write: Write, old: str, new: str, mark: str | None, said: str) -> None:
    path = write(changed(old, new))
    errors = [one for one in check(path) if one.severity == "error" and said in one.message]
    assert len(errors) == 1, check(path)
    assert mark is None or marked(errors[0]) == mark


@pytest.mark.parametrize(
    ("old", "new", "said"), [(old, new, said) for old, new, _, said in WRONG if said is not None], ids=str
)
def test_what_check_refuses_is_not_built_either(write: Write, old: str, new: str, said: str) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(write(changed(old, new))))

    with pytest.raises(AiortsError, match=r"system\.toml"):
        asyncio.run(main())


def test_a_table_that_says_nothing_is_refused(write: Write) -> None:
    path = write(changed('restart = "reset"\n', "").replace("deadlines = {on_execute = 0.1}\n", ""))
    assert [one.message for one in check(path)] == [
        'says nothing that is done; write restart = "reset" or "restart", or a deadline'
    ]


@pytest.mark.slow
def test_a_member_that_is_restarted_stays_in_its_composite_with_its_set(write: Write) -> None:
    frail = 'type = "frail.py:Frail"\nsupervision.restart = "restart"\nactive = "stiff"\nsets.stiff.gain = 3.0\n'
    path = write(changed('[components.two]\ntype = "parts.py:Middle"\n', f"[components.two]\n{frail}"))
    (path.parent / "frail.py").write_text(
        "from aiorts import Component, InPort, OutPort, Param\n"
        "from aiorts.types import TimedLong\n"
        "class Frail(Component):\n"
        "    input, output, gain = InPort(TimedLong), OutPort(TimedLong), Param(1.0)\n"
        "    broken = False\n"
        "    def on_execute(self):\n"
        "        if not Frail.broken:\n"
        "            Frail.broken = True\n"
        "            raise ValueError('once')\n"
    )
    assert check(path) == ()

    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(path))
            await kernel.sleep(5.0)
            two, hand = kernel.components["two"], kernel.components["hand"]
            assert type(two).broken  # type: ignore[attr-defined]
            assert isinstance(hand, Composite)
            assert hand.members == (two,)
            assert (two.state, two.configuration.active) == (LifecycleState.ACTIVE, "stiff")
            assert two.configuration.values["gain"] == 3.0

    simulate(main())


def test_rules_that_wait_for_each_other_are_named(write: Write) -> None:
    text = changed("[components.sink]\n", '[components.sink]\nstart.after = "source"\n')
    errors = [one for one in check(write(text)) if one.severity == "error"]
    assert [one.cause for one in errors] == ["wait for each other, and none can be first: source -> sink -> source"]


def test_a_composite_in_no_context_and_a_pattern_that_nothing_fits_are_warnings(write: Write) -> None:
    found = check(write(changed('["arm", "sink"]', '["sink"]').replace('"arm active"', '"arm added"')))
    assert [(one.severity, one.code, one.where) for one in found] == [("warning", "W-UNUSED", "composites.arm")]
    found = check(write(changed('["two.*"]', '["two.*", "*.speed"]')))
    assert [(one.code, marked(one)) for one in found] == [("W-EXPORT", '"*.speed"')]


def test_a_port_that_a_composite_shows_is_connected_once(write: Write) -> None:
    twice = TABLES + '[[connections]]\nfrom = "arm.hand_output"\nto = "sink.input"\n'
    direct = TABLES + '[[connections]]\nfrom = "two.output"\nto = "sink.input"\n'
    for text in (twice, direct):
        errors = [one for one in check(write(text)) if one.severity == "error"]
        assert ["connected already, by connections[3]" in one.cause for one in errors] == [True]
        with pytest.raises(AiortsError, match=r"connected already, by connections\[3\]"):
            wanted(load(write(text)))  # what `aiorts plan` and `apply` read a file by


def test_a_set_is_checked_on_the_command_line_too(write: Write) -> None:
    path = write(TABLES)
    assert check(path, ["source.active=default"]) == ()
    assert [one.message for one in check(path, ["one.active=stif"])] == ["one: no set 'stif'; did you mean stiff?"]
    assert prepare(load(path, ["one.active=stiff"])).settings["one"].active == "stiff"


def test_what_the_command_line_sets_is_in_force_though_the_set_says_otherwise(write: Write) -> None:
    setting = prepare(load(write(TABLES), ["source.rate_limit=7"])).settings["source"]
    assert setting.sets == {"slow": {"rate_limit": 7}}
    other = prepare(load(write(TABLES), ["source.rate_limit=7", "source.active=default"])).settings["source"]
    assert (other.params["rate_limit"], other.sets["slow"]) == (7, {"rate_limit": 2})


@pytest.mark.parametrize(
    "method",
    [
        "    def ports_for(self, values):\n        return {'output2': OutPort(TimedLong)}\n",
        "    def on_initialize(self):\n        self.make_ports()\n"
        "    def make_ports(self):\n        self.add_port('output2', OutPort(TimedLong))\n",
    ],
)
def test_a_class_that_makes_ports_itself_is_not_judged_by_what_it_declares(write: Write, method: str) -> None:
    text = CHAIN.replace("parts.py:Middle", "more.py:Grown").replace("middle.output", "middle.output2")
    path = write(text)
    (path.parent / "more.py").write_text(
        "from aiorts import Component, InPort, OutPort\n"
        "from aiorts.types import TimedLong\n"
        "class Grown(Component):\n"
        "    input = InPort(TimedLong)\n"
        "    output = OutPort(TimedLong)\n"
        f"{method}"
    )
    assert [one for one in check(path) if one.severity == "error"] == []
    prepare(load(path))


@pytest.mark.parametrize(
    ("form", "parts"),
    [
        ("mermaid", ('subgraph g0_0["arm: composite, isolate"]', 'subgraph g0_0_0["hand: composite, dataflow"]')),
        ("dot", ('label="arm: composite, isolate";', "subgraph cluster_0_0_0 {")),
        ("svg", (">arm: composite, isolate</text>", ">hand: composite, dataflow</text>")),
    ],
)
def test_composites_are_boxes_of_a_drawing_and_arrows_go_to_the_members_own_ports(
    write: Write, form: str, parts: tuple[str, ...]
) -> None:
    drawn = graph(load(write(TABLES)), form)
    assert all(part in drawn for part in parts)
    arrows = {"mermaid": drawn.count("-->"), "dot": drawn.count(" -> "), "svg": drawn.count('class="wire"')}
    assert arrows[form] == 3
    if form == "svg":
        assert "source.out → one.input" in drawn
    if form == "mermaid":
        assert drawn.count("subgraph") == drawn.count("  end\n") == 4


FED_INSIDE = """\
schema = 1
[components.source]
type = "few.py:Few"
[components.middle]
type = "parts.py:Middle"
[components.sink]
type = "parts.py:Sink"
[composites.head]
members = ["source", "middle"]
exported = ["middle.output"]
[[connections]]
from = "source.out"
to = "middle.input"
[[connections]]
from = "head.output"
to = "sink.input"
subscription = "new"
push = "new"
[contexts.loop]
kind = "periodic"
rate = 100.0
members = ["head"]
"""


def test_a_composite_is_no_source_that_is_waited_for_beside_its_members(write: Write) -> None:
    path = write(FED_INSIDE)
    (path.parent / "few.py").write_text(
        "from aiorts import Component, OutPort\n"
        "from aiorts.types import TimedLong\n"
        "class Few(Component):\n"
        "    out = OutPort(TimedLong)\n"
        "    def on_execute(self):\n"
        "        self.out.write_nowait(TimedLong(0, 1))\n"
        "        self.finish()\n"
    )

    async def main() -> bool:
        async with Kernel() as kernel:
            await build(kernel, load(path))
            ending = asyncio.ensure_future(wait_finished(kernel))
            await kernel.sleep(10.0)
            done = ending.done()
            ending.cancel()
            await asyncio.wait([ending])
            return done

    assert simulate(main())
