"""Between a profile of OpenRTM and `Wanted`, the description of a system that a system file is; both ways."""
