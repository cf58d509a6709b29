"""Configuration sets: named, one active, changed while running; each change whole and between cycles, or refused."""

from __future__ import annotations

import asyncio
import threading
from typing import TYPE_CHECKING, Any, ClassVar

import pytest

from aiorts import (
    Component,
    EventContext,
    ExternalContext,
    Kernel,
    Param,
    PeriodicContext,
    RealtimeContext,
    ThreadContext,
)
from aiorts.errors import (
    ClosedError,
    ConfigurationError,
    DeclarationError,
    InvalidNameError,
    ThreadError,
    TransitionTimeout,
)
from aiorts.events import (
    ConfigurationSetActivated,
    ConfigurationSetAdded,
    ConfigurationSetChanged,
    ConfigurationSetRemoved,
    ParameterChanged,
    ParametersChanged,
)
from aiorts.testing import simulated
from config_parts import Arm, hear

if TYPE_CHECKING:
    from collections.abc import Mapping

    from aiorts import Context


# -- sets ------------------------------------------------------------------------------------------------------------


@pytest.mark.row(72)
@simulated
async def test_sets_are_declared_added_changed_activated_and_removed() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"), mode="fast")
        configuration = arm.configuration
        assert list(configuration.sets) == ["default", "stiff", "fast"]
        assert (configuration.active, arm.low, arm.high, arm.mode) == ("default", 1.0, 2.0, "fast")
        await configuration.activate("stiff")
        # What the set does not name is as in "default".
        assert (configuration.active, arm.low, arm.high, arm.mode) == ("stiff", 10.0, 20.0, "fast")
        await arm.configure(high=30.0)  # a change belongs to the active set
        await configuration.add("soft", {"low": 0.5})
        await configuration.change("soft", {"high": "0.75"})
        await configuration.activate("soft")
        assert (arm.low, arm.high) == (0.5, 0.75)
        await configuration.activate("default")
        assert (arm.low, arm.high) == (1.0, 2.0)
        await configuration.activate("stiff")
        assert (arm.low, arm.high) == (10.0, 30.0)
        await configuration.remove("soft")
        assert list(configuration.sets) == ["default", "stiff", "fast"]
        await configuration.add("stiff", {"low": 11.0, "high": 12.0}, replace=True)
        assert (arm.low, arm.high) == (11.0, 12.0)


@simulated
async def test_values_in_force_depend_on_the_active_set_alone() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        await arm.configuration.activate("fast")
        by_way_of_fast = dict(arm.configuration.values)
        await arm.configuration.activate("stiff")
        await arm.configuration.activate("fast")
        assert dict(arm.configuration.values) == by_way_of_fast
        assert {name: getattr(arm, name) for name in by_way_of_fast} == by_way_of_fast


@simulated
async def test_replacing_all_sets_leaves_what_is_not_named_as_declared() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"), low=1.5)
        await arm.configuration.replace({"default": {"high": 3.0}, "hard": {"low": 2.5}}, active="hard")
        assert (arm.low, arm.high, arm.mode) == (2.5, 3.0, "slow")
        assert {name: dict(values) for name, values in arm.configuration.sets.items()} == {
            "default": {"low": 1.0, "high": 3.0, "mode": "slow", "count": 4},
            "hard": {"low": 2.5},
        }


@simulated
async def test_merging_changes_adds_and_activates_in_one_step() -> None:
    arm = Arm("arm")
    # Neither half would do alone: what a system file says of a component is put in force as one.
    await arm.configuration.merge({"hard": {"low": 60.0}, "default": {"high": 70.0}, "stiff": {"mode": "fast"}}, "hard")
    async with Kernel() as kernel:
        await kernel.add(arm)
        assert (arm.low, arm.high, arm.mode, arm.configuration.active) == (60.0, 70.0, "slow", "hard")
        assert {name: dict(values) for name, values in arm.configuration.sets.items()} == {
            "default": {"low": 1.0, "high": 70.0, "mode": "slow", "count": 4},
            "stiff": {"mode": "fast"},
            "fast": {"mode": "fast"},
            "hard": {"low": 60.0},
        }


@pytest.mark.parametrize(
    ("method", "arguments", "why"),
    [
        ("activate", ("stif",), r"arm: no set 'stif'; did you mean stiff\?"),
        ("activate", (7,), "no set 7"),
        ("change", ("nothing", {}), "no set 'nothing'"),
        ("change", ("stiff", {"lwo": 1}), r"arm \(set stiff\).lwo: no such parameter; did you mean low"),
        ("change", ("stiff", {"low": -1}), r"arm \(set stiff\).low = -1: must be >= 0.0; 10.0 kept"),
        ("change", ("fast", {"mode": "warp"}), "must be one of 'slow', 'fast'"),
        ("change", ("stiff", {"low": 50.0}), "arm: set stiff: low 50.0 is above high 20.0; nothing was changed"),
        ("add", ("stiff", {}), "there is a set 'stiff' already"),
        ("add", ("default", {}), "the set 'default' is always there"),
        ("add", ("soft", {"low": 3.0}), "set soft: low 3.0 is above high 2.0"),
        ("add", ("soft", {"count": 3}), "count = 3: must be even; nothing was changed"),
        ("remove", ("default",), "is always there"),
        ("remove", ("nothing",), "no set 'nothing'"),
        ("replace", ({"a": {"low": -1}, "b": {"x": 1}},), r"(?s)arm \(set a\).low.*arm \(set b\).x"),
        ("replace", ({}, "stiff"), "no set 'stiff'"),
        ("merge", ({"default": {"low": 5.0}, "new": {"mode": "x"}},), r"\(set new\).mode = 'x'"),
        ("merge", ({"new": {}}, "nwe"), "no set 'nwe'"),
        ("merge", ({"default": {"high": 0.5}},), "low 1.0 is above high 0.5"),
        ("change", ("default", {"low": 3.0}), "^arm: check_configuration: low 3.0 is above high 2.0"),
    ],
)
@simulated
async def test_what_cannot_be_is_refused_and_nothing_changes(method: str, arguments: Any, why: str) -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        heard = hear(kernel)
        before = arm.params._state
        with pytest.raises(ConfigurationError, match=why):
            await getattr(arm.configuration, method)(*arguments)
        assert arm.params._state is before
        assert heard == []


@simulated
async def test_the_active_set_cannot_be_removed_and_meta_names_are_refused() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        await arm.configuration.activate("stiff")
        with pytest.raises(ConfigurationError, match="is active; activate another first"):
            await arm.configuration.remove("stiff")
        with pytest.raises(InvalidNameError, match="begin with '_'"):
            await arm.configuration.add("__widget__", {})
        with pytest.raises(InvalidNameError):
            await arm.configuration.add("a.b", {})


def test_sets_of_a_class_are_checked_where_it_is_written() -> None:
    for declared, why in (
        ({"stiff": {"gian": 1.0}}, r"Wrong.configurations: Wrong \(set stiff\).gian: no such parameter"),
        ({"stiff": {"gain": -1.0}}, "must be >= 0.0"),
        ({"default": {"gain": 1.0}}, "always there"),
        ({"_hidden": {}}, "begin with '_'"),
        ({"stiff": 5}, "expected values by parameter"),
        (5, "expected sets by name"),
    ):
        with pytest.raises(DeclarationError, match=why):
            type("Wrong", (Component,), {"gain": Param(1.0, ge=0.0), "configurations": declared})

    for taken in ("configuration", "configure", "params", "add_param", "remove_param"):
        with pytest.raises(DeclarationError, match=f"Component has a {taken} of its own"):
            type("Wrong", (Component,), {taken: Param(1)})
    with pytest.raises(DeclarationError, match="expected sets by name"):
        type("Wrong", (Component,), {"configurations": Param(1)})
    with pytest.raises(DeclarationError, match="plain `def`"):

        class Waits(Component):
            async def check_configuration(self, values: Mapping[str, Any]) -> None:  # type: ignore[override]
                pass


def test_a_derived_class_inherits_sets_and_may_replace_them() -> None:
    class Hand(Arm):
        grip = Param(0.5)
        configurations: ClassVar = {"stiff": {"grip": 0.9}}

    assert {name: dict(values) for name, values in Hand("hand").configuration.sets.items()} == {
        "default": {"low": 1.0, "high": 2.0, "mode": "slow", "count": 4, "grip": 0.5},
        "stiff": {"grip": 0.9},
        "fast": {"mode": "fast"},
    }
    assert dict(Arm("arm").configuration.sets["stiff"]) == {"low": 10.0, "high": 20.0}


@simulated
async def test_instances_do_not_share_what_they_change() -> None:
    async with Kernel() as kernel:
        one, other = await kernel.add(Arm()), await kernel.add(Arm())
        await one.configure(low=1.5)
        await one.configuration.add("soft", {})
        assert (one.low, other.low, list(other.configuration.sets)) == (1.5, 1.0, ["default", "stiff", "fast"])


@simulated
async def test_defaults_that_break_the_components_own_rule_keep_it_out() -> None:
    class Crossed(Arm):
        configurations: ClassVar = {"crossed": {"low": 50.0}}

    async with Kernel() as kernel:
        with pytest.raises(ConfigurationError, match="above"):
            await kernel.add(Arm("arm"), low=3.0)
        with pytest.raises(ConfigurationError, match=r"set crossed: low 50\.0"):
            await kernel.add(Crossed("crossed"))
        with pytest.raises(ConfigurationError, match="must be even"):
            await kernel.add(Arm("arm"), count=3)
        assert list(kernel.components) == []


@simulated
async def test_sets_are_chosen_before_the_component_is_added() -> None:
    arm = Arm("arm")
    await arm.configuration.activate("stiff")
    async with Kernel() as kernel:
        await kernel.add(arm, high=40.0)
        assert (arm.configuration.active, arm.low, arm.high) == ("stiff", 10.0, 40.0)


# -- whole or not at all (B22) ---------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(75)
@pytest.mark.fault("B22")
@pytest.mark.parametrize("contexts", ["one", "several", "event"])
@simulated
async def test_of_a_thousand_changes_good_and_bad_while_hooks_run_none_is_ever_half_done(contexts: str) -> None:
    """OpenRTM converts one parameter after the other, while `on_execute` runs in another context's thread."""
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        arm.pause = 0.003
        kinds: dict[str, list[Context]] = {
            "one": [PeriodicContext(100.0)],
            "several": [PeriodicContext(100.0), PeriodicContext(70.0)],
            "event": [EventContext()],
        }
        for context in kinds[contexts]:
            await kernel.start(context, arm, activate=True)
        refused = 0
        for number in range(1000):
            low = float(number % 50)
            good: dict[str, object] = {"low": low, "high": low + 1.0}
            bad = [
                {**good, "mode": "warp"},
                {**good, "nothing": 1},
                {**good, "count": 3},
                {**good, "high": low - 0.5},
                {"high": "wide", **good, "low": "deep"},
            ]
            if number % 2:
                before = dict(arm.configuration.values)
                with pytest.raises(ConfigurationError):
                    await arm.configure(**bad[number // 2 % len(bad)])
                refused += 1
                assert dict(arm.configuration.values) == before
            else:
                await arm.configure(**good)
                assert (arm.low, arm.high) == (low, low + 1.0)
            if number % 5 == 0:
                await asyncio.sleep(0.004)
            if contexts == "event":
                arm.contexts[0].trigger(arm)  # type: ignore[attr-defined]
        assert refused == 500
        assert len(arm.seen) > 100
        # Not one cycle saw one value of one change and one of another: apart by 1 always.
        assert {high - low for low, high in arm.seen} == {1.0}


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(75)
@pytest.mark.fault("B22")
@pytest.mark.parametrize("kind", [ThreadContext, RealtimeContext])
@pytest.mark.anyio
async def test_a_thread_never_sees_half_a_change(kind: type[ThreadContext]) -> None:
    class Quick(Arm):
        def on_execute(self) -> None:  # type: ignore[override]
            for _ in range(20):
                self.seen.append((self.low, self.high))

    async with Kernel() as kernel:
        arm = await kernel.add(Quick("arm"))
        context = kind(1000.0) if kind is ThreadContext else kind(1000.0, priority=None, lock_memory=False)  # type: ignore[call-arg]
        await kernel.start(context, arm, activate=True)
        for number in range(300):
            low = float(number % 50)
            if number % 3 == 2:
                with pytest.raises(ConfigurationError):
                    await arm.configure(low=low, high=low - 1.0)
            else:
                await arm.configure(low=low, high=low + 1.0)
        assert {high - low for low, high in arm.seen} == {1.0}
        assert len(set(arm.seen)) > 1


@pytest.mark.row(76)
@simulated
async def test_an_active_component_is_changed_between_cycles_and_the_caller_knows_when() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        arm.pause = 0.05
        await kernel.start(PeriodicContext(10.0), arm, activate=True)
        await asyncio.sleep(0.02)
        changing = asyncio.create_task(arm.configuration.activate("stiff"))
        await asyncio.sleep(0)
        assert (arm.low, arm.configuration.active) == (1.0, "default")
        await changing
        assert round(asyncio.get_running_loop().time(), 3) == 0.05
        assert (arm.low, arm.configuration.active) == (10.0, "stiff")
        await asyncio.sleep(0.2)
        assert set(arm.seen) == {(1.0, 2.0), (10.0, 20.0)}


@pytest.mark.row(76)
@simulated
async def test_an_inactive_component_is_changed_at_once_though_its_neighbour_holds_the_cycle() -> None:
    """OpenRTM gives an inactive component its new values when it is activated, if they were activated once more."""

    async with Kernel() as kernel:
        idle, busy = await kernel.add(Arm("idle")), await kernel.add(Arm("busy"))
        busy.pause = 0.5
        context = await kernel.start(PeriodicContext(1.0), busy, idle)
        await context.activate(busy)
        await asyncio.sleep(1.1)
        began = asyncio.get_running_loop().time()
        await idle.configure(high=3.0)
        await idle.configuration.activate("stiff")
        assert asyncio.get_running_loop().time() == began
        assert (idle.low, idle.high) == (10.0, 20.0)
        assert busy.seen == []


@pytest.mark.row(76)
@simulated
async def test_a_hook_that_changes_its_own_component_is_not_made_to_wait() -> None:
    class Switcher(Arm):
        async def on_execute(self) -> None:
            before = self.low, self.configuration.active
            await self.configuration.activate("stiff" if self.configuration.active == "default" else "default")
            assert (self.low, self.configuration.active) == before
            await super().on_execute()

    class Plain(Arm):
        def on_execute(self) -> None:  # type: ignore[override]
            self.seen.append((self.low, self.high))
            self.configuration.activate_soon("stiff")
            self.configuration.change_soon(high=25.0)
            with pytest.raises(ConfigurationError, match="no set"):
                self.configuration.activate_soon("nothing")
            assert self.configuration.active == ("default" if len(self.seen) == 1 else "stiff")

    async with Kernel() as kernel:
        switcher, plain = await kernel.add(Switcher()), await kernel.add(Plain())
        context = await kernel.start(ExternalContext(), switcher, plain, activate=True)
        for _ in range(4):
            await context.tick()
        assert (switcher.state, switcher.last_error, plain.last_error) == ("active", None, None)
        assert switcher.seen == [(1.0, 2.0), (10.0, 20.0), (1.0, 2.0), (10.0, 20.0)]
        assert plain.seen == [(1.0, 2.0), (10.0, 25.0), (10.0, 25.0), (10.0, 25.0)]


@pytest.mark.anyio
async def test_a_hook_in_a_thread_changes_its_component_without_waiting() -> None:
    class Plain(Arm):
        def on_execute(self) -> None:  # type: ignore[override]
            if len(self.seen) == 1:
                self.configuration.activate_soon("stiff")
            self.seen.append((self.low, self.high))

    async with Kernel() as kernel:
        arm = await kernel.add(Plain("arm"))
        await kernel.start(ThreadContext(500.0), arm, activate=True)
        while len(arm.seen) < 4:
            await asyncio.sleep(0.001)
        assert arm.seen[:4] == [(1.0, 2.0), (1.0, 2.0), (10.0, 20.0), (10.0, 20.0)]


@simulated
async def test_the_last_hook_of_a_component_changes_it_after_the_hook_and_before_others_do() -> None:
    left = asyncio.Event()

    class Leaving(Arm):
        async def on_deactivated(self) -> None:
            await self.configure(high=3.0)
            assert self.high == 2.0
            left.set()

    async with Kernel() as kernel:
        arm = await kernel.add(Leaving("arm"))
        context = await kernel.start(ExternalContext(), arm, activate=True)
        told: list[float] = []
        kernel.bus.subscribe(ParameterChanged, lambda event: told.append(event.new))

        async def other() -> None:
            await left.wait()
            await arm.configure(high=4.0)

        await asyncio.gather(context.deactivate(), other())
        assert (arm.high, told, arm.last_error) == (4.0, [3.0, 4.0], None)


@pytest.mark.anyio
async def test_an_inactive_component_in_a_thread_is_changed_by_its_thread() -> None:
    class Checked(Component):
        value = Param(0)
        threads: ClassVar[list[int]] = []

        def check_configuration(self, values: Mapping[str, Any]) -> None:
            self.threads.append(threading.get_ident())

        def on_startup(self) -> None:
            self.thread = threading.get_ident()

    async with Kernel() as kernel:
        checked = await kernel.add(Checked("checked"))
        await kernel.start(ThreadContext(100.0), checked)
        await checked.configure(value=1)
        assert checked.threads == [threading.get_ident(), checked.thread]


@simulated
async def test_a_queued_change_that_is_refused_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    class Crossing(Arm):
        async def on_execute(self) -> None:
            if not self.seen:
                await self.configure(low=50.0)  # no value is bad; the component's rule says no, when its turn comes
            await super().on_execute()

    async with Kernel() as kernel:
        for number, contexts in enumerate(([ExternalContext()], [ExternalContext(), ExternalContext()])):
            arm = await kernel.add(Crossing(f"arm{number}"))
            for context in contexts:
                await kernel.start(context, arm, activate=True)
            await contexts[0].tick()
            await asyncio.sleep(0.01)
            assert arm.low == 1.0
            assert "low 50.0 is above high 2.0" in caplog.messages[-1]
            assert len(caplog.messages) == number + 1


class Unspeakable(Exception):
    def __str__(self) -> str:
        raise RuntimeError("not even this")


@pytest.mark.fault("B22")
@simulated
async def test_whatever_a_validator_does_the_old_set_stays_and_the_context_lives() -> None:
    class Tricky(Component):
        what = Param(0, validator=lambda value: tricks[value]())
        other = Param(0)
        ran = 0

        def on_execute(self) -> None:
            self.ran += 1

    tricks: list[Any] = [
        lambda: None,
        lambda: 1 / 0,
        lambda: (_ for _ in ()).throw(asyncio.CancelledError()),
        lambda: (_ for _ in ()).throw(SystemExit(3)),
        lambda: (_ for _ in ()).throw(KeyboardInterrupt()),
        lambda: (_ for _ in ()).throw(StopIteration()),
        lambda: (_ for _ in ()).throw(GeneratorExit()),
        lambda: (_ for _ in ()).throw(Unspeakable()),
    ]
    async with Kernel(contain_interrupts=True) as kernel:
        tricky = await kernel.add(Tricky("tricky"))
        context = await kernel.start(ExternalContext(), tricky, activate=True)
        heard = hear(kernel)
        for number in range(1, len(tricks)):
            with pytest.raises(ConfigurationError, match=f"tricky: what = {number}: raised"):
                await tricky.configure(other=1, what=number)
            assert (tricky.what, tricky.other) == (0, 0)
            await context.tick()
        assert (tricky.ran, tricky.state, heard) == (7, "active", [])


async def later(value: object) -> None:
    """A check that nobody would await."""


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (lambda value: value < 5, "p = 9: its validator says no"),
        (lambda value: later(value) if value == 9 else None, "p = 9: expected None, got a coroutine, which is never"),
        (lambda value: (_ for _ in ()).throw(ValueError()) if value == 9 else None, "p = 9: refused; nothing"),
    ],
)
@simulated
async def test_a_validator_may_be_a_question_but_no_coroutine(answer: Any, why: str) -> None:
    class Asked(Component):
        p = Param(1, validator=answer)

    async with Kernel() as kernel:
        asked = await kernel.add(Asked("asked"))
        await asked.configure(p=2)
        with pytest.raises(ConfigurationError, match=why):
            await asked.configure(p=9)
        assert asked.p == 2


@pytest.mark.parametrize(
    ("result", "why"),
    [
        (5, "check_configuration: expected a function or None, got int"),
        (lambda: later(1), "putting the configuration in force: expected None, got a coroutine"),
    ],
)
@simulated
async def test_what_a_check_returns_is_looked_at(result: Any, why: str) -> None:
    class Odd(Component):
        p = Param(1)

        def check_configuration(self, values: Mapping[str, Any]) -> Any:
            return result if values["p"] == 9 else None

    async with Kernel() as kernel:
        odd = await kernel.add(Odd("odd"))
        with pytest.raises(ConfigurationError, match=why):
            await odd.configure(p=9)
        assert odd.p == 1
        with pytest.raises(ConfigurationError, match="too long to be shown"):
            await kernel.add(Arm("arm"), count=10**5000 + 1)  # its validator is asked, and its value cannot be shown


@simulated
async def test_a_function_that_takes_over_is_part_of_the_change() -> None:
    class Table(Component):
        text = Param("1,2")
        scale = Param(1)
        rows: tuple[int, ...] = ()
        calls = 0

        def check_configuration(self, values: Mapping[str, Any]) -> Any:
            rows = tuple(int(part) * values["scale"] for part in values["text"].split(","))

            def use() -> None:
                assert (self.text, self.scale) == (values["text"], values["scale"])
                if rows[0] == 13:
                    raise RuntimeError("bad luck")
                self.rows = rows
                self.calls += 1

            return use

    async with Kernel() as kernel:
        table = await kernel.add(Table("table"))
        assert table.rows == (1, 2)
        await table.configure(text="3,4", scale=2)
        assert (table.rows, table.calls) == ((6, 8), 2)
        heard = hear(kernel)
        with pytest.raises(ConfigurationError, match="invalid literal"):
            await table.configure(text="3,x")
        with pytest.raises(ConfigurationError, match="bad luck"):
            await table.configure(text="13", scale=1)
        assert (table.rows, table.text, table.scale, heard) == ((6, 8), "3,4", 2, [])
        await table.configuration.add("other", {"text": "9"})
        assert table.rows == (6, 8)
        await table.configuration.activate("other")
        assert table.rows == (18,)


@simulated
async def test_a_configuration_error_of_the_component_itself_arrives_as_it_was_raised() -> None:
    class Placed(ConfigurationError):
        place = 7

    class Typed(Component):
        text = Param("")

        def check_configuration(self, values: Mapping[str, Any]) -> None:
            if values["text"] == "bad":
                raise Placed("look at character 7")

    async with Kernel() as kernel:
        typed = await kernel.add(Typed("typed"))
        with pytest.raises(Placed, match=r"^look at character 7$"):
            await typed.configure(text="bad")
        with pytest.raises(Placed):
            await kernel.add(Typed("other"), text="bad")
        assert (typed.text, list(kernel.components)) == ("", ["typed"])


@simulated
async def test_two_changes_that_exclude_each_other_are_not_both_made() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"), low=0.0, high=10.0)
        arm.pause = 0.01
        await kernel.start(PeriodicContext(10.0), arm, activate=True)
        await asyncio.sleep(0.005)
        # Each of the two is right by what is in force when it is asked for.
        results = await asyncio.gather(arm.configure(low=9.0), arm.configure(high=8.0), return_exceptions=True)
        assert (arm.low, arm.high) == (9.0, 10.0)
        assert results[0] is None
        assert isinstance(results[1], ConfigurationError)


@simulated
async def test_a_change_whose_moment_does_not_come_is_withdrawn() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        arm.pause = 60.0
        await kernel.start(PeriodicContext(0.01), arm, activate=True)
        await asyncio.sleep(1.0)
        with pytest.raises(TransitionTimeout):
            await arm.configuration.activate("stiff")
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(1.0):
                await arm.configure(high=5.0)
        await asyncio.sleep(200.0)
        assert (arm.low, arm.high, arm.configuration.active) == (1.0, 2.0, "default")


@simulated
async def test_a_value_is_what_it_was_when_the_change_was_asked_for() -> None:
    class Listed(Component):
        numbers = Param((1,))

        async def on_execute(self) -> None:
            await asyncio.sleep(0.05)

    async with Kernel() as kernel:
        listed = await kernel.add(Listed("listed"))
        await kernel.start(PeriodicContext(10.0), listed, activate=True)
        await asyncio.sleep(0.01)
        one, other, third = [2], [3], [4]
        asked = [
            asyncio.create_task(listed.configure(numbers=one)),
            asyncio.create_task(listed.configuration.add("a", {"numbers": other})),
            asyncio.create_task(listed.configuration.change("default", {"numbers": third})),
        ]
        await asyncio.sleep(0)
        for numbers in (one, other, third):
            numbers.append(99)
        await asyncio.gather(*asked)
        assert (listed.numbers, listed.configuration.sets["a"]["numbers"]) == ((4,), (3,))
        await listed.configure(numbers=(10**5000,))  # too long for a message, not for a parameter
        with pytest.raises(ConfigurationError, match="too long to be shown"):
            await listed.configure(numbers=10**5000)
        assert listed.state == "active"


@simulated
async def test_changes_come_from_the_kernels_thread_and_to_living_components() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        raised: list[BaseException] = []

        def elsewhere() -> None:
            for call in (arm.configuration.activate("stiff"), arm.configure(low=0.5)):
                try:
                    call.send(None)
                except ThreadError as error:
                    raised.append(error)

        thread = threading.Thread(target=elsewhere)
        thread.start()
        thread.join()
        assert len(raised) == 2
        assert (arm.configuration.active, arm.low) == ("default", 1.0)
        await kernel.remove(arm)
        with pytest.raises(ClosedError, match="was removed"):
            await arm.configure(low=0.5)


# -- what is told ----------------------------------------------------------------------------------------------------


@pytest.mark.row(76)
@simulated
async def test_every_change_is_told_once_in_order_and_after_it_is_in_force() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        heard = hear(kernel)
        told: list[Any] = []
        kernel.bus.subscribe(ParameterChanged, lambda event: told.append((getattr(arm, event.parameter), event.new)))
        await arm.configuration.activate("stiff")
        assert heard == [
            ConfigurationSetActivated("arm", "default", "stiff"),
            ParameterChanged("arm", "low", 1.0, 10.0, "stiff"),
            ParameterChanged("arm", "high", 2.0, 20.0, "stiff"),
            ParametersChanged("arm", (("low", 10.0), ("high", 20.0))),
        ]
        heard.clear()
        await arm.configure(low=10.0, high=21.0)  # only what is another value
        assert heard == [
            ConfigurationSetChanged("arm", "stiff", (("low", 10.0), ("high", 20.0)), (("low", 10.0), ("high", 21.0))),
            ParameterChanged("arm", "high", 20.0, 21.0, "stiff"),
            ParametersChanged("arm", (("high", 21.0),)),
        ]
        heard.clear()
        await arm.configuration.add("soft", {"low": 0.5})
        await arm.configuration.change("soft", {"low": 0.25})
        await arm.configuration.remove("soft")
        await arm.configure(high=21.0)
        assert heard == [
            ConfigurationSetAdded("arm", "soft", (("low", 0.5),)),
            ConfigurationSetChanged("arm", "soft", (("low", 0.5),), (("low", 0.25),)),
            ConfigurationSetRemoved("arm", "soft", (("low", 0.25),)),
        ]
        assert told == [(10.0, 10.0), (20.0, 20.0), (21.0, 21.0)]


@pytest.mark.fault("B15")
@simulated
async def test_an_observer_that_raises_disturbs_neither_the_change_nor_other_observers() -> None:
    async with Kernel() as kernel:
        arm = await kernel.add(Arm("arm"))
        kernel.bus.subscribe(ParameterChanged, lambda event: 1 / 0)
        heard = hear(kernel, ParameterChanged)
        await kernel.start(PeriodicContext(10.0), arm, activate=True)
        await arm.configure(low=0.5, high=0.75)
        assert (arm.low, arm.high, len(heard), arm.state) == (0.5, 0.75, 2, "active")


@pytest.mark.anyio
async def test_what_a_thread_puts_in_force_is_told_on_the_loop_in_order() -> None:
    class Plain(Arm):
        def on_execute(self) -> None:  # type: ignore[override]
            pass

    async with Kernel() as kernel:
        arm = await kernel.add(Plain("arm"), low=0.0, high=50.0)
        await kernel.start(ThreadContext(1000.0), arm, activate=True)
        threads: set[int] = set()
        values: list[float] = []

        def hear_it(event: ParameterChanged) -> None:
            threads.add(threading.get_ident())
            values.append(event.new)

        kernel.bus.subscribe(ParameterChanged, hear_it)
        for number in range(1, 21):
            await arm.configure(low=number)
        await asyncio.sleep(0.05)
        assert values == [float(number) for number in range(1, 21)]
        assert threads == {threading.get_ident()}


@pytest.mark.fault("B22")
@pytest.mark.parametrize("added", [False, True])
@simulated
async def test_a_check_that_changes_what_it_is_asked_about_leaves_nothing_half_done(added: bool) -> None:
    class Meddler(Component):
        gain = Param(1.0)
        mode = Param("a")
        meddles = False

        def check_configuration(self, values: Mapping[str, Any]) -> None:
            if self.meddles:
                self.meddles = False
                self.configuration.change_soon(mode="b")

    async with Kernel() as kernel:
        meddler = Meddler("meddler")
        if added:
            await kernel.add(meddler)
        meddler.meddles = True
        if added:
            await meddler.configure(gain=2.0)
            await asyncio.sleep(0)
            assert dict(meddler.configuration.values) == {"gain": 2.0, "mode": "b"}
        else:
            with pytest.raises(ConfigurationError, match="its own check changed the configuration"):
                await meddler.configure(gain=2.0)
            assert dict(meddler.configuration.values) == {"gain": 1.0, "mode": "b"}
        assert (meddler.gain, meddler.mode) == tuple(meddler.configuration.values.values())
