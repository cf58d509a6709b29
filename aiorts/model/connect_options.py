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

    name: str
    """The name of the connector."""
    dataflow: Literal["push", "pull"] | Dataflow
    """The end that begins a transfer: with push the writer delivers, with pull the reader fetches the writer's latest
    unread sample."""
    subscription: Literal["flush", "new", "periodic"] | Subscription
    """The moment at which the out-port sends: before a write returns (flush), soon after it, so that the writer never
    waits (new), or at push_rate (periodic)."""
    push: Literal["all", "fifo", "skip", "new"] | Push
    """The samples of a backlog that are sent, with new and periodic: all, one at a time (fifo), every (skip + 1)-th or
    the newest (new)."""
    push_rate: float | None
    """The rate of a periodic connector. Unit: Hz."""
    skip: int
    """The number of samples left out between two that are sent, with push skip."""
    length: int
    """The number of samples that the reader's buffer holds; with 0 a write waits until the reader has taken the
    sample."""
    out_length: int
    """The number of samples that the backlog of a periodic connector holds."""
    full: Literal["overwrite", "reject", "block"] | FullPolicy
    """The effect of a write when the reader's buffer is full: it overwrites the oldest sample, is rejected, or
    blocks."""
    empty: Literal["readback", "do_nothing", "block"] | EmptyPolicy
    """The effect of a read when there is nothing to read, in generic components; OpenRTM's, kept for its tools."""
    timeout: float | None
    """The longest that an awaited write waits with full block; None waits forever. Unit: s."""
    stamp: Literal["send", "received", "read"] | Stamp
    """The moment at which the connector sets `tm` to the kernel's clock; by default `tm` is what the writer said."""
    convert: Converter | str | None
    """The converter of samples of the out-port into those of the in-port: a plain function, FILE.py:function,
    package.module:function, or a converter's name and its text, such as map 0>1000>0."""
    measure: int
    """The number of the last sends (`Connector.timing`) and reads (`latency`, `age` of the statistics) that are timed;
    0 times nothing and costs nothing."""
    keep_last: bool
    """Whether a new connector is offered the sample that the writer wrote last, also before it was made."""
    lifespan: float | None
    """The longest that a sample waits to be read before it is dropped as expired. Of a link both ends count what a
    sample waits there, without the time on the way: the clocks of two kernels are not compared. Unit: s."""
    max_gap: float | None
    """The longest time between two writes; after it the writer counts as silent while both ends are active, which is an
    event and a line in the log. Unit: s."""
    on_link_lost: Literal["wait", "error", "disconnect"] | OnLinkLost
    """The reaction to a lost link to the other kernel: the connector waits (the default of a link), moves the component
    to error, or ends. None where both ends are in one kernel."""
    fan_in: int
    """The most connectors that the in-port takes."""
    fan_out: int
    """The most connectors that the out-port takes."""
    connection_limit: int
    """The most connectors that each port takes; -1 is any number."""
    allow_duplicate: bool
    """Whether there may be a second connector between the same two ports."""
    adapt: bool | Literal["text"]
    """Whether a FlexiFilter is inserted between ports that do not fit; with "text" also one that makes numbers of
    texts."""
    mapping: Mapping[str, str]
    """The provided interfaces that answer required ones, by path or name. Of service ports."""
    strict: bool
    """Whether every required interface has to find a provider; false leaves unbound what none answers. Of service
    ports."""
    openrtm: Mapping[str, object]
    """OpenRTM's keys, such as {"dataport.subscription_type": "new"}."""
