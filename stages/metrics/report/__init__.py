"""report.html: pictures, figures, costs and reasons of everything that a capture was put through."""
