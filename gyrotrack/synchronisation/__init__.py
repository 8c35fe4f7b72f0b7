"""One clock for all cameras, from the angle of the casing, which every film shows."""
