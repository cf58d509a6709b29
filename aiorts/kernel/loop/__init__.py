"""The kernel's use of an event loop: tasks, timers, threads that wait, the bus of events, log lines.

It knows no component and no context. Contexts, ports and services stand on it.
"""
