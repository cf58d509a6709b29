"""`adapt`: a FlexiFilter is put between ports that do not fit, where it is plain which one; or nothing is changed."""

from __future__ import annotations

import asyncio
import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts import (
    Component,
    Composite,
    Connector,
    EventContext,
    InPort,
    Kernel,
    OutPort,
    PeriodicContext,
    ThreadContext,
)
from aiorts.adapting import between
from aiorts.adapting.proposing import conversion
from aiorts.errors import AiortsError, PluginError, StateError, SystemFileError, WiringError
from aiorts.system import build, check, graph, load, parse, prepare, wanted
from aiorts.types import (
    Point2D,
    Pose2D,
    TimedBoolean,
    TimedChar,
    TimedDouble,
    TimedDoubleSeq,
    TimedLong,
    TimedPoint2D,
    TimedPose2D,
    TimedString,
    TimedStringSeq,
    TimedVelocity2D,
    Velocity2D,
    record,
)
from aiorts_flexi.mapping.conversion import conversion as conversion_of

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    """One loop is enough: what is put between is an ordinary component."""
    return "asyncio"


class Source(Component):
    metres = OutPort(TimedDouble, unit="m")
    pose = OutPort(TimedPose2D)
    three = OutPort(TimedDoubleSeq, shape=(3,))
    some = OutPort(TimedDoubleSeq)


class Sink(Component):
    mm = InPort(TimedDouble, unit="mm")
    metres = InPort(TimedDouble, unit="m")
    volt = InPort(TimedDouble, unit="V")
    whole = InPort(TimedLong)
    point = InPort(TimedPoint2D)
    velocity = InPort(TimedVelocity2D)
    heading = InPort(TimedDouble)
    value = InPort(TimedDouble)
    two = InPort(TimedDoubleSeq, shape=(2,))
    four = InPort(TimedDoubleSeq, shape=(4,))
    some = InPort(TimedDoubleSeq)


PARTS = """
from aiorts import Component, InPort, OutPort
from aiorts.types import TimedDouble, TimedDoubleSeq, TimedPose2D, TimedPoint2D

class Source(Component):
    metres = OutPort(TimedDouble, unit="m")
    pose = OutPort(TimedPose2D)
    three = OutPort(TimedDoubleSeq, shape=(3,))

class Sink(Component):
    mm = InPort(TimedDouble, unit="mm")
    metres = InPort(TimedDouble, unit="m")
    volt = InPort(TimedDouble, unit="V")
    value = InPort(TimedDouble)
    two = InPort(TimedDoubleSeq, shape=(2,))

class Late(Component):
    def on_initialize(self):
        self.add_port("mm", InPort(TimedDouble, unit="mm"))
"""


def everything(kernel: Kernel) -> Any:
    """All that a connection could have changed."""
    places = {name: tuple(one.name for one in context.members) for name, context in kernel.contexts.items()}
    return list(kernel.components), list(kernel.connectors), places


async def system(kernel: Kernel) -> EventContext:
    source, sink = await kernel.create(Source, "a"), await kernel.create(Sink, "b")
    return await kernel.start(EventContext(name="c"), source, sink, activate=True)


async def through(kernel: Kernel, out: str, sample: Any, in_: str) -> Any:
    """What an in-port gets of a sample."""
    writer, reader = kernel.find(out), kernel.find(in_)
    assert isinstance(writer, OutPort)
    assert isinstance(reader, InPort)
    await writer.write(sample)
    async with asyncio.timeout(5.0):
        return await reader.read()


@pytest.mark.parametrize(
    ("out", "in_", "sample", "got"),
    [
        ("metres", "mm", TimedDouble(data=1.5), TimedDouble(data=1500.0)),
        ("metres", "whole", TimedDouble(data=2.0), TimedLong(data=2)),
        (
            "pose",
            "point",
            TimedPose2D(data=Pose2D(position=Point2D(x=1.0, y=2.0))),
            TimedPoint2D(data=Point2D(x=1.0, y=2.0)),
        ),
        (
            "three",
            "velocity",
            TimedDoubleSeq(data=[1.0, 2.0, 3.0]),
            TimedVelocity2D(data=Velocity2D(vx=1.0, vy=2.0, va=3.0)),
        ),
    ],
)
async def test_what_does_not_fit_goes_through_a_filter_in_the_readers_context(
    out: str, in_: str, sample: Any, got: Any
) -> None:
    async with Kernel() as kernel:
        context = await system(kernel)
        connector = await kernel.connect(f"a.{out}", f"b.{in_}", adapt=True, name="wire", length=5)
        name = f"a_to_b_{in_}"
        assert everything(kernel) == (
            ["a", "b", name],
            [f"a.{out}-{name}.input0", "wire"],
            {"c": ("a", name, "b")},
        )
        assert (connector.name, connector.profile.ports) == ("wire", (f"{name}.output0", f"b.{in_}"))
        assert [one.profile.length for one in kernel.connectors.values()] == [5, 5]
        assert type(kernel.components[name]).__name__ == "FlexiFilter"
        assert context.state(kernel.components[name]) is context.state(kernel.components["b"])
        assert await through(kernel, f"a.{out}", sample, f"b.{in_}") == got


async def test_ports_that_fit_are_connected_as_without_it() -> None:
    async with Kernel() as kernel:
        await system(kernel)
        await kernel.connect("a.metres", "b.metres", adapt=True)
        await kernel.connect("a.metres", "b.value", adapt="yes")  # type: ignore[call-overload]
        await kernel.connect("a.some", "b.two", adapt=True)
        assert list(kernel.components) == ["a", "b"]
        with pytest.raises(WiringError, match="adapt = 'maybe': expected true or false"):
            await kernel.connect("a.metres", "b.mm", adapt="maybe")  # type: ignore[call-overload]
        with pytest.raises(WiringError, match=r"^a\.metres -> b\.mm: units differ"):
            await kernel.connect("a.metres", "b.mm", adapt=False)


async def test_of_several_ports_only_those_that_do_not_fit_get_one() -> None:
    async with Kernel() as kernel:
        await system(kernel)
        made = await kernel.connect("a.metres", "b.metres", "b.mm", adapt=True, name="w")
        assert [one.profile.ports for one in made] == [("a.metres", "b.metres"), ("a_to_b_mm.output0", "b.mm")]
        assert [one.name for one in made] == ["w", "w-2"]
        made.close()
        assert list(kernel.connectors) == ["a.metres-a_to_b_mm.input0"]


REFUSED = [
    ("pose", "value", ["0:position.x>0 or by 0:position.y>0 or by 0:heading>0", "-i TimedPose2D"]),
    ("three", "two", ["0:0>0:0,0:1>0:1 or by 0:1>0:0,0:2>0:1", "-o TimedDoubleSeq:2"]),
    ("some", "value", ["how many elements a.some has is not known; declare a shape"]),
    ("metres", "some", ["how many elements b.some has is not known"]),
]


@pytest.mark.parametrize(("out", "in_", "words"), REFUSED)
async def test_what_is_not_plain_is_refused_with_all_that_it_could_be(out: str, in_: str, words: list[str]) -> None:
    async with Kernel() as kernel:
        await system(kernel)
        before = everything(kernel)
        with pytest.raises(WiringError) as caught:
            await kernel.connect(f"a.{out}", f"b.{in_}", adapt=True)
        assert [word for word in words if word not in str(caught.value)] == []
        assert everything(kernel) == before


@pytest.mark.parametrize(("out", "in_"), [("metres", "volt"), ("three", "four")])
async def test_where_nothing_helps_the_error_is_the_usual_one(out: str, in_: str) -> None:
    async with Kernel() as kernel:
        await system(kernel)
        before = everything(kernel)
        with pytest.raises(WiringError) as usual:
            await kernel.connect(f"a.{out}", f"b.{in_}")
        with pytest.raises(WiringError) as adapted:
            await kernel.connect(f"a.{out}", f"b.{in_}", adapt=True)
        assert str(adapted.value) == str(usual.value)
        assert everything(kernel) == before


async def test_what_fails_on_the_way_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    async with Kernel() as kernel:
        source, sink = await kernel.create(Source, "a"), await kernel.create(Sink, "b")
        before = everything(kernel)
        with pytest.raises(WiringError, match="b is in no context, where its FlexiFilter could run"):
            await kernel.connect(source.metres, sink.mm, adapt=True)
        assert everything(kernel) == before
        await kernel.start(EventContext(name="c"), source, activate=True)
        await kernel.start(ThreadContext(name="t", rate=50.0), sink)
        before = everything(kernel)
        with pytest.raises(StateError, match="the hooks of a thread context are plain `def`"):
            await kernel.connect(source.metres, sink.metres, sink.mm, adapt=True)
        assert everything(kernel) == before
        with pytest.raises(WiringError, match="convert makes them fit already"):
            await kernel.connect(source.metres, sink.mm, adapt=True, convert=lambda sample: sample)
        monkeypatch.setattr("aiorts.adapting.inserting.FILTER", "FlexiGone")
        with pytest.raises(PluginError, match="FlexiGone"):
            await kernel.connect(source.metres, sink.mm, adapt=True)
        assert everything(kernel) == before


async def test_a_hook_is_told_that_it_would_wait_for_itself() -> None:
    raised: list[BaseException] = []

    class Connecting(Sink):
        async def on_execute(self) -> None:
            if not raised:
                try:
                    await kernel.connect("a.metres", "b.mm", adapt=True)
                except StateError as error:
                    raised.append(error)

    async with Kernel() as kernel:
        members = await kernel.create(Source, "a"), await kernel.create(Connecting, "b")
        await kernel.start(PeriodicContext(rate=200.0, name="c"), *members, activate=True)
        async with asyncio.timeout(5.0):
            while not raised:
                await asyncio.sleep(0.005)
        assert "called by a hook" in str(raised[0])
        assert list(kernel.components) == ["a", "b"]


@pytest.mark.slow
async def test_a_caller_that_is_cancelled_leaves_all_of_it_or_nothing() -> None:
    for turns in range(12):
        async with Kernel() as kernel:
            await system(kernel)
            task = asyncio.ensure_future(kernel.connect("a.metres", "b.mm", adapt=True))
            for _ in range(turns):
                await asyncio.sleep(0)
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            components, connectors, places = everything(kernel)
            there = "a_to_b_mm" in components
            assert len(connectors) == (2 if there else 0)
            assert ("a_to_b_mm" in places["c"]) is there


async def test_a_reader_in_a_composite_has_its_filter_before_the_composite() -> None:
    async with Kernel() as kernel:
        source = await kernel.create(Source, "a")
        for name in ("first", "b"):
            await kernel.create(Sink, name)
        whole = await kernel.add(Composite("whole", "first", "b", exported=["b.mm"]))
        context = await kernel.start(EventContext(name="c"), source, whole, activate=True)
        await kernel.connect("a.metres", "whole.mm", adapt=True)
        assert [one.name for one in context.members] == ["a", "a_to_b_mm", "first", "b"]
        assert (await through(kernel, "a.metres", TimedDouble(data=2.0), "b.mm")).data == 2000.0


async def test_names_that_are_taken_get_a_number() -> None:
    async with Kernel() as kernel:
        await system(kernel)
        made: list[Connector] = [await kernel.connect("a.metres", "b.mm", adapt=True)]
        await kernel.create(Source, "c")
        made.append(await kernel.connect("a.metres", "b.mm", adapt=True))
        assert [one.out.path for one in made] == ["a_to_b_mm.output0", "a_to_b_mm2.output0"]


# -- in a system file --------------------------------------------------------------------------------------------------


def text(*connections: str, members: str = '"a", "b"', more: str = "") -> str:
    joined = "".join(f"[[connections]]\n{one}\n" for one in connections)
    return f"""schema = 1
[components.a]
type = "parts.py:Source"
[components.b]
type = "parts.py:Sink"
{more}
{joined}
[contexts.c]
kind = "event"
members = [{members}]
"""


def joined(out: str, in_: str, more: str = "") -> str:
    return f'from = "a.{out}"\nto = "b.{in_}"\nadapt = true\n{more}'


THREAD = """
[contexts.t]
kind = "thread"
rate = 5.0
members = ["b"]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(PARTS)
    return tmp_path / "system.toml"


async def test_a_file_has_the_filter_in_check_graph_plan_and_run_and_is_saved_with_it(file: Path) -> None:
    file.write_text(text(joined("metres", "mm", 'name = "wire"\nlength = 3'), joined("metres", "metres")))
    noted = [one for one in check(file) if one.severity != "note" or one.code == "N-ADAPT"]
    assert [(one.code, one.line, one.where) for one in noted] == [("N-ADAPT", 10, "connections[1].adapt")]
    assert "'a_to_b_mm' is put between a.metres and b.mm: FlexiFilter -i TimedDouble -o TimedDouble" in noted[0].cause
    assert "<b>a_to_b_mm</b><br/>FlexiFilter" in graph(load(file))
    saved = file.with_name("saved.toml")
    async with Kernel() as kernel:
        await build(kernel, load(file))
        assert everything(kernel) == (
            ["a", "b", "a_to_b_mm"],
            ["a.metres-a_to_b_mm.input0", "wire", "a.metres-b.metres"],
            {"c": ("a", "a_to_b_mm", "b")},
        )
        assert (await through(kernel, "a.metres", TimedDouble(data=2.0), "b.mm")).data == 2000.0
        assert (await kernel.apply(wanted(load(file)), dry_run=True)).plan.empty
        await kernel.save(saved)
        assert (await kernel.apply(wanted(load(saved)), dry_run=True)).plan.empty
    assert "adapt" not in saved.read_text()
    async with Kernel() as kernel:
        await build(kernel, load(saved))
        await kernel.save(file.with_name("again.toml"))
    assert file.with_name("again.toml").read_bytes() == saved.read_bytes()


async def test_a_plan_makes_what_a_connection_with_adapt_needs(file: Path) -> None:
    file.write_text(text(joined("metres", "metres")))
    async with Kernel() as kernel:
        await build(kernel, load(file))
        await kernel.apply(wanted(parse(text(joined("metres", "mm")), file)))
        assert everything(kernel) == (
            ["a", "b", "a_to_b_mm"],
            ["a.metres-a_to_b_mm.input0", "a_to_b_mm.output0-b.mm"],
            {"c": ("a", "a_to_b_mm", "b")},
        )
        await kernel.apply(wanted(load(file)))
        assert everything(kernel) == (["a", "b"], ["a.metres-b.metres"], {"c": ("a", "b")})


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (text(joined("pose", "value")), "value by 0:position.x>0 or by 0:position.y>0 or by 0:heading>0"),
        (text(joined("three", "two")), "all by 0:0>0:0,0:1>0:1 or by 0:1>0:0,0:2>0:1"),
        (text(joined("metres", "mm"), members='"a"'), "b is in no context, where its FlexiFilter could run"),
        (text(joined("metres", "mm", 'convert = "map 0>0"')), "convert makes them fit already"),
        (
            text(joined("metres", "mm")).replace("Sink", "Late"),
            "the ports of b are known only when it runs; put a FlexiFilter of your own between them",
        ),
        (
            text(joined("metres", "mm"), members='"a"', more=THREAD),
            "b runs in t, which cannot run a FlexiFilter",
        ),
    ],
)
async def test_what_cannot_be_is_said_at_its_line_by_check_and_by_run(file: Path, content: str, what: str) -> None:
    file.write_text(content)
    (error,) = [one for one in check(file) if one.severity == "error"]
    assert (error.where, error.quote) == ("connections[1].adapt", "adapt = true")
    assert what in error.message
    with pytest.raises(AiortsError) as refused:
        prepare(load(file))
    assert str(refused.value).startswith(f"{file}:{error.line}:1: connections[1].adapt: ")
    assert what in str(refused.value)


async def test_in_a_file_too_the_error_is_the_usual_one_where_nothing_helps(file: Path) -> None:
    file.write_text(text(joined("metres", "volt")))
    (error,) = [one for one in check(file) if one.severity == "error"]
    assert error.cause == "units differ: a.metres sends 'm', b.volt takes 'V'"
    async with Kernel() as kernel:
        with pytest.raises(WiringError, match="units differ"):
            await build(kernel, load(file))


async def test_a_wrong_value_and_adapt_of_a_rule_are_refused(file: Path) -> None:
    file.write_text(text(joined("metres", "mm")).replace("adapt = true", "adapt = 3"))
    (error,) = [one for one in check(file) if one.severity == "error" and one.quote == "adapt = 3"]
    assert "adapt = 3: expected true or false" in error.message
    file.write_text(text(more='[[rules]]\nfrom = "a.*"\nto = "b.*"\nadapt = true'))
    with pytest.raises(SystemFileError, match="a rule connects ports of one type"):
        prepare(load(file))


async def test_no_plugin_offers_the_filter(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("aiorts.system.checks.adapting.FILTER", "FlexiGone")
    file.write_text(text(joined("metres", "mm")))
    (error,) = [one for one in check(file) if one.severity == "error"]
    assert error.code == PluginError.code
    assert "no plugin offers the type 'FlexiGone'" in error.message


async def test_included_repeated_and_composite_readers_have_theirs(file: Path) -> None:
    file.with_name("pair.toml").write_text(text(joined("metres", "mm"), members='"a", "b"'))
    file.write_text('schema = 1\n[[include]]\nfile = "pair.toml"\nprefix = "left_"\n')
    assert "left_a_to_left_b_mm" in prepare(load(file)).types
    composite = '[composites.whole]\nmembers = ["b"]\nexported = ["b.mm"]'
    file.write_text(text('from = "a.metres"\nto = "whole.mm"\nadapt = true', members='"a", "whole"', more=composite))
    assert [one for one in check(file) if one.severity in ("error", "warning")] == []
    async with Kernel() as kernel:
        await build(kernel, load(file))
        assert everything(kernel)[2] == {"c": ("a", "a_to_b_mm", "b")}
        assert (await kernel.apply(wanted(load(file)), dry_run=True)).plan.empty


@pytest.mark.slow(kept_by="test_a_file_has_the_filter_in_check_graph_plan_and_run_and_is_saved_with_it")
async def test_a_program_and_a_file_agree_on_every_pair_of_ports(file: Path) -> None:
    outs = ("metres", "pose", "three", "some")
    ins = (
        *("mm", "metres", "volt", "whole", "point", "velocity", "heading"),
        *("value", "two", "four", "some"),
    )
    for out in outs:
        for in_ in ins:
            content = text(joined(out, in_)).replace("parts.py:", f"{__name__}:")
            file.write_text(content)
            found = [one for one in check(file) if one.severity == "error"]
            async with Kernel() as kernel, Kernel() as built:
                await system(kernel)
                before = everything(kernel)
                try:
                    await kernel.connect(f"a.{out}", f"b.{in_}", adapt=True)
                except WiringError:
                    assert found != [], (out, in_)
                    assert everything(kernel) == before
                else:
                    assert found == [], (out, in_)
                    await build(built, load(file))
                    assert everything(built) == everything(kernel)


# -- units with an offset, and texts -----------------------------------------------------------------------------------

SCALES = ("K", "mK", "degC", "°C", "degF", "°F")


def exactly(value: Fraction, unit: str, wanted: str) -> Fraction:
    """By the definitions of the scales."""
    kelvin = {
        "K": value,
        "mK": value / 1000,
        "degC": value + Fraction(27315, 100),
        "degF": (value + Fraction(45967, 100)) * Fraction(5, 9),
    }[unit.replace("°", "deg")]
    return {
        "K": kelvin,
        "mK": kelvin * 1000,
        "degC": kelvin - Fraction(27315, 100),
        "degF": kelvin * Fraction(9, 5) - Fraction(45967, 100),
    }[wanted.replace("°", "deg")]


def filtered(text: str, value: Any, source: Any = TimedDouble, target: Any = TimedDouble) -> Any:
    return conversion_of(text, source, target)(source(data=value)).data


@given(unit=st.sampled_from(SCALES), wanted=st.sampled_from(SCALES), value=st.floats(-1e9, 1e9))
def test_a_temperature_is_converted_exactly_and_back(unit: str, wanted: str, value: float) -> None:
    found, back = conversion(unit, wanted), conversion(wanted, unit)
    assert found is not None
    assert back is not None
    assert found[0] * back[0] == 1
    assert found[1] * back[0] + back[1] == 0
    one = between(OutPort(TimedDouble, unit=unit), InPort(TimedDouble, unit=wanted))
    assert one is not None
    if found[1]:  # a factor alone is a float, as ever
        assert filtered(one.entries, value) == float(exactly(Fraction(value), unit, wanted))


@pytest.mark.parametrize(
    ("unit", "wanted", "value", "got"),
    [
        ("degC", "K", 0.0, 273.15),
        ("K", "degC", 273.15, 0.0),
        ("degF", "degC", 32.0, 0.0),
        ("degF", "degC", 212.0, 100.0),
        ("degC", "degF", 100.0, 212.0),
        ("degC", "degF", -40.0, -40.0),
        ("degF", "K", -459.67, 0.0),
        ("degC", "mK", 0.0, 273150.0),
        ("K", "mK", 1.5, 1500.0),
    ],
)
async def test_a_temperature_arrives_in_the_unit_of_the_reader(
    unit: str, wanted: str, value: float, got: float
) -> None:
    class Thermometer(Component):
        value = OutPort(TimedDouble, unit=unit)
        whole = OutPort(TimedLong, unit=unit)

    class Display(Component):
        value = InPort(TimedDouble, unit=wanted)

    async with Kernel() as kernel:
        one, two = await kernel.create(Thermometer, "a"), await kernel.create(Display, "b")
        await kernel.start(EventContext(), one, two, activate=True)
        await kernel.connect("a.value", "b.value", adapt=True)
        found = (await through(kernel, "a.value", TimedDouble(data=value), "b.value")).data
        assert found == pytest.approx(got, rel=1e-15, abs=1e-13)
        if value not in (273.15, -459.67):  # which no float is
            assert found == got


def test_infinity_and_nan_stay_what_they_are_and_whole_numbers_whole() -> None:
    assert filtered("0>1+5463/20>0", math.inf) == math.inf
    assert math.isnan(filtered("0>5/9-160/9>0", math.nan))
    assert filtered("0>5/9-160/9>0", 41, TimedLong, TimedLong) == 5


TEXTS: list[tuple[Any, Any, bool]] = [
    (TimedString, TimedDouble, True),
    (TimedString, TimedLong, True),
    (TimedString, TimedBoolean, True),
    (TimedString, TimedChar, True),
    (str, TimedDouble, True),
    (str, float, True),
    (TimedChar, TimedDouble, True),
    (TimedDouble, TimedString, False),
    (TimedChar, TimedString, False),
    (TimedString, str, False),
]


@pytest.mark.parametrize(("source", "target", "refused"), TEXTS)
async def test_a_number_is_made_of_a_text_only_where_the_connection_says_so(
    source: Any, target: Any, refused: bool
) -> None:
    class Writer(Component):
        value = OutPort(source)

    class Reader(Component):
        value = InPort(target)

    async with Kernel() as kernel:
        one, two = await kernel.create(Writer, "a"), await kernel.create(Reader, "b")
        await kernel.start(EventContext(name="c"), one, two, activate=True)
        before = everything(kernel)
        if refused:
            with pytest.raises(WiringError, match=r'made of a text.*adapt = "text"'):
                await kernel.connect("a.value", "b.value", adapt=True)
            assert everything(kernel) == before
        await kernel.connect("a.value", "b.value", adapt="text" if refused else True)
        assert len(kernel.components) == 3


async def test_a_text_in_a_record_and_in_a_sequence_is_one_too() -> None:
    @record
    class Named:
        x: str = ""

    class Writer(Component):
        named = OutPort(Named)
        words = OutPort(TimedStringSeq, shape=(2,))

    class Reader(Component):
        point = InPort(TimedPoint2D)
        two = InPort(TimedDoubleSeq, shape=(2,))

    async with Kernel() as kernel:
        one, two = await kernel.create(Writer, "a"), await kernel.create(Reader, "b")
        await kernel.start(EventContext(), one, two, activate=True)
        for ports in (("a.named", "b.point"), ("a.words", "b.two")):
            with pytest.raises(WiringError, match="made of a text"):
                await kernel.connect(*ports, adapt=True)


@pytest.mark.parametrize("value", ["text", "Text", "true", "maybe"])
def test_a_file_says_that_a_text_is_a_number(value: str, tmp_path: Path) -> None:
    (tmp_path / "parts.py").write_text(
        "from aiorts import Component, InPort, OutPort\n"
        "from aiorts.types import TimedDouble, TimedString\n"
        "class A(Component):\n    value = OutPort(TimedString)\n"
        "class B(Component):\n    value = InPort(TimedDouble)\n"
    )
    file = tmp_path / "system.toml"
    file.write_text(
        'schema = 1\n[components.a]\ntype = "parts.py:A"\n[components.b]\ntype = "parts.py:B"\n'
        f'[[connections]]\nfrom = "a.value"\nto = "b.value"\nadapt = "{value}"\n'
        '[contexts.c]\nkind = "event"\nmembers = ["a", "b"]\n'
    )
    said = [one for one in check(file) if one.severity == "error"]
    if value.lower() == "text":
        assert said == []
    else:
        assert ('adapt = "text"' if value == "true" else '"text"') in " ".join(one.message for one in said)
