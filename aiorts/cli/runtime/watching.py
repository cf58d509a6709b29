"""`aiorts run --watch`: applies changes in the files of a system to the running system."""

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
"""Seconds for which the system is measured, unless --window is given."""
_SETTLED: Final = 0.2
"""Seconds for which a file has to be unchanged before it is read."""
_MOST: Final = 200
"""Files of a folder that are watched at most, of each kind."""
_OURS: Final = Path(aiorts.__file__).resolve().parent
T = TypeVar("T")


class Watch:
    """A watch on the files of a system, which applies changes in them.

    Args:
        plan: the system as it is built.
        read: reads the system file again.
        errors: finds all errors of the file.
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
        """Whether the last reading of the system file failed."""
        self._near: Mapping[Path, bytes] = {}
        """The digests of the files in the same folders at the last reading."""
        self._seen = self._look()
        """The digests of the files as they were last handled."""
        self._code = {path: self._seen[path] for path in self._sources}
        """The digests of the component files from which the running code was read."""

    @contextlib.asynccontextmanager
    async def beside(self, kernel: Kernel, log: Log) -> AsyncIterator[None]:
        """Apply changes during the block."""
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
                    # A file that came during the reading may be one that the system file needs: it counts as changed.
                    self._seen = {one: known.get(one, b"" if self._bad else found) for one, found in before.items()}

    def _look(self) -> Mapping[Path, bytes]:
        """The digests of the watched files; after a failed reading also of the files next to them."""
        paths = self._files | self._sources
        return {path: _digest(path) for path in paths} | (self._look_near() if self._bad else {})

    def _look_near(self) -> dict[Path, bytes]:
        folders = {path.parent for path in self._files}
        return {path: _digest(path) for folder in folders for path in _written_in(folder)}

    async def _take(self, kernel: Kernel, log: Log, changed: Mapping[Path, bytes]) -> None:
        """Apply the changes of these files, given with their digests; errors are logged."""
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
        """Replace the code of all types of a file; a file without a component is imported again when one comes."""
        from aiorts.reload import file_of, forget_file

        kinds = [one for one in dict.fromkeys(map(type, kernel.components.values())) if file_of(one) == path]
        for kind in kinds:
            try:
                done = await kernel.reload(kind, window=self._window)
            except StateError as error:  # the other types still get their new code
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
            except BusyError:  # another client applies a plan
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
        """Begin to measure the system for the comparison of windows."""
        from aiorts.planning import Planning

        if self._window:
            kernel.service(Planning).health.watch(self._window)


def _sources(kinds: Iterable[type[Component]]) -> set[Path]:
    """The files of these types, except those of installed packages."""
    from aiorts.reload import file_of

    found = (file_of(kind) for kind in kinds)
    return {one for one in found if one is not None and "site-packages" not in one.parts and _OURS not in one.parents}


def _written_in(folder: Path) -> list[Path]:
    return [path for pattern in ("*.toml", "*.py") for path in islice(folder.glob(pattern), _MOST)]


def _digest(path: Path) -> bytes:
    """The digest of a file's content; b"" where it cannot be read."""
    try:
        return sha256(path.read_bytes()).digest()
    except OSError:
        return b""


async def _aside(work: Callable[[], T]) -> T:
    """Run a function in a thread and return its result; a cancelled caller does not wait for it."""
    from anyio import to_thread

    return await to_thread.run_sync(work, abandon_on_cancel=True)
