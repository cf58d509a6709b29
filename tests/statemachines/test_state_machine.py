"""State machines as components: lifecycle, events from ports, timers on the kernel's clock, failures, observers."""

from __future__ import annotations

from typing import Any

import pytest

from aiorts import (
    Context,
    EventContext,
    EventPort,
    ExternalContext,
    InPort,
    Kernel,
    LifecycleState,
    OutPort,
    Param,
    PeriodicContext,
    StateMachineComponent,
    ThreadContext,
)
from aiorts.errors import DeclarationError, StateError
from aiorts.events import MachineAfter, MachineBefore, MachineChanged, MachineEnded
from aiorts.statechart import After, Always, Chart, End, History, On, Parallel, State
from aiorts.testing import Rig
from aiorts.types import TimedBoolean, TimedDouble, TimedLong

pytestmark = pytest.mark.anyio


class Told(StateMachineComponent):
    """Keeps what happened."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.told: list[Any] = []

    def tell(self, what: Any = "-") -> None:
        self.told.append(what)


class Door(Told):
    """Opens at a button, closes by itself."""

    button = EventPort(TimedBoolean)
    obstacle = EventPort(TimedDouble)
    lamp = OutPort(TimedBoolean)
    dwell = Param(5.0, unit="s", ge=0.0)

    chart = Chart(
        State("closed", On("button", to="opening"), initial=True),
        State(
            "moving",
            State("opening", After(2.0, to="open"), initial=True),
            State("closing", After(2.0, to="closed"), On("obstacle", to="opening", guard="is_near", action="complain")),
            entry="motor_on",
            exit="motor_off",
        ),
        State("open", After("dwell", to="closing"), On("button", to="closing"), entry="lamp_on", exit="lamp_off"),
    )

    async def lamp_on(self) -> None:
        await self.lamp.write(TimedBoolean(0, True))

    async def lamp_off(self) -> None:
        await self.lamp.write(TimedBoolean(0, False))

    def motor_on(self) -> None:
        self.told.append("motor on")

    def motor_off(self) -> None:
        self.told.append("motor off")

    def is_near(self, sample: TimedDouble) -> bool:
        return sample.data < 0.5

    def complain(self, sample: TimedDouble) -> None:
        self.told.append(sample.data)


@pytest.mark.row(102)
async def test_a_door_opens_and_closes_by_ports_and_timers_alone() -> None:
    """OpenRTM's machine stands still unless its user calls run_event in onExecute; nothing is to be called here."""
    door = Door("door0")
    async with Rig(door, context=EventContext()) as rig:
        assert door.machine.configuration == ("closed",)
        rig.feed("button", True)
        await rig.tick()
        assert door.machine.configuration == ("moving", "opening")
        await rig.advance(2.0)
        assert door.machine.configuration == ("open",)
        await rig.advance(5.0)
        assert door.machine.configuration == ("moving", "closing")
        rig.feed("obstacle", 0.7)
        await rig.tick()
        assert door.machine.is_in("closing")
        rig.feed("obstacle", 0.2)
        await rig.tick()
        assert door.machine.is_in("opening")
        assert door.told == ["motor on", "motor off", "motor on", 0.2]
        assert rig.times("lamp") == [2.0, 7.0]
        assert rig.values("lamp") == [True, False]
    assert door.machine.configuration == ()
    assert door.told[-1] == "motor off"


@pytest.mark.row(103)
async def test_timers_fire_at_their_very_nanosecond_in_an_event_context() -> None:
    class Clock(Told):
        tick = OutPort(TimedLong)
        chart = Chart(
            State("a", After(0.000_000_001, to="b"), entry="beat", initial=True),
            State("b", After(1.234_567_891, to="a"), entry="beat"),
        )

        def beat(self) -> None:
            self.told.append(self.clock.monotonic_ns())

    clock = Clock("clock0")
    async with Rig(clock, context=EventContext()) as rig:
        begun = clock.told[0]
        await rig.advance(3.0)
    assert [at - begun for at in clock.told] == [
        0, 1, 1_234_567_892, 1_234_567_893, 2_469_135_784, 2_469_135_785,
    ]  # fmt: skip


@pytest.mark.row(103)
async def test_in_a_context_with_a_rate_a_timer_fires_in_the_first_cycle_at_or_after_its_deadline() -> None:
    door = Door("door0")
    async with Rig(door, context=PeriodicContext(rate=10.0)) as rig:
        rig.feed("button", True)
        await rig.tick()  # entered at 0.1 s
        await rig.advance(1.9)
        assert door.machine.is_in("opening")
        await rig.tick()
        assert door.machine.is_in("open")
        assert rig.times("lamp") == [pytest.approx(2.1)]


async def test_a_timer_ends_with_its_state_and_reads_a_parameter_when_the_state_is_entered() -> None:
    door = Door("door0")
    async with Rig(door, context=EventContext()) as rig:
        await door.configure(dwell=0.5)
        rig.feed("button", True)
        await rig.tick()
        await rig.advance(2.0)
        assert list(door.machine.timers) == ["after.open.1"]
        rig.feed("button", True)
        await rig.tick()
        assert list(door.machine.timers) == ["after.closing.1"]
        await rig.advance(1.9)
        assert door.machine.is_in("closing")
        await rig.advance(0.1)
        assert door.machine.is_in("closed")
        assert door.machine.timers == {}


class Sorter(Told):
    """Says which events came."""

    a = EventPort(TimedLong)
    b = EventPort(TimedLong, event="bee")
    plain = InPort(TimedLong)
    chart = Chart(State("s", On("a", action="tell"), On("bee", action="told_b"), On("stop", action="told_stop")))

    def told_b(self, sample: TimedLong) -> None:
        self.told.append(("b", sample.data))

    def tell(self, what: Any = None) -> None:
        self.told.append(("a", what.data))

    def told_stop(self, what: Any) -> None:
        self.told.append(("stop", getattr(what, "data", what)))


@pytest.mark.row(102)
async def test_events_are_taken_in_the_order_of_arrival_across_ports_and_sends() -> None:
    sorter = Sorter("s0")
    async with Rig(sorter, context=PeriodicContext(rate=1.0)) as rig:
        rig.feed("b", 1)
        rig.feed("a", 2, 3)
        sorter.machine.send("stop", 4)
        rig.feed("b", 5)
        await rig.tick()
    assert sorter.told == [("b", 1), ("a", 2), ("a", 3), ("stop", 4), ("b", 5)]


class Buttons(StateMachineComponent):
    out = OutPort(TimedLong)
    chart = Chart(State("s"))


@pytest.mark.row(102)
async def test_a_connector_names_its_event_and_its_buffer_policy_holds_for_events() -> None:
    sorter, buttons = Sorter("s0"), Buttons("buttons0")
    async with Rig(buttons, sorter, context=PeriodicContext(rate=1.0)) as rig:
        rig.connect("buttons0.out", "s0.a", fsm_event_name="stop", length=2, full="overwrite")
        for number in range(4):
            buttons.out.write_nowait(TimedLong(0, number))
        await rig.tick()
    assert sorter.told == [("stop", 2), ("stop", 3)]


async def test_an_event_that_nobody_knows_is_refused_by_send_with_what_was_meant() -> None:
    sorter = Sorter("s0")
    with pytest.raises(DeclarationError, match="no transition is for event 'stpo'; did you mean 'stop'"):
        sorter.machine.send("stpo")
    with pytest.raises(StateError, match="does not run"):
        sorter.machine.send("stop")


def _noted(name: str) -> Any:
    def act(self: Noted) -> None:
        self.told.append(name)
        if self.bad == name:
            raise ValueError(name)

    return act


class Noted(Told):
    """Raises where it is told to."""

    go = EventPort(TimedLong)
    bad = ""
    chart = Chart(
        State("out", On("go", to="in1"), initial=True, entry="e_out", exit="x_out"),
        State("in", State("in1", entry="e_in1", exit="x_in1"), entry="e_in", exit="x_in"),
        entry="e_root",
        exit="x_root",
    )
    e_out, x_out, e_in, x_in = map(_noted, ("e_out", "x_out", "e_in", "x_in"))
    e_in1, x_in1, e_root, x_root = map(_noted, ("e_in1", "x_in1", "e_root", "x_root"))


@pytest.mark.row(102)
@pytest.mark.parametrize(
    ("bad", "then"),
    [
        ("x_out", ["x_out", "x_root"]),
        ("e_in", ["x_out", "e_in", "x_in", "x_root"]),
        ("e_in1", ["x_out", "e_in", "e_in1", "x_in1", "x_in", "x_root"]),
    ],
)
async def test_an_action_that_raises_leads_to_error_and_exactly_what_was_entered_is_left(
    bad: str, then: list[str]
) -> None:
    one = Noted("one0")
    async with Rig(one, context=EventContext()) as rig:
        one.told.clear()
        one.bad = bad
        rig.feed("go", 1)
        with rig.expect_error(ValueError):
            await rig.tick()
        assert one.state is LifecycleState.ERROR
        assert one.told == then
        assert one.machine.configuration == ()
        one.bad = ""
        await rig.reset()
        await rig.activate()
        assert one.machine.configuration == ("out",)


def _awaited(name: str) -> Any:
    async def act(self: Noted) -> None:
        _noted(name)(self)

    return act


class AwaitingNoted(Noted):
    """The same with actions that may wait."""

    x_in1, x_in = map(_awaited, ("x_in1", "x_in"))


@pytest.mark.row(102)
@pytest.mark.parametrize("kind", [Noted, AwaitingNoted])
async def test_an_exit_action_that_raises_at_deactivation_keeps_no_other_from_running(kind: Any) -> None:
    one = kind("one0")
    async with Rig(one, context=EventContext()) as rig:
        rig.feed("go", 1)
        await rig.tick()
        one.told.clear()
        one.bad = "x_in1"
        with rig.expect_error(ValueError):
            await rig.deactivate()
        assert one.told == ["x_in1", "x_in", "x_root"]
        assert one.state is LifecycleState.INACTIVE


class Player(Told):
    """Regions, history, an end."""

    power = EventPort(TimedLong)
    next_ = EventPort(TimedLong, name="next", event="next")
    mute = EventPort(TimedLong)
    end = EventPort(TimedLong)
    chart = Chart(
        State("off", On("power", to="before"), On("end", to="over"), initial=True),
        Parallel(
            "on",
            State("track", State("t1", On("next", to="t2"), initial=True), State("t2", On("next", to="t1"))),
            State("sound", State("loud", On("mute", to="quiet"), initial=True), State("quiet", On("mute", to="loud"))),
            History("before", deep=True),
            On("power", to="off"),
        ),
        End("over"),
    )


@pytest.mark.row(103)
@pytest.mark.parametrize("kept", [False, True])
async def test_regions_are_active_together_and_history_brings_all_of_them_back(kept: bool) -> None:
    class Kept(Player):
        chart = Chart(*Player.chart.states, keep_history=kept)

    player = Kept("p0")
    async with Rig(player, context=EventContext()) as rig:

        async def press(*ports: str) -> tuple[str, ...]:
            for port in ports:
                rig.feed(port, 1)
            await rig.tick()
            return player.machine.configuration

        assert await press("power") == ("on", "track", "t1", "sound", "loud")
        assert await press("next", "mute") == ("on", "track", "t2", "sound", "quiet")
        assert await press("power") == ("off",)
        assert await press("power") == ("on", "track", "t2", "sound", "quiet")
        await rig.deactivate()
        await rig.activate()
        again = ("t2", "sound", "quiet") if kept else ("t1", "sound", "loud")
        assert await press("power") == ("on", "track", *again)


async def test_a_machine_at_its_end_deactivates_its_component_and_says_so() -> None:
    player = Player("p0")
    async with Rig(player, context=EventContext()) as rig:
        ended: list[MachineEnded] = []
        rig.kernel.bus.subscribe(MachineEnded, ended.append)
        rig.feed("end", 1)
        await rig.tick()
        await rig.tick()
        assert player.state is LifecycleState.INACTIVE
        assert player.has_finished
        assert ended == [MachineEnded("p0")]


@pytest.mark.row(104)
async def test_observers_hear_of_every_moment_of_the_machine_do_too() -> None:
    """OpenRTM's ON_DO is never fired by its state machines, and its listeners see an order of their own."""

    class Busy(Told):
        go = EventPort(TimedLong)
        chart = Chart(
            State("a", On("go", to="b", action="tell"), initial=True),
            State("b", State("b1", do="tell", entry="tell"), init="tell"),
        )

    busy = Busy("busy0")
    async with Rig(busy, context=EventContext(), debug=False) as rig:
        heard: list[tuple[str, str, str]] = []
        rig.kernel.bus.subscribe(MachineBefore, lambda e: heard.append((">", e.what, e.state)))
        rig.kernel.bus.subscribe(MachineAfter, lambda e: heard.append(("<", e.what, e.state)))
        changes: list[MachineChanged] = []
        rig.kernel.bus.subscribe(MachineChanged, changes.append)
        rig.feed("go", 1)
        await rig.tick()
        assert changes == [MachineChanged("busy0", ("a",), ("b", "b1"), "go")]
    moments = [
        ("state_change", ""), ("exit", "a"), ("transition", "a"), ("entry", "b"), ("init", "b"), ("entry", "b1"),
    ]  # fmt: skip
    expected = [(">", *moments[0])]
    for moment in moments[1:]:
        expected += [(">", *moment), ("<", *moment)]
    expected += [("<", *moments[0]), (">", "do", "b1"), ("<", "do", "b1")]
    assert heard[: len(expected)] == expected


@pytest.mark.row(104)
async def test_an_observer_is_told_what_an_action_raised() -> None:
    one = Noted("one0")
    async with Rig(one, context=EventContext()) as rig:
        heard: list[MachineAfter] = []
        rig.kernel.bus.subscribe(MachineAfter, heard.append)
        one.bad = "e_in"
        rig.feed("go", 1)
        with rig.expect_error(ValueError) as caught:
            await rig.tick()
    told = [(e.what, e.state) for e in heard if e.error is caught.error]
    assert told == [("entry", "in"), ("state_change", "")]


@pytest.mark.row(102)
async def test_an_event_is_carried_out_completely_before_the_next() -> None:
    class Chain(Told):
        go = EventPort(TimedLong)
        chart = Chart(
            State("a", On("go", to="b", action="ask"), initial=True),
            State("b", On("more", to="c"), On("go", action="tell")),
            State("c", Always(to="d", guard="yes")),
            State("d", On("go", to="a", action="tell"), On("later", action="late")),
        )

        def ask(self) -> None:
            self.machine.send("later")
            self.machine.raise_event("more")

        def yes(self) -> bool:
            return True

        def late(self) -> None:
            self.told.append("later")

    chain = Chain("c0")
    async with Rig(chain, context=EventContext()) as rig:
        rig.feed("go", 1)
        await rig.tick()
        await rig.advance(0)
        assert chain.machine.configuration == ("d",)
        assert chain.told == ["later"]
        assert chain.machine.ignored == 0


async def test_transitions_without_end_are_an_error_that_names_the_states() -> None:
    class Endless(Told):
        chart = Chart(State("a", Always(to="b"), initial=True), State("b", Always(to="a")))

    async with Rig(Endless("e0"), context=EventContext(), activate=False) as rig:
        with rig.expect_error(StateError) as caught:
            await rig.activate()
        assert "never settles" in str(caught.error)


async def test_a_machine_of_plain_actions_runs_in_a_thread() -> None:
    class Switch(Told):
        go = EventPort(TimedLong)
        chart = Chart(State("a", On("go", to="b"), initial=True), State("b", On("go", to="a"), entry="tell"))

    async with Kernel() as kernel:
        switch, buttons = await kernel.add(Switch("s0")), await kernel.add(Buttons("b0"))
        await kernel.connect(buttons.out, switch.ports["go"])
        await kernel.start(ThreadContext(rate=200.0), switch, activate=True)
        for number in range(3):
            buttons.out.write_nowait(TimedLong(0, number))
        for _ in range(400):
            if switch.machine.configuration == ("b",) and len(switch.told) == 2:
                break
            await kernel.sleep(0.01)
        assert [sample.data for sample in switch.told] == [0, 2]


@pytest.mark.row(103)
async def test_a_timer_of_no_time_at_all_fires_once_in_a_cycle() -> None:
    class Quick(Told):
        pause = Param(0.0, unit="s")
        chart = Chart(
            State("a", After("pause", to="b"), initial=True), State("b", After("pause", to="a"), entry="tell")
        )

    quick = Quick("q0")
    async with Rig(quick, context=PeriodicContext(rate=10.0)) as rig:
        await rig.tick(4)
        assert len(quick.told) == 2


@pytest.mark.row(102)
async def test_what_an_action_writes_to_a_port_of_its_own_is_for_the_next_cycle() -> None:
    class Echo(Told):
        go = EventPort(TimedLong)
        out = OutPort(TimedLong)
        chart = Chart(State("a", On("go", action="again")))

        def again(self, sample: TimedLong) -> None:
            self.told.append(sample.data)
            self.out.write_nowait(TimedLong(0, sample.data + 1))

    echo = Echo("e0")
    async with Rig(echo, context=PeriodicContext(rate=10.0)) as rig:
        rig.connect("e0.out", "e0.go")
        rig.feed("go", 1)
        for cycle in range(1, 4):
            await rig.tick()
            assert echo.told == list(range(1, cycle + 1))


@pytest.mark.row(102)
async def test_an_event_that_was_not_carried_out_before_a_deactivation_is_gone_after_it() -> None:
    sorter = Sorter("s0")
    async with Rig(sorter, context=PeriodicContext(rate=10.0)) as rig:
        sorter.machine.send("stop", 1)
        await rig.deactivate()
        await rig.activate()
        await rig.tick()
        assert sorter.told == []


@pytest.mark.row(102)
async def test_what_needs_no_event_comes_before_what_an_action_raised() -> None:
    class Both(Told):
        go = EventPort(TimedLong)
        chart = Chart(
            State("a", On("go", to="b", action="ask"), initial=True),
            State("b", Always(to="c", action="tell"), On("more", action="wrong")),
            State("c", On("more", to="d")),
            State("d"),
        )

        def ask(self) -> None:
            self.machine.raise_event("more")

        def wrong(self) -> None:
            self.told.append("too early")

    both = Both("b0")
    async with Rig(both, context=EventContext()) as rig:
        rig.feed("go", 1)
        await rig.tick()
        assert both.machine.configuration == ("d",)
        assert len(both.told) == 1


@pytest.mark.row(102)
async def test_at_its_end_a_machine_does_nothing_more_but_leave() -> None:
    class Ends(Told):
        go = EventPort(TimedLong)
        chart = Chart(
            State("a", On("go", to="over", action="ask"), initial=True),
            End("over", exit="tell"),
            On("more", action="wrong"),
        )

        def ask(self) -> None:
            self.machine.raise_event("more")

        def wrong(self) -> None:
            self.told.append("too late")

    ends = Ends("e0")
    async with Rig(ends, context=EventContext()) as rig:
        rig.feed("go", 1)
        await rig.tick()
        assert ends.machine.configuration == ()
        assert len(ends.told) == 1
        assert ends.told[0] != "too late"


class Waiting(StateMachineComponent):
    """Goes on as soon as it is ready."""

    ready = Param(False)
    chart = Chart(
        State("wait", Always(to="go", guard="is_ready"), On("poke", to="other", guard="never"), initial=True),
        State("go", Always(to="wait", guard="is_back")),
        State("other"),
    )

    def is_ready(self) -> bool:
        return self.ready

    def is_back(self) -> bool:
        return not self.ready

    def never(self) -> bool:
        return False


@pytest.mark.row(102)
@pytest.mark.parametrize("kind", [PeriodicContext, EventContext, ExternalContext])
async def test_what_needs_no_event_is_looked_at_in_every_cycle(kind: type[Context]) -> None:
    machine = Waiting("waiting0")
    async with Rig(machine, context=kind(rate=10.0) if kind is PeriodicContext else kind()) as rig:
        for ready, state in ((True, "go"), (False, "wait"), (True, "go")):
            await machine.configure(ready=ready)
            if isinstance(machine.context, EventContext):
                machine.context.trigger(machine)
            await rig.tick()
            assert machine.machine.configuration == (state,)


@pytest.mark.row(102)
async def test_what_needs_no_event_is_looked_at_after_an_event_that_leads_to_nothing() -> None:
    told: list[tuple[str, str]] = []

    class Poked(Waiting):
        def never(self) -> bool:
            self.now = True  # what the other guard sees when the event has led to nothing
            return False

        now = False

        def is_ready(self) -> bool:
            return self.now

        def is_back(self) -> bool:
            return False

    machine = Poked("poked0")
    async with Rig(machine, context=EventContext()) as rig:
        rig.kernel.bus.subscribe(MachineChanged, lambda event: told.append((event.event, event.new[0])))
        machine.machine.send("poke")
        await rig.tick()
        assert told[0] == ("poke", "go")
        assert machine.machine.ignored == 1


class Doors(Told):
    """Hears of all doors, and of one more closely."""

    opened = EventPort(TimedLong, event="door.open.front")
    chart = Chart(
        State(
            "s", On("door.shut", action="told_shut"), On("door", action="told_door"), On("doors", action="told_doors")
        )
    )

    def told_shut(self, what: Any) -> None:
        self.told.append(("shut", what))

    def told_door(self, what: Any) -> None:
        self.told.append(("door", getattr(what, "data", what)))

    def told_doors(self, what: Any) -> None:
        self.told.append(("doors", what))


@pytest.mark.row(102)
async def test_a_transition_takes_every_event_that_begins_with_its_name_and_a_dot() -> None:
    doors = Doors("doors0")
    async with Rig(doors, context=EventContext()) as rig:
        for number, event in enumerate(("door", "door.shut", "door.shut.hard", "door.open", "doors", "doors.x")):
            doors.machine.send(event, number)
        rig.feed("opened", 6)
        for unknown in ("doo", "doorbell", "shut", ".door"):
            with pytest.raises(DeclarationError, match="no transition is for event"):
                doors.machine.send(unknown)
        await rig.tick()
    expected = [("door", 0), ("shut", 1), ("shut", 2), ("door", 3), ("doors", 4), ("doors", 5), ("door", 6)]
    assert doors.told == expected


def test_what_an_action_takes_is_checked_for_ports_whose_event_begins_with_its_name() -> None:
    with pytest.raises(DeclarationError, match="told_door takes a TimedDouble, and opened carries TimedLong"):

        class Wrong(StateMachineComponent):
            opened = EventPort(TimedLong, event="door.open")
            chart = Chart(State("s", On("door", action="told_door")))

            def told_door(self, what: TimedDouble) -> None: ...


@pytest.mark.slow(kept_by="test_a_connector_names_its_event_and_its_buffer_policy_holds_for_events")
@pytest.mark.row(102)
async def test_an_event_port_connected_with_defaults_loses_no_event_before_the_machines_queue_is_full(
    caplog: pytest.LogCaptureFixture,
) -> None:
    sorter, buttons = Sorter("s0"), Buttons("buttons0")
    async with Rig(buttons, sorter, context=ExternalContext()) as rig:
        connector = rig.connect("buttons0.out", "s0.a")
        assert connector.profile.length == 8192
        for number in range(8192):
            buttons.out.write_nowait(TimedLong(0, number))
        await rig.tick()
        assert sorter.told == [("a", number) for number in range(8192)]
        assert sum(connector.statistics.dropped.values()) == 0
        assert not caplog.records
        sorter.told.clear()
        for number in range(8200):
            buttons.out.write_nowait(TimedLong(0, number))
        await rig.tick()
        assert sorter.told == [("a", number) for number in range(8, 8200)]
        assert connector.statistics.dropped["overwritten"] == 8
        assert "8 events were dropped: more than 8192 waited" in caplog.text
        caplog.clear()
        await rig.tick()
        assert not caplog.records, "said once"


@pytest.mark.row(102)
async def test_what_somebody_says_of_a_connector_holds_for_events_too() -> None:
    sorter, buttons = Sorter("s0"), Buttons("buttons0")
    async with Rig(buttons, sorter, context=ExternalContext()) as rig:
        lengths = [
            rig.connect("buttons0.out", "s0.a", **options).profile.length
            for options in ({"length": 3}, {"inport.buffer.length": 5, "allow_duplicate": True})
        ]
        newest = rig.connect("buttons0.out", "s0.b", subscription="new").profile.length
        plain = rig.connect("buttons0.out", "s0.plain", allow_duplicate=True).profile.length
    assert (lengths, newest, plain) == ([3, 5], 1, 8)
