"""Commands for what runs are carried out from a file, over one session."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from aiorts import PeriodicContext
from control_parts import commanded, controlled

pytestmark = pytest.mark.anyio


@pytest.fixture
def anyio_backend() -> str:
    """One loop is enough: what a command does passes through the socket."""
    return "asyncio"


@pytest.mark.row(121)
async def test_lines_are_carried_out_in_order_and_each_sees_what_the_others_did(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "robot.txt"
    file.write_text(
        "# first the parameters\n"
        "conf counter0 --add 'fast' fast.step=4 --activate fast\n\n"
        "aiorts dis counter0\n"
        "ctx start slow rate=20   # beside\n"
        "ctx drop loop reader0\n"
        "ctx add slow reader0\n"
        "con counter0.out reader0.in --json\n"
    )
    async with controlled() as kernel:
        status, text = await commanded(capsys, "batch", str(file))
        assert (status, '"full": "overwrite"' in text) == (0, True)
        assert kernel.components["counter0"].configuration.values["step"] == 4.0
        assert kernel.contexts["slow"].profile.members == ("reader0",)
        assert len(kernel.connectors) == 1


@pytest.mark.slow(kept_by="first")
@pytest.mark.parametrize(
    ("lines", "status", "text", "step"),
    [
        ("conf counter0 step=5\nconf counter0 step=-5\nconf counter0 step=6\n", 2, "robot.txt:2: counter0.step", 5.0),
        ("conf counter0 step=5\n\nexit reader9\n", 6, "robot.txt:3: reader9", 5.0),
        ("conf counter0 step=5\nconf --nosuch\n", 2, "robot.txt:2: No such option", 5.0),
        ("conf counter0 step=5\nrun other.toml\n", 2, "robot.txt:2: run: is no command for what runs", 1.0),
        ("conf counter0 step=5\nbatch other.txt\n", 2, "robot.txt:2: batch: is no command", 1.0),
        ("conf counter0 'step=5\n", 2, "robot.txt:1: No closing quotation", 1.0),
        (f"conf counter0 step=5\n{'x' * 2**20}\n", 2, "robot.txt:2: a line of 1048576 characters; at most 65536", 1.0),
    ],
)
async def test_the_first_that_fails_ends_it_with_file_and_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, lines: str, status: int, text: str, step: float
) -> None:
    file = tmp_path / "robot.txt"
    file.write_text(lines)
    async with controlled() as kernel:
        found, said = await commanded(capsys, "batch", str(file))
        assert (found, text in said) == (status, True), said
        assert kernel.components["counter0"].configuration.values["step"] == step


async def test_an_inject_reports_what_its_own_line_lost(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The lines share a session, whose counts are sums: a line reported the losses of those before it again."""
    file = tmp_path / "robot.txt"
    line = "inject reader0.in --full overwrite --length 2 1.0"
    file.write_text(f"{line} --count 20\n{line}\n")
    async with controlled() as kernel:
        await kernel.stop(kernel.contexts["loop"])
        await kernel.start(PeriodicContext(rate=2.0, name="slow"), kernel.components["reader0"], activate=True)
        status, said = await commanded(capsys, "batch", str(file), "--keep-going")
    assert (status, "of 20 samples were dropped (overwritten)" in said) == (1, True), said
    assert "of 1 samples" not in said


async def test_with_keep_going_all_are_carried_out_and_the_first_failure_gives_the_status(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = "conf counter0 step=5\nexit reader9\n\nconf counter0 --nosuch\nconf counter0 step=6\n"
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(lines.encode())))
    async with controlled() as kernel:
        status, said = await commanded(capsys, "batch", "-", "--keep-going")
        assert status == 6
        for text in ("standard input:2: reader9", "standard input:4: No such option", "2 of 4 commands failed"):
            assert text in said
        assert kernel.components["counter0"].configuration.values["step"] == 6.0


async def test_with_keep_going_every_line_that_is_no_such_command_is_named_and_the_others_are_carried_out(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "robot.txt"
    file.write_text("conf counter0 step=5\nrun other.toml\nconf counter0 step=6\nrnu 3\n")
    async with controlled() as kernel:
        for more, step in (("--dry-run",), 1.0), ((), 6.0):
            status, said = await commanded(capsys, "batch", str(file), "--keep-going", *more)
            assert status == 2
            assert "robot.txt:2: run: is no command" in said
            assert "robot.txt:4: rnu: is no command" in said
            assert "2 of 4 commands failed" in said
            assert kernel.components["counter0"].configuration.values["step"] == step


async def test_with_keep_going_a_line_that_cannot_be_read_fails_alone(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """It ended the batch, without a word of the lines behind it."""
    file = tmp_path / "robot.txt"
    file.write_text(f"conf counter0 step=5\nconf 'unclosed\n{'x' * 2**17}\nconf counter0 step=6\n")
    async with controlled() as kernel:
        status, said = await commanded(capsys, "batch", str(file), "--keep-going", "--json")
        assert status == 2
        found = json.loads(said[said.index("{") : said.rindex("}") + 1])
        assert [one["status"] for one in found["commands"]] == [0, 2, 2, 0]
        assert "No closing quotation" in found["commands"][1]["error"]["text"]
        assert "at most 65536 are taken" in found["commands"][2]["error"]["text"]
        assert kernel.components["counter0"].configuration.values["step"] == 6.0


async def test_with_keep_going_a_line_is_carried_out_before_the_next_comes(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    async with controlled() as kernel:
        seen = []

        def lines() -> Iterator[str]:
            yield "conf counter0 step=5\n"
            seen.append(kernel.components["counter0"].configuration.values["step"])
            yield "conf counter0 step=6\n"

        monkeypatch.setattr("sys.stdin", lines())
        assert (await commanded(capsys, "batch", "-", "--keep-going"))[0] == 0
    assert seen == [5.0]


async def test_json_has_each_command_with_its_output_and_error(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "robot.txt"
    file.write_text("conf counter0 step=5\n\nls -l counter0\nexit reader9\nconf counter0 step=6\n")
    async with controlled():
        status, said = await commanded(capsys, "batch", str(file), "--json")
    document = json.loads(said[said.index("{\n") : said.rindex("}") + 1])
    assert (status, document["failed"]) == (6, 1)
    assert [(one["line"], one["command"], one["status"]) for one in document["commands"]] == [
        (1, ["conf", "counter0", "step=5"], 0),
        (3, ["ls", "-l", "counter0"], 0),
        (4, ["exit", "reader9"], 6),
    ]
    assert "counter0" in document["commands"][1]["output"]
    assert "robot.txt:4: reader9" in document["commands"][2]["error"]["text"]
