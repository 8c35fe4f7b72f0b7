"""Applications: command line, report, workbench, batch. They combine tracking and fitting."""
