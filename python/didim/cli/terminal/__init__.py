"""Output on a terminal: width, colours, help, completion; independent of results."""
