"""The metrics stage; its description is in `stage`."""
