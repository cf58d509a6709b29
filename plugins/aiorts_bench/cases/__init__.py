"""The benches of codecs, records, services, scale, start-up and recordings."""
