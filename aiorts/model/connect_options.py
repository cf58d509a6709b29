"""The keywords of `Kernel.connect` with their types, for editors and type checkers; `options.py` checks what comes."""

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

    dataflow: Literal["push", "pull"] | Dataflow
    """"push", the default, or "pull": the reader asks, the writer's latest unread sample is taken."""
    subscription: Literal["flush", "new", "periodic"] | Subscription
    """When the out-port sends: before a write returns, soon after it (the writer never waits), or at `push_rate`."""
    push: Literal["all", "fifo", "skip", "new"] | Push
    """Which samples of the backlog are sent, with "new" and "periodic"."""
    push_rate: float
    """Hz, with "periodic"."""
    skip: int
    """n: send every (n + 1)-th sample, with push "skip"."""
    length: int
    """Samples that the reader's buffer holds, to 1,000,000; 0: a write waits until the reader has taken the sample."""
    out_length: int
    """Samples that the backlog of a periodic connector holds, 1 to 1,000,000."""
    full: Literal["overwrite", "reject", "block"] | FullPolicy
    """What a write does where the reader's buffer is full: by default it overwrites the oldest."""
    empty: Literal["readback", "do_nothing", "block"] | EmptyPolicy
    """What a generic component does where there is nothing to read; OpenRTM's, kept for its tools."""
    timeout: float | None
    """Seconds that an awaited write waits with full "block"; None is forever."""
    stamp: Literal["send", "received", "read"] | Stamp
    """When `tm` is set to the kernel's clock."""
    convert: Converter | str | None
    """What makes a sample of the in-port of one of the out-port: a plain function, or a text that finds one."""
    measure: int
    """n: time the last n sends and the last n reads; 0 times nothing."""
    keep_last: bool
    """Whether the connector begins with the sample that the writer wrote last before."""
    lifespan: float | None
    """Seconds of the kernel's clock after which a sample that was not read is dropped as expired."""
    max_gap: float | None
    """Seconds between two writes at the most; a longer gap is an event and a line in the log."""
    on_link_lost: Literal["wait", "error", "disconnect"] | OnLinkLost
    """Of a port in another kernel: what happens when the link to that kernel is lost; by default it waits."""
    name: str
    """The connector's."""
    fan_in: int
    """Connectors that the in-port takes at the most."""
    fan_out: int
    """Connectors that the out-port takes at the most."""
    connection_limit: int
    """Connectors that each port takes at the most; -1 is any number."""
    allow_duplicate: bool
    """Whether there may be a second connector between the same two ports."""
    adapt: bool | Literal["text"]
    """Whether a FlexiFilter is put between ports that do not fit."""
    mapping: Mapping[str, str]
    """Of service ports: which provided interface answers a required one, by path or name."""
    strict: bool
    """Of service ports: False leaves unbound what no provider answers."""
    openrtm: Mapping[str, object]
    """OpenRTM's keys, such as {"dataport.subscription_type": "new"}."""
