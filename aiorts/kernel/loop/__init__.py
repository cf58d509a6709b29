"""What the kernel does with an event loop: tasks, timers, threads that wait, the bus of events, log lines.

It knows no component and no context. Contexts, ports and services stand on it.
"""
