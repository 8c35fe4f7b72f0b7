"""Laws beyond the library: which formula of a speed or an angle describes a residual torque."""
