"""The masks stage; its description is in `stage`."""
