"""Synchronisation of the cameras by the angle of the casing, which all films show."""
