"""A whole system as it is to be, as values: components, connections, contexts, composites, and rules of recovery.

A system file is read into `Wanted`, and a kernel can be described as one: what differs between two is what has to be
done.
"""
