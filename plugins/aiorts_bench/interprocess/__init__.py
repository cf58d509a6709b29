"""`aiorts bench links` and `isolation`: other processes, beside a bare socket pair and bare Zenoh."""
