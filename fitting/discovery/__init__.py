"""Finding the missing effect: score, refine, select, test of lack of fit, verdict."""
