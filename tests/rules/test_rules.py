"""Rules connect ports by pattern and type as they come; a saved system has the rule and not its connectors."""

from __future__ import annotations

import asyncio
import random
from pathlib import Path

import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.errors import ConfigurationError, SystemFileError
from aiorts.system import build, check, load, parse, system_text, wanted
from aiorts.types import TimedDouble, TimedLong

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    """One loop is enough: connecting knows no time."""
    return "asyncio"


class Source(Component):
    pose = OutPort(TimedDouble)
    count = OutPort(TimedLong)


class Logger(Component):
    poses = InPort(TimedDouble)
    counts = InPort(TimedLong)


class Both(Component):
    pose = OutPort(TimedDouble)
    poses = InPort(TimedDouble)


async def settled() -> None:
    for _ in range(3):
        await asyncio.sleep(0)


def ruled(*rules: dict[str, object]) -> Kernel:
    return Kernel(services={"rules": {"rules": list(rules)}})


ANY = {"from": "*.pose", "to": "log*.*"}
PARTS = """
from aiorts import Component, InPort, OutPort
from aiorts.types import TimedDouble

class Source(Component):
    pose = OutPort(TimedDouble)

class Logger(Component):
    poses = InPort(TimedDouble)
"""
FILE = """schema = 1

[[rules]]
from = "*.pose"
to = "logger.*"
max = 20
length = 3

[components.a]
type = "parts.py:Source"

[components.b]
type = "parts.py:Source"

[components.logger]
type = "parts.py:Logger"

[[connections]]
from = "a.pose"
to = "logger.poses"
length = 5

[contexts.loop]
kind = "event"
members = ["a", "b", "logger"]
"""


@pytest.mark.row(59)
async def test_ports_are_connected_by_pattern_and_type_as_they_come_and_go() -> None:
    async with ruled(ANY) as kernel:
        await kernel.create(Logger, "logger")
        for name in ("a", "b"):
            await kernel.create(Source, name)
        await settled()
        assert set(kernel.connectors) == {"a.pose-logger.poses", "b.pose-logger.poses"}
        await kernel.remove(kernel.components["a"])
        late = await kernel.create(Source, "late")
        await settled()
        assert set(kernel.connectors) == {"b.pose-logger.poses", "late.pose-logger.poses"}
        await late.pose.write(TimedDouble(data=2.0))
        assert (await kernel.components["logger"].poses.read()).data == 2.0


async def test_a_port_that_is_added_at_run_time_is_connected() -> None:
    async with ruled({"from": "a.*", "to": "logger.*"}) as kernel:
        await kernel.create(Logger, "logger")
        a = await kernel.create(Component, "a")
        await settled()
        assert not kernel.connectors
        a.add_port("more", OutPort(TimedLong))
        await settled()
        assert set(kernel.connectors) == {"a.more-logger.counts"}


async def test_without_rules_there_is_no_service() -> None:
    async with Kernel() as kernel:
        await kernel.create(Source, "a")
        assert "rules" not in {one.name for one in kernel.services}


async def test_what_is_ended_or_connected_by_hand_is_left_alone() -> None:
    async with ruled(ANY) as kernel:
        source, logger = await kernel.create(Source, "a"), await kernel.create(Logger, "logger")
        await settled()
        (connector,) = kernel.connectors.values()
        await kernel.disconnect(connector)
        await kernel.create(Source, "b")
        await settled()
        assert set(kernel.connectors) == {"b.pose-logger.poses"}
        own = await kernel.connect(source.pose, logger.poses, length=2)
        await kernel.create(Source, "c")
        await settled()
        assert logger.poses.connectors.count(own) == 1
        assert len(logger.poses.connectors) == 3


async def test_connectors_come_in_the_order_in_which_their_components_came() -> None:
    names = [f"s{number}" for number in (3, 1, 4, 15, 9, 2, 6, 5, 35, 8)]
    async with ruled(ANY) as kernel:
        for name in ("log1", "log0"):
            await kernel.create(Logger, name)
        for name in names:
            await kernel.create(Source, name)
        await settled()
        assert list(kernel.connectors) == [f"{name}.pose-{log}.poses" for name in names for log in ("log1", "log0")]


async def test_a_component_is_never_connected_with_itself() -> None:
    async with ruled({"from": "*.*", "to": "*.*"}) as kernel:
        for name in ("one", "two"):
            await kernel.create(Both, name)
        await settled()
        assert set(kernel.connectors) == {"one.pose-two.poses", "two.pose-one.poses"}


async def test_beyond_max_nothing_is_connected_and_it_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    async with ruled({**ANY, "max": 2}) as kernel:
        await kernel.create(Logger, "logger")
        for number in range(5):
            await kernel.create(Source, f"s{number}")
            await settled()
        assert len(kernel.connectors) == 2
        assert [one for one in caplog.messages if "raise max" in one] == [
            "W-RULES: rules[1] (*.pose to log*.*): has its 2 connectors, and more ports fit; raise max"
        ]
        await kernel.remove(kernel.components["s0"])
        await settled()
        assert set(kernel.connectors) == {"s1.pose-logger.poses", "s2.pose-logger.poses"}
        report = kernel.profile().services["rules"]
        assert report["rules[1] (*.pose to log*.*)"] == {"connectors": 2, "max": 2}


async def test_ports_that_do_not_go_together_are_named_once(caplog: pytest.LogCaptureFixture) -> None:
    class Far(Component):
        pose = OutPort(TimedDouble, unit="mm")

    class Near(Component):
        inp = InPort(TimedDouble, unit="m")

    async with ruled({"from": "*.pose", "to": "near.inp"}) as kernel:
        await kernel.create(Near, "near")
        for name in ("far", "farther"):
            await kernel.create(Far, name)
            await settled()
        assert not kernel.connectors
        assert sum("far.pose -> near.inp: units differ" in one for one in caplog.messages) == 1


@pytest.mark.parametrize(
    ("rule", "text"),
    [
        ({"to": "a.b"}, "rules: [1]: from is missing"),
        ({"from": "pose", "to": "a.b"}, "rules: [1].from: 'pose' is no pattern for ports; write COMPONENT.PORT"),
        ({"from": "*.[ab", "to": "a.b"}, "rules: [1].from: '*.[ab' is no pattern for ports"),
        ({"from": "*.pose", "to": 3}, "rules: [1].to: expected text, got 3"),
        ({**ANY, "max": 0}, "rules: [1].max: expected a whole number from 1 to 100000, got 0"),
        ({**ANY, "max": True}, "rules: [1].max: expected a whole number"),
        ({**ANY, "form": "x"}, "rules: [1].form: unknown key 'form'; did you mean 'from'?"),
        ({**ANY, "lenght": 3}, "rules: [1].lenght: unknown option 'lenght'"),
        ({**ANY, "length": -3}, "rules: [1].length: "),
        ({**ANY, "name": "x"}, "rules: [1].name: each connector of a rule has the name of its ports"),
    ],
)
def test_a_rule_that_is_wrong_is_refused_with_its_key(rule: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        ruled(rule)
    assert text in str(caught.value)


def test_in_a_file_the_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    file = tmp_path / "system.toml"
    file.write_text(FILE.replace("max = 20", "max = -1"))
    (finding,) = [one for one in check(file) if one.severity == "error"]
    assert (finding.line, finding.column) == (6, 7)
    assert "expected a whole number from 1 to 100000, got -1" in finding.message
    with pytest.raises(SystemFileError, match=r"system\.toml:6:7: rules\[1\]\.max: expected"):
        wanted(load(file))


def test_a_check_notes_no_open_port_that_a_rule_connects(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(PARTS + "    other = InPort(TimedDouble)\n")
    file = tmp_path / "system.toml"
    file.write_text(FILE.replace('to = "logger.*"', 'to = "logger.poses"'))
    assert [(one.where, one.message) for one in check(file) if one.code == "N-OPEN"] == [
        ("components.logger", "1 port has no connection: other (in TimedDouble)")
    ]


@pytest.mark.slow(kept_by="test_ports_are_connected_by_pattern_and_type_as_they_come_and_go")
async def test_a_file_and_a_plan_have_the_rule_and_not_its_connectors(tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    file = tmp_path / "system.toml"
    file.write_text(FILE)
    async with Kernel() as kernel:
        await build(kernel, load(file))
        await settled()
        lengths = {name: one.profile.length for name, one in kernel.connectors.items()}
        assert lengths == {"a.pose-logger.poses": 5, "b.pose-logger.poses": 3}
        described = wanted(load(file))
        assert (await kernel.apply(described, dry_run=True)).plan.empty
        await kernel.save(tmp_path / "saved.toml")
        text = (tmp_path / "saved.toml").read_text()
        assert text.count("[[connections]]") == text.count("[[rules]]") == 1
        assert system_text(wanted(load(tmp_path / "saved.toml")), tmp_path) == text
        more = FILE.replace(
            "[[connections]]", '[[connections]]\nfrom = "b.pose"\nto = "logger.poses"\n\n[[connections]]'
        )
        await kernel.apply(wanted(parse(more, file)))
        await settled()
        assert kernel.connectors["b.pose-logger.poses"].profile.length == 8
        less = FILE.replace('[components.b]\ntype = "parts.py:Source"\n', "").replace('"b", ', "")
        await kernel.apply(wanted(parse(less, file)))
        await settled()
        assert set(kernel.connectors) == {"a.pose-logger.poses"}
        await kernel.apply(described)
        await settled()
        assert set(kernel.connectors) == {"a.pose-logger.poses", "b.pose-logger.poses"}
        assert (await kernel.apply(described, dry_run=True)).plan.empty


@pytest.mark.parametrize("seed", range(12))
async def test_whatever_comes_and_goes_the_rules_hold(seed: int) -> None:
    dice = random.Random(seed)
    most = dice.choice([2, 5, 100])
    kinds = {"s": Source, "log": Logger, "both": Both}
    ended: set[tuple[str, str]] = set()
    async with ruled({**ANY, "max": most}, {"from": "both*.*", "to": "both*.*", "max": 100}) as kernel:
        for _ in range(60):
            names = list(kernel.components)
            match dice.randrange(5):
                case 0 | 1 | 2:
                    kind = dice.choice(list(kinds))
                    name = f"{kind}{dice.randrange(6)}"
                    if name not in kernel.components:
                        await kernel.create(kinds[kind], name)
                case 3 if names:
                    gone = dice.choice(names)
                    await kernel.remove(kernel.components[gone])
                    ended = {pair for pair in ended if gone not in pair}
                case 4 if kernel.connectors:
                    connector = dice.choice(list(kernel.connectors.values()))
                    await kernel.disconnect(connector)
                    writer, reader = (path.partition(".")[0] for path in connector.profile.ports)
                    ended.add((writer, reader))
            if dice.random() < 0.5:
                await settled()
        await settled()
        names = list(kernel.components)
        fit = {(w, r) for w in names if w[0] in "sb" for r in names if r.startswith("log")} - ended
        rings = {(w, r) for w in names for r in names if w != r and w[:4] == r[:4] == "both"} - ended
        found = [tuple(path.partition(".")[0] for path in one.profile.ports) for one in kernel.connectors.values()]
        assert len(found) == len(set(found))
        first = [pair for pair in found if pair[1].startswith("log")]
        assert set(first) <= fit
        assert len(first) == min(most, len(fit))
        assert {pair for pair in found if pair not in first} == rings
