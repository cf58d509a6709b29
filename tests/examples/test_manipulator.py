"""The force-controlled manipulator, and every way in which it must not pass."""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from aiorts import Kernel, LifecycleState
from aiorts.kernel.extensions.files import load_file
from aiorts.model.wanted.plan import plan
from aiorts.system import Choices, build, load, wanted
from aiorts.testing import Rig, simulate
from run_parts import here

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "manipulator"
HELD = "the same inputs, the same outputs: 700 of 700 ticks, to the last bit"
FOUR = ("sensor", "joystick", "damper", "arm")
numbers = st.floats(-1.0, 1.0)


def module(name: str, folder: Path = EXAMPLE) -> Any:
    return load_file(folder / f"{name}.py")


def ran(folder: Path, *arguments: str) -> tuple[int, list[str], str]:
    """A command: exit status, lines of standard output, standard error."""
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, capture_output=True, text=True, timeout=40, check=False
    )
    return done.returncode, done.stdout.splitlines(), done.stderr


def simulated(*changes: str, folder: Path = EXAMPLE, file: str = "sim.toml") -> tuple[int, list[str], str]:
    """In this process, as a command."""
    settings = [part for change in changes for part in ("--set", change)]
    done = here(folder, "run", file, *settings)
    return done.returncode, done.stdout.splitlines(), done.stderr


def played(capsys: pytest.CaptureFixture[str], file: Path, *changes: str) -> tuple[int, list[str]]:
    """As `simulated`, in this process: sooner."""

    async def main(_clock: object) -> int:
        async with Kernel() as kernel:
            await build(kernel, load(file, changes))
            return await kernel.wait_stop_requested()

    status = simulate(main)
    return status, capsys.readouterr().out.splitlines()


# -- what is promised --------------------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="test_the_four_are_one_composite_that_runs_in_one_context")
def test_all_four_runs_are_as_promised_and_shown_in_one_table() -> None:
    status, lines, errors = ran(ROOT, "examples/manipulator/compare.py")
    assert (status, errors) == (0, ""), lines
    assert [line.split()[0] for line in lines] == ["set", "simulator", "simulator", "real", "replayed", "real"]
    assert lines[4].endswith(HELD)
    assert "not as promised" not in "".join(lines)


@pytest.mark.slow(kept_by="test_one_bit_of_one_answer_is_found")
def test_the_simulator_says_the_same_every_time(tmp_path: Path) -> None:
    command = ("-m", "aiorts", "run", "sim.toml", "--set")
    first, second = (ran(EXAMPLE, *command, f"judge.record={tmp_path / name}") for name in ("one", "two"))
    assert first == second
    assert first[0] == 0
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


@pytest.mark.slow(kept_by="first")
def test_the_force_settles_and_the_brake_holds(tmp_path: Path) -> None:
    """Read from the recording itself, not from what the judge says of it."""
    assert simulated(f"judge.record={tmp_path / 'run'}")[0] == 0
    rows = [line.split(",") for line in (tmp_path / "run").read_text().splitlines()]
    touch, speed = [float(row[5]) for row in rows], [float(row[3]) for row in rows]
    assert len(rows) == 700
    assert all(abs(force - 10.0) <= 0.2 for force in touch[100:500])
    pressed = [row[4] for row in rows].index("True")
    assert abs(speed[pressed]) > 0.04
    assert not any(speed[pressed + 2 :])


def test_the_two_system_files_give_the_controller_the_same_description() -> None:
    """Only who drives whom, and by which clock, differs."""
    sim, real = load(EXAMPLE / "sim.toml"), load(EXAMPLE / "real.toml")
    assert (sim.clock.kind, real.clock.kind) == ("simulated", "system")
    assert (sim.contexts["loop"].kind, real.contexts["loop"].kind) == ("external", "periodic")
    differing = [name for name in sim.components if sim.components[name].type != real.components[name].type]
    assert differing == ["world"]
    assert sim.connections == real.connections
    assert sim.composites == real.composites
    assert [sim.components[name] for name in FOUR] == [real.components[name] for name in FOUR]


def test_one_file_for_robot_and_simulator_is_either_system() -> None:
    robot = EXAMPLE / "robot.toml"
    assert plan(wanted(load(EXAMPLE / "sim.toml")), wanted(load(robot))).steps == ()
    real, hardware = wanted(load(EXAMPLE / "real.toml")), wanted(load(robot, (), Choices(("sim=false",))))
    assert hardware.components == real.components
    assert hardware.connections == real.connections
    assert hardware.clock == real.clock
    assert hardware.contexts["ticks"].members == real.contexts["loop"].members


@pytest.mark.slow(kept_by="test_one_file_for_robot_and_simulator_is_either_system")
def test_one_file_for_robot_and_simulator_runs_as_either() -> None:
    assert simulated(file="robot.toml") == simulated(file="sim.toml")
    real = here(EXAMPLE, "run", "robot.toml", "--var", "sim=false")
    lines = real.stdout.splitlines()
    assert (real.returncode, real.stderr) == (0, "")
    assert lines[1].startswith("damped ")


def test_the_four_are_one_composite_that_runs_in_one_context() -> None:
    async def main(_clock: object) -> None:
        async with Kernel() as kernel:
            await build(kernel, load(EXAMPLE / "sim.toml"))
            loop, composite = kernel.contexts["loop"], kernel.components["manipulator"]
            await kernel.sleep(0.1)
            assert loop.profile.members == FOUR
            assert composite.contexts == (loop,)
            assert composite.state is LifecycleState.ACTIVE
            assert [kernel.components[name].contexts for name in FOUR] == [(loop,)] * 4
            assert kernel.components["damper"].configuration.active == "damped"
            assert 49 <= loop.ticks <= 51

    simulate(main)


@pytest.mark.slow
def test_another_set_takes_effect_while_the_arm_moves() -> None:
    async def main(_clock: object) -> float:
        async with Kernel() as kernel:
            await build(kernel, load(EXAMPLE / "sim.toml"))
            await kernel.sleep(0.04)
            await kernel.components["damper"].configuration.activate("brisk")
            await kernel.sleep(0.5)
            touch: list[float] = vars(kernel.components["judge"])["columns"][5]
            return max(touch)

    assert 10.5 < simulate(main) < 12.5, "damped alone reaches 10.0 N, brisk alone 12.9 N"


# -- and what must not pass --------------------------------------------------------------------------------------------


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    return Path(shutil.copytree(EXAMPLE, tmp_path / "manipulator", ignore=shutil.ignore_patterns("__pycache__")))


def broken(folder: Path, file: str, old: str, new: str) -> None:
    text = (folder / file).read_text()
    assert text.count(old) == 1, f"{file} has {text.count(old)} times {old!r}"
    (folder / file).write_text(text.replace(old, new))


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("damper.py", "push.data - force.data", "0.95 * push.data - force.data", "the force at 1 s is 9.50 N"),
        ("damper.py", "push.data - force.data", "push.data - 0.0 * force.data", "the force at 1 s is "),
        ("devices.py", "self.scale * reading.data", "self.scale * reading.data + 0.3", "the force at 1 s is 9.70 N"),
        ("damper.py", "1.0 + self.damping *", "1.0 + 70.0 *", "the overshoot is 28.9%, where a mass on a damper has 0"),
        (
            "devices.py",
            "TimedBoolean(self.clock.time_ns(), True)",
            "TimedBoolean(0, False)",
            "the brake was called and",
        ),
        ("devices.py", "await self.brake.proxy.engage()", "self.brake.proxy", "the brake was called and the arm moved"),
        ("world.py", "self.brake_force * dt", "0.01 * self.brake_force * dt", "the brake was called and the arm moved"),
        ("devices.py", "-self.newtons if pulls", "self.newtons if pulls", "the arm moved at 0.000 m/s when the brake"),
        ("damper.py", "speed = self.speed +", "speed = self.ticks +", " of 700 ticks came"),
    ],
)
def test_what_is_broken_is_said_with_status_1(
    copy: Path, capsys: pytest.CaptureFixture[str], file: str, old: str, new: str, said: str
) -> None:
    broken(copy, file, old, new)
    status, lines = played(capsys, copy / "sim.toml")
    assert status == 1
    assert any(line.startswith("not as promised: ") and said in line for line in lines), lines


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("joystick.newtons=0", "the joystick was not pushed"),
        ("joystick.press_after=701", "nobody called the brake"),
        ("joystick.press_after=300", "the arm moved at 0.000 m/s when the brake was called: nothing to stop"),
        ("world.stiffness=300", "the force at 1 s is"),
        ("sensor.scale=25", "the force at 1 s is 8.00 N"),
        ("judge.within=1e-9", "the force at 1 s is 10.00 N"),
    ],
)
def test_other_parameters_that_break_a_promise_do_too(
    capsys: pytest.CaptureFixture[str], change: str, said: str
) -> None:
    status, lines = played(capsys, EXAMPLE / "sim.toml", change)
    assert status == 1
    assert any(line.startswith("not as promised: ") and said in line for line in lines), lines


@pytest.mark.slow(kept_by="test_the_force_settles_and_the_brake_holds")
def test_an_arm_without_a_brake_to_call_is_said(copy: Path) -> None:
    broken(copy, "sim.toml", 'from = "joystick.brake"\nto = "arm.brake"', 'from = "arm.speed"\nto = "arm.encoder"')
    status, lines, errors = simulated(folder=copy)
    assert status == 1
    assert lines[-1].startswith("not as promised: 601 of 700 ticks came")
    assert "joystick" in errors


@pytest.mark.slow(kept_by="test_the_two_system_files_give_the_controller_the_same_description")
def test_a_controller_at_another_rate_than_its_own_is_refused(copy: Path) -> None:
    broken(copy, "real.toml", "rate = 500.0", "rate = 400.0")
    status, lines, errors = simulated("judge.patience=0.2", folder=copy, file="real.toml")
    assert status == 1
    assert lines == ["not as promised: 0 of 700 ticks came"]
    assert "period = 0.002 s, but loop runs at 400 Hz" in errors


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    path = tmp_path_factory.mktemp("manipulator") / "run"
    assert simulated(f"judge.record={path}")[0] == 0
    return path.read_text().splitlines()


def replayed(capsys: pytest.CaptureFixture[str], folder: Path, lines: list[str]) -> tuple[int, list[str]]:
    (folder / "tape").write_text("".join(f"{line}\n" for line in lines))
    return played(capsys, EXAMPLE / "replay.toml", f"tape.path={folder / 'tape'}")


@pytest.mark.slow(kept_by="first")
def test_the_same_inputs_give_the_same_outputs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, recording: list[str]
) -> None:
    assert replayed(capsys, tmp_path, recording) == (0, [HELD])


@pytest.mark.parametrize("tick", [0, 1, 350, 699])
def test_one_bit_of_one_answer_is_found(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, recording: list[str], tick: int
) -> None:
    push, force, command, *rest = recording[tick].split(",")
    other = repr(math.nextafter(float(command), math.inf))
    lines = [*recording[:tick], ",".join([push, force, other, *rest]), *recording[tick + 1 :]]
    status, said = replayed(capsys, tmp_path, lines)
    assert status == 1
    assert said == [HELD.replace("700 of", "699 of"), f"not as promised: tick {tick}: [{command}] m/s, then [{other}]"]


def test_nothing_compared_is_not_the_same(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    status, said = replayed(capsys, tmp_path, [])
    assert (status, said[-1]) == (1, "not as promised: nothing was compared")


@pytest.mark.slow(kept_by="test_one_bit_of_one_answer_is_found")
@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        (
            "damper.py",
            "force.data) * self.period",
            "force.data) * (self.period + 1e-12 * (self.clock.monotonic_ns() % 7))",
            "not as promised: replayed: tick ",
        ),
        ("sim.toml", "damping = 70.0", "damping = 180.0", "that is no difference"),
        ("judge.py", "made.stop > 2", "made.stop > 0", "not as promised: simulator: the brake was called"),
    ],
)
def test_the_comparison_of_the_runs_says_what_does_not_hold(
    copy: Path, file: str, old: str, new: str, said: str
) -> None:
    """A controller that asks the time; two sets that are alike; a run that is not as promised."""
    broken(copy, file, old, new)
    status, lines, _ = ran(copy, "compare.py")
    assert status == 1
    assert any(said in line for line in lines), lines


# -- what it is made of ------------------------------------------------------------------------------------------------


@pytest.mark.slow(kept_by="test_the_wall_pushes_and_never_pulls")
@given(push=numbers, damping=st.floats(20.0, 400.0), mass=st.floats(0.5, 5.0))
def test_in_free_space_the_damper_moves_as_its_law_says(push: float, damping: float, mass: float) -> None:
    """v(t) = F/D (1 - exp(-D t / M)), within the first order of the period."""

    async def main(_clock: object) -> None:
        damper = module("damper").Damper("damper")
        async with Rig(damper) as rig:
            await damper.configure(damping=damping, mass=mass)
            for tick in range(1, 60):
                rig.feed("push", push)
                rig.feed("force", 0.0)
                await rig.tick()
                expected = push / damping * (1.0 - math.exp(-damping * 0.002 * tick / mass))
                assert rig.values("command")[-1] == pytest.approx(expected, abs=abs(push) / mass * 0.002)

    simulate(main)


@pytest.mark.slow(kept_by="test_the_force_settles_and_the_brake_holds")
@given(speed=numbers, depth=st.floats(-0.01, 0.01), force=st.floats(100.0, 1000.0))
@example(speed=1.0, depth=0.009765625, force=100.0)
def test_the_brake_takes_speed_away_and_never_turns_it_round(speed: float, depth: float, force: float) -> None:
    tool = module("world").Tool(4.0, 5000.0, 5.0, force, depth, speed)
    before = abs(speed)
    for _ in range(20):
        tool.advance(0.002, 0.0, True)
        if tool.contact() > force:
            return  # so deep in the wall that it pushes harder than the clamp holds
        assert abs(tool.speed) <= before + 1e-12
        before = abs(tool.speed)
    # Once the clamp is stronger than the wall it stands, after at most its momentum / (friction - contact).
    spare = force - max(5000.0 * max(depth, 0.0) + 5.0 * abs(speed), 0.0)
    if spare > 150.0:
        assert tool.speed == 0.0


@given(depth=st.floats(-0.01, 0.01), speed=numbers)
def test_the_wall_pushes_and_never_pulls(depth: float, speed: float) -> None:
    tool = module("world").Tool(4.0, 5000.0, 5.0, 400.0, depth, speed)
    assert tool.contact() >= 0.0
    assert depth > 0.0 or tool.contact() == 0.0
