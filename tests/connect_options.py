"""Write `aiorts/model/connect_options.py` from the declared options. Run: python tests/connect_options.py

Type checkers and editors read that file: a TypedDict cannot be made at run time. A test fails when it is stale.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from aiorts.model import options, profile
from aiorts.model.declared import Option, kinds_of, may_be_none, options_of

FILE: Final = Path(__file__).parents[1] / "aiorts" / "model" / "connect_options.py"
_WIDTH: Final = 120
_HEAD: Final = '''\
"""The keywords of `Kernel.connect` with their types, for editors and type checkers; `options.py` checks what comes.

Written by tests/connect_options.py from the declarations in `profile.py` and `options.py`: correct them there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Protocol, TypedDict

from aiorts.model.buffer import EmptyPolicy, FullPolicy
from aiorts.model.policy import Dataflow, OnLinkLost, Push, Stamp, Subscription


class Converter(Protocol):
    """A function of one sample. `Callable[[Any], Any]` would make the result of `connect` Any for mypy."""

    def __call__(self, sample: Any, /) -> object: ...


class ConnectOptions(TypedDict, total=False):
    """The options of `Kernel.connect`, each of which may be left out.

    For functions that pass options on: `def link(**options: Unpack[ConnectOptions])`, with `Unpack` of `typing`. At run
    time `connect(a, b, **{"dataport.push_policy": "new"})` is accepted as well; no type can say so before Python 3.15.
    """
'''
_TAIL: Final = '''    openrtm: Mapping[str, object]
    """OpenRTM's keys, such as {"dataport.subscription_type": "new"}."""
'''


def text() -> str:
    """The text of the file."""
    lines = [
        line for cls in (profile.ConnectorProfile, options.PortLimits, options.ServiceOptions) for line in _of(cls)
    ]
    return _HEAD + "\n" + "\n".join(lines) + "\n" + _TAIL


def _of(cls: type) -> Iterator[str]:
    for name, one in options_of(cls).items():
        yield f"    {name}: {_kind(cls, name, one)}"
        ends = {"ports": "", "services": " Of service ports."}.get(one.end, "")
        yield textwrap.fill(f'"""{one.described}{ends}"""', _WIDTH, initial_indent="    ", subsequent_indent="    ")


def _kind(cls: type, name: str, one: Option) -> str:
    """The type of an option as a program writes it."""
    # A limit of a port has no value where it is not given: None is none of its values.
    none = " | None" if may_be_none(cls, name) and one.end not in ("ports", "services") else ""
    if one.takes is not None:
        return f"{one.takes.__annotations__['value']}{none}"
    kinds = kinds_of(cls)[name]
    if isinstance(kinds[0], type) and issubclass(kinds[0], StrEnum):
        words = ", ".join(f'"{member.value}"' for member in kinds[0])
        return f"Literal[{words}] | {kinds[0].__name__}{none if one.default is not None else ''}"
    return " | ".join(map(_spelled, kinds)) + none


def _spelled(kind: Any) -> str:
    return (
        str(kind.__name__)
        if isinstance(kind, type) and not hasattr(kind, "__args__")
        else str(kind).replace("typing.", "").replace("collections.abc.", "").replace("'", '"')
    )


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
