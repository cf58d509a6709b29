"""`component(function)`: ports and parameters by type hints, when it is called, and that nothing is lost on the way."""

from __future__ import annotations

import asyncio
import functools
import math
import pickle
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Component, EventContext, InPort, Kernel, OutPort, Param, PeriodicContext, ThreadContext, component
from aiorts.errors import ConfigurationError, DeclarationError, PortTypeError
from aiorts.functions.function_component import kind_of
from aiorts.model.lifecycle import LifecycleState
from aiorts.testing import Rig, simulate, simulated
from aiorts.types import (
    TimedBoolean,
    TimedDouble,
    TimedDoubleSeq,
    TimedFloat,
    TimedLong,
    TimedLongLong,
    TimedMap,
    TimedNDArray,
    TimedOctetSeq,
    TimedString,
    TimedStringSeq,
    TimedVelocity2D,
    i32,
    u8,
)
from campaign import cases


def add(a: float, b: float) -> float:
    """The sum."""
    return a + b


Adder = component(add)


@component
def scale(a: float, *, gain: float = Param(2.0, ge=0.0, le=10.0, unit="V"), offset: float = 0.0) -> float:
    """Times `gain`."""
    return a * gain + offset


@dataclass(frozen=True)
class Reading:
    """A record of the user's own."""

    tm: int = 0
    celsius: float = 0.0


class Polar(NamedTuple):
    """Two results with names."""

    r: float
    phi: float


def of(cls: type[Component]) -> dict[str, type[Any]]:
    return {name: port.type for name, port in cls("draft").ports.items()}


# -- what a signature says ---------------------------------------------------------------------------------------------


def test_parameters_are_in_ports_and_the_result_is_the_out_port() -> None:
    assert of(Adder) == {"a": TimedDouble, "b": TimedDouble, "output": TimedDouble}
    assert [port.direction for port in Adder("adder0").ports.values()] == ["in", "in", "out"]


@pytest.mark.parametrize(
    ("hint", "carrier"),
    [
        (float, TimedDouble),
        (int, TimedLongLong),
        (bool, TimedBoolean),
        (str, TimedString),
        (bytes, bytes),
        (i32, TimedLong),
        (float | None, TimedDouble),
        (list[float], TimedDoubleSeq),
        (tuple[float, ...], TimedDoubleSeq),
        (list[str], TimedStringSeq),
        (list[u8], TimedOctetSeq),
        (np.ndarray, TimedNDArray),
        (np.typing.NDArray[np.float64], TimedNDArray),
        (dict[str, float], TimedMap),
        (TimedVelocity2D, TimedVelocity2D),
        (Reading, Reading),
        (Annotated[float, InPort(TimedFloat, unit="m")], TimedFloat),
    ],
)
def test_a_hint_stands_for_the_record_that_carries_it(hint: Any, carrier: type[Any]) -> None:
    made = component(lambda x: None, hints={"x": hint, "return": None}, name="taker")
    assert of(made) == {"x": carrier}


@pytest.mark.parametrize(
    ("hint", "value", "given"),
    [
        (float, 1.5, float),
        (list[float], [1.0, 2.0], list),
        (tuple[float, ...], (1.0, 2.0), tuple),
        (list[str], ["a", "b"], list),
        (dict[str, float], {"a": 1.0}, dict),
        (bytes, b"ab", bytes),
        (TimedVelocity2D, TimedVelocity2D(7), TimedVelocity2D),
    ],
)
@simulated
async def test_an_argument_has_the_type_that_the_hint_says(hint: Any, value: Any, given: type[Any]) -> None:
    got: list[Any] = []

    def echo(x: Any) -> Any:
        got.append(x)
        return x

    async with Rig(component(echo, hints={"x": hint, "return": hint})("echo0")) as rig:
        rig.feed("x", value)
        await rig.tick()
        assert type(got[0]) is given
        assert got == [value]
        assert len(rig.values("output")) == 1


def test_metadata_gives_units_shapes_and_record_types() -> None:
    @component
    def fuse(
        left: Annotated[float, InPort(TimedFloat, unit="m")],
    ) -> Annotated[list[float], OutPort(TimedDoubleSeq, unit="m", shape=(2,), doc="both")]:
        return [left, left]

    made = fuse("fuse0")
    assert (made.left.unit, made.left.type) == ("m", TimedFloat)
    assert (made.output.unit, made.output.shape, made.output.doc) == ("m", (2,), "both")


def test_several_results_have_a_port_each() -> None:
    assert list(of(component(divmod, hints={"x": int, "y": int, "return": tuple[int, int]}))) == [
        "x",
        "y",
        "output0",
        "output1",
    ]
    named = component(lambda x: None, hints={"x": float, "return": Polar}, name="polar")
    assert list(of(named)) == ["x", "r", "phi"]
    chosen = component(lambda x: None, hints={"x": float, "return": tuple[int, str]}, name="p", output=("n", "text"))
    assert of(chosen) == {"x": TimedDouble, "n": TimedLongLong, "text": TimedString}


def test_it_is_still_the_function_and_says_what_it_is() -> None:
    assert Adder.function(1.0, 2.0) == 3.0
    assert scale.function(3.0) == 6.0
    assert scale.function(3.0, gain=1.0) == 3.0
    assert (Adder.__name__, Adder.__doc__, Adder.__module__) == ("add", "The sum.", __name__)
    assert repr(Adder) == f"<component type {__name__}.add(a, b) -> output>"
    assert repr(Adder("adder0")) == "<add adder0 3 ports>"


def test_the_type_can_be_pickled() -> None:
    assert pickle.loads(pickle.dumps(scale)) is scale
    again = pickle.loads(pickle.dumps(component(add, when="all", output="sum")))
    assert of(again) == {"a": TimedDouble, "b": TimedDouble, "sum": TimedDouble}
    kind = kind_of(again)
    assert kind is not None
    assert kind.options["when"] == "all"


def test_methods_partials_and_functions_without_hints_serve_as_well() -> None:
    class Robot:
        offset = 10.0

        def place(self, x: float) -> float:
            return x + self.offset

    assert of(component(Robot().place)) == {"x": TimedDouble, "output": TimedDouble}
    assert component(functools.partial(add, b=1.0))("p").params["b"].value == 1.0
    assert of(component(lambda a, b=1.0: a, hints={"a": float, "return": None}, name="left")) == {"a": TimedDouble}
    assert of(component(math.sqrt, hints={"x": float, "return": float})) == {"x": TimedDouble, "output": TimedDouble}


def no_hint(a) -> float:  # type: ignore[no-untyped-def]
    return float(a)


def no_result(a: float):  # type: ignore[no-untyped-def]
    return a


def variable(*values: float) -> float:
    return sum(values)


def unsupported(a: complex) -> float:
    return a.real


def union(a: int | str) -> None: ...


def lax(a: float, b=1.0) -> float:  # type: ignore[no-untyped-def]
    return a + b  # type: ignore[no-any-return]


def required(*, gain: float) -> float:
    return gain


def taken(name: str) -> None: ...


def generates(a: float) -> float:  # type: ignore[misc]
    yield a


def clash(output: float) -> float:
    return output


@pytest.mark.fault("A19")
@pytest.mark.parametrize(
    ("function", "message"),
    [
        (no_hint, r"component\(no_hint\): parameter a has no type hint; allowed: float, int"),
        (no_result, r"component\(no_result\): the result has no type hint; write -> None, or: float"),
        (lax, r"component\(lax\): parameter b has no type hint"),
        (variable, r"component\(variable\): \*values: .*write the parameters out"),
        (unsupported, r"component\(unsupported\): parameter a: complex cannot travel; allowed: float"),
        (union, r"component\(union\): parameter a: int \| str cannot travel"),
        (required, r"component\(required\): gain is keyword-only.*needs a default"),
        (taken, r"taken\.name: Component has a name of its own"),
        (generates, r"component\(generates\): is a generator; its result is Iterator\[TYPE\], got float"),
        (clash, r"component\(clash\): output is a parameter and an out-port"),
        (math.sqrt, r"component\(sqrt\): parameter x has no type hint"),
        (Polar, r"component\(Polar\): expected a function or a method, got a class"),
        (7, r"component\(int\): expected a function or a method, got an object of int"),
    ],
)
def test_what_does_not_fit_is_refused_where_it_is_defined(function: Any, message: str) -> None:
    with pytest.raises(DeclarationError, match=message) as caught:
        component(function)
    assert len(str(caught.value)) <= 240


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"when": "sometimes"}, r"when='sometimes': expected any, all, cycle"),
        ({"output": ("x", "y")}, r"2 names for 1 results"),
        ({"hints": {"c": float}}, r"hints\['c'\]: no such parameter; there are a, b, return"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(DeclarationError, match=message):
        component(add, **options)


# -- when it is called -------------------------------------------------------------------------------------------------


@simulated
async def test_every_sample_of_one_input_is_worked_on_with_its_own_time() -> None:
    async with Rig(scale("scale0")) as rig:
        rig.feed("a", TimedDouble(5, 1.0), TimedDouble(7, 2.0), TimedDouble(9, 3.0))
        await rig.tick()
        assert rig.received("output") == [TimedDouble(5, 2.0), TimedDouble(7, 4.0), TimedDouble(9, 6.0)]


class Model:
    """What a function of two inputs is to be called with, from the words of `component`."""

    def __init__(self, when: str, latest: bool) -> None:
        self.when, self.latest = when, latest or when == "cycle"
        self.queues: list[list[tuple[int, float]]] = [[], []]
        self.last: list[tuple[int, float] | None] = [None, None]
        self.calls: list[tuple[float, float]] = []

    def cycle(self) -> None:
        while self.due():
            unknown = None in self.last
            for number in self.all_or_oldest(unknown):
                queue = self.queues[number]
                if queue:
                    self.last[number] = queue[-1] if self.latest else queue[0]
                    del queue[: len(queue) if self.latest else 1]
            self.calls.append((self.last[0][1], self.last[1][1]))  # type: ignore[index]
            if self.latest:
                return

    def all_or_oldest(self, unknown: bool) -> list[int]:
        if unknown or self.latest or self.when == "all":
            return [0, 1]
        return [min((number for number in (0, 1) if self.queues[number]), key=lambda n: self.queues[n][0][0])]

    def due(self) -> bool:
        fresh = [bool(queue) for queue in self.queues]
        if self.when == "all":
            return all(fresh)
        known = all(new or last is not None for new, last in zip(fresh, self.last, strict=True))
        return known and (any(fresh) or self.when == "cycle")


@pytest.mark.slow(kept_by="test_every_sample_makes_a_call_with_those_that_were_the_last_at_its_time")
@given(
    when=st.sampled_from(["any", "all", "cycle"]),
    latest=st.booleans(),
    steps=st.lists(st.tuples(st.sampled_from("ab."), st.integers(0, 9)), max_size=30),
)
@settings(max_examples=cases(5000), deadline=None)
def test_calls_of_two_inputs_are_those_that_the_option_promises(when: Any, latest: bool, steps: list[Any]) -> None:
    async def main(_clock: object) -> None:
        seen: list[tuple[float, float]] = []

        def note(a: float, b: float) -> None:
            seen.append((a, b))

        model = Model(when, latest)
        async with Rig(component(note, when=when, latest=latest)("note0")) as rig:
            for number, (step, tm) in enumerate(steps):
                if step == ".":
                    await rig.tick()
                    model.cycle()
                else:
                    rig.feed(step, TimedDouble(tm=tm, data=float(number)))
                    model.queues["ab".index(step)].append((tm, float(number)))
            assert seen == model.calls
            for port, queue in zip(rig.components[0].ports.values(), model.queues, strict=True):
                assert [(sample.tm, sample.data) for sample in port.drain()] == queue  # type: ignore[attr-defined]

    simulate(main)


@simulated
async def test_every_sample_makes_a_call_with_those_that_were_the_last_at_its_time() -> None:
    calls: list[tuple[float, float]] = []

    def note(a: float, b: float) -> None:
        calls.append((a, b))

    async with Rig(component(note)("note0")) as rig:
        rig.feed("a", *(TimedDouble(tm=tm, data=float(tm)) for tm in (1, 2, 12, 13)))
        rig.feed("b", *(TimedDouble(tm=tm, data=float(tm)) for tm in (1, 11, 12)))
        await rig.tick()
        assert calls == [(1, 1), (2, 1), (2, 11), (12, 11), (12, 12), (13, 12)]


@simulated
async def test_samples_without_time_stamps_are_taken_in_the_order_of_the_ports_and_none_is_lost() -> None:
    calls: list[tuple[bytes, float]] = []

    def note(a: bytes, b: float) -> None:
        calls.append((a, b))

    async with Rig(component(note)("note0")) as rig:
        rig.feed("a", b"1", b"2", b"3")
        rig.feed("b", *(TimedDouble(tm=tm, data=float(tm)) for tm in (1, 2)))
        await rig.tick()
        assert calls == [(b"1", 1), (b"2", 1), (b"3", 1), (b"3", 2)]


@simulated
async def test_a_positional_parameter_with_a_default_is_not_waited_for() -> None:
    @component
    def biased(a: float, bias: float = 100.0) -> float:
        return a + bias

    async with Rig(biased("biased0")) as rig:
        rig.feed("a", 1.0)
        await rig.tick()
        rig.feed("bias", 10.0)
        await rig.tick()
        assert rig.values("output") == [101.0, 11.0]


@simulated
async def test_a_result_has_the_time_of_its_newest_argument_or_of_the_clock() -> None:
    @component
    def constant() -> float:
        return 1.0

    async with Rig(Adder("adder0"), constant("constant0")) as rig:
        rig.feed("a", TimedDouble(5, 1.0), TimedDouble(9, 2.0))
        rig.feed("b", TimedDouble(7, 10.0))
        await rig.tick()
        assert rig.received("adder0.output") == [TimedDouble(7, 11.0), TimedDouble(9, 12.0)]
        assert rig.received("constant0.output") == [TimedDouble(rig.clock.time_ns(), 1.0)]


@simulated
async def test_none_sends_nothing_also_for_one_of_several() -> None:
    @component
    def positive(a: float) -> tuple[float | None, bool]:
        return (a if a > 0 else None), a > 0

    async with Rig(positive("positive0")) as rig:
        rig.feed("a", 1.0, -1.0, 2.0)
        await rig.tick()
        assert rig.values("output0") == [1.0, 2.0]
        assert rig.values("output1") == [True, False, True]


@simulated
async def test_of_one_input_and_output_too_none_sends_nothing() -> None:
    @component
    def positive(a: float) -> float | None:
        return a if a > 0 else None

    async with Rig(positive("positive0")) as rig:
        rig.feed("a", 1.0, -1.0, 2.0)
        await rig.tick()
        assert rig.values("output") == [1.0, 2.0]


@simulated
async def test_an_activation_knows_no_samples_of_the_one_before() -> None:
    async with Rig(Adder("adder0")) as rig:
        rig.feed("a", 1.0)
        rig.feed("b", 2.0)
        await rig.tick()
        await rig.context.deactivate()
        await rig.context.activate()
        rig.feed("a", 5.0)
        await rig.tick()
        assert rig.values("output") == [3.0]


@simulated
async def test_what_arrives_during_a_cycle_is_for_the_next_also_from_itself() -> None:
    @component
    def following(a: float) -> float:
        return a + 1.0

    async with Rig(following("following0")) as rig:
        rig.connect("output", "a")
        rig.feed("a", 0.0)
        for expected in ([1.0], [1.0, 2.0], [1.0, 2.0, 3.0]):
            async with asyncio.timeout(10):
                await rig.tick()
            assert rig.values("output") == expected


@simulated
async def test_parameters_change_between_cycles_and_keep_their_bounds() -> None:
    async with Rig(scale("scale0")) as rig:
        made = rig.components[0]
        rig.feed("a", 1.0)
        await rig.tick()
        await made.configure(gain=3.0, offset=0.5)
        rig.feed("a", 1.0)
        await rig.tick()
        assert rig.values("output") == [2.0, 3.5]
        with pytest.raises(ConfigurationError, match=r"gain.*must be <= 10\.0"):
            await made.configure(gain=11.0)
        assert made.params["gain"].unit == "V"


@simulated
async def test_an_asynchronous_function_is_awaited_and_keeps_the_order() -> None:
    @component
    async def late(a: float) -> float:
        await asyncio.sleep(3.0 - a)
        return a

    async with Rig(late("late0")) as rig:
        rig.feed("a", 1.0, 2.0, 3.0)
        await rig.tick()
        assert rig.values("output") == [1.0, 2.0, 3.0]


# -- generators --------------------------------------------------------------------------------------------------------


@component
def three() -> Iterator[int]:
    """A source."""
    yield from range(3)


@component
async def three_later() -> AsyncIterator[int]:
    """A source that waits."""
    for number in range(3):
        await asyncio.sleep(0.5)
        yield number


@pytest.mark.parametrize("source", [three, three_later])
@simulated
async def test_a_generator_is_a_source_of_one_sample_a_cycle(source: type[Component]) -> None:
    async with Rig(source("source0")) as rig:
        await rig.tick()
        assert rig.values("output") == [0]
        for _ in range(3):
            await rig.tick()
        assert rig.values("output") == [0, 1, 2]
        assert rig.components[0].has_finished
        await rig.context.activate()
        await rig.tick()
        assert rig.values("output") == [0, 1, 2, 0]


@pytest.mark.parametrize("source", [three, three_later])
@simulated
async def test_in_an_event_context_a_source_is_as_fast_as_its_reader_takes_it(source: type[Component]) -> None:
    async with Kernel() as kernel:
        seen: list[int] = []

        async def slow(x: int) -> None:
            await asyncio.sleep(1.0)
            seen.append(x)

        made = await kernel.create(source)
        reader = await kernel.create(component(slow))
        connector = await kernel.connect(made.ports["output"], reader.ports["x"], length=1, full="block", timeout=None)
        await kernel.start(EventContext(), reader, activate=True)
        await kernel.start(EventContext(), made, activate=True)
        await kernel.sleep(10.0)
        assert seen == [0, 1, 2]
        assert made.has_finished
        assert connector.statistics.dropped == {}


@simulated
async def test_a_generator_with_inputs_sends_all_that_it_yields() -> None:
    @component
    def words(text: str) -> Iterator[str]:
        yield from text.split()

    @component
    async def letters(text: str) -> AsyncIterator[str]:
        for letter in text:
            yield letter

    async with Rig(words("words0"), letters("letters0")) as rig:
        rig.feed("words0.text", "to be", "or not")
        rig.feed("letters0.text", "ab", "", "c")
        await rig.tick()
        assert rig.values("words0.output") == ["to", "be", "or", "not"]
        assert rig.values("letters0.output") == ["a", "b", "c"]


@simulated
async def test_a_source_that_is_stopped_is_closed() -> None:
    closed: list[str] = []

    @component
    def plain() -> Iterator[int]:
        try:
            while True:
                yield 1
        finally:
            closed.append("plain")

    @component
    async def waiting() -> AsyncIterator[int]:
        try:
            while True:
                yield 1
        finally:
            await asyncio.sleep(0.1)
            closed.append("waiting")

    async with Rig(plain("plain0"), waiting("waiting0")) as rig:
        await rig.tick()
    assert sorted(closed) == ["plain", "waiting"]


# -- what goes wrong ---------------------------------------------------------------------------------------------------


@pytest.mark.fault("A01")
@simulated
async def test_an_exception_of_the_function_moves_the_component_to_error() -> None:
    @component
    def inverse(a: float) -> float:
        return 1.0 / a

    async with Rig(inverse("inverse0"), scale("scale0"), strict=False) as rig:
        rig.feed("inverse0.a", 2.0, 0.0, 4.0)
        rig.feed("scale0.a", 1.0)
        await rig.tick()
        failed = rig.components[0]
        assert failed.state is LifecycleState.ERROR
        assert isinstance(failed.last_error, ZeroDivisionError)
        assert rig.values("inverse0.output") == [0.5]
        assert rig.values("scale0.output") == [2.0]
        await rig.context.reset()
        await rig.context.activate(failed)
        rig.feed("inverse0.a", 4.0)
        await rig.tick()
        assert rig.values("inverse0.output") == [0.5, 0.25]


@pytest.mark.parametrize(
    ("hint", "result", "message"),
    [
        (float, "far", r"wrong0\.output: .* returned 'far': TimedDouble\.data: expected .*nothing was sent"),
        (int, 2**63, r"wrong0\.output: .* returned 9223372036854775808: TimedLongLong\.data"),
        (tuple[float, float], (1.0,), r"wrong0: .* returned \(1\.0,\); expected 2 results in a tuple"),
        (None, 1.0, r"wrong0: .* returned 1\.0; expected None"),
        (Reading, 1.0, r"wrong0\.output: expected a (\S+\.)?Reading, got float"),
    ],
)
@simulated
async def test_a_wrong_result_is_an_error_that_names_port_and_function(hint: Any, result: Any, message: str) -> None:
    made = component(lambda a: result, hints={"a": float, "return": hint}, name="wrong")
    async with Rig(made("wrong0"), strict=False) as rig:
        rig.feed("a", 1.0)
        await rig.tick()
        with pytest.raises(PortTypeError, match=message):
            raise rig.components[0].last_error or AssertionError


# -- wherever it runs --------------------------------------------------------------------------------------------------


def run_in(context: Any, function: Callable[..., Any], take: int) -> list[Any]:
    """The results of a component of `function` fed by a source, in this context."""

    async def main() -> list[Any]:
        got: list[Any] = []
        done = asyncio.Event()

        def collect(x: float) -> None:
            got.append(x)
            if len(got) % take == 0:
                done.set()

        def numbers() -> Iterator[float]:
            yield from (float(number) for number in range(take))

        async with Kernel() as kernel:
            source = await kernel.create(component(numbers))
            made = await kernel.create(component(function))
            sink = await kernel.create(component(collect))
            ways: dict[str, Any] = {"length": 2, "full": "block", "timeout": None}
            await kernel.connect(source.output, made.x, **ways)
            await kernel.connect(made.output, sink.x, **ways)
            await kernel.start(EventContext(), sink, activate=True)
            await kernel.start(context, made, activate=True)
            starts = await kernel.start(EventContext(), source, activate=True)
            async with asyncio.timeout(20):
                await done.wait()
            assert made.state is LifecycleState.ACTIVE
            await context.stop()
            await kernel.start(EventContext(), made, activate=True)
            done.clear()
            await starts.activate(source)
            async with asyncio.timeout(20):
                await done.wait()
        return got

    return asyncio.run(main())


@pytest.mark.parametrize(
    "context", [EventContext(), PeriodicContext(rate=500.0), ThreadContext(), ThreadContext(rate=500.0)], ids=str
)
def test_a_plain_function_runs_in_any_context_and_loses_nothing(context: Any) -> None:
    threads = set()

    def double(x: float) -> float:
        threads.add(threading.current_thread() is threading.main_thread())
        return 2.0 * x

    assert run_in(context, double, 40) == [2.0 * number for number in range(40)] * 2
    assert threads == ({False, True} if isinstance(context, ThreadContext) else {True})


def test_in_a_thread_a_source_and_several_inputs_work_as_well() -> None:
    async def main() -> None:
        got: list[float] = []
        async with Kernel() as kernel:
            numbers = await kernel.create(component(range_of, name="numbers"))
            adder = await kernel.create(component(add, when="all"))
            sink = await kernel.create(component(got.append, hints={"object": float, "return": None}))
            for port in (adder.a, adder.b):
                await kernel.connect(numbers.output, port, length=1, full="block", timeout=None)
            await kernel.connect(adder.output, sink.object, length=1, full="block", timeout=None)
            await kernel.start(EventContext(), sink, activate=True)
            await kernel.start(ThreadContext(), adder, activate=True)
            await kernel.start(ThreadContext(), numbers, activate=True)
            async with asyncio.timeout(20):
                while len(got) < 20 or not numbers.has_finished:  # its thread sees the end in a cycle of its own
                    await asyncio.sleep(0.01)
            assert got == [2.0 * number for number in range(20)]
            assert numbers.has_finished

    asyncio.run(main())


@pytest.mark.slow
def test_in_a_thread_a_stop_waits_for_one_call_not_for_all_that_is_unread() -> None:
    calls: list[float] = []

    def slow(a: float) -> None:
        time.sleep(0.05)
        calls.append(a)

    async def main() -> None:
        async with Kernel() as kernel:
            source = await kernel.create(component(range_of))
            made = await kernel.create(component(slow))
            connector = await kernel.connect(source.output, made.a, length=100)
            context = await kernel.start(ThreadContext(), made, activate=True)
            await kernel.start(EventContext(), source, activate=True)
            while not calls:
                await asyncio.sleep(0.01)
            await context.stop()
            assert len(calls) < 20
            ledger = connector.statistics
            assert ledger.delivered == len(calls)
            assert ledger.balanced
            assert made.last_error is None

    asyncio.run(main())


@pytest.mark.slow
@pytest.mark.parametrize("function", [add, math.sqrt])
def test_in_a_thread_without_a_rate_one_that_has_nothing_to_do_rests(function: Any) -> None:
    async def main() -> int:
        async with Kernel() as kernel:
            hints = {"x": float, "return": float} if function is math.sqrt else None
            context = await kernel.start(ThreadContext(), await kernel.create(component(function, hints=hints)))
            await context.activate()
            before = context.ticks
            await asyncio.sleep(0.2)
            return context.ticks - before

    assert asyncio.run(main()) <= 250  # a busy loop makes tens of thousands


@pytest.mark.parametrize("simulating", [False, True])
def test_in_a_thread_without_a_rate_several_share_it_and_nobody_holds_up_the_others(simulating: bool) -> None:
    async def main() -> None:
        got: list[float] = []
        async with Kernel() as kernel:
            numbers = await kernel.create(component(range_of, name="numbers"))
            double = await kernel.create(component(math.sqrt, hints={"x": float, "return": float}, name="root"))
            sink = await kernel.create(component(got.append, hints={"object": float, "return": None}))
            await kernel.connect(numbers.output, double.x, length=100)
            ledger = await kernel.connect(double.output, sink.object, length=100)
            context = await kernel.start(ThreadContext(), double, sink, activate=True)
            await kernel.start(EventContext(), numbers, activate=True)
            async with asyncio.timeout(20):
                while len(got) < 20:
                    await kernel.sleep(0.01)
            assert got == [math.sqrt(number) for number in range(20)]
            assert ledger.statistics.delivered == 20
            assert ledger.statistics.balanced
            await context.deactivate()

    simulate(main()) if simulating else asyncio.run(main())


@pytest.mark.parametrize("simulating", [False, True])
def test_in_a_thread_one_that_waits_for_data_takes_requests(simulating: bool) -> None:
    async def main() -> None:
        async with Kernel() as kernel:
            alone = await kernel.create(component(math.sqrt, hints={"x": float, "return": float}))
            context = await kernel.start(ThreadContext(), alone, activate=True)
            for _ in range(3):
                await kernel.sleep(0.05)  # it rests
                await context.deactivate(timeout=5.0)
                assert context.state(alone) is LifecycleState.INACTIVE
                await context.activate(timeout=5.0)
            await kernel.sleep(0.05)
            other = await kernel.create(component(math.sqrt, hints={"x": float, "return": float}, name="other"))
            await context.add(other)
            await context.activate(other, timeout=5.0)
            assert context.state(other) is LifecycleState.ACTIVE

    simulate(main()) if simulating else asyncio.run(main())


def range_of() -> Iterator[float]:
    """Twenty numbers."""
    yield from (float(number) for number in range(20))
