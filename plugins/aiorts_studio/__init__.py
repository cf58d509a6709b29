"""`aiorts studio`: running systems over HTTP, for pages, notebooks and other programs.

`codes` decides which clients are admitted, `guard` checks the form of requests, `plain/values` their JSON. `openapi`
describes the operations of the kernel's table, `kernels` carries out the calls, `api` and `socket` send the answers,
and `serving` runs the server.
"""
