"""Effects: torque laws with parameters; the library, and laws written by users."""
