"""Runs the commands of README.md in a shell and compares what each prints with the text under it.

Run: python examples/flexi/check.py
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
CASE = re.compile(r"```sh\n(.*?)```\n+```text\n(.*?)```", re.DOTALL)
START = 'set -o pipefail; aiorts() { "$PYTHON" -m aiorts "$@"; }\n'


def main(path: Path) -> int:
    """0 when every command of the file printed its text and ended with status 0, else 1."""
    cases = CASE.findall(path.read_text())
    right = 0
    for command, expected in cases:
        done = subprocess.run(
            ["bash", "-c", START + command],
            cwd=ROOT,
            env={**os.environ, "PYTHON": sys.executable},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=60,
        )
        if (done.returncode, done.stdout, done.stderr) == (0, expected, ""):
            right += 1
        else:
            print(f"{command}expected:\n{expected}got, with status {done.returncode}:\n{done.stdout}{done.stderr}")
    print(f"{right} of {len(cases)} commands printed what they should")
    return 0 if cases and right == len(cases) else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("README.md")))
