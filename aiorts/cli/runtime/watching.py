"""`aiorts run --watch`: what is changed in the files of a system is applied to the system that runs."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import aiorts
from aiorts.errors import AiortsError, BusyError, ClosedError, StateError, SystemFileError

if TYPE_CHECKING:
    from aiorts import Component, Kernel
    from aiorts.cli.runtime.log import Log
    from aiorts.system import Blueprint, Finding, Wanted

WINDOW: Final = 5.0
"""Seconds for which the system is measured, unless somebody says otherwise."""
_SETTLED: Final = 0.2
"""Seconds for which a file has to be the same before it is read."""
_MOST: Final = 200
"""Files of a folder that are looked at."""
_OURS: Final = Path(aiorts.__file__).resolve().parent
T = TypeVar("T")


class Watch:
    """Looks at the files that a system was made of, and applies what is changed in them.

    Args:
        plan: the system as it is built.
        read: reads its file anew.
        errors: finds all that is wrong with the file.
        window: seconds for which the system is measured before and after a change.
    """

    def __init__(
        self, plan: Blueprint, read: Callable[[], Blueprint], errors: Callable[[], Sequence[Finding]], window: float
    ) -> None:
        self._read = read
        self._errors = errors
        self._window = window
        self._files = set(plan.system.files)
        self._sources = _sources(plan.types.values())
        self._bad = False
        """Whether the file could not be read when it was read last."""
        self._near: Mapping[Path, bytes] = {}
        """What lay beside the file when it was read last."""
        self._seen = self._look()
        """The files as they were when something was done about them last."""
        self._code = {path: self._seen[path] for path in self._sources}
        """The files of components as the code that runs was read from them."""

    @contextlib.asynccontextmanager
    async def beside(self, kernel: Kernel, log: Log) -> AsyncIterator[None]:
        """Apply changes while this lasts."""
        following = asyncio.ensure_future(self._follow(kernel, log))
        try:
            yield
        finally:
            following.cancel()
            await asyncio.wait((following,))
            if not following.cancelled() and (error := following.exception()) is not None:
                log.failed(error)

    async def _follow(self, kernel: Kernel, log: Log) -> None:
        self._measure(kernel)
        before = self._seen
        with contextlib.suppress(ClosedError):
            while True:
                await asyncio.sleep(_SETTLED)
                now = await _aside(self._look)
                settled, before = now == before, now
                if settled and now != self._seen:
                    await self._take(
                        kernel, log, {path: now[path] for path in now if now[path] != self._seen.get(path)}
                    )
                    self._measure(kernel)
                    self._sources |= _sources(map(type, kernel.components.values()))
                    before, known = await _aside(self._look), {**self._near, **now}
                    self._code = {path: before[path] for path in self._sources} | self._code
                    # What came while the file was read may be what it needs: it counts as changed.
                    self._seen = {one: known.get(one, b"" if self._bad else found) for one, found in before.items()}

    def _look(self) -> Mapping[Path, bytes]:
        """What tells whether files have changed; what a bad file names, and is not there, may come beside it."""
        paths = self._files | self._sources
        return {path: _digest(path) for path in paths} | (self._look_near() if self._bad else {})

    def _look_near(self) -> dict[Path, bytes]:
        folders = {path.parent for path in self._files}
        return {path: _digest(path) for folder in folders for path in _written_in(folder)}

    async def _take(self, kernel: Kernel, log: Log, changed: Mapping[Path, bytes]) -> None:
        """Do what these files, which are such now, ask for; what is wrong with them is told."""
        try:
            for path, digest in changed.items():
                if digest != self._code.get(path):
                    await self._reload(kernel, log, path)
                    self._code[path] = digest
        except ClosedError:
            raise
        except AiortsError as error:
            log.failed(error)
        if not (self._bad or self._files.intersection(changed)):
            return
        self._near = await _aside(self._look_near)
        try:
            wanted = await _aside(self._wanted)
        except AiortsError as error:
            self._bad = True
            log.refused(error, await _aside(self._errors))
            return
        if wrong := await _aside(self._errors):
            self._bad = True
            log.refused(SystemFileError(wrong[0].cause), wrong)
            return
        self._bad = False
        try:
            await self._apply(kernel, log, wanted)
        except ClosedError:
            raise
        except AiortsError as error:
            log.failed(error)

    async def _reload(self, kernel: Kernel, log: Log, path: Path) -> None:
        """Replace the code of all types of a file; where there is no component of it, it is imported when one comes."""
        from aiorts.reload import file_of, forget_file

        kinds = [one for one in dict.fromkeys(map(type, kernel.components.values())) if file_of(one) == path]
        for kind in kinds:
            try:
                done = await kernel.reload(kind, window=self._window)
            except StateError as error:  # the other types have their newer code all the same
                log.tell("", str(error), level="warning")
                continue
            log.tell("", f"~ reload {done.kind}: {', '.join(one.component for one in done.components)}", level="info")
            log.tell("", "kept" if self._window else "done", level="info")
        if not kinds and path in self._sources:
            forget_file(path)

    async def _apply(self, kernel: Kernel, log: Log, wanted: Wanted) -> None:
        while True:
            try:
                plan = (await kernel.apply(wanted, dry_run=True)).plan
                for why in plan.refused:
                    log.tell("E-SYSTEM", why)
                if plan.refused or plan.empty:
                    return
                for step in plan.steps:
                    log.tell("", f"{step.sign} {step.text}", level="info")
                done = await kernel.apply(wanted, window=self._window)
            except BusyError:  # somebody else applies a plan
                await asyncio.sleep(_SETTLED)
                continue
            for note in done.notes:
                log.tell("", note, level="warning")
            if done.done:
                log.tell("", "kept" if self._window else "done", level="info")
            else:
                log.tell("E-APPLY", f"taken back: {done.rolled_back}")
            return

    def _wanted(self) -> Wanted:
        from aiorts.system import wanted

        plan = self._read()
        self._files = set(plan.system.files)
        return wanted(plan)

    def _measure(self, kernel: Kernel) -> None:
        """From now on have at hand how the system does."""
        from aiorts.planning import Planning

        if self._window:
            kernel.service(Planning).health.watch(self._window)


def _sources(kinds: Iterable[type[Component]]) -> set[Path]:
    """The files of these types, without what is installed."""
    from aiorts.reload import file_of

    found = (file_of(kind) for kind in kinds)
    return {one for one in found if one is not None and "site-packages" not in one.parts and _OURS not in one.parents}


def _written_in(folder: Path) -> list[Path]:
    return [path for pattern in ("*.toml", "*.py") for path in islice(folder.glob(pattern), _MOST)]


def _digest(path: Path) -> bytes:
    """Of what is in a file; b"" where it cannot be read."""
    try:
        return sha256(path.read_bytes()).digest()
    except OSError:
        return b""


async def _aside(work: Callable[[], T]) -> T:
    """What it returns, from a thread; who is cancelled does not wait for it."""
    from anyio import to_thread

    return await to_thread.run_sync(work, abandon_on_cancel=True)
