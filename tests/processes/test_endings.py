"""Whatever ends a process, its end is seen at once, with its cause, and nothing of it is left."""

from __future__ import annotations

import asyncio
import ctypes
import os
import resource
import signal
import subprocess
import sys
import time

import pytest

from aiorts.errors import ClosedError, ProcessError
from aiorts.processes import Ending, Limits
from aiorts.processes.tree import children
from process_parts import DAEMON, WAIT, started, there

SILENT = "import faulthandler, resource; resource.setrlimit(resource.RLIMIT_CORE, (0, 0))\n"
BUSY = "print('ready', flush=True)\nwhile True: pass"


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("body", "text"),
    [
        ("pass", "exit status 0"),
        ("import os; os._exit(3)", "exit status 3"),
        ("raise ValueError('boom')", "exit status 1"),
        ("import ctypes; ctypes.string_at(0)", "killed by SIGSEGV (signal 11)"),
        ("import os; os.abort()", "killed by SIGABRT (signal 6)"),
        ("import os, signal; os.kill(os.getpid(), 40)", "killed by signal 40"),
        ("import os, signal; os.kill(os.getpid(), 9)", "killed by SIGKILL (signal 9)"),
    ],
)
async def test_the_cause_is_exact(body: str, text: str) -> None:
    async with started() as its, asyncio.timeout(WAIT):
        child = await its.start(SILENT + body)
        ending = await child.ended
    assert (ending.text, ending.out_of_memory) == (text, False)
    assert any("boom" in line for line in ending.last_lines) == ("boom" in body)


@pytest.mark.slow(kept_by="first")
@pytest.mark.anyio
@pytest.mark.parametrize(
    "body",
    [
        BUSY,
        "import signal\nfor n in (1, 2, 15): signal.signal(n, signal.SIG_IGN)\n" + BUSY,
        "import os, signal\nprint('ready', flush=True)\nos.kill(os.getpid(), signal.SIGSTOP)",
        "import ctypes\nprint('ready', flush=True)\nctypes.PyDLL(None).sleep(100)",  # holds the interpreter's lock
        DAEMON + BUSY,
    ],
    ids=["busy", "ignores", "stopped", "locked", "daemon"],
)
async def test_kill_ends_a_process_whatever_it_does_within_a_fifth_of_a_second(body: str) -> None:
    async with started() as its, asyncio.timeout(WAIT):
        child = await its.start(body)
        await its.line("ready")
        began = time.monotonic()
        child.kill()
        ending = await child.ended
        took = time.monotonic() - began
        child.kill()
    assert ending == Ending(None, signal.SIGKILL, last_lines=("ready",))
    assert took < 0.2 or os.getloadavg()[0] > 4


@pytest.mark.anyio
async def test_what_a_process_has_started_ends_with_it_and_its_neighbours_do_not() -> None:
    async with started() as its, asyncio.timeout(WAIT):
        other = await its.start("import time; print('other', flush=True); time.sleep(100)")
        child = await its.start(DAEMON + "print('ready', flush=True); input_ = __import__('os').read(3, 1)")
        await its.line("ready")
        await its.line("other")
        its.ours.send(b"x")
        assert (await child.ended).text == "exit status 0"
        while len(left := set(there(its.mark))) > 2:
            await asyncio.sleep(0.005)
        assert left == {its.helper, other.pid}
        assert not other.ended.done()


@pytest.mark.slow
@pytest.mark.anyio
async def test_the_descriptor_is_there_and_nothing_else_is_inherited() -> None:
    async with started() as its, asyncio.timeout(WAIT):
        child = await its.start(
            "import os, socket\n"
            "print(sorted(map(int, os.listdir('/proc/self/fd')))[:-1], os.getsid(0) == os.getpid())\n"
            "socket.socket(fileno=3).send(b'hello')"
        )
        assert (await child.ended).status == 0
        assert its.lines == [("stdout", "[0, 1, 2, 3, 4] True")]
        assert its.ours.recv(10) == b"hello"


@pytest.mark.slow
@pytest.mark.anyio
async def test_environment_and_folder_are_those_of_now(monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    async with started() as its, asyncio.timeout(WAIT):
        await (await its.start("pass")).ended
        monkeypatch.setenv("AIORTS_LATER", "caf\udce9")
        monkeypatch.chdir(str(tmp_path))
        child = await its.start(
            "import os; print(ascii(os.environ['AIORTS_LATER']), os.getcwd(), 'AIORTS_HELPER' in os.environ)"
        )
        await child.ended
        assert its.lines == [("stdout", f"'caf\\udce9' {tmp_path} False")]


@pytest.mark.slow(kept_by="first")
@pytest.mark.anyio
async def test_output_without_bound_holds_up_nobody_and_is_counted() -> None:
    async with started() as its, asyncio.timeout(WAIT):
        child = await its.start(
            "import os\nfor _ in range(300): os.write(1, b'0123456789abcde\\n' * 4096)\nprint('last')"
        )
        time.sleep(0.1)  # this loop does not turn meanwhile
        ending = await child.ended
    said = [line.split() for _, line in its.lines if line.startswith("...")]
    lines = [line for _, line in its.lines if not line.startswith("...")]
    assert ending.last_lines[-1] == "last"
    assert sum(int(words[1]) for words in said) + len(lines) == 300 * 4096 + 1
    assert len(lines) < 10_000


@pytest.mark.slow
@pytest.mark.anyio
async def test_memory_is_bounded_above_what_the_imports_took() -> None:
    async with started() as its, asyncio.timeout(WAIT):
        child = await its.start(
            "from aiorts.processes import limit_memory\nlimit_memory(50_000_000)\nfine = bytearray(20_000_000)\n"
            "try: bytearray(100_000_000)\nexcept MemoryError: print('MemoryError')",
            limits=Limits(memory=50_000_000),
        )
        assert (await child.ended).text == "exit status 0"
    assert its.lines == [("stdout", "MemoryError")]
    assert child.granted == {"memory": "RLIMIT_AS, by the process itself after its imports"}


@pytest.mark.slow
@pytest.mark.anyio
async def test_what_limits_get_is_said() -> None:
    async with started() as its, asyncio.timeout(WAIT):
        child = await its.start("import os; print(os.nice(0))", limits=Limits(cpu=0.5))
        await child.ended
        assert child.denied == {}
        if child.granted["cpu"].startswith("nice"):
            assert its.lines == [("stdout", str(os.nice(0) + 3))]
        else:
            assert "cpu.max = 50000 100000" in child.granted["cpu"]


@pytest.mark.anyio
async def test_a_number_of_processes_is_kept_or_refused() -> None:
    fork = (
        "import os, time\nwhile True:\n    try: os.fork()\n    except OSError: print('full', flush=True); time.sleep(9)"
    )
    async with started() as its, asyncio.timeout(WAIT):
        try:
            child = await its.start(fork, limits=Limits(processes=20))
        except ProcessError as error:
            if str(error).startswith("camera0: limits.processes = 20: cgroup v2"):
                pytest.skip(f"not run: {error}")
            raise
        await its.line("full")
        child.kill()
        await child.ended


@pytest.mark.slow(kept_by="test_what_a_process_has_started_ends_with_it_and_its_neighbours_do_not")
@pytest.mark.anyio
async def test_processes_that_start_others_without_end_are_all_killed() -> None:
    """Up to 100 at a time, which replace each other at once, in sessions of their own; for 6 s at the most."""
    bomb = """
        import os, time
        until, most = time.monotonic() + 6, len(os.listdir("/proc")) + 100
        print("ready", flush=True)
        while time.monotonic() < until:
            if len(os.listdir("/proc")) < most and os.fork() == 0:
                os.setsid()
        """
    async with started() as its, asyncio.timeout(WAIT):
        child = await its.start(bomb)
        await its.line("ready")
        await asyncio.sleep(0.1)
        child.kill()
        assert (await child.ended).signal == signal.SIGKILL
        async with asyncio.timeout(2.0):
            while set(there(its.mark)) != {its.helper}:
                await asyncio.sleep(0.01)


@pytest.mark.slow
@pytest.mark.anyio
async def test_a_program_that_cannot_be_started_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    async with started() as its, asyncio.timeout(WAIT):
        await (await its.start("pass")).ended
        monkeypatch.setattr("sys.executable", "/nowhere/python")
        with pytest.raises(ProcessError, match=r"camera0: .*No such file"):
            await its.start("pass")


@pytest.mark.anyio
async def test_a_helper_that_ends_at_once_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    async with started() as its:
        monkeypatch.setattr("sys.executable", "/bin/false")
        with pytest.raises(ProcessError, match="camera0: the helper process has ended"):
            await its.start("pass")
        monkeypatch.undo()


@pytest.mark.anyio
async def test_a_closed_launcher_starts_nothing_and_says_how_its_children_ended() -> None:
    async with started() as its:
        child = await its.start(BUSY)
        await its.launcher.close()
        assert child.ended.result().signal == signal.SIGKILL
        with pytest.raises(ClosedError, match="camera0"):
            await its.start("pass")
        await its.launcher.close()


@pytest.mark.slow
@pytest.mark.anyio
async def test_a_start_that_is_cancelled_leaves_no_process() -> None:
    async with started() as its:
        first = await its.start("import time; time.sleep(100)")
        for turns in range(6):
            task = asyncio.ensure_future(its.start(BUSY))
            for _ in range(turns):
                await asyncio.sleep(0)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
        async with asyncio.timeout(WAIT):
            while set(there(its.mark)) != {its.helper, first.pid}:
                await asyncio.sleep(0.01)


def test_a_program_that_no_launcher_started_is_refused() -> None:
    from aiorts.processes import prepare

    with pytest.raises(ProcessError, match="AIORTS_HELPER is not set"):
        prepare()


def test_the_text_says_what_is_known() -> None:
    assert Ending(None, signal.SIGKILL, out_of_memory=True).text == "killed by SIGKILL, out of memory"
    assert Ending(0, None).text == "exit status 0"
    assert Ending(None, None).text == "end not seen: the helper process was killed"


@pytest.mark.slow
@pytest.mark.anyio
async def test_the_process_that_starts_others_adopts_and_waits_for_nothing_else() -> None:
    own = subprocess.Popen([sys.executable, "-S", "-c", "raise SystemExit(7)"])
    async with started() as its, asyncio.timeout(WAIT):
        await (await its.start("pass")).ended
        adopts = ctypes.c_int(-1)
        ctypes.CDLL(None).prctl(37, ctypes.byref(adopts), 0, 0, 0)  # PR_GET_CHILD_SUBREAPER
        assert adopts.value == 0
        assert {pid for pid in children(os.getpid()) if pid != own.pid} >= {its.helper}
    assert own.wait(WAIT) == 7


@pytest.mark.slow
@pytest.mark.anyio
async def test_a_helper_without_descriptors_refuses_and_its_children_go_on() -> None:
    async with started() as its, asyncio.timeout(WAIT):
        child = await its.start("import os; os.read(3, 1)")
        resource.prlimit(its.helper, resource.RLIMIT_NOFILE, (len(os.listdir(f"/proc/{its.helper}/fd")), 1024))
        for _ in range(2):
            with pytest.raises(ProcessError, match="camera0: "):
                await its.start("pass")
        resource.prlimit(its.helper, resource.RLIMIT_NOFILE, (1024, 1024))
        assert (await (await its.start("pass")).ended).status == 0
        its.ours.send(b"x")
        assert (await child.ended).status == 0
