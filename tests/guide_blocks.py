"""Runs the blocks of code of a page as its reader does, in one folder, and compares what they print with what is shown.

What a block is, is said by its language:

- any with `title="NAME"`: a file of this name;
- `python`: a program, run by itself; a block `output` after it is what it prints;
- `console`: commands after `$ `, each with what it prints, both streams; `sh`: commands alone;
- `toml`, `json`: has to be well-formed; of a system file's tables, `toml` has to be one that `aiorts schema` accepts;
- `text`, `mermaid`, `ini`, `dockerfile`: only shown.

A word behind the language says what is special: `varies`, every number may be another; `fails`, the last command ends
with another status than 0; `elsewhere`, it is not run here, for the reason that ELSEWHERE in the tests has. A line
`...` stands for any lines, `...` in a line for any text.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

from aiorts.guide import Block, anchor, blocks

SHOWN = frozenset({"text", "mermaid", "ini", "dockerfile", "xml"})
_LINK = re.compile(r"\[[^\]]+\]\(([^)\s]+)\)")
LIMIT = 60.0
"""Seconds that a block may take."""
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def links(text: str) -> list[str]:
    """What a page links to, and the pictures it shows, but for what is elsewhere on the net."""
    found = _LINK.findall(_prose(text)) + re.findall(r'<img src="([^"]+)"', text)
    return [link for link in found if "://" not in link]


def anchors(text: str) -> set[str]:
    """The fragments that links to a page can have."""
    return {anchor(heading) for heading in re.findall(r"^#+ (.*)$", _prose(text), re.MULTILINE)}


def _prose(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)


def run_page(text: str, folder: Path) -> int:
    """Run all blocks of a page in a folder, up to the first difference; returns how many commands and programs ran."""
    ran, printed = 0, ""
    for block in blocks(text):
        place = f"line {block.line}"
        if block.title:
            path = folder / block.title
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
        elif "elsewhere" in block.marks or block.language in SHOWN:
            pass
        elif block.language == "python":
            program = folder / f"block_{block.line}.py"
            program.write_text(block.text, encoding="utf-8")
            printed = execute([sys.executable, program.name], folder, place, fails="fails" in block.marks)
            program.unlink()
            ran += 1
        elif block.language == "output":
            compare(block.text, printed, place, varies="varies" in block.marks)
        elif block.language == "sh":
            execute(["bash", "-ec", block.text], folder, place, fails="fails" in block.marks)
            ran += 1
        elif block.language == "console":
            ran += _console(block, folder, place)
        elif block.language == "toml":
            tomllib.loads(block.text)
        elif block.language == "json":
            json.loads(block.text)
        else:
            raise AssertionError(f"{place}: a block of {block.language!r}: say what it is (see {Path(__file__).name})")
    return ran


def _console(block: Block, folder: Path, place: str) -> int:
    parts = re.split(r"^\$ ", block.text, flags=re.MULTILINE)
    assert not parts[0].strip(), f"{place}: a console block begins with '$ '"
    for number, part in enumerate(parts[1:], 1):
        command, _, expected = re.sub(r"\\\n\s*", " ", part).partition("\n")
        fails = "fails" in block.marks and number == len(parts) - 1
        compare(
            expected,
            execute(["bash", "-c", command], folder, place, fails=fails),
            place,
            varies="varies" in block.marks,
        )
    return len(parts) - 1


def execute(command: list[str], folder: Path, place: str, *, fails: bool) -> str:
    """Run a command; returns what it printed on both streams. Its status has to be 0, or another one where it fails."""
    scripts = str(Path(sys.executable).parent)
    left_out = ("AIORTS_PLUGINS", "FORCE_COLOR", "PYTHONPATH", "PYTEST_CURRENT_TEST")
    environment = {name: value for name, value in os.environ.items() if name not in left_out}
    environment |= {
        "PATH": f"{scripts}:{os.environ['PATH']}",
        "NO_COLOR": "1",
        "COLUMNS": "80",
        "PYTHONUNBUFFERED": "1",
    }
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert bool(done.returncode) == fails, f"{place}: {command[-1]}: status {done.returncode}\n{done.stdout[-3000:]}"
    return done.stdout


def compare(expected: str, printed: str, place: str, *, varies: bool) -> None:
    """Compare what a page shows with what was printed."""
    pattern = "".join(_line(line, varies=varies) for line in expected.rstrip().splitlines())
    shown = "".join(f"{line.rstrip()}\n" for line in printed.rstrip().splitlines())
    assert re.fullmatch(pattern, shown), (
        f"{place}: the page shows\n{expected}\nand this was printed:\n{printed[-4000:]}"
    )


def _line(line: str, *, varies: bool) -> str:
    if line.strip() == "...":
        return r"(?:.*\n)*?"
    texts = [_numbers(text) if varies else re.escape(text) for text in line.rstrip().split("...")]
    # A busy machine may run a cycle between two activations: what is dropped then has its reason behind it.
    reason = r"(?: inactive)?" if varies and "dropped" in texts[-1] else ""
    return ".*".join(texts) + reason + r"\n"


def _numbers(text: str) -> str:
    return r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?".join(map(re.escape, _NUMBER.split(text)))
