"""Rendered films of the experiment with exactly known angles."""
