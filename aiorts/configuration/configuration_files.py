"""Saves the configuration of a whole kernel at one moment, loads it all or nothing, and compares it with a file."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from aiorts.errors import AiortsError, ConfigurationError
from aiorts.kernel.between_cycles import between_cycles
from aiorts.kernel.commit import Edit, try_out
from aiorts.kernel.configuring import put
from aiorts.kernel.declarations import declarations
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.file_access import acting
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.kernel.service import KernelService
from aiorts.model.configuration.sets import ConfigurationState, Difference, differences
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.configuration.configuration_text import Document

_LOG = KernelLog()


class ConfigurationFiles(KernelService):
    """Saves, loads and compares the configuration of a kernel's components."""

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._turn = asyncio.Lock()
        """One file is put in force at a time."""

    async def save(self, path: str | os.PathLike[str], components: Sequence[Component]) -> None:
        """See `Kernel.save_configuration`."""
        from anyio import to_thread

        from aiorts.configuration.safe_files import replace_text

        for component in components:
            self.kernel.check_mine(component, "save the configuration of")
        await to_thread.run_sync(replace_text, Path(path), self.text(components))

    def text(self, components: Sequence[Component] = ()) -> str:
        """The file's text at this moment: of these components, or of all that have parameters."""
        from aiorts.model.configuration.configuration_text import document_text

        chosen = components or tuple(one for one in self.kernel.components.values() if one.params)
        states = {component.name: cell(component).configuration for component in chosen}
        declared = {component.name: declarations(type(component)).parameters for component in chosen}
        return document_text(states, declared)

    async def load(self, path: str | os.PathLike[str]) -> None:
        """See `Kernel.load_configuration`."""
        document = await self._read(path)
        self.kernel.check_open("load_configuration")
        await self._put_document(document)

    async def load_text(self, text: str, name: str) -> tuple[str, ...]:
        """Load the text of a file, which messages call `name`; return the components in it."""
        from aiorts.model.configuration.configuration_text import parse_document

        document = parse_document(text, name)
        await self._put_document(document)
        return tuple(document.components)

    async def _put_document(self, document: Document) -> None:
        kernel = self.kernel
        edits = self._edits(document)
        if any(context.runner.inside() for component in edits for context in component.contexts):
            kernel_task(kernel.loop, self._logged(document, edits), f"aiorts load {document.path}")
        else:
            await self._put(edits)

    async def diff(self, path: str | os.PathLike[str]) -> tuple[Difference, ...]:
        """See `Kernel.diff_configuration`."""
        kernel = self.kernel
        document = await self._read(path)
        found: list[Difference] = []
        for name, entry in document.components.items():
            component = kernel.components.get(name)
            if component is None:
                found.append(Difference("removed", "component", name))
                continue
            state = cell(component).configuration
            active = (entry.active, state.active)
            found += differences(name, document.plain_sets(name, state), state.sets, active)
        for name, component in kernel.components.items():
            if name not in document.components and component.params:
                found.append(Difference("added", "component", name))
        return tuple(found)

    # -- how it is done --------------------------------------------------------------------------------------------

    async def _read(self, path: str | os.PathLike[str]) -> Document:
        from anyio import to_thread

        from aiorts.configuration.safe_files import read_text
        from aiorts.model.configuration.configuration_text import LARGEST, parse_document

        text = await to_thread.run_sync(read_text, Path(path), LARGEST)
        return parse_document(text, os.fspath(path))

    def _edits(self, document: Document) -> dict[Component, Edit]:
        """The changes by component; errors that can be known now are raised now."""
        components = self.kernel.components
        edits: dict[Component, Edit] = {}
        faults = []
        for name in document.components:
            component = components.get(name)
            if component is None:
                hint = suggestion(name, components, shown=str)
                faults.append(str(document.fail(("components", name), f"no such component; {hint}")))
                continue
            edit = edits[component] = partial(document.state, name)
            try:
                edit(cell(component).configuration)
            except AiortsError as error:
                faults.append(str(error))
        if faults:
            raise ConfigurationError("\n".join(faults))
        return edits

    async def _put(self, edits: Mapping[Component, Edit]) -> None:
        kernel = self.kernel
        async with self._turn:
            for component, edit in edits.items():
                await between_cycles(kernel, component, partial(try_out, component, edit))
            done: list[tuple[Component, ConfigurationState, ConfigurationState]] = []
            try:
                for component, edit in edits.items():
                    before = cell(component).configuration
                    await put(kernel, component, edit)
                    done.append((component, before, cell(component).configuration))
            except BaseException:
                await _take_back(kernel, done)
                raise

    async def _logged(self, document: Document, edits: Mapping[Component, Edit]) -> None:
        try:
            await self._put(edits)
        except AiortsError as error:
            _LOG.warning("%s: queued request to load %s failed: %s", self.kernel.name, document.path, error)


async def _take_back(
    kernel: Microkernel, done: Sequence[tuple[Component, ConfigurationState, ConfigurationState]]
) -> None:
    for component, before, after in reversed(done):
        try:
            with acting(None):  # the files that it had were not named by the client
                await put(kernel, component, partial(_as_before, before, after))
        except AiortsError as error:
            _LOG.warning("%s: its configuration could not be taken back: %s", component.name, error)


def _as_before(
    before: ConfigurationState, after: ConfigurationState, present: ConfigurationState
) -> ConfigurationState:
    # A component that was changed meanwhile keeps its parameters.
    return before if present is after else present.replaced(before.sets, before.active)
