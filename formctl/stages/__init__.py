"""What the commands do, as functions with plain arguments: for the command line, for notebooks and for tests."""
