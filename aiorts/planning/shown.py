"""The paths and names in a system file for connectors with members that a composite has in other kernels.

The file knows the ports that the composite exports; here they are those of components that stand for the members.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.composites import outer_of

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector


def shown_path(kernel: Microkernel, path: str) -> str:
    """A path as a file has it: a port of a member elsewhere is that of its composite, or one of its kernel."""
    name, _, port = path.partition(".")
    member = kernel.components.get(name)
    outer = None if member is None else outer_of(member)
    if member is None or outer is None or member not in outer.brought:
        return path
    names = (key for key, one in outer.component.ports.items() if one is member.ports.get(port))
    shown = next(names, None)
    return f"{outer.brought[member]}.{port}" if shown is None else f"{outer.name}.{shown}"


def shown_name(kernel: Microkernel, connector: Connector) -> str:
    """The name of a connector as a file has it; a name that follows from the ports follows from the file's paths."""
    paths = connector.out.path, connector.in_.path
    usual, name = "-".join(paths), connector.profile.name
    if not name.startswith(usual):
        return name
    return "-".join(shown_path(kernel, path) for path in paths) + name.removeprefix(usual)
