"""The equations of motion, their solution, and its sensitivities."""
