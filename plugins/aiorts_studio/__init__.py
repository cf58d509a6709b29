"""`aiorts studio`: running systems over HTTP, for pages, notebooks and other programs.

`codes` decides which clients are let in, `guard` checks the form of requests, `plain/values` their JSON. `openapi`
describes the operations of the kernel's table, `kernels` carries the calls out, `api` and `socket` answer, `serving`
waits.
"""
