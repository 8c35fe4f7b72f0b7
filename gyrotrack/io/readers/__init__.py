"""Readers of files written by other programs."""
