"""The command line: one module per command, and what a command does where that is not done elsewhere."""
