"""Compiled kernels of tracking."""
