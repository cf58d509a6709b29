"""The stand-in in a kernel for a component of another one.

It has the component's data ports and parameters, and is started here as any other, such as with the composite that it
is a member of. Its hooks ask the other kernel to do the same; changes of the component there happen to it. While the
stand-in is in a context here, its state decides whether the component is active; afterwards the component is as before.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, ClosedError, ComponentError, LinkError, NoAnswerError, StateError
from aiorts.isolation import fail, follow
from aiorts.kernel.between_cycles import between_cycles
from aiorts.kernel.commit import commit
from aiorts.kernel.component import Component, Elsewhere
from aiorts.kernel.declarations import Kind
from aiorts.kernel.execution.cell import cell
from aiorts.links import Links
from aiorts.model.configuration.configuration_profile import plain_value
from aiorts.model.lifecycle import LifecycleState

if TYPE_CHECKING:
    from aiorts.model.configuration.sets import ConfigurationState
    from aiorts.model.names import Path
    from aiorts.remote.session import KernelSession

_ACTIVE, _ERROR, _INACTIVE = LifecycleState.ACTIVE, LifecycleState.ERROR, LifecycleState.INACTIVE
_LINKED: Final = 2.0
"""Seconds that an activation waits for the links of its out-ports."""
_TIMEOUT: Final = 4.0
"""Seconds that a transition may take in the other kernel."""
_NEWS: Final = (
    *("StateChanged", "HookFailed", "ParametersChanged", "PortAdded", "PortRemoved", "ComponentRemoved"),
    *("MemberAdded", "MemberRemoved", "ContextStopped"),
)
"""Events after which the stand-in looks at the component."""


class FarKind(Kind):
    """Passes changes of the configuration on, before they are in force here."""

    async def configuring(self, component: FarComponent, state: ConfigurationState) -> None:
        await component.passes_on(state)

    def keeps_code(self, component: Any) -> str:
        return "it runs in another kernel; reload it there"


class FarComponent(Component, Elsewhere, kind=FarKind()):
    """A component of another kernel, as this one sees it. `Kernel.stand_in` makes it."""

    _where: Path
    _holder = ""
    _session: KernelSession | None = None
    _there = _INACTIVE
    """The last state that its kernel has told."""
    _was_active = False
    """Whether the component was active before the stand-in was in a context here."""
    _own = 0
    """Transitions of this end that are under way."""
    _looks: asyncio.Task[None] | None = None
    _news = False

    def bind(self, where: Path, holder: str, session: KernelSession) -> None:
        """Make it the stand-in of the component of this path, held for a composite of this name."""
        self._where, self._holder, self._session = where, holder, session
        self._turn = asyncio.Lock()
        """The lock that lets one look, or one question that changes something, run at a time."""

    @property
    def path(self) -> str:
        """The path of the component in its kernel."""
        return str(self._where)

    # -- its kernel ------------------------------------------------------------------------------------------------

    async def on_initialize(self) -> None:
        await self._begin()

    async def on_finalize(self) -> None:
        if self._looks is not None:
            self._looks.cancel()
        if self._session is not None:
            self._session.close()

    async def _begin(self) -> None:
        """Hold the component in its kernel, and take over its ports and configuration."""
        session, name = self._open_session, self._where.component
        links = self.kernel.service(Links)
        holder = f"{links.reached_as}/{self._holder}" if self._holder else f"kernel {links.reached_as}"
        await session.call("hold", component=name, holder=holder)
        session.lost = self._lost
        await session.follow("events", self._happened, kinds=_NEWS)
        await self._look()

    async def _connect(self) -> None:
        """Reach its kernel again, where it was lost."""
        from aiorts.remote.finding import opened  # late: that module knows this class

        if self._session is None or not self._session.is_open:
            self._session = await opened(self.kernel, self._where, self.path)
            try:
                await self._begin()
            except BaseException:
                self._session.close()  # the next reset begins from the start
                raise

    @property
    def _open_session(self) -> KernelSession:
        if self._session is None or not self._session.is_open:
            raise self._lost_error()
        return self._session

    def _lost_error(self) -> LinkError:
        return LinkError(f"{self.path}: its kernel {self._where.kernel} is lost; reset it when that is back")

    def _lost(self) -> None:
        self._there = _ERROR
        self._fails(self._lost_error())

    def _fails(self, error: Exception) -> None:
        if self.state is not _ERROR:
            fail(self, error)

    # -- what happens there ----------------------------------------------------------------------------------------

    def _happened(self, item: Mapping[str, Any]) -> None:
        if item["event"].get("component", self._where.component) != self._where.component:
            return
        self._news = True
        if self._looks is None or self._looks.done():
            self._looks = self.kernel.service(Links).run(self._looking(), f"aiorts look {self.name}")

    async def _looking(self) -> None:
        while self._news:
            self._news = False
            try:
                await self._follow_state(*await self._look())
            except NoAnswerError:
                self._news = True  # the wait was long enough; the change is still to be seen
            except (ClosedError, LinkError, StateError):
                continue  # the kernel is lost, as the session says, or the state here has changed meanwhile
            except AiortsError as error:
                self.log.warning("%s", error)

    async def _look(self) -> tuple[bool, str]:
        """Take over its ports, values and state; returns whether it has finished, and its error."""
        async with self._turn:
            names, report, outline = await self._see()
        states = names["components"][self._where.component].values()
        rows = _rows(self._where.component, report, outline["ports"])
        if rows and not names["links"] and self.kernel.service(Links).peer_of(self._where) is None:
            raise StateError(
                f"{self.path}: links of other kernels cannot reach {self._where.kernel}; give it a [links] table"
            )
        follow(self, rows, names["links"] or self._where.kernel, self._where.host)
        self._there = _ERROR if "error" in states else _ACTIVE if "active" in states else _INACTIVE
        # After the turn: a hook that waits for it holds up the context in which the values are to be in force.
        await self._copy(report["configuration"])
        return self._where.component in names["finished"], report["last_error"] or "is in error"

    async def _see(self) -> tuple[Mapping[str, Any], Mapping[str, Any], Mapping[str, Any]]:
        """Its kernel's names, and its report and outline there. LinkError: the component is there no more."""
        session, name = self._open_session, self._where.component
        names = await session.call("names")
        if name not in names["components"]:
            session.close()
            self._there = _ERROR
            gone = LinkError(f"{self.path}: is there no more")
            self._fails(gone)
            raise gone
        report = (await session.call("part", components=[name]))["components"][name]
        return names, report, (await session.call("outline", components=[name]))[name]

    async def _copy(self, configuration: Mapping[str, Any]) -> None:
        """Take over the values that are in force in the other kernel."""
        sets, active = configuration["sets"], configuration["active"]
        here = {key: plain_value(dict(values)) for key, values in self.configuration.sets.items()}
        if (sets, active) == (here, self.configuration.active):
            return
        checked = cell(self).configuration.replaced(sets, active, self.name).sets
        edit = partial(_replaced, checked, active, self.name)
        await between_cycles(self.kernel, self, partial(commit, self, edit))  # not passed on: they are from there

    async def _follow_state(self, finished: bool, error: str) -> None:
        if self._own:
            return  # a hook here has asked for the change and has not ended
        if self._there is _ERROR:
            self._fails(ComponentError(f"{self.path}: {error}"))
        elif self._there is _INACTIVE and self.state is _ACTIVE:
            if finished:
                self.finish()
            else:
                await self.kernel.deactivate(self)
        elif self._there is _ACTIVE and self.state is _INACTIVE:
            await self.kernel.activate(self)

    # -- what is asked of it ---------------------------------------------------------------------------------------

    async def passes_on(self, state: ConfigurationState) -> None:
        """Ask the other kernel for this configuration."""
        before = cell(self).configuration
        if self._session is None or self.kernel.registry.is_arriving(self):
            return
        values = {
            key: {one: plain_value(value) for one, value in values.items() if _differs(before, key, one, value)}
            for key, values in state.sets.items()
        }
        changed = {key: one for key, one in values.items() if one or key not in before.sets}
        activate = None if state.active == before.active else state.active
        gone = [key for key in before.sets if key not in state.sets]
        added = [key for key in state.sets if key not in before.sets]
        if changed or activate or gone or added:
            one = self._where.component
            await self.ask("configure", component=one, values=changed, add=added, remove=gone, activate=activate)

    async def on_startup(self) -> None:
        await self._connect()
        if self._there is _ERROR:
            raise StateError(f"{self.path}: is in error there; reset it there first")
        self._was_active = self._there is _ACTIVE
        await self._to(_INACTIVE, "deactivate")

    async def on_shutdown(self) -> None:
        if self._session is not None and self._session.is_open and self._there is not _ERROR:
            await (self._to(_ACTIVE, "activate") if self._was_active else self._to(_INACTIVE, "deactivate"))

    async def on_activated(self) -> None:
        # Samples that it wrote before its links are made would have no connector that counts them.
        connectors = [one for port in self.ports.values() for one in port.connectors]
        await self.kernel.service(Links).up(connectors, _LINKED)
        await self._to(_ACTIVE, "activate")

    async def on_deactivated(self) -> None:
        if self._session is not None and self._session.is_open:
            await self._to(_INACTIVE, "deactivate")

    async def on_reset(self) -> None:
        await self._connect()
        if self._there is _ERROR:
            await self.ask("reset", component=self._where.component, timeout=_TIMEOUT)
            self._there = _INACTIVE
        await self._to(_INACTIVE, "deactivate")

    async def _to(self, state: LifecycleState, operation: str) -> None:
        """Bring the component into this state in its kernel."""
        self._own += 1
        try:
            async with self._turn:  # a look that held the turn may have seen another state
                if self._there is not state and not (self._there is _ERROR and state is _INACTIVE):
                    await self._open_session.call(operation, component=self._where.component, timeout=_TIMEOUT)
                    self._there = state
        finally:
            self._own -= 1

    async def ask(self, operation: str, **arguments: Any) -> Any:
        """The answer of its kernel.

        Raises:
            LinkError: the connection is lost.
            NoAnswerError, AiortsError: the kernel does not answer, or has refused.
        """
        async with self._turn:
            return await self._open_session.call(operation, **arguments)


def _replaced(
    sets: Mapping[str, Mapping[str, object]], active: str, owner: str, state: ConfigurationState
) -> ConfigurationState:
    return state.replaced(sets, active, owner)


def _differs(before: ConfigurationState, key: str, name: str, value: Any) -> bool:
    values = before.sets.get(key, {})
    return name not in values or values[name] != value


def _rows(name: str, report: Mapping[str, Any], outline: Mapping[str, Any]) -> list[list[Any]]:
    """The component's data ports, as `follow` takes them."""
    exported = (report["composite"] or {}).get("exported", {})
    rows = []
    for port, one in report["ports"].items():
        if one["direction"] != "service":
            what = [one["direction"], outline[port]["full_type"], one["unit"], one["shape"], one["doc"], None, None]
            rows.append([port, *what, exported.get(port, f"{name}.{port}")])
    return rows
