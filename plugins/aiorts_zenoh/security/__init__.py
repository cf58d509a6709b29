"""Security of the network: certificates, the access table made from their names, and the reasons of refusals.

Nothing here knows the engine or a kernel.
"""
