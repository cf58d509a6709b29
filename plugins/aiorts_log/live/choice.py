"""The ports of a kernel to record: the meaning of words of the command line, now and when there are more ports."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, Final

from aiorts.errors import AbsentError, AmbiguousError
from aiorts.sessions import Kernels, Running, is_glob
from aiorts.spelling import suggestion

_SHOWN: Final = 10


class Choice:
    """The out-ports that the words of a command line mean.

    Attributes:
        running: the kernel.
        exact: the ports that are named one by one: each has to be there.
    """

    def __init__(self, found: Kernels, words: Sequence[str], excluded: Sequence[str] = ()) -> None:
        """Find the kernel.

        Raises:
            AbsentError: nothing has such a name.
            AmbiguousError: several things have one name, or several kernels are meant.
            NoAnswerError: the kernel that may be meant does not answer.
        """
        meant = [(word, one) for word in words for one in found.all(word)]
        if len({one.running.name for _, one in meant}) > 1:
            names = ", ".join(one.full for _, one in meant[:_SHOWN])
            raise AmbiguousError(f"{names}: of several kernels; a recording is of one, so name ports of one")
        self.running: Running = meant[0][1].running if meant else found.kernel()
        self.exact: list[str] = []
        self._globs: list[str] = []
        self._words: dict[str, str] = {}
        """The word that each glob came from, without words for kernels, which may have no port yet."""
        for word, one in meant:
            component = word.rpartition("/")[2].partition(".")[0]
            glob = f"{component if is_glob(component) else one.component or '*'}.{one.port or '*'}"
            if one.port and not is_glob(glob):
                self.exact.append(one.path)
            else:
                self._globs.append(glob)
                if one.component:
                    self._words[glob] = word
        if not words:
            self._globs.append("*.*")
        self._excluded = [glob if "." in glob else f"{glob}.*" for glob in excluded]

    def of(self, outlines: Mapping[str, Any]) -> list[str]:
        """The ports of these components that the words mean, those named one by one first."""
        there = list(_out_ports(outlines))
        named = [path for path in dict.fromkeys(self.exact) if path in there]
        others = [path for path in there if path not in named and _fits(path, self._globs)]
        return [path for path in named + others if not _fits(path, self._excluded)]

    def check(self, outlines: Mapping[str, Any]) -> None:
        """Refuse a word that means no port.

        Raises:
            AbsentError: a word means no port; the message says which ports there are.
        """
        there = list(_out_ports(outlines))
        for path in self.exact:
            if path not in there:
                raise AbsentError(f"{path}: {_why_not(path, outlines, there)}")
        for glob, word in self._words.items():
            if not any(_fits(path, [glob]) for path in there):
                raise AbsentError(f"{word}: has no out-port; there are {_few(there)}")


def _out_ports(outlines: Mapping[str, Any]) -> Iterable[str]:
    for component, outline in outlines.items():
        for name, port in outline["ports"].items():
            if port["direction"] == "out":
                yield f"{component}.{name}"


def _why_not(path: str, outlines: Mapping[str, Any], there: list[str]) -> str:
    component, _, name = path.partition(".")
    port = outlines.get(component, {"ports": {}})["ports"].get(name)
    if port is not None:
        kind = "an in-port" if port["direction"] == "in" else "no port of samples"
        return f"is {kind}; out-ports are recorded, such as {_few(there)}"
    own = [one for one in there if one.startswith(f"{component}.")]
    return f"no such port; {suggestion(path, there, f'there are {_few(own or there)}', shown=str)}"


def _fits(path: str, globs: Iterable[str]) -> bool:
    return any(all(map(fnmatchcase, path.partition("."), glob.partition("."))) for glob in globs)


def _few(names: Sequence[str]) -> str:
    return f"{', '.join(names[:_SHOWN])}{', ...' if len(names) > _SHOWN else ''}" if names else "none"
