"""Turns sequences of a profile (StartUp, Activation) into rules for activating components, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from aiorts import StartRule
from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.markup.element import Element
from aiorts_openrtm.markup.shapes import made
from aiorts_openrtm.notes import Note
from aiorts_openrtm.profiles.rts_profile import RtsComponent, RtsTarget

_MOST: Final = 20_000
"""The most conditions of all steps."""
USUAL_TIMEOUT: Final = 10.0
"""The time-out in seconds of a rule that states none."""


def rules_of(
    sequences: Mapping[str, tuple[RtsTarget, ...]], names: Mapping[str, str], notes: list[Note]
) -> dict[str, StartRule]:
    """The rule of each component, by its name here.

    Args:
        names: the name here of each component that can have a rule, by its name in the profile.
    """
    chosen = chosen_sequence(sequences)
    for word, targets in sequences.items():
        if targets and word != chosen:
            what = "stays in the profile; here components stop in the reverse of the order in which they started"
            if word in ("StartUp", "Initializing"):
                what = "stays in the profile; here the order of Activation counts"
            notes.append(Note(targets[0].where, f"{word}: {what}"))
    rules: dict[str, StartRule] = {}
    steps = sorted(sequences.get(chosen, ()), key=lambda one: one.sequence)
    before: list[str] = []
    """Components of the step before the present one."""
    now: list[str] = []
    number: int | None = None
    conditions = 0
    for step in steps:
        if step.sequence != number:
            before, now, number = now or before, [], step.sequence
        name = names.get(step.component)
        if name is None:
            notes.append(Note(step.where, f"{chosen}: {step.component!r:.80} is no component that is activated"))
            continue
        if name in rules:
            notes.append(Note(step.where, f"{chosen}: a second step of {name}; the first one counts"))
            continue
        named = [names[other] for other in step.preceding if other in names]
        if len(named) < len(step.preceding):
            notes.append(Note(step.where, f"{chosen}: a component that {name} waits for is not there"))
        if step.timing == "ASYNC" and named:
            notes.append(Note(step.where, f"{chosen}: ASYNC: {name} waits here until those before it are active"))
        after = dict.fromkeys(other for other in named or before if other != name)
        conditions += len(after)
        if conditions > _MOST:
            what = f"steps that wait for more than {_MOST} components in all"
            raise OpenRTMError(f"{step.where}: {chosen}: {what} have no place in a profile; say Preceding of a few")
        waits = tuple(f"{other} active" for other in after)
        rules[name] = StartRule(name, waits, step.wait, step.timeout or USUAL_TIMEOUT)
        now.append(name)
    return _without_circles(rules, notes, chosen)


def chosen_sequence(sequences: Mapping[str, tuple[RtsTarget, ...]]) -> str:
    """The name of the sequence that orders the activation of components; "" where there is none."""
    return next((word for word in ("Activation", "StartUp") if sequences.get(word)), "")


def _without_circles(rules: dict[str, StartRule], notes: list[Note], word: str) -> dict[str, StartRule]:
    """The rules, without conditions by which components would wait for each other in a circle."""
    done: set[str] = set()
    found: dict[str, StartRule] = {}
    left = dict(rules)
    while left:
        ready = [name for name, rule in left.items() if all(_of(one) not in left for one in rule.after)]
        if not ready:
            name, rule = next(iter(left.items()))
            kept = tuple(one for one in rule.after if _of(one) in done or _of(one) not in rules)
            notes.append(Note(name, f"{word}: it waits for components that wait for it; it does not wait for them"))
            left[name] = StartRule(name, kept, rule.wait, rule.timeout)
            continue
        for name in ready:
            found[name] = left.pop(name)
            done.add(name)
    return {name: found[name] for name in rules}


def _of(condition: str) -> str:
    return condition.partition(" ")[0]


def is_sayable(rule: StartRule) -> bool:
    """Whether a sequence can state the whole rule."""
    waits_for_active = all(condition.state == "active" for condition in rule.conditions)
    in_ms = all(abs(seconds * 1000 - round(seconds * 1000)) < 1e-9 for seconds in (rule.wait, rule.timeout))
    both = bool(rule.after) and rule.wait > 0
    return waits_for_active and in_ms and not both and (bool(rule.after) or rule.timeout == USUAL_TIMEOUT)


def sequence_of(
    word: str, rules: Sequence[StartRule], components: Mapping[str, RtsComponent], old: Element | None
) -> Element:
    """The element of a sequence that states these rules, as far as it can.

    Args:
        rules: ordered so that each comes after those that it waits for.
        components: the profile's components, by their names here.
        old: the sequence that stood there.
    """
    levels: dict[str, int] = {}
    targets = []
    for rule in rules:
        if rule.component not in components:
            continue
        others = [one.component for one in rule.conditions if one.component in components]
        level = levels[rule.component] = 1 + max((levels.get(other, 0) for other in others), default=0)
        parts = [_target("TargetComponent", components[rule.component])]
        if others:
            timing = made(
                "Preceding",
                *(_target("PrecedingComponents", components[other]) for other in others),
                timeout=None if rule.timeout == USUAL_TIMEOUT else str(round(rule.timeout * 1000)),
                sendingTiming="SYNC",
            )
            parts.append(timing)
        else:
            parts.append(made("WaitTime", waitTime=str(round(rule.wait * 1000))))
        targets.append((level, made("targets", *parts, sequence=str(level))))
    targets.sort(key=lambda one: one[0])
    new = made(word)
    if old is None:
        return new.edited(added=[(("targets",), one) for _, one in targets])
    cleared = old.edited(lambda child: None if child.local == "targets" else child)
    return cleared.edited(added=[(("targets",), one) for _, one in targets])


def _target(local: str, component: RtsComponent) -> Element:
    context = component.contexts[0].id if component.contexts else "0"
    return made(local, componentId=component.id, instanceName=component.name, id=context)
