"""What `didim check` looks for in a log, one idea per module; `didim.check` runs them in order."""
