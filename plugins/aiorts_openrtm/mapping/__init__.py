"""Maps profiles of OpenRTM to `Wanted`, the description of a system that a system file is, and back."""
