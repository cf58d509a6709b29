"""What runs is changed from another terminal: parameters, sets, connectors, components."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, InPort, Kernel, Param, PeriodicContext
from aiorts.composites import Composite
from aiorts.errors import DeniedError
from aiorts.sessions import Client
from aiorts.types import TimedLong, TimedPoint2D
from control_parts import Counter, Reader, commanded, controlled, with_client

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    """One loop is enough: what a command does passes through the socket."""
    return "asyncio"


async def test_parameters_are_in_force_when_conf_returns_read_by_their_types(
    capsys: pytest.CaptureFixture[str],
) -> None:
    async with controlled() as kernel:
        counter = kernel.components["counter0"]
        assert await commanded(capsys, "conf", "counter0", "step=2") == (0, "")
        assert counter.configuration.values["step"] == 2.0
        assert await commanded(capsys, "conf", "counter0", "--add", "fast", "fast.step=9", "--activate", "fast") == (
            0,
            "",
        )
        assert (counter.configuration.active, counter.configuration.values["step"]) == ("fast", 9.0)
        assert await commanded(capsys, "conf", "counter0", "default.step=3") == (0, "")
        assert (counter.configuration.values["step"], counter.configuration.sets["default"]["step"]) == (9.0, 3.0)
        status, text = await commanded(capsys, "conf", "counter0")
        assert (status, " ".join(text.split())) == (0, "unit/counter0 set fast of default, fast step 9.0 fast: 9.0")
        await kernel.create(Checked, "checked0")
        status, text = await commanded(capsys, "conf", "checked0", "high")
        assert (status, "high" in text, "low" in text) == (0, True, False), text
        status, text = await commanded(capsys, "conf", "checked0", "high", "--json")
        assert (status, [one["name"] for one in json.loads(text)["parameters"]]) == (0, ["high"])


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (["counter0", "step=much"], 2, "counter0.step = 'much': must be a float"),
        (["counter0", "step=-1", "default.nosuch=2"], 2, "nosuch"),
        (["counter0", "slow.step=1"], 6, "no set 'slow'; there are default"),
        (["counter0", "--add", "default"], 2, "already"),
        (["couter0"], 6, "did you mean counter0"),
        (["counter0", "stp"], 6, "stp: counter0 has no such parameter; did you mean step?"),
        (["counter0", "step", "step=2"], 2, "expected PARAM=VALUE"),
        (["counter0", "step", "--activate", "default"], 2, "expected PARAM=VALUE"),
        ([], 2, "say which component"),
    ],
)
async def test_conf_refuses_with_nothing_changed(
    capsys: pytest.CaptureFixture[str], words: list[str], status: int, text: str
) -> None:
    async with controlled() as kernel:
        found, text_ = await commanded(capsys, "conf", *words)
        assert (found, text in text_) == (status, True), text_
        assert dict(kernel.components["counter0"].configuration.sets) == {"default": {"step": 1.0}}


class Checked(Component):
    low: float = Param(0.0)
    high: float = Param(1.0)

    def check_configuration(self, values: Mapping[str, Any]) -> None:
        if values["low"] >= values["high"]:
            raise ValueError("low has to be below high")


async def test_what_a_validator_refuses_is_not_in_force(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        checked = await kernel.create(Checked, "checked0")
        status, text = await commanded(capsys, "conf", "checked0", "low=5")
        assert (status, "low has to be below high" in text) == (2, True)
        assert await commanded(capsys, "conf", "checked0", "low=5", "high=6") == (0, "")
        assert dict(checked.configuration.values) == {"low": 5.0, "high": 6.0}


@pytest.mark.slow
async def test_a_configuration_is_dumped_and_loaded(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = str(tmp_path / "robot.toml")
    async with controlled() as kernel:
        counter = kernel.components["counter0"]
        assert await commanded(capsys, "conf", "--dump", file) == (0, "")
        await kernel.save_configuration(tmp_path / "same.toml")
        assert Path(file).read_text() == (tmp_path / "same.toml").read_text()
        assert (await commanded(capsys, "conf", "counter0", "step=7"))[0] == 0
        assert await commanded(capsys, "conf", "--load", file) == (0, "")
        assert counter.configuration.values["step"] == 1.0
        large = "".join(f"# {number} {'ä' * 60}\n" for number in range(2_000))
        Path(file).write_text(f"{large}schema = 1\n[components.counter0.sets.default]\nstep = 2.0\n")
        assert await commanded(capsys, "conf", "--load", file) == (0, "")
        assert counter.configuration.values["step"] == 2.0
        Path(file).write_text("schema = 1\n[components.nosuch]\n")
        status, text = await commanded(capsys, "conf", "--load", file)
        assert (status, "robot.toml:2" in text, "no such component" in text) == (2, True, True)


async def test_connectors_are_made_with_options_and_ended(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        status, text = await commanded(capsys, "con")
        assert (status, "counter0.out-reader0.in" in text, "delivered" in text) == (0, True, True)
        assert await commanded(capsys, "dis", "counter0.out", "reader0.in") == (0, "")
        assert kernel.connectors == {}
        status, text = await commanded(capsys, "con", "counter0.out", "reader0.in", "length=4", "--full", "reject")
        assert (status, "reader0.in: length 4, full reject" in text) == (0, True), text
        (profile,) = [one.profile for one in kernel.connectors.values()]
        assert (profile.length, profile.full) == (4, "reject")
        assert await commanded(capsys, "dis", "counter0.out-reader0.in") == (0, "")
        assert kernel.connectors == {}


async def test_each_connector_of_one_call_has_its_own_two_ports(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        await kernel.disconnect(kernel.connectors["counter0.out-reader0.in"])
        await kernel.create(type(kernel.components["reader0"]), "reader1")
        await kernel.connect("counter0.out", "reader0.in", "reader1.in")
        status, text = await commanded(capsys, "con", "counter0", "--json")
        assert [one["ports"] for one in json.loads(text)["kernels"][0]["connectors"]] == [
            ["counter0.out", "reader0.in"],
            ["counter0.out", "reader1.in"],
        ], text
        status, text = await commanded(capsys, "con", "reader1.in")
        assert (status, "  reader1.in: length 8" in text, "reader0.in" in text) == (0, True, False), text
        assert await commanded(capsys, "dis", "reader1.in") == (0, "")
        assert list(kernel.connectors) == ["counter0.out-reader0.in"]


class Shorter(Component):
    """Takes whole numbers, and two fields."""

    whole = InPort(TimedLong)
    point = InPort(TimedPoint2D)


async def test_with_adapt_a_filter_is_put_between_and_shown(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        shorter = await kernel.create(Shorter, "shorter")
        status, text = await commanded(capsys, "con", "counter0.out", "shorter.whole", "--adapt")
        assert (status, "shorter is in no context" in text) == (2, True), text
        await kernel.contexts["loop"].add(shorter)
        status, text = await commanded(capsys, "con", "counter0.out", "shorter.whole", "--adapt", "length=2")
        assert status == 0, text
        assert "  shorter.whole: length 2" in text
        assert "  counter0_to_shorter_whole.input0: length 2" in text
        filter_ = "through counter0_to_shorter_whole: FlexiFilter -i TimedDouble -o TimedLong -m '0>0'"
        assert text.endswith(f"  {filter_}\n")
        assert "counter0_to_shorter_whole" in (await commanded(capsys, "ls"))[1]
        status, text = await commanded(capsys, "con", "counter0.out", "shorter.point", "--adapt")
        assert (status, "types differ" in text) == (2, True), text
        status, text = await commanded(capsys, "con", "counter0.out", "reader0.in", "adapt=true", "allow_duplicate=1")
        assert (status, "through" in text) == (0, False), text


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (["con", "counter0.out", "reader0.in", "lenght=4"], 2, "did you mean 'length'"),
        (["con", "counter0.out", "reader0.im"], 6, "has no such port; there are in"),
        (["con", "counter0.out", "counter0.out"], 2, "at least one out-port and one in-port"),
        (["con", "counter0.out", "reader0.in", "length=4", "--length", "5"], 2, "given twice"),
        (["dis", "counter0"], 0, ""),
        (["dis", "reader1"], 6, "did you mean reader0"),
        (["exit", "reader9"], 6, "did you mean reader0"),
        (["comp", "add", "reader0", "counter0"], 2, "is no composite but a Reader"),
        (["comp", "create", "NoSuchType"], 6, "E-UNKNOWN-TYPE: no component named 'NoSuchType'"),
        (["comp", "create", "no_such_file.py:One"], 6, "no_such_file.py:One': no file 'no_such_file.py'"),
        (["comp", "create", "no_such.module:One"], 6, "E-UNKNOWN-TYPE: no module named 'no_such'"),
        (["comp", "create", "asyncio.nothing:One"], 6, "E-UNKNOWN-TYPE: asyncio.nothing:One: no module named"),
        (["comp", "create", "aiorts.testing:One"], 6, "E-UNKNOWN-TYPE: aiorts.testing:One: there is no 'One'"),
        (["comp", "create", "aiorts.testing:simulated"], 2, "E-PLUGIN: "),
    ],
)
async def test_wrong_words_are_told(
    capsys: pytest.CaptureFixture[str], words: list[str], status: int, text: str
) -> None:
    async with controlled():
        found, text_ = await commanded(capsys, *words)
        assert (found, text in text_) == (status, True), text_


async def test_no_connector_between_two_kernels_without_links(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled("one"), Kernel(services={"control": {"name": "two"}}) as kernel:
        await kernel.create(Reader, "other0")
        status, text = await commanded(capsys, "con", "counter0.out", "other0.in")
        assert (status, "two/other0.in: links of other kernels cannot reach two" in text) == (2, True)
        assert "give it a [links] table" in text
        status, text = await commanded(capsys, "dis", "counter0.out", "other0.in")
        assert (status, "links of other kernels cannot reach two" in text) == (2, True)


async def test_components_come_and_go(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "source.py").write_text(
        "from aiorts import Component, Param\n\n\nclass Source(Component):\n    top: int = Param(1)\n"
    )
    async with controlled() as kernel:
        kind = f"{tmp_path}/source.py:Source"
        status, text = await commanded(
            capsys, "comp", "create", kind, "unit/src", "top=0x10", "--context", "loop", "--json"
        )
        assert (status, json.loads(text)) == (0, {"done": [{"name": "unit/src"}]})
        source = kernel.components["src"]
        assert (source.configuration.values["top"], [one.name for one in source.contexts]) == (16, ["loop"])
        assert await commanded(capsys, "exit", "src") == (0, "")
        assert "src" not in kernel.components


async def test_members_of_a_composite_are_changed(capsys: pytest.CaptureFixture[str]) -> None:
    async with Kernel(services={"control": {"name": "group"}}) as kernel:
        for name in ("a", "b"):
            await kernel.create(Counter, name)
        both = await kernel.add(Composite("both", "a"))
        assert await commanded(capsys, "comp", "add", "both", "b") == (0, "")
        assert [one.name for one in both.members] == ["a", "b"]
        assert await commanded(capsys, "comp", "drop", "both", "a") == (0, "")
        assert [one.name for one in both.members] == ["b"]


async def test_paths_need_the_right_to_read_code() -> None:
    from aiorts.control.operation import Right
    from aiorts.control.operations import OPERATIONS
    from aiorts.model.reading import from_plain

    def needed(name: str, **arguments: object) -> Right:
        row = OPERATIONS[name]
        return row.needed(from_plain(row.arguments, arguments))

    assert needed("create", type="FlexiDump") is Right.OPERATE
    assert needed("create", type="a.py:B") is needed("create", type="os:B") is Right.CODE
    ports = ["a.out", "b.in"]
    assert needed("connect", ports=ports, options={"convert": "degrees"}) is Right.OPERATE
    assert needed("connect", ports=ports, options={"convert": "a.py:f"}) is Right.CODE
    assert needed("connect", ports=ports, options={"openrtm": {"convert": "a.py:f"}}) is Right.CODE


async def test_who_may_only_look_changes_nothing() -> None:
    async with controlled("looks", mode="view") as kernel:

        def ask(client: Client) -> None:
            assert client.call("configuration", component="counter0")["active"] == "default"
            for name, given in (
                ("configure", {"component": "counter0"}),
                ("disconnect", {"at": ["counter0"]}),
                ("remove", {"components": ["counter0"]}),
            ):
                with pytest.raises(DeniedError, match=name):
                    client.call(name, **given)

        await with_client("looks", ask)
        assert (len(kernel.components), len(kernel.connectors)) == (2, 1)


class Slow(Component):
    step: float = Param(1.0)
    released: asyncio.Event

    async def on_deactivated(self) -> None:
        await self.released.wait()


async def test_a_kernel_that_closes_changes_nothing_more(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        slow = await kernel.create(Slow, "slow0")
        slow.released = asyncio.Event()
        await kernel.start(PeriodicContext(rate=10.0), slow, activate=True)
        closing = asyncio.ensure_future(kernel.aclose())
        await kernel.closing
        for words in (("comp", "create", "FlexiDump"), ("con", "counter0.out", "reader0.in"), ("exit", "reader0")):
            status, text = await commanded(capsys, *words)
            assert (status, "E-ABSENT" in text) == (6, True), text
        slow.released.set()
        await closing
    assert (await commanded(capsys, "conf", "slow0"))[0] == 6
