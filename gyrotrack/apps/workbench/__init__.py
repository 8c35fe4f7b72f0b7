"""The workbench: a page in the browser, served to this machine only."""
