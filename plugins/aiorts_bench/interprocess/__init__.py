"""`aiorts bench links` and `isolation`: other processes, next to a bare socket pair and bare Zenoh."""
