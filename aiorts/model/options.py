"""Turns the options of `connect` (or OpenRTM's keys) into the options in force; it connects nothing.

aiorts' own keys are those of `Kernel.connect`. OpenRTM's keys, with or without the prefix `dataport.`, are aliases;
the side-specific ones win: `inport.buffer.*` is the reader's buffer, `outport.buffer.*` the backlog, which only has a
length here. Words stand in any case, with blanks round them. An unknown key with a dot is kept, and `doubts`
reports it; an unknown one without a dot is a typing mistake and refused. Keys of OpenRTM's transports are kept, and
`without_effect` finds them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final, Literal, NamedTuple, cast

from aiorts.errors import InvalidNameError, WiringError
from aiorts.late import dataclass
from aiorts.model.buffer import DEFAULT_LENGTH, MAX_LENGTH, FullPolicy
from aiorts.model.declared import (
    Option,
    OptionError,
    folded,
    may_be_none,
    option,
    options_of,
    read_option,
    read_yes,
)
from aiorts.model.names import check_name
from aiorts.model.policy import Dataflow, OnLinkLost, Push, Stamp, Subscription, default_push
from aiorts.model.profile import ConnectorProfile
from aiorts.spelling import suggestion

MEASURED_SENDS: Final = 1000
"""The number of sends over which OpenRTM's keys time a publisher where they give none."""

_NO_EXTRA: Final[Mapping[str, str]] = MappingProxyType({})

_EITHER_SIDE: Final[tuple[tuple[str, str], ...]] = (
    # OpenRTM key, ours. Later rows win over earlier ones.
    ("dataflow_type", "dataflow"),
    ("subscription_type", "subscription"),
    ("io_mode", "subscription"),
    ("publisher.push_policy", "push"),
    ("publisher.skip_count", "skip"),
    ("publisher.push_rate", "push_rate"),
    ("push_rate", "push_rate"),
    ("timestamp_policy", "stamp"),
    ("sync_readwrite", "rendezvous"),
    ("measurement.exec_count", "measure_exec_count"),
    ("measurement.period_count", "measure_period_count"),
    ("measurement.exec_time", "measure_exec"),
    ("measurement.period_time", "measure_period"),
)
_OF_THE_READER: Final[tuple[tuple[str, str], ...]] = (
    ("buffer.write.full_policy", "full"),
    ("buffer.write.timeout", "timeout"),
    ("buffer.read.empty_policy", "empty"),
)
ALIASES: Final[tuple[tuple[str, str], ...]] = (
    *_EITHER_SIDE,
    *_OF_THE_READER,
    ("buffer.length", "length"),
    ("buffer.length", "out_length"),
    *((f"outport.{alias}", key) for alias, key in _EITHER_SIDE),
    *((f"inport.{alias}", key) for alias, key in (*_EITHER_SIDE, *_OF_THE_READER)),
    ("outport.buffer.length", "out_length"),
    ("inport.buffer.length", "length"),
    ("fan_in", "fan_in"),
    ("fan_out", "fan_out"),
    ("connection_limit", "connection_limit"),
    ("allow_dup_connection", "allow_duplicate"),
)
_DUPLEX: Final = "duplex"
"""OpenRTM's dataflow in which a write and a read meet."""
_AT_A_RENDEZVOUS: Final[Mapping[str, Any]] = {
    "length": 0,
    "dataflow": Dataflow.PUSH,
    "subscription": Subscription.FLUSH,
    "full": FullPolicy.BLOCK,
    "lifespan": None,
    "keep_last": False,
}
"""The options where a write waits until the reader has taken its sample."""

_ON_LOSS: Final = ("full", "length", "push")


@dataclass(frozen=True, slots=True)
class PortLimits:
    """The options of `connect` about the ports that it joins, not about the connector."""

    fan_in: int | None = option(
        None, "The most connectors that the in-port takes.", low=1, high=MAX_LENGTH, end="ports"
    )
    fan_out: int | None = option(
        None, "The most connectors that the out-port takes.", low=1, high=MAX_LENGTH, end="ports"
    )
    connection_limit: int | None = option(
        None, "The most connectors that each port takes; -1 is any number.", low=-1, high=MAX_LENGTH, end="ports"
    )
    allow_duplicate: bool = option(
        False,
        "Whether there may be a second connector between the same two ports.",
        end="ports",
    )
    adapt: bool | Literal["text"] = option(
        False,
        'Whether a FlexiFilter is inserted between ports that do not fit; with "text" also one that makes numbers of '
        "texts.",
        end="ports",
    )


@dataclass(frozen=True, slots=True)
class ServiceOptions:
    """The options of `connect` for service ports alone."""

    mapping: Mapping[str, str] | None = option(
        None, "The provided interfaces that answer required ones, by path or name.", end="services"
    )
    strict: bool = option(
        True,
        "Whether every required interface has to find a provider; false leaves unbound what none answers.",
        end="services",
    )


SERVICE_KEYS: Final = tuple(options_of(ServiceOptions))
"""Options of service ports; for data ports they mean nothing, and are reported when these are connected."""


def without_identity(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of an existing connector without its name, by which it was found, and without `AGAIN`."""
    return {key: value for key, value in options.items() if key != "name" and key not in AGAIN}


def has_buffer(options: Mapping[str, Any]) -> bool:
    """Whether a connector with these options has a buffer; without one a write waits until its sample is taken."""
    return options.get("length") != 0


OPENRTM: Final = "openrtm"
"""The keyword of `connect` whose value is a mapping of OpenRTM's keys, which have dots and so cannot be keywords."""

_OF_CONNECTORS: Final = options_of(ConnectorProfile)
_OF_PORTS: Final = options_of(PortLimits)
OWN_OPTIONS: Final[Mapping[str, Option]] = MappingProxyType({**_OF_CONNECTORS, **_OF_PORTS})
"""The options for data ports."""
OWN_KEYS: Final = tuple(OWN_OPTIONS)
AGAIN: Final[Mapping[str, Any]] = MappingProxyType({"allow_duplicate": True})
"""The options of a second connector between two ports."""


def with_openrtm(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """The options with those of `openrtm` among them.

    Raises:
        WiringError: `openrtm` is no mapping with texts as keys, or a key is also given outside it with another value.
    """
    if OPENRTM not in options:
        return options
    merged = dict(options)
    given = merged.pop(OPENRTM)
    if not (isinstance(given, Mapping) and all(isinstance(key, str) for key in given)):
        raise WiringError(f"{OPENRTM} = {given!r:.80}: expected a mapping, such as {{'dataport.push_policy': 'new'}}")
    for key, value in given.items():
        if key in merged and folded(str(merged[key])) != folded(str(value)):
            raise WiringError(f"{key} stands in {OPENRTM} and beside it with two values; take one of them away")
        merged[key] = value
    return merged


class _Asked(NamedTuple):
    """The facts from which a default may follow, in addition to the options before it."""

    where: str
    own: Mapping[str, Any]
    rendezvous: bool
    length: int


def _usual_length(chosen: Mapping[str, Any], asked: _Asked) -> int:
    # Flush hands every sample over as it is written: a push policy is kept and reported, and chooses nothing.
    keeps_one = chosen["push"] is Push.NEW and chosen["subscription"] is not Subscription.FLUSH
    return 0 if asked.rendezvous else 1 if keeps_one else asked.length


_USUAL: Final[Mapping[str, Callable[[Mapping[str, Any], _Asked], Any]]] = MappingProxyType(
    {
        "push": lambda chosen, _: default_push(chosen["subscription"]),
        "length": _usual_length,
        "full": lambda _, asked: FullPolicy.BLOCK if asked.rendezvous else FullPolicy.OVERWRITE,
        "measure": lambda _, asked: _measured(asked.where, asked.own),
    }
)
"""Defaults that follow from other options."""


def connector_profile(
    where: str, options: Mapping[str, Any], name: str, ports: tuple[str, ...], usual_length: int = DEFAULT_LENGTH
) -> tuple[ConnectorProfile, PortLimits]:
    """The options in force of a connector, and those about its ports; `usual_length` where they give none.

    Raises:
        WiringError: names the option, what is allowed and what was given.
    """
    own, extra = _translate(where, options)
    rendezvous = _rendezvous_by(where, own)
    asked = _Asked(where, own, bool(rendezvous), usual_length)
    chosen: dict[str, Any] = {}
    for key, one in _OF_CONNECTORS.items():
        usual = _USUAL[key](chosen, asked) if key in _USUAL else one.default
        low = 0 if rendezvous and key == "out_length" else None  # a write that waits has no backlog
        chosen[key] = _value(where, ConnectorProfile, own, key, usual, low)
    if chosen["subscription"] is Subscription.PERIODIC and chosen["push_rate"] is None:
        raise WiringError(f"{where}: subscription periodic needs a push_rate in Hz")
    chosen["name"] = chosen["name"] or name
    profile = ConnectorProfile(**chosen, ports=ports, extra=MappingProxyType(extra) if extra else _NO_EXTRA)
    if rendezvous:
        _check_rendezvous(where, options, profile, rendezvous)
    limits = {key: _value(where, PortLimits, own, key, one.default) for key, one in _OF_PORTS.items() if key in own}
    return profile, PortLimits(**limits)


def _value(where: str, cls: type, own: Mapping[str, Any], key: str, usual: Any, low: float | None = None) -> Any:
    """The value of an option; `usual` where it is not given."""
    value = own.get(key)
    if value is None:
        return None if key in own and may_be_none(cls, key) else usual
    try:
        return read_option(cls, key, value, low=low)
    except OptionError as error:
        raise WiringError(f"{where}: {error}") from None


_AT_THE_WRITER: Final[Mapping[str, StrEnum]] = MappingProxyType(
    {"subscription": Subscription.PERIODIC, "push": Push.SKIP, "stamp": Stamp.SEND}
)
"""The values of options that the writer's end alone carries out."""


USUAL_APART: Final[Mapping[str, Any]] = MappingProxyType({"subscription": Subscription.NEW, "push": Push.ALL})
"""The defaults of a connector to another process, where they differ from those within one."""


def link_options(
    where: str, options: Mapping[str, Any], *, from_reader: bool = False, through: bool = False
) -> dict[str, Any]:
    """The options of a connector to another kernel, completed by the defaults of links.

    The default subscription is new/all: a flush waits for a round trip at each write, which a hook does not expect.

    Args:
        from_reader: the reader's kernel connects it: the values that the writer's end alone carries out are refused.
        through: both ends are in other kernels, and the samples go through this one: pulling is refused.

    Raises:
        WiringError: an option that a link does not have, or as `connector_profile`.
    """
    own, _ = _translate(where, options)
    if _rendezvous_by(where, own):
        raise WiringError(f"{where}: length = 0: the reader is in another kernel; subscription = flush waits for it")
    if own.get("convert") is not None:
        raise WiringError(f"{where}: convert: the reader is in another kernel; convert in a component of this one")
    pulls = _value(where, ConnectorProfile, own, "dataflow", Dataflow.PUSH) is Dataflow.PULL
    if pulls and own.get("max_gap") is not None:
        why = "the reader's kernel gets a sample when it asks, and does not know when the writer writes"
        raise WiringError(f"{where}: max_gap does not go with dataflow = pull to another kernel: {why}")
    for key, value in _AT_THE_WRITER.items() if from_reader else ():
        if _value(where, ConnectorProfile, own, key, None) is value:
            raise WiringError(f"{where}: {key} = {value}: the writer is in another kernel; connect them there")
    if pulls and through:
        why = "both ends are in other processes, and samples go through this one, which would answer for the writer"
        raise WiringError(f"{where}: dataflow = pull: {why}")
    usual: dict[str, Any] = {}
    if "subscription" not in own and not pulls:
        usual = {key: value for key, value in USUAL_APART.items() if key not in own}
    if own.get("on_link_lost") is None:
        usual["on_link_lost"] = OnLinkLost.WAIT
    return {**options, **usual}


_CHOSEN: Final = tuple(key for key in _OF_CONNECTORS if key not in ("name", "convert"))
"""Options that are chosen, each after the options that its default follows from."""


def chosen_options(profile: ConnectorProfile, usual_length: int | None = None) -> dict[str, Any]:
    """The fewest options of aiorts that make this profile, except its name and `convert`.

    Args:
        usual_length: the length that the in-port declares, if it does.
    """
    usual = DEFAULT_LENGTH if usual_length is None else usual_length
    options = dict(_chosen(tuple(getattr(profile, key) for key in _CHOSEN), usual))
    if profile.on_link_lost is not None and profile.dataflow is Dataflow.PUSH and "subscription" not in options:
        options["subscription"] = str(profile.subscription)  # the default of a link is new/all
    return options


def said_options(profile: ConnectorProfile, usual_length: int | None = None) -> dict[str, Any]:
    """The options of `chosen_options` for a connector to another process, without the defaults of such connectors."""
    options = chosen_options(profile, usual_length)
    usual = USUAL_APART if all(options.get(key) == value for key, value in USUAL_APART.items()) else {}
    return {key: value for key, value in options.items() if key not in (*usual, "on_link_lost")}


@lru_cache(maxsize=256)
def _chosen(values: tuple[Any, ...], usual_length: int) -> Mapping[str, Any]:
    options: dict[str, Any] = {}
    made, _ = connector_profile("", options, "", (), usual_length)
    left = dict(zip(_CHOSEN, values, strict=True))
    while left:
        key = next(iter(left))
        value = left.pop(key)
        if getattr(made, key) == value:
            continue
        options[key] = value.value if isinstance(value, StrEnum) else value
        if key == "subscription" and value is Subscription.PERIODIC:
            options["push_rate"] = left.pop("push_rate")
        made, _ = connector_profile("", options, "", (), usual_length)
    return MappingProxyType(options)


CHANGEABLE: Final = tuple(key for key, one in _OF_CONNECTORS.items() if one.changes)
"""Options that may be changed while connected."""


def what_stays(profile: ConnectorProfile) -> dict[str, Any]:
    """The options in force with which a changed option must agree."""
    return {key: getattr(profile, key) for key in _CHOSEN}


def changed_profile(where: str, profile: ConnectorProfile, options: Mapping[str, Any]) -> ConnectorProfile:
    """The options in force after a change to these options.

    Raises:
        WiringError: as `connector_profile`; or no option is given; or one cannot be changed.
    """
    can = f"{', '.join(CHANGEABLE[:-1])} and {CHANGEABLE[-1]} can be changed while connected"
    if not options:
        raise WiringError(f"{where}: change: there is nothing to change; {can}")
    for key in options:
        if key not in CHANGEABLE:
            hint = suggestion(key, CHANGEABLE, "")
            can = f"{hint} {can}" if hint else can
            raise WiringError(f"{where}: change: {key}: {can}; for other options disconnect and connect anew")
    periodic = profile.subscription is Subscription.PERIODIC and profile.dataflow is Dataflow.PUSH
    if "push_rate" in options and not periodic:
        pulls = profile.dataflow is Dataflow.PULL
        what = "the reader pulls" if pulls else f"the subscription is {profile.subscription}"
        raise WiringError(f"{where}: change: push_rate: {what}; only a periodic connector has a push_rate")
    length = _value(where, ConnectorProfile, options, "length", profile.length)
    if (length == 0) is not (profile.length == 0):
        raise WiringError(
            f"{where}: change: length = {length}: whether a write waits until the reader has taken the sample (length "
            "0) cannot be changed; disconnect and connect anew"
        )
    new, _ = connector_profile(where, {**what_stays(profile), **options}, profile.name, profile.ports)
    return replace(profile, **{key: getattr(new, key) for key in CHANGEABLE})


def says_what_is_lost(options: Mapping[str, Any], profile: ConnectorProfile) -> bool:
    """Whether the options of this profile, as the user gave them, say how many samples may wait at a reader, and which
    samples are dropped beyond that."""
    given = {key.removeprefix("dataport.") for key, value in options.items() if value is not None}
    chosen = {key for alias, key in ALIASES if key in _ON_LOSS and not given.isdisjoint((alias, key))}
    return bool(chosen - {"push"} if _pushes_in_vain(profile) else chosen)


def loses_unasked(profile: ConnectorProfile) -> bool:
    """Whether every sample is to be delivered, and the oldest is dropped when the reader is slow."""
    every = profile.subscription is Subscription.FLUSH or profile.push is Push.ALL
    return every and profile.dataflow is Dataflow.PUSH and profile.full is FullPolicy.OVERWRITE


def _rendezvous_by(where: str, own: Mapping[str, Any]) -> str:
    """The key that makes a write wait until the reader has taken its sample; "" if no key does."""
    said = own.get("rendezvous", "")
    if said not in ("", None) and is_yes(where, "sync_readwrite", said):
        return "rendezvous"
    if "duplex" in own:
        return "dataflow"
    return "" if _value(where, ConnectorProfile, own, "length", 1) else "length"


def _check_rendezvous(where: str, options: Mapping[str, Any], profile: ConnectorProfile, by: str) -> None:
    """Refuse options that do not go with a write that waits until the reader has taken its sample."""
    for key, value in _AT_A_RENDEZVOUS.items():
        if getattr(profile, key) != value:
            raise WiringError(
                f"{where}: {_as_given(options, key)} does not go with {_as_given(options, by)}: a write waits until "
                "the reader has taken the sample (length 0, dataflow push, subscription flush, full block); "
                "take one of them away"
            )


def _as_given(options: Mapping[str, Any], key: str) -> str:
    """An option in the user's spelling; of several spellings, the one in force."""
    plain = {given.removeprefix("dataport."): given for given in options}
    spelled = [key, *(alias for alias, known in reversed(ALIASES) if known == key)]
    given = next((plain[alias] for alias in spelled if alias in plain), "")
    return f"{given} = {options[given]!r}" if given else ""


def _measured(where: str, own: Mapping[str, Any]) -> int:
    """The default number of sends to time: the larger one of OpenRTM's two measurements."""
    counts = {what: own.get(f"measure_{what}_count", MEASURED_SENDS) for what in ("exec", "period")}
    return max(
        int(_value(where, ConnectorProfile, {"measure": count}, "measure", 0, 1))
        * is_yes(where, f"measurement.{what}_time", own.get(f"measure_{what}", False))
        for what, count in counts.items()
    )


def is_yes(where: str, key: str, value: object) -> bool:
    """Read a truth value, also as OpenRTM writes it. WiringError: the value is none."""
    try:
        return read_yes(key, value)
    except OptionError as error:
        raise WiringError(f"{where}: {error}") from None


def how_to_adapt(where: str, value: object) -> bool | Literal["text"]:
    """The option `adapt`: a truth value, or "text", where numbers may be made of texts, too."""
    return cast("bool | Literal['text']", _value(where, PortLimits, {"adapt": value}, "adapt", usual=False))


def _check_once(where: str, options: Mapping[str, Any], plain: Mapping[str, Any]) -> None:
    """Refuse one option in two spellings with two values. A key of one side may differ from that of both."""
    given_as: dict[str, tuple[str, Any]] = {}
    for given, value in options.items():
        alias = given.removeprefix("dataport.")
        before = given_as.setdefault(alias, (given, value))
        if folded(str(before[1])) != folded(str(value)):  # as text: NaN is not equal to itself
            raise WiringError(f"{where}: {before[0]} and {given} are one option with two values; take one of them away")
    for alias, key in ALIASES:
        if alias != key and alias in plain and key in plain and not _same(key, plain[alias], plain[key]):
            if key == "out_length" and alias == "buffer.length":
                continue  # one key is for both sides, the other for the writer's
            raise WiringError(f"{where}: {alias} and {key} are one option with two values; take one of them away")


def _same(key: str, one: Any, other: Any) -> bool:
    words = OWN_OPTIONS[key].words if key in OWN_OPTIONS else _NO_EXTRA
    one, other = folded(str(one)), folded(str(other))
    return bool(words.get(one, one) == words.get(other, other))


def _translate(where: str, options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    plain = {key.removeprefix("dataport."): value for key, value in options.items()}
    own: dict[str, Any] = {}
    used: set[str] = set()
    _check_once(where, options, plain)
    for alias, key in ALIASES:
        if alias in plain:
            used.add(alias)
            own[key] = plain[alias]
    if folded(own.get("dataflow")) == _DUPLEX:
        own["dataflow"], own["duplex"] = Dataflow.PUSH, True
    for key in plain:
        if key in OWN_KEYS:
            used.add(key)
            own[key] = plain[key]
    extra: dict[str, str] = {}
    for given, value in options.items():
        key = given.removeprefix("dataport.")
        if key in used or key in SERVICE_KEYS:
            continue
        if "." not in given and key not in KEPT:
            hint = suggestion(key, (*OWN_KEYS, *SERVICE_KEYS), f"there are {', '.join(OWN_KEYS)}")
            raise WiringError(f"{where}: unknown option {given!r}; {hint}")
        extra[given] = str(value)
    return own, extra


KEPT: Final = ("data_type", "interface_type", "buffer_type", "marshaling_type", "thread_type", "fsm_event_name")
"""OpenRTM's keys without a dot that are kept and do nothing."""


_KEPT_BEGINNINGS: Final = (
    "buffer.read.timeout",
    "serializer.",
    "corba_cdr.",
    "corba_any.",
    "direct.",
    "shared_memory.",
    "interface_option.",
    "port.",
)
"""The beginnings of OpenRTM's keys for its transports and tools."""

_OF_TRANSPORT: Final = frozenset({"interface_type", "marshaling_type", "empty"}) | {
    *(alias for alias, key in _OF_THE_READER if key == "empty"),
    *(f"outport.{alias}" for alias, _ in _OF_THE_READER),
}
"""OpenRTM's keys for the way of samples, or the behaviour of its backlog; they have no effect here."""


def without_effect(options: Mapping[str, Any]) -> list[str]:
    """The keys among these, as they were given, that are kept for OpenRTM's tools and change nothing here."""
    found = []
    for given, value in options.items():
        key = given.removeprefix("dataport.")
        bare = key.removeprefix("inport.").removeprefix("outport.")
        if folded(value) not in (None, "") and (key in _OF_TRANSPORT or bare in _OF_TRANSPORT):
            found.append(given)
    return found


def transport_notice(keys: Sequence[str]) -> str:
    """The notice on keys that `without_effect` found."""
    those, are, them = ("keys", "they are", "them") if len(keys) > 1 else ("a key", "it is", "it")
    return (
        f"{', '.join(keys)}: {those} of OpenRTM's transports and backlogs; {are} kept and without effect here: leave "
        f"{them} for its tools, or take {them} away"
    )


def doubts(options: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Options that are taken and do nothing: the key as it was given, and the remark on it."""
    known = {alias for alias, _ in ALIASES} | {*KEPT}
    for given in options:
        key = given.removeprefix("dataport.")
        bare = key.removeprefix("inport.").removeprefix("outport.")
        kept = bare in KEPT or bare.startswith(_KEPT_BEGINNINGS) or key in _OF_TRANSPORT
        if "." not in given or key in known or key in OWN_KEYS or kept or key.partition(".")[0] in SERVICE_KEYS:
            continue
        otherwise = "it is kept and does nothing: take it away"
        before = given.removesuffix(key)
        hint = suggestion(key, sorted(known | {*OWN_KEYS}), otherwise, shown=lambda near: repr(before + near))  # noqa: B023
        yield given, f"{given} is no option that is known; {hint}"
    name = options.get("name")
    if isinstance(name, str):
        try:
            check_name(name, "connector")
        except InvalidNameError as error:
            # A program may give any name, but no command finds a connector by this one.
            yield "name", f"{error}; choose another, or take it away"


def _pushes_in_vain(profile: ConnectorProfile) -> bool:
    """Whether the push policy would choose among samples, but each is sent as it is written."""
    chooses = profile.push in (Push.NEW, Push.SKIP)
    return chooses and profile.subscription is Subscription.FLUSH and profile.dataflow is Dataflow.PUSH


_IDLE: Final[tuple[tuple[str, Callable[[ConnectorProfile], bool], tuple[str, ...]], ...]] = (
    (
        "the reader pulls the writer's latest unread sample",
        lambda profile: profile.dataflow is Dataflow.PULL,
        ("length", "out_length", "push", "push_rate", "skip", "full"),
    ),
    (
        "a newer sample takes the place of the one that is unread",
        lambda profile: profile.subscription is Subscription.NEW and profile.push is Push.NEW,
        ("length", "full"),
    ),
)
"""The behaviour of some connectors, a test for these, and the options that choose nothing there."""
_AS_IT_IS: Final[Mapping[str, Any]] = {
    "length": 1,
    "out_length": 1,
    "push": Push.NEW,
    "push_rate": None,
    "skip": 0,
    "full": FullPolicy.OVERWRITE,
}
"""The value with which such an option agrees with the behaviour, and is not reported."""
_ALONE: Final[tuple[tuple[str, Callable[[ConnectorProfile], bool], str], ...]] = (
    ("push", _pushes_in_vain, "every sample is sent: push takes subscription new or periodic"),
    (
        "out_length",
        lambda profile: profile.subscription is not Subscription.PERIODIC and profile.out_length != 1,
        "there is no backlog: the subscription is not periodic",
    ),
    (
        "push_rate",
        lambda profile: profile.subscription is not Subscription.PERIODIC and profile.push_rate is not None,
        "samples are sent as they are written: the subscription is not periodic",
    ),
    (
        "skip",
        lambda profile: (
            (profile.subscription is Subscription.FLUSH or profile.push is not Push.SKIP) and profile.skip > 0
        ),
        "every sample is sent: skip takes subscription new or periodic with push skip",
    ),
)
"""Options that choose nothing by themselves, by aiorts' own names alone: the option, a test, and the reason.

OpenRTM's keys for them stand in the files of its tools, whatever the subscription: they are not reported.
"""
_KEY_OF: Final = {**dict(reversed(ALIASES)), **{key: key for key in OWN_KEYS}}


def idle(options: Mapping[str, Any], profile: ConnectorProfile) -> Iterator[tuple[str, str]]:
    """Options that choose nothing in the profile that they make: the key as it was given, and the remark on it."""
    rows = [(what, keys) for what, applies, keys in _IDLE if applies(profile)]
    alone = {key: why for key, applies, why in _ALONE if applies(profile)}
    for given in options:
        key = _KEY_OF.get(given.removeprefix("dataport."), "")
        what = next((what for what, keys in rows if key in keys), "")
        says_so = what and getattr(profile, key) == _AS_IT_IS[key]
        if why := "" if says_so else what or alone.get(given, ""):
            yield given, f"{given} chooses nothing where {why}; take it away"
