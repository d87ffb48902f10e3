"""The train stage; its description is in `stage`."""
