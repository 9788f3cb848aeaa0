"""The methods: along which motion (7) is written."""
