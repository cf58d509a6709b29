"""This file decides which samples a subscription sends; it never sends, waits or keeps time.

It decides when a sample is written (`admits`: flush and new), and when a period is over (`choose`: periodic).
Both are functions of counts alone, so that any transport, thread or simulation applies the same rule.
"""

from __future__ import annotations

from enum import Enum, StrEnum


class Dataflow(StrEnum):
    """The end that begins a transfer."""

    PUSH = "push"
    PULL = "pull"


class Subscription(StrEnum):
    """The moment at which an out-port sends."""

    FLUSH = "flush"
    NEW = "new"
    PERIODIC = "periodic"


class Push(StrEnum):
    """The samples of a backlog that are sent."""

    ALL = "all"
    FIFO = "fifo"
    SKIP = "skip"
    NEW = "new"


class ErrorPolicy(StrEnum):
    """The effect of a member's error on the composite."""

    STOP = "stop"
    """The composite is in error, and the other members are deactivated before the next cycle."""
    REPORT = "report"
    """The composite is in error, and the other members go on."""
    ISOLATE = "isolate"
    """Other members go on, and the composite is in error only when no member is active."""


class Stamp(StrEnum):
    """The moment at which a connector writes its clock into the sample's `tm`."""

    SEND = "send"
    RECEIVED = "received"
    READ = "read"


class OnLinkLost(StrEnum):
    """The reaction of a connector to another kernel when the link to it is lost."""

    WAIT = "wait"
    """The connector goes on when the link is back."""
    ERROR = "error"
    """The component at this end goes to error, too."""
    DISCONNECT = "disconnect"
    """The connector ends."""


class Choice(Enum):
    """The treatment of one sample of a backlog when a period is over."""

    SEND = "send"
    SKIP = "skipped"
    SUPERSEDE = "superseded"


# Looked up once: on CPython 3.11 a member costs eight times as much through its Enum class as through a module.
_SKIP = Push.SKIP


def default_push(subscription: Subscription) -> Push:
    """The push policy in force when none is given."""
    return Push.ALL if subscription is Subscription.FLUSH else Push.NEW


def admits(push: Push, skip: int, number: int) -> bool:
    """Whether the `number`-th sample since the connection (from 1) is sent when it is written; `skip` leaves out n of
    n + 1."""
    return push is not _SKIP or number % (skip + 1) == 0


def choose(push: Push, skip: int, first: int, backlog: int) -> tuple[Choice, ...]:
    """The choices for the oldest samples of a backlog when a period is over.

    `first` is the number since the connection (from 1) of the oldest of the `backlog` samples. The answer has one
    choice for each sample that leaves the backlog, oldest first; the other samples stay.
    """
    if push is Push.ALL:
        return (Choice.SEND,) * backlog
    if push is Push.FIFO:
        return (Choice.SEND,) * min(backlog, 1)
    if push is Push.SKIP:
        return tuple(
            Choice.SEND if admits(push, skip, number) else Choice.SKIP for number in range(first, first + backlog)
        )
    return (Choice.SUPERSEDE,) * (backlog - 1) + (Choice.SEND,) * min(backlog, 1)
