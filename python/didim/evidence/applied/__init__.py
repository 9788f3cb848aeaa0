"""Evidence on a log that a result was not fitted to: payloads, validations, residuals."""
