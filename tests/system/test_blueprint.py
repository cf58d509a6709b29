"""From a system file to a running system: what is made, in which order it is activated, and when it has ended."""

from __future__ import annotations

import asyncio
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import EventContext, Kernel, LifecycleState, PeriodicContext
from aiorts.errors import ConfigurationError, PluginError, SystemFileError, WiringError
from aiorts.system import SystemFile, build, is_source, load, prepare, wait_finished
from aiorts.testing import simulate

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.anyio

PARTS = """
from pathlib import Path
from aiorts import Component, InPort, OutPort, Param
from aiorts.types import TimedLong

activated = []

class Base(Component):
    def on_activated(self):
        activated.append(self.name)

class Source(Base):
    out = OutPort(TimedLong)
    count = Param(3)
    path = Param(Path("data.txt"))
    def on_execute(self):
        for n in range(self.count):
            self.out.write_nowait(TimedLong(0, n))
        self.finish()

class Middle(Base):
    input = InPort(TimedLong)
    out = OutPort(TimedLong)
    def on_execute(self):
        for sample in self.input.drain():
            self.out.write_nowait(sample)

class Sink(Base):
    input = InPort(TimedLong)
    def on_activated(self):
        super().on_activated()
        self.taken = []
    def on_execute(self):
        self.taken += [sample.data for sample in self.input.drain()]

class Deaf(Sink):
    def on_execute(self):
        pass

class Failing(Source):
    def on_execute(self):
        raise ValueError("no")

class Unmade(Base):
    def on_initialize(self):
        raise ValueError("not today")

class NotOne:
    pass
"""
CHAIN = """
schema = 1
[components.source]
type = "parts.py:Source"
[components.middle]
type = "parts.py:Middle"
[components.sink]
type = "parts.py:Sink"
[[connections]]
from = "source.out"
to = "middle.input"
[[connections]]
from = "middle.out"
to = "sink.input"
[contexts.a]
kind = "periodic"
rate = 100.0
members = ["source"]
[contexts.b]
kind = "event"
members = ["middle", "sink"]
"""


@pytest.fixture
def make(tmp_path: Path) -> Callable[..., SystemFile]:
    """Load a system file that stands beside the components above."""

    def make(text: str = CHAIN, *overrides: str) -> SystemFile:
        (tmp_path / "parts.py").write_text(PARTS)
        path = tmp_path / "system.toml"
        path.write_text(textwrap.dedent(text))
        return load(path, overrides)

    return make


async def test_it_makes_what_the_file_says_and_ends_when_all_was_taken(make: Callable[..., SystemFile]) -> None:
    async with Kernel() as kernel:
        await build(kernel, make())
        assert list(kernel.components) == ["source", "middle", "sink"]
        assert list(kernel.contexts) == ["a", "b"]
        assert kernel.contexts["a"].rate == 100.0
        assert [component.name for component in kernel.contexts["b"].members] == ["middle", "sink"]
        assert await wait_finished(kernel) == ()
        assert kernel.components["sink"].taken == [0, 1, 2]  # type: ignore[attr-defined]
        assert all(not connector.statistics.dropped for connector in kernel.connectors.values())


async def test_an_event_context_with_every_ends_with_its_data_too(make: Callable[..., SystemFile]) -> None:
    async with Kernel() as kernel:
        await build(kernel, make(CHAIN.replace('kind = "event"', 'kind = "event"\nevery = 0.001')))
        context = kernel.contexts["b"]
        assert isinstance(context, EventContext)
        assert context.every == 0.001
        assert await asyncio.wait_for(wait_finished(kernel), 30.0) == ()
        assert kernel.components["sink"].taken == [0, 1, 2]  # type: ignore[attr-defined]


async def test_who_reads_is_active_before_who_writes(make: Callable[..., SystemFile]) -> None:
    plan = prepare(make())
    async with Kernel() as kernel:
        await build(kernel, plan)
        module = __import__("sys").modules[plan.types["source"].__module__]
        assert module.activated[-3:] == ["sink", "middle", "source"]


async def test_an_override_wins_over_the_file(make: Callable[..., SystemFile]) -> None:
    text = CHAIN.replace('type = "parts.py:Source"', 'type = "parts.py:Source"\nparams.count = 2')
    for overrides, count in ((), 2), (("source.count=0x5",), 5):
        async with Kernel() as kernel:
            await build(kernel, make(text, *overrides))
            assert kernel.components["source"].params["count"].value == count


async def test_a_relative_path_is_counted_from_the_file_and_on_the_command_line_from_here(
    make: Callable[..., SystemFile], tmp_path: Path
) -> None:
    text = CHAIN.replace('type = "parts.py:Source"', 'type = "parts.py:Source"\nparams.path = "sub/x.txt"')
    assert prepare(make(text)).params["source"]["path"] == tmp_path / "sub" / "x.txt"
    assert prepare(make(text, "source.path=y.txt")).params["source"]["path"] == Path("y.txt")


async def test_a_context_that_is_not_to_be_activated_stays_inactive(make: Callable[..., SystemFile]) -> None:
    async with Kernel() as kernel:
        await build(kernel, make(CHAIN.replace("rate = 100.0", "rate = 100.0\nactivate = false")))
        assert kernel.components["source"].state is LifecycleState.INACTIVE
        assert kernel.components["sink"].state is LifecycleState.ACTIVE


@pytest.mark.parametrize(
    ("old", "new", "error", "said"),
    [
        ("parts.py:Sink", "parts.py:Sinc", PluginError, "did you mean 'Sink'"),
        ("parts.py:Sink", "parts.py:NotOne", PluginError, "no class derived from Component"),
        ("parts.py:Sink", "port.py:Sink", PluginError, "did you mean 'parts.py:Sink'"),
        ("parts.py:Sink", "../parts.py:Sink", SystemFileError, "outside"),
        ("parts.py:Sink", "/etc/passwd:Sink", PluginError, "FILE.py:Class"),
        ("parts.py:Sink", "FlexiDumb", PluginError, "did you mean FlexiDump"),
        ("rate = 100.0", "rate = 1e9", ConfigurationError, "rate = 1000000000.0"),
        ("rate = 100.0", 'overrun = "wait"', ConfigurationError, "'wait'; there are skip, catch_up"),
        ("rate = 100.0", "rates = 5.0", SystemFileError, "did you mean 'rate'"),
        (
            'kind = "event"',
            'kind = "event"\nevery = 0',
            ConfigurationError,
            r"contexts\.b\.every: expected seconds from 0\.0001 on, got 0",
        ),
        ('kind = "event"', 'kind = "evnet"', SystemFileError, "did you mean 'event'"),
        ('to = "sink.input"', 'to = "sink.inputs"', SystemFileError, "did you mean 'input'"),
        ('to = "sink.input"', 'to = "sink.input"\npush = "some"', WiringError, "all, fifo, skip, new"),
        ('to = "sink.input"', 'to = "sink.input"\nsubscription = "periodic"', WiringError, "needs a push_rate"),
    ],
)
async def test_what_is_wrong_is_said_before_anything_is_made(
    make: Callable[..., SystemFile], old: str, new: str, error: type[Exception], said: str
) -> None:
    assert old in CHAIN
    async with Kernel() as kernel:
        with pytest.raises(error, match=said) as caught:
            await build(kernel, make(CHAIN.replace(old, new)))
        assert "system.toml" in str(caught.value)
        assert not kernel.components


async def test_a_component_that_cannot_be_made_is_named(make: Callable[..., SystemFile]) -> None:
    async with Kernel() as kernel:
        with pytest.raises(ValueError, match="not today") as caught:
            await build(kernel, make('schema = 1\n[components.it]\ntype = "parts.py:Unmade"\n'))
        assert caught.value.__notes__ == ["it"]


async def test_a_port_that_does_not_fit_is_named_with_its_connection(make: Callable[..., SystemFile]) -> None:
    async with Kernel() as kernel:
        with pytest.raises(WiringError, match=r"connections\[2\] \(middle.out to source.out\)"):
            await build(kernel, make(CHAIN.replace('to = "sink.input"', 'to = "source.out"')))


async def test_two_systems_may_have_files_of_one_name(tmp_path: Path) -> None:
    classes = []
    for folder in ("one/here", "two/here"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "parts.py").write_text(PARTS)
        (tmp_path / folder / "s.toml").write_text('schema = 1\n[components.it]\ntype = "parts.py:Sink"\n')
        classes.append(prepare(load(tmp_path / folder / "s.toml")).types["it"])
    assert classes[0] is not classes[1]


async def test_a_source_has_an_out_port_and_nothing_that_feeds_it(make: Callable[..., SystemFile]) -> None:
    async with Kernel() as kernel:
        await build(kernel, make())
        assert [c.name for c in kernel.components.values() if is_source(c)] == ["source"]


async def test_a_source_in_error_has_ended_too(make: Callable[..., SystemFile]) -> None:
    async with Kernel() as kernel:
        await build(kernel, make(CHAIN.replace("parts.py:Source", "parts.py:Failing")))
        assert await wait_finished(kernel) == ()
        assert kernel.components["source"].state is LifecycleState.ERROR


@pytest.mark.slow(kept_by="system/test_ending.py::test_what_was_sent_to_a_reader_that_was_stopped_is_not_waited_for")
async def test_samples_that_nobody_wants_are_named_and_not_waited_for(make: Callable[..., SystemFile]) -> None:
    async with Kernel() as kernel:
        await build(kernel, make(CHAIN.replace("parts.py:Sink", "parts.py:Deaf")))
        assert [connector.in_.path for connector in await wait_finished(kernel)] == ["sink.input"]


async def test_options_of_a_command_line_make_the_same_component(make: Callable[..., SystemFile]) -> None:
    text = """
        schema = 1
        [components.metres]
        type = "FlexiFilter"
        options = ["-i", "TimedDouble", "-o", "TimedLong", "-m", "0>1000>0"]
        params.rounding = "floor"
    """
    async with Kernel() as kernel:
        await build(kernel, make(text))
        component = kernel.components["metres"]
        assert {name: value for name, value in component.params.values_in_force.items() if value} == {
            "inputs": ("TimedDouble",),
            "outputs": ("TimedLong",),
            "map": "0>1000>0",
            "rounding": "floor",
            "overflow": "error",
            "nan": "pass",
            "time": "oldest",
        }
        assert list(component.ports) == ["input0", "output0"]


async def test_a_plugin_below_the_folder_offers_its_types_to_the_file_and_to_the_kernel(
    make: Callable[..., SystemFile], tmp_path: Path
) -> None:
    folder = tmp_path / "plugins" / "grip"
    module = f"grip_{tmp_path.name}"  # a module is imported once in a process
    folder.mkdir(parents=True)
    (folder / "pyproject.toml").write_text(
        f'[project]\nname = "grip"\n[project.entry-points."aiorts.components"]\nGrip = "{module}:Grip"\n'
    )
    (folder / f"{module}.py").write_text("from aiorts import Component\nclass Grip(Component):\n    pass\n")
    text = 'schema = 1\nplugins.path = [".", "plugins"]\n[components.one]\ntype = "Grip"\n'
    async with Kernel() as kernel:
        await build(kernel, make(text))
        assert type(kernel.components["one"]).__name__ == "Grip"
        later = await kernel.create("Grip", "two")
        assert type(later) is type(kernel.components["one"])
    with pytest.raises(PluginError, match="no component named 'Grip'"):
        prepare(make(text.replace('".", "plugins"', '"."')))


PROMPT = """
from aiorts import Component

class Prompt(Component):
    def on_startup(self):
        self.at = []
    def on_execute(self):
        self.at.append(self.clock.monotonic_ns())
"""


def test_members_of_a_file_execute_one_period_after_t0_and_those_started_active_at_t0(tmp_path: Path) -> None:
    (tmp_path / "prompt.py").write_text(PROMPT)
    file = tmp_path / "system.toml"
    file.write_text(
        'schema = 1\n[components.one]\ntype = "prompt.py:Prompt"\n'
        '[contexts.main]\nkind = "periodic"\nrate = 4.0\nmembers = ["one"]\n'
    )

    async def main() -> tuple[list[int], list[int]]:
        async with Kernel() as kernel:
            await build(kernel, load(file))
            one: Any = kernel.components["one"]
            other = await kernel.add(type(one)("other"))
            await kernel.start(PeriodicContext(rate=4.0), other, activate=True)
            await kernel.sleep(0.6)
            return one.at, other.at

    assert simulate(main()) == ([250_000_000, 500_000_000], [0, 250_000_000, 500_000_000])
