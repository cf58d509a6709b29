"""The conformance suites accept what ships with aiorts and refuse what breaks one promise, by the check's name."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from typing import Any

import pytest

from aiorts import (
    Component,
    Context,
    EventContext,
    ExternalContext,
    InPort,
    KernelService,
    OutPort,
    Param,
    PeriodicContext,
    RealtimeContext,
    ThreadContext,
)
from aiorts.diagnostics.loop_monitor import LoopMonitor
from aiorts.errors import AiortsError
from aiorts.supervision.supervising import Supervising
from aiorts.testing import (
    CODEC_CHECKS,
    COMPONENT_CHECKS,
    CONTEXT_CHECKS,
    CONVERTER_CHECKS,
    SERVICE_CHECKS,
    ConformanceError,
    check_codec,
    check_component,
    check_context,
    check_converter,
    check_service,
    faults,
)
from aiorts.types import TimedDouble, TimedDoubleSeq
from aiorts.wire import CONTROL, Codec, MsgpackCodec
from testing import wrong_codecs, wrong_components, wrong_contexts, wrong_converters, wrong_services

CONTEXTS: dict[str, Callable[[], Context]] = {
    "external": ExternalContext,
    "external untimed": functools.partial(ExternalContext, timing=False),
    "periodic": functools.partial(PeriodicContext, 100.0),
    "periodic 333 Hz catch_up": functools.partial(PeriodicContext, 333.0, overrun="catch_up"),
    "event": EventContext,
    "thread": functools.partial(ThreadContext, 100.0),
    "realtime": functools.partial(RealtimeContext, 100.0),
}
WRONG_CONTEXTS: dict[str, tuple[Callable[[], Context], str]] = {
    "loses ticks": (wrong_contexts.LosesTicks, "loses_no_tick"),
    "loses the tenth tick": (functools.partial(wrong_contexts.LosesTheTenthTick, 100.0), "loses_no_tick"),
    "obeys in the middle": (wrong_contexts.ObeysInTheMiddle, "finishes_a_cycle_before_it_obeys"),
    "re-enters": (wrong_contexts.Reenters, "never_enters_a_hook_twice"),
    "ends in order": (wrong_contexts.EndsInOrder, "ends_in_reverse_order"),
    "flatters itself": (wrong_contexts.Flatters, "counts_its_cycles"),
}
WRONG_CODECS: dict[str, tuple[type[MsgpackCodec], str]] = {
    "loses -0.0": (wrong_codecs.LosesTheSignOfZero, "keeps_every_float"),
    "reads past the end": (wrong_codecs.ReadsPastTheEnd, "refuses_more_than_a_frame"),
    "forgets the element type": (wrong_codecs.ForgetsTheElementType, "keeps_element_types"),
    "forgets the byte order": (wrong_codecs.ForgetsTheByteOrder, "takes_any_layout"),
    "confuses emptiness": (wrong_codecs.ConfusesEmptiness, "keeps_nothing"),
    "lets errors through": (wrong_codecs.LetsErrorsThrough, "refuses_a_part"),
}

SERVICES: dict[str, tuple[type[KernelService], dict[str, Any]]] = {
    "good": (wrong_services.Good, {"interval": 2.0}),
    "watch_loop": (LoopMonitor, {"policy": "exit"}),
    "supervision": (Supervising, {"ready": ["sink"]}),
}
WRONG_SERVICES: dict[str, tuple[type[KernelService], str]] = {
    "has the name of a table": (wrong_services.NamedAsATable, "has_a_name"),
    "changing settings": (wrong_services.ChangingSettings, "has_settings"),
    "has an option of several": (wrong_services.OptionOfSeveral, "has_settings"),
    "doubles its settings": (wrong_services.DoublingSettings, "comes_back_from_its_table"),
    "forgets what was replaced": (wrong_services.ForgetsReplaced, "follows_a_system"),
    "knows only the new": (wrong_services.KnowsOnlyTheNew, "comes_to_a_system_that_runs"),
    "reports NaN": (wrong_services.ReportsNaN, "reports_what_json_can_carry"),
    "leaves a task": (wrong_services.LeavesATask, "leaves_nothing"),
    "leaves a timer": (wrong_services.LeavesATimer, "leaves_nothing"),
    "leaves a thread": (wrong_services.LeavesAThread, "leaves_nothing"),
    "takes its time": (wrong_services.TakesItsTime, "leaves_nothing"),
}


class Smoother(Component):
    """A component as it should be: reads, keeps a state, writes, waits a little."""

    raw = InPort(TimedDouble)
    smooth = OutPort(TimedDoubleSeq)
    share = Param(0.5, ge=0.0, le=1.0)

    def on_activated(self) -> None:
        self.value = 0.0

    async def on_execute(self) -> None:
        await self.sleep(0.002)
        while self.raw.is_new:
            self.value += self.share * ((await self.raw.read()).data - self.value)
        await self.smooth.write(TimedDoubleSeq(0, [self.value, 1.0]))


@pytest.mark.parametrize("name", CONTEXT_CHECKS)
@pytest.mark.parametrize("kind", CONTEXTS)
def test_contexts_of_aiorts_keep_every_promise(kind: str, name: str) -> None:
    check_context(CONTEXTS[kind], only=[name])


@pytest.mark.parametrize("what", WRONG_CONTEXTS)
def test_wrong_context_is_refused_by_the_check_of_that_promise(what: str) -> None:
    make, name = WRONG_CONTEXTS[what]
    with pytest.raises(ConformanceError) as caught:
        check_context(make, only=[name])
    assert caught.value.check == name
    with pytest.raises(ConformanceError):
        check_context(make)


@pytest.mark.parametrize("name", SERVICE_CHECKS)
@pytest.mark.parametrize("what", SERVICES)
def test_good_service_keeps_every_promise(what: str, name: str) -> None:
    kind, settings = SERVICES[what]
    check_service(kind, only=[name])
    check_service(kind, settings, only=[name])


@pytest.mark.parametrize("what", WRONG_SERVICES)
def test_wrong_service_is_refused_by_the_check_of_that_promise(what: str) -> None:
    kind, name = WRONG_SERVICES[what]
    wrong_services.THREADS_END.clear()
    try:
        with pytest.raises(ConformanceError) as caught:
            check_service(kind, only=[name])
    finally:
        wrong_services.THREADS_END.set()
    assert caught.value.check == name


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("name", CODEC_CHECKS)
def test_codec_of_aiorts_keeps_every_promise(name: str) -> None:
    check_codec(MsgpackCodec(), only=[name])


def test_codec_with_the_limits_of_control_frames_keeps_to_them() -> None:
    check_codec(MsgpackCodec(CONTROL), only=["keeps_to_its_limits"])


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("what", WRONG_CODECS)
def test_wrong_codec_is_refused_by_the_check_of_that_promise(what: str) -> None:
    cls, name = WRONG_CODECS[what]
    codec: Codec = cls()
    with pytest.raises(ConformanceError) as caught:
        check_codec(codec, only=[name])
    assert caught.value.check == name
    with pytest.raises(ConformanceError):
        check_codec(codec)


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("name", COMPONENT_CHECKS)
@pytest.mark.parametrize("make", [Smoother, functools.partial(faults.Flooding, 50)])
def test_good_component_keeps_every_promise(make: Callable[[], Component], name: str) -> None:
    check_component(make, {"raw": [1.0, -2.0, 0.5]}, deterministic=True, only=[name])


@pytest.mark.slow(kept_by="functions/test_function_use.py::test_it_conforms_in_a_thread")
def test_component_for_a_thread_is_checked_in_one() -> None:
    check_component(
        lambda: faults.Blocking("on_execute", 0.11, times=1),
        make_context=functools.partial(ThreadContext, 100.0),
        cycles=3,
    )


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize("what", wrong_components.WRONG)
def test_wrong_component_is_refused_by_the_check_of_that_promise(what: str) -> None:
    make, name = wrong_components.WRONG[what]
    with pytest.raises(ConformanceError) as caught:
        check_component(make, deterministic=True, only=[name])
    assert caught.value.check == name


@pytest.mark.slow
def test_a_component_that_blocks_is_refused_at_the_first_cycle_that_takes_too_long() -> None:
    executed: list[int] = []

    class Sleeper(Component):
        def on_execute(self) -> None:
            executed.append(1)
            time.sleep(0.05)

    with pytest.raises(ConformanceError, match=r"Sleeper: check does_not_block_the_loop: .*on_execute: 0\.\d+ s"):
        check_component(Sleeper, may_block=0.02)
    assert len(executed) == 3  # an attempt each: a busy machine is not the component's fault


def test_error_names_subject_check_expected_and_got() -> None:
    with pytest.raises(ConformanceError) as caught:
        check_codec(wrong_codecs.LosesTheSignOfZero())
    error = caught.value
    assert isinstance(error, AiortsError)
    assert isinstance(error, AssertionError)
    assert (error.subject, error.check) == ("LosesTheSignOfZero", "keeps_every_float")
    assert "TimedDouble.data: 0.0 (bits 0000000000000000), not -0.0" in error.got
    assert str(error).startswith("LosesTheSignOfZero: check keeps_every_float: expected ")


def test_checks_can_be_chosen_and_an_unknown_one_is_refused() -> None:
    check_codec(wrong_codecs.LosesTheSignOfZero(), skip=["keeps_every_float", "keeps_every_type", "keeps_plain_values"])
    with pytest.raises(ValueError, match=r"no such check: nonsense; there are keeps_every_float"):
        check_codec(MsgpackCodec(), only=["nonsense"])


@pytest.mark.parametrize("name", wrong_converters.WRONG)
def test_the_suite_of_converters_refuses_each_wrong_one(name: str) -> None:
    make, target, check = wrong_converters.WRONG[name]
    samples = [TimedDouble(0, 1.0), TimedDouble(1, 2.0), TimedDouble(2, 3.0)]
    with pytest.raises(ConformanceError) as caught:
        check_converter(make, "2", samples, target)
    assert caught.value.check == check
    check_converter(wrong_converters.right, "2", samples, TimedDouble)


def test_the_suite_of_converters_needs_a_sample() -> None:
    with pytest.raises(ValueError, match="at least one sample"):
        check_converter(wrong_converters.right, "2", [], TimedDouble)


@pytest.mark.parametrize("promises", [CONTEXT_CHECKS, CODEC_CHECKS, COMPONENT_CHECKS, CONVERTER_CHECKS])
def test_every_check_says_what_it_demands(promises: dict[str, str]) -> None:
    assert len(promises) >= 8 or promises in (COMPONENT_CHECKS, CONVERTER_CHECKS)
    assert all(len(promise) > 20 and promise != name for name, promise in promises.items())
