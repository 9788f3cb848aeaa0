"""Evidence for and against a result: records of findings, each graded by its effect, and the judge that collects them."""
