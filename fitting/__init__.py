"""Friction models of a two-body gyroscope: fit them, see where they fail, learn what is missing."""
