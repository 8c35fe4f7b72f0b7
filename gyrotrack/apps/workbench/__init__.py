"""The workbench: a page in the browser, served on this machine only."""
