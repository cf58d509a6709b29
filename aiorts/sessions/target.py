"""The meaning of a command line's word among running kernels: a kernel, a component, a port.

A word is `component`, `component.port`, `kernel/component.port` or `host/kernel/component.port`. A shorter form is
enough where only one kernel has that name; a kernel's name may also omit the number of its process. A file ends in
.toml, .xml, .yaml or .mcap, or begins with ./ or /; every other word is a name.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from fnmatch import fnmatchcase
from typing import Any, Final, Never, TypeVar

from aiorts.errors import AbsentError, AiortsError, AmbiguousError, ClosedError, NoAnswerError
from aiorts.late import dataclass
from aiorts.model.names import split_path
from aiorts.sessions.client import Client, Silent, open_all
from aiorts.sessions.folder import Entry, entries, entry_at, is_listed
from aiorts.sessions.many import said_by_many
from aiorts.sessions.protocol import RightName
from aiorts.spelling import suggestion

T = TypeVar("T")
FILES: Final = (".toml", ".xml", ".yaml", ".yml", ".mcap")
"""The endings of words that are files."""
_STREAMS: Final = ("stdin", "stdout", "live")
"""The components that a filter adds: they read and write its standard streams."""
_SHOWN: Final = 10
_GLOB: Final = re.compile(r"[*?\[]")


def is_file(word: str) -> bool:
    """Whether a word of a command line is a file, not the name of a running kernel, component or port."""
    return word.startswith(("./", "../", "/", "~")) or word.lower().endswith(FILES)


def is_glob(word: str) -> bool:
    """Whether a word has one of the characters * ? [, with which it may mean several things."""
    return _GLOB.search(word) is not None


@dataclass(frozen=True, slots=True)
class Running:
    """A kernel that answered, its session open."""

    client: Client
    names: Mapping[str, Any]
    """The answer of the operation `names`: components, contexts, connectors."""
    alias: str = ""
    """The name by which links reach the kernel, if no kernel is called so; "" otherwise."""
    short: str = ""
    """The kernel's name without the number of its process, if no other kernel is meant by that; else ""."""

    @property
    def name(self) -> str:
        """The kernel's name, without the host."""
        return self.client.entry.name

    def fits(self, kernel: str) -> bool:
        """Whether a word means this kernel: its name or "host/name", in which * ? [] stand for any characters."""
        host = self.client.entry.address.rpartition("/")[0]
        others = [one for one in (self.alias, self.short) if one]
        return _matches(self.client.entry, kernel) or kernel in (*others, *(f"{host}/{one}" for one in others))

    @property
    def links(self) -> str:
        """The name by which links of other kernels reach this kernel; "" where they cannot."""
        return str(self.names.get("links") or "")


@dataclass(frozen=True, slots=True)
class Found:
    """The running kernel, component or port that a word means."""

    running: Running
    component: str
    """The component's name; "" where the kernel itself is meant."""
    port: str = ""
    """The name after the component's, such as a port's or parameter's; "" where there is none."""

    @property
    def client(self) -> Client:
        """The session with its kernel."""
        return self.running.client

    @property
    def path(self) -> str:
        """The name within the kernel: "component" or "component.port"."""
        return f"{self.component}.{self.port}" if self.port else self.component

    @property
    def full(self) -> str:
        """The name with the kernel's name before it."""
        return f"{self.running.name}/{self.path}" if self.path else self.running.name

    @property
    def kind(self) -> str:
        """ "kernel", "component" or "port"."""
        return "port" if self.port else "component" if self.component else "kernel"

    def check(self, *kinds: str) -> None:
        """Raise AbsentError unless the found thing is of one of these kinds."""
        if self.kind not in kinds:
            raise AbsentError(f"{self.full}: is a {self.kind}, no {' or '.join(kinds)}; `aiorts ls -R` shows all")


class Kernels:
    """The kernels that run, each with an open session.

    Attributes:
        running: the kernels that answered.
        silent: the kernels that did not.
        changing: whether the command changes something: it then refuses a word that may also mean something in a silent
            kernel.
    """

    def __init__(self, running: Sequence[Running], silent: Sequence[Silent], *, changing: bool = False) -> None:
        here = [*(one.client.entry for one in running), *(one.entry for one in silent)]
        own = {one.name for one in here}
        shorts = Counter([*own, *(short for one in here if (short := _short(one)))])
        self.running = tuple(
            Running(
                one.client,
                one.names,
                alias="" if one.links in own else one.links,
                short=short if shorts[short := _short(one.client.entry)] == 1 else "",
            )
            for one in running
        )
        self.silent = tuple(silent)
        self.changing = changing

    def find(self, word: str, *, bare: bool = False) -> Found:
        """Find the single thing that a word means; with `bare`, also a kernel, if no component has that name.

        Raises:
            AbsentError: nothing has the name.
            AmbiguousError: several things have the name; the text lists them.
            NoAnswerError: the kernel that is meant does not answer.
        """
        found = self.all(word, bare=bare)
        return the_one(word, found, _told_apart(found))

    def all(self, word: str, *, bare: bool = False) -> tuple[Found, ...]:
        """Find everything that a word means: one thing, or all that match where * ? [] in it stand for any characters.

        Raises:
            AbsentError: nothing has the name.
            AmbiguousError: several things have the name, and the word has no such character; the text lists them.
                NoAnswerError: a kernel that may have the name does not answer, and nothing else has it or `changing` is
                set.
            InvalidNameError: the word has more parts than a name.
        """
        host, kernel, component, port = split_path(word)
        kernel = f"{host}/{kernel}" if host else kernel or ""
        found = [
            Found(one, name, port or "")
            for one in self.running
            if not kernel or one.fits(kernel)
            for name in _of(one, component, bare=bool(kernel))
        ]
        if not found and not kernel and port:
            found = self._of_lone(component, port)
        if not found and bare:
            found = [Found(one, "") for one in self.running if one.fits(word)]
        if found:
            if not is_glob(word):
                the_one(word, found, _told_apart(found))
            self.check_sure(word, kernel, [one.running for one in found])
            return tuple(found)
        self._nothing(word, kernel, component)

    def having(self, kind: str, word: str) -> list[tuple[Running, str]]:
        """The kernels with a context or connector that a word means, each with that name; none, one or several.

        Args:
            kind: "contexts" or "connectors".
            word: the name of the context or connector, also after the kernel's name and a slash.

        Raises: NoAnswerError: `changing` is set, and a kernel that may have the thing does not answer.
        """
        kernel, _, name = word.rpartition("/")
        found = [(one, name) for one in self.running if (not kernel or one.fits(kernel)) and name in one.names[kind]]
        if found:
            self.check_sure(word, kernel, [one for one, _ in found])
        return found

    def check_sure(self, word: str, kernel: str, found: Sequence[Running]) -> None:
        """Raise NoAnswerError if `changing` is set and the word may also mean a kernel that does not answer."""
        mute = self._mute(kernel) if self.changing else ""
        if mute:
            there = dict.fromkeys(one.name for one in found)
            name = word.rpartition("/")[2]
            raise NoAnswerError(
                f"{word}: in {', '.join(there)}; no answer from {mute}, which may have this name, too; "
                f"write {next(iter(there))}/{name}"
            )

    def _mute(self, kernel: str) -> str:
        """The names of the silent kernels that `kernel` may mean: all, if no kernel is named."""
        mute = [one.entry.name for one in self.silent if not kernel or _matches(one.entry, kernel)]
        return ", ".join(mute[:_SHOWN])

    def component(self, word: str) -> Found:
        """Find the component that a word means; raises as `find`, and AbsentError for any other thing."""
        one = self.find(word)
        one.check("component")
        return one

    def components(self, words: Iterable[str]) -> list[Found]:
        """Find all components that words mean; raises as `all`, and AbsentError where a word means something else."""
        found = [one for word in words for one in self.all(word)]
        for one in found:
            one.check("component")
        return found

    def members(self, running: Running, words: Iterable[str]) -> list[str]:
        """Find components of one kernel by words that may omit its name; raises as `component`."""
        found = [self.component(word if "/" in word else f"{running.name}/{word}") for word in words]
        for one in found:
            if one.running is not running:
                raise AbsentError(f"{one.full}: is of another kernel than {running.name}, where it is to be a member")
        return [one.component for one in found]

    def _of_lone(self, kernel: str, port: str) -> list[Found]:
        """Find a port of a kernel with a single component, such as a filter: KERNEL.PORT is enough."""
        found = []
        for one in self.running:
            own = [name for name in one.names["components"] if name not in _STREAMS]
            if one.fits(kernel) and len(own) == 1:
                found.append(Found(one, own[0], port))
        return found

    def kernel(self, word: str = "") -> Running:
        """The kernel of this name, or the only one that runs; raises as `find`."""
        fitting = [one for one in self.running if not word or one.fits(word)]
        if len(fitting) == 1:
            if self.changing and (mute := self._mute(word)):
                raise NoAnswerError(
                    f"{word or 'no kernel is named'}: {fitting[0].name} runs, and there is no answer from {mute}; "
                    "say which one"
                )
            return fitting[0]
        if not fitting:
            self._nothing(word, word, "")
        shown = ", ".join(_told_apart([Found(one, "") for one in fitting])[:_SHOWN])
        raise AmbiguousError(f"{word or 'no kernel is named, and'} {len(fitting)} kernels run: {shown}; say which one")

    def _nothing(self, word: str, kernel: str, component: str) -> Never:
        """Raise the error for a name that exists in no kernel that answers."""
        what = f"{word}: " if word else ""
        if (kernel or component) and (mute := self._mute(kernel or component)):
            raise NoAnswerError(f"{what}no answer from {mute}; it is stopped, or busy")
        if not kernel and (mute := self._mute("")):
            raise NoAnswerError(f"{what}{'not found, and ' if word else ''}no answer from {mute}")
        if not self.running:
            raise AbsentError(f"{what}nothing runs that can be reached; start it with `aiorts run`, see `aiorts ls`")
        wanted = "component" if component else "kernel"
        if other := self._of_other_kind(kernel if component else "", component or kernel, wanted):
            raise AbsentError(f"{what}no {wanted} that runs has this name; it is {other}")
        among = [one for one in self.running if not kernel or one.fits(kernel)]
        if component and among:
            known = [name for one in among for name in one.names["components"]]
        else:
            known, component = [one.name for one in self.running], ""
        raise _absent(word, component or kernel, known)

    def _of_other_kind(self, kernel: str, name: str, wanted: str) -> str:
        """A text that names the thing of another kind with this name; "" where there is none."""
        for one in self.running:
            if not kernel and wanted != "kernel" and one.name == name:
                return f"a kernel: {one.name}/"
            for kind in ("component", "context", "connector"):
                if kind != wanted and (not kernel or one.fits(kernel)) and name in one.names[f"{kind}s"]:
                    return f"a {kind} of {one.name}"
        return ""

    def close(self) -> None:
        """End the sessions."""
        for one in self.running:
            one.client.close()


@contextmanager
def kernels(
    timeout: float = 1.0,
    select: Callable[[Entry], bool] | None = None,
    *,
    changing: bool = False,
    right: RightName = "",
) -> Iterator[Kernels]:
    """Open a session with each kernel of this user that runs.

    Args:
        timeout: seconds to wait for the first answer.
        select: whether to include a kernel; all by default.
        changing: as in `Kernels`.
        right: as in `Client.open`.
    """
    if _shared:
        yield from _anew(_shared[-1], select, changing=changing)
        return
    wanted = [one for one in entries() if select is None or select(one)]
    running, asked = _told(wanted, right)
    opened, silent = open_all(asked, "names", timeout=timeout, right=right)
    running += [Running(client, names) for client, names in opened]
    running.sort(key=lambda one: one.client.entry.address)
    found = Kernels(running, silent, changing=changing)
    try:
        yield found
    except ClosedError as error:  # the kernel has ended meanwhile, or is about to
        raise AbsentError(str(error)) from None
    finally:
        found.close()


def _told(wanted: Sequence[Entry], right: RightName) -> tuple[list[Running], list[Entry]]:
    """The kernels that told their names without a session, which begins at the first call; and all other kernels."""
    said = said_by_many(wanted, "names")
    running, others = [], []
    for one in wanted:
        names = said.get((one.address, one.epoch)) if one.carried else None
        if names is None:
            others.append(one)
        else:
            entry = Entry(one.address, names.get("pid") or one.pid, one.epoch, one.path, True)
            running.append(Running(Client(entry, right=right, later=True), names))
    return running, others


_shared: Final[list[Kernels]] = []


@contextmanager
def sharing() -> Iterator[None]:
    """Share the sessions that are open now with all commands of the block, whatever right a command needs."""
    with kernels() as found:
        _shared.append(found)
        try:
            yield
        finally:
            _shared.remove(found)


def _anew(shared: Kernels, select: Callable[[Entry], bool] | None, *, changing: bool) -> Iterator[Kernels]:
    """Yield the shared sessions with the present names of their kernels."""
    running = []
    wanted = [one.client for one in shared.running if select is None or select(one.client.entry)]
    said = said_by_many([client.entry for client in wanted if not client.begun], "names")
    for client in wanted:
        names = None if client.begun else said.get((client.entry.address, client.entry.epoch))
        with suppress(ClosedError):
            running.append(Running(client, client.call("names") if names is None else names))
    try:
        yield Kernels(running, shared.silent, changing=changing)
    except ClosedError as error:
        raise AbsentError(str(error)) from None


def _told_apart(found: Sequence[Found]) -> list[str]:
    """The names of things; where several have the same name, with the host."""
    count = Counter(one.full for one in found)
    hosts = [f"{one.client.entry.address.rpartition('/')[0]}/" if count[one.full] > 1 else "" for one in found]
    return [f"{host}{one.full}" for host, one in zip(hosts, found, strict=True)]


def _matches(entry: Entry, kernel: str) -> bool:
    return fnmatchcase(entry.address if "/" in kernel else entry.name, kernel)


def _short(entry: Entry) -> str:
    """The name without the process number with which the default names of kernels end; "" without such a number."""
    short = entry.name.removesuffix(f"-{entry.pid}")
    return "" if short == entry.name else short


def _of(one: Running, component: str, *, bare: bool) -> list[str]:
    """The components of a kernel that a name means; without a name and with `bare`, "" for the kernel itself."""
    if not component:
        return [""] if bare else []
    known = one.names["components"]
    if not is_glob(component):
        return [component] if component in known else []
    return [name for name in known if fnmatchcase(name, component)]


def the_one(word: str, found: Sequence[T], names: Sequence[str]) -> T:
    """The single item of `found`, which is not empty; AmbiguousError, with the names, if `found` has several."""
    if len(found) > 1:
        more = ", ..." if len(names) > _SHOWN else ""
        raise AmbiguousError(
            f"{word}: {len(found)} have this name: {', '.join(names[:_SHOWN])}{more}; write one of these"
        )
    return found[0]


def entry_named(word: str = "") -> Entry:
    """Find the entry of the kernel that a word means, without a session.

    Args:
        word: the kernel's name, "host/name" or the path of its socket; "" is the only one that runs.

    Raises:
        AbsentError: no kernel has the name. AmbiguousError: several kernels have the name; the text lists them.
    """
    if word.startswith("/"):
        return entry_at(word)
    there = entries()
    found = [one for one in there if not word or _matches(one, word)]
    found = found or [one for one in there if _short(one) == word]
    if len(found) > 1:  # kernels that were killed have left their entries
        found = [one for one in found if is_listed(one)]
    if not there or not (found or word):
        raise AbsentError(f"{word and f'{word}: '}nothing runs that can be reached; start it with `aiorts run`")
    if not found:
        raise _absent(word, word, [one.name for one in there])
    return the_one(word or "no kernel is named", found, [one.address for one in found])


def _absent(word: str, name: str, known: Iterable[str]) -> AbsentError:
    """The error for a name that does not exist; its text has the near names, or all."""
    hint = suggestion(name, dict.fromkeys(known), shown=str)
    return AbsentError(f"{word}: nothing that runs has this name; {hint}")


# -- completion --------------------------------------------------------------------------------------------------------

PATIENCE: Final = 0.05
"""Seconds that a press of the Tab key waits for kernels."""


def likely(incomplete: str) -> list[str]:
    """The words that begin with `incomplete`: components, ports after a component's dot, kernels with a slash."""
    with kernels(PATIENCE, right="view") as found:
        head, dot, _ = incomplete.rpartition(".")
        if dot:
            words = [f"{head}.{port}" for one in outlines(found, head) for port in one["ports"]]
        else:
            words = [name for one in found.running for name in one.names["components"]]
            words += [f"{one.name}/" for one in found.running]
            if "/" in incomplete:
                words += [f"{one.name}/{name}" for one in found.running for name in one.names["components"]]
    return [word for word in dict.fromkeys(words) if word.startswith(incomplete)]


def fitting(word: str, incomplete: str) -> list[str]:
    """The ports that begin with `incomplete` and can be connected with the port that a word means, in its kernel."""
    with kernels(PATIENCE, right="view") as found:
        try:
            port = found.find(word)
            fits = port.client.call("fits", PATIENCE, port=port.path, fitting=True)
        except AiortsError:
            return []
        kernel = f"{port.running.name}/" if "/" in incomplete else ""
    return [path for one in fits if (path := f"{kernel}{one}").startswith(incomplete)]


def offered() -> dict[str, list[str]]:
    """The types of components that running kernels can create: by name, the parameters that are known."""
    with kernels(PATIENCE, right="view") as found:
        types: dict[str, list[str]] = {}
        for one in found.running:
            with suppress(AiortsError):
                for name, described in one.client.call("catalogue", PATIENCE)["components"].items():
                    types.setdefault(name, []).extend(described["params"])
    return types


def outlines(found: Kernels, word: str) -> list[Any]:
    """The outlines of the components that a word means; none where no answer comes within `PATIENCE`."""
    try:
        return [
            one.client.call("outline", PATIENCE, components=[one.component])[one.component] for one in found.all(word)
        ]
    except (AiortsError, KeyError):
        return []
