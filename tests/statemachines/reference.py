"""A slow interpreter, written after the words of SCXML's appendix D with sets of states, to hold ours against.

It reads the table as it was written (`State`, `On`, ...), shares nothing with `aiorts.model` but those declarations,
and keeps no plan: everything is found anew for every event.
"""

from __future__ import annotations

from collections import deque
from typing import Any

from aiorts.statechart import After, Always, History, In, On, Parallel, State


class Ref:
    """One state of the tree."""

    def __init__(self, part: Any, parent: Ref | None, order: list[Ref]) -> None:
        self.part, self.parent = part, parent
        self.name = part.name
        self.order = len(order)
        order.append(self)
        self.history = isinstance(part, History)
        parts = () if self.history else part.parts
        self.all_children = [Ref(p, self, order) for p in parts if isinstance(p, State | History)]
        self.children = [c for c in self.all_children if not c.history]
        self.ways = [p for p in parts if isinstance(p, On | After | Always)]
        self.final = not self.history and part.kind == "final"
        self.parallel = isinstance(part, Parallel)
        self.compound = bool(self.children) and not self.parallel

    def ancestors(self, upto: Ref | None = None) -> list[Ref]:
        found, state = [], self.parent
        while state is not None and state is not upto:
            found.append(state)
            state = state.parent
        return found

    def inside(self, other: Ref) -> bool:
        return other in self.ancestors()


class Reference:
    def __init__(self, *states: Any, guards: dict[str, bool] | None = None) -> None:
        self.order: list[Ref] = []
        self.root = Ref(State("root", *states), None, self.order)
        self.by_name = {ref.name: ref for ref in self.order}
        self.guards = {} if guards is None else guards
        self.configuration: set[Ref] = set()
        self.history: dict[Ref, set[Ref]] = {}
        self.internal: deque[str] = deque()
        self.deferred: list[str] = []
        self.log: list[tuple[str, str]] = []
        self.running = True
        self.endless = False
        self.timers: dict[str, tuple[int, int]] = {}
        self.now = 0
        self.made = 0

    # -- the algorithm -------------------------------------------------------------------------------------------------

    def start(self) -> None:
        self._enter([(None, self.root)])
        self._settle()

    def handle(self, event: str, own: bool = False) -> None:
        if not self.running:
            return
        self._recall()
        self._handle(event, own)
        self._recall()

    def _handle(self, event: str, own: bool) -> None:
        taken = self._select(event, own)
        if taken:
            self._microstep(taken)
        elif not own and self._kept_by_any(event):
            self.deferred.append(event)
        self._settle()

    def _kept_by_any(self, event: str) -> bool:
        return any(self._keeps(state, event) for state in self.configuration)

    def _keeps(self, state: Ref, event: str) -> bool:
        return not state.history and any(f"{event}.".startswith(f"{name}.") for name in state.part.defer)

    def _recall(self) -> None:
        while self.running:
            free = [event for event in self.deferred if not self._kept_by_any(event) or self._select(event, False)]
            if not free:
                return
            self.deferred.remove(free[0])
            self._handle(free[0], False)

    def cycle(self) -> None:
        self._settle()
        self._recall()

    def pass_time(self, until: int) -> None:
        while self.running and self.timers:
            when, _, name = min((when, made, name) for name, (when, made) in self.timers.items())
            if when > until:
                break
            self.now = when
            del self.timers[name]
            self.handle(name, own=True)
        self.now = until

    def _settle(self) -> None:
        for _ in range(1000):
            if not self.running:
                return
            taken = self._select(None, False)
            if not taken:
                if not self.internal:
                    return
                taken = self._select(self.internal.popleft(), True)
            if taken:
                self._microstep(taken)
        self.endless = True
        self.running = False

    def _select(self, event: str | None, own: bool) -> list[tuple[Ref, Any]]:
        enabled: list[tuple[Ref, Any]] = []
        atomic = [s for s in self.order if s in self.configuration and not s.children]
        for state in atomic:
            for source in [state, *state.ancestors()]:
                way = next((w for w in source.ways if self._matches(source, w, event, own)), None)
                if way is not None:
                    if not any(w is way for _, w in enabled):
                        enabled.append((source, way))
                    break
                if event is not None and not own and self._keeps(source, event):
                    break
        kept: list[tuple[Ref, Any]] = []
        for one in enabled:
            preempted, removed = False, []
            for other in kept:
                if self._exit_set(one) & self._exit_set(other):
                    if one[0].inside(other[0]):
                        removed.append(other)
                    else:
                        preempted = True
                        break
            if not preempted:
                kept = [k for k in kept if not any(k is r for r in removed)]
                kept.append(one)
        return kept

    def _matches(self, source: Ref, way: Any, event: str | None, own: bool) -> bool:
        if isinstance(way, Always):
            named = event is None
        elif isinstance(way, After):
            named = event == self._timer(source, way)
        else:
            named = event is not None and (f"{event}.".startswith(f"{way.event}.") or (way.event == "*" and not own))
        guards = way.guard if isinstance(way.guard, tuple) else () if way.guard is None else (way.guard,)
        return named and all(map(self._true, guards))

    def _true(self, guard: Any) -> bool:
        if isinstance(guard, In):
            return (self.by_name[guard.state] in self.configuration) is guard.active
        return self.guards[guard]

    def _timer(self, source: Ref, way: After) -> str:
        afters = [w for w in source.ways if isinstance(w, After)]
        return f"after.{source.name}.{next(n for n, w in enumerate(afters, 1) if w is way)}"

    def _effective(self, target: Ref) -> set[Ref]:
        if not target.history:
            return {target}
        if target in self.history:
            return set(self.history[target])
        return self._default(target)

    def _default(self, history: Ref) -> set[Ref]:
        if history.part.to is not None:
            return {self.by_name[history.part.to]}
        assert history.parent is not None
        return set(history.parent.children) if history.parent.parallel else {self._initial(history.parent)}

    @staticmethod
    def _initial(state: Ref) -> Ref:
        return next((c for c in state.children if c.part.initial), state.children[0])

    def _domain(self, source: Ref, way: Any) -> Ref | None:
        if way.to is None:
            return None
        targets = self._effective(self.by_name[way.to])
        if way.local and (source.compound) and all(t.inside(source) for t in targets):
            return source
        for ancestor in source.ancestors():
            if (ancestor.compound or ancestor is self.root) and all(t.inside(ancestor) for t in targets):
                return ancestor
        raise AssertionError

    def _exit_set(self, taken: tuple[Ref, Any]) -> set[Ref]:
        domain = self._domain(*taken)
        return set() if domain is None else {s for s in self.configuration if s.inside(domain)}

    def _microstep(self, taken: list[tuple[Ref, Any]]) -> None:
        leaving: set[Ref] = set()
        for one in taken:
            leaving |= self._exit_set(one)
        backwards = sorted(leaving, key=lambda s: -s.order)
        for state in backwards:
            for history in (c for c in state.all_children if c.history):
                if history.part.deep:
                    self.history[history] = {s for s in self.configuration if not s.children and s.inside(state)}
                else:
                    self.history[history] = {s for s in self.configuration if s.parent is state}
        for state in backwards:
            self.log.append(("exit", state.name))
            for way in state.ways:
                if isinstance(way, After):
                    self.timers.pop(self._timer(state, way), None)
            self.configuration.discard(state)
        for source, way in taken:
            if way.action is not None:
                self.log.append(("transition", source.name))
        self._enter([(self._domain(source, way), self.by_name[way.to]) for source, way in taken if way.to is not None])

    def _enter(self, targets: list[tuple[Ref | None, Ref]]) -> None:
        entering: set[Ref] = set()
        for domain, target in targets:
            self._add_descendants(target, entering)
            for state in self._effective(target):
                self._add_ancestors(state, domain, entering)
        for state in sorted(entering, key=lambda s: s.order):
            self.configuration.add(state)
            for way in state.ways:
                if isinstance(way, After):
                    self.made += 1
                    self.timers[self._timer(state, way)] = (self.now + round(way.seconds * 1e9), self.made)
            self.log.append(("entry", state.name))
            if state.final:
                assert state.parent is not None
                if state.parent is self.root:
                    self.running = False
                    continue
                self.internal.append(f"done.state.{state.parent.name}")
                above = state.parent.parent
                if above is not None and above.parallel and all(self._in_final(c) for c in above.children):
                    self.internal.append(f"done.state.{above.name}")

    def _in_final(self, state: Ref) -> bool:
        if state.compound:
            return any(c.final and c in self.configuration for c in state.children)
        return state.parallel and all(self._in_final(c) for c in state.children)

    def _add_descendants(self, state: Ref, entering: set[Ref]) -> None:
        if state.history:
            assert state.parent is not None
            remembered = self.history.get(state) or self._default(state)
            for s in remembered:
                self._add_descendants(s, entering)
            for s in remembered:
                self._add_ancestors(s, state.parent, entering)
            return
        entering.add(state)
        if state.compound:
            initial = self._initial(state)
            self._add_descendants(initial, entering)
        elif state.parallel:
            for child in state.children:
                if not any(s is child or s.inside(child) for s in entering):
                    self._add_descendants(child, entering)

    def _add_ancestors(self, state: Ref, domain: Ref | None, entering: set[Ref]) -> None:
        for ancestor in state.ancestors(domain):
            if ancestor is self.root and domain is not None:
                continue
            entering.add(ancestor)
            if ancestor.parallel:
                for child in ancestor.children:
                    if not any(s is child or s.inside(child) for s in entering):
                        self._add_descendants(child, entering)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.order if s in self.configuration and s is not self.root)
