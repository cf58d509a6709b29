"""`aiorts studio`: running systems over HTTP, for pages, notebooks and other programs.

`codes` decides who may come in, `guard` what a request must look like, `values` what its JSON may have in it. `openapi`
describes the operations of the kernel's table, `kernels` carries the calls out, `api` and `socket` answer, `serving`
waits.
"""
