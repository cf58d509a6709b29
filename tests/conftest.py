"""What every test of the suite gets: both event loops, reproducible property tests, and a guard against leaks.

After every test no new task, thread or file descriptor is left, and the event loop has not complained of an exception
that nobody retrieved or a task that was destroyed while pending. ("Never awaited" is a warning, and warnings are
errors here.) A module-scoped async fixture keeps its loop open from test to test; this suite has none.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import gc
import importlib.util
import logging
import os
import random
import shutil
import signal
import sys
import tempfile
import threading
import time
import tomllib
import traceback
from importlib.metadata import distribution
from pathlib import Path
from typing import TYPE_CHECKING, Any, Never

import pytest
from hypothesis import settings

from aiorts.kernel.extensions.catalogue import Catalogue
from campaign import CAMPAIGN, be_quick
from tiers import ALONE, are_left, are_slow, far_from_quick

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator

os.environ.pop("FORCE_COLOR", None)
HAS_UVLOOP = importlib.util.find_spec("uvloop") is not None
DESCRIPTORS = Path("/proc/self/fd")
ENDS_WITHIN = 2.0  # seconds that a pool's thread has to end after its loop was closed
OWN_THREADS = ("pytest_timeout", "pytest-timeout")  # of the test runner, not of a test
ENDING = [signal.Signals[name] for name in ("SIGTERM", "SIGHUP", "SIGQUIT") if name in signal.Signals.__members__]
FAR_FROM_QUICK = pytest.StashKey[dict[str, tuple[float, bool]]]()
BUSY = 2.0
"""Tasks that wait for each processor, above which the time that a test takes says nothing."""
COMPLAINTS = ("never retrieved", "was destroyed but it is pending", "was never awaited")

# A run under nohup, or behind a shell's "&", inherits signals that are ignored, and so would every process of a test.
for _signal, _handler in ((signal.SIGINT, signal.default_int_handler), *((s, signal.SIG_DFL) for s in ENDING)):
    if signal.getsignal(_signal) is signal.SIG_IGN:
        signal.signal(_signal, _handler)


# Where bytecode is not to be written, that of the tests goes to pytest's own folder while they are collected: compiling
# them again would take three times as long as all the rest of it.
_AS_ASKED_FOR = sys.dont_write_bytecode, sys.pycache_prefix
BYTECODE = Path(__file__).parents[1] / ".pytest_cache" / "bytecode"
if sys.dont_write_bytecode:
    sys.dont_write_bytecode, sys.pycache_prefix = False, str(BYTECODE)

# The runs of the tests have a folder of their own for their sockets: no other run is seen or disturbed.
RUNTIME = tempfile.mkdtemp(prefix="aiorts-")
os.environ["XDG_RUNTIME_DIR"] = RUNTIME
atexit.register(shutil.rmtree, RUNTIME, ignore_errors=True)

settings.register_profile("aiorts", deadline=None, print_blob=True)
settings.register_profile("ci", deadline=None, print_blob=True, derandomize=True)
settings.register_profile("quick", deadline=None, print_blob=True, max_examples=20)
settings.load_profile("ci" if os.environ.get("CI") else "aiorts")

# An `aiorts run` in this process unfreezes what was frozen when all tests were collected: then every full collection
# of all tests that follow goes through it.
UNFROZEN = threading.Event()
_unfreeze = gc.unfreeze


def _unfrozen() -> None:
    UNFROZEN.set()
    _unfreeze()


gc.unfreeze = _unfrozen


def _check_installed() -> None:
    """Refuse an installation that is older than `pyproject.toml`: it has a copy of the entry points."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text("utf-8"))["project"]
    ours = {(group, *one) for group, several in project["entry-points"].items() for one in several.items()}
    installed = {(one.group, one.name, one.value) for one in distribution("aiorts").entry_points}
    if missing := ours - installed:
        pytest.exit(f"aiorts was installed before {min(missing)} was offered; run: pip install -e . --no-deps", 4)


def pytest_configure(config: pytest.Config) -> None:
    """Name the test that ends the process of all tests: os._exit, a test's time limit too, leaves no summary."""
    _check_installed()
    if config.getoption("--tier") == "quick" and not CAMPAIGN and not os.environ.get("CI"):
        settings.load_profile("quick")  # other ones each time; CI tries all of them
        be_quick()
    leave, process, capture = os._exit, os.getpid(), config.pluginmanager.getplugin("capturemanager")

    def told(status: int) -> Never:
        if os.getpid() == process:
            test = os.environ.get("PYTEST_CURRENT_TEST", "between two tests").rpartition(" ")[0]
            with capture.global_and_fixture_disabled() if capture else contextlib.nullcontext():
                traceback.print_stack()
                print(f"\nENDED {test}", file=sys.stderr, flush=True)
            shutil.rmtree(RUNTIME, ignore_errors=True)
        leave(status)

    os._exit = told


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--tier",
        choices=("quick", "slow", "all"),
        default="quick",
        help="quick tests (the default), the rest without what takes minutes (tests/tiers.py), or all; a test that is "
        "named with :: runs always",
    )
    parser.addoption("--shuffle", type=int, metavar="SEED", help="run the tests in another order, the same for a seed")


def _keeper(item: pytest.Item) -> str | None:
    """What keeps the promise of a test that is marked slow."""
    mark = item.get_closest_marker("slow")
    return None if mark is None else str(mark.kwargs.get("kept_by", ALONE))


def _keep(config: pytest.Config, items: list[pytest.Item], wanted: list[bool]) -> None:
    config.hook.pytest_deselected(items=[item for item, take in zip(items, wanted, strict=True) if not take])
    items[:] = [item for item, take in zip(items, wanted, strict=True) if take]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the tests of the tier that was asked for, in the order that was."""
    tier = config.getoption("--tier")
    if tier != "all" and not any("::" in argument for argument in config.args) and not config.getoption("lf", False):
        wanted = [slow is (tier == "slow") for slow in are_slow((item.nodeid, _keeper(item)) for item in items)]
        _keep(config, items, wanted)
        if tier == "slow":
            _keep(config, items, [not left for left in are_left(item.nodeid for item in items)])
    if (seed := config.getoption("--shuffle")) is not None:
        random.Random(seed).shuffle(items)


def pytest_collection() -> None:
    """Look for no garbage while thousands of tests are made: all of them stay."""
    gc.disable()


def pytest_collection_finish() -> None:
    """What tests import is theirs: only what was imported to collect them has its bytecode kept.

    And what there is now stays: a full collection in a test, which went through all of it, took most of its time.
    """
    gc.enable()
    gc.freeze()
    sys.dont_write_bytecode, sys.pycache_prefix = _AS_ASKED_FOR


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Find the quick tests that were far from quick; one that is so in two runs of an idle machine is a failure."""
    config = session.config
    reporter = config.pluginmanager.getplugin("terminalreporter")
    if config.getoption("--tier") != "quick" or reporter is None or hasattr(config, "workerinput"):
        return
    passed = reporter.getreports("passed")
    took = {report.nodeid: report.duration for report in passed}
    cache, key = getattr(config, "cache", None), f"aiorts/far from quick, {sys.version_info[0]}.{sys.version_info[1]}"
    before = set(cache.get(key, []) if cache else [])
    late = far_from_quick(took, (report.nodeid for report in passed if "slow" in report.keywords))
    config.stash[FAR_FROM_QUICK] = {name: (took[name], name in before) for name in late}
    if os.getloadavg()[0] > BUSY * (os.cpu_count() or 1):
        return
    if cache:
        cache.set(key, sorted((before - took.keys()) | late))
    if before & late and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Name them."""
    found = config.stash.get(FAR_FROM_QUICK, {})
    for name, (seconds, again) in sorted(found.items(), key=lambda each: -each[1][0])[:20]:
        twice = "; the second time: if the machine is idle, see tests/tiers.py" if again else ""
        terminalreporter.write_line(f"slow among the quick: {seconds:.2f} s {name}{twice}")


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(("asyncio", {"use_uvloop": False}), id="asyncio"),
        pytest.param(
            ("asyncio", {"use_uvloop": True}),
            id="uvloop",
            marks=[] if HAS_UVLOOP else pytest.mark.skip(reason="uvloop is not installed"),
        ),
    ],
)
def anyio_backend(request: pytest.FixtureRequest) -> Any:
    """The event loop of an async test: the standard one, then uvloop."""
    return request.param


@pytest.fixture(scope="session", autouse=True)
def _bytecode_is_kept() -> Iterator[None]:
    """Where bytecode is not to be written, let the processes of the tests use the folder that ours is in.

    There are hundreds of them, and without it each takes half of its time to compile the same modules. What comes of
    files that a test made is of no use to any other run.
    """
    if not os.environ.get("PYTHONDONTWRITEBYTECODE"):
        yield
        return
    temporary = Path(tempfile.gettempdir()).resolve()
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("PYTHONDONTWRITEBYTECODE")
        patch.setenv("PYTHONPYCACHEPREFIX", str(BYTECODE))
        yield
    shutil.rmtree(BYTECODE / temporary.relative_to(temporary.anchor), ignore_errors=True)


@pytest.fixture(scope="session", autouse=True)
def _opened_once_in_a_process() -> None:
    """Let the event loops open what they keep for the whole process before anything is compared."""
    asyncio.run(asyncio.sleep(0))
    if HAS_UVLOOP:
        import uvloop

        uvloop.run(asyncio.sleep(0))


class _Complaints(logging.Handler):
    """Collects what the event loop says of exceptions and tasks that nobody took."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        if any(complaint in text for complaint in COMPLAINTS):
            self.texts.append(text)


def _descriptors() -> dict[str, str]:
    """Open descriptors and what each is; empty where the system does not tell."""
    if not DESCRIPTORS.is_dir():
        return {}
    found = {}
    for name in os.listdir(DESCRIPTORS):
        try:
            found[name] = os.readlink(DESCRIPTORS / name)
        except OSError:
            continue  # the one that listed the folder
    return found


def _new_threads(before: set[threading.Thread]) -> list[threading.Thread]:
    return [t for t in threading.enumerate() if t not in before and not t.name.startswith(OWN_THREADS)]


def _new_descriptors(before: dict[str, str]) -> dict[str, str]:
    return {name: target for name, target in _descriptors().items() if before.get(name) != target}


def _tasks() -> set[asyncio.Task[Any]]:
    """Unfinished tasks but the running one and those of the test runner itself."""
    own = {"TestRunner._call_in_runner_task", "TestRunner._run_tests_and_fixtures"}
    return {task for task in asyncio.all_tasks() if getattr(task.get_coro(), "__qualname__", "") not in own}


@pytest.fixture
async def _tasks_all_end() -> AsyncIterator[None]:
    before = _tasks()
    yield
    for _ in range(20):  # a task that was just cancelled needs a few turns to end
        if not (left := _tasks() - before):
            return
        await asyncio.sleep(0)
    for task in left:
        task.cancel()
    listed = sorted(f"{task.get_name()}: {task.get_coro()!r}" for task in left)
    pytest.fail(f"{len(listed)} tasks left: {'; '.join(listed)}")


@pytest.fixture
def _no_thread_descriptor_or_complaint_left() -> Iterator[None]:
    threads, descriptors, complaints = set(threading.enumerate()), _descriptors(), _Complaints()
    loop_log = logging.getLogger("asyncio")
    loop_log.addHandler(complaints)
    Catalogue._default = None  # a command that another test ran in this process may have chosen its own
    yield
    until = time.monotonic() + ENDS_WITHIN
    while (left := _new_threads(threads)) and time.monotonic() < until:
        left[0].join(0.05)
    opened = _new_descriptors(descriptors)
    if left or opened:
        gc.collect()
        left, opened = _new_threads(threads), _new_descriptors(descriptors)
    loop_log.removeHandler(complaints)
    if UNFROZEN.is_set():
        UNFROZEN.clear()
        gc.freeze()
    faults = [f"thread {thread.name}" for thread in left]
    faults += [f"descriptor {name} ({target})" for name, target in opened.items()]
    faults += complaints.texts
    if faults:
        pytest.fail(f"abandoned: {'; '.join(faults)}")


@pytest.fixture(autouse=True)
def _leaves_nothing_behind(request: pytest.FixtureRequest) -> None:
    """Ask for the guards before any other fixture, so that they look after all of them were torn down."""
    request.getfixturevalue("_no_thread_descriptor_or_complaint_left")
    if "anyio_backend" in request.fixturenames:
        request.getfixturevalue("_tasks_all_end")
