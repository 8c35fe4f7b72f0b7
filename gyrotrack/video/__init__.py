"""Films: decoding, time base, repeated frames."""
