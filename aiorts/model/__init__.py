"""The RTC model as values and pure machines: nothing here waits, does I/O, logs or asks what time it is."""
