"""Each command asks for the right that its calls need, by the table of operations, and for no more.

Where its arguments name a file or code, it asks for the right `code`, whatever the operation alone needs.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from aiorts.cli.group import _SECTIONS
from aiorts.control.operation import Right
from aiorts.control.session import Session
from control_parts import commanded, controlled

SYSTEM = """
schema = 1
[components.counter0]
type = "parts.py:Counter"
"""
LINES = {
    Right.VIEW: (
        *("ls", "cat counter0", "find counter0", "top --once", "print counter0.out --count 1", "conf counter0"),
        *("hz counter0.out --count 1 --interval 0.1", "bw counter0.out --count 1 --interval 0.1"),
        *("vlog", "fsm counter0"),
        *("watch --for 0.1", "conf --dump dump.toml", "con", "ctx", "save", "record counter0.out --for 0.1"),
    ),
    Right.OPERATE: (
        *("conf counter0 step=2.5", "conf counter0 step=-1e3", "conf counter0 --add fast", "fsm counter0 go"),
        *("delay counter0.out --count 1 --interval 0.1", "vlog --set info counter0", "activate counter0"),
        *("deactivate counter0", "reset counter0", "comp create Nothing new0 step=2", "comp add counter0 reader0"),
        *("comp drop counter0 reader0", "comp remove reader0", "exit counter0", "connect counter0.out reader0.in"),
        *("disconnect counter0.out", "ctx start slow rate=5", "ctx rate loop 50", "ctx add loop counter0"),
        *("ctx drop loop counter0", "ctx stop loop", "call counter0.out.method 2 x=3", "goal counter0.out.method"),
        *("call counter0.out.method '{\"n\": 2}'", "goal counter0.out.method 'to={\"x\": [1.0, true, null]}'"),
        *("inject reader0.in 1.0", "stop"),
    ),
    Right.CODE: (
        *("conf counter0 step=map.png", "conf counter0 step=/etc/passwd", "conf counter0 'step=[\"a\"]'"),
        *("conf --load dump.toml", "comp create parts.py:Counter new0", "comp create Nothing new0 map=map.png"),
        *("con counter0.out reader0.in convert=parts.py:half", "reload counter0", "batch batch.txt"),
        *("call counter0.out.method map.png", "goal counter0.out.method map=map.png"),
        *('call counter0.out.method \'{"map": "map.png"}\'', "call counter0.out.method '[{\"./map\": 1}]'"),
        *("call counter0.out.method /tmp/a=1", "call counter0.out.method '{\"n\": 2'"),
        *("plan system.toml --live asked", "apply system.toml", "apply system.toml --dry-run"),
    ),
}
CASES = [(line, right) for right, lines in LINES.items() for line in lines]


@contextmanager
def heard(patch: pytest.MonkeyPatch) -> Iterator[list[tuple[Right, str, Right]]]:
    """The calls of this process's kernels: the right of the session, the operation, and the right that it needs."""
    calls: list[tuple[Right, str, Right]] = []
    begin = Session.begin

    def heard_too(session: Session, number: int, operation: Any, arguments: Any, credit: int | None = None) -> None:
        calls.append((session.right, operation.name, operation.needed(arguments)))
        begin(session, number, operation, arguments, credit)

    with patch.context() as patched:
        patched.setattr(Session, "begin", heard_too)
        yield calls


@pytest.mark.slow(kept_by="first")
@pytest.mark.anyio
@pytest.mark.parametrize(("line", "right"), CASES)
async def test_a_command_asks_for_what_its_calls_need(
    line: str,
    right: Right,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in (("system.toml", SYSTEM), ("dump.toml", ""), ("batch.txt", "conf counter0 step=2")):
        Path(name).write_text(text)
    Path("parts.py").write_text("from control_parts import Counter\n")
    async with controlled("asked"):
        with heard(monkeypatch) as calls:
            _, said = await commanded(capsys, *shlex.split(line))
    needed = max((one for _, _, one in calls), key=list(Right).index)
    assert {given for given, _, _ in calls} == {right}, (calls, said)
    assert right.allows(needed)
    assert needed is right or right is Right.CODE, calls


def test_all_commands_for_what_runs_are_in_the_table() -> None:
    live = {name for title, *names in _SECTIONS if "what runs" in title for name in " ".join(names).split()}
    live.remove("studio")  # it has a right of its own, which its tests ask for
    short = {"con": "connect"}
    tried = {short.get(word := line.split()[0], word) for line, _ in CASES}
    assert live | {"record", "plan", "apply"} == tried
