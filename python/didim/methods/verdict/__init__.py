"""Evidence for and against a result, one kind a file, and the judgement that collects it."""
