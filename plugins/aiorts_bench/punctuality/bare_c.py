"""The bare periodic loop in C: compiled where a compiler is found, and run in a process that is always ended."""

from __future__ import annotations

import asyncio
import shutil
import struct
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from aiorts_bench.punctuality.pacing import Ticks

COMPILERS: Final = ("cc", "gcc", "clang")
_GRACE_S: Final = 10.0
"""Seconds beyond count * period after which the process is ended."""

SOURCE: Final = r"""
#define _GNU_SOURCE
#include <errno.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <time.h>

static int64_t now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int main(int argc, char **argv) {
    if (argc != 4) return 2;
    int64_t period = atoll(argv[1]), count = atoll(argv[2]);
    int priority = atoi(argv[3]);
    if (period <= 0 || count <= 0) return 2;
    int64_t *marks = calloc(2 * count, sizeof *marks);
    if (!marks) return 3;
    int64_t granted = 0, skipped = 0, overruns = 0, tick = 0;
    if (priority > 0) {
        struct sched_param request = {.sched_priority = priority};
        mlockall(MCL_CURRENT | MCL_FUTURE);
        prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0);
        granted = sched_setscheduler(0, SCHED_FIFO, &request) == 0;
    }
    int64_t start = now() + 2000000;
    for (int64_t n = 0; n < count; n++) {
        int64_t due = start + tick * period;
        struct timespec until = {.tv_sec = due / 1000000000, .tv_nsec = due % 1000000000};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR) {}
        int64_t ran = now();
        marks[2 * n] = due;
        marks[2 * n + 1] = ran;
        int64_t behind = (ran - due) / period;
        if (behind > 0 && n + 1 < count) {
            overruns++;
            skipped += behind - 1;
            tick += behind - 1;
        }
        tick++;
    }
    struct rusage used;
    getrusage(RUSAGE_SELF, &used);
    int64_t cpu = (int64_t)(used.ru_utime.tv_sec + used.ru_stime.tv_sec) * 1000000000 +
                  (int64_t)(used.ru_utime.tv_usec + used.ru_stime.tv_usec) * 1000;
    int64_t head[4] = {granted, skipped, overruns, cpu};
    if (fwrite(head, sizeof *head, 4, stdout) != 4) return 4;
    if (fwrite(marks, sizeof *marks, 2 * count, stdout) != (size_t)(2 * count)) return 4;
    return fflush(stdout) ? 4 : 0;
}
"""


@dataclass(frozen=True, slots=True)
class CLoop:
    """The compiled loop."""

    program: Path

    async def run(self, period_ns: int, count: int, *, priority: int | None = None) -> Ticks:
        """Run the loop and return its ticks; with `priority` under SCHED_FIFO where that is granted.

        Raises:
            OSError: the loop could not be run, or gave no ticks.
        """
        arguments = (str(period_ns), str(count), str(priority or 0))
        process = await asyncio.create_subprocess_exec(
            str(self.program), *arguments, stdout=asyncio.subprocess.PIPE, stdin=asyncio.subprocess.DEVNULL
        )
        try:
            async with asyncio.timeout(period_ns * count / 1e9 + _GRACE_S):
                output, _ = await process.communicate()
        except TimeoutError:
            raise OSError(f"{self.program}: gave no ticks in time") from None
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if process.returncode or len(output) != 8 * (4 + 2 * count):
            raise OSError(f"{self.program}: status {process.returncode}, {len(output)} bytes")
        _, skipped, overruns, cpu, *marks = struct.unpack(f"={4 + 2 * count}q", output)
        return Ticks(period_ns, marks[::2], marks[1::2], skipped, overruns, cpu)


def build(folder: str | Path) -> CLoop | str:
    """Compile the loop into `folder`; return a sentence with the reason where that fails."""
    if sys.platform != "linux":
        return f"the C loop is written for Linux, not for {sys.platform}"
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        return f"no C compiler ({', '.join(COMPILERS)}) on the PATH: the loop in C is left out"
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        source, program = Path(scratch, "loop.c"), Path(folder, "loop")
        source.write_text(SOURCE, encoding="utf-8")
        try:
            done = subprocess.run(  # noqa: S603 - the user's own compiler, fixed words, no shell
                [compiler, "-O2", "-Wall", "-Werror", "-o", str(program), str(source)],
                capture_output=True,
                text=True,
                timeout=30,
                check=False,
            )
        except (OSError, subprocess.SubprocessError) as error:
            return f"{compiler}: {error}: the loop in C is left out"
    if done.returncode:
        first = (done.stderr.strip().splitlines() or ["no reason given"])[0]
        return f"{compiler}: {first}: the loop in C is left out"
    return CLoop(program)
