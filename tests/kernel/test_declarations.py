"""What a component class declares: refused when it is loaded, in force between cycles, seen by every tool."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import Component, ExternalContext, InPort, Kernel, OutPort, Param, PeriodicContext, SimulatedClock
from aiorts.errors import ClosedError, ConfigurationError, DeclarationError, InvalidNameError, StateError, WiringError
from aiorts.kernel.loop.bus import Disconnected, ParametersChanged, PortAdded, PortRemoved
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from campaign import cases

if TYPE_CHECKING:
    from collections.abc import Callable


def takes_too_much() -> Any:
    def on_execute(self: Any, dt: float) -> None: ...

    return on_execute


def takes_no_error() -> Any:
    async def on_error(self: Any) -> None: ...

    return on_error


def generates() -> Any:
    def on_execute(self: Any) -> Any:
        yield

    return on_execute


def generates_async() -> Any:
    async def on_activated(self: Any) -> Any:
        yield

    return on_activated


@pytest.mark.fault("A19")
@pytest.mark.parametrize(
    ("hook", "value", "message"),
    [
        ("on_execute", takes_too_much(), r"Bad\.on_execute\(self: 'Any', dt: 'float'\).*expected \(self\)"),
        ("on_error", takes_no_error(), r"Bad\.on_error.*expected \(self, error\)"),
        ("on_execute", generates(), r"Bad\.on_execute: is a generator"),
        ("on_activated", generates_async(), r"Bad\.on_activated: is a generator"),
        ("on_execute", 7, r"Bad\.on_execute: expected a method, got int 7"),
        ("on_execute", staticmethod(lambda: None), r"Bad\.on_execute: expected a method, got staticmethod"),
    ],
)
def test_hook_of_a_wrong_kind_or_signature_is_refused_when_the_class_is_made(
    hook: str, value: Any, message: str
) -> None:
    with pytest.raises(DeclarationError, match=message):
        type("Bad", (Component,), {hook: value})


@pytest.mark.fault("A19")
@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("on_excute", "on_execute"),
        ("on_exceute", "on_execute"),
        ("on_exxecute", "on_execute"),
        ("on_executed", "on_execute"),
        ("on_activate", "on_activated"),
        ("on_deactivate", "on_deactivated"),
        ("on_initialise", "on_initialize"),
        ("on_start_up", "on_startup"),
        ("on_state_updates", "on_state_update"),
        ("onExecute", "on_execute"),
        ("onStateUpdate", "on_state_update"),
        ("on_Reset", "on_reset"),
    ],
)
def test_a_misspelt_hook_is_refused_when_the_class_is_made(name: str, meant: str) -> None:
    async def method(self: Any) -> None: ...

    with pytest.raises(DeclarationError, match=rf"Bad\.{name}: there is no such hook; did you mean {meant}\?"):
        type("Bad", (Component,), {name: method})


@pytest.mark.fault("A19")
def test_a_misspelt_hook_that_takes_the_error_is_refused_too() -> None:
    def method(self: Any, error: BaseException) -> None: ...

    with pytest.raises(DeclarationError, match="did you mean on_error"):
        type("Bad", (Component,), {"on_eror": method})
    with pytest.raises(DeclarationError, match="did you mean on_execute"):
        type("Bad", (Component,), {"onExecute": method})


def test_methods_of_ones_own_may_begin_with_on() -> None:
    class Panel(Component):
        """Has methods that are no hooks."""

        on_error_count = 0

        def on_button(self) -> None: ...

        def on_result(self) -> None: ...

        def on_actuated(self) -> None: ...

        def on_execution(self) -> None: ...

        def on_preset(self, number: int) -> None: ...

        def on_errors(self) -> None: ...

        def once(self) -> None: ...

    assert Panel("panel0").on_error_count == 0


class Unsightly:
    """Raises when it is looked at."""

    @property  # type: ignore[misc]
    def __class__(self) -> type:
        raise RuntimeError("no class")

    def __repr__(self) -> str:
        raise RuntimeError("no text")


@pytest.mark.fault("A19")
@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (lambda: 5, "returned int 5; a hook returns nothing"),
        (lambda: asyncio.sleep(0), "returned coroutine .*async def"),
        (lambda: Unsightly(), "returned Unsightly <Unsightly that cannot be shown>; a hook returns nothing"),
    ],
    ids=["a value", "a coroutine", "what raises when it is looked at"],
)
def test_returned_value_is_an_error_at_the_first_call(returned: Callable[[], Any], message: str) -> None:
    class Returning(Component):
        def on_execute(self) -> Any:
            return returned()

    class Refused(Component):
        def on_initialize(self) -> Any:
            return returned()

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            component = await kernel.add(Returning("pid0"))
            context = await kernel.start(ExternalContext(), component, activate=True)
            await context.tick()
            assert component.state == "error"
            with pytest.raises(StateError, match=rf"pid0\.on_execute\(self\): {message}"):
                raise component.last_error or AssertionError
            with pytest.raises(StateError, match=message):
                await kernel.add(Refused("pid1"))
            assert kernel.exit_status == 0

    simulate(main)


@pytest.mark.fault("A19")
def test_hook_set_on_an_instance_or_a_forgotten_super_call_is_refused_when_added() -> None:
    class Forgetful(Component):
        def __init__(self) -> None:
            pass

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            component: Any = Component("pid0")
            component.on_execute = lambda: None
            with pytest.raises(DeclarationError, match=r"Component\.on_execute: set on the instance"):
                await kernel.add(component)
            with pytest.raises(DeclarationError, match=r"Forgetful: super\(\).__init__\(name\) was not called"):
                await kernel.add(Forgetful())

    simulate(main)


def test_super_of_a_hook_that_nobody_wrote_can_be_awaited_or_called() -> None:
    class Polite(Component):
        async def on_activated(self) -> None:
            hook: Any = super().on_activated()
            await hook

        def on_execute(self) -> None:
            super().on_execute()

    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            polite = await kernel.add(Polite("polite"))
            context = await kernel.start(ExternalContext(), polite, activate=True)
            await context.tick()
            assert (polite.state, polite.last_error) == ("active", None)

    simulate(main)


# -- parameters ------------------------------------------------------------------------------------------------------


class Tuned(Component):
    gain = Param(1.0, ge=0.0, le=10.0, unit="m")
    mode = Param("slow", choices=("slow", "fast"))
    count = Param(3)

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.seen: list[tuple[float, float, float]] = []

    async def on_execute(self) -> None:
        first = self.gain
        await asyncio.sleep(0.05)
        second = self.gain
        await self.configure(gain=self.gain + 1.0)
        self.seen.append((first, second, self.gain))


def test_parameters_change_between_cycles_only() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            tuned = await kernel.add(Tuned("pid0"))
            await kernel.start(PeriodicContext(10.0), tuned, activate=True)
            await asyncio.sleep(0.02)
            changing = asyncio.create_task(tuned.configure(gain=5.0))
            await asyncio.sleep(0)
            assert tuned.gain == 1.0
            await changing
            assert round(asyncio.get_running_loop().time(), 3) == 0.05
            await asyncio.sleep(0.2)
            assert tuned.seen[:2] == [(1.0, 1.0, 1.0), tuned.seen[1]]
            assert all(len(set(values)) == 1 for values in tuned.seen)

    simulate(main)


def test_bad_change_is_refused_whole_and_names_every_culprit() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            heard: list[ParametersChanged] = []
            tuned = await kernel.add(Tuned("pid0"), gain=2)
            kernel.bus.subscribe(ParametersChanged, heard.append)
            for bad in ({"gain": 11.0, "count": 4}, {"mode": "warp"}, {"count": "many"}, {"nothing": 1}):
                with pytest.raises(ConfigurationError, match=rf"pid0\.{next(iter(bad))}"):
                    await tuned.configure(**bad)
            assert tuned.params.values_in_force == {"gain": 2.0, "mode": "slow", "count": 3}
            assert heard == []
            await tuned.configure(gain=3.0, mode="fast")
            assert (tuned.gain, tuned.mode, tuned.params["gain"].value, tuned.params["gain"].unit) == (
                3.0,
                "fast",
                3.0,
                "m",
            )
            assert [event.values for event in heard] == [(("gain", 3.0), ("mode", "fast"))]
            with pytest.raises(ConfigurationError):
                await kernel.add(Tuned("pid1"), gain=-1.0)
            assert list(kernel.components) == ["pid0"]

    simulate(main)


# -- ports that come and go ------------------------------------------------------------------------------------------


class Source(Component):
    out = OutPort(TimedLong)


@pytest.mark.row(21)
def test_ports_added_and_removed_at_run_time_are_announced_and_serve_at_once() -> None:
    async def main(clock: SimulatedClock) -> None:
        heard: list[Any] = []
        async with Kernel() as kernel:
            source, sink = await kernel.add(Source("source")), await kernel.add(Component("sink"))
            for kind in (PortAdded, PortRemoved, Disconnected):
                kernel.bus.subscribe(kind, heard.append)
            context = await kernel.start(ExternalContext(), sink, activate=True)
            port = sink.add_port("more", InPort(TimedLong, unit="m"))
            assert heard == [PortAdded("sink", port.profile)]
            assert list(sink.ports) == ["more"]
            assert [profile.name for profile in sink.profile.ports] == ["more"]
            assert kernel.find("sink.more") is port
            await kernel.connect(source.out, port)
            source.out.write_nowait(TimedLong(0, 7))
            assert port.read_nowait().data == 7
            with pytest.raises(WiringError, match=r"sink\.more: there is a port of that name already"):
                sink.add_port("more", InPort(TimedLong))
            waiting = asyncio.create_task(port.read())
            await asyncio.sleep(0)
            sink.remove_port("more")
            with pytest.raises(ClosedError):
                await waiting
            assert [type(event) for event in heard] == [PortAdded, Disconnected, PortRemoved]
            assert (dict(sink.ports), dict(kernel.connectors)) == ({}, {})
            with pytest.raises(WiringError, match="no such port"):
                sink.remove_port("more")
            await context.tick()
            assert sink.state == "active"

    simulate(main)


@pytest.mark.parametrize("name", ["", "a.b", "a b", "<b>", "1/2"])
def test_names_that_would_not_survive_a_path_are_refused(name: str) -> None:
    with pytest.raises(InvalidNameError):
        Source("source").add_port(name, InPort(TimedLong))


# -- what tools see --------------------------------------------------------------------------------------------------


class Labelled(Component):
    """A class whose parameters hold markup."""

    text = Param("<script>alert(1)</script>")
    out = OutPort(TimedLong, unit="<b>m</b>")


def test_repr_and_html_show_the_system_and_escape_everything() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel("plant") as kernel:
            labelled, sink = await kernel.add(Labelled("pid0")), await kernel.add(Component("sink"))
            port = sink.add_port("in", InPort(TimedLong))
            await kernel.connect(labelled.out, port)
            await kernel.start(PeriodicContext(10.0, name="loop"), labelled, activate=True)
            for shown in (kernel, labelled, port, labelled.out):
                html: str = shown._repr_html_()  # type: ignore[attr-defined]
                assert html.count("<table>") == html.count("</table>") >= 1
                assert "<script>" not in html
                assert "<b>" not in html
            assert "&lt;script&gt;" in labelled._repr_html_()
            assert "loop: active" in kernel._repr_html_()
            assert repr(kernel) == "<Kernel plant open 2 components 1 contexts 1 connectors>"
            assert "pid0" in repr(labelled)
            assert "loop: active" in repr(labelled)
            assert "pid0.out" in repr(labelled.out)
        assert repr(kernel) == "<Kernel plant closed 0 components 0 contexts 0 connectors>"

    simulate(main)


# -- what a writer does afterwards -----------------------------------------------------------------------------------


@dataclass
class Scan:
    """A user's own mutable type."""

    number: int
    ranges: list[int] = field(default_factory=list)


class Scanner(Component):
    out = OutPort(Scan)


class Reader(Component):
    scan = InPort(Scan)


@pytest.mark.fault("A20")
@pytest.mark.campaign
def test_what_a_writer_changes_after_the_write_no_reader_sees() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            scanner = await kernel.add(Scanner("scanner"))
            readers = [await kernel.add(Reader(f"r{n}")) for n in range(2)]
            for reader in readers:
                await kernel.connect(scanner.out, reader.scan)
            scan = Scan(0)
            for number in range(cases(100_000)):
                scan.number, scan.ranges[:] = number, [number] * 3
                scanner.out.write_nowait(scan)
                scan.number = -1
                scan.ranges[0] = -1
                scan.ranges.append(-1)
                first, second = readers[0].scan.read_nowait(), readers[1].scan.read_nowait()
                assert (first.number, list(first.ranges)) == (number, [number] * 3)
                assert first is second

    simulate(main)


def test_a_parameter_named_like_something_of_the_component_is_refused() -> None:
    with pytest.raises(DeclarationError, match=r"Bad\.state: Component has a state of its own"):

        class Bad(Component):
            state = Param(1)


def test_the_private_names_of_a_component_belong_to_its_writer() -> None:
    assert set(vars(Component("c"))) == {"_rt"}
    inherited = {name for name in vars(Component) if name.startswith("_") and not name.startswith("__")}
    assert inherited == {"_repr_html_", "_rt"}


def test_a_class_has_what_all_of_its_bases_declare_as_python_finds_attributes() -> None:
    class Base(Component):
        gain = Param(1.0)
        out = OutPort(TimedLong)

    class Tuned(Base):
        gain = Param(2.0)

    class Limited(Base):
        limit = Param(9.0)
        inp = InPort(TimedLong)

    class Mixin:
        offset = Param(0.5)

    class Both(Limited, Tuned, Mixin):
        pass

    both = Both()
    assert (both.gain, both.limit, both.offset) == (2.0, 9.0, 0.5)
    assert sorted(both.params) == ["gain", "limit", "offset"]
    assert sorted(both.ports) == ["inp", "out"]
    assert both.ports["inp"] is both.inp


def test_a_type_in_quotes_is_refused_with_class_and_port_when_the_class_is_made() -> None:
    said = r"Typo\.obstacle: 'Obstacle' is text; give the class itself, without quotes: InPort\(Obstacle\)"
    with pytest.raises(DeclarationError, match=said):

        class Typo(Component):
            obstacle = InPort("Obstacle")  # type: ignore[arg-type]


def test_a_type_that_cannot_travel_is_refused_when_the_class_is_made() -> None:
    said = r"Watch\.seen: complex cannot be the type of a port"
    with pytest.raises(DeclarationError, match=said):

        class Watch(Component):
            seen = OutPort(complex)


def test_a_field_of_a_dataclass_that_cannot_travel_is_refused_when_the_class_of_the_component_is_made() -> None:
    @dataclass
    class Seen:
        marks: set[int]

    said = r"Watch\.seen: .*Seen\.marks: a value of type set\[int\] cannot travel; use"
    with pytest.raises(DeclarationError, match=said):

        class Watch(Component):
            seen = OutPort(Seen)


def test_a_dataclass_may_name_a_class_that_is_defined_after_the_component() -> None:
    space = {"__name__": __name__, "dataclass": dataclass, "Component": Component, "OutPort": OutPort}
    exec(
        compile(
            "@dataclass\nclass Outer:\n    inner: 'Inner'\n\n"
            "class Watch(Component):\n    seen = OutPort(Outer)\n\n"
            "@dataclass\nclass Inner:\n    value: float = 0.0\n",
            "later.py",
            "exec",
        ),
        space,
    )


def test_a_type_that_cannot_travel_is_refused_when_the_port_is_added() -> None:
    with pytest.raises(DeclarationError, match=r"watch0\.seen: complex cannot be the type of a port"):
        Component("watch0").add_port("seen", OutPort(complex))
