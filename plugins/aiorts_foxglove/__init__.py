"""`aiorts foxglove`: shows a running system in Foxglove, over its documented WebSocket protocol.

`source` takes samples from the kernel's local socket in a thread of its own; `serving` passes them to the viewers, each
of which has a bounded queue (`viewer`). `protocol` has the messages, `admission` the rule for connecting.
"""
