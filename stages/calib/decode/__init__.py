"""The decode stage; its description is in `stage`."""
