"""Contract suites for plugin authors: what a type cannot say, as functions that raise."""
