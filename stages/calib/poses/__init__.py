"""The poses stage; its description is in `stage`."""
