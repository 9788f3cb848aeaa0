"""The model of one robot as text: C for controllers, LaTeX for papers."""
