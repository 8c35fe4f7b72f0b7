"""Rendered films of the experiment whose true angles are known exactly."""
