"""Self-contained HTML pages: the report of a dataset and the inspection of a capture."""
