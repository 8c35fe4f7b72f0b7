"""Where things are: the scene found in a clip, its centre frame by frame, corners, orbits and tilt."""
