"""One document describes the whole system, it is true, and it is what the schema says."""

from __future__ import annotations

import json
import math
from dataclasses import FrozenInstanceError
from typing import Any

import jsonschema
import pytest

import aiorts
from aiorts import Component, ExternalContext, InPort, Kernel, OutPort, Param, SimulatedClock
from aiorts.errors import ClosedError
from aiorts.testing import simulate
from aiorts.types import TimedDouble

VALIDATOR = jsonschema.Draft202012Validator(aiorts.profile_schema())


class Sensor(Component):
    """Measures something.

    And more that no table shows.
    """

    out = OutPort(TimedDouble, unit="m", doc="what it measured")
    gain = Param(1.0, ge=0.0, le=math.inf, unit="m", doc="how much")
    worst = Param(math.nan)
    mode = Param("fast", choices=("fast", "slow"))

    def on_execute(self) -> None:
        self.log.warning("gain is %s", self.gain)
        self.out.write_nowait(TimedDouble(0, self.gain))


class Arm(Component):
    force = InPort(TimedDouble, unit="m")

    def on_execute(self) -> None:
        raise ValueError("too hot")


def document(kernel: Kernel) -> Any:
    """The profile as somebody else reads it: strict JSON, valid by the schema."""

    def refuse(text: str) -> Any:
        raise AssertionError(f"{text} is not JSON")

    told = json.loads(kernel.profile().to_json(), parse_constant=refuse)
    VALIDATOR.validate(told)
    return told


@pytest.mark.slow
def test_schema_is_one() -> None:
    jsonschema.Draft202012Validator.check_schema(aiorts.profile_schema())
    assert aiorts.profile_schema()["$defs"]["ComponentReport"]["additionalProperties"] is False


@pytest.mark.row(79, 85)
def test_one_document_has_the_whole_system() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel("robot") as kernel:
            sensor, arm = await kernel.add(Sensor("sensor0")), await kernel.add(Arm("arm0"))
            wire = await kernel.connect(sensor.out, arm.force, length=3, name="force")
            loop = await kernel.start(ExternalContext(name="loop"), sensor, arm, activate=True)
            await clock.advance(2.0)
            await loop.tick()
            told = document(kernel)
            assert told["name"] == "robot"
            assert told["state"] == "open"
            assert told["schema"] == 1
            assert told["clock"]["kind"] == "SimulatedClock"
            assert told["clock"]["uptime_ns"] == 2_000_000_000
            assert told["versions"]["aiorts"] == aiorts.__version__
            one, other = told["components"]["sensor0"], told["components"]["arm0"]
            assert one["type"] == f"{__name__}:Sensor"
            assert one["doc"] == "Measures something."
            assert one["ports"]["out"] == {
                "name": "out",
                "direction": "out",
                "type": "TimedDouble",
                "unit": "m",
                "shape": None,
                "interfaces": [],
                "doc": "what it measured",
                "connectors": ["force"],
            }
            assert one["params"]["gain"]["value"] == 1.0
            assert one["params"]["gain"]["le"] == "Infinity"
            assert one["params"]["worst"]["value"] == "NaN"
            assert one["params"]["mode"]["choices"] == ["fast", "slow"]
            assert one["states"] == {"loop": "active"}
            assert other["states"] == {"loop": "error"}
            assert other["last_error"] == "ValueError: too hot"
            assert [(line["level"], line["text"], line["hook"]) for line in one["log"]] == [
                ("WARNING", "gain is 1.0", "on_execute")
            ]
            force = told["connectors"]["force"]
            assert (force["source"], force["target"]) == ("sensor0.out", "arm0.force")
            assert force["options"]["length"] == 3
            assert force["options"]["subscription"] == "flush"
            assert force["ledger"] == {
                "written": 1,
                "delivered": 0,
                "buffered": 0,
                "dropped": {"inactive": 1},
                "missed_gaps": 0,
                "silent": False,
                "at_ns": wire.statistics.at_ns,
                "mean_rate": None,
                "latency": None,
                "age": None,
                "age_within_ns": None,
                "acknowledged": None,
                "in_flight": 0,
                "round_trip_ns": None,
            }, wire.statistics
            assert told["contexts"]["loop"]["members"] == ["sensor0", "arm0"]
            assert told["contexts"]["loop"]["statistics"]["cycles"] == 1

    simulate(main)


@pytest.mark.row(79)
def test_a_profile_is_frozen_and_says_what_was() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            sensor = await kernel.add(Sensor("sensor0"))
            before = kernel.profile()
            await sensor.configure(gain=3.0)
            sensor.add_port("more", OutPort(TimedDouble))
            after = kernel.profile()
            assert before.components["sensor0"].params["gain"].value == 1.0
            assert after.components["sensor0"].params["gain"].value == 3.0
            assert set(before.components["sensor0"].ports) == {"out"}
            assert set(after.components["sensor0"].ports) == {"out", "more"}
            assert after.sequence > before.sequence
            with pytest.raises(FrozenInstanceError):
                before.name = "x"  # type: ignore[misc]
            with pytest.raises(TypeError):
                before.components["x"] = before.components["sensor0"]  # type: ignore[index]
            assert before.structure() != after.structure()
            # As plain data: NaN is no more equal to itself than it ever was.
            assert after.structure().to_plain() == kernel.profile().structure().to_plain()

    simulate(main)


def test_profile_takes_no_sample() -> None:
    async def main(clock: SimulatedClock) -> None:
        async with Kernel() as kernel:
            sensor, arm = await kernel.add(Sensor("sensor0")), await kernel.add(Arm("arm0"))
            await kernel.connect(sensor.out, arm.force, name="w")
            sensor.out.write_nowait(TimedDouble(0, 5.0))
            for _ in range(3):
                assert kernel.profile().connectors["w"].ledger.buffered == 1
            assert arm.force.read_nowait().data == 5.0

    simulate(main)


def test_a_kernel_that_was_never_opened_has_no_profile_and_a_closed_one_has() -> None:
    async def main(clock: SimulatedClock) -> None:
        kernel = Kernel()
        with pytest.raises(ClosedError):
            kernel.profile()
        async with kernel:
            await kernel.add(Sensor("sensor0"))
        told = document(kernel)
        assert told["state"] == "closed"
        assert told["components"] == {}

    simulate(main)
