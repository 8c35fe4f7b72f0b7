"""From films of a spinning gyroscope to the physics that its model is missing."""

__version__ = "0.1.0"
