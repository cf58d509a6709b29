"""Commands for running systems: each opens a short session with the kernels that are meant, and ends.

What is imported here decides how long a command takes: no event loop, no numpy, no kernel.
"""
