"""Readers of formats that need further packages, each an extra of the project."""
