"""Composites with members in a kernel that is reached over the network alone."""

from __future__ import annotations

import os
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from anyio import fail_after

from aiorts import Composite, Kernel, LifecycleState, PeriodicContext
from aiorts.errors import DeniedError
from aiorts.types import TimedLong
from remote_parts import Local, left, until

pytest.importorskip("zenoh")

from network.certificate_parts import folder
from network.network_parts import free_port

pytestmark = [pytest.mark.anyio, pytest.mark.row(101)]
ACTIVE, ERROR, INACTIVE = LifecycleState.ACTIVE, LifecycleState.ERROR, LifecycleState.INACTIVE


@asynccontextmanager
async def two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *words: str, certificates: Path | None = None
) -> AsyncIterator[tuple[Kernel, Any]]:
    """A kernel here, and one with another folder of sockets, as on another host."""
    port = free_port()
    secured = ("--insecure-network",) if certificates is None else ("--certs", str(certificates))
    network = ("--listen", f"127.0.0.1:{port}", *secured, "--host", "pc2", *words)
    async with left(tmp_path, "left", *network) as process:
        with tempfile.TemporaryDirectory(prefix="al") as folder:
            monkeypatch.setitem(os.environ, "XDG_RUNTIME_DIR", folder)
            how = {"insecure": True} if certificates is None else {"certificates": certificates}
            zenoh = {"connect": f"127.0.0.1:{port}", "host": "pc1", **how}
            async with Kernel("right", services={"links": {}, "zenoh": zenoh}) as kernel:
                yield kernel, process


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
@pytest.mark.row(15)
@pytest.mark.parametrize("certified", [False, True])
async def test_a_member_of_another_host_is_one_like_any_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, certified: bool
) -> None:
    certificates = folder(tmp_path / "certs", left="component", right="coordinator").path if certified else None
    async with two(tmp_path, monkeypatch, "--allow-control", certificates=certificates) as (kernel, process):
        source = await kernel.create(Local, "source")
        arm = await kernel.add(Composite("arm", Local("near"), "left/gripper", exported=["gripper.*"]))
        await kernel.connect(source.out, arm.ports["inp"], length=100)
        await kernel.connect(arm.ports["force"], source.inp, length=100)
        await kernel.start(PeriodicContext(100.0), arm, activate=True)
        await kernel.components["gripper"].configure(factor=3)
        for value in range(100):
            source.out.write_nowait(TimedLong(0, value))
        seen: list[int] = []
        with fail_after(20):
            while len(seen) < 100:
                seen.append((await source.inp.read()).data)
        assert seen == [3 * value for value in range(100)]
        process.kill()
        await until(lambda: [member.state for member in arm.members] == [INACTIVE, ERROR])
        assert "left/gripper: its kernel left is lost" in str(arm.last_error)


@pytest.mark.slow(
    kept_by="remote/test_two_kernels.py::test_a_member_elsewhere_has_the_ports_the_lifecycle_the_values_and_the_errors_of_the_component"
)
async def test_a_kernel_without_allow_control_has_no_members(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async with two(tmp_path, monkeypatch) as (kernel, _):
        with pytest.raises(
            DeniedError, match=r"pc2/left/gripper: pc2/left lets this kernel look only.*--allow-control"
        ):
            await kernel.add(Composite("arm", "pc2/left/gripper"))
        assert not kernel.components


@pytest.mark.slow
async def test_a_kernel_that_is_certified_as_component_operates_no_other_one_and_is_told_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    certificates = folder(tmp_path / "certs", left="component", right="component").path
    async with two(tmp_path, monkeypatch, "--allow-control", certificates=certificates) as (kernel, _):
        with pytest.raises(DeniedError, match=r"pc2/left: right has the role component, which.*coordinator"):
            await kernel.add(Composite("arm", "left/gripper"))
        assert not kernel.components
