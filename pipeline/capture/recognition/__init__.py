"""What belongs to a capture and what does not: strangers among the images, one framing, tables that match nothing."""
