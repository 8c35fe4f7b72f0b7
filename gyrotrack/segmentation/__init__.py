"""Pixels of a frame told apart: the chroma of a colour, coloured blobs, and rings unrolled about a centre."""
