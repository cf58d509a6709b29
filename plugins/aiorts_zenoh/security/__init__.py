"""Who may do what over the network: certificates, the access table made from their names, and why one was refused.

Nothing here knows the engine or a kernel.
"""
