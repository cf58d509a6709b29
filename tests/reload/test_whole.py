"""All of a context at once, nobody else late, nothing abandoned; composites, machines, plugins and packages."""

from __future__ import annotations

import asyncio
import gc
import os
import sys
import weakref
from typing import TYPE_CHECKING, Any

import pytest

from aiorts import (
    Catalogue,
    Component,
    Composite,
    InPort,
    Kernel,
    LifecycleState,
    PeriodicContext,
    StateMachineComponent,
)
from aiorts.errors import ComponentError, PluginError, StateError
from aiorts.statechart import After, Chart, State
from aiorts.testing import simulated
from aiorts.types import TimedDouble
from campaign import cases, time_limit

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from reload_files import Source

    Make = Callable[[str], Source]

pytestmark = pytest.mark.row(23)

MANY = """
class One(Component):
    version = 1
    seen = []

    def on_execute(self):
        self.seen.append((self.context.name, self.context.ticks, self.name, self.version))

    def on_reload(self, old):
        pass  # reload
"""
NEW = ("version = 1", "version = 2")
FAILS = "    def on_state_update(self):\n        if self.name == 'one8': 1 / 0"


class Reader(Component):
    inp = InPort(TimedDouble)


class Neighbour(Component):
    """Notes when its cycles begin."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.at: list[int] = []

    def on_execute(self) -> None:
        self.at.append(self.clock.monotonic_ns())


@pytest.mark.parametrize("good", [True, False])
def test_all_of_a_context_change_in_the_same_moment(good: bool, source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(MANY)
        seen: list[tuple[str, int, str, int]] = []
        file.get("One").seen = seen
        file.replace("seen = []", "import sys; seen = sys.modules['" + file.name + "'].One.seen")
        async with Kernel() as kernel:
            ones = [await kernel.create(file.get("One"), f"one{n}") for n in range(12)]
            first = await kernel.start(PeriodicContext(rate=100.0), *ones[:6], activate=True)
            second = await kernel.start(PeriodicContext(rate=37.0), *ones[6:], activate=True)
            await kernel.sleep(0.5)
            file.replace(*NEW)
            if not good:
                file.replace("    def on_reload", FAILS + "\n\n    def on_reload")
                with pytest.raises(ComponentError):
                    await kernel.reload("One", cycles=20)
            else:
                await kernel.reload("One", cycles=20)
            await kernel.sleep(0.5)
            by_cycle: dict[tuple[str, int], set[int]] = {}
            names: dict[tuple[str, int], list[str]] = {}
            for context, tick, name, version in seen:
                by_cycle.setdefault((context, tick), set()).add(version)
                names.setdefault((context, tick), []).append(name)
            assert all(len(versions) == 1 for versions in by_cycle.values())
            line = {first.name: [f"one{n}" for n in range(6)], second.name: [f"one{n}" for n in range(6, 12)]}
            assert all(order == line[context] for (context, _), order in names.items())
            assert {versions.pop() for versions in by_cycle.values()} == {1, 2}
            assert {each.version for each in (*first.members, *second.members)} == {2 if good else 1}
            assert [each.name for each in kernel.components.values()] == [f"one{n}" for n in range(12)]

    run()


@pytest.mark.slow
@simulated
async def test_others_are_not_late(source: Make) -> None:
    file = source(MANY)
    async with Kernel() as kernel:
        here, elsewhere = await kernel.create(Neighbour, "here"), await kernel.create(Neighbour, "elsewhere")
        ones = [await kernel.create(file.get("One"), f"one{n}") for n in range(50)]
        await kernel.start(PeriodicContext(rate=100.0), *ones, here, activate=True)
        await kernel.start(PeriodicContext(rate=1000.0), elsewhere, activate=True)
        for bad in (False, True, False):
            if bad:
                file.replace("pass  # reload", "if self.name == 'one40': 1 / 0")
                with pytest.raises(ComponentError):
                    await kernel.reload("One")
                file.replace("if self.name == 'one40': 1 / 0", "pass  # reload")
            else:
                await kernel.reload("One")
        await kernel.sleep(0.1)
        for neighbour, period in ((here, 10_000_000), (elsewhere, 1_000_000)):
            assert {two - one for one, two in zip(neighbour.at, neighbour.at[1:], strict=False)} == {period}


@pytest.mark.slow(kept_by="test_new_code_that_is_taken_back_is_finalized")
@pytest.mark.timeout(time_limit(600))
def test_old_classes_are_collected_and_nothing_grows(source: Make) -> None:
    declared = "data = InPort(TimedDouble)\n    out = OutPort(TimedDouble)\n    gain = Param(1.0)\n    seen = []"
    text = MANY.replace("seen = []", declared)
    rounds = max(1000, cases(10_000))

    @simulated
    async def run() -> None:
        file = source(text)
        file.replace("self.seen.append((self.context.name, self.context.ticks, self.name, self.version))", "pass")
        async with Kernel() as kernel:
            one = await kernel.create(file.get("One"), "one")
            two = await kernel.create(file.get("One"), "two")
            connector = await kernel.connect(one.out, two.data)
            context = await kernel.start(PeriodicContext(rate=100.0), one, activate=True)
            weak: list[weakref.ref[Any]] = []
            counts: list[int] = []
            del one, two
            bad = file.path.read_text(encoding="utf-8")
            for number in range(rounds):
                weak += [weakref.ref(type(kernel.components["one"])), weakref.ref(kernel.components["two"])]
                if number % 10 == 9:
                    file.path.write_text(bad.replace("pass  # reload", "1 / 0"), encoding="utf-8")
                    with pytest.raises(ComponentError):
                        await kernel.reload("One", cycles=1)
                    file.path.write_text(bad, encoding="utf-8")
                await kernel.reload("One", cycles=number % 2)
                if number in (rounds // 2, rounds - 1):
                    gc.collect()
                    counts.append(len(gc.get_objects()) - len(weak))
            gc.collect()
            assert sum(ref() is not None for ref in weak[2:]) == 0
            assert counts[1] - counts[0] < 100
            assert [name for name in sys.modules if name.startswith(f"{file.name}__")] == []
            assert not connector.closed
            assert context.statistics.cycles > rounds // 2

    run()


@pytest.mark.parametrize("groups", ["", "one0,one1|one2"])
def test_a_member_of_a_composite_stays_a_member(groups: str, source: Make) -> None:
    @simulated
    async def run() -> None:
        file = source(MANY.replace("seen = []", "seen = []\n    out = OutPort(TimedDouble)"))
        async with Kernel() as kernel:
            kind = file.get("One")
            ones = [kind(f"one{n}") for n in range(3)]
            reader = await kernel.create(Reader, "reader")
            pair = await kernel.add(Composite("pair", *ones, exported=["one0.*"], groups=groups))
            connector = await kernel.connect(pair.ports["out"], reader.inp)
            context = await kernel.start(PeriodicContext(rate=100.0), pair, activate=True)
            with pytest.raises(StateError, match="is a composite"):
                await kernel.reload(Composite)
            file.replace(*NEW)
            file.replace("out = OutPort(TimedDouble)", "out = OutPort(TimedDouble)\n    more = OutPort(TimedDouble)")
            await kernel.reload(kind)
            now: Any = [kernel.components[f"one{n}"] for n in range(3)]
            assert [each.version for each in now] == [2, 2, 2]
            assert context.members == tuple(now)
            assert pair.members == tuple(now)
            sections: Any = () if context._divided is None else context._divided.args[0]  # type: ignore[attr-defined]
            beside = {part for section in sections for group in section for part in group}
            assert beside == (set(now) if groups else set())
            assert set(pair.ports) == {"out", "more"}
            assert pair.ports["out"].connectors == (connector,)
            file.replace("self.seen.append(", "1 / 0, (")
            with pytest.raises(ComponentError):
                await kernel.reload(kind)
            assert context.members == pair.members == tuple(now)
            seen = len(now[0].seen)
            await kernel.sleep(0.1)
            assert len(now[0].seen) >= seen + 27
            await pair.remove_members(now[1])
            assert context.members == (now[0], now[2])

    run()


@simulated
async def test_a_state_machine_that_runs_is_refused_and_one_at_rest_is_not(source: Make) -> None:
    file = source("""
    from aiorts import StateMachineComponent
    from aiorts.statechart import Chart, State, After

    class Door(StateMachineComponent):
        chart = Chart(State("shut", After(1.0, to="open"), initial=True), State("open", After(1.0, to="shut")))
    """)
    async with Kernel() as kernel:
        door = await kernel.create(file.get("Door"), "door")
        context = await kernel.start(PeriodicContext(rate=100.0), door, activate=True)
        with pytest.raises(StateError, match="door: cannot be reloaded: is a state machine that runs"):
            await kernel.reload("Door")
        await context.deactivate(door)
        file.replace("open", "wide")
        await kernel.reload("Door")
        new: Any = kernel.components["door"]
        await context.activate(new)
        await kernel.sleep(1.5)
        assert new.machine.is_in("wide")


@simulated
async def test_a_type_of_a_plugin_is_reloaded_by_the_name_it_is_offered_under(tmp_path: Path) -> None:
    file = tmp_path / "gripper.py"
    file.write_text("from aiorts import Component\n\nclass Gripper(Component):\n    version = 1\n", encoding="utf-8")
    async with Kernel(plugins=Catalogue([tmp_path])) as kernel:
        name = next(name for name in kernel.plugins.extensions("components") if name.lower() == "gripper")
        old: Any = await kernel.create(name, "gripper")
        module = type(old).__module__
        file.write_text(file.read_text(encoding="utf-8").replace("1", "2"), encoding="utf-8")
        await kernel.reload(name)
        await kernel.reload(f"{file}:Gripper")
        assert kernel.components["gripper"].version == 2  # type: ignore[attr-defined]
        assert (await kernel.create(name, "other")).version == 2  # type: ignore[attr-defined]
        sys.modules.pop(module)


@simulated
async def test_an_edit_of_the_same_length_in_the_same_second_is_an_edit(
    source: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    file = source(MANY)
    assert list(file.path.parent.glob("__pycache__/*.pyc"))
    async with Kernel() as kernel:
        await kernel.create(file.get("One"), "one")
        for version in "234567":
            file.replace(f"version = {int(version) - 1}", f"version = {version}")
            os.utime(file.path, (1e9, 1e9))
            await kernel.reload("One")
            assert str(kernel.components["one"].version) == version  # type: ignore[attr-defined]


@simulated
async def test_a_module_of_a_package_stays_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "reloaded_package"
    package.mkdir()
    (package / "__init__.py").write_text("", encoding="utf-8")
    (package / "gains.py").write_text("GAIN = 3\n", encoding="utf-8")
    (package / "arm.py").write_text(
        "from __future__ import annotations\nfrom dataclasses import dataclass\nfrom typing import ClassVar\n"
        "from aiorts import Component\nfrom .gains import GAIN\n\n"
        "@dataclass\nclass State:\n    kind: ClassVar[str] = 'x'\n    n: int = 0\n\n"
        "class Arm(Component):\n    gain = GAIN\n    made = State(1)\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    import importlib

    arm = importlib.import_module("reloaded_package.arm")
    async with Kernel() as kernel:
        await kernel.create(arm.Arm, "arm")
        (package / "gains.py").write_text("GAIN = 4\n", encoding="utf-8")
        await kernel.reload("arm.py:Arm")
        new: Any = kernel.components["arm"]
        assert type(new).__module__ == "reloaded_package.arm"
        assert (new.gain, new.made.n, type(new.made).__module__) == (3, 1, "reloaded_package.arm")
        package_module: Any = sys.modules["reloaded_package"]
        assert package_module.arm.Arm is type(new)
        assert sys.modules["reloaded_package.arm"].Arm is type(new)
    for name in [name for name in sys.modules if name.startswith("reloaded_package")]:
        del sys.modules[name]


@simulated
async def test_what_on_reload_takes_away_is_the_new_ones_and_comes_back_with_the_old_code(source: Make) -> None:
    file = source("""
    class Device:
        open = True
        def close(self): self.open = False

    class Driver(Component):
        device = None

        def on_activated(self):
            self.device = Device()

        def on_finalize(self):
            if self.device is not None:
                self.device.close()

        def on_reload(self, old):
            self.device, old.device = old.device, None

        def on_execute(self):
            assert self.device.open
            # execute
    """)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Driver"), "driver")
        await kernel.start(PeriodicContext(rate=100.0), old, activate=True)
        device = old.device
        await kernel.reload("Driver")
        new: Any = kernel.components["driver"]
        assert (new.device, old.device, device.open) == (device, None, True)
        file.replace("# execute", "raise OSError")
        with pytest.raises(ComponentError):
            await kernel.reload("Driver")
        assert kernel.components["driver"] is new
        assert (new.device, device.open) == (device, True)
        await kernel.sleep(0.1)
        assert new.state is LifecycleState.ACTIVE
        await asyncio.sleep(0)
    assert not device.open


@simulated
async def test_an_error_names_file_and_line(source: Make) -> None:
    file = source(MANY)
    async with Kernel() as kernel:
        one = await kernel.create(file.get("One"), "one")
        await kernel.start(PeriodicContext(rate=100.0), one, activate=True)
        text = file.path.read_text(encoding="utf-8")
        for old, new, kind, line in (
            ("class One(Component):", "class One(Component:", PluginError, "class One(Component:"),
            ("    version = 1", "    version = 1 / 0", PluginError, "    version = 1 / 0"),
            ("        pass  # reload", "        1 / 0", ComponentError, "        1 / 0"),
            ("    seen = []", "    def __init__(self, name):\n        nothing", PluginError, "        nothing"),
            ("    seen = []", "    def on_initialize(self):\n        nothing", PluginError, "        nothing"),
            ("    def on_reload(self, old):", "    def on_reload(self):", PluginError, "    def on_reload(self):"),
        ):
            file.path.write_text(text.replace(old, new), encoding="utf-8")
            with pytest.raises(kind) as raised:
                await kernel.reload("One")
            assert str(file.path) in str(raised.value)
            assert f"{file.path}:{file.line_of(line)}" in str(raised.value)


@simulated
async def test_a_type_made_of_a_function_is_reloaded_as_any(source: Make) -> None:
    file = source("""
    from aiorts import component

    @component
    def double(value: float, *, factor: float = 2.0) -> float:
        return value * factor
    """)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("double"), "double", factor=3.0)
        file.replace("value * factor", "value * factor + 1")
        await kernel.reload("double")
        new: Any = kernel.components["double"]
        assert new.factor == 3.0
        assert new is not old
        assert type(new).function(1.0, factor=2.0) == 3.0


@simulated
async def test_what_the_new_code_has_taken_over_is_not_called_left_behind(
    source: Make, caplog: pytest.LogCaptureFixture
) -> None:
    file = source("""
    class Holder(Component):
        taken = None

        def on_initialize(self):
            self.mine = open(__file__)

        def on_reload(self, old):
            self.taken = old.mine
    """)
    async with Kernel() as kernel:
        old = await kernel.create(file.get("Holder"), "holder")
        await kernel.reload("Holder")
        assert "left after on_finalize" not in caplog.text
        new: Any = kernel.components["holder"]
        file.replace("self.taken = old.mine", "pass")
        await kernel.reload("Holder")
        assert "holder: left after on_finalize: file" in caplog.text
        for holder in (old, new, kernel.components["holder"]):
            holder.mine.close()  # type: ignore[attr-defined]


@simulated
async def test_new_code_that_is_taken_back_is_finalized(source: Make) -> None:
    file = source("""
    class Paired(Component):
        opened = []

        def on_initialize(self):
            self.opened.append(1)

        def on_finalize(self):
            self.opened.pop()

        def on_reload(self, old):
            pass  # reload
    """)
    opened: list[int] = file.get("Paired").opened
    file.replace("opened = []", f"import sys; opened = sys.modules[{file.name!r}].Paired.opened")
    async with Kernel() as kernel:
        await kernel.create(file.get("Paired"), "paired")
        await kernel.reload("Paired")
        assert opened == [1]
        file.replace("pass  # reload", "1 / 0")
        with pytest.raises(ComponentError):
            await kernel.reload("Paired")
        assert opened == [1]
    assert opened == []


class Door(StateMachineComponent):
    chart = Chart(State("shut", After(0.1, to="open"), initial=True), State("open", After(0.1, to="shut")))


@simulated
async def test_a_participant_of_a_machine_is_told_on(source: Make) -> None:
    file = source("""
    class Guard(aiorts.Participant):
        told = 0

        def on_action(self, change):
            self.told += 1

        def on_execute(self):
            pass  # execute
    """)
    async with Kernel() as kernel:
        door = await kernel.create(Door, "door")
        guard = await kernel.create(file.get("Guard"), "guard")
        door.machine.add_participant(guard)
        await kernel.start(PeriodicContext(rate=100.0), door, guard, activate=True)
        await kernel.reload("Guard", cycles=1)
        new: Any = kernel.components["guard"]
        await kernel.sleep(1.0)
        told = new.told
        assert told >= 9
        file.replace("pass  # execute", "1 / 0")
        with pytest.raises(ComponentError):
            await kernel.reload("Guard")
        await kernel.sleep(1.0)
        assert new.told >= told + 9
