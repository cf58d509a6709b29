"""Composites with members in kernels of other processes of this host."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from anyio import fail_after

from aiorts import Composite, Kernel, LifecycleState, PeriodicContext
from aiorts.errors import AiortsError, ComponentError, ConfigurationError, DeniedError, LinkError, StateError
from aiorts.sessions import Client
from aiorts.types import TimedLong
from control_parts import entry_of, with_client
from remote_parts import WAIT, Local, left, until

pytestmark = [pytest.mark.anyio, pytest.mark.row(101)]
ACTIVE, ERROR, INACTIVE = LifecycleState.ACTIVE, LifecycleState.ERROR, LifecycleState.INACTIVE


@pytest.fixture
def anyio_backend() -> tuple[str, dict[str, bool]]:
    """One loop: what the process of the other kernel does is most of each test."""
    return "asyncio", {"use_uvloop": False}


@asynccontextmanager
async def right(name: str = "right") -> AsyncIterator[Kernel]:
    async with Kernel(name, services={"links": {}}) as kernel:
        yield kernel


async def arm_of(kernel: Kernel, *, activate: bool = True, **options: Any) -> Composite:
    """A composite with one member here, and one elsewhere."""
    arm = await kernel.add(Composite("arm", Local("near"), "left/gripper", **options))
    await kernel.start(PeriodicContext(100.0), arm, activate=activate)
    return arm


async def asked(name: str, operation: str, **arguments: object) -> Any:
    def ask(client: Client) -> Any:
        return client.call(operation, **arguments)

    return await with_client(name, ask)


async def state_there(component: str = "gripper") -> str:
    states: Mapping[str, str] = (await asked("left", "names"))["components"].get(component, {})
    return states.get("loop", "")


async def is_there(state: str) -> None:
    """Wait until the gripper is in this state in its own kernel."""
    with fail_after(20):
        while await state_there() != state:
            await asyncio.sleep(0.01)


def near_and_gripper(kernel: Kernel) -> list[LifecycleState | None]:
    return [kernel.components[name].state for name in ("near", "gripper")]


# -- ports -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_an_exported_port_of_a_member_elsewhere_carries_samples(tmp_path: Path) -> None:
    async with left(tmp_path), right() as kernel:
        source = await kernel.create(Local, "source")
        exported = {"gripper.force": "force", "gripper.inp": "inp"}
        arm = await kernel.add(Composite("arm", Local("near"), "left/gripper", exported=exported))
        await kernel.connect(source.out, arm.ports["inp"], length=100)
        await kernel.connect(arm.ports["force"], source.inp, length=100)
        await kernel.start(PeriodicContext(100.0), arm, activate=True)
        for value in range(100):
            source.out.write_nowait(TimedLong(0, value))
        seen: list[int] = []
        with fail_after(20):
            while len(seen) < 100:
                seen.append((await source.inp.read()).data)
        assert seen == [2 * value for value in range(100)]


# -- lifecycle -------------------------------------------------------------------------------------------------------


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_the_lifecycle_of_the_composite_is_that_of_the_member_elsewhere(tmp_path: Path) -> None:
    async with left(tmp_path), right() as kernel:
        arm = await arm_of(kernel)
        assert (arm.state, await state_there()) == (ACTIVE, "active")
        await arm.deactivate()
        assert (arm.state, await state_there()) == (INACTIVE, "inactive")
        await arm.activate()
        assert (near_and_gripper(kernel), await state_there()) == ([ACTIVE, ACTIVE], "active")


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_an_activation_that_fails_elsewhere_activates_nothing(tmp_path: Path) -> None:
    async with left(tmp_path), right() as kernel:
        arm = await arm_of(kernel, activate=False)
        await kernel.components["gripper"].configure(stuck=True)
        with pytest.raises(ComponentError, match="is stuck"):
            await arm.activate()
        assert near_and_gripper(kernel) == [INACTIVE, ERROR]
        await kernel.components["gripper"].configure(stuck=False)
        await arm.reset()
        await arm.activate()
        assert (near_and_gripper(kernel), await state_there()) == ([ACTIVE, ACTIVE], "active")


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_an_activation_that_fails_here_is_taken_back_elsewhere(tmp_path: Path) -> None:
    class Stuck(Local):
        async def on_activated(self) -> None:
            raise RuntimeError("is stuck")

    async with left(tmp_path), right() as kernel:
        arm = await kernel.add(Composite("arm", "left/gripper", Stuck("near")))
        await kernel.start(PeriodicContext(100.0), arm)
        with pytest.raises(ComponentError, match="is stuck"):
            await arm.activate()
        assert (near_and_gripper(kernel), await state_there()) == ([ERROR, INACTIVE], "inactive")


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_what_is_asked_of_the_member_in_its_own_kernel_happens_in_the_composite(tmp_path: Path) -> None:
    async with left(tmp_path), right() as kernel:
        await arm_of(kernel)
        await asked("left", "deactivate", component="gripper")
        await until(lambda: near_and_gripper(kernel) == [ACTIVE, INACTIVE])
        await asked("left", "activate", component="gripper")
        await until(lambda: near_and_gripper(kernel) == [ACTIVE, ACTIVE])


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_a_source_that_has_finished_elsewhere_has_finished_here(tmp_path: Path) -> None:
    async with left(tmp_path), right() as kernel:
        source = await kernel.create(Local, "source")
        arm = await arm_of(kernel, exported=["gripper.inp"])
        await kernel.connect(source.out, arm.ports["inp"])
        source.out.write_nowait(TimedLong(0, -2))
        await until(lambda: kernel.components["gripper"].has_finished)
        assert near_and_gripper(kernel) == [ACTIVE, INACTIVE]


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
@pytest.mark.parametrize("before", ["active", "inactive"])
async def test_a_member_that_leaves_is_as_it_was_before_it_came(tmp_path: Path, before: str) -> None:
    async with left(tmp_path, activate=before == "active"):
        await is_there(before)
        async with right() as kernel:
            arm = await arm_of(kernel, activate=False)
            assert await state_there() == "inactive"
            await arm.activate()
            assert await state_there() == "active"
            await arm.remove_members("gripper")
            assert await state_there() == before
            assert ("gripper" in kernel.components, [one.name for one in arm.members]) == (False, ["near"])
            await arm.add_members("left/gripper")
            assert await state_there() == "active"
            await kernel.remove(kernel.components["gripper"])
            assert await state_there() == before
            await arm.add_members("left/gripper")
            assert await state_there() == "active"
            await kernel.remove(arm)
            assert (await state_there(), "gripper" in kernel.components) == (before, False)
        async with right("again") as kernel:
            await arm_of(kernel)
        await asyncio.sleep(0.3)  # a session that ended in order is no link that was lost, which would deactivate it
        assert await state_there() == before


# -- configuration ---------------------------------------------------------------------------------------------------


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_values_and_sets_are_those_of_the_member_elsewhere(tmp_path: Path) -> None:
    async with left(tmp_path), right() as kernel:
        await arm_of(kernel)
        gripper = kernel.components["gripper"]
        await gripper.configure(factor=5)
        await gripper.configuration.activate("large")
        there = await asked("left", "configuration", component="gripper")
        assert (there["active"], there["sets"]) == (
            "large",
            {"default": {"factor": 5, "stuck": False}, "large": {"factor": 1000}},
        )
        with pytest.raises(ConfigurationError, match="13 is no factor"):
            await gripper.configure(factor=13)
        assert gripper.configuration.values["factor"] == 1000
        await asked("left", "configure", component="gripper", values={"": {"factor": 7}})
        await until(lambda: gripper.configuration.values["factor"] == 7)


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_a_configuration_of_several_members_is_in_force_in_all_or_in_none(tmp_path: Path) -> None:
    async with left(tmp_path), right() as kernel:
        await arm_of(kernel)
        file = tmp_path / "sets.toml"
        await kernel.save_configuration(file)
        saved = file.read_text()
        changed = saved.replace("gain = 1\n", "gain = 3\n").replace("factor = 2\n", "factor = 13\n")
        assert changed != saved
        file.write_text(changed)
        with pytest.raises(ConfigurationError, match="13 is no factor"):
            await kernel.load_configuration(file)
        assert kernel.components["near"].configuration.values["gain"] == 1
        file.write_text(changed.replace("factor = 13\n", "factor = 4\n"))
        await kernel.load_configuration(file)
        there = await asked("left", "configuration", component="gripper")
        assert there["sets"]["default"]["factor"] == 4
        assert kernel.components["near"].configuration.values["gain"] == 3


# -- errors ----------------------------------------------------------------------------------------------------------

AFTER = {"stop": (ERROR, INACTIVE), "report": (ERROR, ACTIVE), "isolate": (ACTIVE, ACTIVE)}
"""The states of the composite and of the member here, by the policy, when the one elsewhere has failed."""


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
@pytest.mark.row(15)
@pytest.mark.parametrize("errors", AFTER)
async def test_an_error_elsewhere_is_one_here_and_a_reset_is_one_there(tmp_path: Path, errors: str) -> None:
    async with left(tmp_path), right() as kernel:
        source = await kernel.create(Local, "source")
        arm = await arm_of(kernel, exported=["gripper.inp"], errors=errors)
        await kernel.connect(source.out, arm.ports["inp"])
        source.out.write_nowait(TimedLong(0, -1))
        await until(lambda: near_and_gripper(kernel) == [AFTER[errors][1], ERROR])
        assert arm.state is AFTER[errors][0]
        assert "left/gripper: " in str(arm.last_error)
        assert "lost its grip" in str(arm.last_error)
        await arm.reset()
        await arm.activate()
        assert (near_and_gripper(kernel), await state_there()) == ([ACTIVE, ACTIVE], "active")


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
@pytest.mark.row(15)
@pytest.mark.parametrize("errors", AFTER)
async def test_a_member_whose_kernel_is_killed_is_in_error_until_that_is_back_and_it_is_reset(
    tmp_path: Path, errors: str
) -> None:
    async with AsyncExitStack() as lefts, right() as kernel:
        process = await lefts.enter_async_context(left(tmp_path))
        arm = await arm_of(kernel, errors=errors, exported=["gripper.*"])
        source = await kernel.create(Local, "source")
        await kernel.connect(source.out, arm.ports["inp"])
        await kernel.connect(arm.ports["force"], source.inp)
        process.kill()
        await until(lambda: near_and_gripper(kernel) == [AFTER[errors][1], ERROR])
        assert arm.state is AFTER[errors][0]
        assert "left/gripper: its kernel left is lost" in str(arm.last_error)
        with pytest.raises(AiortsError, match=r"no kernel 'left' runs|left is lost"):
            await arm.reset()
        await lefts.enter_async_context(left(tmp_path))
        await arm.reset()
        await arm.activate()
        assert (near_and_gripper(kernel), await state_there()) == ([ACTIVE, ACTIVE], "active")
        source.out.write_nowait(TimedLong(0, 21))
        with fail_after(20):
            while (await source.inp.read()).data != 42:
                pass


# -- refused ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_members_that_cannot_be_had_are_refused_with_the_reason_and_nothing_is_left(tmp_path: Path) -> None:
    async with left(tmp_path), right() as kernel:
        for member, error, why in (
            ("lft/gripper", LinkError, "lft/gripper: no kernel 'lft' runs; did you mean 'left'?"),
            ("left/griper", StateError, "left/griper: griper: no such component; did you mean gripper?"),
            ("left/near", StateError, "left/near: there is a component 'near' here already"),
        ):
            with pytest.raises(error) as caught:
                await kernel.add(Composite("arm", Local("near"), "left/finger", member))
            assert why in str(caught.value)
            assert not kernel.components


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_a_kernel_that_lets_others_look_only_has_no_members(tmp_path: Path) -> None:
    async with left(tmp_path, "left", "--control", "view"), right() as kernel:
        with pytest.raises(DeniedError, match=r"left/gripper: .*/left lets this kernel look only"):
            await kernel.add(Composite("arm", "left/gripper"))


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_a_component_is_a_member_of_one_composite_at_a_time_which_the_error_names(tmp_path: Path) -> None:
    async with left(tmp_path), right() as one, right("other") as two:
        await one.add(Composite("arm", "left/gripper"))
        with pytest.raises(StateError, match=r"left/gripper: .*is a member of right/arm already"):
            await two.add(Composite("hand", "left/gripper"))
        await one.remove(one.components["arm"])
        await two.add(Composite("hand", "left/gripper"))


@pytest.mark.slow
@pytest.mark.fault("G05")
async def test_what_is_cancelled_while_it_looks_for_a_member_leaves_nothing(tmp_path: Path) -> None:
    async with left(tmp_path), right() as kernel:
        for turns in (0, 1, 3, 10, 30, 100, 300):
            finding = asyncio.ensure_future(kernel.stand_in("left/gripper", "arm"))
            for _ in range(turns):
                await asyncio.sleep(0)
            finding.cancel()
            with suppress(asyncio.CancelledError):
                await kernel.remove(await finding)
            assert not kernel.components
        await kernel.add(Composite("arm", "left/gripper"))


@pytest.mark.slow
async def test_changes_there_while_it_is_activated_and_deactivated_here_hold_nothing_up(tmp_path: Path) -> None:
    async with left(tmp_path), right() as kernel:
        arm, over = await arm_of(kernel, activate=False), False

        async def change() -> None:
            number = 0
            while not over:
                number += 1
                await asked("left", "configure", component="gripper", values={"": {"factor": 20 + number}})

        changing = asyncio.ensure_future(change())
        try:
            for _ in range(10):
                await arm.activate()
                assert near_and_gripper(kernel) == [ACTIVE, ACTIVE]
                await arm.deactivate()
                assert near_and_gripper(kernel) == [INACTIVE, INACTIVE]
        finally:
            over = True
            await changing


@pytest.mark.slow
async def test_a_change_here_while_one_there_is_taken_over_is_in_force_in_both(tmp_path: Path) -> None:
    async with left(tmp_path), right() as kernel:
        await arm_of(kernel)
        gripper = kernel.components["gripper"]
        for number in range(1, 11):
            there = asyncio.ensure_future(
                asked("left", "configure", component="gripper", values={"": {"factor": 1000 + number}})
            )
            await asyncio.sleep(number * 0.001)
            await gripper.configure(factor=number + 20)
            await there
            with fail_after(10):
                while True:
                    parameters = (await asked("left", "configuration", component="gripper"))["parameters"]
                    if [one["value"] for one in parameters if one["name"] == "factor"] == [
                        gripper.configuration.values["factor"]
                    ]:
                        break
                    await asyncio.sleep(0.02)


@pytest.mark.slow
async def test_a_reset_that_was_refused_there_can_be_asked_for_again(tmp_path: Path) -> None:
    async with AsyncExitStack() as stack:
        process = await stack.enter_async_context(left(tmp_path))
        kernel, third = await stack.enter_async_context(right()), await stack.enter_async_context(right("third"))
        arm = await arm_of(kernel)
        process.kill()
        process.wait()
        await until(lambda: kernel.components["gripper"].state is ERROR)
        await stack.enter_async_context(left(tmp_path))
        await third.stand_in("left/gripper", "other")
        with pytest.raises(AiortsError, match="is a member of third/other already"):
            await arm.reset()
        await third.remove(third.components["gripper"])
        await arm.reset()
        await arm.activate()
        assert (near_and_gripper(kernel), await state_there()) == ([ACTIVE, ACTIVE], "active")


async def test_a_component_that_another_kernel_has_as_a_member_joins_no_composite_of_its_own() -> None:
    async with Kernel("unit", services={"control": {"name": "unit"}}) as kernel:
        near = await kernel.create(Local, "near")
        hand = await kernel.add(Composite("hand", Local("finger")))
        with await asyncio.to_thread(Client.open, entry_of("unit"), timeout=20.0) as client:
            await asyncio.to_thread(client.call, "hold", component="near", holder="right/arm")
            with pytest.raises(StateError, match="near: is a member of right/arm already, and cannot join arm"):
                await kernel.add(Composite("arm", near))
            with pytest.raises(StateError, match="near: is a member of right/arm already, and cannot join hand"):
                await hand.add_members("near")
        with fail_after(20):
            while near not in hand.members:
                with suppress(StateError):
                    await hand.add_members("near")
                await asyncio.sleep(0.01)


@pytest.mark.slow(kept_by="observe/test_samples.py::test_it_gives_each_sample_from_now_on")
async def test_samples_of_a_component_of_another_kernel_are_given_by_what_stands_for_it(tmp_path: Path) -> None:
    async with left(tmp_path, activate=True), right() as kernel:
        local, gripper = await kernel.add(Local("local")), await kernel.stand_in("left/gripper")
        await kernel.connect(local.out, gripper.ports["inp"])
        with fail_after(WAIT):
            async with kernel.samples("gripper.force") as stream:
                coming = asyncio.ensure_future(anext(stream))
                while not coming.done():  # what was written before the way there was whole is dropped
                    local.out.write_nowait(TimedLong(0, 3))
                    await asyncio.wait([coming], timeout=0.1)
                assert coming.result().data == 6
