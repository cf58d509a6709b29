"""Commands for running systems: each opens a short session with the kernels that it needs, and ends.

Imports here decide how long a command takes: no event loop, no numpy, no kernel.
"""
