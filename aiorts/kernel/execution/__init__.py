"""Execution: contexts, their members, the cycle as steps, and the driver that carries the steps out.

The cycle (`cycle.py`) decides and never waits; the driver (`task_driver.py`) waits and runs hooks. A context needs of
a component and of a kernel what the protocols in `cell.py` say; other rooms ask of a context what `runner.py` offers.
"""
