"""The configuration of a whole kernel in a file: saved as it is at one moment, read back all or nothing, compared."""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

from aiorts.errors import AiortsError, ConfigurationError
from aiorts.kernel.between_cycles import between_cycles
from aiorts.kernel.commit import Edit, commit, try_out
from aiorts.kernel.tasks import kernel_task
from aiorts.model.sets import ConfigurationState, Difference, differences

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.kernel import Kernel
    from aiorts.model.configuration_text import Document

__all__ = ("ConfigurationFiles",)

_LOG = logging.getLogger("aiorts.kernel")


class ConfigurationFiles:
    """What a kernel does with configuration files; `Kernel` derives from this."""

    _configuration_turn: asyncio.Lock | None = None
    """One file is put in force at a time."""

    async def save_configuration(self, path: str | os.PathLike[str], *components: Component) -> None:
        """Save the configuration sets of these components, or of all that have parameters.

        It is the configuration of one moment; the file is the old one or the new one, whatever happens meanwhile.

        Raises:
            ConfigurationError: a value cannot be written, or the file cannot; nothing was changed.
        """
        from anyio import to_thread

        from aiorts.kernel.safe_files import replace_text
        from aiorts.model.configuration_text import document_text

        kernel = cast("Kernel", self)
        kernel._require_open("save_configuration")
        for component in components:
            kernel._check_mine(component, "save the configuration of")
        chosen = components or tuple(component for component in kernel.components.values() if component.params)
        states = {component.name: component._rt_params._state for component in chosen}
        declared = {component.name: type(component)._rt_parameter_specs for component in chosen}
        text = document_text(states, declared)
        await to_thread.run_sync(replace_text, Path(path), text)

    async def load_configuration(self, path: str | os.PathLike[str]) -> None:
        """Put in force what a file says, of every component in it, or of none when anything is wrong.

        A component's sets are those of the file then, and no others. The components change one after the other, each
        between its own cycles. Awaited from a hook that this would wait for it is queued and returns at once.

        Raises:
            ConfigurationError: names all that is wrong, with lines. TransitionTimeout: a component's moment did not
                come in time. What was changed already is taken back.
        """
        kernel = cast("Kernel", self)
        kernel._require_open("load_configuration")
        document = await self._read(path)
        kernel._require_open("load_configuration")
        edits = self._edits(document)
        if any(context._inside() for component in edits for context in component.contexts):
            kernel_task(kernel.loop, self._logged(document, edits), f"aiorts load {document.path}")
        else:
            await self._put(edits)

    async def diff_configuration(self, path: str | os.PathLike[str]) -> tuple[Difference, ...]:
        """What differs between a file (old) and the components as they are (new); empty when loading changes nothing.

        Raises:
            ConfigurationError: the file cannot be read.
        """
        kernel = cast("Kernel", self)
        kernel._require_open("diff_configuration")
        document = await self._read(path)
        found: list[Difference] = []
        for name, entry in document.components.items():
            component = kernel.components.get(name)
            if component is None:
                found.append(Difference("removed", "component", name))
                continue
            state = component._rt_params._state
            active = (entry.active, state.active)
            found += differences(name, document.plain_sets(name, state), state.sets, active)
        for name, component in kernel.components.items():
            if name not in document.components and component.params:
                found.append(Difference("added", "component", name))
        return tuple(found)

    # -- how it is done --------------------------------------------------------------------------------------------

    async def _read(self, path: str | os.PathLike[str]) -> Document:
        from anyio import to_thread

        from aiorts.kernel.safe_files import read_text
        from aiorts.model.configuration_text import LARGEST, parse_document

        text = await to_thread.run_sync(read_text, Path(path), LARGEST)
        return parse_document(text, os.fspath(path))

    def _edits(self, document: Document) -> dict[Component, Edit]:
        """What is to be done with whom; what can be seen to be wrong now is refused now."""
        components = cast("Kernel", self).components
        edits: dict[Component, Edit] = {}
        faults = []
        for name in document.components:
            component = components.get(name)
            if component is None:
                near = get_close_matches(name, components, n=1)
                hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(components) or 'none'}"
                faults.append(str(document.fail(("components", name), f"no such component; {hint}")))
                continue
            edit = edits[component] = partial(document.state, name)
            try:
                edit(component._rt_params._state)
            except AiortsError as error:
                faults.append(str(error))
        if faults:
            raise ConfigurationError("\n".join(faults))
        return edits

    async def _put(self, edits: Mapping[Component, Edit]) -> None:
        if self._configuration_turn is None:
            self._configuration_turn = asyncio.Lock()
        kernel = cast("Kernel", self)
        async with self._configuration_turn:
            for component, edit in edits.items():
                await between_cycles(kernel, component, partial(try_out, component, edit))
            done: list[tuple[Component, ConfigurationState, ConfigurationState]] = []
            try:
                for component, edit in edits.items():
                    before = component._rt_params._state
                    await between_cycles(kernel, component, partial(commit, component, edit))
                    done.append((component, before, component._rt_params._state))
            except BaseException:
                await _take_back(kernel, done)
                raise

    async def _logged(self, document: Document, edits: Mapping[Component, Edit]) -> None:
        try:
            await self._put(edits)
        except AiortsError as error:
            _LOG.warning("%s: queued request to load %s failed: %s", cast("Kernel", self).name, document.path, error)


async def _take_back(kernel: Kernel, done: Sequence[tuple[Component, ConfigurationState, ConfigurationState]]) -> None:
    for component, before, after in reversed(done):
        try:
            await between_cycles(kernel, component, partial(commit, component, partial(_as_before, before, after)))
        except AiortsError as error:
            _LOG.warning("%s: its configuration could not be taken back: %s", component.name, error)


def _as_before(
    before: ConfigurationState, after: ConfigurationState, present: ConfigurationState
) -> ConfigurationState:
    # What somebody else changed meanwhile keeps its parameters.
    return before if present is after else present.replaced(before.sets, before.active)
