"""Operations that call services: a call and its result, a goal with its feedback and end."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING, Any, Final, Literal, cast

from aiorts.control.operation import Operation, Right
from aiorts.control.operations.known import absent, component_named
from aiorts.control.session import Session, Stream
from aiorts.control.values import Done
from aiorts.errors import AbsentError, ControlError, GoalCancelled, GoalFailed
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.late import dataclass
from aiorts.model.plain import Schemas, empty, plain

if TYPE_CHECKING:
    from aiorts.model.interface import Method
    from aiorts.services import Goal, OutsideCaller, ServicePort


@dataclass(frozen=True, slots=True)
class Calling:
    """A call of a method of a service."""

    path: str
    """ "component.port.method", with the interface before a method that several interfaces of the port have."""
    args: tuple[Any, ...] = ()
    """The arguments by position; a text is read by the type that the interface declares."""
    kwargs: Mapping[str, Any] = field(default_factory=empty)
    """The arguments by name."""
    timeout: float = 5.0
    """Seconds of the kernel's clock until the call is given up."""


@dataclass(frozen=True, slots=True)
class Result:
    """The answer of a method."""

    value: Any = None


@dataclass(frozen=True, slots=True)
class GoalEnd:
    """The end of a goal."""

    state: str
    """ "succeeded", "failed" or "cancelled"."""
    result: Any = None
    reason: str = ""
    """The reason of a failed goal under which `GoalStatistics.failed` counts it."""
    text: str = ""
    """The text of the failure or cancellation."""


@dataclass(frozen=True, slots=True)
class ServiceNamed:
    """A service port."""

    port: str
    """ "component.port"."""


@dataclass(frozen=True, slots=True)
class MethodTypes:
    """The types of a method, each as the text of a JSON Schema."""

    parameters: Mapping[str, str]
    """The parameters by name, in order: the schema of the values, with the default where there is one."""
    required: tuple[str, ...]
    """The parameters that have to be given."""
    returns: str
    """The schema of the result; where the method answers with a goal, of the goal's result."""
    feedback: str | None = None
    """The schema of the feedback of a method that answers with a goal; None of any other method."""


@dataclass(frozen=True, slots=True)
class InterfaceTypes:
    """The types of an interface of a service port; `PortProfile` has the docs of its methods."""

    type: str
    polarity: Literal["provided", "required"]
    methods: Mapping[str, MethodTypes]


def _interfaces(session: Session, given: ServiceNamed) -> dict[str, InterfaceTypes]:
    name, _, port = given.port.partition(".")
    ends = _service_port(session, name, port).interfaces
    return {
        one.instance: InterfaceTypes(
            one.spec.name,
            cast("Literal['provided', 'required']", one.polarity),
            {method.name: _types(method) for method in one.spec.methods.values()},
        )
        for one in ends
    }


def _types(method: Method) -> MethodTypes:
    from aiorts.control.operations.arguments import value_schema  # late: it needs the record types
    from aiorts.services import goal_types

    goal = goal_types(method.returns)
    parameters = {}
    for one in method.parameters:
        default = {} if one.default in (one.empty, None) else {"default": plain(one.default)}
        parameters[one.name] = json.dumps({**value_schema(one.annotation), **default})
    return MethodTypes(
        parameters,
        tuple(one.name for one in method.parameters if one.default is one.empty),
        _answer_schema(method.returns if goal is None else goal.result),
        None if goal is None else _answer_schema(goal.feedback),
    )


def _answer_schema(hint: Any) -> str:
    schemas = Schemas()
    try:
        schema = schemas.of(hint)
    except TypeError:  # a type without a schema
        return "{}"
    return json.dumps({**schema, "$defs": schemas.definitions} if schemas.definitions else schema)


async def _call(session: Session, given: Calling) -> Result:
    caller, method = _caller(session, given)
    try:
        if caller.answers_with_goal(method):
            raise ControlError(f"{given.path}: answers with a goal; send it with `aiorts goal`")
        return Result(await _answer(caller, method, given))
    finally:
        caller.close()


async def _goal(session: Session, given: Calling, stream: Stream) -> Done:
    """Send a goal and stream its feedback until its end; a stream that ends before cancels the goal."""
    caller, method = _caller(session, given)
    try:
        if not caller.answers_with_goal(method):
            raise ControlError(f"{given.path}: answers at once, with no goal; call it with `aiorts call`")
        goal = await _answer(caller, method, given)
    except BaseException:
        caller.close()
        raise
    task = kernel_task(session.kernel.loop, _follow(goal, stream), f"aiorts control goal {given.path}")
    task.add_done_callback(lambda _: caller.close())
    stream.on_close(lambda: None if asyncio.current_task() is task else task.cancel())
    return Done()


async def _answer(caller: OutsideCaller, method: str, given: Calling) -> Any:
    from aiorts.control.operations.arguments import read_arguments  # late: it needs the record types

    args, kwargs = read_arguments(given.path, caller.signature(method), given.args, given.kwargs)
    return await caller.call(method, args, kwargs, given.timeout)


async def _follow(goal: Goal[Any, Any], stream: Stream) -> None:
    async for feedback in goal:
        stream.send(feedback)
    try:
        stream.finish(GoalEnd("succeeded", await goal.result()))
    except GoalFailed as error:
        stream.finish(GoalEnd("failed", reason=error.reason, text=str(error)))
    except GoalCancelled as error:
        stream.finish(GoalEnd("cancelled", text=str(error)))


def _caller(session: Session, given: Calling) -> tuple[OutsideCaller, str]:
    """Make a caller of the interface that a path means; returns it with the name of the method."""
    from aiorts.services import OutsideCaller, Provided  # late: most systems have no services

    name, *rest = given.path.split(".")
    if not 2 <= len(rest) <= 3:
        raise AbsentError(f"{given.path:.80}: expected component.port.method")
    port, *_, method = rest
    ends = [one for one in _service_port(session, name, port).interfaces if isinstance(one, Provided)]
    if len(rest) == 3:
        named = [one for one in ends if one.instance == rest[1]]
        if not named:
            what = f"{name}.{port}.{rest[1]:.80}: no such interface that is provided"
            raise absent(what, rest[1], [one.instance for one in ends])
        ends = named
    having = [one for one in ends if method in one.spec.methods]
    if len(having) > 1:
        paths = ", ".join(f"{name}.{port}.{one.instance}.{method}" for one in having)
        raise AbsentError(f"{given.path}: {len(having)} interfaces have this method: {paths}; say which")
    if not having:
        methods = [each for one in ends for each in one.spec.methods]
        raise absent(f"{given.path:.80}: no such method that is provided", method, methods)
    return OutsideCaller(having[0]), method


def _service_port(session: Session, name: str, port: str) -> ServicePort:
    from aiorts.services import ServicePort  # late: most systems have no services

    found = component_named(session, name).ports
    services = {path: one for path, one in found.items() if isinstance(one, ServicePort)}
    if port not in services:
        raise absent(f"{name}.{port:.80}: no such service port", port, services)
    return services[port]


def _provider(given: Calling, _: object) -> tuple[str]:
    return (given.path.partition(".")[0],)


ROWS: Final = (
    Operation("call", "Call a method of a service.", Calling, Result, Right.OPERATE, _call, changes=_provider),
    Operation(
        "goal",
        "Send a goal, and stream its feedback.",
        Calling,
        Done,
        Right.OPERATE,
        _goal,
        item=Any,
        end=GoalEnd,
        changes=_provider,
    ),
    Operation(
        "interfaces",
        "The interfaces of a service port, with the types of their methods.",
        ServiceNamed,
        Mapping[str, InterfaceTypes],
        Right.VIEW,
        _interfaces,
        idempotent=True,
    ),
)
