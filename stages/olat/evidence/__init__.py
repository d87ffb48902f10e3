"""What a light stage tells of its own faults: the table, the passes, the frames against the table, and the finished maps."""
