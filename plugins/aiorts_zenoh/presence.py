"""The kernels that are there: their tokens come here, `names` decides which are seen, and `Presence` shows them."""

from __future__ import annotations

import asyncio
import hashlib
import os
import time
import uuid
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Final, Protocol

from aiorts.links import KernelFace, Peer
from aiorts_zenoh.claims import LOOKED_AT, Claims, Told
from aiorts_zenoh.engine import Engine, in_thread
from aiorts_zenoh.keys import Keys, claim_of, teller_in
from aiorts_zenoh.limits import OF_KERNEL
from aiorts_zenoh.names import Claim, Name, Standing, free_name

_TURN: Final = 0.0005
"""Seconds of the loop for each of: tokens that have come, kernels to tell of tokens, names to look at."""
_PAUSE: Final = 0.006
"""Seconds until the next turn: the claims of others take at most a fifth of the loop's time."""
_REST: Final = 50e-6
"""Seconds for each claim until all claims of a host name that several machines claim are looked at again."""
_TICK: Final = 0.1
"""Seconds between two looks whether a name is owned by now, or free again."""
_AGAIN: Final = 1.0
"""Seconds until tokens that the engine did not take are declared again."""
_SAID: Final = 100
"""The most lines in the log about rival claims, until the standing of this kernel changes."""


class Trust(Protocol):
    """The rules of which kernels may be there, and which may tell of others."""

    @property
    def is_bound(self) -> bool:
        """Whether a kernel's name is that of its certificate."""
        ...

    def admits(self, name: str) -> bool:
        """Whether a kernel of this name may be there."""
        ...

    def heeds(self, name: str) -> bool:
        """Whether a kernel of this name may tell of tokens which this one does not see itself."""
        ...


class AnyName:
    """The rules without certificates: all kernels may be there, and may tell of others."""

    is_bound = False

    def admits(self, name: str) -> bool:
        return True

    def heeds(self, name: str) -> bool:
        return True


class Presence:
    """The kernels that are there, and this one among them.

    Each claim of another kernel costs the same, and all claims together a bounded part of the loop's time, however many
    there are.

    Args:
        show: called with each kernel that others may see, and when it is to be seen no more.
        connects: whether this kernel is to connect to others: before it has, no other can say that its name is taken.
        listens: whether others connect to it: those do not see each other, and it tells each of rivals for its name.
        trust: which kernels may be there, and which may tell of others.
        renamed: called in a thread with the keys of another name that this kernel takes where its own is taken, to
            declare all that is asked there; None: it takes none, and is not seen until its own is free.
    """

    def __init__(
        self,
        engine: Engine,
        keys: Keys,
        kernel: KernelFace,
        show: Callable[[Peer, bool], None],
        *,
        connects: bool,
        listens: bool,
        trust: Trust,
        renamed: Callable[[Keys], None] | None = None,
    ) -> None:
        self._trust = trust
        self._engine, self._keys, self._kernel, self._show = engine, keys, kernel, show
        self._connects, self._listens = connects, listens
        self._loop = asyncio.get_running_loop()
        self._name, self._first = Name(keys.claim, self._loop.time()), keys.own.kernel
        self._claims = Claims(bound=trust.is_bound)
        """The claims of others, and that of this kernel while it is to be seen."""
        self._shown: dict[str, dict[str, Peer]] = {}
        """The kernels that are shown, by the scope of their claims and by their name."""
        self._told_others = Told()
        self._to_tell: deque[tuple[Claim, str]] = deque()
        """The kernels that were told of a token that is gone, and that token."""
        self._heard_of: set[Claim] = set()
        """Claims that others have told of, whose tokens this kernel may not see itself."""
        self._came_last: OrderedDict[tuple[Claim, bool], tuple[bool, ...]] = OrderedDict()
        """Tokens to look at, and whether each came or went: the last change, and the one before."""
        self._due: OrderedDict[tuple[str, str], None] = OrderedDict()
        self._due_scopes: set[str] = set()
        """Names to look at again, and whole scopes."""
        self._seen: dict[str, Mapping[str, Claim]] = {}
        """The claims that were seen in each scope of several machines when the whole scope was last looked at."""
        self._works: asyncio.Handle | None = None
        self._said: set[str] = set()
        self._renamed, self._declared = renamed, keys
        self._end_told: Callable[[], None]
        """Ends the subscription to what others tell this kernel under its name."""
        self._told: tuple[Standing, Keys] | None = None
        self._telling = False
        self._timer: asyncio.TimerHandle | None = None
        self._closed = False

    @property
    def standing(self) -> Standing:
        """The standing of this kernel with its name."""
        return self._name.standing

    def declare(self) -> None:
        """Watch the tokens of others, and declare the token that claims the name; in a thread."""
        self._end_told = self._engine.subscribe(self._keys.heard, self._was_told)
        self._engine.presence(self._keys.tokens, self._came)
        self._engine.announce(self._keys.token)

    def claim(self) -> None:
        """Begin to count the time until the name is owned: it is claimed from now on."""
        self._told = Standing.CLAIMS, self._keys
        self._name.unseen(self._loop.time())
        self._changed()

    def forget(self, kernel: str) -> None:
        """Take all kernels of a name as gone: it is not admitted any more."""
        for claim in self._claims.of_kernel(kernel):
            if claim != self._name.own:
                self._gone(claim)

    def close(self) -> None:
        """Stop telling others of tokens."""
        self._closed = True
        for handle in (self._timer, self._works):
            if handle is not None:
                handle.cancel()

    # -- tokens ----------------------------------------------------------------------------------------------------

    def _came(self, token: str, up: bool) -> None:
        found = claim_of(token)
        if self._closed or found is None or found[0] == self._name.own:
            return
        claim, owned = found
        before = self._came_last.get(found, ())
        if before == (True,) and not up and not self._is_of_note(claim, owned=owned):
            del self._came_last[found]  # the token went before it was looked at
        elif before[-1:] != (up,):
            self._came_last[found] = (*before, up)[-2:]
            self._work_soon()

    def _is_of_note(self, claim: Claim, *, owned: bool) -> bool:
        """Whether a token that is gone mattered: it was seen, or is a rival that this kernel has to give way to."""
        return self._claims.has(claim, owned=owned) or (
            len(self._came_last) < OF_KERNEL and self._claims.meets(claim, self._name.own)
        )

    def _work_soon(self) -> None:
        if self._works is None and not self._closed:
            self._works = self._loop.call_soon(self._work)

    def _work(self) -> None:
        try:
            self._work_off()
        finally:  # whatever a listener of kernels raises
            left = (self._came_last or self._to_tell or self._due) and not self._closed
            self._works = self._loop.call_later(_PAUSE, self._work) if left else None

    def _work_off(self) -> None:
        """Look at tokens that have come, tell of those that are gone, and look at names, each for a bounded time."""
        until = time.perf_counter() + _TURN
        while self._came_last and time.perf_counter() < until:
            (claim, owned), changes = self._came_last.popitem(last=False)
            for up in changes:
                if not up or self._trust.admits(claim.kernel):
                    self._put(claim, owned=owned, up=up)
        until = time.perf_counter() + _TURN
        while self._to_tell and time.perf_counter() < until:
            other, token = self._to_tell.popleft()
            self._tell_of_first(other)  # first: else it would claim its name again
            self._send("-", token, other)
        self._show_due()

    def _show_due(self) -> None:
        until = time.perf_counter() + _TURN
        while self._due and time.perf_counter() < until and not self._closed:
            scope, kernel = self._due.popitem(last=False)[0]
            if not self._claims.is_shared(scope):
                self._set(scope, kernel, self._claims.first(scope, kernel))
            elif scope in self._seen:
                claim = self._seen[scope].get(kernel)
                self._set(scope, kernel, claim if claim is not None and claim in self._claims else None)

    def _put(self, claim: Claim, *, owned: bool, up: bool) -> None:
        """Take a token of another kernel as there (`up`) or as gone."""
        if self._claims.has(claim, owned=owned) is up:
            return
        is_new, scope = claim not in self._claims, self._claims.scope_of(claim)
        was_shared = self._claims.is_shared(scope)
        self._claims.put(claim, owned=owned, up=up)
        if claim not in self._claims:
            self._ended(claim, scope, was_shared=was_shared)
        elif up:
            if scope == self._claims.scope_of(self._name.own):
                # A kernel that connects late gets both tokens of an owner one after the other.
                owns = self._claims.has(claim, owned=True) or self._came_last.get((claim, True), ())[-1:] == (True,)
                self._meets(claim, owned=owns, is_new=is_new)
            if self._listens:
                self._tell_rivals(claim)
        self._look_at(scope, claim.kernel)

    def _gone(self, claim: Claim) -> None:
        """Remove a claim, whatever its tokens say."""
        scope = self._claims.scope_of(claim)
        was_shared = self._claims.is_shared(scope)
        self._claims.remove(claim)
        self._ended(claim, scope, was_shared=was_shared)
        self._look_at(scope, claim.kernel)

    def _ended(self, claim: Claim, scope: str, *, was_shared: bool) -> None:
        # The kernel is hidden at once: the next token may be of the same kernel with a new connection.
        if self._shown.get(scope, {}).get(claim.kernel) == _peer(claim):
            self._set(scope, claim.kernel, None)
        if was_shared:  # and may not be shared any more
            self._look_at_all(scope)
        self._to_tell.extend(self._told_others.ended(claim))

    # -- telling rivals of each other ------------------------------------------------------------------------------

    def _tell_rivals(self, claim: Claim) -> None:
        """Tell a kernel whose claim gives way, this one's or a rival's, of the claim that goes first; one at a time."""
        is_shared = self._claims.is_shared(self._claims.scope_of(claim))
        for other in self._claims.rivals(claim):
            if other == self._name.own:  # all that connect here see its tokens themselves
                continue
            for one, two in ((claim, other), (other, claim)):
                if one not in self._told_others and self._claims.gives_way(one, two):
                    self._tell_of(one, two)
            if not is_shared:
                return  # the other rivals were told of that one

    def _tell_of_first(self, claim: Claim) -> None:
        """Tell a claim's kernel of the first claim that it has to give way to."""
        rivals = (other for other in self._claims.rivals(claim) if other != self._name.own)
        found = next((other for other in rivals if self._claims.gives_way(claim, other)), None)
        if found is not None:
            self._tell_of(claim, found)

    def _tell_of(self, claim: Claim, of: Claim) -> None:
        token = self._keys.token_of(of, owned=self._claims.has(of, owned=True))
        self._told_others.note(claim, of, token)
        self._send("+", token, claim)

    def _send(self, what: str, token: str, to: Claim) -> None:
        self._engine.put(self._keys.told(_peer(to)), f"{what}{token}".encode())

    def _was_told(self, key: str, data: bytes) -> None:
        """Handle a token that another kernel tells of. An owner of its name believes only tokens that it sees."""
        if self._closed or not self._trust.heeds(teller_in(key)):
            return
        token, up = data[1:].decode(errors="replace"), data[:1] == b"+"
        found = claim_of(token)
        if found is None or self.standing is Standing.OWNS or not self._claims.meets(found[0], self._name.own):
            return
        if up and len(self._heard_of) >= LOOKED_AT:
            return
        (self._heard_of.add if up else self._heard_of.discard)(found[0])
        self._came(token, up)

    # -- showing kernels --------------------------------------------------------------------------------------------

    def _meets(self, claim: Claim, *, owned: bool, is_new: bool) -> None:
        before = self._name.standing
        self._name.meets(claim, owned=owned)
        own = self._name.own
        if self._name.standing is not before:
            if self._renamed is None or own.machine != claim.machine:
                self._say(_given_way(own, claim))
            else:
                self._take_another()
            self._changed()
        elif self._name.is_shown and is_new and claim.machine != own.machine:
            self._say(f"zenoh: {_other_machine(claim)}; it is refused. {_ADVICE}")
        elif self._name.is_shown and is_new and claim.meets(own):
            self._say(f"zenoh: another kernel named {own.kernel!r} was started on {own.host}; it does not get the name")

    def _say(self, text: str) -> None:
        """Log a text, once until the standing of this kernel changes: others may claim as often as they like."""
        if text not in self._said and len(self._said) < _SAID:
            self._said.add(text)
            self._kernel.report(text)

    def _look_at(self, scope: str, kernel: str) -> None:
        """Look soon which kernel has this name; in a scope that several machines claim, look at all names."""
        if self._claims.is_shared(scope):
            self._look_at_all(scope)
        else:
            self._due[scope, kernel] = None
            self._work_soon()

    def _look_at_all(self, scope: str) -> None:
        if scope not in self._due_scopes:
            self._due_scopes.add(scope)
            self._loop.call_later(self._claims.count(scope) * _REST, self._look_at_scope, scope)

    def _look_at_scope(self, scope: str) -> None:
        self._due_scopes.discard(scope)
        found = self._claims.seen(scope)
        if self._claims.is_shared(scope):
            self._seen[scope] = found
        else:
            self._seen.pop(scope, None)
        self._due.update(dict.fromkeys((scope, kernel) for kernel in {*self._shown.get(scope, ()), *found}))
        self._work_soon()

    def _set(self, scope: str, kernel: str, claim: Claim | None) -> None:
        """Show this claim, and no other of the same name."""
        if self._closed:
            return
        shown, own = self._shown.get(scope, {}), self._name.own
        peer = None if claim in (None, own) or not self._name.is_shown else _peer(claim)
        if peer == (before := shown.get(kernel)):
            return
        if before is not None:
            del shown[kernel]
            if not shown:
                del self._shown[scope]
            self._show(before, False)
        if peer is not None:
            self._shown.setdefault(scope, {})[kernel] = peer
            self._show(peer, True)

    # -- this kernel -----------------------------------------------------------------------------------------------

    def _take_another(self) -> None:
        """Claim the next name that is free, for as long as this kernel runs."""
        own, first = self._name.own, self._first
        name = free_name(first, self._claims.kernels(own.host))
        self._claims.remove(own)
        self._keys = Keys(self._keys.domain, Peer(own.host, name, own.epoch), own.start_ns, own.machine)
        self._name = Name(self._keys.claim, self._loop.time())
        self._kernel.report(
            f"zenoh: a kernel named {own.kernel!r} runs already on {own.host}; this one is {name!r} for other hosts"
        )

    def _changed(self) -> None:
        """Show and tell what follows from the changed standing of this kernel."""
        own = self._name.own
        self._claims.put(own, owned=False, up=self._name.is_shown)
        self._claims.put(own, owned=True, up=self.standing is Standing.OWNS)
        for scope in {*self._claims.scopes, *self._shown}:
            self._look_at_scope(scope)
        self._show_due()  # as many as there is time for: few kernels are hidden at once where they have to be
        self._tell_soon()
        if self._timer is None and self.standing in (Standing.CLAIMS, Standing.WITHDRAWN):
            self._timer = self._loop.call_later(_TICK, self._tick)

    def _tell_soon(self) -> None:
        if not (self._telling or self._closed):
            self._telling = True
            self._kernel.run_in_background(self._tell(), "aiorts zenoh name")

    async def _tell(self) -> None:
        """Declare the tokens of the present standing, one change after the other; a failed one is tried again."""
        try:
            while self._told != (now := (self.standing, self._keys)) and not self._closed:
                standing, keys = now
                if keys is not self._declared:
                    await in_thread(partial(self._declare_as, keys))
                tokens = {Standing.CLAIMS: [keys.token], Standing.OWNS: [keys.token, keys.owned]}
                await in_thread(partial(self._engine.announce, *tokens.get(standing, ())))
                self._told = now
        except Exception:
            self._loop.call_later(_AGAIN, self._tell_soon)
            raise
        finally:
            self._telling = False

    def _declare_as(self, keys: Keys) -> None:
        """Declare all that others may ask under another name, before its token is there; in a thread."""
        self._engine.announce()
        self._end_told()
        self._end_told = self._engine.subscribe(keys.heard, self._was_told)
        if self._renamed is not None:
            self._renamed(keys)
        self._declared = keys
        self._loop.call_soon_threadsafe(lambda: self._name.unseen(self._loop.time()))

    def _tick(self) -> None:
        self._timer, before, now = None, self.standing, self._loop.time()
        if self._connects and not self._engine.is_heard:
            if before is Standing.CLAIMS:
                self._name.unseen(now)
            for claim in self._heard_of:  # the kernel that told of them is gone
                self._gone(claim)
            self._heard_of.clear()
        self._name.passed(self._claims.rivals(self._name.own), now)
        if self.standing is not before:
            self._said.clear()
            if before is Standing.WITHDRAWN:
                self._kernel.report(f"zenoh: the name {self._name.own.kernel!r} is free again; this kernel takes it")
            self._changed()
        elif self.standing in (Standing.CLAIMS, Standing.WITHDRAWN):
            self._timer = self._loop.call_later(_TICK, self._tick)


_ADVICE: Final = "Give each machine a name of its own: --host, or `host` of [zenoh]"


def _other_machine(claim: Claim) -> str:
    return f"another machine calls itself {claim.host!r} as well, with a kernel {claim.kernel!r}"


def _given_way(own: Claim, other: Claim) -> str:
    if own.machine != other.machine:
        return f"zenoh: {_other_machine(other)}; this kernel is not seen from other hosts. {_ADVICE}"
    return (
        f"zenoh: a kernel named {own.kernel!r} runs already on {own.host}; this one is not seen from other hosts until "
        f"that one ends. Give this one another name"
    )


def _peer(claim: Claim) -> Peer:
    return Peer(claim.host, claim.kernel, claim.epoch)


def this_machine() -> int:
    """A number that no other machine has, made from the identities of its network namespace and its last boot.

    Contents of files would not do: an image of a machine is copied with them.
    """
    try:
        booted = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        network = os.stat("/proc/self/ns/net").st_ino
    except OSError:  # no Linux
        booted, network = "", uuid.getnode()
    return int.from_bytes(hashlib.sha256(f"aiorts {booted} {network}".encode()).digest()[:8], "big")
