"""Readers of formats that need packages of their own: an extra of the project for each."""
