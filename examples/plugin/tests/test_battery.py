"""The component in a rig, where time is virtual; the record and the codec held to what aiorts promises."""

from __future__ import annotations

import pytest
from aiorts_battery.codec import DeflateCodec
from aiorts_battery.command import battery_life
from aiorts_battery.records import BatteryState
from aiorts_battery.watch import BatteryWatch
from click.testing import CliRunner

from aiorts.errors import RecordError
from aiorts.testing import Rig, check_codec, check_component, simulated


@simulated
async def test_a_voltage_becomes_a_state() -> None:
    async with Rig(BatteryWatch("watch0")) as rig:
        rig.feed("voltage", 12.6)
        rig.feed("voltage", 10.2)
        await rig.tick()
        full, flat = rig.received("battery")
        assert (full.charge, full.low) == (1.0, False)
        assert (round(flat.charge, 3), flat.low) == (0.111, True)


def test_a_record_refuses_what_does_not_fit() -> None:
    with pytest.raises(RecordError, match="charge"):
        BatteryState(tm=0, charge="much")  # type: ignore[arg-type]


def test_the_component_is_a_good_neighbour() -> None:
    check_component(BatteryWatch)


def test_the_codec_gives_back_what_it_was_given() -> None:
    check_codec(DeflateCodec())


def test_the_command_says_how_long() -> None:
    done = CliRunner().invoke(battery_life, ["--capacity", "5", "--current", "2.5"])
    assert done.output == "2 h 00 min\n"
