"""Profiles of systems (RtsProfile) and of component types (RTC.xml), as frozen values with the place of each."""
