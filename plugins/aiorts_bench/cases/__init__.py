"""The other benches: codecs, records, services, scale, start-up, recordings."""
