"""What holds a device ends before its replacement is made, as its class or the system file says."""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts import Kernel
from aiorts.errors import ApplyError
from aiorts.planning import wanted_of
from aiorts.system import build, load, wanted
from aiorts.testing import simulate

PARTS = """
from aiorts import Component

OPEN = []
LOG = []


class Camera(Component):
    def on_initialize(self):
        if OPEN:
            raise OSError(f"the device is held by {OPEN[0]}")
        OPEN.append(self.name)
        LOG.append(f"+{self.name}")

    def on_finalize(self):
        OPEN.remove(self.name)
        LOG.append(f"-{self.name}")


class Better(Camera):
    pass


class Failing(Camera):
    def on_activated(self):
        raise ValueError("dark")
"""


def a_system(folder: Path, name: str, kind: str, exclusive: str = "exclusive = true\n") -> Path:
    file = folder / f"{name}{kind}.toml"
    file.write_text(
        f'schema = 1\n[components.{name}]\ntype = "cameras.py:{kind}"\n{exclusive}'
        f'[contexts.all]\nkind = "periodic"\nrate = 10.0\nmembers = ["{name}"]\n'
    )
    return file


@pytest.mark.parametrize(("name", "kind"), [("camera", "Better"), ("other", "Camera"), ("other", "Better")])
def test_it_ends_before_its_replacement_is_made(tmp_path: Path, name: str, kind: str) -> None:
    (tmp_path / "cameras.py").write_text(PARTS)

    async def changed() -> list[str]:
        async with Kernel() as kernel:
            await build(kernel, load(a_system(tmp_path, "camera", "Camera")))
            await kernel.sleep(0.2)
            applied = await kernel.apply(wanted(load(a_system(tmp_path, name, kind))))
            assert applied.done
            found = kernel.components[name]
            assert type(found).__name__ == kind
            assert str(found.states["all"]) == "active"
            assert wanted_of(kernel).components[name].exclusive
            saved = tmp_path / "saved.toml"
            await kernel.save(saved)
            assert "exclusive = true" in saved.read_text()
            return list(type(found).on_initialize.__globals__["LOG"])

    assert simulate(changed()) == ["+camera", "-camera", f"+{name}"]


def test_it_is_made_anew_when_the_plan_is_taken_back(tmp_path: Path) -> None:
    (tmp_path / "cameras.py").write_text(PARTS)

    async def taken_back() -> list[str]:
        async with Kernel() as kernel:
            await build(kernel, load(a_system(tmp_path, "camera", "Camera")))
            before = kernel.components["camera"]
            with pytest.raises(ApplyError, match="dark") as refused:
                await kernel.apply(wanted(load(a_system(tmp_path, "camera", "Failing"))))
            assert refused.value.not_undone == ("camera: was made anew: what it held in attributes is lost",)
            now = kernel.components["camera"]
            assert now is not before
            assert type(now) is type(before)
            assert str(now.states["all"]) == "active"
            return list(type(now).on_initialize.__globals__["LOG"])

    assert simulate(taken_back()) == ["+camera", "-camera", "+camera", "-camera", "+camera"]


def test_without_it_what_was_there_is_parked_and_the_device_is_held(tmp_path: Path) -> None:
    (tmp_path / "cameras.py").write_text(PARTS)

    async def refused() -> None:
        async with Kernel() as kernel:
            await build(kernel, load(a_system(tmp_path, "camera", "Camera", "")))
            before = kernel.components["camera"]
            with pytest.raises(ApplyError, match="the device is held by camera"):
                await kernel.apply(wanted(load(a_system(tmp_path, "other", "Camera", ""))))
            assert kernel.components["camera"] is before

    simulate(refused())


@pytest.mark.parametrize("text", ["exclusive = 1\n", 'exclusive = "yes"\n'])
def test_it_is_true_or_false(tmp_path: Path, text: str) -> None:
    from aiorts.system import check

    (tmp_path / "cameras.py").write_text(PARTS)
    (found,) = check(a_system(tmp_path, "camera", "Camera", text))
    assert "exclusive" in found.message or "true or false" in found.message
