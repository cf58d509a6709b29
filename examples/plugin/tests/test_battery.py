"""The component in a rig, where time is virtual; the record and the codec held to what aiorts promises."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path

import pytest
from aiorts_battery.codec import DeflateCodec
from aiorts_battery.command import battery_life
from aiorts_battery.guard import Limits
from aiorts_battery.records import BatteryState
from aiorts_battery.watch import BatteryWatch
from click.testing import CliRunner

from aiorts import Catalogue, Kernel
from aiorts.errors import RecordError
from aiorts.system import check, load, prepare
from aiorts.testing import Rig, check_codec, check_component, simulated

PLUGIN = Path(__file__).parents[1]


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


@simulated
async def test_the_service_ends_the_run_when_the_reserve_is_reached() -> None:
    services = {"battery": {"reserve": 0.3, "interval": 0.5}}
    async with Kernel(plugins=Catalogue([PLUGIN]), services=services) as kernel:
        watch = await kernel.add(BatteryWatch("watch0"))
        ending = asyncio.ensure_future(kernel.wait_stop_requested())
        await kernel.sleep(1.9)
        assert kernel.profile().services["battery"] == {"reserve": 0.3, "looks": 3}
        assert not ending.done()
        watch.charge = 0.25
        await kernel.sleep(0.5)
        assert ending.done()


def test_the_table_and_the_option_say_what_it_goes_by(tmp_path: Path) -> None:
    path = tmp_path / "system.toml"
    path.write_text("schema = 1\n[battery]\ninterval = 0.5\nreserve = 0.2\n")
    plan = prepare(load(path), Catalogue([PLUGIN]), {"battery": {"reserve": 0.4}})
    assert plan.services["battery"].settings == Limits(reserve=0.4, interval=0.5)
    path.write_text("schema = 1\n[battery]\nreserv = 0.2\ninterval = 0\n")
    assert [(one.line, one.message) for one in check(path, plugins=[PLUGIN])] == [
        (3, "unknown key 'reserv'; did you mean 'reserve'?"),
        (4, "expected seconds above 0, such as 1.0, got 0"),
    ]
    command = [sys.executable, "-m", "aiorts", "--plugins", str(PLUGIN), "run", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
    assert "Options of the service battery:\n  --battery-reserve FLOAT" in done.stdout
