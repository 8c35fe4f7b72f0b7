"""Applications: command line, report, workbench, batch. Here tracking and fitting meet."""
