"""The result of an identification."""
