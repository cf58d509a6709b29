"""Which kernels are there: their tokens come here, `names` decides who is seen, and this shows those."""

from __future__ import annotations

import asyncio
import hashlib
import os
import uuid
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Final

from aiorts.links import KernelFace, Peer
from aiorts_zenoh.engine import Engine, in_thread
from aiorts_zenoh.keys import Keys, claim_of
from aiorts_zenoh.names import Claim, Name, Standing, free_name, seen

_HEARD: Final = 100
"""Kernels that are told of one that claims the same name, at the most."""
_REST: Final = 50e-6
"""Where several machines claim a host name: seconds, for each claim, until all of them are looked at again."""
_TICK: Final = 0.1
"""Seconds between two looks whether a name is owned by now, or free again."""


class Presence:
    """The kernels that are there, and this one among them.

    Args:
        show: called with each kernel that others may see, and when it is to be seen no more.
        connects: whether this kernel is to connect to others: before it has, nobody can say that its name is taken.
        listens: whether others connect to it: those do not see each other, and hear from it who has their names.
        admits: whether a kernel of a name may be there.
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
        admits: Callable[[str], bool],
        renamed: Callable[[Keys], None] | None = None,
    ) -> None:
        self._admits = admits
        self._engine, self._keys, self._kernel, self._show = engine, keys, kernel, show
        self._connects, self._listens = connects, listens
        self._loop = asyncio.get_running_loop()
        self._name, self._first = Name(keys.claim, self._loop.time()), keys.own.kernel
        self._said: dict[str, dict[Claim, set[bool]]] = {}
        """By host name: what is claimed, and of each the tokens that are there: of the claim, of its owner."""
        self._named: dict[tuple[str, str], set[Claim]] = {}
        self._machines: dict[str, Counter[int]] = {}
        """The same by host and kernel, and how many of each machine."""
        self._shown: dict[str, dict[str, Peer]] = {}
        self._gave_way: dict[Claim, set[Claim]] = {}
        """Of each claim that is there: those that this kernel has told of it."""
        self._heard_of: set[Claim] = set()
        """Claims that others have told of, whose tokens this kernel may not see itself."""
        self._due: set[tuple[str, str]] = set()
        self._due_hosts: set[str] = set()
        """Names to look at anew, and host names."""
        self._renamed, self._declared = renamed, keys
        self._end_told: Callable[[], None]
        """Ends the subscription to what others tell this kernel under its name."""
        self._told: tuple[Standing, Keys] | None = None
        self._telling = False
        self._timer: asyncio.TimerHandle | None = None
        self._closed = False

    @property
    def standing(self) -> Standing:
        """How this kernel stands with its name."""
        return self._name.standing

    def declare(self) -> None:
        """Watch who is there, and declare the token that claims the name; in a thread."""
        self._end_told = self._engine.subscribe(self._keys.told(_peer(self._name.own)), self._was_told)
        self._engine.presence(self._keys.tokens, self._came)
        self._engine.announce(self._keys.token)

    def claim(self) -> None:
        """The name is claimed from now on: begin to count the time until it is owned."""
        self._told = Standing.CLAIMS, self._keys
        self._name.unseen(self._loop.time())
        self._changed()

    def forget(self, kernel: str) -> None:
        """A name is not admitted any more: who has it is gone."""
        for host, name in [one for one in self._named if one[1] == kernel]:
            for claim in tuple(self._named[host, name]):
                self._forget(claim)

    def close(self) -> None:
        """Tell nothing any more."""
        self._closed = True
        if self._timer is not None:
            self._timer.cancel()

    # -- others ----------------------------------------------------------------------------------------------------

    def _came(self, token: str, up: bool) -> None:
        found = claim_of(token)
        if self._closed or found is None or found[0] == self._name.own:
            return
        claim, owned = found
        if not self._admits(claim.kernel):
            return
        claims = self._said.setdefault(claim.host, {})
        tokens = claims.setdefault(claim, set())
        is_new = not tokens
        (tokens.add if up else tokens.discard)(owned)
        if up and is_new:
            self._named.setdefault((claim.host, claim.kernel), set()).add(claim)
            self._machines.setdefault(claim.host, Counter())[claim.machine] += 1
        if not tokens:
            self._forget(claim, was_there=not is_new)
        elif up and claim.host == self._name.own.host:
            self._meets(claim, owned=owned, is_new=is_new)
        self._look_at(claim.host, claim.kernel)
        if self._listens:
            self._pass_on(claim, token, up=up)

    def _forget(self, claim: Claim, *, was_there: bool = True) -> None:
        """A claim is there no more: look soon who is to be seen instead."""
        several = self._several(claim.host)
        del self._said[claim.host][claim]
        if was_there:
            self._named[claim.host, claim.kernel].remove(claim)
            if not self._named[claim.host, claim.kernel]:
                del self._named[claim.host, claim.kernel]
            machines = self._machines[claim.host]
            machines -= Counter([claim.machine])  # and what is 0 is no more in it
        self._hide(claim)
        if several:  # and they may be no more
            self._look_at_all(claim.host)
        self._look_at(claim.host, claim.kernel)

    def _pass_on(self, claim: Claim, token: str, *, up: bool) -> None:
        """Tell rivals of each other: of this claim when it comes, and when it goes those that were told of it."""
        to = self._gave_way.setdefault(claim, set())
        if not up:
            self._tell_of(token, up, *to)
            if claim not in self._said.get(claim.host, ()):
                del self._gave_way[claim]
            return
        for other in self._rivals(claim):
            tokens = self._said[claim.host][other]
            self._tell_of(token, up, other)
            self._tell_of(self._keys.token_of(other, owned=True in tokens), up, claim)
            for one, two in ((claim, other), (other, claim)):
                if len(heard := self._gave_way.setdefault(one, set())) < _HEARD:
                    heard.add(two)

    def _rivals(self, claim: Claim) -> list[Claim]:
        """The claims that cannot be seen beside this one; as many as may be told at the most."""
        of_host = self._said[claim.host]
        several = len(self._machines[claim.host]) > 1
        among: Iterable[Claim] = of_host if several else self._named[claim.host, claim.kernel]
        return list(islice((other for other in among if other != claim and claim.meets(other)), _HEARD))

    def _tell_of(self, token: str, up: bool, *to: Claim) -> None:
        for claim in to:
            self._engine.put(self._keys.told(_peer(claim)), f"{'+' if up else '-'}{token}".encode())

    def _was_told(self, _: str, data: bytes) -> None:
        """Another kernel tells of a token. A kernel that owns its name believes only what it sees itself."""
        token, up = data[1:].decode(errors="replace"), data[:1] == b"+"
        found = claim_of(token)
        if found is None or self.standing is Standing.OWNS or not found[0].meets(self._name.own):
            return
        (self._heard_of.add if up else self._heard_of.discard)(found[0])
        self._came(token, up)

    def _meets(self, claim: Claim, *, owned: bool, is_new: bool) -> None:
        before = self._name.standing
        self._name.meets(claim, owned=owned)
        own = self._name.own
        if self._name.standing is not before:
            if self._renamed is None or own.machine != claim.machine:
                self._kernel.report(_given_way(own, claim))
            else:
                self._take_another()
            self._changed()
        elif self._name.is_shown and is_new and claim.machine != own.machine:
            self._kernel.report(f"zenoh: {_other_machine(claim)}; it is refused. {_ADVICE}")
        elif self._name.is_shown and is_new and claim.meets(own):
            self._kernel.report(
                f"zenoh: another kernel named {own.kernel!r} was started on {own.host}; it does not get the name"
            )

    def _hide(self, claim: Claim) -> None:
        """Show a claim no more, at once: what comes next may be the same kernel with a new connection."""
        if self._shown.get(claim.host, {}).get(claim.kernel) == _peer(claim):
            self._set(claim.host, {claim.kernel: None})

    def _several(self, host: str) -> bool:
        """Whether several machines claim a host name."""
        machines = set(self._machines.get(host, ()))
        return len(machines | {self._name.own.machine} if host == self._name.own.host else machines) > 1

    def _look_at(self, host: str, kernel: str) -> None:
        """Look soon who has this name; where several machines have the host name, at all of it."""
        if self._several(host):
            self._look_at_all(host)
        else:
            if not self._due:
                self._loop.call_soon(self._look)
            self._due.add((host, kernel))

    def _look_at_all(self, host: str) -> None:
        if host not in self._due_hosts:
            self._due_hosts.add(host)
            self._loop.call_later(len(self._said.get(host, ())) * _REST, self._look_at_host, host)

    def _look(self) -> None:
        """Show who is to be seen now; once for all that has come at the same time."""
        due, self._due = self._due, set()
        for host, kernel in due:
            if not self._several(host):
                found = seen(self._claims(host, self._named.get((host, kernel), ())))
                self._set(host, {kernel: found.get(kernel)})

    def _look_at_host(self, host: str) -> None:
        self._due_hosts.discard(host)
        found = seen(self._claims(host, self._said.get(host, ())))
        self._set(host, {kernel: found.get(kernel) for kernel in {*self._shown.get(host, ()), *found}})

    def _claims(self, host: str, among: Iterable[Claim]) -> dict[Claim, bool]:
        """These, and whether they own their names; of its own host this kernel's, too."""
        claims = {claim: True in self._said[host][claim] for claim in among}
        own = self._name.own
        return claims if host != own.host else {**claims, own: self._name.standing is Standing.OWNS}

    def _set(self, host: str, kernels: Mapping[str, Claim | None]) -> None:
        """Of these names of a host, these are to be seen."""
        if self._closed:
            return
        shown, own = self._shown.setdefault(host, {}), self._name.own
        for kernel, claim in kernels.items():
            now = None if claim in (None, own) or not self._name.is_shown else claim
            before, peer = shown.get(kernel), None if now is None else _peer(now)
            if peer == before:
                continue
            if before is not None:
                del shown[kernel]
                self._show(before, False)
            if peer is not None:
                shown[kernel] = peer
                self._show(peer, True)
        if not shown:
            del self._shown[host]
        if not self._said.get(host, True):
            del self._said[host]
            self._machines.pop(host, None)

    # -- this kernel -----------------------------------------------------------------------------------------------

    def _take_another(self) -> None:
        """Claim the next name that is free, for as long as this kernel runs."""
        own, first = self._name.own, self._first
        name = free_name(first, (claim.kernel for claim in self._said.get(own.host, ())))
        self._keys = Keys(self._keys.domain, Peer(own.host, name, own.epoch), own.start_ns, own.machine)
        self._name = Name(self._keys.claim, self._loop.time())
        self._kernel.report(
            f"zenoh: a kernel named {own.kernel!r} runs already on {own.host}; this one is {name!r} for other hosts"
        )

    def _changed(self) -> None:
        """This kernel stands otherwise with its name: show and tell what follows from it."""
        for host in {*self._said, *self._shown}:
            self._look_at_host(host)
        if not self._telling:
            self._telling = True
            self._kernel.run_in_background(self._tell(), "aiorts zenoh name")
        if self._timer is None and self.standing in (Standing.CLAIMS, Standing.WITHDRAWN):
            self._timer = self._loop.call_later(_TICK, self._tick)

    async def _tell(self) -> None:
        """Declare the tokens that belong to how it stands, one change after the other."""
        try:
            while self._told != (self.standing, self._keys) and not self._closed:
                standing, keys = self._told = self.standing, self._keys
                if keys is not self._declared:
                    await in_thread(partial(self._declare_as, keys))
                tokens = {Standing.CLAIMS: [keys.token], Standing.OWNS: [keys.token, keys.owned]}
                await in_thread(partial(self._engine.announce, *tokens.get(standing, ())))
        finally:
            self._telling = False

    def _declare_as(self, keys: Keys) -> None:
        """Declare under another name all that others may ask, before its token is there; in a thread."""
        self._engine.announce()
        self._end_told()
        self._end_told = self._engine.subscribe(keys.told(keys.own), self._was_told)
        if self._renamed is not None:
            self._renamed(keys)
        self._declared = keys
        self._loop.call_soon_threadsafe(lambda: self._name.unseen(self._loop.time()))

    def _tick(self) -> None:
        self._timer, before, now = None, self.standing, self._loop.time()
        others = self._said.get(self._name.own.host, {})
        if self._connects and not self._engine.is_heard:
            if before is Standing.CLAIMS:
                self._name.unseen(now)
            for claim in self._heard_of & others.keys():  # who told of them is gone
                self._forget(claim)
            self._heard_of.clear()
        self._name.passed(others, now)
        if self.standing is not before:
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
    """A number that no other machine has, made of what identifies its network namespace and its last boot.

    What is in files would not do: an image of a machine is copied with them.
    """
    try:
        booted = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        network = os.stat("/proc/self/ns/net").st_ino
    except OSError:  # no Linux
        booted, network = "", uuid.getnode()
    return int.from_bytes(hashlib.sha256(f"aiorts {booted} {network}".encode()).digest()[:8], "big")
