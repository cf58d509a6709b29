"""The state that a component takes into another process, as plain values, and the samples that it has not read.

Its attributes go over: plain data, arrays and records. Ports, parameters and a state machine, which begins in its
initial state, are made by its class there. The `on_reload` of a class that has one gets a look-alike of the old
instance instead, with the attributes that can go over.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Mapping
from enum import Enum
from functools import reduce
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError, ComponentError, StateError, format_error
from aiorts.kernel.component import Component
from aiorts.kernel.detached_hook import run_alone
from aiorts.kernel.execution.cell import ATTRIBUTE, MadeByClass, cell
from aiorts.kernel.execution.hooks import further_kinds
from aiorts.kernel.execution.member import is_open
from aiorts.kernel.ports import InPort, PortDeclaration
from aiorts.kernel.ports.connector import Connector, transport_of
from aiorts.kernel.ports.in_port import receiver_of, set_open
from aiorts.kernel.quality.dated import Dated
from aiorts.wire import LINK, MsgpackCodec

if TYPE_CHECKING:
    from collections.abc import Sequence

    from aiorts.kernel.microkernel import Microkernel

_CODEC: Final = MsgpackCodec(LINK)
_AS_IT_IS: Final = (type(None), bool, int, float, str)
_ROWS: Final[Mapping[type, str]] = {list: "list", tuple: "tuple", set: "set", frozenset: "frozenset"}
_MADE: Final[Mapping[str, Callable[[Any], Any]]] = {name: kind for kind, name in _ROWS.items()}
_DEEPEST: Final = 100


def packed(value: Any, where: str, depth: int = 0) -> Any:
    """A value in a form that a request can carry, JSON and bytes, with its type.

    Raises:
        StateError: it cannot go into another process; says where it is.
    """
    import numpy as np  # late: few components move

    kind = type(value)
    if kind in _AS_IT_IS:
        return value
    if depth > _DEEPEST:
        raise StateError(f"{where[:200]}: is nested more than {_DEEPEST} deep")
    if kind in _ROWS:
        return {_ROWS[kind]: [packed(one, f"{where}[{place}]", depth + 1) for place, one in enumerate(value)]}
    if kind is dict:
        pairs = [(key, value[key], f"{where}[{key!r:.40}]") for key in value]
        return {"dict": [[packed(key, at, depth + 1), packed(one, at, depth + 1)] for key, one, at in pairs]}
    if kind is deque:
        return {"deque": [[packed(one, where, depth + 1) for one in value], value.maxlen]}
    if kind in (bytes, bytearray):
        return {kind.__name__: bytes(value)}
    if kind is complex:
        return {"complex": [value.real, value.imag]}
    if isinstance(value, Enum):
        return {"enum": [_name_of(kind, where), value.name]}
    if (kind is np.ndarray or isinstance(value, np.generic)) and not value.dtype.hasobject:
        return {"array": [np.lib.format.dtype_to_descr(value.dtype), list(value.shape), value.tobytes()]}
    try:
        head, parts = _CODEC.parts_encoder(kind)(value)
    except AiortsError:
        raise _refusal(value, where) from None
    return {"record": [_name_of(kind, where), bytes(head), [bytes(part) for part in parts]]}


def unpacked(value: Any) -> Any:
    """The value from which `packed` made this one."""
    if not isinstance(value, dict):
        return value
    ((kind, given),) = value.items()
    if kind in _MADE:
        return _MADE[kind](unpacked(one) for one in given)
    match kind:
        case "dict":
            return {unpacked(key): unpacked(one) for key, one in given}
        case "deque":
            return deque((unpacked(one) for one in given[0]), given[1])
        case "bytes":
            return given
        case "bytearray":
            return bytearray(given)
        case "complex":
            return complex(*given)
        case "enum":
            return _named(given[0])[given[1]]
        case "array":
            import numpy as np  # late: as above

            descr: Any = given[0] if isinstance(given[0], str) else [tuple(field) for field in given[0]]
            array = np.frombuffer(bytearray(given[2]), np.lib.format.descr_to_dtype(descr)).reshape(given[1])
            return array if given[1] else array[()]
    name, head, parts = given
    return _CODEC.parts_decoder(_named(name))(head, parts)


def _name_of(kind: type, where: str) -> str:
    """The text by which another process finds a class. StateError: there is none."""
    name = f"{kind.__module__}:{kind.__qualname__}"
    try:
        found = _named(name)
    except (AttributeError, ImportError, KeyError):
        found = None
    if found is not kind or kind.__module__ == "__main__":
        raise StateError(f"{where}: its class {kind.__qualname__} cannot be imported by another process")
    return name


def _named(name: str) -> Any:
    module, _, path = name.partition(":")
    return reduce(getattr, path.split("."), sys.modules.get(module) or import_module(module))


def _refusal(value: Any, where: str) -> StateError:
    return StateError(
        f"{where}: a {type(value).__name__} cannot go into another process: plain data, arrays and records can; set it "
        "to None in on_deactivated and make it in on_activated, or write on_reload(self, old)"
    )


# -- state ---------------------------------------------------------------------------------------------------------


def state_of(component: Component) -> dict[str, Any]:
    """The attributes of a component, as values that a request can carry.

    Raises:
        StateError: an attribute, which is named, cannot go over, and the component has no `on_reload`.
    """
    takes_over = _takes_over(component)
    state = {}
    for name, value in vars(component).items():
        if name == ATTRIBUTE or isinstance(value, PortDeclaration | MadeByClass):
            continue
        if name in cell(component).configuration.specs:
            continue
        try:
            state[name] = packed(value, f"{component.name}.{name}")
        except StateError:
            if not takes_over:
                raise
    return state


def _takes_over(component: Component) -> bool:
    return type(component).on_reload is not Component.on_reload


async def give_state(kernel: Microkernel, component: Component, state: Mapping[str, Any]) -> None:
    """Give a component the attributes of the instance before it; or run its `on_reload` with a look-alike of that.

    Raises:
        ComponentError: `on_reload` failed.
    """
    values = {name: unpacked(value) for name, value in state.items()}
    if not _takes_over(component):
        vars(component).update(values)
        return
    cell(component).hook_kinds |= further_kinds(type(component), Component, {"on_reload": ("self", "old")})
    old = object.__new__(type(component))
    vars(old).update({**cell(component).configuration.values, **values})
    error = await run_alone(kernel, component, "on_reload", None, old, limit=kernel.initialize_timeout)
    if error is not None:
        raise ComponentError(f"{component.name}: on_reload failed: {format_error(error)}") from error


# -- samples -------------------------------------------------------------------------------------------------------


def hold(component: Component) -> None:
    """Keep a component's open in-ports open, wherever the component is: unread samples stay unread."""
    cell(component).held_open = is_open(component)


def release(component: Component) -> None:
    """End `hold`: the ports of the component are open or closed as always."""
    here = cell(component)
    if not here.held_open:
        return
    here.held_open = here.retired = False
    takes = is_open(component)
    for port in component.ports.values():
        if isinstance(port, InPort):
            set_open(port, takes)


def taken(connector: Connector) -> list[Any]:
    """Take the unread samples of a connector, which counts them as dropped{moved}: they go where its reader goes."""
    transport = transport_of(connector)
    transport.settle()
    with transport.guard():
        samples = [*transport.queue, *transport.leave_off()]
        transport.discard("moved")
        receiver_of(connector.in_).settle_tokens()
    return samples


def put_in_front(connector: Connector, samples: Sequence[Any]) -> None:
    """Put samples in front of the unread ones of a connector; they count as written to it."""
    transport, receiver = transport_of(connector), receiver_of(connector.in_)
    transport.settle()
    with transport.guard():
        if isinstance(transport, Dated):
            transport.moments.queue.extendleft([transport.moments.now_ns()] * len(samples))
        transport.queue.extendleft(reversed(samples))
        transport.written += len(samples)
        if receiver.tokens is not None:
            receiver.tokens.extendleft([transport] * len(samples))
