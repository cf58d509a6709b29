"""The robot's drive: CSV, recording, replay at 100 times its speed, and the heading that the robot itself had."""

from __future__ import annotations

import importlib.util
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from aiorts import Kernel, SimulatedClock
from aiorts.system import build, load, wait_finished
from aiorts.testing import simulate
from aiorts.types import TimedShortSeq
from aiorts_flexi.recordings.logger import FlexiLogger
from aiorts_log import RecordingReader, RecordingWriter

EXAMPLES = Path(__file__).parents[2] / "examples"
ROOMBA = EXAMPLES / "roomba"
sys.path.insert(0, str(EXAMPLES / "recording"))

import replay as example  # noqa: E402

VERIFIED = "heading verified: 1216 of 1216 within 1e-6 rad"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.mcap"
    example.convert(ROOMBA / "imu.txt", path)
    return path


async def play(clock: SimulatedClock, path: Path, *changes: str) -> tuple[int, float]:
    """Exit status, and the seconds that it took."""
    recorder = [f"recorder.logfile={path.with_name('driven.mcap')}", "recorder.min_free=0"]
    async with Kernel(clock=clock) as kernel:
        await build(kernel, load(ROOMBA / "replay.toml", [f"player.logfile={path}", *recorder, *changes]))
        assert await wait_finished(kernel) == ()
    return kernel.exit_status, clock.time()


@pytest.mark.slow(kept_by="first")
@pytest.mark.row(115)
@pytest.mark.row(116)
@pytest.mark.parametrize(("speed", "seconds"), [(100.0, 0.19), (1.0, 19.0)])
def test_replayed_it_gives_the_heading_of_the_robot(
    speed: float, seconds: float, drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, took = simulate(lambda clock: play(clock, drive, f"player.speed={speed}"))
    assert (status, capsys.readouterr().out.splitlines()) == (0, [VERIFIED])
    assert took == pytest.approx(seconds, rel=0.02)


@pytest.mark.slow(kept_by="test_replayed_it_gives_the_heading_of_the_robot")
def test_with_stamps_of_now_it_does_as_well(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, _ = simulate(lambda clock: play(clock, drive, "player.absolute=false"))
    assert (status, capsys.readouterr().out.splitlines()) == (0, [VERIFIED])


@pytest.mark.slow(kept_by="test_replayed_it_gives_the_heading_of_the_robot")
def test_of_another_drive_it_does_not(tmp_path: Path, drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with RecordingReader(drive) as reader, RecordingWriter(tmp_path / "other.mcap") as writer:
        ports = {name: writer.add_port(name, port.type, dict(port.metadata)) for name, port in reader.ports.items()}
        for number, (name, log_time, sample) in enumerate(reader.records()):
            changed = TimedShortSeq(sample.tm, [0, 0]) if name == "encoders" and number > 3000 else sample
            writer.write(ports[name], changed, log_time)
    status, _ = simulate(lambda clock: play(clock, tmp_path / "other.mcap"))
    assert status == 1
    assert capsys.readouterr().out.startswith("heading not verified: row 1001")


@pytest.mark.slow(
    kept_by="flexi/test_replaying.py::TestDeterminism::test_recorded_replayed_and_recorded_again_is_the_same_to_the_byte"
)
@pytest.mark.row(117)
def test_replayed_and_recorded_again_it_is_the_same_to_the_byte(tmp_path: Path, drive: Path) -> None:
    async def main(clock: SimulatedClock) -> None:
        from aiorts import EventContext

        async with Kernel(clock=clock) as kernel:
            player = await kernel.create(FlexiLogger, mode="replay", logfile=str(drive), absolute=True, speed=100.0)
            types: list[Any] = [port.type.__name__ for port in player.ports.values()]
            path = str(tmp_path / "again.mcap")
            recorder = await kernel.create(
                FlexiLogger, inputs=types, names=list(player.ports), logfile=path, min_free=0.0
            )
            for name, port in player.ports.items():
                await kernel.connect(port, recorder.ports[name])
            await kernel.start(EventContext(), recorder, activate=True)
            await kernel.start(EventContext(), player, activate=True)
            await wait_finished(kernel)

    simulate(main)
    with RecordingReader(drive) as first, RecordingReader(tmp_path / "again.mcap") as again:
        assert first.count == again.count == 3648
        for before, after in zip(first.samples(), again.samples(), strict=True):
            assert (before.port.name, before.sequence, before.data) == (after.port.name, after.sequence, after.data)
            exact = (before.log_time - first.start) / 100
            assert 0 <= after.log_time - again.start - exact < 1


@pytest.mark.slow(kept_by="test_replayed_it_gives_the_heading_of_the_robot")
def test_the_commands_of_its_readme_do_what_they_say(tmp_path: Path) -> None:
    text = (EXAMPLES / "recording" / "README.md").read_text()
    lines = text.partition("```sh\n")[2].partition("```")[0].replace("\\\n", " ").splitlines()
    commands = [shlex.split(line) for line in lines]
    assert [command[:3] for command in commands] == [
        ["aiorts", "log", "convert"],
        ["aiorts", "run", "examples/roomba/replay.toml"],
        ["aiorts", "log", "plot"],
    ]
    (tmp_path / "examples").symlink_to(EXAMPLES)
    for command in commands[: 3 if importlib.util.find_spec("matplotlib") else 2]:
        more = ["--set", "recorder.min_free=0"] if "run" in command else []
        arguments = [sys.executable, "-m", "aiorts", *command[1:], *more]
        done = subprocess.run(arguments, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr
        if "run" in command:
            assert done.stdout.splitlines() == [VERIFIED]
    with RecordingReader(tmp_path / "driven.mcap") as reader:
        assert (reader.count, [port.type_name for port in reader.ports.values()]) == (1216, ["TimedPose2D"])
