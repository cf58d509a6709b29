"""The calibration in four processes: three with a range finder each, and the station, which ends the run.

Run: python examples/lrf/run.py

    --kill north   kill -9 that process in mid calibration, and start it again
    --network      each range finder on a host of its own, a network namespace: as root, and with the extra `zenoh`

Exit status 1 when a pose is not right.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from namespaces import namespaces

FOLDER = Path(__file__).parent
HOSTS = {"west": "10.79.0.1", "north": "10.79.0.2", "east": "10.79.0.3"}
MEETING = f"{HOSTS['west']}:7447"
AIORTS = (sys.executable, "-m", "aiorts")


class Program(NamedTuple):
    """What one of the processes runs."""

    host: str
    arguments: tuple[str, ...]
    network: tuple[str, ...] = ()
    """How it reaches other hosts, where there are any."""


PROGRAMS = {
    "west": Program("west", ("finder.toml", "--var", "place=west")),
    "north": Program("north", ("finder.toml", "--var", "place=north"), ("--connect", MEETING)),
    "east": Program("east", ("finder.toml", "--var", "place=east"), ("--connect", MEETING)),
    "station": Program("west", ("station.toml",), ("--listen", MEETING)),
}


class Processes:
    """All four: what the station says is read with `said`, the warnings of each lie in a file."""

    def __init__(self, folder: Path, hosts: Mapping[str, list[str]]) -> None:
        self.folder, self.hosts = folder, hosts
        self.running = {name: self.start(name) for name in PROGRAMS}

    def start(self, name: str) -> subprocess.Popen[str]:
        host, arguments, network = PROGRAMS[name]
        sockets = self.folder / (host if self.hosts else "here")
        sockets.mkdir(mode=0o700, exist_ok=True)
        command = [*self.hosts.get(host, []), *AIORTS, "run", *arguments]
        if self.hosts and network:
            command += ["--host", host, *network, "--certs", str(self.folder / "certs")]
        environment = {**os.environ, "XDG_RUNTIME_DIR": str(sockets)}
        with (self.folder / f"{name}.log").open("a") as log:
            return subprocess.Popen(command, cwd=FOLDER, env=environment, stdout=subprocess.PIPE, stderr=log, text=True)

    def kill(self, name: str) -> None:
        self.running[name].kill()
        self.running[name].wait()
        print(f"{name} is killed, and started again", flush=True)
        self.running[name] = self.start(name)

    def said(self) -> str:
        """The next line of the station; "" when it has ended."""
        output = self.running["station"].stdout
        assert output is not None
        return output.readline()

    def warnings(self, word: str) -> list[str]:
        logs = [self.folder / f"{name}.log" for name in PROGRAMS]
        return [line for log in logs for line in log.read_text().splitlines() if word in line]

    def end(self) -> None:
        for process in self.running.values():
            process.terminate()
        for process in self.running.values():
            process.wait(20)


def certify(folder: Path) -> None:
    """Make certificates for all that talk to other hosts; on machines of their own each would have its own alone."""
    certs = (*AIORTS, "certs")
    subprocess.run([*certs, "init", "--folder", folder], check=True, stdout=subprocess.DEVNULL)
    for name, (host, _, network) in PROGRAMS.items():
        if network:
            issue = (*certs, "issue", name, "--role", "component", "--address", HOSTS[host], "--folder", folder)
            subprocess.run(issue, check=True, stdout=subprocess.DEVNULL)


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--kill", choices=[*PROGRAMS])
    parser.add_argument("--network", action="store_true")
    options = parser.parse_args()
    if options.network and (shutil.which("ip") is None or os.geteuid() != 0):
        parser.error("--network makes network namespaces: that needs Linux, root and the command `ip`")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # what was made is taken away all the same
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="lrf")))
        if options.network:
            certify(folder / "certs")
        processes = Processes(folder, stack.enter_context(namespaces(HOSTS)) if options.network else {})
        stack.callback(processes.end)
        while line := processes.said():
            print(line, end="", flush=True)
            if line == "100 matches\n" and options.kill:
                processes.kill(options.kill)
                options.kill = ""
            if line.startswith("calibrated"):
                print("".join(f"{warning}\n" for warning in processes.warnings("dropped{")), end="")
        if status := processes.running["station"].wait(20):
            print(*processes.warnings(""), sep="\n", file=sys.stderr)
        return status


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
