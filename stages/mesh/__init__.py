"""The mesh stage; its description is in `stage`."""
