"""From measurements to parameters: data, noise, likelihood, optimisation, result."""
