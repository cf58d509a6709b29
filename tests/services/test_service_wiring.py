"""Declaring and connecting service ports: who is bound with whom, what is refused and why, what tools can see."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

import pytest

from aiorts import Component, InPort, Kernel, OutPort, Provided, Required, ServicePort
from aiorts.errors import AiortsError, ClosedError, DeclarationError, InterfaceMismatch, ServiceError, WiringError
from aiorts.events import Connected, Disconnected, Event, PortAdded, PortRemoved
from aiorts.system import build, load, prepare
from aiorts.testing import simulated
from aiorts.testing.simulation import simulate
from aiorts.types import TimedLong
from services.parts import Arm, Brake, PlainBrake, Quick


class Lamp(Protocol):
    """Something to look at."""

    async def shine(self, colour: str, *, blink: bool = False) -> None:
        """Shine."""
        ...


class Panel(Component):
    """One port with three interfaces."""

    lamp = Provided[Lamp](port="front", doc="the big one")
    second = Provided[Lamp](port="front")
    brake = Required[Brake](port="front")

    def __init__(self, name: str = "panel") -> None:
        super().__init__(name)
        self.shone: list[tuple[str, bool]] = []

    def shine(self, colour: str, *, blink: bool = False) -> None:
        self.shone.append((colour, blink))


class Machine(Component):
    """The other side of it."""

    brake = Provided[Brake](port="back")
    lamp = Required[Lamp](port="back")

    def __init__(self, name: str = "machine") -> None:
        super().__init__(name)

    async def stop(self, force: float = 1.0) -> float:
        await self.lamp.proxy.shine("red")
        return force

    def held(self) -> bool:
        return True


@pytest.mark.row(67)
@simulated
async def test_several_interfaces_in_one_port_are_connected_in_one_go() -> None:
    """In OpenRTM several connections to one service port misbehave (OpenRTM-aist#425)."""
    async with Kernel() as kernel:
        panel, machine = await kernel.add(Panel()), await kernel.add(Machine())
        assert list(panel.ports) == ["front"]
        port = panel.ports["front"]
        assert isinstance(port, ServicePort)
        assert not port.is_bound
        connector = await kernel.connect(panel.ports["front"], machine.ports["back"])
        assert connector.profile.mapping == (
            ("panel.front.brake", "machine.back.brake"),
            ("machine.back.lamp", "panel.front.lamp"),
        )
        assert await panel.brake.proxy.stop(3.0) == 3.0
        assert panel.shone == [("red", False)]
        assert port.is_bound
        again = await kernel.add(Machine("again"))
        second = await kernel.connect(panel.second, again.lamp)
        await again.lamp.proxy.shine("blue", blink=True)
        assert panel.shone[-1] == ("blue", True)
        assert port.connectors == (connector, second)
        await kernel.disconnect(connector)
        assert panel.brake.profile.bound_to == ()
        await again.lamp.proxy.shine("green")
        assert kernel.service_connectors == {second.name: second}


class Both(Component):
    """Two interfaces in one port that others answer."""

    brake = Required[Brake](port="front")
    lamp = Required[Lamp](port="front")


class Light(Component):
    lamp = Provided[Lamp]()

    async def shine(self, colour: str, *, blink: bool = False) -> None: ...


@pytest.mark.row(67)
@pytest.mark.parametrize("strict", [True, False])
@pytest.mark.parametrize("bind_lamp", [True, False])
@simulated
async def test_a_second_provider_is_told_who_is_bound_already_by_port_as_by_end(bind_lamp: bool, strict: bool) -> None:
    async with Kernel() as kernel:
        both, first = await kernel.create(Both, "both"), await kernel.create(PlainBrake, "first")
        second, light = await kernel.create(PlainBrake, "second"), await kernel.create(Light, "light")
        held = await kernel.connect(both.brake, first.service)
        lamp = await kernel.connect(both.lamp, light.lamp) if bind_lamp else None
        text = f"both.front.brake: is bound to first.service already; disconnect {held.name} first"
        for one, two in (
            (both.brake, second.service),
            (both.ports["front"], second.service),
            (both.ports["front"], second.ports["service"]),
            (both.brake, second.ports["service"]),
        ):
            with pytest.raises(WiringError) as told:
                await kernel.connect(one, two, strict=strict)  # type: ignore[call-overload]
            assert str(told.value).startswith(text)
        assert tuple(kernel.service_connectors.values()) == (held,) if lamp is None else (held, lamp)


class Horn(Protocol):
    async def blow(self) -> None: ...


class Loud(Component):
    horn = Provided[Horn]()

    async def blow(self) -> None: ...


@pytest.mark.row(67)
@simulated
async def test_who_provides_something_else_is_told_that_and_not_of_who_is_bound() -> None:
    async with Kernel() as kernel:
        both, first = await kernel.create(Both, "both"), await kernel.create(PlainBrake, "first")
        loud, light = await kernel.create(Loud, "loud"), await kernel.create(Light, "light")
        await kernel.connect(both.brake, first.service)
        with pytest.raises(InterfaceMismatch, match=r"both\.front\.lamp requires Lamp, loud\.horn provides Horn"):
            await kernel.connect(both.ports["front"], loud.ports["horn"])
        with pytest.raises(WiringError, match="nothing would be bound; there is no provider that fits"):
            await kernel.connect(both.ports["front"], loud.ports["horn"], strict=False)
        await kernel.connect(both.ports["front"], light.ports["lamp"])
        assert both.lamp.is_bound


@pytest.mark.row(67)
@simulated
async def test_one_provider_answers_many_and_many_providers_are_asked_only_by_who_says_so() -> None:
    class Convoy(Component):
        brakes = Required[Brake](many=True)

    async with Kernel() as kernel:
        brakes = [await kernel.add(PlainBrake(f"brake{n}")) for n in range(3)]
        arms = [await kernel.add(Arm(f"arm{n}")) for n in range(3)]
        for arm in arms:
            await kernel.connect(arm.brake, brakes[0].service)
        for number, arm in enumerate(arms):
            await arm.brake.proxy.stop(number)
        assert brakes[0].forces == [0, 1, 2]
        with pytest.raises(WiringError, match=r"arm0\.brake: is bound to brake0\.service already; disconnect"):
            await kernel.connect(arms[0].brake, brakes[1].service)
        with pytest.raises(WiringError, match="is bound to brake0"):
            await kernel.connect(arms[0].brake, brakes[0].service)
        convoy = await kernel.add(Convoy("convoy"))
        made = await kernel.connect(convoy.brakes, *(brake.service for brake in brakes))
        assert len(made) == 3
        assert [await brake.stop(8.0) for brake in convoy.brakes.proxies] == [4.0] * 3
        with pytest.raises(ServiceError, match="bound to 3 providers"):
            await convoy.brakes.proxy.stop()
        with pytest.raises(WiringError, match="connected already"):
            await kernel.connect(convoy.brakes, brakes[0].service)


@pytest.mark.row(68)
@simulated
async def test_a_mapping_says_who_answers_where_the_type_does_not() -> None:
    async with Kernel() as kernel:
        panel, machine = await kernel.add(Panel()), await kernel.add(Machine())
        both = await kernel.add(Panel("both"))
        lonely = await kernel.add(Asking())
        with pytest.raises(WiringError) as told:
            await kernel.connect(lonely.ports["light"], both.ports["front"], strict=False)
        for part in ("asking0.light", "both.front.lamp, both.front.second", "say which: mapping="):
            assert part in str(told.value)
        connector = await kernel.connect(
            panel.ports["front"], machine.ports["back"], mapping={"machine.back.lamp": "panel.front.second"}
        )
        assert ("machine.back.lamp", "panel.front.second") in connector.profile.mapping
        await kernel.disconnect(connector)
        connector = await kernel.connect(panel.ports["front"], machine.ports["back"], mapping={"lamp": None})
        assert connector.profile.mapping == (("panel.front.brake", "machine.back.brake"),)
        assert not machine.lamp.is_bound
        await kernel.disconnect(connector)
        openrtm = {
            "port.connection.strictness": "strict",
            "machine.port.back.required.Lamp.lamp": "panel.port.front.provided.Lamp.second",
        }
        connector = await kernel.connect(panel.ports["front"], machine.ports["back"], **openrtm)
        assert ("machine.back.lamp", "panel.front.second") in connector.profile.mapping


class Asking(Component):
    light = Required[Lamp]()


@pytest.mark.row(68)
@simulated
async def test_what_nobody_answers_is_refused_unless_it_is_said_that_it_may_be() -> None:
    """OpenRTM's default connects all the same, and the first call fails."""

    class Half(Component):
        brake = Required[Brake](port="all")
        light = Required[Lamp](port="all")

    async with Kernel() as kernel:
        half, brake = await kernel.add(Half("half")), await kernel.add(PlainBrake())
        with pytest.raises(InterfaceMismatch) as told:
            await kernel.connect(half.ports["all"], brake.service)
        for part in ("half.all.light requires Lamp", "brake0.service provides Brake", "no method async shine("):
            assert part in str(told.value)
        assert not kernel.service_connectors
        assert half.brake.connectors == brake.service.connectors == ()
        await kernel.connect(half.ports["all"], brake.service, strict=False)
        assert half.brake.is_bound
        assert not half.light.is_bound


class OtherBrake(Protocol):
    async def stop(self, power: float = 1.0) -> float: ...
    async def held(self) -> bool: ...


class Textual(Protocol):
    async def stop(self, force: float = 1.0) -> str: ...
    async def held(self) -> bool: ...


class Needy(Protocol):
    async def stop(self, force: float) -> float: ...
    async def held(self) -> bool: ...


class Poor(Protocol):
    async def stop(self, force: float = 1.0) -> float: ...


class Rich(Protocol):
    async def stop(self, force: float = 1.0, ramp: int = 0) -> int: ...
    async def held(self) -> bool: ...
    async def more(self) -> None: ...


@pytest.mark.fault("B20")
@pytest.mark.row(68)
@pytest.mark.parametrize(
    ("interface", "difference"),
    [
        (OtherBrake, "stop, parameter force: is called power"),
        (Textual, "stop returns str, not float"),
        (Needy, "stop, parameter force: has no default"),
        (Poor, "there is no method async held() -> bool"),
    ],
)
@simulated
async def test_another_interface_is_refused_at_connect_with_the_difference(interface: Any, difference: str) -> None:
    class Anything:
        def __getattr__(self, name: str) -> Any:
            return answering[name]

    async def stop(force: float = 1.0) -> Any: ...
    async def other(power: float = 1.0) -> Any: ...
    async def held() -> bool: ...

    answering: dict[str, Any] = {"stop": other if interface is OtherBrake else stop, "held": held}

    async with Kernel() as kernel:
        arm, host = await kernel.add(Arm()), await kernel.add(Component("host"))
        host.add_port("service", Provided[interface](Anything()))
        with pytest.raises(InterfaceMismatch) as told:
            await kernel.connect(arm.brake, host.ports["service"])  # type: ignore[call-overload]
        for part in ("arm.brake requires Brake", "host.service provides", difference):
            assert part in str(told.value)


@simulated
async def test_an_interface_that_has_more_fits() -> None:
    class Better(Component):
        service = Provided[Rich]()

        async def stop(self, force: float = 1.0, ramp: int = 0) -> int:
            return 7

        def held(self) -> bool:
            return False

        def more(self) -> None: ...

    async with Kernel() as kernel:
        arm, better = await kernel.add(Arm()), await kernel.add(Better("better"))
        await kernel.connect(arm.brake, better.service)
        assert await arm.brake.proxy.stop() == 7


@simulated
async def test_what_cannot_be_connected_says_why() -> None:
    class Reading(Component):
        inp = InPort(TimedLong)
        out = OutPort(TimedLong)

    async with Kernel() as kernel:
        arm, brake, reading = await kernel.add(Arm()), await kernel.add(PlainBrake()), await kernel.add(Reading("r"))
        loose, other = PlainBrake("loose"), await kernel.add(Arm("other"))
        for ports, options, why in (
            ((arm.brake, reading.inp), {}, "r.inp is a data port"),
            ((arm.brake, other.brake), {}, "no port provides anything"),
            ((brake.service, brake.service), {}, "no port requires anything"),
            ((arm.brake, loose.service), {}, "await kernel.add"),
            ((arm.brake, PlainBrake.service), {}, "is a declaration"),
            ((arm.brake, brake.service), {"subscription": "new"}, "unknown option 'subscription'"),
            ((arm.brake, brake.service), {"strickt": True}, "did you mean 'strict'"),
            ((arm.brake, brake.service), {"mapping": {"nothing": "service"}}, "mapping: 'nothing': none is called so"),
            ((arm.brake, brake.service), {"mapping": {"brake": None}}, "nothing would be bound"),
        ):
            with pytest.raises(WiringError) as told:
                await kernel.connect(*ports, **options)  # type: ignore[call-overload]
            assert why in str(told.value)
        assert not kernel.service_connectors
        with pytest.raises(WiringError, match="strict: is an option of service ports"):
            await kernel.connect(reading.out, reading.inp, strict=True)


@simulated
async def test_a_port_takes_so_many_connectors_and_no_more() -> None:
    class Exclusive(PlainBrake):
        service = Provided[Brake](max_connectors=1)

    async with Kernel() as kernel:
        one, two, brake = await kernel.add(Arm("a")), await kernel.add(Arm("b")), await kernel.add(Exclusive())
        await kernel.connect(one.brake, brake.service)
        with pytest.raises(WiringError, match=r"brake0\.service: takes 1 connectors at the most"):
            await kernel.connect(two.brake, brake.service)


@simulated
async def test_the_provider_may_be_another_object() -> None:
    class Driver:
        def __init__(self) -> None:
            self.forces: list[float] = []

        async def stop(self, force: float = 1.0) -> float:
            self.forces.append(force)
            return -force

        def held(self) -> bool:
            return True

    class Holder(Component):
        service = Provided[Brake]("driver")

        def __init__(self, name: str = "") -> None:
            super().__init__(name)
            self.driver = Driver()

    async with Kernel() as kernel:
        holder, arm = await kernel.add(Holder()), await kernel.add(Arm())
        await kernel.connect(arm.brake, holder.service)
        assert await arm.brake.proxy.stop(2.0) == -2.0
        assert holder.driver.forces == [2.0]
        driver = Driver()
        port = holder.add_port("another", Provided[Brake](driver))
        other = await kernel.add(Arm("other"))
        await kernel.connect(other.brake, port)
        assert await other.brake.proxy.stop(3.0) == -3.0
        assert driver.forces == [3.0]


@simulated
async def test_service_ports_come_and_go_while_the_system_runs() -> None:
    heard: list[Event] = []
    async with Kernel() as kernel:
        for kind in (PortAdded, PortRemoved, Connected, Disconnected):
            kernel.bus.subscribe(kind, heard.append)
        host, arm = await kernel.add(PlainBrake("host")), await kernel.add(Component("arm"))
        heard.clear()
        end = arm.add_port("brake", Required[Brake](timeout=0.5))
        assert arm.ports["brake"] is end.port
        assert end.path == "arm.brake"
        connector = await kernel.connect(end, host.service)
        assert await end.proxy.stop() == 0.5
        with pytest.raises(WiringError, match="there is a port of that name already"):
            arm.add_port("brake", Required[Brake]())
        arm.remove_port("brake")
        assert [type(event).__name__ for event in heard] == ["PortAdded", "Connected", "Disconnected", "PortRemoved"]
        assert connector.closed
        assert not host.service.connectors
        assert host.service.statistics.calls == 1
        again = arm.add_port("again", Arm.brake)
        assert (again.path, again.instance) == ("arm.again", "again")
        with pytest.raises(ClosedError, match="belongs to no component"):
            _ = Arm.brake.port


def declare(**body: Any) -> type[Component]:
    return type("Made", (Component,), body)


class Valued(Protocol):
    level: int

    def get(self) -> int: ...


class Loose(Protocol):
    def get(self, *args: int) -> int: ...


class Nothing(Protocol):
    pass


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda: Required[int](), "an interface is a typing.Protocol"),
        (lambda: Required(), "say which interface"),  # type: ignore[var-annotated]
        (lambda: Required[Valued](), r"Valued\.level: is a value"),
        (lambda: Required[Loose](), "each parameter needs a name"),
        (lambda: Required[Nothing](), "needs a method"),
        (lambda: Required[Brake](timeout=0.0), "every call has a deadline"),
        (lambda: Provided[Brake](failure="loud"), "failure = 'loud'"),
        (lambda: Provided[Brake](object()), "does not provide Brake: there is no method async stop"),
        (lambda: declare(service=Provided[Brake]()), r"Made\.service: does not provide Brake"),
        (
            lambda: declare(service=Provided[Quick](), count=_count),
            r"count may not wait: wanted count\(\) -> int, there is async count\(\)",
        ),
    ],
)
def test_a_wrong_declaration_is_refused_where_it_is_written(make: Any, why: str) -> None:
    with pytest.raises(DeclarationError, match=why):
        make()


async def _count(self: Any) -> int:
    return 0


@pytest.mark.row(67)
@simulated
async def test_methods_parameters_types_and_docs_are_plain_data() -> None:
    async with Kernel() as kernel:
        panel, machine = await kernel.add(Panel()), await kernel.add(Machine())
        await kernel.connect(panel.ports["front"], machine.ports["back"])
        profile = json.loads(json.dumps(asdict(panel.ports["front"].profile)))
        assert profile["direction"] == "service"
        lamp, second, brake = profile["interfaces"]
        assert lamp == {
            "name": "lamp",
            "polarity": "provided",
            "type": "Lamp",
            "doc": "the big one",
            "bound_to": ["machine.back.lamp"],
            "methods": [
                {
                    "name": "shine",
                    "parameters": [
                        {"name": "colour", "type": "str", "default": None, "kind": "either"},
                        {"name": "blink", "type": "bool", "default": "False", "kind": "keyword"},
                    ],
                    "returns": "None",
                    "doc": "Shine.",
                    "plain": False,
                }
            ],
        }
        assert (second["bound_to"], second["doc"]) == ([], "Something to look at.")
        assert (brake["polarity"], brake["bound_to"]) == ("required", ["machine.back.brake"])
        assert str(panel.brake.profile.methods[0]) == "async stop(force: float = 1.0) -> float"
        assert "service" in panel._repr_html_()
        assert "machine.back.lamp" in panel.ports["front"]._repr_html_()
        assert "provided Lamp" in repr(panel.ports["front"])


FILE = """
schema = 1
[components.arm]
type = "service_parts.py:Arm"
[components.brake0]
type = "service_parts.py:PlainBrake"
[contexts.loop]
kind = "event"
members = ["brake0", "arm"]
[[connections]]
from = "arm.brake"
to = "brake0.service"
strict = true
mapping = { "arm.brake" = "brake0.service" }
"""


@pytest.mark.row(68)
def test_a_system_file_connects_service_ports(tmp_path: Path) -> None:
    parts = Path(__file__).with_name("parts.py").read_text(encoding="utf-8")
    (tmp_path / "service_parts.py").write_text(parts, encoding="utf-8")
    (tmp_path / "system.toml").write_text(FILE, encoding="utf-8")
    system = load(tmp_path / "system.toml")

    async def main() -> None:
        async with Kernel() as kernel:
            await build(kernel, system)
            arm: Any = kernel.components["arm"]
            assert await arm.brake.proxy.stop(2.0) == 1.0

    simulate(main())


def test_a_wrong_option_in_a_system_file_is_found_before_anything_is_made(tmp_path: Path) -> None:
    parts = Path(__file__).with_name("parts.py").read_text(encoding="utf-8")
    (tmp_path / "service_parts.py").write_text(parts, encoding="utf-8")
    (tmp_path / "system.toml").write_text(FILE.replace("strict", "strickt"), encoding="utf-8")
    with pytest.raises(AiortsError, match="did you mean 'strict'"):
        prepare(load(tmp_path / "system.toml"))


def test_a_method_overridden_with_other_parameters_is_refused_where_it_is_written() -> None:
    with pytest.raises(DeclarationError, match=r"Worse\.service: does not provide Brake: stop, parameter force"):

        class Worse(PlainBrake):
            def stop(self, power: float = 1.0) -> float:  # type: ignore[override] # what is tested
                return power


@simulated
async def test_service_ports_are_given_themselves_or_by_their_paths() -> None:
    async with Kernel() as kernel:
        panel, machine = await kernel.add(Panel()), await kernel.add(Machine())
        pairs: list[Any] = [
            ("panel.front", "machine.back"),
            ("machine.back", panel.ports["front"]),
            (machine.ports["back"], "panel.front"),
        ]
        for one, two in pairs:
            connector = await kernel.connect(one, two, mapping={"lamp": "lamp"})
            assert set(connector.profile.ports) == {"panel.front", "machine.back"}
            await kernel.disconnect(connector)
        with pytest.raises(WiringError, match=r"panel has no port 'brake'; it has front"):
            await kernel.connect("panel.brake", "machine.back")
        with pytest.raises(WiringError, match=r"machine: is a component; give one of its ports: machine\.back"):
            await kernel.connect("panel.front", "machine")
        assert not kernel.service_connectors
