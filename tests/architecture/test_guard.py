"""The guard that every test runs under finds what a test leaves behind, and nothing where all was closed."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TESTS_UNDER_GUARD = """
import asyncio, os, threading, time
import anyio.to_thread
import pytest
from hypothesis import given, strategies as st

KEPT = []

@pytest.fixture
async def background():
    task = asyncio.create_task(asyncio.sleep(100))
    yield
    task.cancel()

@pytest.mark.anyio
async def test_clean_pools():
    await asyncio.to_thread(time.sleep, 0.01)
    await anyio.to_thread.run_sync(time.sleep, 0.01)

@pytest.mark.anyio
async def test_clean_process():
    process = await asyncio.create_subprocess_exec("true")
    await process.wait()

@pytest.mark.anyio
async def test_clean_fixture(background):
    pass

@pytest.mark.anyio
@given(st.integers())
async def test_clean_property(number):
    await asyncio.sleep(0)

def test_clean_loop():
    asyncio.run(asyncio.sleep(0))

@pytest.mark.anyio
async def test_leaks_task():
    KEPT.append(asyncio.create_task(asyncio.sleep(100)))

def test_leaks_descriptor():
    KEPT.append(os.open(os.devnull, os.O_RDONLY))

def test_leaks_thread():
    stop = threading.Event()
    KEPT.append(stop)
    threading.Thread(target=stop.wait, args=(5,), daemon=True).start()

@pytest.mark.anyio
async def test_leaks_exception():
    async def fail():
        raise ValueError("lost")
    task = asyncio.create_task(fail())
    await asyncio.sleep(0.01)
    del task

@pytest.mark.anyio
async def test_leaks_coroutine():
    asyncio.sleep(0)
"""


@pytest.mark.slow
@pytest.mark.parametrize("asked_for", ["task or clean_loop", "test"])
def test_guard_finds_each_kind_of_leak_and_no_other(asked_for: str, tmp_path: Path) -> None:
    tests, ours = tmp_path / "tests", Path(__file__).parents[1]
    tests.mkdir()
    shutil.copy(ours.parent / "pyproject.toml", tmp_path)
    for name in ("conftest.py", "campaign.py", "tiers.py"):
        shutil.copy(ours / name, tests)
    (tests / "test_under_guard.py").write_text(TESTS_UNDER_GUARD)
    (tests / "pytest.ini").write_text("[pytest]\nfilterwarnings = error\naddopts = -p no:cacheprovider\n")
    command = [sys.executable, "-m", "pytest", "-q", "-rEf", "--tb=no", "-k", asked_for, str(tests)]
    done = subprocess.run(command, cwd=tests, capture_output=True, text=True, timeout=50, check=False)
    bad = set(re.findall(r"^(?:ERROR|FAILED) \S+::(\w+)", done.stdout, re.MULTILINE))
    kinds = {"task", "thread", "exception", "coroutine"} | ({"descriptor"} if Path("/proc/self/fd").is_dir() else set())
    kinds = kinds if asked_for == "test" else {"task"}
    assert bad == {f"test_leaks_{kind}" for kind in kinds}, done.stdout
    assert re.search(r"\d+ passed", done.stdout)
