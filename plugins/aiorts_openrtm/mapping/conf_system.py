"""`rtc.conf`, or the `.conf` of one component, as the profile of the system that a manager would make of it.

Keys that have an effect: modules, precreate, preconnect, preactivation, naming formats, execution contexts, and keys of
components. All others are noted with their line. No variable of the environment is looked up, and no module loaded.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from aiorts_openrtm.conf.properties import ENVIRONMENT, Conf, Entry
from aiorts_openrtm.errors import OpenRTMError
from aiorts_openrtm.mapping.extras import MARK
from aiorts_openrtm.mapping.types import Types
from aiorts_openrtm.markup.element import Element
from aiorts_openrtm.markup.shapes import in_order, made, made_component, made_set, made_system
from aiorts_openrtm.notes import Note
from aiorts_openrtm.profiles.rts_profile import MOST

_BASICS: Final = (
    *("implementation_id", "type_name", "description", "version", "vendor", "category", "activity_type"),
    *("max_instance", "language", "lang_type", "instance_name"),
)
_OF_MANAGERS: Final = frozenset(
    {
        *("config", "corba", "exec_cxt", "ec", "execution_contexts", "logger", "manager", "module", "naming"),
        *("openrtm", "os", "port", "sdo", "timer", "rtc"),
    }
)
"""The first words of a manager's keys; other keys are of components."""
_ACTS: Final = frozenset(
    {
        *("manager.components.precreate", "manager.components.preconnect", "manager.components.preactivation"),
        *("manager.modules.load_path", "manager.modules.preload", "manager.name", "naming.formats"),
    }
)
_TAKEN: Final = frozenset(
    {*_BASICS, "configuration.active_config", "execution_contexts", "naming.formats", "config_file"}
)
"""Keys of a component that have an effect here, or that its profile states."""
_OF_COMPONENTS: Final = ("conf.", "configuration.", "exec_cxt.", "execution_contexts", "ec.", "port.")
_EC: Final = re.compile(r"\s*([\w.]+)\s*(?:\(\s*([\w.-]*)\s*\))?\s*")
_COMMA: Final = re.compile(r",(?![^()]*\))")
_OF_TWO: Final = re.compile(r"([\w.-]+\.[\w-]+)\s*:\s*([\w.-]+\.[\w-]+)\s*(?:\(([^()]*)\))?")
_USUAL_TYPE: Final = "PeriodicExecutionContext"
_USUAL_RATE: Final = "1000"
_USUAL_FORMAT: Final = "%h.host_cxt/%n.rtc"


@dataclass
class _Component:
    """A component that is to be made, and the keys about it."""

    name: str
    type: str
    where: str
    keys: dict[str, Entry] = field(default_factory=dict)
    basics: dict[str, str] = field(default_factory=dict)

    def value(self, key: str, default: str = "") -> str:
        found = self.keys.get(key)
        return default if found is None or not found.value else found.value


@dataclass(frozen=True)
class ConfSystem:
    """A system that a .conf file describes."""

    element: Element
    """The profile."""
    files: Mapping[str, list[Path]]
    """The files in which the class of a type may stand, by the type's name."""
    notes: list[Note]


def system_of_conf(conf: Conf, types: Types) -> ConfSystem:
    """The system that a file of a manager, or of one component, configures.

    Raises:
        OpenRTMError: a value is impossible; the message has the line.
    """
    return _Reader(conf, types).whole()


def is_of_manager(conf: Conf) -> bool:
    """Whether a file configures a manager, and not one component.

    Raises:
        OpenRTMError: it configures neither.
    """
    if any(key.startswith("manager.") or key.endswith(".config_file") for key in conf.last):
        return True
    if any(key.startswith(_OF_COMPONENTS) or key in _BASICS for key in conf.last):
        return False
    if any(key.partition(".")[0] in _OF_MANAGERS for key in conf.last):
        return True
    raise OpenRTMError(f"{conf.path}:1: has no key that OpenRTM knows: expected rtc.conf, or the .conf of a component")


class _Reader:
    """Makes one profile of one file."""

    def __init__(self, conf: Conf, types: Types) -> None:
        self._conf = conf
        self._types = types
        self._notes: list[Note] = []
        self._used: set[str] = set()
        self._folder = conf.path.parent
        self._is_manager = is_of_manager(conf)

    def whole(self) -> ConfSystem:
        """The whole system that the file describes."""
        components = list(self._created() if self._is_manager else self._single())
        if len(components) > MOST:
            raise OpenRTMError(f"{self._conf.path}: more than {MOST} components")
        for one in components:
            self._configure(one)
        active = self._preactivated(components)
        contexts = self._contexts(components, active)
        elements = [self._element(one, contexts[one.name]) for one in components]
        root = made_system(
            *in_order([*elements, *self._connectors(components)]),
            identity=f"RTSystem:aiorts:{self._conf.path.stem}:1.0.0",
            where=f"{self._conf.path}:1",
        )
        files = self._files(components)
        self._note_the_rest()
        return ConfSystem(root, files, self._notes)

    # -- which components ------------------------------------------------------------------------------------------

    def _single(self) -> Iterator[_Component]:
        """The component that its own .conf describes."""
        conf = self._conf
        stem = conf.path.stem
        kind = conf.value("type_name") or conf.value("implementation_id") or stem.rstrip("0123456789") or stem
        name = conf.value("instance_name") or (stem if stem != kind else f"{kind}0")
        yield _Component(name, kind, f"{conf.path}:1", dict(conf.last))

    def _created(self) -> Iterator[_Component]:
        entry = self._entry("manager.components.precreate")
        taken: set[str] = set()
        for text in entry.items:
            head, _, arguments = text.partition("?")
            parts = [part.strip() for part in head.split(":")]
            if len(parts) not in (1, 6):
                what = "expected TYPE, or RTC:vendor:category:type:language:version"
                raise OpenRTMError(f"{entry.where}: {head!r:.80}: {what}")
            where = entry.where
            kind = parts[3] if len(parts) == 6 else parts[0]
            basics = {}
            if len(parts) == 6:
                basics = {"vendor": parts[1], "category": parts[2], "version": parts[5]}
            keys = {}
            for argument in filter(None, arguments.split("&")):
                key, _, value = argument.partition("=")
                keys[key.strip()] = Entry(key.strip(), value.strip(), where)
            stated = keys.pop("instance_name", None)
            name = (
                stated.value if stated else next(n for i in range(len(taken) + 1) if (n := f"{kind}{i}") not in taken)
            )
            if name in taken:
                raise OpenRTMError(f"{where}: a second component {name!r:.80}; choose another instance_name")
            taken.add(name)
            yield _Component(name, kind, where, keys, basics)

    def _configure(self, one: _Component) -> None:
        """Gather a component's keys: of its type, then of the instance; keys here override those of its own file."""
        if self._is_manager:
            for who in (one.type, one.name):
                one.keys.update(self._keys_of(one, who))
            for word in ("vendor", "category", "version"):
                if one.value(word):
                    one.basics[word] = one.value(word)
        for key in one.keys:
            if key not in _TAKEN and not key.startswith(("conf.", "exec_cxt.", "ec.", "port.")):
                entry = one.keys[key]
                self._notes.append(Note(entry.where, f"{key} = {entry.value!r:.60}: nothing here acts on it"))

    def _keys_of(self, one: _Component, who: str) -> dict[str, Entry]:
        """The keys of a type or instance: those of its own file, replaced by those of this file."""
        mark = f".{who}."
        own: dict[str, Entry] = {}
        for key, entry in self._conf.last.items():
            category, found, rest = key.partition(mark)
            if not found or category.partition(".")[0] in _OF_MANAGERS:
                continue
            stated = one.basics.setdefault("category", category)
            if stated != category:
                self._notes.append(Note(entry.where, f"{key}: the category of {one.name} is {stated!r:.60}"))
                continue
            self._used.add(key)
            own[rest] = entry
        file = own.get("config_file")
        return {**({} if file is None else self._file_of(file)), **own}

    def _file_of(self, entry: Entry) -> dict[str, Entry]:
        """The keys of a component's own file, if it lies below a folder that may be named."""
        if ENVIRONMENT.search(entry.value):
            self._notes.append(Note(entry.where, f"{entry.value!r:.80}: no environment is looked up; write it out"))
            return {}
        path = self._types.inside(entry.value, self._folder) or self._types.inside(entry.value)
        if path is None:
            what = "is not there, or not below a folder that may be named (--module-path)"
            self._notes.append(Note(entry.where, f"{entry.value!r:.80}: {what}"))
            return {}
        return dict(Conf.read(path).last)

    # -- what they are ---------------------------------------------------------------------------------------------

    def _element(self, one: _Component, contexts: list[Element]) -> Element:
        sets: dict[str, dict[str, Entry]] = {"default": {}}
        for key, entry in one.keys.items():
            if key.startswith("conf."):
                name, dot, param = key[5:].partition(".")
                if not dot or not name or not param:
                    self._notes.append(Note(entry.where, f"{key}: expected conf.SET.PARAMETER"))
                    continue
                sets.setdefault("__constraints__" if name == "__constraint__" else name, {})[param] = entry
                self._note_environment(entry)
            elif key.startswith("port."):
                self._notes.append(Note(entry.where, f"{key}: of OpenRTM's ports; nothing here acts on it"))
        basics = one.basics
        vendor, category, version = (basics.get(word, "") for word in ("vendor", "category", "version"))
        data = {name: {param: (one.value, one.where) for param, one in values.items()} for name, values in sets.items()}
        return made_component(
            one.name,
            f"RTC:{vendor}:{category}:{one.type}:{version}",
            [*(made_set(name, values, one.where) for name, values in data.items()), *contexts],
            path=self._path_of(one),
            active=one.value("configuration.active_config", "default"),
            composite="PeriodicECShared" if one.type == "PeriodicECSharedComposite" else "None",
            where=one.where,
        )

    def _path_of(self, one: _Component) -> str:
        """The component's name in name servers: the first of its naming formats."""
        self._used.update(("naming.formats", "manager.name"))
        text = one.value("naming.formats") or self._conf.value("naming.formats", _USUAL_FORMAT)
        text = text.split(",")[0].strip()
        number = one.name.removeprefix(one.type)
        words = {
            "n": one.name,
            "t": one.type,
            "m": one.type,
            "i": one.type,
            "N": number if number.isdigit() else "",
            "v": one.basics.get("version", ""),
            "V": one.basics.get("vendor", ""),
            "c": one.basics.get("category", ""),
            "h": "localhost",
            "M": self._conf.value("manager.name", "manager"),
            "p": "pid",
            "%": "%",
        }
        return re.sub(r"%(.)", lambda found: words.get(found[1], found[1]), text)

    def _files(self, components: list[_Component]) -> dict[str, list[Path]]:
        """The files in which classes of types may stand: preloaded modules, then files of the type's name."""
        paths = self._entry("manager.modules.load_path")
        folders = [self._folder]
        for text in paths.items:
            if (found := self._types.inside(text, self._folder) or self._types.inside(text)) is not None:
                folders.append(found)
            else:
                self._notes.append(Note(paths.where, f"{text!r:.80}: no folder, or none below one that may be named"))
        entry = self._entry("manager.modules.preload")
        preloaded: list[Path] = []
        for text in entry.items:
            file = text.partition("(")[0].strip()
            found = next((path for one in folders if (path := self._types.inside(file, one)) is not None), None)
            if not file.endswith(".py"):
                self._notes.append(Note(entry.where, f"{text!r:.80}: no Python module; nothing here loads it"))
            elif found is None:
                self._notes.append(Note(entry.where, f"{text!r:.80}: is in none of the folders that may be named"))
            else:
                preloaded.append(found)
        files: dict[str, list[Path]] = {}
        for kind in dict.fromkeys(one.type for one in components):
            own = [path for one in folders if (path := self._types.inside(f"{kind}.py", one)) is not None]
            files[kind] = [*preloaded, *own]
        return files

    # -- contexts --------------------------------------------------------------------------------------------------

    def _contexts(self, components: list[_Component], active: frozenset[str]) -> dict[str, list[Element]]:
        """The execution contexts of each component; components share a context by its name."""
        found: dict[str, list[Element]] = {one.name: [] for one in components}
        shared: dict[str, list[tuple[_Component, str]]] = {}
        for one in components:
            stated = one.value("execution_contexts") or self._conf_value("execution_contexts")
            if stated.strip().lower() == "none":
                continue
            kinds = [self._kind(part, one) for part in stated.split(",") if part.strip()]
            kind = one.value("exec_cxt.periodic.type") or self._conf_value("exec_cxt.periodic.type") or _USUAL_TYPE
            for number, (word, name) in enumerate(kinds or [(kind, "")]):
                shared.setdefault(name or f"{one.name}\n{number}", []).append((one, word))
        for key, members in shared.items():
            (one, word), name = members[0], key.partition("\n")[0] if "\n" not in key else ""
            rate = self._rate(one, word, name)
            idle = not any(member.name in active for member, _ in members)
            extras = {"activate": json.dumps(False)} if idle else {}
            if 0 < sum(member.name in active for member, _ in members) < len(members):
                what = f"the context {name!r:.60} activates all of its members, not only those of preactivation"
                self._notes.append(Note(one.where, what))
            if name:
                extras["name"] = json.dumps(name)
            participants = [
                made("Participants", componentId=f"RTC:::{member.type}:", instanceName=member.name)
                for member, _ in members[1:]
            ]
            properties = [made("Properties", ext=True, name=MARK + key, value=value) for key, value in extras.items()]
            element = made(
                "ExecutionContexts",
                *participants,
                *properties,
                id=str(len(found[one.name])),
                kind=word,
                rate=rate,
                where=one.where,
            )
            found[one.name].append(element)
        return found

    def _kind(self, text: str, one: _Component) -> tuple[str, str]:
        match = _EC.fullmatch(text)
        if match is None:
            raise OpenRTMError(f"{one.where}: {one.name}: {text.strip()!r:.80}: expected KIND(NAME), KIND(NAME), ...")
        return match[1], match[2] or ""

    def _rate(self, one: _Component, kind: str, name: str) -> str:
        """The most specific rate: of the context, else of its kind, else of the component or of all."""
        for key in (f"ec.{name}.rate", f"ec.{kind}.rate", "exec_cxt.periodic.rate"):
            entry = one.keys.get(key) or self._conf.last.get(key)
            if entry is not None and entry.value and key != "ec..rate":
                self._used.add(key)
                try:
                    if 0 < float(entry.value[:40]) < float("inf"):
                        return entry.value
                except ValueError:
                    pass
                raise OpenRTMError(f"{entry.where}: {key} = {entry.value!r:.60}: expected Hz, a number above 0")
        return _USUAL_RATE

    def _conf_value(self, key: str) -> str:
        self._used.add(key)
        return self._conf.value(key)

    def _preactivated(self, components: list[_Component]) -> frozenset[str]:
        names = {one.name for one in components}
        if not self._is_manager:
            return frozenset(names)
        entry = self._entry("manager.components.preactivation")
        found = set()
        for text in entry.items:
            name = _of_uri(text)
            if name in names:
                found.add(name)
            else:
                self._notes.append(Note(entry.where, f"preactivation: {text!r:.80} is no component that is made here"))
        if not found and names:
            what = "no component is in manager.components.preactivation: none is activated at the start"
            self._notes.append(Note(f"{self._conf.path}:1", what))
        return frozenset(found)

    # -- connections -----------------------------------------------------------------------------------------------

    def _connectors(self, components: list[_Component]) -> Iterator[Element]:
        entry = self._entry("manager.components.preconnect")
        kinds = {one.name: one.type for one in components}
        for text in _connections_in(entry.value):
            head, _, query = _of_two(text).partition("?")
            pairs = [part.partition("=")[::2] for part in query.split("&") if part]
            ports = [value.strip() for key, value in pairs if re.fullmatch(r"port\d*", key.strip())]
            options = {key.strip(): value.strip() for key, value in pairs if not re.fullmatch(r"port\d*", key.strip())}
            if not ports and (kind := options.get("interface_type", "corba_cdr")) != "corba_cdr":
                what = f"{text!r:.80}: a port without a partner, of the interface {kind!r:.40}; nothing here acts on it"
                self._notes.append(Note(entry.where, what))
                continue
            if not ports:
                raise OpenRTMError(f"{entry.where}: {text!r:.80}: expected A.out?port=B.in&KEY=VALUE")
            for port in ports:
                yield self._connector(entry, head.strip(), port, options, kinds)

    def _connector(
        self, entry: Entry, source: str, target: str, options: Mapping[str, str], kinds: Mapping[str, str]
    ) -> Element:
        ends = []
        for local, text in (("sourceDataPort", source), ("targetDataPort", target)):
            component, dot, port = _of_uri(text).rpartition(".")
            if not dot or not component or not port:
                raise OpenRTMError(f"{entry.where}: {text!r:.80}: expected COMPONENT.PORT")
            identity = f"RTC:::{kinds.get(component, '')}:"
            ends.append(made(local, componentId=identity, instanceName=component, portName=f"{component}.{port}"))
        properties = [
            made("Properties", ext=True, name=key if key.startswith("dataport.") else f"dataport.{key}", value=value)
            for key, value in options.items()
        ]
        return made(
            "DataPortConnectors",
            *ends,
            *properties,
            connectorId=f"{source}>{target}",
            name=f"{source}>{target}",
            dataType=options.get("data_type", "IDL:RTC/Unknown:1.0"),
            interfaceType=options.get("interface_type", "corba_cdr"),
            dataflowType=options.get("dataflow_type", "push"),
            subscriptionType=options.get("subscription_type", "flush"),
            where=entry.where,
        )

    # -- what is left ----------------------------------------------------------------------------------------------

    def _entry(self, key: str) -> Entry:
        """The entry of a key; an entry with an empty value where the file lacks the key."""
        self._used.add(key)
        found = self._conf.last.get(key) or Entry(key, "", f"{self._conf.path}:1")
        self._note_environment(found)
        return found

    def _note_environment(self, entry: Entry) -> None:
        if ENVIRONMENT.search(entry.value):
            what = "the environment is not looked up; the text stands as it is"
            self._notes.append(Note(entry.where, f"{entry.key} = {entry.value!r:.60}: {what}"))

    def _note_the_rest(self) -> None:
        if not self._is_manager:
            return
        for key, entry in self._conf.last.items():
            if key not in self._used and key not in _ACTS:
                first = key.partition(".")[0]
                what = "nothing here acts on it" if first in _OF_MANAGERS else "no component that is made here"
                self._notes.append(Note(entry.where, f"{key} = {entry.value!r:.60}: {what}"))


def _connections_in(text: str) -> Iterator[str]:
    """The connections of a list; a comma within parentheses separates options of one connection."""
    return (part.strip() for part in _COMMA.split(text) if part.strip())


def _of_two(text: str) -> str:
    """A connection as `A.out?port=B.in&KEY=VALUE`, also where it is written `A.out:B.in(KEY=VALUE)`, as in 1.1."""
    found = _OF_TWO.fullmatch(text)
    if found is None:
        return text
    options = [part.strip() for part in re.split("[&,]", found[3] or "") if part.strip()]
    return f"{found[1]}?{'&'.join((f'port={found[2]}', *options))}"


def _of_uri(text: str) -> str:
    """A component, or component and port, without the address of a manager or name server."""
    text = text.strip()
    if "://" not in text:
        return text
    return text.rpartition("/")[2].replace(".rtc", "", 1)
