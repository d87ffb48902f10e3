"""The olat stage; its description is in `stage`."""
