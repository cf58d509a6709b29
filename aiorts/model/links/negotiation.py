"""The way of one end of a link to its channel: a table of states and events, without time, sockets or tasks.

The writer's end offers. The reader's end accepts the offer; if its own kernel made the connector, it first asks the
writer's kernel for an offer. So an end has one of three roles, and each role has a table. A cell has the effect of
an event: the state that follows, and the actions. `-` is ignored, and `!` cannot happen.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, StrEnum
from types import MappingProxyType
from typing import Final, NamedTuple

PAUSES: Final = (0.2, 0.4, 0.8, 1.0)
"""Seconds until an unanswered question is asked again: less than the 2 s in which a link is up once both can talk."""
EXPECT: Final = 1.5
"""Seconds until a promised offer is asked for again: the kernel that promised it may have ended."""
LINGER: Final = 10.0
"""Seconds until a component that was not there is asked for again: the message that it has come may be lost."""


class LinkRole(StrEnum):
    """The part of an end in making the link."""

    OFFERS = "offers"
    """The writer's end."""
    REQUESTS = "requests"
    """The reader's end of a link that its own kernel has connected: it asks for the offer."""
    ANSWERS = "answers"
    """The reader's end of a link that the writer's kernel has connected: it waits for the offer."""


class NegotiationState(StrEnum):
    """The progress of one end's negotiation."""

    ABSENT = "absent"
    """There is no kernel of the other end's name."""
    ASKING = "asking"
    """A question to the other kernel is under way: an offer, or a request for one."""
    OFFERED = "offered"
    """An offer is agreed on, and the channel is being made."""
    WAITING = "waiting"
    """There is a kernel of the other end's name: that is asked when a question is due, or makes its offer."""
    UP = "up"
    """There is a channel."""
    REFUSED = "refused"
    """The link is refused by either kernel: the connector ends."""
    ENDED = "ended"
    """Either end was disconnected."""


class LinkEvent(StrEnum):
    """An event at one end of a link."""

    PRESENT = "present"
    """A kernel of the other end's name has come."""
    GONE = "gone"
    """A kernel of the other end's name has gone."""
    MISSING = "missing"
    """A question cannot be asked: there is no such kernel."""
    COME = "come"
    """The component has come, as its kernel says."""
    WANTED = "wanted"
    """The reader's kernel asks for an offer."""
    DUE = "due"
    """The pause is over."""
    AGREED = "agreed"
    """The offer is accepted by the other kernel."""
    PROMISED = "promised"
    """The requested offer will be made by the other kernel."""
    LACKING = "lacking"
    """The component is not there yet, as its kernel answers."""
    REFUSED = "refused"
    """Either kernel refuses the link for good."""
    UNANSWERED = "unanswered"
    """No answer came, or none that can be read."""
    OFFER = "offer"
    """An offer has come and was accepted."""
    MADE = "made"
    """The channel is made."""
    UNMADE = "unmade"
    """The channel cannot be made."""
    LATE = "late"
    """An answer or a channel has come that belongs to an earlier question."""
    LOST = "lost"
    """The transport says that the channel is down."""
    SILENT = "silent"
    """The channel is up, but no frame has come in answer."""
    LEFT = "left"
    """The news has come that the other end was disconnected."""
    DISCONNECTED = "disconnected"
    """The connector of this end has ended."""


class LinkAction(Enum):
    """An action of the driver; the actions of a cell are carried out in order, after its change of state."""

    DROP = "give the channel up"
    ASK = "ask the other kernel, or say that it is missing"
    ABANDON = "end what the other kernel has connected and never had a channel for"
    REPORT = "log what the link waits for"
    RETRY = "try again after a pause, each time a longer one"
    EXPECT = "ask again where the offer that was promised does not come"
    LINGER = "ask again much later"
    OPEN = "make the channel"
    CONNECT = "use the channel"
    LOSE = "do what the connector says of a lost link"
    REFUSE = "end the connector, with the reason"
    READ_OUT = "end the connector when all that has come is read"
    CLOSE = "close this end"
    DEPART = "tell the other kernel that its end has no other one"
    TELL = "tell the kernel that was late that this end is no more"


class Move(NamedTuple):
    """A cell: the effect of an event in one state."""

    state: NegotiationState | None
    """The state that follows; None: no change."""
    actions: tuple[LinkAction, ...]


_S, _A = NegotiationState, LinkAction
MOVES: Final[Mapping[str, Move]] = MappingProxyType(
    {
        "ask": Move(_S.ASKING, (_A.ASK,)),
        "ask anew": Move(_S.ASKING, (_A.DROP, _A.ASK)),
        "part": Move(_S.ABSENT, (_A.ABANDON,)),
        "miss": Move(_S.ABSENT, (_A.REPORT,)),
        "leave": Move(_S.ABSENT, (_A.DROP, _A.LOSE)),
        "heed": Move(_S.WAITING, ()),
        "pause": Move(_S.WAITING, (_A.RETRY,)),
        "expect": Move(_S.WAITING, (_A.EXPECT,)),
        "linger": Move(_S.WAITING, (_A.REPORT, _A.LINGER)),
        "open": Move(_S.OFFERED, (_A.OPEN,)),
        "open anew": Move(_S.OFFERED, (_A.DROP, _A.OPEN)),
        "connect": Move(_S.UP, (_A.CONNECT,)),
        "lose": Move(_S.WAITING, (_A.RETRY, _A.LOSE)),
        "lose, heed": Move(_S.WAITING, (_A.LOSE,)),
        "drop": Move(_S.WAITING, (_A.DROP, _A.RETRY)),
        "refuse": Move(_S.REFUSED, (_A.REFUSE,)),
        "read out": Move(_S.ENDED, (_A.READ_OUT,)),
        "depart": Move(_S.ENDED, (_A.CLOSE, _A.DEPART)),
        "close": Move(_S.ENDED, (_A.CLOSE,)),
        "tell": Move(None, (_A.TELL,)),
    }
)
"""The words of the tables."""
IGNORED: Final = "-"
IMPOSSIBLE: Final = "!"

_OFFERS: Final = """
             | absent   | asking   | offered  | waiting  | up       | refused | ended
present      | ask      | ask      | ask      | ask      | -        | -       | -
gone         | -        | part     | part     | part     | leave    | -       | -
missing      | !        | miss     | !        | !        | !        | !       | !
come         | -        | ask      | -        | ask      | -        | -       | -
wanted       | ask      | -        | -        | ask      | ask anew | -       | -
due          | !        | !        | !        | ask      | !        | !       | !
agreed       | !        | open     | !        | !        | !        | !       | !
promised     | !        | !        | !        | !        | !        | !       | !
lacking      | !        | linger   | !        | !        | !        | !       | !
refused      | !        | refuse   | !        | !        | !        | !       | !
unanswered   | !        | pause    | !        | !        | !        | !       | !
offer        | !        | !        | !        | !        | !        | !       | !
made         | !        | !        | connect  | !        | !        | !       | !
unmade       | !        | !        | pause    | !        | !        | !       | !
late         | -        | -        | -        | -        | -        | tell    | tell
lost         | !        | !        | !        | !        | lose     | !       | -
silent       | !        | !        | !        | !        | drop     | !       | -
left         | read out | read out | read out | read out | read out | -       | -
disconnected | depart   | depart   | depart   | depart   | close    | depart  | close
"""
_REQUESTS: Final = """
             | absent   | asking   | offered  | waiting  | up        | refused | ended
present      | ask      | ask      | -        | ask      | -         | -       | -
gone         | -        | part     | part     | part     | leave     | -       | -
missing      | !        | miss     | !        | !        | !         | !       | !
come         | -        | ask      | -        | ask      | -         | -       | -
wanted       | !        | !        | !        | !        | !         | !       | !
due          | !        | !        | !        | ask      | !         | !       | !
agreed       | !        | !        | !        | !        | !         | !       | !
promised     | !        | expect   | !        | !        | !         | !       | !
lacking      | !        | linger   | !        | !        | !         | !       | !
refused      | refuse   | refuse   | refuse   | refuse   | refuse    | -       | -
unanswered   | !        | pause    | !        | !        | !         | !       | !
offer        | open     | open     | open     | open     | open anew | !       | !
made         | !        | !        | connect  | !        | !         | !       | !
unmade       | !        | !        | pause    | !        | !         | !       | !
late         | -        | -        | -        | -        | -         | -       | -
lost         | !        | !        | !        | !        | lose      | !       | -
silent       | !        | !        | !        | !        | !         | !       | !
left         | read out | read out | read out | read out | read out  | -       | -
disconnected | depart   | depart   | depart   | depart   | close     | depart  | close
"""
_ANSWERS: Final = """
             | absent   | asking | offered  | waiting  | up         | refused | ended
present      | heed     | !      | -        | -        | -          | !       | -
gone         | -        | !      | part     | part     | leave      | !       | -
missing      | !        | !      | !        | !        | !          | !       | !
come         | -        | !      | -        | -        | -          | !       | -
wanted       | !        | !      | !        | !        | !          | !       | !
due          | !        | !      | !        | open     | !          | !       | !
agreed       | !        | !      | !        | !        | !          | !       | !
promised     | !        | !      | !        | !        | !          | !       | !
lacking      | !        | !      | !        | !        | !          | !       | !
refused      | !        | !      | !        | !        | !          | !       | !
unanswered   | !        | !      | !        | !        | !          | !       | !
offer        | open     | !      | open     | open     | open anew  | !       | !
made         | !        | !      | connect  | !        | !          | !       | !
unmade       | !        | !      | pause    | !        | !          | !       | !
late         | -        | -      | -        | -        | -          | -       | -
lost         | !        | !      | !        | !        | lose, heed | !       | -
silent       | !        | !      | !        | !        | !          | !       | !
left         | read out | !      | read out | read out | read out   | !       | -
disconnected | depart   | !      | depart   | depart   | close      | !       | close
"""


def _rows(text: str) -> dict[tuple[NegotiationState, LinkEvent], str]:
    head, *rows = (line.split("|") for line in text.strip("\n").splitlines())
    states = [NegotiationState(name.strip()) for name in head[1:]]
    return {
        (state, LinkEvent(event.strip())): cell.strip()
        for event, *cells in rows
        for state, cell in zip(states, cells, strict=True)
    }


TABLE: Final[Mapping[LinkRole, Mapping[tuple[NegotiationState, LinkEvent], str]]] = MappingProxyType(
    {role: _rows(text) for role, text in zip(LinkRole, (_OFFERS, _REQUESTS, _ANSWERS), strict=True)}
)
"""The tables by role: each cell is a word of `MOVES`, `IGNORED` or `IMPOSSIBLE`."""


class ImpossibleEvent(Exception):
    """An event cannot happen in this state: the driver of the table has a fault."""


class Negotiation:
    """The state of one end of a link, and the rules by which it changes.

    The driver reports each event (`on`) and carries out the actions. The result of an action counts only while `step`
    is still what it was when the action began.
    """

    state = NegotiationState.ABSENT
    """The progress of the negotiation."""

    def __init__(self, role: LinkRole) -> None:
        self.role = role
        self.step = 0
        """Counts the moves."""
        self.tried = 0
        """The number of failed attempts since the link was up last."""
        self.pause: float | None = None
        """Seconds after which DUE happens, unless another move comes before; None: never."""
        self._heard = (0, 0)

    def on(self, event: LinkEvent) -> tuple[LinkAction, ...]:
        """Take an event, and return the actions that are to be carried out now.

        Raises:
            ImpossibleEvent: the event cannot happen in this state.
        """
        word = TABLE[self.role][self.state, event]
        if word == IMPOSSIBLE:
            raise ImpossibleEvent(f"{event} at an end that {self.role} and is {self.state}")
        if word == IGNORED:
            return ()
        state, actions = MOVES[word]
        if state is not None:
            self.step += 1
            self.state = state
            self.pause = self._pause_of(actions)
            if state is NegotiationState.UP:
                self.tried = 0
        return actions

    def _pause_of(self, actions: tuple[LinkAction, ...]) -> float | None:
        if LinkAction.RETRY in actions:
            self.tried += 1
            return PAUSES[min(self.tried, len(PAUSES)) - 1]
        if LinkAction.EXPECT in actions:
            return EXPECT
        return LINGER if LinkAction.LINGER in actions else None

    @property
    def takes_offers(self) -> bool:
        """Whether an offer may be taken now."""
        return TABLE[self.role][self.state, LinkEvent.OFFER] != IMPOSSIBLE

    @property
    def is_answered(self) -> bool:
        """Whether `connect` has nothing more to wait for."""
        if self.state is NegotiationState.OFFERED:
            return self.role is not LinkRole.OFFERS
        return self.state is not NegotiationState.ASKING and self.pause != EXPECT

    def is_stale(self, epoch: int, number: int) -> bool:
        """Whether a later offer of the same kernel has come; if not, this one is the latest from now on.

        Args:
            number: the number of the offer; 0 is given by a kernel that does not number its offers.
        """
        if epoch == self._heard[0] and 0 < number < self._heard[1]:
            return True
        self._heard = epoch, number
        return False


def mermaid(role: LinkRole) -> str:
    """The diagram of the table of one role, for Mermaid."""
    arrows: dict[tuple[NegotiationState, NegotiationState], list[LinkEvent]] = {}
    for (state, event), word in TABLE[role].items():
        if word in MOVES and (after := MOVES[word].state) is not None:
            arrows.setdefault((state, after), []).append(event)
    lines = [f"    {state} --> {after}: {', '.join(events)}" for (state, after), events in arrows.items()]
    return "\n".join(("stateDiagram-v2", "    [*] --> absent", *lines, ""))
