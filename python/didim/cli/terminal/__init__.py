"""What a terminal asks for: a width, colours, help, completion. Nothing here knows a result."""
