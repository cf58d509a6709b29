"""OpenRTM's configuration files: `rtc.conf` of a manager, and the `.conf` of a component."""
