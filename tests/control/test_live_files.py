"""graph, check and inspect take what runs where they take files and types; filter reaches every component."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from aiorts import Component, EventContext, PeriodicContext
from aiorts.cli.app import run_command
from aiorts.composites import Composite
from aiorts.errors import SLOW_READER
from aiorts.system import check_running, running_graph
from control_parts import Counter, controlled, until

pytestmark = pytest.mark.anyio


class Failing(Component):
    """Fails."""

    async def on_execute(self) -> None:
        raise LookupError("no camera")


async def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """The status of a command and what it printed, while the kernel runs on."""
    status = await asyncio.to_thread(run_command, words)
    return status, *capsys.readouterr()


@pytest.mark.slow(kept_by="test_a_drawing_of_what_runs_has_composites_and_says_what_was_dropped")
async def test_graph_draws_what_runs_with_states_and_rates(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    svg = tmp_path / "live.svg"
    async with controlled() as kernel:
        await kernel.start(EventContext(name="events"), await kernel.create(Counter, "idle0"))
        assert await said(capsys, "graph", "unit", "-o", str(svg)) == (0, "", "")
        drawn = "".join(ElementTree.parse(svg).getroot().itertext())
        assert [word for word in ("counter0", "(active)", "(inactive)", "100 Hz", "events") if word not in drawn] == []
        status, text, _ = await said(capsys, "graph", "unit/")
        assert (status, text.startswith("flowchart LR\n"), text.count("-->")) == (0, True, 1)
        assert (await said(capsys, "graph", "unit", "--set", "counter0.step=2"))[0] == 2
        status, _, text = await said(capsys, "graph", "counter0")
        assert (status, "is a component, and no system; write its kernel: unit/" in text) == (6, True)


async def test_a_drawing_of_what_runs_has_composites_and_says_what_was_dropped() -> None:
    async with controlled() as kernel:
        inner = await kernel.create(Counter, "inner0")
        await kernel.add(Composite("whole", inner, order="dataflow"))
        profile = kernel.profile()
    ((name, wire),) = profile.connectors.items()
    lossy = replace(wire, ledger=replace(wire.ledger, dropped={"overwritten": 3}, silent=True))
    text = running_graph(replace(profile, connectors={name: lossy}), "dot")
    assert 'label="whole: composite, dataflow"' in text
    assert "inner0\\nCounter" in text
    assert 'label="3 dropped, silent"' in text
    with pytest.raises(ValueError, match="expected mermaid, dot, svg"):
        running_graph(profile, "png")
    findings = check_running(replace(profile, connectors={name: lossy}), "unit/")
    found = {one.code: one.cause for one in findings}
    (helps,) = [one.remedy for one in findings if one.code == "W-DROPPED"]
    assert helps == f"the reader is slower than the writer; {SLOW_READER}; see aiorts help slow-reader"
    assert found["W-DROPPED"] == f"3 of {wire.ledger.written} samples were dropped (3 overwritten)"
    assert found["W-SILENT"] == "counter0.out has not written for longer than max_gap"


async def test_check_tells_what_failed_is_lost_and_never_runs(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled(rate=1.0) as kernel:
        assert await said(capsys, "check", "unit") == (0, "unit/: no findings\n", "")
        failing = await kernel.create(Failing, "failing0")
        await kernel.start(PeriodicContext(rate=100.0, name="other"), failing, activate=True)
        await kernel.create(Counter, "lone0")
        await asyncio.to_thread(until, lambda: failing.last_error is not None)
        status, text, _ = await said(capsys, "check", "unit/", "--format", "json")
        found = {(one["code"], one["where"]): one["cause"] for one in json.loads(text)["findings"]}
        assert status == 2
        assert "no camera" in found["E-COMPONENT", "components.failing0"]
        assert found["W-UNUSED", "components.lone0"] == "lone0 is in no context and never runs"
        assert found["N-OPEN", "components.lone0"] == "1 port has no connection: out"
        assert check_running(kernel.profile(), "unit/")[0].severity == "error"


@pytest.mark.slow
async def test_inspect_shows_a_component_that_runs_with_values_in_force(capsys: pytest.CaptureFixture[str]) -> None:
    async with controlled() as kernel:
        await kernel.components["counter0"].configuration.change("default", {"step": 2.5})
        status, text, _ = await said(capsys, "inspect", "counter0")
        assert (status, "step  2.5" in text, "default 1.0" in text) == (0, True, True)
        status, text, _ = await said(capsys, "inspect", "unit/counter0", "--json")
        assert json.loads(text)["components"]["counter0"]["params"]["step"]["value"] == 2.5
        assert (await said(capsys, "inspect", "counter0", "--step", "2"))[0] == 2
        assert (await said(capsys, "inspect", "couter0"))[0] == 6
        status, _, text = await said(capsys, "inspect", "unit/couter0")
        assert (status, "did you mean counter0?" in text) == (6, True)


async def test_what_a_word_meant_before_wins_and_the_other_is_named(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("unit").write_text("schema = 1\n", encoding="utf-8")
    async with controlled() as kernel:
        await kernel.create(Counter, "TimedDouble")
        status, text, told = await said(capsys, "inspect", "TimedDouble")
        assert (status, "TimedDouble: " in text) == (0, True)
        assert told == "aiorts: unit/TimedDouble runs, too: `aiorts inspect unit/TimedDouble` shows it\n"
        _, text, told = await said(capsys, "check", "unit")
        assert text.startswith("aiorts: W-EMPTY: unit:1:1: ")
        assert told == "aiorts: unit/ runs, too: `aiorts check unit/` shows it\n"
        assert (await said(capsys, "check", "unit/"))[1].startswith("aiorts: W-UNUSED: unit: components.TimedDouble")


def test_filter_reaches_a_component_with_the_name_of_a_command(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run_command(["filter", "flexiconst", "-p", "TimedDouble", "-c", "2", "--count", "1"]) == 0
    assert json.loads(capsys.readouterr().out)["data"] == 2.0
    assert run_command(["filter", "flexicons"]) == 2
    assert "did you mean 'flexiconst'?" in capsys.readouterr().err
