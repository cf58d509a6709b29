"""Names of instances by policy, lowest free number first; no more instances of a type than it allows."""

from __future__ import annotations

import os
from typing import Any

import pytest

from aiorts import Component, Kernel, NamePolicy, PeriodicContext
from aiorts.errors import ConfigurationError, DeclarationError, InvalidNameError, StateError
from aiorts.testing import simulated


class Pid(Component):
    """Nothing in it."""


class Single(Component):
    """Two at the most."""

    max_instance = 2


@pytest.mark.row(90)
@simulated
async def test_default_is_type_and_lowest_free_number() -> None:
    async with Kernel() as kernel:
        names = [(await kernel.create(Pid)).name for _ in range(3)]
        assert names == ["pid0", "pid1", "pid2"]
        await kernel.remove(kernel.components["pid1"])
        assert (await kernel.create(Pid)).name == "pid1"
        assert (await kernel.add(Pid())).name == "pid3"


@pytest.mark.row(90)
@simulated
async def test_pattern_with_every_field() -> None:
    async with Kernel("robot") as kernel:
        kernel.naming = NamePolicy("{kernel}-{type}_{number}-p{pid}", first=1)
        one, two = await kernel.create(Pid), await kernel.create(Pid)
        assert (one.name, two.name) == (f"robot-pid_1-p{os.getpid()}", f"robot-pid_2-p{os.getpid()}")
        await kernel.remove(one)
        assert (await kernel.create(Pid)).name == one.name
        kernel.naming = NamePolicy("{host}{number}")
        assert (await kernel.create(Pid)).name.endswith("0")
        assert (await kernel.create(Pid, "mine")).name == "mine"
        kernel.naming = NamePolicy("a" * 100 + "{number}")
        with pytest.raises(InvalidNameError):
            await kernel.create(Pid)


@pytest.mark.row(90)
@simulated
async def test_scope_process_makes_names_unique_among_kernels_as_openrtm_does() -> None:
    async with Kernel("one") as one, Kernel("two") as two:
        assert (await one.create(Pid)).name == "pid0"
        assert (await two.create(Pid)).name == "pid0"
        two.naming = NamePolicy(scope="process")
        assert (await two.create(Pid)).name == "pid1"
        await one.create(Pid, "pid2")
        assert (await two.create(Pid)).name == "pid3"
        async with Kernel("three") as three:
            three.naming = NamePolicy(scope="process")
            assert (await three.create(Pid)).name == "pid4"
        assert (await two.create(Pid)).name == "pid4"


@simulated
async def test_a_name_is_no_contexts_either() -> None:
    async with Kernel() as kernel:
        kernel.naming = NamePolicy("periodic{number}")
        await kernel.start(PeriodicContext(1.0))
        assert (await kernel.create(Pid)).name == "periodic1"


@pytest.mark.row(90)
def test_environment_variables_are_not_read_in_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOT", "r2")
    for pattern in ("$(ROBOT){number}", "${ROBOT}{number}", "$ROBOT{number}"):
        with pytest.raises(ConfigurationError, match=r"environment variables are not read|no field"):
            NamePolicy(pattern)


@pytest.mark.parametrize(
    "wrong",
    [
        {"pattern": "{type}"},
        {"pattern": "{number}{number}"},
        {"pattern": "{version}{number}"},
        {"pattern": "%n{number}"},
        {"pattern": "a b{number}"},
        {"pattern": "{number"},
        {"scope": "host"},
        {"first": -1},
        {"first": True},
    ],
)
def test_wrong_policies_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError):
        NamePolicy(**wrong)


@simulated
async def test_what_is_no_policy_is_refused() -> None:
    async with Kernel() as kernel:
        with pytest.raises(DeclarationError):
            kernel.naming = "{type}{number}"  # type: ignore[assignment]


@pytest.mark.row(22)
@simulated
async def test_limit_of_instances_is_enforced_and_names_those_there_are() -> None:
    async with Kernel() as kernel:
        one, two = await kernel.create(Single, "left"), await kernel.create(Single, "right")
        for another in (kernel.create(Single, "third"), kernel.add(Single("third"))):
            with pytest.raises(StateError, match="allows 2 instances, 2 exist: left, right"):
                await another
        assert set(kernel.components) == {"left", "right"}
        await kernel.remove(one)
        await kernel.create(Single, "third")
        assert set(kernel.components) == {"right", "third"}
        assert two.name == "right"
        async with Kernel() as other:  # of one kernel
            await other.create(Single)
