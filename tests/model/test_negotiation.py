"""The table of a link's negotiation: each cell, and two ends that follow it over a way that loses and delays."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from random import Random

import pytest

from aiorts.model.links.negotiation import (
    EXPECT,
    LINGER,
    PAUSES,
    TABLE,
    ImpossibleEvent,
    LinkAction,
    LinkEvent,
    LinkRole,
    Negotiation,
    NegotiationState,
)
from campaign import cases

A, E, S = LinkAction, LinkEvent, NegotiationState
STATES = dict(zip("akowure", (S.ABSENT, S.ASKING, S.OFFERED, S.WAITING, S.UP, S.REFUSED, S.ENDED), strict=True))
AFTER = {
    LinkRole.OFFERS: """
        present kkkk...     gone .aaaa..      missing xaxxxxx     come .k.k...        wanted k..kk..
        due xxxkxxx         agreed xoxxxxx    promised xxxxxxx    lacking xwxxxxx     refused xrxxxxx
        unanswered xwxxxxx  offer xxxxxxx     made xxuxxxx        unmade xxwxxxx      late .....==
        lost xxxxwx.        silent xxxxwx.    left eeeee..        disconnected eeeeeee
    """,
    LinkRole.REQUESTS: """
        present kk.k...     gone .aaaa..      missing xaxxxxx     come .k.k...        wanted xxxxxxx
        due xxxkxxx         agreed xxxxxxx    promised xwxxxxx    lacking xwxxxxx     refused rrrrr..
        unanswered xwxxxxx  offer oooooxx     made xxuxxxx        unmade xxwxxxx      late .......
        lost xxxxwx.        silent xxxxxxx    left eeeee..        disconnected eeeeeee
    """,
    LinkRole.ANSWERS: """
        present wx...x.     gone .xaaax.      missing xxxxxxx     come .x...x.        wanted xxxxxxx
        due xxxoxxx         agreed xxxxxxx    promised xxxxxxx    lacking xxxxxxx     refused xxxxxxx
        unanswered xxxxxxx  offer oxoooxx     made xxuxxxx        unmade xxwxxxx      late .......
        lost xxxxwx.        silent xxxxxxx    left exeeex.        disconnected exeeexe
    """,
}
"""The state that follows each event in each state, in the order of STATES: `.` ignored, `x` impossible, `=` the
same."""
DONE = {
    "present k": (A.ASK,),
    "present w": (),
    "gone a": (A.ABANDON,),
    "gone a up": (A.DROP, A.LOSE),
    "missing a": (A.REPORT,),
    "come k": (A.ASK,),
    "wanted k": (A.ASK,),
    "wanted k up": (A.DROP, A.ASK),
    "due k": (A.ASK,),
    "due o": (A.OPEN,),
    "agreed o": (A.OPEN,),
    "promised w": (A.EXPECT,),
    "lacking w": (A.REPORT, A.LINGER),
    "refused r": (A.REFUSE,),
    "unanswered w": (A.RETRY,),
    "offer o": (A.OPEN,),
    "offer o up": (A.DROP, A.OPEN),
    "made u": (A.CONNECT,),
    "unmade w": (A.RETRY,),
    "late =": (A.TELL,),
    "lost w": (A.RETRY, A.LOSE),
    "lost w answers": (A.LOSE,),
    "silent w": (A.DROP, A.RETRY),
    "left e": (A.READ_OUT,),
    "disconnected e": (A.CLOSE, A.DEPART),
    "disconnected e up": (A.CLOSE,),
    "disconnected e ended": (A.CLOSE,),
}
"""What is carried out, by event and state after it; for some states before it and roles something else."""
CELLS = [
    (role, before, E(event), after)
    for role, text in AFTER.items()
    for event, row in zip(text.split()[::2], text.split()[1::2], strict=True)
    for before, after in zip(STATES.values(), row, strict=True)
]


def in_state(role: LinkRole, state: NegotiationState) -> Negotiation:
    found = Negotiation(role)
    found.state = state
    return found


def test_every_cell_is_expected() -> None:
    assert sorted({(role, before, event) for role, before, event, _ in CELLS}) == sorted(
        (role, state, event) for role in LinkRole for state, event in TABLE[role]
    )
    assert len(CELLS) == len(LinkRole) * len(S) * len(E)


@pytest.mark.parametrize("role", LinkRole)
def test_each_cell_leads_where_it_should(role: LinkRole) -> None:
    for of, before, event, after in CELLS:
        if of is not role:
            continue
        end, where = in_state(role, before), f"{role}: {event} in {before}"
        if after == "x":
            with pytest.raises(ImpossibleEvent, match=f"{event} at an end that {role} and is {before}"):
                end.on(event)
            continue
        actions = end.on(event)
        assert end.state is STATES.get(after, before), where
        short = f"{event} {after}"
        wanted = DONE.get(f"{short} {before}", DONE.get(f"{short} {role}", DONE.get(short)))
        assert actions == (() if after == "." else wanted), where
        assert end.step == (after not in ".="), where


def test_pauses_grow_and_begin_anew_once_it_was_up() -> None:
    end = Negotiation(LinkRole.OFFERS)
    end.on(E.PRESENT)
    pauses = []
    for _ in range(6):
        end.on(E.UNANSWERED)
        pauses.append(end.pause)
        end.on(E.DUE)
    assert pauses == [0.2, 0.4, 0.8, 1.0, 1.0, 1.0]
    assert end.pause is None
    for event in (E.AGREED, E.MADE, E.LOST):
        end.on(event)
    assert end.pause == 0.2
    end.on(E.DUE)
    end.on(E.LACKING)
    assert end.pause == LINGER


def test_no_pause_is_longer_than_the_time_in_which_a_link_is_up() -> None:
    assert max(*PAUSES, EXPECT) < 2.0


def test_whoever_connects_waits_for_the_first_answer_alone() -> None:
    writer, reader = Negotiation(LinkRole.OFFERS), Negotiation(LinkRole.REQUESTS)
    found = [writer.is_answered]
    for event in (E.PRESENT, E.AGREED, E.MADE):
        writer.on(event)
        found.append(writer.is_answered)
    assert found == [True, False, False, True]
    found = []
    for event in (E.PRESENT, E.PROMISED, E.OFFER):
        reader.on(event)
        found.append(reader.is_answered)
    assert found == [False, False, True]


def test_an_offer_that_a_later_one_has_overtaken_is_known() -> None:
    end = Negotiation(LinkRole.ANSWERS)
    assert [end.is_stale(7, number) for number in (3, 5, 4, 5, 6)] == [False, False, True, False, False]
    assert [end.is_stale(8, number) for number in (1, 0, 2)] == [False, False, False]


class End:
    """One end as the table drives it, on a line to another that both are told of."""

    def __init__(self, role: LinkRole, world: World) -> None:
        self.now, self.world = Negotiation(role), world
        self.other: End
        self.line = 0
        """The line that it knows; 0: it knows that there is none."""
        self.number = 0
        """Of the channel that it has, or is making."""

    def on(self, event: LinkEvent) -> None:
        for action in self.now.on(event):
            if action is A.ASK:
                self.ask()
            elif action is A.OPEN:
                self.world.later(self, self.opened(self.now.step, self.line))

    def on_step(self, step: int, event: LinkEvent) -> None:
        if step == self.now.step:
            self.on(event)

    def opened(self, step: int, line: int) -> Callable[[], None]:
        return lambda: self.on_step(step, E.MADE if line == self.line and line else E.UNMADE)

    def ask(self) -> None:
        if not self.line:
            self.on(E.MISSING)
            return
        step, world = self.now.step, self.world
        world.later(self, lambda: self.on_step(step, E.UNANSWERED), at_last=True)
        if self.now.role is LinkRole.OFFERS:
            world.offers += 1
            offer = world.offers
            world.send(self, lambda: self.other.offered(offer, step))
        else:
            world.send(self, lambda: self.other.requested(step))

    def offered(self, offer: int, step: int) -> None:
        if self.now.is_stale(1, offer):
            return
        self.number = offer
        self.on(E.OFFER)
        self.world.send(self, lambda: self.other.agreed(offer, step))

    def agreed(self, offer: int, step: int) -> None:
        if step == self.now.step:
            self.number = offer
            self.on(E.AGREED)
        else:
            self.on(E.LATE)

    def requested(self, step: int) -> None:
        self.on(E.WANTED)
        self.world.send(self, lambda: self.other.on_step(step, E.PROMISED))

    def told(self, line: int) -> None:
        """The transport says that the line has ended, or that there is this one."""
        if self.line and self.now.state is S.UP:
            self.on(E.LOST)
        if self.line:
            self.on(E.GONE)
        self.line = line
        if line:
            self.on(E.PRESENT)


class World:
    """A way between two ends, either of which stands still at times."""

    def __init__(self, random: Random, role: LinkRole) -> None:
        self.random, self.offers = random, 0
        self.line = self.lines = 0
        """The line that there is, 0 for none, and how many there were."""
        self.writer, self.reader = End(LinkRole.OFFERS, self), End(role, self)
        self.writer.other, self.reader.other = self.reader, self.writer
        self.notices: dict[End, deque[int]] = {self.writer: deque(), self.reader: deque()}
        self.under_way: list[tuple[End, int, Callable[[], None]]] = []
        self.due: list[tuple[End, Callable[[], None]]] = []
        self.time_outs: list[tuple[End, Callable[[], None]]] = []

    def send(self, sender: End, what: Callable[[], None]) -> None:
        """Something is under way to the other end, as long as this line is there."""
        if self.line and sender.line == self.line:
            self.under_way.append((sender.other, self.line, what))

    def later(self, end: End, what: Callable[[], None], *, at_last: bool = False) -> None:
        """An end does something soon, or when a question has timed out."""
        (self.time_outs if at_last else self.due).append((end, what))

    def reconnect(self, up: bool) -> None:
        """The line ends, and there may be another; both ends will be told."""
        self.lines += 1
        self.line = self.lines if up else 0
        self.under_way.clear()
        for notices in self.notices.values():
            notices.append(self.line)

    def tell(self, end: End) -> bool:
        """An end hears what there is to hear before all else."""
        if self.notices[end]:
            end.told(self.notices[end].popleft())
            return True
        return False

    def step(self, still: End | None, *, kind: bool = False) -> bool:
        """One thing happens, to no end that stands still; False: nothing is left. `kind`: in order, and all comes."""
        random = self.random
        if any(self.tell(end) for end in self.notices if end is not still):
            return True
        moves: list[Callable[[], object]] = []
        ready = [one for one in self.under_way if one[0] is not still]
        if ready:
            one = ready[0] if kind else random.choice(ready)
            moves.append(lambda: (self.under_way.remove(one), kind or random.random() < 0.8) and self.arrive(one))
        for queue in (self.due, self.time_outs):
            mine = [one for one in queue if one[0] is not still]
            if mine:
                other = mine[0] if kind else random.choice(mine)
                moves.append(lambda queue=queue, other=other: (queue.remove(other), other[1]()))
        pausing = [end for end in self.notices if end is not still and end.now.pause is not None]
        moves += [partial(end.on, E.DUE) for end in pausing]
        if moves:
            (moves[0] if kind else random.choice(moves))()
        return bool(moves)

    def arrive(self, one: tuple[End, int, Callable[[], None]]) -> None:
        if not self.notices[one[0]]:
            if one[0].line == one[1]:
                one[2]()
        else:
            self.under_way.append(one)

    @property
    def backlog(self) -> int:
        """What has waited for an end that stood still."""
        return len(self.under_way) + len(self.due) + len(self.time_outs)

    @property
    def is_up(self) -> bool:
        ends = self.writer, self.reader
        return all(end.now.state is S.UP for end in ends) and ends[0].number == ends[1].number


@pytest.mark.slow(kept_by="first")
@pytest.mark.fault("E06")
@pytest.mark.parametrize("role", [LinkRole.REQUESTS, LinkRole.ANSWERS])
def test_two_ends_are_up_soon_after_both_can_talk(role: LinkRole) -> None:
    for seed in range(cases(20_000)):
        random = Random(f"{role} {seed}")
        world = World(random, role)
        still: End | None = None
        for _ in range(random.randrange(60)):
            if random.random() < 0.1:
                still = random.choice((None, world.writer, world.reader))
            if random.random() < 0.08:
                world.reconnect(random.random() < 0.7)
            world.step(still)
        if not world.line:
            world.reconnect(up=True)
        steps, most = 0, 60 + 4 * world.backlog
        while world.step(None, kind=True):
            steps += 1
            assert steps < most, seed
        assert world.is_up, (seed, world.writer.now.state, world.reader.now.state)
