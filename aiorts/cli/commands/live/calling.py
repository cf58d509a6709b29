"""`aiorts call` and `goal`: call methods of services in running kernels."""

from __future__ import annotations

from typing import Any

import click

from aiorts import exits
from aiorts.cli.commands.live.components import pairs, right_for
from aiorts.cli.commands.live.showing import json_option, timeout_option
from aiorts.cli.commands.live.target import Found, complete, kernels
from aiorts.cli.console.output import say, say_either, say_line, say_now
from aiorts.errors import AbsentError, GoalCancelled, GoalFailed

_WORDS: Any = "[VALUE | NAME=VALUE]..."


@click.command(short_help="Call a service of what runs.")
@click.argument("path", metavar="COMPONENT.PORT.METHOD", shell_complete=complete)
@click.argument("words", nargs=-1, metavar=_WORDS)
@timeout_option(5.0, "Give up after S seconds")
@json_option('One JSON document: {"value": ...}.')
def call(path: str, words: tuple[str, ...], timeout: float, as_json: bool) -> int:
    """Call METHOD and print its result as JSON; what returns nothing prints nothing.

    Arguments are given by position, by NAME=VALUE, or all of them as one JSON list or object. Each is read by the type
    that the interface says: a number, a text, JSON for records and lists. Ctrl-C cancels the call.
    """
    with kernels(changing=True, right=right_for(map(_value, words))) as found:
        one = found.find(path)
        answer = one.client.call("call", timeout + 2.0, timeout=timeout, **_given(one, path, words))
    if as_json or answer["value"] is not None:
        say_either(answer, lambda: _text(answer["value"]), as_json=as_json)
    return exits.DONE


@click.command(short_help="Send a goal, and show its feedback.")
@click.argument("path", metavar="COMPONENT.PORT.METHOD", shell_complete=complete)
@click.argument("words", nargs=-1, metavar=_WORDS)
@timeout_option(5.0, "Wait S seconds until it is accepted")
@json_option("A JSON object in a line for each feedback, and for the end.")
def goal(path: str, words: tuple[str, ...], timeout: float, as_json: bool) -> int:
    """Send a goal to METHOD, print its feedback as it comes and, at the end, its result.

    Arguments are those of aiorts call. Ctrl-C asks to cancel it, as any end of this command does. The status is 1 where
    it failed or was cancelled.
    """
    with kernels(changing=True, right=right_for(map(_value, words))) as found:
        one = found.find(path)
        stream = one.client.stream("goal", timeout + 2.0, timeout=timeout, **_given(one, path, words))
        for feedback in stream:
            if as_json:
                say_line({"feedback": feedback, "missed": stream.missed})
            else:
                say_now(_text(feedback))
        end = stream.result
    if as_json:
        say_line(end)
    elif end["state"] != "succeeded":
        raise (GoalCancelled if end["state"] == "cancelled" else GoalFailed)(end["text"])
    elif end["result"] is not None:
        say(_text(end["result"]))
    return exits.DONE if end["state"] == "succeeded" else exits.FAILED


def _given(one: Found, path: str, words: tuple[str, ...]) -> dict[str, Any]:
    """The arguments of the operation: the path within the kernel, and the method's arguments."""
    one.check("port")
    if "." not in one.port:
        raise AbsentError(f"{path}: is a port; expected COMPONENT.PORT.METHOD")
    whole = _json(words[0]) if len(words) == 1 else None
    if isinstance(whole, dict):
        return {"path": one.path, "kwargs": whole}
    if isinstance(whole, list):
        return {"path": one.path, "args": whole}
    named = tuple(word for word in words if _value(word) != word)
    return {"path": one.path, "args": [word for word in words if word not in named], "kwargs": pairs(named)}


def _value(word: str) -> str:
    """The value of NAME=VALUE; any other word is a value itself."""
    name, sign, value = word.partition("=")
    return value if sign and name.isidentifier() else word


def _json(word: str) -> Any:
    """The JSON list or object that a word spells; None where it is neither."""
    from json import loads

    if not word.startswith(("{", "[")):
        return None
    try:
        return loads(word)
    except (ValueError, RecursionError):
        return None


def _text(value: Any) -> str:
    from json import dumps

    from aiorts.cli.console.output import plain

    return dumps(plain(value), allow_nan=False)
