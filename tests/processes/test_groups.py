"""Groups of cgroup v2 are made and bounded by small files, and where they cannot be the reason is said.

The files of the tests are in a plain folder: they show what is written, not what a kernel makes of it.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from aiorts.processes.groups import (
    Group,
    Refused,
    cpu_bound,
    killed_for_memory,
    own_group,
    processes_bound,
    remove_old,
)


def delegated(folder: Path, controllers: str = "cpu pids") -> str:
    (folder / "cgroup.controllers").write_text(controllers)
    (folder / "cgroup.subtree_control").write_text("")
    return str(folder)


def test_a_group_has_its_bounds_and_its_process(tmp_path: Path) -> None:
    group = Group(delegated(tmp_path), "aiorts-1-1", [cpu_bound(0.25), processes_bound(20)])
    group.add(77)
    group.kill()
    assert (tmp_path / "cgroup.subtree_control").read_text() == "+cpu +pids"
    made = {path.name: path.read_text() for path in (tmp_path / "aiorts-1-1").iterdir()}
    assert made == {"cpu.max": "25000 100000", "pids.max": "20", "cgroup.procs": "77", "cgroup.kill": "1"}


def test_a_group_is_removed_when_nothing_is_in_it(tmp_path: Path) -> None:
    group = Group(delegated(tmp_path), "aiorts-1-1", [])
    (tmp_path / "aiorts-1-1" / "process").touch()
    assert not group.remove()
    (tmp_path / "aiorts-1-1" / "process").unlink()
    assert group.remove()
    assert group.remove()


def test_why_there_is_no_group_is_said(tmp_path: Path) -> None:
    with pytest.raises(Refused, match=r"has no controller pids$"):
        Group(delegated(tmp_path, "cpu"), "one", [cpu_bound(0.5), processes_bound(3)])
    with pytest.raises(Refused, match="is not delegated: No such file"):
        Group(str(tmp_path / "absent"), "one", [processes_bound(3)])
    (tmp_path / "cgroup").write_text("3:cpu:/\n")
    with pytest.raises(Refused, match="this system has no cgroup v2"):
        own_group(str(tmp_path))


def test_the_own_group_is_where_it_is_mounted(tmp_path: Path) -> None:
    (tmp_path / "cgroup").write_text("1:cpu:/\n0::/user.slice/a.service\n")
    (tmp_path / "mountinfo").write_text("41 31 0:38 / /sys/fs/cgroup rw,relatime - cgroup2 cgroup2 rw\n")
    assert own_group(str(tmp_path)) == "/sys/fs/cgroup/user.slice/a.service"
    (tmp_path / "cgroup").write_text("0::/\n")
    assert own_group(str(tmp_path)) == "/sys/fs/cgroup"


def test_groups_of_helpers_that_were_killed_are_removed(tmp_path: Path) -> None:
    for name in ("aiorts-1-4", "aiorts-99999999-1", "other"):
        (tmp_path / name).mkdir()
    remove_old(str(tmp_path), "aiorts-")
    assert {path.name for path in tmp_path.iterdir()} == {"aiorts-1-4", "other"}


def test_the_nearest_count_of_kills_for_memory_is_taken(tmp_path: Path) -> None:
    near, far = tmp_path / "memory.events", tmp_path / "vmstat"
    far.write_text("pgfault 9\noom_kill 7\n")
    assert killed_for_memory([str(near), str(far)]) == 7
    near.write_text("oom 4\noom_kill 3\noom_group_kill 0\n")
    assert killed_for_memory([str(near), str(far)]) == 3
    assert killed_for_memory([]) == 0
    assert killed_for_memory() >= 0
