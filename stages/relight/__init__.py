"""The relight stage; its description is in `stage`."""
