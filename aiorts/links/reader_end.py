"""The connector at the reader's end of a link: its options, and the check of what is written to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from aiorts.model.buffer import FullPolicy
from aiorts.model.policy import Dataflow, Push, Stamp, Subscription

if TYPE_CHECKING:
    from aiorts.model.links import Buffer
    from aiorts.model.profile import ConnectorProfile


def reader_options(profile: ConnectorProfile) -> dict[str, Any]:
    """The options of the connector at the reader's end, by those that the link was made with.

    A link loses nothing inside its window: what finds the reader's buffer full waits at the reader's end, and when the
    window is used up the writer's buffer decides. With flush the writer waits for the answer, so the policy of the full
    buffer is the reader's own.
    """
    options: dict[str, Any] = {"timeout": None, "allow_duplicate": True}
    if profile.push is not Push.NEW:
        options["length"] = profile.length
    options |= {"keep_last": profile.keep_last, "lifespan": profile.lifespan, "max_gap": profile.max_gap}
    if profile.stamp in (Stamp.RECEIVED, Stamp.READ):
        options["stamp"] = profile.stamp
    if profile.dataflow is Dataflow.PULL:
        del options["length"]
        return {**options, "dataflow": profile.dataflow}
    if profile.subscription is Subscription.FLUSH:
        return {**options, "full": profile.full}
    if profile.push is Push.NEW:
        return {**options, "subscription": Subscription.NEW, "push": Push.NEW}
    return {**options, "full": FullPolicy.BLOCK}


def of_shape(
    decode: Callable[[Buffer, Sequence[Buffer]], Any], check: Callable[[Any, Any], object], shape: tuple[int, ...]
) -> Callable[[Buffer, Sequence[Buffer]], Any]:
    """The same `decode`, whose samples must have this shape."""

    def checked(head: Buffer, parts: Sequence[Buffer]) -> Any:
        sample = decode(head, parts)
        check(sample, shape)
        return sample

    return checked
