"""A whole system as it is to be, as values: components, connections, contexts, composites, and rules of recovery.

A system file is read into `Wanted`, and a kernel can be described as one: the differences of two are the changes to
make.
"""
