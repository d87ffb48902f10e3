"""What files tell of their radiometry beyond capture.toml: exposures, sensor codes, encoding."""
