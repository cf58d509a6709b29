"""`aiorts bench links`: connectors into another process, beside a bare socket pair and bare Zenoh."""
