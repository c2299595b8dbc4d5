"""The workbench: a folder of studies and records in the browser, served on this machine alone."""
